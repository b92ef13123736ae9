//! Rays against small steps along them.

use super::*;

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
