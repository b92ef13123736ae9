//! Two writers of one file where nothing can be locked: the one that comes second is refused, and
//! harms nothing, at whatever moment the other one commits.

use super::disk::Disk;
use super::tale::{self, BYTES};
use crate::support::report::figure;
use crate::support::rng::Rng;
use brickmarch::store::Storage;
use brickmarch::{Budget, ErrorKind};
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

/// Shows a writer the superblocks as they were when it opened the file or wrote them: no fence.
struct NotFenced {
    inner: Arc<dyn Storage>,
    superblocks: Mutex<Vec<u8>>,
}

const SUPERBLOCKS: u64 = 4096;

impl NotFenced {
    fn new(inner: Arc<dyn Storage>) -> Self {
        let mut superblocks = vec![0; 8192];
        inner
            .read_at(&mut superblocks, SUPERBLOCKS)
            .expect("a file");
        Self {
            inner,
            superblocks: Mutex::new(superblocks),
        }
    }
}

impl Storage for NotFenced {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        if (4096..12288).contains(&offset) {
            let seen = self
                .superblocks
                .lock()
                .unwrap_or_else(PoisonError::into_inner);
            buffer.copy_from_slice(&seen[(offset - SUPERBLOCKS) as usize..][..buffer.len()]);
            return Ok(());
        }
        self.inner.read_at(buffer, offset)
    }
    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<()> {
        if (4096..12288).contains(&offset) {
            let mut seen = self
                .superblocks
                .lock()
                .unwrap_or_else(PoisonError::into_inner);
            seen[(offset - SUPERBLOCKS) as usize..][..bytes.len()].copy_from_slice(bytes);
        }
        self.inner.write_at(bytes, offset)
    }
    fn len(&self) -> io::Result<u64> {
        self.inner.len()
    }
    fn set_len(&self, length: u64) -> io::Result<()> {
        self.inner.set_len(length)
    }
    fn sync(&self) -> io::Result<()> {
        self.inner.sync()
    }
    fn lock(&self) -> io::Result<bool> {
        self.inner.lock()
    }
}

/// How the first of the two writers sees the disk.
type View<'a> = &'a dyn Fn(Arc<dyn Storage>) -> Arc<dyn Storage>;

/// The first writer puts `before` bricks, the second makes `commits` commits of `bricks` bricks, the
/// first puts `after` bricks and commits. What is wrong, if anything.
fn meet(
    before: usize,
    commits: usize,
    bricks: usize,
    after: usize,
    view: View<'_>,
) -> Option<String> {
    let budget = Budget::mib(8);
    let mut rng = Rng::new((before * 64 + bricks * 8 + after + commits * 512) as u64);
    let disk = Arc::new(Disk::new(Vec::new()));
    let mut states = vec![Vec::new()];
    let writer = tale::start(disk.clone(), &budget).expect("starts");
    tale::step(&writer, &disk, &mut states, 8, &mut rng).expect("commits");
    drop(writer);
    let first = tale::reopen(view(disk.clone()), &budget).expect("opens");
    let second = tale::reopen(disk.clone(), &budget).expect("opens: there are no locks");
    let put = |bricks: usize| -> brickmarch::Result<()> {
        let mut ignored = vec![0; BYTES];
        for (brick, raw) in tale::change(&mut ignored, bricks, &mut Rng::new(7)) {
            first.put_brick(brick, &raw)?;
        }
        Ok(())
    };
    put(before).expect("nobody has committed");
    for _ in 0..commits {
        tale::step(&second, &disk, &mut states, bricks, &mut rng).expect("nobody has committed");
    }
    let refused = put(after).and_then(|()| first.commit());
    match refused {
        Ok(_) => return Some("the first writer commits over the second".into()),
        Err(e) if e.kind() != ErrorKind::ForeignWriter => return Some(e.to_string()),
        Err(_) => {}
    }
    if first.commit().is_ok() {
        return Some("the first writer commits at the second try".into());
    }
    // The second one may go on.
    if let Err(e) = tale::step(&second, &disk, &mut states, 1, &mut rng) {
        return Some(e.to_string());
    }
    let last = states.len() - 1;
    let image: Arc<dyn Storage> = Arc::new(Disk::new(disk.image()));
    tale::judge(image, &budget, &states, last, last, &mut vec![0; BYTES]).err()
}

/// A writer without a lock wrote its footer and its bricks over a commit of another one before it
/// looked at the superblocks again.
#[test]
fn a_second_writer_is_refused_and_harms_nothing_without_locks() {
    let (mut meetings, mut harm) = (0, 0);
    for before in 0..=4 {
        for commits in 1..=2 {
            for bricks in [1, 2, 4, 8] {
                for after in 1..=4 {
                    let what =
                        format!("{before} bricks, {commits} commits of {bricks}, {after} bricks");
                    let wrong = meet(before, commits, bricks, after, &|s| s);
                    assert!(wrong.is_none(), "{what}: {}", wrong.unwrap_or_default());
                    let wrong = meet(before, commits, bricks, after, &|s| {
                        Arc::new(NotFenced::new(s))
                    });
                    harm += u32::from(wrong.is_some());
                    meetings += 1;
                }
            }
        }
    }
    assert_eq!(harm, meetings, "a writer without a fence is not caught");
    figure(&format!(
        "two writers without locks: {meetings} meetings, each refused, 0 commits harmed; without the fence all {harm} are caught"
    ));
}
