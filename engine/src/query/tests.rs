//! Each question against what the samples themselves say, on a dense copy.

use super::*;
use crate::field::{Dense, Field, FromFn, Samples};
use crate::store::{Volume, VolumeSpec, write_field};
use crate::{Affine, Box3, Budget, ErrorKind, Grid, Inside, Kind, Range, SampleType};
use std::collections::BTreeSet;

const DOMAIN: Box3 = Box3::new([-5, 3, 100], [38, 37, 131]);

/// Numbers from 0 to 1.
struct Rng(u64);

impl Rng {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A point in and a little around a box; every fourth coordinate on the lattice.
    fn point(&mut self, domain: Box3) -> [f64; 3] {
        std::array::from_fn(|a| {
            let size = f64::from(domain.size()[a]) + 2.0;
            let v = f64::from(domain.min[a]) - 1.5 + self.next() * size;
            if self.next() < 0.25 { v.round() } else { v }
        })
    }
}

/// Blobs on a constant ground, so that there are tiles; rounded to whole numbers for whole types.
fn value(sample: SampleType, p: [i32; 3]) -> f32 {
    let [x, y, z] = p.map(|v| v as f32);
    let f = (x * 0.31).sin() + (y * 0.23).cos() * (z * 0.37).sin();
    let v = if f < 0.4 { 0.0 } else { f };
    match sample {
        SampleType::Bit => f32::from(u8::from(v > 0.0)),
        SampleType::F32 if p == [7, 9, 111] => f32::NAN,
        SampleType::F32 if p == [20, 20, 120] => f32::INFINITY,
        SampleType::F32 => v,
        SampleType::U8 | SampleType::U16 | SampleType::U32 => (v * 60.0).round(),
        _ => (v * 50.0 - 20.0).round(),
    }
}

fn grid() -> Grid {
    Grid {
        index_to_world: Affine::from_spacing([0.5, 2.0, 1.0], [10.0, 0.0, -3.0]),
        ..Grid::new(DOMAIN)
    }
}

/// A file of this type, and what is in it.
fn volume(sample: SampleType, edge: u32, budget: &Budget) -> (tempfile::TempDir, Volume, Dense) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("v.bvol");
    let field = FromFn::new(
        grid(),
        Kind::Density,
        |p| value(sample, p),
        |_| Range::UNKNOWN,
    );
    let spec = VolumeSpec {
        brick_edge: edge,
        ..VolumeSpec::new(grid(), sample)
    };
    write_field(&field, &spec, &path, &Budget::mib(64)).expect("writes");
    let volume = Volume::open(&path, budget).expect("opens");
    let mut values = vec![0.0; DOMAIN.count() as usize];
    field
        .read(DOMAIN, &mut Samples::dense(&mut values, DOMAIN))
        .expect("reads");
    (folder, volume, Dense::new(grid(), values).expect("counts"))
}

fn at(dense: &Dense, p: [i32; 3]) -> f32 {
    dense.values()[dense.grid().domain.offset_of(p)]
}

/// Trilinear interpolation as the definition says.
fn trilinear_of(dense: &Dense, p: [f64; 3]) -> Option<f32> {
    let domain = dense.grid().domain;
    let inside =
        |a: usize| p[a] >= f64::from(domain.min[a]) && p[a] <= f64::from(domain.max[a] - 1);
    if !(0..3).all(inside) {
        return None;
    }
    let base = p.map(|v| v.floor() as i32);
    let t: [f32; 3] = std::array::from_fn(|a| (p[a] - f64::from(base[a])) as f32);
    // Axis by axis; a neighbour is read only when it counts.
    let line = |j: i32, k: i32| {
        let a = at(dense, [base[0], base[1] + j, base[2] + k]);
        if t[0] == 0.0 {
            return a;
        }
        a + (at(dense, [base[0] + 1, base[1] + j, base[2] + k]) - a) * t[0]
    };
    let face = |k: i32| {
        let a = line(0, k);
        if t[1] == 0.0 {
            a
        } else {
            a + (line(1, k) - a) * t[1]
        }
    };
    let a = face(0);
    Some(if t[2] == 0.0 {
        a
    } else {
        a + (face(1) - a) * t[2]
    })
}

