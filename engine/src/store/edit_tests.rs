//! Changes to a file that is there: against a dense array, with readers beside, and with a medium
//! that refuses.

use super::tests::{Dense, mixed, open, spec};
use super::*;
use crate::{Budget, ErrorKind, Result, SampleType};
use proptest::prelude::*;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};

fn edit(storage: &Arc<MemoryStorage>, budget: &Budget) -> VolumeWriter {
    VolumeWriter::open_in(storage.clone(), Path::new("test"), budget).expect("opens for changes")
}

/// Everything that a file promises, against the dense array.
fn check(storage: &Arc<MemoryStorage>, dense: &Dense, budget: &Budget) -> VolumeInfo {
    let volume = open(storage.clone(), budget).expect("opens");
    dense.check(&volume, dense.spec.grid.domain);
    let report = verify_in(storage.clone(), Path::new("test"), budget).expect("verifies");
    assert!(report.is_intact(), "{:?}", report.problems);
    let info = volume.info().expect("info");
    let fresh = dense.write(budget).1;
    // The same tree as if it had been written at once; only the stored range may not shrink alone.
    assert_eq!(
        (
            info.range,
            info.bricks_stored,
            info.tiles,
            info.pages,
            info.bytes_stored
        ),
        (
            fresh.range,
            fresh.bricks_stored,
            fresh.tiles,
            fresh.pages,
            fresh.bytes_stored
        )
    );
    assert_eq!(
        (info.bricks_constant, info.page_levels),
        (fresh.bricks_constant, fresh.page_levels)
    );
    info
}

impl Dense {
    /// Fills bricks `min..max` (cut to the domain) with `value`.
    fn fill(&mut self, min: [u32; 3], max: [u32; 3], value: impl Fn([u32; 3]) -> f64) {
        let edge = self.spec.brick_edge;
        let size = self.spec.grid.domain.size();
        let width = self.spec.sample.bytes();
        for k in min[2] * edge..(max[2] * edge).min(size[2]) {
            for j in min[1] * edge..(max[1] * edge).min(size[1]) {
                for i in min[0] * edge..(max[0] * edge).min(size[0]) {
                    let at = (i + size[0] * (j + size[1] * k)) as usize * width;
                    let value = value([i, j, k]);
                    self.spec.sample.put(value, &mut self.raw[at..at + width]);
                }
            }
        }
    }
}

#[derive(Clone, Debug)]
enum Op {
    Brick([u32; 3], u8),
    Constant([u32; 3], u8, u8),
    Commit,
    Reopen,
    Drop,
}

fn ops() -> impl Strategy<Value = Vec<Op>> {
    let at = [0..18u32, 0..10u32, 0..3u32];
    let value = prop_oneof![Just(0u8), Just(7), 1..9u8];
    let op = prop_oneof![
        5 => (at.clone(), 0..40u8).prop_map(|(b, v)| Op::Brick(b, v)),
        3 => (at, 0..6u8, value).prop_map(|(b, l, v)| Op::Constant(b, l, v)),
        2 => Just(Op::Commit),
        1 => Just(Op::Reopen),
        1 => Just(Op::Drop),
    ];
    proptest::collection::vec(op, 1..30)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn any_sequence_of_changes_reads_as_the_dense_array(ops in ops(), start in any::<bool>()) {
        let budget = Budget::mib(24).with_threads(2);
        let spec = spec([140, 75, 20], SampleType::U8, 8);
        let bricks = spec.bricks();
        let mut dense = Dense::new(spec, |p| if start { mixed(p) } else { 0.0 });
        let (storage, _) = dense.write(&budget);
        let mut committed = dense.raw.clone();
        let mut writer = edit(&storage, &budget);
        let mut generation = 1;
        for op in ops.into_iter().chain([Op::Commit]) {
            match op {
                Op::Brick(at, v) => {
                    // A few values give constant bricks, the others noise.
                    let value = move |p: [u32; 3]| if v < 9 { f64::from(v) } else {
                        f64::from((p[0] * 7 + p[1] * 31 + p[2] * 97) % u32::from(v))
                    };
                    dense.fill(at, at.map(|b| b + 1), value);
                    writer.put_brick(at, &dense.brick(at)).expect("puts");
                }
                Op::Constant(at, level, v) => {
                    let at = at.map(|b| b >> level << level);
                    dense.fill(at, at.map(|b| b + (1 << level)), |_| f64::from(v));
                    writer.put_constant(at, level, v.into()).expect("puts");
                }
                Op::Commit => {
                    let now = writer.commit().expect("commits");
                    prop_assert!(now == generation || now == generation + 1);
                    generation = now;
                    committed.clone_from(&dense.raw);
                    check(&storage, &dense, &budget);
                }
                Op::Reopen => {
                    writer.commit().expect("commits");
                    committed.clone_from(&dense.raw);
                    drop(writer);
                    writer = edit(&storage, &budget);
                    generation = writer.commit().expect("nothing to do");
                }
                Op::Drop => {
                    drop(writer);
                    dense.raw.clone_from(&committed);
                    writer = edit(&storage, &budget);
                }
            }
        }
        let bricks: u64 = bricks.into_iter().map(u64::from).product();
        let info = check(&storage, &dense, &budget);
        prop_assert_eq!(info.bricks_stored + info.bricks_constant + info.bricks_background, bricks);
        drop(writer);
        prop_assert_eq!(budget.used_bytes(), 0);
    }
}

