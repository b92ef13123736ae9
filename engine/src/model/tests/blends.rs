//! Blends are continuous, and smooth where they claim to be: along random ways through random
//! operands, no step changes the value, or the gradient, by more than its length allows.

use super::{Random, ball, model, samples_wanted, shape};
use crate::model::{Blend, Boolean, Convert, Primitive, Shape};

const SETS: [Boolean; 3] = [Boolean::Union, Boolean::Intersection, Boolean::Difference];

fn half_space(normal: [f64; 3], offset: f64) -> Shape {
    shape(Primitive::HalfSpace { normal, offset })
}

/// Steps of one way.
const STEPS: usize = 100;

/// Calls `each` with the ends of many steps and their length: on ways from wide to very short, so
/// that a jump shows wherever it hides.
fn walk(seed: u64, samples: usize, mut each: impl FnMut([f64; 3], [f64; 3], f64)) {
    let mut random = Random(seed);
    for _ in 0..samples.div_ceil(STEPS) {
        let length = 10f64.powf(random.within(-4.0, 0.3));
        let (from, way) = (random.point(0.8), random.point(length));
        let at = |i: usize| [0, 1, 2].map(|a| from[a] + way[a] * (i as f64 / STEPS as f64 - 0.5));
        for i in 0..STEPS {
            let (p, q) = (at(i), at(i + 1));
            let step = [0, 1, 2].map(|a| q[a] - p[a]);
            each(p, q, step.iter().map(|s| s * s).sum::<f64>().sqrt());
        }
    }
}

/// The first step that changes the value by more than `most` times its length.
fn too_steep(shape: &Shape, most: f64, samples: usize) -> Option<String> {
    let model = model(shape, 8.0);
    let value = |p| model.value(p).expect("no data fails");
    let mut found = None;
    walk(11, samples, |p, q, step| {
        let change = (value(q) - value(p)).abs();
        if change > most * step * (1.0 + 1e-9) + 1e-12 {
            found.get_or_insert_with(|| format!("{change:e} over {step:e} at {p:?}"));
        }
    });
    found
}

/// The first step that changes the gradient by more than `most` times its length.
fn too_bent(shape: &Shape, most: f64, samples: usize) -> Option<String> {
    let model = model(shape, 8.0);
    let gradient = |p| model.gradient(p).expect("no data fails");
    let mut found = None;
    walk(12, samples, |p, q, step| {
        let (a, b) = (gradient(p), gradient(q));
        let change = (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
        if change > most * step * (1.0 + 1e-9) + 1e-10 {
            found.get_or_insert_with(|| format!("{change:e} over {step:e} at {p:?}"));
        }
    });
    found
}

/// Solids that meet at many angles.
fn solids() -> Vec<Shape> {
    let block = Primitive::Box {
        size: [0.9, 0.7, 1.1],
        rounding: 0.0,
    };
    vec![
        ball(0.5, [0.2, 0.1, 0.0]),
        shape(block).moved([-0.2, 0.1, 0.0]),
        half_space([1.0, -2.0, 0.5], 0.1),
    ]
}

#[test]
fn blends_of_distances_have_slope_one_and_no_jumps() {
    let samples = samples_wanted(20_000);
    for of in SETS {
        for blend in [
            Blend::Smooth { of, width: 0.3 },
            Blend::Circular { of, radius: 0.3 },
        ] {
            let shape = Shape::Blend(blend, solids());
            assert_eq!(too_steep(&shape, 1.0, samples), None, "{blend:?}");
        }
    }
    for blend in [
        Blend::Weld { radius: 0.2 },
        Blend::Contact {
            width: 0.4,
            bulge: 0.05,
            gap: 0.0,
        },
    ] {
        let shape = Shape::Blend(blend, solids()[..2].to_vec());
        assert_eq!(too_steep(&shape, 1.0, samples), None, "{blend:?}");
    }
}

#[test]
fn blends_of_densities_have_no_jumps() {
    let samples = samples_wanted(20_000);
    let (hardness, radius) = (2.0f64, 0.5);
    let blob = |at: [f64; 3]| {
        shape(Primitive::Metaballs {
            balls: vec![(at, radius, 1.0)],
            hardness,
        })
    };
    // exp(h (1 - d^2 / r^2)) is steepest at d = r / sqrt(2 h).
    let steepest = (2.0 * hardness).sqrt() / radius * (hardness - 0.5).exp();
    for blend in [
        Blend::Sum,
        Blend::Ricci { power: 1.0 },
        Blend::Ricci { power: 2.0 },
        Blend::Ricci { power: 3.0 },
        Blend::Ricci { power: -2.5 },
    ] {
        // Every operand has a weight of at most 1.
        let shape = Shape::Blend(blend, vec![blob([0.2; 3]), blob([-0.3, 0.0, 0.1])]);
        assert_eq!(
            too_steep(&shape, 2.0 * steepest, samples),
            None,
            "{blend:?}"
        );
    }
}

#[test]
fn smooth_blends_have_no_crease() {
    let samples = samples_wanted(10_000);
    let planes = || {
        vec![
            half_space([1.0, 0.0, 0.2], 0.0),
            half_space([0.3, 1.0, 0.0], 0.1),
            half_space([-0.5, 0.4, 1.0], 0.1),
        ]
    };
    for of in SETS {
        // Second derivatives by the difference of two distances, whose slope is at most 2: 1/2w for
        // the parabola and 1/r for the circle; each of two passages adds its own.
        for (blend, most) in [
            (Blend::Smooth { of, width: 0.3 }, 2.0 * 4.0 * 0.5 / 0.3),
            (Blend::Circular { of, radius: 0.3 }, 2.0 * 4.0 / 0.3),
        ] {
            let shape = Shape::Blend(blend, planes());
            assert_eq!(too_bent(&shape, most, samples), None, "{blend:?}");
        }
    }
    let reach = 0.4;
    let plane = Box::new(planes().remove(0));
    let density = Shape::Convert(Convert::ToDensity { reach }, plane);
    assert_eq!(too_bent(&density, 1.5 / (reach * reach), samples), None);
}

#[test]
fn a_sharp_boolean_has_a_crease_that_the_suite_sees() {
    let planes = vec![
        half_space([1.0, 0.0, 0.0], 0.0),
        half_space([0.0, 1.0, 0.0], 0.0),
    ];
    let shape = Shape::Boolean(Boolean::Union, planes);
    assert!(too_bent(&shape, 50.0, 20_000).is_some());
    assert!(too_steep(&shape, 0.5, 20_000).is_some());
}