const TYPES: [(SampleType, u32); 6] = [
    (SampleType::F32, 16),
    (SampleType::U8, 8),
    (SampleType::I16, 32),
    (SampleType::U16, 64),
    (SampleType::Bit, 64),
    (SampleType::I32, 16),
];

#[test]
fn trilinear_and_nearest_values_have_the_bits_of_the_definition() {
    for (sample, edge) in TYPES {
        let budget = Budget::mib(24).with_threads(2);
        let (_folder, volume, dense) = volume(sample, edge, &budget);
        let mut rng = Rng(11);
        let points: Vec<[f64; 3]> = (0..20_000).map(|_| rng.point(DOMAIN)).collect();
        let mut inside = 0;
        for (method, field) in [
            (Method::Trilinear, &volume as &dyn Field),
            (Method::Nearest, &volume),
            (Method::Trilinear, &dense),
        ] {
            let options = Sampling {
                method,
                space: Space::Index,
                outside: -77.0,
            };
            let mut out = vec![0.0; points.len()];
            sample_points(field, &points, &options, &mut out, &budget).expect("samples");
            for (p, got) in points.iter().zip(out) {
                let expected = match method {
                    Method::Trilinear => trilinear_of(&dense, *p),
                    _ => trilinear_of(&dense, *p)
                        .map(|_| at(&dense, p.map(|v| (v + 0.5).floor() as i32))),
                };
                inside += u32::from(expected.is_some());
                let expected = expected.unwrap_or(-77.0);
                let same =
                    got.to_bits() == expected.to_bits() || (got.is_nan() && expected.is_nan());
                assert!(same, "{sample:?} {method:?} {p:?}: {got} {expected}");
            }
        }
        assert!((30_000..60_000).contains(&inside), "{inside}");
    }
}

#[test]
fn order_threads_and_cache_do_not_show() {
    let mut answers = BTreeSet::new();
    for (mib, threads) in [(16, 1), (64, 3)] {
        let budget = Budget::mib(mib).with_threads(threads);
        let (_folder, volume, _) = volume(SampleType::F32, 16, &budget);
        for sorted in [false, true] {
            let mut rng = Rng(5);
            let mut points: Vec<[f64; 3]> = (0..9000).map(|_| rng.point(DOMAIN)).collect();
            if sorted {
                points.sort_by(|a, b| a[0].total_cmp(&b[0]));
            }
            let mut out = vec![[0.0; 3]; points.len()];
            let options = Sampling {
                method: Method::Tricubic,
                space: Space::World,
                outside: 0.5,
            };
            let to_world = |p: &[f64; 3]| volume.grid().index_to_world.apply(*p);
            let world: Vec<[f64; 3]> = points.iter().map(to_world).collect();
            sample_gradients(&volume, &world, &options, &mut out, &budget).expect("samples");
            let mut all: Vec<_> = world
                .iter()
                .zip(out)
                .map(|(p, g)| (p.map(f64::to_bits), g.map(f32::to_bits)))
                .collect();
            all.sort_unstable();
            answers.insert(all);
        }
    }
    assert_eq!(answers.len(), 1);
}

#[test]
fn cubic_values_go_through_samples_and_gradients_are_slopes() {
    let budget = Budget::mib(24);
    let (_folder, volume, dense) = volume(SampleType::I16, 8, &budget);
    let mut cursor = Cursor::new(&volume, &budget).expect("fits");
    let mut rng = Rng(3);
    let mut steep = 0;
    for _ in 0..3000 {
        let p = rng.point(DOMAIN);
        let near = p.map(|v| v.round() as i32);
        if DOMAIN.contains(near) {
            let on = cursor
                .value(near.map(f64::from), Method::Tricubic)
                .expect("reads");
            assert_eq!(on, Some(at(&dense, near)));
        }
        for method in [Method::Trilinear, Method::Tricubic] {
            let Some(g) = cursor.gradient(p, method).expect("reads") else {
                assert_eq!(cursor.value(p, method).expect("reads"), None);
                continue;
            };
            // Both interpolants are smooth within a cell.
            let h = 1e-3;
            for a in 0..3 {
                let (mut low, mut high) = (p, p);
                (low[a], high[a]) = (p[a] - h, p[a] + h);
                if low[a].floor() != high[a].floor() || p[a].floor() == p[a] {
                    continue;
                }
                let [l, r] = [low, high].map(|q| cursor.value(q, method).expect("reads"));
                let (Some(l), Some(r)) = (l, r) else { continue };
                let slope = (f64::from(r) - f64::from(l)) / (2.0 * h);
                assert!(
                    (slope - f64::from(g[a])).abs() < 0.05,
                    "{method:?} {p:?} {a}: {slope} {g:?}"
                );
                steep += u32::from(slope.abs() > 1.0);
            }
        }
    }
    assert!(steep > 500, "{steep}");
}