#[test]
fn readers_keep_their_generation_and_committed_bytes_stay() {
    let budget = Budget::mib(24);
    let mut dense = Dense::new(spec([70, 40, 40], SampleType::I16, 8), mixed);
    let (storage, first) = dense.write(&budget);
    assert_eq!((first.generation, first.bytes_dead), (1, 0));
    let writer = edit(&storage, &budget);
    let mut readers = Vec::new();
    for round in 0..6u32 {
        // A reader that has not read a brick yet.
        let reader = open(storage.clone(), &budget).expect("opens");
        let now = Dense {
            spec: dense.spec.clone(),
            raw: dense.raw.clone(),
        };
        readers.push((reader, now));
        let before = storage.to_vec();
        for n in 0..20 {
            let brick = [n % 9, n / 9, round % 5];
            dense.fill(brick, brick.map(|b| b + 1), |p| {
                f64::from(p[0] * round + p[1] * 3 + p[2])
            });
            writer.put_brick(brick, &dense.brick(brick)).expect("puts");
        }
        assert_eq!(writer.commit().expect("commits"), u64::from(round) + 2);
        let after = storage.to_vec();
        assert!(
            after[12288..before.len()] == before[12288..],
            "the log only grows"
        );
        let slot = if round % 2 == 0 { 8192 } else { 4096 };
        let other = 12288 - slot;
        assert!(after[other..other + 4096] == before[other..other + 4096]);
        assert!(after[slot..slot + 4096] != before[slot..slot + 4096]);
    }
    for (reader, then) in &readers {
        then.check(reader, then.spec.grid.domain);
    }
    let info = check(&storage, &dense, &budget);
    assert!(info.bytes_dead > 0 && info.generation == 7);
}

#[test]
fn a_new_file_may_be_committed_in_parts() {
    let budget = Budget::mib(24);
    let dense = Dense::new(spec([70, 40, 80], SampleType::F32, 8), mixed);
    let storage = Arc::new(MemoryStorage::default());
    let writer = VolumeWriter::create_in(storage.clone(), Path::new("test"), &dense.spec, &budget)
        .expect("good");
    let [bx, by, bz] = writer.bricks();
    for z in 0..bz {
        for n in 0..bx * by {
            let brick = [n % bx, n / bx, z];
            writer.put_brick(brick, &dense.brick(brick)).expect("puts");
        }
        assert_eq!(writer.commit().expect("commits"), u64::from(z) + 1);
        assert_eq!(writer.commit().expect("nothing to do"), u64::from(z) + 1);
    }
    let info = writer.finish().expect("finishes");
    assert_eq!(info.generation, u64::from(bz));
    assert_eq!(check(&storage, &dense, &budget), info);
}

#[test]
fn several_volumes_in_one_file() {
    let budget = Budget::mib(24);
    let mut one = Dense::new(spec([40, 30, 20], SampleType::U8, 8), mixed);
    let mut two = Dense::new(spec([33, 65, 20], SampleType::F32, 16), mixed);
    two.spec.name = "another".into();
    let (storage, _) = one.write(&budget);
    let mut writer = edit(&storage, &budget);
    assert!(writer.add_volume(&one.spec).is_err(), "a name twice");
    let n = writer.add_volume(&two.spec).expect("adds");
    assert!(writer.put_brick_in(2, [0; 3], &[]).is_err());
    let [bx, by, bz] = two.spec.bricks();
    for b in 0..bx * by * bz {
        let brick = [b % bx, b / bx % by, b / bx / by];
        writer
            .put_brick_in(n, brick, &two.brick(brick))
            .expect("puts");
    }
    one.fill([0; 3], [2; 3], |p| f64::from(p[0]));
    for b in 0..8 {
        let brick = [b % 2, b / 2 % 2, b / 4];
        writer.put_brick(brick, &one.brick(brick)).expect("puts");
    }
    writer.commit().expect("commits");
    drop(writer);
    two.fill([1; 3], [2; 3], |_| 4.0);
    let writer = edit(&storage, &budget);
    writer.put_constant_in(1, [1; 3], 0, 4.0).expect("puts");
    writer.finish().expect("commits");
    check(&storage, &one, &budget);
    let volume = Volume::open_named_in(storage.clone(), Path::new("test"), "another", &budget)
        .expect("opens");
    two.check(&volume, two.spec.grid.domain);
    assert_eq!(volume.names(), ["test volume", "another"]);
    let none = Volume::open_named_in(storage, Path::new("test"), "third", &budget);
    let message = none.err().expect("no such volume").to_string();
    assert!(message.contains("another"), "{message}");
}

