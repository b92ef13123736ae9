//! Gradients agree with finite differences, and the slopes of a box hold those of its points.

use super::{Random, model, nodes, samples_wanted};
use crate::model::interval::Interval;
use crate::model::tape::Room;

#[test]
fn gradients_agree_with_differences_of_every_node() {
    // Thirteen values and a gradient for each point.
    let points = samples_wanted(70_000).div_ceil(100);
    let mut problems = Vec::new();
    for (name, shape) in nodes() {
        let model = model(&shape, 64.0);
        let mut random = Random(2);
        let (mut compared, mut wrong) = (0, 0);
        for _ in 0..points {
            let p = random.point(1.4);
            let value = |p| model.value(p).expect("no data fails");
            let gradient = model.gradient(p).expect("no data fails");
            let along = |a: usize, h: f64| {
                let (mut q, mut r) = (p, p);
                q[a] -= h;
                r[a] += h;
                (value(r) - value(q)) / (2.0 * h)
            };
            for a in 0..3 {
                let (wide, slim) = (along(a, 2e-5), along(a, 1e-5));
                // At a crease, or where it curves much, differences of two widths disagree.
                let sides = [1e-5, -1e-5].map(|h| {
                    let mut q = p;
                    q[a] += h;
                    (value(q) - value(p)) / h
                });
                let scale = 1.0 + slim.abs();
                let smooth = (wide - slim).abs() < 1e-6 * scale
                    && (sides[0] - sides[1]).abs() < 1e-3 * scale;
                // Beyond that differences lose their digits.
                if !slim.is_finite() || !smooth || value(p).abs() > 1e4 {
                    continue;
                }
                compared += 1;
                if (gradient[a] - slim).abs() >= 1e-4 * scale {
                    wrong += 1;
                }
            }
        }
        // Where a formula has no value nothing is compared.
        if 7 * compared < 4 * points || wrong > 0 {
            problems.push(format!("{name}: {wrong} wrong of {compared}"));
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
fn slopes_of_a_box_hold_those_of_its_points_for_every_node() {
    let boxes = samples_wanted(20_000).div_ceil(100);
    let mut problems = Vec::new();
    for (name, shape) in nodes() {
        let tape = &model(&shape, 64.0).tape;
        let mut random = Random(8);
        let mut room = Room::default();
        let mut slopes = |cube| tape.slopes(cube, &mut room).expect("no data fails");
        'boxes: for _ in 0..boxes {
            let size = 10f64.powf(random.within(-4.0, 0.0));
            let low = random.point(1.4);
            let high = low.map(|c| c + size * random.within(0.1, 1.0));
            let all = slopes([0, 1, 2].map(|a| Interval::new(low[a], high[a])));
            for _ in 0..10 {
                let p = [0, 1, 2].map(|a| random.within(low[a], high[a]));
                let one = slopes(p.map(Interval::point));
                // Where there is no value there is no slope either.
                if one.value.nan {
                    continue;
                }
                let held = (0..3).all(|a| {
                    let (d, all) = (one.d[a].middle(), all.d[a]);
                    let room = 1e-9 * (d.abs() + 1.0);
                    !d.is_finite() || (all.lo - room <= d && d <= all.hi + room)
                });
                if !held {
                    problems.push(format!(
                        "{name}: {one:?} at {p:?}: {all:?} of {low:?} {high:?}"
                    ));
                    break 'boxes;
                }
            }
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}
