//! Small files that were changed after they were made: several commits, volumes and levels of detail,
//! and a compacted one.

use super::small::{Part, Small, make};
use brickmarch::store::{MemoryStorage, VolumeWriter, compact_in};
use brickmarch::{Affine, Budget, Kind, SampleType};
use std::path::Path;
use std::sync::Arc;

const NAME: &str = "changed.bvol";

fn budget() -> Budget {
    Budget::mib(24).with_threads(1)
}

fn storage_of(small: &Small) -> Arc<MemoryStorage> {
    Arc::new(MemoryStorage::new(small.file()))
}

fn writer(storage: &Arc<MemoryStorage>) -> VolumeWriter {
    VolumeWriter::open_in(storage.clone(), Path::new(NAME), &budget()).expect("sound")
}

/// Three commits, the last two of changes; the level built after the first no longer fits.
fn commits() -> Vec<u8> {
    use Part::{Background, Constant, Few, Noise, Ramp, Smooth};
    let parts = [Few, Background, Constant, Noise, Ramp, Smooth];
    let small = make(
        "u8_commits",
        SampleType::U8,
        Kind::Density,
        &parts,
        |_, _| {},
    );
    let storage = storage_of(&small);
    let mut changes = writer(&storage);
    changes.build_levels(1).expect("memory does not fail");
    let ramp: Vec<u8> = (0..512u32).map(|n| (n * n % 251) as u8).collect();
    changes.put_brick([1, 0, 0], &ramp).expect("inside");
    changes.put_brick([3, 0, 1], &ramp).expect("inside");
    changes.commit().expect("memory does not fail");
    drop(changes);
    let changes = writer(&storage);
    changes.put_constant([4, 0, 0], 0, 3.0).expect("inside");
    changes.put_constant([0, 0, 0], 0, 0.0).expect("inside");
    changes.finish().expect("memory does not fail");
    storage.to_vec()
}

/// As many levels of detail as there are.
fn levels() -> Vec<u8> {
    use Part::{Constant, Few, Noise, Ramp, Smooth};
    let parts = [Few, Smooth, Constant, Noise, Ramp];
    let small = make(
        "i16_levels",
        SampleType::I16,
        Kind::Density,
        &parts,
        |spec, _| {
            spec.background = -3.0;
            spec.grid.index_to_world = Affine::from_spacing([0.5, 0.5, 2.0], [1.0, 2.0, 3.0]);
        },
    );
    let storage = storage_of(&small);
    let mut changes = writer(&storage);
    changes.build_levels(9).expect("memory does not fail");
    changes.finish().expect("memory does not fail");
    storage.to_vec()
}

/// Labels with a level, and distances of another size and brick edge beside them.
fn volumes() -> Vec<u8> {
    use Part::{Background, Few, Noise, Smooth};
    let labels = make(
        "labels",
        SampleType::U32,
        Kind::Label,
        &[Few, Background, Noise],
        |_, _| {},
    );
    let distances = make(
        "distances",
        SampleType::F32,
        Kind::Distance,
        &[Smooth, Smooth],
        |spec, _| {
            spec.brick_edge = 16;
        },
    );
    let storage = storage_of(&labels);
    let mut changes = writer(&storage);
    let number = changes.add_volume(&distances.spec).expect("another name");
    let dense = crate::volume::Dense {
        spec: &distances.spec,
        raw: &distances.raw,
    };
    dense.put_all_in(&changes, number);
    changes.build_levels(1).expect("memory does not fail");
    changes.finish().expect("memory does not fail");
    storage.to_vec()
}

/// The same volumes in Morton order and one commit.
fn sealed() -> Vec<u8> {
    let storage = Arc::new(MemoryStorage::default());
    let source = Arc::new(MemoryStorage::new(volumes()));
    compact_in(source, storage.clone(), Path::new(NAME), &budget()).expect("sound");
    storage.to_vec()
}

/// Name and bytes of each; the bytes of all but the last hold the random number of a writer.
pub(crate) fn all() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("u8_commits", commits()),
        ("i16_levels", levels()),
        ("two_volumes", volumes()),
        ("two_volumes_sealed", sealed()),
    ]
}