#[test]
fn what_has_no_weight_does_not_count() {
    let domain = Box3::from_size([3, 2, 1]);
    let values = vec![1.0, f32::NAN, f32::INFINITY, 2.0, 3.0, 4.0];
    let field = Dense::new(Grid::new(domain), values).expect("counts");
    let budget = Budget::mib(8);
    let mut cursor = Cursor::new(&field, &budget).expect("fits");
    let mut value = |p| cursor.value(p, Method::Trilinear).expect("reads");
    assert_eq!(value([0.0, 0.5, 0.0]), Some(1.5));
    assert_eq!(value([0.5, 1.0, 0.0]), Some(2.5));
    assert!(value([0.5, 0.5, 0.0]).expect("inside").is_nan());
    assert_eq!(value([2.0, 0.0, 0.0]), Some(f32::INFINITY));
    assert_eq!(value([2.0, 1.0, 0.0]), Some(4.0));
    for outside in [
        [-1e-9, 0.0, 0.0],
        [2.1, 0.0, 0.0],
        [0.0, 0.0, 0.1],
        [f64::NAN, 0.0, 0.0],
    ] {
        assert_eq!(value(outside), None);
        assert!(!cursor_inside(&field, outside));
    }
    assert!(cursor_inside(&field, [0.0, 0.5, 0.0]) && !cursor_inside(&field, [0.5, 0.5, 0.0]));
}

fn cursor_inside(field: &Dense, p: [f64; 3]) -> bool {
    let mut cursor = Cursor::new(field, &Budget::mib(8)).expect("fits");
    cursor.is_inside(p, 1.0, Inside::Above).expect("reads")
}

#[test]
fn bricks_of_a_region_are_in_morton_order_and_hold_its_samples() {
    let region = Box3::new([-3, 5, 103], [30, 37, 130]);
    for (sample, edge) in TYPES {
        for threads in [1, 3] {
            let budget = Budget::mib(32).with_threads(threads);
            let (_folder, volume, dense) = volume(sample, edge, &budget);
            let mut seen = 0;
            let mut last = None;
            let mut constant = 0;
            let mut check = |brick: Brick| {
                let block = volume.block_edge();
                let place = DOMAIN.local(brick.region.min).map(|v| v / block);
                let code = crate::lattice::morton_encode(place);
                assert!(last.is_none_or(|l| l < code));
                last = Some(code);
                assert!(region.contains_box(&brick.region));
                seen += brick.region.count();
                let mut n = 0;
                for k in brick.region.min[2]..brick.region.max[2] {
                    for j in brick.region.min[1]..brick.region.max[1] {
                        for i in brick.region.min[0]..brick.region.max[0] {
                            let got = match &brick.samples {
                                BrickSamples::Constant(v) => *v,
                                BrickSamples::Dense(values) => values[n],
                            };
                            n += 1;
                            let expected = at(&dense, [i, j, k]);
                            assert!(got == expected || (got.is_nan() && expected.is_nan()));
                        }
                    }
                }
                constant += u32::from(matches!(brick.samples, BrickSamples::Constant(_)));
                Ok(())
            };
            bricks_of(&volume, region, &budget, &mut check).expect("streams");
            assert_eq!(seen, region.count());
            if edge == 8 {
                assert!(constant > 5, "{constant}");
            }
            let iterated = Bricks::new(&volume, region, &budget).expect("inside");
            let total: u64 = iterated.map(|b| b.expect("reads").region.count()).sum();
            assert_eq!(total, region.count());
        }
    }
}

