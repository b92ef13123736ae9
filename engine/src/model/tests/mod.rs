//! Suites for every kind of node: ranges hold every sample, pruned evaluation gives the same bits,
//! gradients agree with finite differences, blends are continuous, rows agree with points.

mod blends;
mod gradients;
mod listing;
mod nodes;
mod operations;
mod ranges;

use super::*;
use crate::field::{Field, Samples};
use crate::lattice::Box3;
use crate::{Inside, Units};
use nodes::nodes;

/// SplitMix64 (Steele et al. 2014).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn point(&mut self, half: f64) -> [f64; 3] {
        [0; 3].map(|_| self.within(-half, half))
    }
}

/// Random samples for each kind of node: `BRICKMARCH_MODEL_SAMPLES`, or `short` when it is not set.
fn samples_wanted(short: usize) -> usize {
    let asked = std::env::var("BRICKMARCH_MODEL_SAMPLES").ok();
    asked.map_or(short, |n| {
        n.parse().expect("BRICKMARCH_MODEL_SAMPLES is a number")
    })
}

fn shape(p: Primitive) -> Shape {
    Shape::Primitive(p)
}

fn ball(radius: f64, at: [f64; 3]) -> Shape {
    shape(Primitive::Sphere { radius }).moved(at)
}

fn formula(text: &str) -> Shape {
    shape(Primitive::Formula {
        value: Expression::parse(text, &|_| None).expect(text),
        convention: Convention::Level,
    })
}

fn block() -> Shape {
    shape(Primitive::Box {
        size: [1.2, 0.8, 1.0],
        rounding: 0.0,
    })
    .moved([0.3, -0.2, 0.1])
}

fn model(shape: &Shape, cells: f64) -> Model {
    let grid =
        Model::lattice([[-1.5; 3], [1.5; 3]], 3.0 / cells, Units::Unknown).expect("a lattice");
    Model::new(shape, grid).expect("a model")
}

#[test]
fn blocks_of_every_node_have_the_bits_of_single_points() {
    for (name, shape) in nodes() {
        let model = model(&shape, 40.0);
        let mut random = Random(3);
        for n in 0..12 {
            let low = [0; 3].map(|_| (random.next() % 30) as i32);
            let mut size = [0; 3].map(|_| 1 + (random.next() % 11) as i32);
            match n {
                // Planes and rows that are cut.
                0 => size = [23, 39, 2],
                1 => size = [1030, 2, 1],
                _ => {}
            }
            let region = Box3::new(low, [0, 1, 2].map(|a| low[a] + size[a]));
            let mut values = vec![0.0; region.count() as usize];
            model
                .read(region, &mut Samples::dense(&mut values, region))
                .expect("no data fails");
            let range = model.range(region).expect("no data fails");
            for (i, &value) in values.iter().enumerate() {
                let (nx, ny) = (size[0] as usize, size[1] as usize);
                let at = [i % nx, i / nx % ny, i / (nx * ny)];
                let p = [0, 1, 2].map(|a| model.world(a, low[a] + at[a] as i32));
                let want = model.value(p).expect("no data fails") as f32 + 0.0;
                let same = value.to_bits() == want.to_bits() || (value.is_nan() && want.is_nan());
                assert!(same, "{name}: {value} in a block, {want} alone, at {p:?}");
                // A range is asked of the domain only.
                let held = !model.grid().domain.contains_box(&region)
                    || if value.is_nan() {
                        range.has_nan
                    } else {
                        range.min <= value && value <= range.max
                    };
                assert!(held, "{name}: {value} is not in {range:?}");
            }
        }
    }
}

#[test]
fn distances_change_by_no_more_than_the_way() {
    for (name, shape) in nodes() {
        if shape.convention().expect("valid") != Convention::Distance {
            continue;
        }
        // Copies see their own cell only, and data that is converted is promised by its author.
        if name.contains("Repeat")
            || name.contains("Around")
            || name == "to distance"
            || name == "revolve"
        {
            continue;
        }
        let model = model(&shape, 64.0);
        let mut random = Random(4);
        for _ in 0..5000 {
            let p = random.point(1.5);
            let step = random.point(0.2);
            let q = [0, 1, 2].map(|a| p[a] + step[a]);
            let way = step.iter().map(|s| s * s).sum::<f64>().sqrt();
            let change = (model.value(q).expect("fine") - model.value(p).expect("fine")).abs();
            assert!(
                change <= way * (1.0 + 1e-9) + 1e-12,
                "{name}: {change} over {way} at {p:?}"
            );
        }
    }
}

