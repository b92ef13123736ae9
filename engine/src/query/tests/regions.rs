//! Bricks of a region, statistics, active cells.

use super::*;

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