#[test]
fn a_stream_waits_for_memory_stops_and_passes_errors_on() {
    let budget = Budget::mib(4).with_threads(2);
    let grid = Grid::new(Box3::from_size([256; 3]));
    let field = FromFn::new(grid, Kind::Density, |p| p[0] as f32, |_| Range::UNKNOWN);
    // A slow taker: what waits is bounded by a quarter of the budget.
    let mut taken = 0;
    bricks_of(&field, grid.domain, &budget, |_| {
        taken += 1;
        Ok(())
    })
    .expect("streams");
    assert_eq!(taken, 512);
    assert!(budget.peak_bytes() <= 3 << 20, "{}", budget.peak_bytes());
    // Bricks that are kept use the budget up; dropping some lets it go on with the same one.
    let mut bricks = Bricks::new(&field, grid.domain, &budget).expect("inside");
    let mut kept = Vec::new();
    let refused = loop {
        match bricks.next().expect("more") {
            Ok(brick) => kept.push(brick),
            Err(e) => break e,
        }
    };
    assert_eq!(
        (refused.kind(), kept.len()),
        (ErrorKind::BudgetExceeded, 32)
    );
    kept.clear();
    let next = bricks.next().expect("more").expect("room again");
    assert_eq!(next.region.min, [0, 0, 64], "the 33rd in Morton order");
    drop(bricks);
    let stopped = bricks_of(&field, grid.domain, &budget, |_| {
        budget.cancel_token().cancel();
        Ok(())
    });
    assert_eq!(stopped.expect_err("cancelled").kind(), ErrorKind::Cancelled);
    let budget = Budget::mib(4).with_threads(2);
    let failed = bricks_of(&field, grid.domain, &budget, |_| {
        Err(crate::Error::bad_input("enough"))
    });
    assert_eq!(failed.expect_err("passed on").to_string(), "enough");
    assert_eq!(budget.used_bytes(), 0);
}

#[test]
fn statistics_and_histograms_count_every_sample() {
    let region = Box3::new([-4, 3, 101], [38, 30, 131]);
    for (sample, edge) in TYPES {
        let mut answers = Vec::new();
        for threads in [1, 2, 5] {
            let budget = Budget::mib(32).with_threads(threads);
            let (_folder, volume, dense) = volume(sample, edge, &budget);
            let mut values = vec![0.0; region.count() as usize];
            dense
                .read(region, &mut Samples::dense(&mut values, region))
                .expect("reads");
            let found = statistics(&volume, region, &budget).expect("counts");
            let finite: Vec<f64> = values
                .iter()
                .filter(|v| v.is_finite())
                .map(|&v| f64::from(v))
                .collect();
            let nan = values.iter().filter(|v| v.is_nan()).count();
            let mean = finite.iter().sum::<f64>() / finite.len() as f64;
            let variance =
                finite.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / finite.len() as f64;
            assert_eq!((found.count, found.nan), (region.count(), nan as u64));
            assert_eq!(found.infinite, (values.len() - nan - finite.len()) as u64);
            assert_eq!(found.range, Range::of_slice(&values));
            assert!(
                (found.mean - mean).abs() < 1e-9
                    && (found.deviation - variance.sqrt()).abs() < 1e-9
            );

            let bins = Bins {
                low: -10.0,
                high: 30.0,
                count: 80,
            };
            let counted = histogram(&volume, region, &bins, &budget).expect("counts");
            let mut expected = [0u64; 80];
            let (mut below, mut above) = (0, 0);
            for v in values.iter().map(|&v| f64::from(v)).filter(|v| !v.is_nan()) {
                match v {
                    v if v < -10.0 => below += 1,
                    v if v > 30.0 => above += 1,
                    v => expected[(((v + 10.0) * 2.0) as usize).min(79)] += 1,
                }
            }
            assert_eq!(counted.counts, expected);
            assert_eq!(
                (counted.below, counted.above, counted.nan),
                (below, above, nan as u64)
            );
            answers.push((found.mean.to_bits(), found.deviation.to_bits()));
        }
        assert!(answers.iter().all(|a| *a == answers[0]));
    }
}

