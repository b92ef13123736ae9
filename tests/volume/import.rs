//! Streams and fields into volume files: the same samples, and the same bytes every time.

use super::{raw_of, read_all};
use crate::extraction::dense;
use crate::support::fields::{Content, random};
use crate::support::rng::Rng;
use crate::support::scratch::{Scratch, bytes};
use brickmarch::store::{Volume, VolumeSpec, import_stream, verify, write_field};
use brickmarch::{Box3, Budget, ErrorKind, Field, Grid, SampleType};
use std::io::Read;

/// A reader that gives a few bytes at a time, as pipes and decompressors do.
struct Dribble<'a>(&'a [u8], Rng);

impl Read for Dribble<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let some = 1 + self.1.below(70_000) as usize;
        let n = some.min(buffer.len()).min(self.0.len());
        buffer[..n].copy_from_slice(&self.0[..n]);
        self.0 = &self.0[n..];
        Ok(n)
    }
}

/// Larger than the least budget, so that slabs go through a scratch file there.
fn domain() -> Box3 {
    let n = if cfg!(debug_assertions) { 60 } else { 180 };
    Box3::new([-3, 0, 7], [n, 2 * n - 9, n + 5])
}

#[test]
fn threads_and_memory_do_not_change_a_byte_of_a_volume() {
    let scratch = Scratch::new("volume-import");
    let mut rng = Rng::new(91);
    let domain = domain();
    for (sample, content) in [
        (SampleType::F32, Content::Smooth),
        (SampleType::I16, Content::Bytes),
        (SampleType::Bit, Content::Plateaus),
    ] {
        let mut values = random(content, domain, &mut rng);
        // A slab of one value, so that there are tiles of several levels.
        let quarter = values.len() / 4;
        values[quarter..2 * quarter].fill(1.0);
        let raw = raw_of(sample, &values);
        let mut spec = VolumeSpec::new(Grid::new(domain), sample);
        spec.brick_edge = 8;
        let mut first: Option<Vec<u8>> = None;
        for (mib, threads) in [(1024, 1), (1024, 2), (16, 8), (16, 1)] {
            let what = format!("{sample:?}, {threads} threads, {mib} MiB");
            let budget = Budget::mib(mib).with_threads(threads);
            let path = scratch.path("stream.bvol");
            let mut source = Dribble(&raw, Rng::new(mib));
            let info = import_stream(&mut source, &spec, &path, &budget)
                .unwrap_or_else(|e| panic!("{what}: {e}"));
            assert!(
                budget.peak_bytes() <= mib << 20 && budget.used_bytes() == 0,
                "{what}"
            );
            assert_eq!(
                info.bytes_file,
                std::fs::metadata(&path).expect("written").len(),
                "{what}"
            );
            let file = bytes(&path);
            std::fs::remove_file(&path).expect("written");
            match &first {
                None => first = Some(file),
                Some(first) => assert!(*first == file, "{what}: other bytes"),
            }
        }
        let path = scratch.write("again.bvol", first.expect("four runs"));
        let budget = Budget::mib(64);
        let volume = Volume::open(&path, &budget).expect("a volume");
        let got = read_all(&volume, domain).expect("readable");
        assert!(got == raw, "{sample:?}: other samples came out");
        let report = verify(&path, &budget).expect("readable");
        assert!(report.is_intact(), "{report:?}");
        // Nothing else may be left beside it.
        assert_eq!(scratch.listing().len(), 1, "{:?}", scratch.listing());
    }
}

#[test]
fn a_field_is_written_as_it_reads() {
    let scratch = Scratch::new("volume-field");
    let mut rng = Rng::new(92);
    let domain = Box3::new([5, -6, 0], [50, 41, 37]);
    let mut values = random(Content::Infinite, domain, &mut rng);
    let half = values.len() / 2;
    values[half..].fill(-0.5);
    let field = dense(domain, values.clone(), 16);
    let mut spec = VolumeSpec::new(Grid::new(domain), SampleType::F32);
    let mut first: Option<Vec<u8>> = None;
    for background in [0.0, -0.5] {
        spec.background = background;
        for threads in [1, 2, 8] {
            let path = scratch.path(&format!("{background}-{threads}.bvol"));
            let budget = Budget::mib(32).with_threads(threads);
            write_field(&field, &spec, &path, &budget).expect("it can be written");
            let volume = Volume::open(&path, &budget).expect("a volume");
            let got = read_all(&volume, domain).expect("readable");
            assert!(
                got == raw_of(SampleType::F32, &values),
                "background {background}, {threads} threads"
            );
            let file = bytes(&path);
            assert!(
                first.get_or_insert_with(|| file.clone()) == &file,
                "{threads} threads: other bytes"
            );
        }
        first = None;
    }
}

#[test]
fn ranges_are_never_too_narrow() {
    let scratch = Scratch::new("volume-range");
    let mut rng = Rng::new(93);
    let domain = Box3::new([-9, 2, 0], [60, 45, 50]);
    for content in [Content::Extreme, Content::Infinite, Content::Smooth] {
        let values = random(content, domain, &mut rng);
        let field = dense(domain, values, 16);
        let spec = VolumeSpec::new(Grid::new(domain), SampleType::F32);
        let path = scratch.path(&format!("{content:?}.bvol"));
        write_field(&field, &spec, &path, &Budget::mib(32)).expect("it can be written");
        let budget = Budget::mib(32);
        let volume = Volume::open(&path, &budget).expect("a volume");
        for _ in 0..200 {
            let min: [i32; 3] = std::array::from_fn(|a| rng.between(domain.min[a], domain.max[a]));
            let max = std::array::from_fn(|a| rng.between(min[a] + 1, domain.max[a] + 1));
            let region = Box3::new(min, max);
            let (wide, true_range) = (
                volume.range(region).expect("readable"),
                field.range(region).expect("in memory"),
            );
            let covers = wide.min <= true_range.min && wide.max >= true_range.max;
            assert!(
                covers && (wide.has_nan || !true_range.has_nan),
                "{content:?} {region}: {wide:?} {true_range:?}"
            );
        }
    }
}

#[test]
fn a_stream_that_ends_early_leaves_nothing() {
    let scratch = Scratch::new("volume-short");
    let domain = Box3::from_size([40; 3]);
    let spec = VolumeSpec::new(Grid::new(domain), SampleType::U16);
    let raw = vec![7u8; 2 * 40 * 40 * 40 - 1];
    let path = scratch.path("short.bvol");
    let error = import_stream(&mut &raw[..], &spec, &path, &Budget::mib(16))
        .expect_err("a byte is missing");
    assert_eq!(error.kind(), ErrorKind::Truncated, "{error}");
    assert!(error.to_string().contains("short.bvol"), "{error}");
    assert!(scratch.listing().is_empty(), "{:?}", scratch.listing());
}
