//! Calls that fail: each call of a run of 300 in each way, syncs that lose data, full disks. The
//! outcome is an error or the right samples, on the disk as well, never damage.

use super::disk::{Disk, Fault, Plan};
use crate::support::report::figure;
use crate::support::rng::Rng;
use brickmarch::store::{Storage, Volume, VolumeInfo, VolumeSpec, VolumeWriter};
use brickmarch::{Box3, Budget, ErrorKind, Grid, Result, SampleType};
use std::io;
use std::path::Path;
use std::sync::Arc;

/// 6 x 6 x 8 bricks of edge 8.
const DOMAIN: Box3 = Box3::from_size([48, 48, 64]);
const NAME: &str = "faulty.bvol";

fn spec() -> VolumeSpec {
    VolumeSpec {
        brick_edge: 8,
        history: "made to fail".into(),
        ..VolumeSpec::new(Grid::new(DOMAIN), SampleType::U8)
    }
}

/// Bricks, no two alike, and the samples that they make.
struct Content {
    bricks: Vec<([u32; 3], Vec<u8>)>,
    samples: Vec<u8>,
}

fn content() -> Content {
    let mut rng = Rng::new(300);
    let mut samples = vec![0; DOMAIN.count() as usize];
    let mut bricks = Vec::new();
    for n in 0..6 * 6 * 8u32 {
        let brick = [n % 6, n / 6 % 6, n / 36];
        let base = rng.next() as u8;
        let mut raw = vec![0; 512];
        for (at, value) in raw.iter_mut().enumerate() {
            let p = [at % 8, at / 8 % 8, at / 64];
            *value = base.wrapping_add((p[0] * (n as usize % 7) + p[2]) as u8);
            let whole: [usize; 3] = std::array::from_fn(|a| brick[a] as usize * 8 + p[a]);
            samples[whole[0] + 48 * (whole[1] + 48 * whole[2])] = *value;
        }
        bricks.push((brick, raw));
    }
    Content { bricks, samples }
}

fn write(storage: Arc<dyn Storage>, content: &Content) -> Result<VolumeInfo> {
    let writer = VolumeWriter::create_in(storage, Path::new(NAME), &spec(), &Budget::mib(16))?;
    for (brick, raw) in &content.bricks {
        writer.put_brick(*brick, raw)?;
    }
    writer.finish()
}

fn read(storage: Arc<dyn Storage>, budget: &Budget) -> Result<Vec<u8>> {
    let volume = Volume::open_in(storage, Path::new(NAME), budget)?;
    let mut out = vec![0; DOMAIN.count() as usize];
    volume.read_raw(DOMAIN, &mut out).map(|()| out)
}

/// One line that names the file.
#[track_caller]
fn assert_clear(error: &brickmarch::Error, what: &str) {
    let text = error.to_string();
    assert!(
        text.contains(NAME) && !text.contains('\n'),
        "{what}: {text}"
    );
}

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
fn a_fault_at_any_call_of_a_reader_is_an_error_and_the_next_try_succeeds() {
    let content = content();
    let disk = Arc::new(Disk::failing(Vec::new(), Plan::default(), 0));
    write(disk.clone(), &content).expect("nothing fails");
    let image = disk.image();
    let reader = Arc::new(Disk::failing(image.clone(), Plan::default(), 0));
    read(reader.clone(), &Budget::mib(16)).expect("nothing fails");
    let (calls, _) = reader.calls();
    let (mut runs, mut said) = (0, 0);
    for fault in [Fault::Io, Fault::Interrupted, Fault::Short] {
        for at in (0..calls).step_by(if cfg!(debug_assertions) { 13 } else { 1 }) {
            let what = format!("{fault:?} at call {at} of a reader");
            let plan = Plan {
                at: Some((at, fault)),
                ..Plan::default()
            };
            let disk = Arc::new(Disk::failing(image.clone(), plan, 0));
            let budget = Budget::mib(16);
            let opened = Volume::open_in(disk.clone(), Path::new(NAME), &budget);
            let mut out = vec![0; content.samples.len()];
            let error = match opened {
                Err(e) => Some(e),
                Ok(volume) => {
                    let error = volume.read_raw(DOMAIN, &mut out).err();
                    // A fault while reading ahead concerns nobody: what was asked for is read alone.
                    let right = out == content.samples;
                    assert!(
                        error.is_some() || right,
                        "{what}: other samples, and nothing was said"
                    );
                    // The same open volume reads on once the disk does.
                    disk.heal();
                    volume.read_raw(DOMAIN, &mut out).expect("healed");
                    assert!(out == content.samples, "{what}: other samples came out");
                    error
                }
            };
            if let Some(e) = error {
                assert_clear(&e, &what);
                said += 1;
            }
            runs += 1;
        }
    }
    assert!(2 * said > runs, "{said} of {runs} faults came to light");
    figure(&format!(
        "faults of a reader: {runs} runs of {calls} calls, each an error or the right samples"
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
