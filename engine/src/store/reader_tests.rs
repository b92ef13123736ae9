//! Readers: newer and older generations, damage that is substituted, files that were compacted.

use super::layout::{RECORD_HEADER, get_u32};
use super::tests::{Dense, mixed, open, spec};
use super::*;
use crate::{Box3, Budget, ErrorKind, Field, Range, SampleType, Samples};
use std::path::Path;
use std::sync::Arc;

fn edit(storage: &Arc<MemoryStorage>, budget: &Budget) -> VolumeWriter {
    VolumeWriter::open_in(storage.clone(), Path::new("test"), budget).expect("opens for changes")
}

/// A copy of `dense` with brick `brick` set to `value`.
fn with_brick(dense: &Dense, brick: [u32; 3], value: f64) -> Dense {
    let domain = dense.spec.grid.domain;
    let inside = dense.spec.brick_box(brick);
    Dense::new(dense.spec.clone(), |p| {
        let at: [i32; 3] = std::array::from_fn(|a| domain.min[a] + p[a] as i32);
        if inside.contains(at) {
            return value;
        }
        let offset = domain.offset_of(at) * dense.spec.sample.bytes();
        dense.spec.sample.get(&dense.raw[offset..])
    })
}

#[test]
fn refresh_and_older_generations() {
    let budget = Budget::mib(64);
    let mut states = vec![Dense::new(spec([70, 40, 40], SampleType::F32, 8), mixed)];
    let (storage, _) = states[0].write(&budget);
    let mut reader = open(storage.clone(), &budget).expect("opens");
    let domain = reader.spec().grid.domain;
    assert!(!reader.refresh().expect("nothing new"));
    let writer = edit(&storage, &budget);
    for n in 1..5u32 {
        let next = with_brick(&states[n as usize - 1], [n, 1, 2], n.into());
        writer.put_constant([n, 1, 2], 0, n.into()).expect("puts");
        writer.commit().expect("commits");
        states.last().expect("is there").check(&reader, domain);
        let before = reader.blocks_decoded();
        assert!(reader.refresh().expect("refreshes"));
        assert_eq!(reader.generation(), u64::from(n) + 1);
        next.check(&reader, domain);
        assert_eq!(
            reader.blocks_decoded(),
            before,
            "unchanged bricks stay cached"
        );
        states.push(next);
    }
    for (n, state) in (1u64..).zip(&states) {
        let then = reader.open_generation(n).expect("is there");
        assert_eq!(then.generation(), n);
        state.check(&then, domain);
    }
    for n in [0, 6, u64::MAX] {
        let error = reader.open_generation(n).err().expect("is not there");
        assert_eq!(error.kind(), ErrorKind::BadInput, "{error}");
    }
    let mut then = reader.open_generation(2).expect("is there");
    assert!(then.refresh().expect("to the newest"));
    states[4].check(&then, domain);
}

/// Offsets and lengths of whole records of a kind.
fn records(bytes: &[u8], kind: u8) -> Vec<(usize, usize)> {
    let starts = (12288..bytes.len() - RECORD_HEADER).step_by(8);
    starts
        .filter(|&at| &bytes[at..at + 4] == b"SVrc" && bytes[at + 4] == kind)
        .map(|at| (at, get_u32(bytes, at + 8) as usize))
        .collect()
}

#[test]
fn damage_is_an_error_or_substituted_and_told() {
    let budget = Budget::mib(64);
    for (kind, background) in [(2, 0.0), (3, 0.0), (2, -3.5), (2, f64::NAN)] {
        let mut spec = spec([200, 70, 20], SampleType::F32, 8);
        spec.background = background;
        let dense = Dense::new(spec, mixed);
        let (storage, _) = dense.write(&budget);
        let bytes = storage.to_vec();
        let domain = dense.spec.grid.domain;
        let all = records(&bytes, kind);
        // Not the root page.
        for &(at, length) in all[..all.len() - 1].iter().step_by(7) {
            let mut bad = bytes.clone();
            bad[at + RECORD_HEADER + length / 2] ^= 0x10;
            let storage = Arc::new(MemoryStorage::new(bad));
            let mut volume = open(storage, &budget).expect("opens");
            let mut values = vec![0.0; domain.count() as usize];
            let error = volume
                .read(domain, &mut Samples::dense(&mut values, domain))
                .expect_err("damaged");
            assert_eq!(error.kind(), ErrorKind::Damaged);
            assert!(volume.substituted().is_empty());
            volume.set_on_damage(OnDamage::Substitute);
            volume
                .read(domain, &mut Samples::dense(&mut values, domain))
                .expect("substitutes");
            let told = volume.substituted();
            assert_eq!(told.len(), 1, "{told:?}");
            let lost = told[0].lost.expect("says where");
            let truth = dense.floats(domain);
            for (n, (&got, &want)) in values.iter().zip(&truth).enumerate() {
                let [nx, ny, _] = domain.size().map(|v| v as usize);
                let p = [n % nx, n / nx % ny, n / nx / ny];
                let p: [i32; 3] = std::array::from_fn(|a| domain.min[a] + p[a] as i32);
                if !lost.contains(p) {
                    assert_eq!(got.to_bits(), want.to_bits(), "{p:?}");
                    continue;
                }
                let here = Box3::new(p, p.map(|v| v + 1));
                let range = volume.range(here).expect("range");
                assert_eq!(range.union(Range::of(got)), range, "{p:?}");
            }
            assert_eq!(volume.substituted(), told);
        }
    }
}

