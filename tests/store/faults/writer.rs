//! Faults of a writer of a new file.

use super::*;
use std::io;

/// What is on the disk after the writer is gone; `whole`: it must be the volume.
#[track_caller]
fn judge(image: Vec<u8>, content: &Content, whole: bool, what: &str) {
    match read(Arc::new(Disk::new(image)), &Budget::mib(16)) {
        Ok(samples) => assert!(samples == content.samples, "{what}: other samples came out"),
        Err(e) => assert!(!whole, "{what}: success was reported, and then {e}"),
    }
}

fn calls(content: &Content) -> (u64, u64, u64) {
    let disk = Arc::new(Disk::failing(Vec::new(), Plan::default(), 0));
    write(disk.clone(), content).expect("nothing fails");
    let (calls, syncs) = disk.calls();
    (calls, syncs, disk.image().len() as u64)
}

#[test]
fn a_fault_at_any_call_of_a_writer_is_an_error_or_no_matter() {
    let content = content();
    let (calls, syncs, _) = calls(&content);
    assert!(calls >= 300, "{calls} calls");
    let step = if cfg!(debug_assertions) { 11 } else { 1 };
    let (mut runs, mut refused) = (0, 0);
    for fault in Fault::ALL {
        let (last, step) = match fault {
            Fault::Sync => (syncs, 1),
            _ => (calls, step),
        };
        for at in (0..last).step_by(step) {
            for stays in [false, true] {
                for loss in 0..if fault == Fault::Sync { 8 } else { 1 } {
                    let what = format!("{fault:?} at call {at}, stays: {stays}, loss {loss}");
                    let plan = Plan {
                        at: Some((at, fault)),
                        stays,
                        capacity: None,
                    };
                    let disk = Arc::new(Disk::failing(Vec::new(), plan, loss));
                    let result = write(disk.clone(), &content);
                    if let Err(e) = &result {
                        assert_clear(e, &what);
                    } else {
                        // What has no such call cannot fail by it, everything else must show.
                        assert_eq!(disk.failed(), 0, "{what}: success in spite of it");
                    }
                    refused += u64::from(result.is_err());
                    judge(disk.image(), &content, result.is_ok(), &what);
                    judge(disk.synced(), &content, result.is_ok(), &what);
                    runs += 1;
                }
            }
        }
    }
    assert!(refused * 2 > runs);
    figure(&format!(
        "faults of a writer: {runs} runs of {calls} calls, {refused} refused, 0 damaged"
    ));
}

#[test]
fn a_full_disk_is_one_error_whatever_its_size() {
    let content = content();
    let (_, _, whole) = calls(&content);
    let mut sizes = 0;
    for capacity in (0..whole).step_by(if cfg!(debug_assertions) { 4099 } else { 509 }) {
        let what = format!("a disk of {capacity} bytes");
        let plan = Plan {
            capacity: Some(capacity),
            ..Plan::default()
        };
        let disk = Arc::new(Disk::failing(Vec::new(), plan, 0));
        let error = write(disk.clone(), &content).expect_err(&what);
        assert_clear(&error, &what);
        assert_eq!(error.kind(), ErrorKind::Io, "{what}: {error}");
        judge(disk.image(), &content, false, &what);
        sizes += 1;
    }
    figure(&format!("full disk: {sizes} sizes, each one error"));
}

/// The mistake that lost data of several databases: to try a failed sync again.
struct TriesAgain(Arc<Disk>);

impl Storage for TriesAgain {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        self.0.read_at(buffer, offset)
    }
    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<()> {
        self.0.write_at(bytes, offset)
    }
    fn len(&self) -> io::Result<u64> {
        self.0.len()
    }
    fn set_len(&self, length: u64) -> io::Result<()> {
        self.0.set_len(length)
    }
    fn sync(&self) -> io::Result<()> {
        self.0.sync().or_else(|_| self.0.sync())
    }
    fn lock(&self) -> io::Result<bool> {
        self.0.lock()
    }
}

#[test]
fn a_sync_that_is_tried_again_is_caught() {
    let content = content();
    let lost = (0..8).any(|loss| {
        let plan = Plan {
            at: Some((0, Fault::Sync)),
            ..Plan::default()
        };
        let disk = Arc::new(Disk::failing(Vec::new(), plan, loss));
        let done = write(Arc::new(TriesAgain(disk.clone())), &content).is_ok();
        let after = read(Arc::new(Disk::new(disk.synced())), &Budget::mib(16));
        done && after.is_err()
    });
    assert!(lost, "the disk forgives a failed sync");
}
