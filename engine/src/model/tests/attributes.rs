//! Attributes against what a naive reading of the definition gives: the winner of a boolean, the weights of a blend.

use super::{Random, ball, model};
use crate::model::{Blend, Boolean, Shape};

const BALLS: [(f64, [f64; 3]); 3] = [
    (0.6, [-0.3, 0.1, 0.0]),
    (0.5, [0.4, 0.0, 0.2]),
    (0.4, [0.0, -0.3, -0.4]),
];
const WEIGHTS: [&str; 3] = ["w0", "w1", "w2"];
const POINTS: usize = 20_000;

/// Three balls, each with a number of its own and a weight that the others lack.
fn parts() -> Vec<Shape> {
    let balls = BALLS.into_iter().zip(WEIGHTS).enumerate();
    balls
        .map(|(n, ((radius, at), weight))| {
            let part = ball(radius, at).with("number", n as f64);
            part.with(weight, 1.0)
        })
        .collect()
}

fn distances(p: [f32; 3]) -> [f64; 3] {
    BALLS.map(|(radius, at)| {
        let square: f64 = (0..3).map(|a| (f64::from(p[a]) - at[a]).powi(2)).sum();
        square.sqrt() - radius
    })
}

#[test]
fn the_winner_of_a_boolean_gives_its_attributes() {
    let mut random = Random(21);
    let points: Vec<[f32; 3]> = (0..POINTS)
        .map(|_| random.point(1.4).map(|v| v as f32))
        .collect();
    for of in [Boolean::Union, Boolean::Intersection, Boolean::Difference] {
        let model = model(&Shape::Boolean(of, parts()), 8.0);
        let got = model.attribute("number", &points).expect("no data fails");
        let mut seen = [0; 3];
        for (&p, got) in points.iter().zip(got) {
            let d = distances(p);
            // What decides: the largest of these wins.
            let rank = match of {
                Boolean::Union => d.map(|v| -v),
                Boolean::Intersection => d,
                _ => [d[0], -d[1], -d[2]],
            };
            let mut order = [0, 1, 2];
            order.sort_by(|&a, &b| rank[b].total_cmp(&rank[a]));
            if rank[order[0]] - rank[order[1]] < 1e-9 {
                continue;
            }
            seen[order[0]] += 1;
            assert_eq!(got, order[0] as f32, "{of:?} at {p:?}: {d:?}");
        }
        assert!(seen.iter().all(|&n| n > POINTS / 50), "{of:?}: {seen:?}");
    }
}

#[test]
fn weights_of_a_blend_sum_to_one_and_change_little_by_little() {
    let width = 0.5;
    for of in [Boolean::Union, Boolean::Intersection, Boolean::Difference] {
        let model = model(&Shape::Blend(Blend::Smooth { of, width }, parts()), 8.0);
        let mut random = Random(22);
        let from: Vec<[f64; 3]> = (0..POINTS).map(|_| random.point(1.2)).collect();
        let step = 1e-3;
        let near = |by: f64| -> Vec<[f32; 3]> {
            let moved = from.iter().map(|p| [p[0] + by, p[1], p[2]]);
            moved.map(|p| p.map(|v| v as f32)).collect()
        };
        let all = [near(0.0), near(step)].map(|points| {
            WEIGHTS.map(|name| model.attribute(name, &points).expect("no data fails"))
        });
        let mut mixed = 0;
        for n in 0..POINTS {
            let [here, there] = [0, 1].map(|side| [0, 1, 2].map(|w| all[side][w][n]));
            let sum: f32 = here.iter().sum();
            assert!((sum - 1.0).abs() < 1e-6, "{of:?}: {here:?} sum to {sum}");
            assert!(here.iter().all(|w| (0.0..=1.0).contains(w)), "{here:?}");
            mixed += usize::from(here.iter().all(|&w| w < 0.9));
            for (a, b) in here.iter().zip(there) {
                // A share has a slope of 1 / width at most, and there are two of them.
                let most = 2.0 / width * step + 1e-5;
                assert!(f64::from((a - b).abs()) <= most, "{of:?}: {a} and {b}");
            }
        }
        assert!(mixed > POINTS / 50, "{of:?}: {mixed}");
    }
}
