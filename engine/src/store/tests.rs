//! The whole store against a dense array.

use super::*;
use crate::{
    Affine, Box3, Budget, ErrorKind, Field, Grid, Kind, Range, SampleType, Samples, Units,
};
use proptest::prelude::*;
use std::path::Path;
use std::sync::Arc;

/// Raw samples of a whole domain.
pub(super) struct Dense {
    pub(super) spec: VolumeSpec,
    pub(super) raw: Vec<u8>,
}

impl Dense {
    /// Samples from numbers; `Bit` from their lowest bit.
    pub(super) fn new(spec: VolumeSpec, value: impl Fn([u32; 3]) -> f64) -> Self {
        let [nx, ny, nz] = spec.grid.domain.size();
        let width = spec.sample.bytes();
        let mut raw = vec![0; (nx * ny * nz) as usize * width];
        let points =
            (0..nz).flat_map(|k| (0..ny).flat_map(move |j| (0..nx).map(move |i| [i, j, k])));
        for (point, bytes) in points.zip(raw.chunks_mut(width)) {
            spec.sample.put(value(point), bytes);
        }
        Self { spec, raw }
    }

    pub(super) fn read(&self, region: Box3) -> Vec<u8> {
        let width = self.spec.sample.bytes();
        let mut out = Vec::new();
        for k in region.min[2]..region.max[2] {
            for j in region.min[1]..region.max[1] {
                let start = self.spec.grid.domain.offset_of([region.min[0], j, k]) * width;
                out.extend_from_slice(&self.raw[start..][..region.size()[0] as usize * width]);
            }
        }
        out
    }

    pub(super) fn floats(&self, region: Box3) -> Vec<f32> {
        let raw = self.read(region);
        let mut out = vec![0.0; region.count() as usize];
        self.spec.sample.to_f32(&raw, &mut out);
        out
    }

    /// The brick, with rubbish beyond the domain.
    pub(super) fn brick(&self, brick: [u32; 3]) -> Vec<u8> {
        let (edge, width) = (self.spec.brick_edge as usize, self.spec.sample.bytes());
        let inside = self.spec.brick_box(brick);
        let [nx, ny, nz] = inside.size().map(|n| n as usize);
        let mut out = vec![0x5a; edge.pow(3) * width];
        let rows = self.read(inside);
        for k in 0..nz {
            for j in 0..ny {
                let row = &rows[(j + ny * k) * nx * width..][..nx * width];
                out[(j + edge * k) * edge * width..][..nx * width].copy_from_slice(row);
            }
        }
        out
    }

    pub(super) fn write(&self, budget: &Budget) -> (Arc<MemoryStorage>, VolumeInfo) {
        let storage = Arc::new(MemoryStorage::default());
        let writer =
            VolumeWriter::create_in(storage.clone(), Path::new("test"), &self.spec, budget)
                .expect("good spec");
        let [bx, by, bz] = writer.bricks();
        for n in 0..bx * by * bz {
            let brick = [n % bx, n / bx % by, n / bx / by];
            writer.put_brick(brick, &self.brick(brick)).expect("writes");
        }
        let info = writer.finish().expect("commits");
        (storage, info)
    }

    /// Compares samples and ranges over `region`.
    pub(super) fn check(&self, volume: &Volume, region: Box3) {
        let mut raw = vec![0xee; region.count() as usize * self.spec.sample.bytes()];
        volume.read_raw(region, &mut raw).expect("reads");
        assert!(raw == self.read(region), "samples of {region}");
        let expected = self.floats(region);
        let mut floats = vec![0.5; expected.len()];
        volume
            .read(region, &mut Samples::dense(&mut floats, region))
            .expect("reads");
        assert!(
            floats
                .iter()
                .zip(&expected)
                .all(|(a, b)| a.to_bits() == b.to_bits()),
            "floats of {region}"
        );
        let range = volume.range(region).expect("range");
        let truth = Range::of_slice(&expected);
        assert_eq!(truth.union(range), range, "range of {region} is too narrow");
    }

    /// The range over bricks is exactly that of their samples.
    fn check_tight(&self, volume: &Volume, brick: [u32; 3]) {
        let region = self.spec.brick_box(brick);
        let truth = Range::of_slice(&self.floats(region));
        assert_eq!(
            volume.range(region).expect("range"),
            truth,
            "range of brick {brick:?}"
        );
    }
}

pub(super) fn spec(size: [i32; 3], sample: SampleType, edge: u32) -> VolumeSpec {
    let min = [-7, 3, 100];
    let domain = Box3::new(min, std::array::from_fn(|a| min[a] + size[a]));
    VolumeSpec {
        brick_edge: edge,
        name: "test volume".into(),
        history: "made by a test".into(),
        ..VolumeSpec::new(Grid::new(domain), sample)
    }
}

