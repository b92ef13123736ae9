//! Speed and size of the codecs, for `docs/why.md`. Not a test of behaviour beyond the round trip:
//! `cargo test --release -p brickmarch --lib measure -- --ignored --nocapture`.

use super::codec::{Choice, Encoder, decode};
use super::layout::brick_bytes;
use super::write_field::write_field;
use super::{Volume, VolumeSpec, import_stream};
use crate::field::FromFn;
use crate::iso::{Extract, extract};
use crate::mesh::Count;
use crate::{Box3, Budget, Field, Grid, Kind, Range, SampleType, Samples};
use std::collections::HashSet;
use std::f32::consts::TAU;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Instant;

const CHOICE: Choice = Choice {
    rows: true,
    fitted: true,
    binary: true,
    smallest: false,
};

fn gyroid(p: [i32; 3], period: f32) -> f32 {
    let [x, y, z] = p.map(|v| v as f32 * TAU / period);
    x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()
}

fn shared(name: &str) -> Option<Vec<u8>> {
    let data = std::env::var_os("BRICKMARCH_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    std::fs::read(data.join("volumes").join(name)).ok()
}

/// Bricks of a dense cube of samples, those of one value left out: they are not stored.
fn bricks(sample: SampleType, raw: &[u8], size: [usize; 3], edge: usize) -> Vec<Vec<u8>> {
    let w = sample.bytes();
    let counts = size.map(|n| n / edge);
    let mut all = Vec::new();
    for n in 0..counts.iter().product() {
        let b = [
            n % counts[0],
            n / counts[0] % counts[1],
            n / counts[0] / counts[1],
        ]
        .map(|v: usize| v * edge);
        let mut brick = Vec::with_capacity(edge.pow(3) * w);
        for k in 0..edge {
            for j in 0..edge {
                let at = (b[0] + size[0] * (b[1] + j + size[1] * (b[2] + k))) * w;
                brick.extend_from_slice(&raw[at..][..edge * w]);
            }
        }
        if brick.chunks(w).any(|sample| sample != &brick[..w]) {
            all.push(brick);
        }
    }
    all
}

#[test]
#[ignore = "a measurement"]
#[expect(clippy::print_stderr, reason = "a measurement")]
fn measure_codecs() {
    let n = 128usize;
    let dense = |period: f32| -> Vec<u8> {
        let points = (0..n * n * n).map(|i| [i % n, i / n % n, i / n / n].map(|v| v as i32));
        points
            .flat_map(|p| gyroid(p, period).to_le_bytes())
            .collect()
    };
    let mut inputs = vec![(
        "gyroid f32, period 128",
        SampleType::F32,
        dense(128.0),
        [n; 3],
    )];
    inputs.push((
        "gyroid f32, period 32",
        SampleType::F32,
        dense(32.0),
        [n; 3],
    ));
    // What a 1024^3 level set holds: 8 periods, half-width 3, in f32 as brickmarch-data-gen makes it;
    // and a part of a sphere of radius 409.6, in f64.
    let (sin, cos): (Vec<f32>, Vec<f32>) =
        (0..n).map(|v| (v as f32 * TAU / 128.0).sin_cos()).unzip();
    let band = |n: usize, value: &dyn Fn([usize; 3]) -> f32, width: f32| -> Vec<u8> {
        let points = (0..n * n * n).map(|i| [i % n, i / n % n, i / n / n]);
        let values = points.map(|p| value(p).clamp(-width, width));
        values.flat_map(f32::to_le_bytes).collect()
    };
    let slope = |[x, y, z]: [usize; 3]| {
        let f = (sin[x] * cos[y] + sin[y] * cos[z]) + sin[z] * cos[x];
        let gx = cos[x] * cos[y] - sin[z] * sin[x];
        let gy = cos[y] * cos[z] - sin[x] * sin[y];
        let gz = cos[z] * cos[x] - sin[y] * sin[z];
        f / (TAU / 128.0 * (gx * gx + gy * gy + gz * gz).sqrt()).max(1e-12)
    };
    let sphere = |[x, y, z]: [usize; 3]| {
        let square = |v: usize, first: f64| (v as f64 + first).powi(2);
        ((square(x, 160.5) + square(y, 96.5) + square(z, 128.5)).sqrt() - 409.6) as f32
    };
    for (name, size, value, width) in [
        (
            "level set gyroid",
            n,
            &slope as &dyn Fn([usize; 3]) -> f32,
            3.0,
        ),
        ("level set sphere", 256, &sphere, 3.0),
        ("distance to a sphere", n, &sphere, f32::MAX),
    ] {
        inputs.push((name, SampleType::F32, band(size, value, width), [size; 3]));
    }
    if let Some(bytes) = shared("tooth.raw") {
        let raw = bytes
            .as_chunks::<2>()
            .0
            .iter()
            .flat_map(|&[a, b]| [b, a])
            .collect();
        inputs.push(("tooth u16", SampleType::U16, raw, [103, 94, 161]));
    }
    if let Some(raw) = shared("ct_abdomen_crop128.raw") {
        inputs.push(("ct i16", SampleType::I16, raw, [n; 3]));
    }
    if let Some(raw) = shared("ct_abdomen_u8_crop128.raw") {
        inputs.push(("ct u8", SampleType::U8, raw, [n; 3]));
    }
    for (name, sample, raw, size) in &inputs {
        for edge in [16u32, 32] {
            let bricks = bricks(*sample, raw, *size, edge as usize);
            let bytes: usize = bricks.iter().map(Vec::len).sum();
            let mut encoder = Encoder::default();
            let mut scratch = Vec::new();
            let mut out = vec![0; brick_bytes(*sample, edge)];
            for codec in [
                None,
                Some(1),
                Some(2),
                Some(3),
                Some(4),
                Some(5),
                Some(6),
                Some(7),
                Some(8),
            ] {
                let float = *sample == SampleType::F32;
                if float && codec > Some(6) || !float && matches!(codec, Some(5 | 6)) {
                    continue;
                }
                let (mut encode_s, mut decode_s, mut stored_bytes) = (f64::MAX, f64::MAX, 0);
                let mut chosen = [0usize; 10];
                for _ in 0..3 {
                    let start = Instant::now();
                    let stored: Vec<(u8, Vec<u8>)> = bricks
                        .iter()
                        .map(|brick| {
                            let mut stored = Vec::new();
                            let used = match codec {
                                None => encoder.encode(*sample, edge, brick, CHOICE, &mut stored),
                                Some(codec) => {
                                    encoder.encode_as(codec, *sample, edge, brick, &mut stored);
                                    codec
                                }
                            };
                            if stored.len() > brick.len() {
                                (0, brick.clone())
                            } else {
                                (used, stored)
                            }
                        })
                        .collect();
                    encode_s = encode_s.min(start.elapsed().as_secs_f64());
                    let start = Instant::now();
                    for (used, stored) in &stored {
                        decode(*used, stored, *sample, edge, &mut out, &mut scratch)
                            .expect("decodes");
                    }
                    decode_s = decode_s.min(start.elapsed().as_secs_f64());
                    for (brick, (used, stored)) in bricks.iter().zip(&stored) {
                        decode(*used, stored, *sample, edge, &mut out, &mut scratch)
                            .expect("decodes");
                        assert!(out == *brick);
                        chosen[usize::from(*used)] += 1;
                    }
                    stored_bytes = stored.iter().map(|s| s.1.len()).sum();
                }
                eprintln!(
                    "{name:24} edge {edge:2} codec {:6} ratio {:5.2} encode {:5.0} MB/s decode {:5.0} MB/s {:?}",
                    codec.map_or("chosen".into(), |c: u8| c.to_string()),
                    bytes as f64 / stored_bytes as f64,
                    bytes as f64 / encode_s / 1e6,
                    bytes as f64 / decode_s / 1e6,
                    chosen.map(|c| c / 3),
                );
            }
        }
    }
}

#[test]
#[ignore = "a measurement"]
#[expect(clippy::print_stderr, reason = "a measurement")]
fn measure_files() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let out = folder.path().join("v.bvol");
    let n = std::env::var("MEASURE_N")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(512);
    let mib = std::env::var("MEASURE_MIB")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(64);
    for edge in [16, 32] {
        let spec = VolumeSpec {
            brick_edge: edge,
            ..VolumeSpec::new(Grid::new(Box3::from_size([n; 3])), SampleType::F32)
        };
        // Factors per axis, so that the function is not what is measured.
        let (sin, cos): (Vec<f32>, Vec<f32>) = (0..n)
            .map(|v| (v as f32 * TAU * 8.0 / n as f32).sin_cos())
            .unzip();
        let value = |p: [i32; 3]| {
            let [x, y, z] = p.map(|v| v as usize);
            sin[x] * cos[y] + sin[y] * cos[z] + sin[z] * cos[x]
        };
        let field = FromFn::new(spec.grid, Kind::Density, value, |_| Range::UNKNOWN);
        let budget = Budget::mib(mib);
        let start = Instant::now();
        let info = write_field(&field, &spec, &out, &budget).expect("writes");
        eprintln!(
            "gyroid {n}^3 edge {edge}: write {:.2} s, file {} B, ratio {:.2}, pages {}, peak permits {} B",
            start.elapsed().as_secs_f64(),
            info.bytes_file,
            info.compression,
            info.pages,
            budget.peak_bytes()
        );
        read_all(&out, mib, 32);
    }
    for (name, sample, size, big) in [
        ("tooth.raw", SampleType::U16, [103, 94, 161], true),
        (
            "ct_abdomen_512x512x275.raw",
            SampleType::U8,
            [512, 512, 275],
            false,
        ),
        ("ct_abdomen_crop128.raw", SampleType::I16, [128; 3], false),
    ] {
        let Some(mut raw) = shared(name) else {
            eprintln!("SKIPPED {name}: not there");
            continue;
        };
        if big {
            raw.as_chunks_mut::<2>()
                .0
                .iter_mut()
                .for_each(|b| b.reverse());
        }
        for edge in [16, 32] {
            let spec = VolumeSpec {
                brick_edge: edge,
                ..VolumeSpec::new(Grid::new(Box3::from_size(size)), sample)
            };
            let budget = Budget::mib(mib);
            let start = Instant::now();
            let info = import_stream(&mut &raw[..], &spec, &out, &budget).expect("imports");
            eprintln!(
                "{name} edge {edge}: import {:.2} s, file {} B, ratio {:.2}, bricks {} + {} constant",
                start.elapsed().as_secs_f64(),
                info.bytes_file,
                info.compression,
                info.bricks_stored,
                info.bricks_constant
            );
            read_all(&out, mib, 32);
        }
    }
}