#[test]
fn booleans_follow_their_truth_tables() {
    let distances = || {
        [
            ball(0.5, [0.5, 0.0, 0.0]),
            block(),
            ball(0.6, [0.0, 0.5, 0.2]),
        ]
    };
    let densities = || {
        [[0.3, 0.0, 0.0], [-0.2, 0.4, 0.0], [0.0, -0.3, 0.5]].map(|at| {
            let balls = vec![(at, 0.8, 1.0)];
            shape(Primitive::Metaballs {
                balls,
                hardness: 1.0,
            })
        })
    };
    for parts in [distances(), densities()] {
        let inside = |model: &Model, p: [f64; 3]| {
            let convention = model.convention();
            let value = model.value(p).expect("no data fails") as f32;
            convention.inside().contains(value, convention.iso())
        };
        let of = |op, parts: &[Shape]| model(&Shape::Boolean(op, parts.to_vec()), 8.0);
        let own = [0, 1, 2].map(|i| model(&parts[i], 8.0));
        let [union, common, rest] =
            [Boolean::Union, Boolean::Intersection, Boolean::Difference].map(|op| of(op, &parts));
        let outside = of(Boolean::Complement, &parts[..1]);
        let mut random = Random(6);
        let mut seen = [false; 8];
        for _ in 0..20_000 {
            let p = random.point(1.3);
            let [a, b, c] = [0, 1, 2].map(|i| inside(&own[i], p));
            seen[usize::from(a) + 2 * usize::from(b) + 4 * usize::from(c)] = true;
            assert_eq!(inside(&union, p), a || b || c);
            assert_eq!(inside(&common, p), a && b && c);
            assert_eq!(inside(&rest, p), a && !b && !c);
            assert_eq!(inside(&outside, p), !a);
        }
        assert_eq!(seen, [true; 8], "every row of the table was met");
    }
}

/// Values of a blend of two half-spaces along a line that crosses the passage.
#[test]
fn a_circular_union_of_two_planes_is_a_fillet() {
    let radius = 0.5;
    let plane = |normal| {
        shape(Primitive::HalfSpace {
            normal,
            offset: 0.0,
        })
    };
    let parts = vec![plane([1.0, 0.0, 0.0]), plane([0.0, 1.0, 0.0])];
    let of = Boolean::Union;
    let fillet = model(&Shape::Blend(Blend::Circular { of, radius }, parts), 8.0);
    for i in 0..=90 {
        let angle = f64::from(i).to_radians();
        // The circle around (r, r), on its side towards the corner.
        let p = [
            radius * (1.0 - angle.cos()),
            radius * (1.0 - angle.sin()),
            0.3,
        ];
        let value = fillet.value(p).expect("no data fails");
        assert!(value.abs() < 1e-12, "{value:e} at {i} degrees");
    }
}