pub(super) fn open(storage: Arc<MemoryStorage>, budget: &Budget) -> crate::Result<Volume> {
    Volume::open_in(storage, Path::new("test"), budget)
}

/// Constant regions, smooth regions and noise.
pub(super) fn mixed(p: [u32; 3]) -> f64 {
    let [x, y, z] = p.map(f64::from);
    let hash = p[0].wrapping_mul(73_856_093)
        ^ p[1].wrapping_mul(19_349_663)
        ^ p[2].wrapping_mul(83_492_791);
    match (p[0] / 20 + p[1] / 20 + p[2] / 20) % 4 {
        0 => 0.0,
        1 => 5.0,
        2 => ((x * 0.1).sin() + (y * 0.07).cos() + (z * 0.05).sin()) * 50.0 + 60.0,
        _ => f64::from(hash % 100_000),
    }
}

#[test]
fn every_type_and_edge_round_trips() {
    let budget = Budget::mib(24).with_threads(2);
    for sample in SampleType::ALL {
        for edge in [8, 16, 32, 64] {
            let size = if edge == 8 {
                [70, 33, 41]
            } else {
                [45, 33, 41]
            };
            let dense = Dense::new(spec(size, sample, edge), mixed);
            let (storage, info) = dense.write(&budget);
            let volume = open(storage, &budget).expect("opens");
            assert_eq!(volume.spec(), &dense.spec);
            let domain = dense.spec.grid.domain;
            dense.check(&volume, domain);
            assert_eq!(
                volume.range(domain).expect("range"),
                Range::of_slice(&dense.floats(domain))
            );
            let [bx, by, bz] = dense.spec.bricks();
            for n in 0..bx * by * bz {
                dense.check_tight(&volume, [n % bx, n / bx % by, n / bx / by]);
            }
            assert_eq!(volume.info().expect("info"), info);
            assert_eq!(volume.blocks_decoded(), info.bricks_stored);
            let all = info.bricks_stored + info.bricks_constant + info.bricks_background;
            assert_eq!(all, u64::from(bx * by * bz));
            assert!(info.bricks_background > 0 || edge > 16);
        }
    }
    assert_eq!(budget.used_bytes(), 0);
}

#[test]
fn nan_is_kept_and_known() {
    let budget = Budget::mib(24);
    let mut spec = spec([40, 20, 20], SampleType::F32, 8);
    spec.background = f64::NAN;
    let value = |p: [u32; 3]| match p[0] / 8 {
        0 | 1 => f64::NAN,
        2 => 4.0,
        3 if p[1] == 3 => f64::NAN,
        3 => f64::from(p[2]),
        _ => f64::INFINITY,
    };
    let dense = Dense::new(spec, value);
    let (storage, info) = dense.write(&budget);
    assert!(info.range.has_nan && info.bricks_background == 18);
    let volume = open(storage, &budget).expect("opens");
    let domain = dense.spec.grid.domain;
    dense.check(&volume, domain);
    for n in 0..5 {
        dense.check_tight(&volume, [n, 0, 0]);
    }
}

#[test]
fn an_empty_volume_is_background() {
    let budget = Budget::mib(24);
    let mut spec = spec([300, 200, 100], SampleType::I16, 16);
    spec.background = -5.0;
    let dense = Dense::new(spec, |_| -5.0);
    let (storage, info) = dense.write(&budget);
    assert_eq!(
        (info.bricks_stored, info.tiles, info.pages, info.page_levels),
        (0, 0, 0, 0)
    );
    assert!(info.bytes_file <= 20 << 10, "{} bytes", info.bytes_file);
    let volume = open(storage, &budget).expect("opens");
    dense.check(&volume, dense.spec.grid.domain);
    assert_eq!(
        volume.range(Box3::from_size([1000; 3])).expect("range"),
        Range::of(-5.0)
    );
    assert_eq!(
        volume.range(Box3::from_size([1; 3])).expect("outside"),
        Range::EMPTY
    );
}