#[test]
fn compaction_drops_the_dead_and_keeps_the_rest() {
    let budget = Budget::mib(24);
    let mut dense = Dense::new(spec([140, 75, 40], SampleType::I16, 8), mixed);
    let (storage, fresh) = dense.write(&budget);
    let mut writer = edit(&storage, &budget);
    for n in 0..9 {
        dense = with_brick(&dense, [n, 3, 1], 9.0);
        let brick = [n, 3, 1];
        writer.put_brick(brick, &dense.brick(brick)).expect("puts");
        dense = with_brick(&dense, [n, 2, 1], f64::from(n));
        writer.put_constant([n, 2, 1], 0, n.into()).expect("puts");
        writer.commit().expect("commits");
    }
    writer.build_levels(2).expect("builds");
    let mut other = spec_named("other");
    other.history = "its own".into();
    let number = writer.add_volume(&other).expect("adds");
    writer
        .put_constant_in(number, [0; 3], 1, 3.0)
        .expect("puts");
    let before = writer.finish().expect("commits");
    assert!(before.bytes_dead > 0 && !before.sealed && before.bytes_file > fresh.bytes_file);
    let target = Arc::new(MemoryStorage::default());
    let info =
        compact_in(storage.clone(), target.clone(), Path::new("test"), &budget).expect("compacts");
    assert!(info.sealed && info.bytes_dead == 0 && info.generation == 1);
    assert!(info.bytes_file < before.bytes_file);
    let report = verify_in(target.clone(), Path::new("test"), &budget).expect("verifies");
    assert!(report.is_intact(), "{:?}", report.problems);
    for storage in [&storage, &target] {
        let volume = open(storage.clone(), &budget).expect("opens");
        dense.check(&volume, dense.spec.grid.domain);
        assert_eq!((volume.levels(), volume.names().len()), (2, 2));
        let other = Volume::open_named_in(storage.clone(), Path::new("test"), "other", &budget)
            .expect("opens");
        assert_eq!(other.spec().history, "its own");
        assert_eq!(
            other.range(other.spec().grid.domain).expect("range").max,
            3.0
        );
    }
    for level in 0..3 {
        let [a, b] = [&storage, &target].map(|s| {
            let volume = open(s.clone(), &budget).expect("opens");
            let level = volume.level(level).expect("is there");
            let domain = level.spec().grid.domain;
            let mut raw = vec![0; domain.count() as usize * 2];
            level.read_raw(domain, &mut raw).expect("reads");
            raw
        });
        assert!(a == b);
    }
    // Bricks in Morton order, and again nothing to gain.
    let bytes = target.to_vec();
    let keys: Vec<(u16, u64)> = records(&bytes, 2)
        .iter()
        .map(|&(at, _)| (get_u16_at(&bytes, at + 32), get_u64_at(&bytes, at + 24)))
        .collect();
    assert!(keys.is_sorted() && keys.len() as u64 > info.bricks_stored);
    let again = Arc::new(MemoryStorage::default());
    compact_in(target.clone(), again.clone(), Path::new("test"), &budget).expect("compacts");
    assert!(again.to_vec() == bytes);
    let writer = edit(&target, &budget);
    writer.put_constant([0; 3], 0, 1.0).expect("puts");
    let info = writer.finish().expect("commits");
    assert!(!info.sealed && info.generation == 2);
}

fn spec_named(name: &str) -> VolumeSpec {
    let mut spec = spec([30, 30, 30], SampleType::U8, 8);
    spec.name = name.into();
    spec
}

fn get_u16_at(bytes: &[u8], at: usize) -> u16 {
    super::layout::get_u16(bytes, at)
}

fn get_u64_at(bytes: &[u8], at: usize) -> u64 {
    super::layout::get_u64(bytes, at)
}

#[test]
fn a_file_is_compacted_in_its_place() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let path = folder.path().join("v.bvol");
    let budget = Budget::mib(24);
    let dense = Dense::new(spec([70, 40, 40], SampleType::U8, 8), mixed);
    std::fs::write(&path, dense.write(&budget).0.to_vec()).expect("writes");
    let writer = VolumeWriter::open(&path, &budget).expect("opens");
    writer.put_constant([0; 3], 0, 200.0).expect("puts");
    writer.commit().expect("commits");
    let busy = compact(&path, &path, &budget).expect_err("has a writer");
    assert_eq!(busy.kind(), ErrorKind::ForeignWriter);
    drop(writer);
    let reader = Volume::open(&path, &budget).expect("opens");
    let dense = with_brick(&dense, [0; 3], 200.0);
    compact(&path, &path, &budget).expect("compacts");
    dense.check(&reader, dense.spec.grid.domain);
    dense.check(
        &Volume::open(&path, &budget).expect("opens"),
        dense.spec.grid.domain,
    );
    assert_eq!(std::fs::read_dir(folder.path()).expect("lists").count(), 1);
    // Damage is not copied.
    let mut bytes = std::fs::read(&path).expect("reads");
    let (at, _) = records(&bytes, 2)[3];
    bytes[at + RECORD_HEADER] ^= 1;
    std::fs::write(&path, &bytes).expect("writes");
    let error = compact(&path, &path, &budget).expect_err("damaged");
    assert_eq!(error.kind(), ErrorKind::Damaged);
    assert!(std::fs::read(&path).expect("reads") == bytes);
    assert_eq!(std::fs::read_dir(folder.path()).expect("lists").count(), 1);
}