#[test]
fn active_cells_are_those_with_corners_on_both_sides() {
    let region = Box3::new([-5, 4, 100], [38, 37, 129]);
    for (sample, edge) in TYPES {
        let budget = Budget::mib(32).with_threads(2);
        let (_folder, volume, dense) = volume(sample, edge, &budget);
        for inside in [Inside::Above, Inside::Below] {
            let iso = if sample == SampleType::Bit { 0.5 } else { 1.0 };
            let mut found = Vec::new();
            let count = active_cells(&volume, region, iso, inside, &budget, |cells| {
                found.extend_from_slice(cells);
                Ok(())
            })
            .expect("finds");
            let mut expected = BTreeSet::new();
            for k in 100..128 {
                for j in 4..36 {
                    for i in -5..37 {
                        let corner =
                            |c: i32| at(&dense, [i + (c & 1), j + (c >> 1 & 1), k + (c >> 2)]);
                        let n = (0..8).filter(|&c| inside.contains(corner(c), iso)).count();
                        if n % 8 != 0 {
                            expected.insert([i, j, k]);
                        }
                    }
                }
            }
            assert_eq!(
                (count, found.len()),
                (expected.len() as u64, expected.len())
            );
            assert_eq!(found.into_iter().collect::<BTreeSet<_>>(), expected);
            assert!(expected.len() > 500);
        }
    }
}

#[test]
fn planes_hold_the_values_of_their_points() {
    let budget = Budget::mib(32).with_threads(3);
    let (_folder, volume, dense) = volume(SampleType::F32, 16, &budget);
    let plane = Plane {
        first: [-7.0, 5.0, 98.0],
        right: [0.7, 0.1, 0.05],
        down: [-0.1, 0.2, 0.6],
        size: [71, 67],
    };
    let mut out = vec![0.0; 71 * 67];
    sample_plane(&volume, &plane, Method::Trilinear, -1.0, &mut out, &budget).expect("samples");
    let mut inside = 0;
    for (n, got) in out.into_iter().enumerate() {
        let expected = trilinear_of(&dense, plane.at(n % 71, n / 71));
        inside += u32::from(expected.is_some());
        let expected = expected.unwrap_or(-1.0);
        assert!(got.to_bits() == expected.to_bits() || (got.is_nan() && expected.is_nan()));
    }
    assert!(inside > 500, "{inside}");
}

/// At a border a place may be outside by rounding.
fn held(p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|a| p[a].clamp(f64::from(DOMAIN.min[a]), f64::from(DOMAIN.max[a] - 1)))
}

fn unit(rng: &mut Rng) -> [f64; 3] {
    let d: [f64; 3] = std::array::from_fn(|_| 2.0 * rng.next() - 1.0);
    // Some along axes and in lattice planes.
    let d = if rng.next() < 0.2 {
        [d[0], 0.0, 0.0]
    } else {
        d
    };
    let length = d.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-3);
    d.map(|v| v / length)
}