#[expect(clippy::print_stderr, reason = "a measurement")]
fn read_all(path: &Path, mib: u64, block: i32) {
    let budget = Budget::mib(mib);
    let volume = Volume::open(path, &budget).expect("opens");
    let domain = volume.grid().domain;
    let mut values = vec![0.0; (block as usize).pow(3)];
    let start = Instant::now();
    let mut regions = Vec::new();
    for z in (0..domain.max[2]).step_by(block as usize) {
        for y in (0..domain.max[1]).step_by(block as usize) {
            for x in (0..domain.max[0]).step_by(block as usize) {
                regions.push(
                    Box3::new([x, y, z], [x + block, y + block, z + block]).intersect(&domain),
                );
            }
        }
    }
    for region in &regions {
        volume
            .read(*region, &mut Samples::dense(&mut values, *region))
            .expect("reads");
    }
    let read_s = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let mut sum = 0.0;
    for region in &regions {
        sum += volume.range(region.grow(0, 1)).expect("range").max;
    }
    let range_s = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let report = super::verify(path, &budget).expect("verifies");
    assert!(report.is_intact() && sum.is_finite());
    eprintln!(
        "    read all in {block}^3 blocks, 1 thread: {:.2} s = {:.0} Msamples/s; range {:.2} us; verify {:.2} s",
        read_s,
        domain.count() as f64 / read_s / 1e6,
        range_s * 1e6 / regions.len() as f64,
        start.elapsed().as_secs_f64()
    );
}

