//! Reads all that a volume file gives, within a budget.

use brickmarch::store::{MemoryStorage, Volume, verify_in};
use brickmarch::{Box3, Budget, Field, Samples};
use std::path::Path;
use std::sync::Arc;

const MIB: u64 = 16;

/// Opens, asks, reads, verifies. Errors are answers; panics and memory are findings.
pub fn everything(bytes: Vec<u8>) {
    let budget = Budget::mib(MIB).with_threads(1);
    let storage = Arc::new(MemoryStorage::new(bytes));
    let name = Path::new("fuzzed");
    if let Ok(volume) = Volume::open_in(storage.clone(), name, &budget) {
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
    let _ = verify_in(storage, name, &budget);
    assert!(budget.peak_bytes() <= MIB << 20);
    assert_eq!(budget.used_bytes(), 0);
}
