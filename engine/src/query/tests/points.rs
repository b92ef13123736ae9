//! Values and gradients at points and on planes.

use super::*;

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

#[test]
fn points_that_are_read_again_have_the_same_values_in_any_memory() {
    let domain = Box3::from_size([300, 200, 100]);
    let field = FromFn::new(
        Grid::new(domain),
        Kind::Density,
        |p| ((7 * p[0] + 13 * p[1] + 29 * p[2]) % 101) as f32,
        |_| Range::UNKNOWN,
    );
    let options = Sampling {
        space: Space::Index,
        outside: -1.0,
        ..Sampling::default()
    };
    for half in [false, true] {
        let mut rng = Rng(8);
        // Half of them in a single block, more than a small budget holds.
        let points: Vec<[f64; 3]> = (0..60_000)
            .map(|n| match n % 2 == 0 && half {
                true => rng.point(Box3::from_size([30; 3])),
                false => rng.point(domain),
            })
            .collect();
        assert!(are_scattered(&field, &points, Space::Index, &Budget::mib(8)).expect("asks"));
        let mut cursor = Cursor::new(&field, &Budget::mib(8)).expect("fits");
        let mut by_block: Vec<usize> = (0..points.len()).collect();
        by_block.sort_by_key(|&n| points[n].map(|v| v as u32 / 32));
        let mut expected = vec![-1.0; points.len()];
        for n in by_block {
            let found = cursor.value(points[n], Method::Trilinear).expect("reads");
            expected[n] = found.unwrap_or(-1.0);
        }
        for (mib, threads) in [(4, 1), (6, 3), (64, 2)] {
            let budget = Budget::mib(mib).with_threads(threads);
            let mut reads = 0;
            let mut out = vec![0.0; points.len()];
            let read = |take: &mut TakePoints<'_>| {
                reads += 1;
                points.chunks(1000).try_for_each(&mut *take)
            };
            sample_points_again(&field, read, &options, &mut out, &budget).expect("samples");
            assert_eq!(out, expected);
            assert_eq!(reads > 3, mib < 8, "{reads}");
            assert!(budget.peak_bytes() <= budget.memory_bytes());
            assert_eq!(budget.used_bytes(), 0);
            sample_points(&field, &points, &options, &mut out, &budget).expect("samples");
            assert_eq!(out, expected);
        }
    }
    let refused = |mut counts: Vec<usize>| {
        let read = |take: &mut TakePoints<'_>| take(&vec![[1.0; 3]; counts.remove(0)]);
        let budget = Budget::mib(8);
        sample_points_again(&field, read, &options, &mut [0.0; 5], &budget)
            .expect_err("another number of points")
            .to_string()
    };
    assert!(refused(vec![4]).contains("5 answers at 4 points"));
    assert!(refused(vec![5, 6]).contains("5 points became 6"));
}
