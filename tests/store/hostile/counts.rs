//! Counts and generations at the end of numbers: what a commit adds to them.

use super::super::image::{self, kind, put, u64_at};
use brickmarch::store::{MemoryStorage, Volume, VolumeSpec, VolumeWriter, compact_in, verify_in};
use brickmarch::{Box3, Budget, Error, ErrorKind, Field, Grid, SampleType};
use std::path::Path;
use std::sync::Arc;

const NAME: &str = "counts.bvol";
/// Where a superblock and the payload of a footer have their bytes live and dead.
const LIVE: usize = 48;
const DEAD: usize = 56;

fn budget() -> Budget {
    Budget::mib(16)
}

/// A file of one commit.
fn whole() -> Vec<u8> {
    let spec = VolumeSpec {
        brick_edge: 8,
        ..VolumeSpec::new(Grid::new(Box3::from_size([20, 9, 8])), SampleType::U16)
    };
    let storage = Arc::new(MemoryStorage::default());
    let writer = VolumeWriter::create_in(storage.clone(), Path::new(NAME), &spec, &budget());
    let writer = writer.expect("made");
    writer.put_brick([0, 1, 0], &[7; 1024]).expect("put");
    writer.finish().expect("finished");
    storage.to_vec()
}

fn reopen(storage: &Arc<MemoryStorage>) -> Result<VolumeWriter, Error> {
    VolumeWriter::open_in(storage.clone(), Path::new(NAME), &budget())
}

fn largest(storage: &Arc<MemoryStorage>) -> (f64, u64) {
    let volume = Volume::open_in(storage.clone(), Path::new(NAME), &budget()).expect("opens");
    let range = volume.range(Box3::from_size([8, 8, 8])).expect("known");
    (f64::from(range.max), volume.generation())
}

/// What the superblocks and the footer say of live and dead bytes is a count that a commit adds to: it
/// stops at the end of numbers, where one that goes round would be small.
#[test]
fn fuzz_open_and_read_all_counts_that_overflow_in_a_commit() {
    let whole = whole();
    let footer = image::of_kind(&whole, kind::FOOTER)[0].payload();
    for (field, value) in [
        (LIVE, u64::MAX),
        (LIVE, u64::MAX - 100),
        (DEAD, u64::MAX),
        (DEAD, u64::MAX - 100),
    ] {
        let mut bytes = whole.clone();
        for slot in [1, 2].map(image::superblock_of) {
            put(&mut bytes, slot + field, value.to_le_bytes());
        }
        put(&mut bytes, footer + field, value.to_le_bytes());
        image::reseal(&mut bytes);
        let storage = Arc::new(MemoryStorage::new(bytes));
        let writer = reopen(&storage).expect("opens");
        writer.put_constant([0; 3], 0, 3.0).expect("put");
        assert_eq!(writer.commit().expect("committed"), 2);
        drop(writer);
        let after = storage.to_vec();
        let footers = image::of_kind(&after, kind::FOOTER);
        let last = footers.last().expect("one").payload();
        for (place, at) in [("superblock", image::superblock_of(2)), ("footer", last)] {
            let said = u64_at(&after, at + field);
            // Dead bytes only grow; of the live ones the commit takes away what it replaces.
            let least = match field {
                DEAD => u64::MAX,
                _ => u64::MAX - after.len() as u64,
            };
            assert!(said >= least, "{place}: {value} became {said}");
        }
        assert_eq!(largest(&storage), (3.0, 2));
        let report = verify_in(storage, Path::new(NAME), &budget()).expect("reads");
        assert!(!report.is_intact(), "verify believes the counts");
    }
}

/// A file whose one commit is of `generation`, with a superblock of the generation before beside it.
fn of_generation(generation: u64) -> Arc<MemoryStorage> {
    let mut bytes = whole();
    for record in image::records(&bytes) {
        put(&mut bytes, record.at + 16, generation.to_le_bytes());
        if record.kind == kind::FOOTER {
            put(&mut bytes, record.payload(), generation.to_le_bytes());
        }
    }
    let root: [u8; 4096] = image::get(&bytes, image::superblock_of(1));
    for generation in [generation - 1, generation] {
        let slot = image::superblock_of(generation);
        put(&mut bytes, slot, root);
        put(&mut bytes, slot + 8, generation.to_le_bytes());
    }
    image::reseal(&mut bytes);
    Arc::new(MemoryStorage::new(bytes))
}

#[track_caller]
fn assert_full(error: &Error) {
    let text = error.to_string();
    assert_eq!(error.kind(), ErrorKind::LimitExceeded, "{text}");
    assert!(text.contains(NAME) && text.contains("compact"), "{text}");
}

/// Such a file reads and can be compacted, but takes no commit: there is no number for it.
#[test]
fn no_commit_follows_the_last_generations() {
    for generation in [u64::MAX - 1, u64::MAX] {
        let storage = of_generation(generation);
        let before = storage.to_vec();
        assert_eq!(largest(&storage), (0.0, generation));
        assert_full(&reopen(&storage).map(|_| ()).expect_err("no number is left"));
        assert!(storage.to_vec() == before, "a refused writer wrote");
        let anew = Arc::new(MemoryStorage::default());
        compact_in(storage, anew.clone(), Path::new(NAME), &budget()).expect("a sound file");
        let writer = reopen(&anew).expect("it begins again");
        writer.put_constant([0; 3], 0, 3.0).expect("put");
        assert_eq!(writer.commit().expect("committed"), 2);
        assert_eq!(largest(&anew), (3.0, 2));
    }
}

/// The same for a writer that is open when it comes there.
#[test]
fn a_writer_stops_at_the_last_generation() {
    let storage = of_generation(u64::MAX - 2);
    let writer = reopen(&storage).expect("one number is left");
    writer.put_constant([0; 3], 0, 3.0).expect("put");
    assert_eq!(writer.commit().expect("committed"), u64::MAX - 1);
    let put = writer.put_constant([0; 3], 0, 4.0);
    assert_full(
        &put.and_then(|()| writer.commit())
            .expect_err("no number is left"),
    );
    drop(writer);
    assert_eq!(largest(&storage), (3.0, u64::MAX - 1));
}