#[test]
fn constants_at_every_level_become_tiles() {
    let budget = Budget::mib(24);
    let spec = spec([600, 520, 70], SampleType::U8, 8);
    for level in 0..=6u8 {
        let storage = Arc::new(MemoryStorage::default());
        let writer = VolumeWriter::create_in(storage.clone(), Path::new("test"), &spec, &budget)
            .expect("good");
        writer.put_constant([0; 3], level, 9.0).expect("puts");
        for brick in [[0; 3], [0; 3], [(1 << level) - 1, 0, 0]] {
            let brick = brick.map(|b: u32| b.min(7));
            let varied: Vec<u8> = (0..512).map(|n| n as u8).collect();
            let twice = writer.put_brick(brick, &varied).expect_err("covered");
            assert!(twice.to_string().contains("twice"), "{twice}");
        }
        assert!(
            writer.put_constant([1, 0, 0], 1, 9.0).is_err(),
            "off its lattice"
        );
        assert!(writer.put_constant([0; 3], 40, 9.0).is_err(), "too high");
        assert!(writer.put_constant([0; 3], 0, 256.0).is_err(), "no u8");
        let info = writer.finish().expect("commits");
        let edge = 8u32 << level;
        let dense = Dense::new(spec.clone(), |p| {
            if p.iter().all(|&v| v < edge) {
                9.0
            } else {
                0.0
            }
        });
        let volume = open(storage, &budget).expect("opens");
        dense.check(&volume, spec.grid.domain);
        let covered: u64 = [75u64, 65, 9].iter().map(|&n| n.min(1 << level)).product();
        assert_eq!(info.bricks_constant, covered);
        let inside = level % 3;
        // The flat third axis cuts tiles off at 9 bricks.
        assert!(
            info.tiles <= 8u64.pow(inside.into()) * 2,
            "{} tiles at level {level}",
            info.tiles
        );
        assert_eq!(volume.blocks_decoded(), 0);
    }
}

#[test]
fn equal_bricks_join_to_a_tile_above() {
    let budget = Budget::mib(24);
    let dense = Dense::new(spec([200, 64, 64], SampleType::U16, 8), |p| {
        if p[0] < 128 { 300.0 } else { f64::from(p[1]) }
    });
    let (storage, info) = dense.write(&budget);
    assert_eq!((info.tiles, info.bricks_constant), (2, 1024));
    dense.check(
        &open(storage, &budget).expect("opens"),
        dense.spec.grid.domain,
    );
}

#[test]
fn labels_beyond_24_bits_are_exact() {
    let budget = Budget::mib(24);
    let id = 98_340_801u32;
    let mut spec = spec([40, 24, 24], SampleType::U32, 8);
    spec.kind = Kind::Label;
    let value =
        |p: [u32; 3]| f64::from(id - 1 + (p[0] / 16).min(2) + u32::from(p == [39, 0, 0]) * 5);
    let dense = Dense::new(spec, value);
    let (storage, _) = dense.write(&budget);
    let volume = open(storage, &budget).expect("opens");
    let domain = dense.spec.grid.domain;
    for label in [id - 1, id, id + 1, id + 2, id + 6, 7] {
        let field = volume.label(label);
        let mut got = vec![0.0; domain.count() as usize];
        field
            .read(domain, &mut Samples::dense(&mut got, domain))
            .expect("reads");
        let expected: Vec<f32> = dense
            .raw
            .chunks(4)
            .map(|b| f32::from(u8::from(b == label.to_le_bytes())))
            .collect();
        assert!(got == expected, "label {label}");
        let range = field.range(domain).expect("range");
        let truth = Range::of_slice(&expected);
        assert_eq!(truth.union(range), range);
        let present = truth.max == 1.0;
        assert!(
            present || label == id + 2 || range.max == 0.0,
            "label {label}"
        );
    }
    let before = volume.blocks_decoded();
    let middle = Box3 {
        min: [domain.min[0] + 16, 3, 100],
        max: [domain.min[0] + 32, 27, 124],
    };
    assert_eq!(
        volume.label(id).range(middle).expect("range"),
        Range::of(1.0)
    );
    assert_eq!(
        volume.label(id + 1).range(middle).expect("range"),
        Range::of(0.0)
    );
    assert_eq!(volume.blocks_decoded(), before);
    assert_eq!(volume.label(id).kind(), Kind::Mask);
}

#[test]
fn minus_zero_is_label_zero() {
    let budget = Budget::mib(24);
    let dense = Dense::new(spec([8, 8, 8], SampleType::F32, 8), |p| {
        if p[0] < 4 { -0.0 } else { 0.0 }
    });
    let (storage, info) = dense.write(&budget);
    assert_eq!(info.bricks_stored, 1);
    let volume = open(storage, &budget).expect("opens");
    let domain = dense.spec.grid.domain;
    dense.check(&volume, domain);
    assert_eq!(
        volume.label(0).range(domain).expect("range"),
        Range::of(1.0)
    );
    let mut got = vec![0.0; 512];
    volume
        .label(0)
        .read(domain, &mut Samples::dense(&mut got, domain))
        .expect("reads");
    assert!(got.iter().all(|&v| v == 1.0));
}