#[test]
fn mixed_conventions_and_bad_numbers_are_refused_with_a_remedy() {
    let blobs = || {
        shape(Primitive::Metaballs {
            balls: vec![([0.0; 3], 1.0, 1.0)],
            hardness: 2.0,
        })
    };
    let smooth = Blend::Smooth {
        of: Boolean::Union,
        width: 0.1,
    };
    let level = || formula("x^2 - y");
    for (shape, words) in [
        (
            Shape::Boolean(Boolean::Union, vec![blobs(), block()]),
            "convert",
        ),
        (Shape::Boolean(Boolean::Union, vec![]), "at least one"),
        (
            Shape::Boolean(Boolean::Complement, vec![block(), block()]),
            "give one",
        ),
        (Shape::Blend(smooth, vec![level(), block()]), "slope"),
        (Shape::Blend(smooth, vec![blobs(), blobs()]), "slope"),
        (Shape::Blend(Blend::Sum, vec![block()]), "density"),
        (
            Shape::Blend(Blend::Ricci { power: 0.0 }, vec![blobs()]),
            "power",
        ),
        (
            Shape::Convert(Convert::Offset { by: 0.1 }, Box::new(level())),
            "slope",
        ),
        (ball(-1.0, [0.0; 3]), "above 0"),
        (ball(f64::NAN, [0.0; 3]), "usable"),
        (ball(1.0, [f64::INFINITY, 0.0, 0.0]), "usable"),
        (
            shape(Primitive::HalfSpace {
                normal: [0.0; 3],
                offset: 0.0,
            }),
            "points somewhere",
        ),
    ] {
        let error = shape.convention().expect_err(words).to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn formulas_say_where_they_are_wrong() {
    for (text, words) in [
        ("", "character 1"),
        ("x +", "character 4, found the end"),
        ("x * (y", "')'"),
        ("sin(x, y)", "1 argument of sin, not 2"),
        ("sing(x)", "none of"),
        ("2 q", "an operator"),
        ("a + 1", "'a' is not defined"),
        ("1..2", "a number"),
        ("x $ y", "found '$'"),
        ("\u{e9}", "character 1"),
    ] {
        let error = Expression::parse(text, &|_| None)
            .expect_err(text)
            .to_string();
        assert!(error.contains(words), "{text}: {error}");
    }
    let deep = "(".repeat(5000);
    assert!(Expression::parse(&deep, &|_| None).is_err());
    let value = |text: &str| Expression::parse(text, &|_| None).expect(text).constant();
    assert_eq!(value("-2^2"), Some(-4.0));
    assert_eq!(value("2^3^2"), Some(512.0));
    assert_eq!(value("2 - 3 - 4"), Some(-5.0));
    assert_eq!(value("8/4/2 + mod(-1, 3)"), Some(3.0));
    assert_eq!(value("2^-1 * 1e2"), Some(50.0));
}

#[test]
fn attributes_follow_the_winner_and_the_weights() {
    let red = ball(0.5, [-0.6, 0.0, 0.0])
        .with("red", 1.0)
        .with("heat", 10.0);
    let dark = ball(0.5, [0.6, 0.0, 0.0])
        .with("red", 0.0)
        .with("heat", 30.0);
    let parts = vec![red, dark];
    let sharp = model(&Shape::Boolean(Boolean::Union, parts.clone()), 8.0);
    let at = [[-1.1, 0.0, 0.0], [1.1, 0.0, 0.0]];
    assert_eq!(sharp.attribute("heat", &at).expect("fine"), [10.0, 30.0]);
    assert_eq!(sharp.colors(&at).expect("fine")[0], [255, 204, 204]);
    let of = Boolean::Union;
    let soft = model(&Shape::Blend(Blend::Smooth { of, width: 0.5 }, parts), 8.0);
    let heat = soft
        .attribute("heat", &[[0.0; 3], [-1.1, 0.0, 0.0]])
        .expect("fine");
    assert_eq!(heat, [20.0, 10.0]);
}

#[test]
fn a_narrow_band_is_cut_and_the_rest_constant() {
    let shape = ball(0.7, [0.0; 3]);
    let narrow = model(&shape, 60.0).narrow(0.1).expect("a distance");
    let whole = narrow.grid().domain;
    let range = narrow.range(whole).expect("fine");
    assert_eq!((range.min, range.max), (-0.1f32, 0.1f32));
    let far = narrow.range(Box3::from_size([8; 3])).expect("fine");
    assert_eq!((far.min, far.max), (0.1f32, 0.1f32));
    assert!(model(&formula("x"), 8.0).narrow(0.1).is_err());
    let level = formula("x^2 + y^2 + z^2 - 0.5");
    let field = model(&level, 60.0);
    let near = NearSurface::new(&field, 0.0, 8.0);
    let mut values = vec![0.0; 4096];
    for x in 0..3 {
        let region = Box3::new([16 * x, 16, 16], [16 * x + 16, 32, 32]);
        near.read(region, &mut Samples::dense(&mut values, region))
            .expect("fine");
        for (i, &v) in values.iter().enumerate() {
            let p = [0, 1, 2].map(|a| field.world(a, region.min[a] + (i >> (4 * a) & 15) as i32));
            let want = field.value(p).expect("fine") as f32;
            assert!(v == want || (v.abs() == 8.0 && v.signum() == want.signum()));
            assert_eq!(
                Inside::Below.contains(v, 0.0),
                Inside::Below.contains(want, 0.0)
            );
        }
    }
}
