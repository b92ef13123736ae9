//! Values at ten million points of a volume file, with a budget of 64 MiB and one thread: along a path,
//! at random in the middle 256^3, and at random in the whole.
//!
//! `BRICKMARCH_SAMPLE=a.bvol cargo bench -p brickmarch-benches -- sample`

use brickmarch::query::{Method, Sampling, Space, sample_points};
use brickmarch::store::Volume;
use brickmarch::{Box3, Budget, Field, Samples};
use std::path::Path;
use std::time::Instant;

const POINTS: usize = 10_000_000;
/// Points whose bits are compared with the definition.
const CHECKED: usize = 1_000_000;
const RUNS: usize = 3;

pub(crate) fn run() {
    let Ok(files) = std::env::var("BRICKMARCH_SAMPLE") else {
        println!("sample: name volume files in BRICKMARCH_SAMPLE");
        return;
    };
    for file in files.split(',') {
        report(Path::new(file));
    }
}

/// Numbers from 0 to 1.
struct Rng(u64);

impl Rng {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Steps of at most half a cell that turn back at the walls.
fn path(low: [f64; 3], side: f64) -> Vec<[f64; 3]> {
    let mut rng = Rng(1);
    let mut walk = [side / 2.0; 3];
    let fold = |v: f64| {
        let v = v.rem_euclid(2.0 * side);
        if v > side { 2.0 * side - v } else { v }
    };
    (0..POINTS)
        .map(|_| {
            walk = walk.map(|v| v + rng.next() - 0.5);
            std::array::from_fn(|a| low[a] + fold(walk[a]))
        })
        .collect()
}

fn random(low: [f64; 3], side: [f64; 3]) -> Vec<[f64; 3]> {
    let mut rng = Rng(2);
    (0..POINTS)
        .map(|_| std::array::from_fn(|a| low[a] + side[a] * rng.next()))
        .collect()
}

/// Trilinear interpolation as docs/conventions.md has it, corner by corner.
fn definition(values: &[f32], part: Box3, p: [f64; 3]) -> f32 {
    let base = p.map(|v| v.floor() as i32);
    let t: [f32; 3] = std::array::from_fn(|a| (p[a] - f64::from(base[a])) as f32);
    let at =
        |x: i32, y: i32, z: i32| values[part.offset_of([base[0] + x, base[1] + y, base[2] + z])];
    let mix = |t: f32, end: &dyn Fn(i32) -> f32| match t {
        0.0 => end(0),
        t => end(0) + (end(1) - end(0)) * t,
    };
    mix(t[2], &|z| mix(t[1], &|y| mix(t[0], &|x| at(x, y, z))))
}

fn report(file: &Path) {
    let budget = Budget::mib(64).with_threads(1);
    let volume = Volume::open(file, &budget).expect("opens");
    let domain = volume.grid().domain;
    let low: [i32; 3] =
        std::array::from_fn(|a| domain.min[a] + (domain.size()[a] as i32 / 2 - 128).max(0));
    let part = Box3::new(low, low.map(|v| v + 256)).intersect(&domain);
    let mut values = vec![0.0; part.count() as usize];
    volume
        .read(part, &mut Samples::dense(&mut values, part))
        .expect("reads");
    let from = low.map(f64::from);
    let side = f64::from(part.size().into_iter().min().expect("three axes")) - 1.0;
    let whole = domain.size().map(|n| f64::from(n) - 1.0);
    for (name, points, checked) in [
        ("along a path", path(from, side), true),
        ("random in 256^3", random(from, [side; 3]), true),
        ("random", random(domain.min.map(f64::from), whole), false),
    ] {
        let options = Sampling {
            method: Method::Trilinear,
            space: Space::Index,
            ..Sampling::default()
        };
        let mut out = vec![0.0; points.len()];
        let mut times: Vec<f64> = (0..RUNS)
            .map(|_| {
                let start = Instant::now();
                sample_points(&volume, &points, &options, &mut out, &budget).expect("samples");
                start.elapsed().as_secs_f64()
            })
            .collect();
        let decoded = volume.blocks_decoded();
        let wrong = points
            .iter()
            .zip(&out)
            .take(if checked { CHECKED } else { 0 })
            .filter(|(p, v)| definition(&values, part, **p).to_bits() != v.to_bits())
            .count();
        assert_eq!(wrong, 0, "{name}");
        times.sort_by(f64::total_cmp);
        println!(
            "{}: {POINTS} points {name}: {:.3} s, {:.1} M/s (median of {RUNS}); {decoded} bricks decoded up to now, \
             {} MiB under permit at most",
            file.display(),
            times[RUNS / 2],
            POINTS as f64 / times[RUNS / 2] / 1e6,
            budget.peak_bytes() >> 20,
        );
    }
}