#[test]
fn wrong_calls_say_what_is_wrong() {
    let budget = Budget::mib(24);
    let dense = Dense::new(spec([40, 20, 20], SampleType::U8, 16), mixed);
    let (storage, _) = dense.write(&budget);
    let volume = open(storage.clone(), &budget).expect("opens");
    let outside = Box3::new([-8, 3, 100], [0, 4, 101]);
    assert_eq!(
        volume
            .read_raw(outside, &mut [0; 8])
            .expect_err("outside")
            .kind(),
        ErrorKind::BadInput
    );
    let inside = Box3::new([-7, 3, 100], [1, 4, 101]);
    assert!(volume.read_raw(inside, &mut [0; 7]).is_err());
    let writer = VolumeWriter::create_in(
        Arc::new(MemoryStorage::default()),
        Path::new("test"),
        &dense.spec,
        &budget,
    )
    .expect("good");
    assert!(writer.put_brick([3, 0, 0], &[0; 4096]).is_err());
    assert!(writer.put_brick([0, 0, 0], &[0; 4095]).is_err());
    let tight = Budget::bytes(1000);
    assert_eq!(
        open(storage, &tight).err().map(|e| e.kind()),
        Some(ErrorKind::BudgetExceeded)
    );
}

#[test]
fn files_appear_whole_or_not_at_all() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let path = folder.path().join("v.bvol");
    let budget = Budget::mib(24);
    let entries = || std::fs::read_dir(folder.path()).expect("lists").count();
    let dense = Dense::new(spec([40, 20, 20], SampleType::F32, 8), mixed);
    let writer = VolumeWriter::create(&path, &dense.spec, &budget).expect("creates");
    writer
        .put_brick([0; 3], &dense.brick([0; 3]))
        .expect("writes");
    assert!(!path.exists() && entries() == 1);
    drop(writer);
    assert_eq!(entries(), 0);
    let writer = VolumeWriter::create(&path, &dense.spec, &budget).expect("creates");
    let info = writer.finish().expect("commits");
    assert_eq!(
        (entries(), std::fs::metadata(&path).expect("is there").len()),
        (1, info.bytes_file)
    );
    let volume = Volume::open(&path, &budget).expect("opens");
    assert_eq!(volume.info().expect("info"), info);
    let missing = Volume::open(&folder.path().join("none"), &budget)
        .err()
        .expect("missing");
    assert_eq!(missing.kind(), ErrorKind::Io);
    let nowhere = VolumeWriter::create(&folder.path().join("no/such/v.bvol"), &dense.spec, &budget);
    assert_eq!(nowhere.err().expect("no folder").kind(), ErrorKind::Io);
}

#[test]
fn metadata_survives() {
    let budget = Budget::mib(24);
    let mut spec = spec([9, 9, 9], SampleType::I8, 8);
    spec.grid.index_to_world = Affine::from_columns(
        [[0.0, 2.0, 0.0], [-0.5, 0.0, 0.1], [0.0, 0.0, -3.0]],
        [1.0, -2.0, 5.0],
    );
    spec.grid.units = Units::Micrometre;
    (spec.kind, spec.background) = (Kind::Distance, -128.0);
    let dense = Dense::new(spec, |_| -128.0);
    let (storage, _) = dense.write(&budget);
    let volume = open(storage, &budget).expect("opens");
    assert_eq!(volume.spec(), &dense.spec);
    assert_eq!(
        (volume.kind(), volume.block_edge(), volume.grid()),
        (Kind::Distance, 8, &dense.spec.grid)
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn any_box_reads_as_the_dense_array(
        size in [1..90i32, 1..50i32, 1..50i32],
        (sample, edge) in (0..8usize, 3..7u32),
        corners in proptest::collection::vec([0.0..1.0f64, 0.0..1.0, 0.0..1.0, 0.0..1.0, 0.0..1.0, 0.0..1.0], 6),
    ) {
        let budget = Budget::mib(24).with_threads(2);
        let dense = Dense::new(spec(size, SampleType::ALL[sample], 1 << edge), mixed);
        let (storage, _) = dense.write(&budget);
        let volume = open(storage, &budget).expect("opens");
        let domain = dense.spec.grid.domain;
        for c in corners {
            let at = |t: f64, a: usize| domain.min[a] + (t * f64::from(size[a])) as i32;
            let region = Box3::new(
                std::array::from_fn(|a| at(c[a].min(c[a + 3]), a)),
                std::array::from_fn(|a| at(c[a].max(c[a + 3]), a) + 1),
            );
            dense.check(&volume, region);
        }
    }
}
