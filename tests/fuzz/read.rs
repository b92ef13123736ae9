//! Reads all that a volume file gives, within a budget.

use brickmarch::store::{
    MemoryStorage, OnDamage, Volume, VolumeWriter, compact_in, verify_in,
};
use brickmarch::{Box3, Budget, Field, Samples};
use std::path::Path;
use std::sync::Arc;

const MIB: u64 = 16;

/// Opens, asks, reads, verifies, changes, compacts. Errors are answers; panics and memory are findings.
pub fn everything(bytes: Vec<u8>) {
    let budget = Budget::mib(MIB).with_threads(1);
    let storage = Arc::new(MemoryStorage::new(bytes));
    let name = Path::new("fuzzed");
    if let Ok(volume) = Volume::open_in(storage.clone(), name, &budget) {
        one(&volume);
        for level in 1..=volume.levels().min(2) {
            if let Ok(level) = volume.level(level) {
                one(&level);
            }
        }
        if let Ok(older) = volume.open_generation(volume.generation().wrapping_sub(1)) {
            one(&older);
        }
        for other in volume.names().iter().skip(1).take(2) {
            if let Ok(mut volume) = Volume::open_named_in(storage.clone(), name, other, &budget) {
                volume.set_on_damage(OnDamage::Substitute);
                one(&volume);
                let _ = volume.refresh();
            }
        }
    }
    let _ = verify_in(storage.clone(), name, &budget);
    if let Ok(info) = Volume::open_in(storage.clone(), name, &budget).and_then(|v| v.info()) {
        // What is stored decides the work, not what the domain could hold.
        if info.bricks_stored < 1000 && info.pages < 1000 {
            let target = Arc::new(MemoryStorage::default());
            let _ = compact_in(storage.clone(), target, name, &budget);
        }
        change(&storage, name, &budget);
    }
    assert!(budget.peak_bytes() <= MIB << 20);
    assert_eq!(budget.used_bytes(), 0);
}

/// A commit on top of whatever is there must leave a file whose change reads right.
fn change(storage: &Arc<MemoryStorage>, name: &Path, budget: &Budget) {
    let Ok(writer) = VolumeWriter::open_in(storage.clone(), name, budget) else {
        return;
    };
    if writer.put_constant([0; 3], 0, 1.0).is_err() || writer.commit().is_err() {
        return;
    }
    drop(writer);
    let volume = Volume::open_in(storage.clone(), name, budget).expect("just committed");
    let corner = volume.spec().grid.domain.min;
    let one = Box3::new(corner, corner.map(|v| v + 1));
    let mut value = [0.0];
    volume
        .read(one, &mut Samples::dense(&mut value, one))
        .expect("just written");
    assert_eq!(value, [1.0]);
}

/// All that a volume gives.
fn one(volume: &Volume) {
    let info = volume.info().expect("an open volume has info");
    let domain = info.domain;
    let _ = volume.range(domain);
    // Huge domains are read at both ends.
    let part = |low: bool| {
        let size = domain.size();
        let min: [i32; 3] = std::array::from_fn(|a| {
            if low {
                domain.min[a]
            } else {
                (i64::from(domain.max[a]) - i64::from(size[a].min(40))) as i32
            }
        });
        Box3::new(
            min,
            std::array::from_fn(|a| (i64::from(min[a]) + i64::from(size[a].min(40))) as i32),
        )
    };
    for region in [part(true), part(false)] {
        let mut raw = vec![0; region.count() as usize * info.sample.bytes()];
        let read = volume.read_raw(region, &mut raw);
        let mut values = vec![0.0; region.count() as usize];
        let values_read = volume.read(region, &mut Samples::dense(&mut values, region));
        assert_eq!(read.is_ok(), values_read.is_ok());
        let _ = volume.range(region);
        let label = volume.label(1);
        let _ = label.range(region);
        let _ = label.read(region, &mut Samples::dense(&mut values, region));
    }
    volume.forget(part(true));
}