/// Fails the n-th write or sync from now on.
#[derive(Default)]
struct Failing {
    inner: Arc<MemoryStorage>,
    writes_left: AtomicI64,
    syncs_left: AtomicI64,
    locked: AtomicU64,
}

impl Failing {
    fn over(inner: Arc<MemoryStorage>) -> Arc<Self> {
        Arc::new(Self {
            inner,
            writes_left: AtomicI64::new(i64::MAX),
            syncs_left: AtomicI64::new(i64::MAX),
            locked: AtomicU64::new(0),
        })
    }
}

impl Storage for Failing {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        self.inner.read_at(buffer, offset)
    }
    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<()> {
        if self.writes_left.fetch_sub(1, Ordering::Relaxed) == 0 {
            // A part of it arrives.
            self.inner.write_at(&bytes[..bytes.len() / 2], offset)?;
            return Err(io::ErrorKind::StorageFull.into());
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
        if self.syncs_left.fetch_sub(1, Ordering::Relaxed) == 0 {
            return Err(io::Error::other("the cable"));
        }
        Ok(())
    }
    fn lock(&self) -> io::Result<bool> {
        Ok(self.locked.fetch_add(1, Ordering::Relaxed) == 0)
    }
}

#[test]
fn a_failed_write_costs_the_commit_and_no_more() {
    let budget = Budget::mib(24);
    let mut outcomes = [0; 2];
    for k in 0.. {
        let mut dense = Dense::new(spec([40, 20, 20], SampleType::U16, 8), mixed);
        let (storage, _) = dense.write(&budget);
        let failing = Failing::over(storage.clone());
        let writer =
            VolumeWriter::open_in(failing.clone(), Path::new("test"), &budget).expect("opens");
        dense.fill([0; 3], [5, 3, 1], |p| f64::from(p[0] * p[1]));
        let put = |dense: &Dense| -> Result<u64> {
            let mut first = Ok(());
            for n in 0..15 {
                let brick = [n % 5, n / 5, 0];
                let result = writer.put_brick(brick, &dense.brick(brick));
                first = first.and(result);
            }
            // Like a caller that looks at the commit only.
            let commit = writer.commit();
            assert!(first.is_ok() || commit.is_err());
            commit
        };
        failing.writes_left.store(k, Ordering::Relaxed);
        match put(&dense) {
            Ok(2) => break,
            Ok(other) => panic!("generation {other}"),
            Err(_) => match put(&dense) {
                Ok(generation) => {
                    assert_eq!(generation, 2);
                    outcomes[0] += 1;
                }
                Err(e) => {
                    // Only the write of the superblock leaves the outcome open.
                    assert_eq!(e.kind(), ErrorKind::Poisoned, "{e}");
                    outcomes[1] += 1;
                    drop(writer);
                    let writer = edit(&storage, &budget);
                    assert_eq!(writer.commit().expect("the commit was whole"), 2);
                }
            },
        }
        check(&storage, &dense, &budget);
    }
    assert!(outcomes[0] > 15 && outcomes[1] == 1, "{outcomes:?}");
}

#[test]
fn a_failed_sync_poisons() {
    let budget = Budget::mib(24);
    for k in 0..2 {
        let dense = Dense::new(spec([40, 20, 20], SampleType::U16, 8), mixed);
        let failing = Failing::over(dense.write(&budget).0);
        let writer =
            VolumeWriter::open_in(failing.clone(), Path::new("test"), &budget).expect("opens");
        writer.put_constant([0; 3], 0, 3.0).expect("puts");
        failing.syncs_left.store(k, Ordering::Relaxed);
        assert_eq!(writer.commit().expect_err("fails").kind(), ErrorKind::Io);
        let kinds = [
            writer.commit().expect_err("poisoned").kind(),
            writer
                .put_brick([0; 3], &[0; 1024])
                .expect_err("poisoned")
                .kind(),
            writer
                .put_constant([0; 3], 0, 3.0)
                .expect_err("poisoned")
                .kind(),
            writer.finish().expect_err("poisoned").kind(),
        ];
        assert_eq!(kinds, [ErrorKind::Poisoned; 4]);
    }
}