#[test]
fn rays_agree_with_small_steps() {
    for (sample, edge) in [
        (SampleType::F32, 16),
        (SampleType::I16, 8),
        (SampleType::U8, 32),
    ] {
        let budget = Budget::mib(32).with_threads(2);
        let (_folder, volume, dense) = volume(sample, edge, &budget);
        let rays = Rays::new(&volume, DOMAIN, &budget).expect("prepares");
        let mut cursor = Cursor::new(&volume, &budget).expect("fits");
        let mut rng = Rng(21);
        let (mut hits, mut misses) = (0, 0);
        for _ in 0..300 {
            let (from, direction) = (rng.point(DOMAIN), unit(&mut rng));
            let origin = std::array::from_fn(|a| from[a] - 30.0 * direction[a]);
            let ray = Ray { origin, direction };
            let iso = if sample == SampleType::F32 { 0.7 } else { 11.3 };
            let step = 1.0 / 64.0;
            let values: Vec<Option<f32>> = (0..6000)
                .map(|n| trilinear_of(&dense, ray.at(f64::from(n) * step)))
                .collect();
            // A NaN or an infinity near by: what steps say is not what cells say.
            if values.iter().flatten().any(|v| !v.is_finite()) {
                continue;
            }
            let inside: Vec<(usize, f32)> = values
                .iter()
                .enumerate()
                .filter_map(|(n, v)| v.map(|v| (n, v)))
                .collect();
            let by_steps = inside
                .windows(2)
                .find(|w| (w[0].1 >= iso) != (w[1].1 >= iso));
            let found = rays
                .first_crossing(&mut cursor, &ray, iso, 0.0)
                .expect("casts");
            match (by_steps, found) {
                (None, None) => misses += 1,
                (Some(w), Some(c)) => {
                    hits += 1;
                    // Steps may pass over what is thinner than a step, never the other way.
                    assert!(c.t <= w[1].0 as f64 * step + 1e-9, "{ray:?} {c:?} {w:?}");
                    let value = trilinear_of(&dense, held(ray.at(c.t))).expect("inside");
                    assert!((value - iso).abs() < 1e-3 * iso, "{value}");
                }
                (None, Some(c)) => {
                    let value = trilinear_of(&dense, held(ray.at(c.t))).expect("inside");
                    assert!((value - iso).abs() < 1e-3 * iso, "{value}");
                }
                (Some(_), None) => panic!("missed {ray:?}"),
            }
            let best = inside
                .iter()
                .map(|&(_, v)| v)
                .fold(f32::NEG_INFINITY, f32::max);
            let peak = rays.maximum(&mut cursor, &ray).expect("casts");
            let sum = rays.integral(&mut cursor, &ray).expect("casts");
            if inside.len() > 2 {
                let peak = peak.expect("inside");
                let steepest = 4.0 * (1.0 + f64::from(best).abs());
                let over = peak.value - f64::from(best);
                assert!(
                    (-1e-3..steepest * step).contains(&over),
                    "{ray:?}: {peak:?} {best}"
                );
                let at_peak = trilinear_of(&dense, held(ray.at(peak.t))).expect("inside");
                assert!((f64::from(at_peak) - peak.value).abs() < 1e-3 * (1.0 + peak.value.abs()));
                let by_steps: f64 = inside.iter().map(|&(_, v)| f64::from(v) * step).sum();
                let highest = inside
                    .iter()
                    .map(|&(_, v)| f64::from(v).abs())
                    .fold(0.0, f64::max);
                assert!(
                    (sum.sum - by_steps).abs()
                        <= 2.0 * step * highest + 2e-3 * sum.length * (1.0 + highest),
                    "{ray:?}: {sum:?} {by_steps}"
                );
                assert!((sum.length - inside.len() as f64 * step).abs() <= 2.0 * step);
            }
        }
        assert!(hits > 80 && misses > 10, "{hits} {misses}");
    }
}