/// Notes which bricks are read.
struct Watched<'a> {
    volume: &'a Volume,
    edge: i32,
    bricks: Mutex<HashSet<[i32; 3]>>,
    forgets: bool,
}

impl Field for Watched<'_> {
    fn grid(&self) -> &Grid {
        self.volume.grid()
    }

    fn block_edge(&self) -> u32 {
        self.volume.block_edge()
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> crate::Result<()> {
        let first = region.min.map(|v| v / self.edge);
        let last = region.max.map(|v| (v - 1) / self.edge);
        let mut bricks = self.bricks.lock().expect("no thread panicked");
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                bricks.extend((first[0]..=last[0]).map(|x| [x, y, z]));
            }
        }
        drop(bricks);
        self.volume.read(region, out)
    }

    fn range(&self, region: Box3) -> crate::Result<Range> {
        self.volume.range(region)
    }

    fn forget(&self, region: Box3) {
        if self.forgets {
            self.volume.forget(region);
        }
    }

    fn blocks_decoded(&self) -> u64 {
        self.volume.blocks_decoded()
    }
}

/// Bricks decoded per distinct brick while a gyroid is meshed, for caches of a part of the bricks of
/// its surface. `MEASURE_N` is the edge of the volume.
#[test]
#[ignore = "a measurement"]
#[expect(clippy::print_stderr, reason = "a measurement")]
fn measure_walk() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let out = folder.path().join("v.bvol");
    let n: i32 = std::env::var("MEASURE_N")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(512);
    let spec = VolumeSpec {
        brick_edge: 16,
        ..VolumeSpec::new(Grid::new(Box3::from_size([n; 3])), SampleType::U8)
    };
    let (sin, cos): (Vec<f32>, Vec<f32>) =
        (0..n).map(|v| (v as f32 * TAU / 128.0).sin_cos()).unzip();
    let value = |p: [i32; 3]| {
        let [x, y, z] = p.map(|v| v as usize);
        128.0 + 60.0 * (sin[x] * cos[y] + sin[y] * cos[z] + sin[z] * cos[x])
    };
    let field = FromFn::new(spec.grid, Kind::Density, value, |_| Range::UNKNOWN);
    write_field(&field, &spec, &out, &Budget::mib(256)).expect("writes");
    for normals in [false, true] {
        let mut distinct = 0u64;
        for (percent, threads, forgets) in [
            (100, 1, true),
            (1, 1, false),
            (1, 1, true),
            (1, 2, false),
            (1, 2, true),
            (5, 1, false),
            (5, 1, true),
        ] {
            // The cache is 3/8 of the budget; an entry costs its brick and a little.
            let entries = if percent == 100 {
                1000
            } else {
                distinct * percent / 100
            };
            let bytes = entries * (4096 + 128) * 8 / 3;
            let budget = Budget::bytes(bytes.max(1 << 20)).with_threads(threads);
            let volume = Volume::open(&out, &budget).expect("opens");
            let watched = Watched {
                volume: &volume,
                edge: 16,
                bricks: Mutex::default(),
                forgets,
            };
            let options = Extract {
                iso: 128.0,
                normals,
                ..Extract::default()
            };
            let start = Instant::now();
            let stats = extract(
                &watched,
                &options,
                &Budget::mib(64).with_threads(threads),
                &mut Count::default(),
            )
            .expect("meshes");
            distinct = watched.bricks.lock().expect("no thread panicked").len() as u64;
            let loads = stats.blocks_decoded as f64 / distinct as f64;
            // The order of the walk and what it forgets keep this low; a smaller volume has too few
            // bricks for a share of them to hold the front.
            if n >= 1024 && !normals && percent == 1 && forgets {
                assert!(loads <= 1.25, "{loads} loads per brick");
            }
            eprintln!(
                "gyroid {n}^3 normals {normals} cache {entries} of {distinct} bricks, {threads} threads, forget {forgets}: {:.3} loads per brick, {:.2} s",
                loads,
                start.elapsed().as_secs_f64()
            );
        }
    }
}