#[test]
fn one_writer_at_a_time() {
    let budget = Budget::mib(24);
    let dense = Dense::new(spec([40, 20, 20], SampleType::U16, 8), mixed);
    // By lock.
    let folder = tempfile::tempdir().expect("scratch folder");
    let path = folder.path().join("v.bvol");
    std::fs::write(&path, dense.write(&budget).0.to_vec()).expect("writes");
    let writer = VolumeWriter::open(&path, &budget).expect("opens");
    let second = VolumeWriter::open(&path, &budget).err().expect("locked");
    assert_eq!(second.kind(), ErrorKind::ForeignWriter);
    Volume::open(&path, &budget).expect("readers take no lock");
    drop(writer);
    VolumeWriter::open(&path, &budget).expect("free again");
    // By the fence, where locks do not work.
    let (storage, _) = dense.write(&budget);
    let one = edit(&storage, &budget);
    let two = edit(&storage, &budget);
    one.put_constant([0; 3], 0, 3.0).expect("puts");
    two.put_constant([1, 0, 0], 0, 4.0).expect("puts");
    assert_eq!(one.commit().expect("commits"), 2);
    let bytes = storage.to_vec();
    for _ in 0..2 {
        assert_eq!(
            two.commit().expect_err("foreign").kind(),
            ErrorKind::ForeignWriter
        );
        assert!(two.put_brick([0; 3], &dense.brick([2, 0, 0])).is_err());
    }
    assert!(
        bytes == storage.to_vec(),
        "nothing of the first was touched"
    );
}

#[test]
fn a_torn_superblock_is_given_back_before_the_next_commit() {
    let budget = Budget::mib(24);
    let mut dense = Dense::new(spec([40, 20, 20], SampleType::U16, 8), mixed);
    let (storage, _) = dense.write(&budget);
    let writer = edit(&storage, &budget);
    writer.put_constant([0; 3], 0, 3.0).expect("puts");
    writer.commit().expect("commits");
    drop(writer);
    dense.fill([0; 3], [1; 3], |_| 3.0);
    storage.write_at(&[0xee; 100], 8192).expect("tears");
    let writer = edit(&storage, &budget);
    let report = verify_in(storage.clone(), Path::new("test"), &budget).expect("verifies");
    assert!(report.is_intact(), "{:?}", report.problems);
    writer.put_constant([1, 0, 0], 0, 9.0).expect("puts");
    assert_eq!(writer.commit().expect("commits"), 3);
    dense.fill([1, 0, 0], [2, 1, 1], |_| 9.0);
    check(&storage, &dense, &budget);
}

/// A first commit that was found in the log left the other superblock damaged, and the next commit,
/// while it was written, made the file unreadable.
#[test]
fn a_writer_makes_damaged_superblocks_good_before_it_appends() {
    let budget = Budget::mib(24);
    let dense = Dense::new(spec([20, 9, 9], SampleType::U8, 8), mixed);
    for commits in 1..=3 {
        let (storage, _) = dense.write(&budget);
        for n in 1..commits {
            let writer = edit(&storage, &budget);
            writer.put_brick([0, 0, 0], &[n; 512]).expect("puts");
            writer.commit().expect("commits");
        }
        let whole = storage.to_vec();
        let volume = open(storage, &budget).expect("opens");
        let mut samples = vec![0; dense.raw.len()];
        let domain = dense.spec.grid.domain;
        volume.read_raw(domain, &mut samples).expect("reads");
        for slots in [&[4096][..], &[8192], &[4096, 8192]] {
            let mut damaged = whole.clone();
            slots.iter().for_each(|&at| damaged[at + 100] ^= 1);
            let storage = Arc::new(MemoryStorage::new(damaged));
            let writer = edit(&storage, &budget);
            writer.put_brick([1, 0, 0], &[77; 512]).expect("puts");
            // The writer is killed: the tail is there, the commit is not.
            drop(writer);
            storage
                .write_at(&[1; 77], storage.len().expect("length"))
                .expect("writes");
            let volume = open(storage.clone(), &budget).expect("opens");
            let mut now = vec![0; samples.len()];
            volume.read_raw(domain, &mut now).expect("reads");
            assert!(now == samples, "{commits} commits, {slots:?}");
            assert_eq!(volume.info().expect("info").generation, u64::from(commits));
            let report = verify_in(storage, Path::new("test"), &budget).expect("verifies");
            assert!(report.is_intact(), "{:?}", report.problems);
        }
    }
}