/// A ball and a shell that is 0.02 of a cell thick, whose trilinear surface is exact: distances along
/// planes are linear.
#[test]
fn no_thin_slab_is_missed() {
    let domain = Box3::from_size([130, 130, 130]);
    // 1 only on a lattice plane of a tilted ramp: |x + y - 129.49| as a tent of width 1.
    let tent = |p: [i32; 3]| 1.0 - ((p[0] + p[1]) as f32 - 129.0).abs();
    let range = move |b: Box3| {
        let (low, high) = (b.min[0] + b.min[1], b.max[0] + b.max[1] - 2);
        let mut range = Range::EMPTY;
        for s in [low, high, 129.clamp(low, high)] {
            range.add(1.0 - (s as f32 - 129.0).abs());
        }
        range
    };
    let field = FromFn::new(Grid::new(domain), Kind::Density, tent, range);
    let budget = Budget::mib(64);
    let rays = Rays::new(&field, domain, &budget).expect("prepares");
    let mut rng = Rng(77);
    let casts: Vec<Ray> = (0..20_000)
        .map(|_| {
            let start = [
                2.0 + 40.0 * rng.next(),
                2.0 + 40.0 * rng.next(),
                5.0 + 120.0 * rng.next(),
            ];
            let end = [
                88.0 + 40.0 * rng.next(),
                88.0 + 40.0 * rng.next(),
                5.0 + 120.0 * rng.next(),
            ];
            let direction = std::array::from_fn(|a| end[a] - start[a]);
            Ray {
                origin: start,
                direction,
            }
        })
        .collect();
    let mut out = vec![None; casts.len()];
    rays.cast(&casts, &mut out, &budget, |cursor, ray| {
        rays.first_crossing(cursor, ray, 0.99, 0.0)
    })
    .expect("casts");
    let mut missed = 0;
    for (ray, crossing) in casts.iter().zip(out) {
        let Some(Crossing { t, rising }) = crossing else {
            missed += 1;
            continue;
        };
        assert!(rising);
        let [x, y, _] = ray.at(t);
        // Within a cell the tent is not flat on top; its rim is where the interpolant says.
        assert!((x + y - 129.0).abs() < 1.0);
        let mut cursor = Cursor::new(&field, &budget).expect("fits");
        let value = cursor
            .value(ray.at(t), Method::Trilinear)
            .expect("reads")
            .expect("inside");
        assert!((value - 0.99).abs() < 1e-4, "{value}");
    }
    // The interpolant reaches 0.99 only near lattice points and edges of the plane: whether a ray meets
    // that is decided by steps of a thousandth.
    let mut met = 0;
    for ray in casts.iter().take(300) {
        let length = ray.direction.iter().map(|d| d * d).sum::<f64>().sqrt();
        let steps = (length * 1000.0) as usize;
        let mut cursor = Cursor::new(&field, &budget).expect("fits");
        let middle =
            (129.0 - ray.origin[0] - ray.origin[1]) / (ray.direction[0] + ray.direction[1]);
        let around = (middle * steps as f64) as usize;
        let by_steps = (around.saturating_sub(2000)..around + 2000).any(|n| {
            let p = ray.at(n as f64 / steps as f64);
            cursor
                .value(p, Method::Trilinear)
                .expect("reads")
                .is_some_and(|v| v >= 0.99)
        });
        let found = rays
            .first_crossing(&mut cursor, ray, 0.99, 0.0)
            .expect("casts")
            .is_some();
        assert!(found || !by_steps, "{ray:?}");
        met += u32::from(by_steps);
    }
    assert!(met > 0 && missed < 20_000, "{met} {missed}");
}

#[test]
fn rays_pass_through_cells_without_values_and_keep_to_their_region() {
    // x - 4.5, with a NaN at x = 5: the crossing lies in a cell that has no values.
    let domain = Box3::from_size([10, 3, 3]);
    let value = |nan: bool, p: [i32; 3]| match p[0] {
        5 if nan => f32::NAN,
        x => x as f32 - 4.5,
    };
    let budget = Budget::mib(8);
    let field = |nan: bool| {
        FromFn::new(
            Grid::new(domain),
            Kind::Density,
            move |p| value(nan, p),
            |_| Range::UNKNOWN,
        )
    };
    let ray = Ray {
        origin: [-1.0, 1.0, 1.0],
        direction: [2.0, 0.0, 0.0],
    };
    for (nan, region, crossing, length) in [
        (false, domain, Some(2.75), 4.5),
        (true, domain, None, 3.5),
        (false, Box3::new([5, 0, 0], [10, 3, 3]), None, 2.0),
        (false, Box3::new([2, 1, 1], [8, 2, 2]), Some(2.75), 2.5),
    ] {
        let field = field(nan);
        let rays = Rays::new(&field, region, &budget).expect("prepares");
        let mut cursor = Cursor::new(&field, &budget).expect("fits");
        let found = rays
            .first_crossing(&mut cursor, &ray, 0.0, 0.0)
            .expect("casts");
        let expected = crossing.map(|t| Crossing { t, rising: true });
        assert_eq!(found, expected, "{nan} {region}");
        let sum = rays.integral(&mut cursor, &ray).expect("casts");
        assert!(
            (sum.length - length).abs() < 1e-12,
            "{nan} {region}: {sum:?}"
        );
        let peak = rays
            .maximum(&mut cursor, &ray)
            .expect("casts")
            .expect("values");
        assert_eq!(peak.value, f64::from(region.max[0]) - 1.0 - 4.5);
    }
}
