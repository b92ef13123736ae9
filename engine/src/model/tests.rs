//! One suite for every kind of node: ranges hold every sample, pruned evaluation gives the same
//! bits, gradients agree with finite differences, rows agree with points.

use super::*;
use crate::field::{Dense, Field, Samples};
use crate::lattice::{Affine, Box3, Grid};
use crate::{Inside, Units};
use std::sync::Arc;

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

fn outline() -> Profile {
    let outer = vec![
        [-0.9, -0.7],
        [0.8, -0.8],
        [1.0, 0.6],
        [0.0, 0.2],
        [-0.8, 0.9],
    ];
    let hole = vec![[-0.5, -0.4], [-0.1, -0.4], [-0.3, 0.0]];
    Profile::filled(&[outer, hole]).expect("an outline")
}

fn samples(size: [i32; 3], map: Affine) -> Sampled {
    let mut random = Random(5);
    let grid = Grid {
        index_to_world: map,
        ..Grid::new(Box3::from_size(size))
    };
    let values = (0..grid.domain.count())
        .map(|_| random.within(-1.0, 1.0) as f32)
        .collect();
    let dense = Dense::new(grid, values).expect("counts");
    Sampled::new(Arc::new(dense), "noise").expect("regular")
}

/// Every kind of node, by name; whether its gradient exists almost everywhere.
fn nodes() -> Vec<(String, Shape)> {
    let turned = Affine::from_columns(
        [[0.2, 0.05, 0.0], [-0.05, 0.2, 0.0], [0.0, 0.0, 0.3]],
        [-0.8, -0.9, -1.0],
    );
    let flat = Affine::from_spacing([0.4; 3], [-1.5, -1.5, 0.0]);
    let mut out: Vec<(String, Shape)> = Vec::new();
    let mut add = |name: &str, s: Shape| out.push((name.to_string(), s));
    add("sphere", ball(0.8, [0.1, 0.2, -0.1]));
    add(
        "quadratic sphere",
        shape(Primitive::QuadraticSphere { radius: 0.9 }),
    );
    add(
        "ellipsoid",
        shape(Primitive::Ellipsoid {
            radii: [1.2, 0.5, 0.8],
        }),
    );
    add("box", block());
    add(
        "rounded box",
        shape(Primitive::Box {
            size: [1.4, 1.0, 1.2],
            rounding: 0.3,
        }),
    );
    add(
        "cylinder",
        shape(Primitive::Cylinder {
            radius: 0.7,
            height: 1.3,
        }),
    );
    add(
        "capsule",
        shape(Primitive::Capsule {
            from: [-0.6, 0.1, -0.4],
            to: [0.7, -0.3, 0.5],
            radius: 0.35,
        }),
    );
    add(
        "cone",
        shape(Primitive::Cone {
            bottom: 0.9,
            top: 0.2,
            height: 1.4,
        }),
    );
    add(
        "torus",
        shape(Primitive::Torus {
            major: 0.9,
            minor: 0.3,
        }),
    );
    add(
        "half-space",
        shape(Primitive::HalfSpace {
            normal: [1.0, 2.0, -0.5],
            offset: 0.2,
        }),
    );
    add(
        "extrude",
        shape(Primitive::Extrude {
            profile: outline(),
            height: 0.9,
        }),
    );
    let stroke = Profile::stroked(&[vec![[-0.8, -0.5], [0.1, 0.6], [0.8, 0.0]]], 0.4);
    add(
        "stroke",
        shape(Primitive::Extrude {
            profile: stroke.expect("lines"),
            height: 0.7,
        }),
    );
    add("revolve", shape(Primitive::Revolve { profile: outline() }));
    for surface in Periodic::ALL {
        add(
            surface.name(),
            shape(Primitive::Periodic {
                surface,
                period: 1.7,
                thickness: 0.0,
            }),
        );
    }
    add(
        "wall",
        shape(Primitive::Periodic {
            surface: Periodic::Gyroid,
            period: 1.7,
            thickness: 0.3,
        }),
    );
    add(
        "polynomial",
        shape(Primitive::Polynomial {
            terms: vec![
                (1.0, [4, 0, 0]),
                (-2.0, [1, 2, 0]),
                (0.5, [0, 1, 5]),
                (-0.3, [0, 0, 0]),
            ],
        }),
    );
    for text in [
        "tan(0.5*x) + sinh(y) - cosh(z)/2",
        "asin(0.4*x) + acos(0.3*y*z) - 1",
        "atan(x*y) + tanh(3*z)",
        "exp(-x^2) - ln(2 + y) + z",
        "sqrt(x) + y",
        "ln(x*y) - z",
        "abs(x - y)*z - 0.1",
        "atan2(y, x) + z",
        "hypot(x, y) - hypot(y, z)/2 - 0.2",
        "(1.5 + x)^2.3 - (2 + y)^(z)",
        "x/(y + 0.3) - z",
        "x^-3 + y^7 + z^6 - 1",
        "mod(x, 0.7) - 0.3 + y*fract(z)",
        "min(x, y, z) + max(x*y, z) + square(floor(2*x))*0.01",
        "1/x + y/(z*z)",
    ] {
        add(text, formula(text));
    }
    let balls = vec![([0.4, 0.1, 0.0], 0.6, 1.0), ([-0.5, 0.0, 0.3], 0.5, 1.2)];
    let blobs = shape(Primitive::Metaballs {
        balls,
        hardness: 2.0,
    });
    add("metaballs", blobs.clone());
    let heights = samples([9, 8, 1], flat);
    add(
        "heights",
        shape(Primitive::Heights {
            heights,
            factor: 0.6,
        }),
    );
    let density = Convention::Density { iso: 0.1 };
    add(
        "samples",
        shape(Primitive::Sampled {
            samples: samples([9, 10, 8], turned),
            convention: density,
        }),
    );
    let three = || {
        vec![
            ball(0.7, [0.3, 0.0, 0.0]),
            block(),
            ball(0.5, [-0.4, 0.3, 0.2]),
        ]
    };
    let two = || vec![ball(0.7, [-0.4, 0.0, 0.0]), block()];
    for op in [Boolean::Union, Boolean::Intersection, Boolean::Difference] {
        add(&format!("{op:?}"), Shape::Boolean(op, three()));
        for blend in [
            Blend::Smooth { of: op, width: 0.4 },
            Blend::Circular {
                of: op,
                radius: 0.3,
            },
        ] {
            add(&format!("{blend:?}"), Shape::Blend(blend, three()));
        }
    }
    add(
        "complement",
        Shape::Boolean(Boolean::Complement, vec![block()]),
    );
    add(
        "difference of densities",
        Shape::Boolean(
            Boolean::Difference,
            vec![blobs.clone(), blobs.clone().moved([0.5; 3])],
        ),
    );
    add(
        "sum",
        Shape::Blend(
            Blend::Sum,
            vec![blobs.clone(), blobs.clone().moved([0.3; 3])],
        ),
    );
    for power in [3.0, -2.5] {
        add(
            "ricci",
            Shape::Blend(
                Blend::Ricci { power },
                vec![blobs.clone(), blobs.clone().moved([0.3; 3])],
            ),
        );
    }
    add(
        "contact",
        Shape::Blend(
            Blend::Contact {
                width: 0.5,
                bulge: 0.08,
                gap: 0.02,
            },
            two(),
        ),
    );
    add("weld", Shape::Blend(Blend::Weld { radius: 0.2 }, two()));
    let convert = |c, s: Shape| Shape::Convert(c, Box::new(s));
    add("to level", convert(Convert::ToLevel, blobs));
    add(
        "to distance",
        convert(Convert::ToDistance { slope: 3.0 }, formula("x^2 + y^2 - z")),
    );
    add(
        "to density",
        convert(Convert::ToDensity { reach: 0.5 }, block()),
    );
    add("offset", convert(Convert::Offset { by: 0.2 }, block()));
    add("shell", convert(Convert::Shell { thickness: 0.2 }, block()));
    for t in [
        Transform::Rotate {
            axis: [1.0, 2.0, -1.0],
            degrees: 37.0,
        },
        Transform::Scale([1.5, -0.7, 1.0]),
        Transform::Mirror { axis: 0 },
        Transform::Repeat {
            step: [0.9, 0.0, 0.8],
            count: [3, 1, 0],
        },
        Transform::Around { count: 5 },
        Transform::Twist { rate: 60.0 },
    ] {
        add(&format!("{t:?}"), Shape::Transform(t, Box::new(block())));
    }
    out
}

fn model(shape: &Shape, cells: f64) -> Model {
    let grid =
        Model::lattice([[-1.5; 3], [1.5; 3]], 3.0 / cells, Units::Unknown).expect("a lattice");
    Model::new(shape, grid).expect("a model")
}

fn ranges_hold(samples: usize) {
    let problems: Vec<String> = nodes()
        .iter()
        .filter_map(|(name, shape)| range_problem(name, shape, samples))
        .collect();
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

/// The first sample that is not in the range of its box.
fn range_problem(name: &str, shape: &Shape, samples: usize) -> Option<String> {
    let model = model(shape, 64.0);
    let mut random = Random(1);
    for _ in 0..samples.div_ceil(20) {
        let size = 10f64.powf(random.within(-4.0, 0.3));
        let low = random.point(1.5);
        let high = low.map(|c| c + size * random.within(0.1, 1.0));
        let range = model.world_range(low, high).expect("no data fails");
        for _ in 0..20 {
            let p = std::array::from_fn(|a| random.within(low[a], high[a]));
            let value = model.value(p).expect("no data fails") as f32;
            let held = if value.is_nan() {
                range.has_nan
            } else {
                range.min <= value && value <= range.max
            };
            if !held {
                return Some(format!(
                    "{name}: {value} at {p:?} is not in {range:?} of {low:?} {high:?}"
                ));
            }
        }
    }
    None
}

#[test]
fn ranges_hold_every_sample_of_every_node() {
    ranges_hold(8_000);
}

/// The same with ten million samples for each node: some minutes.
#[test]
#[ignore = "long; .ci/deep runs it"]
fn ranges_hold_ten_million_samples_of_every_node() {
    ranges_hold(10_000_000);
}

#[test]
fn gradients_agree_with_differences_of_every_node() {
    let mut problems = Vec::new();
    for (name, shape) in nodes() {
        let model = model(&shape, 64.0);
        let mut random = Random(2);
        let (mut compared, mut wrong) = (0, 0);
        for _ in 0..700 {
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
        if compared < 400 || wrong > 0 {
            problems.push(format!("{name}: {wrong} wrong of {compared}"));
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
fn blocks_of_every_node_have_the_bits_of_single_points() {
    for (name, shape) in nodes() {
        let model = model(&shape, 40.0);
        let mut random = Random(3);
        for _ in 0..12 {
            let low = [0; 3].map(|_| (random.next() % 30) as i32);
            let size = [0; 3].map(|_| 1 + (random.next() % 11) as i32);
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
                let held = if value.is_nan() {
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
fn along_passage(blend: Blend) -> Vec<f64> {
    let plane = |normal| {
        shape(Primitive::HalfSpace {
            normal,
            offset: 0.0,
        })
    };
    let shape = Shape::Blend(blend, vec![plane([1.0, 0.0, 0.0]), plane([0.0, 1.0, 0.0])]);
    let model = model(&shape, 8.0);
    (0..=2000)
        .map(|i| {
            let t = f64::from(i) / 1000.0 - 1.0;
            model
                .value([t, 0.21 - 0.4 * t, 0.0])
                .expect("no data fails")
        })
        .collect()
}

#[test]
fn blends_are_continuous_and_smooth_ones_have_no_crease() {
    for of in [Boolean::Union, Boolean::Intersection, Boolean::Difference] {
        for (blend, c1) in [
            (Blend::Smooth { of, width: 0.3 }, true),
            (Blend::Circular { of, radius: 0.3 }, true),
        ] {
            let values = along_passage(blend);
            let steps: Vec<f64> = values.windows(2).map(|w| (w[1] - w[0]) * 1000.0).collect();
            let jump = steps.iter().fold(0.0f64, |m, s| m.max(s.abs()));
            assert!(jump < 1.5, "{blend:?}: a step of slope {jump}");
            let bend = steps
                .windows(2)
                .fold(0.0f64, |m, w| m.max((w[1] - w[0]).abs()));
            // The sharp boolean bends by 1.4 in one step.
            assert!(!c1 || bend < 0.02, "{blend:?}: a crease of {bend}");
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
        let values = along_passage(blend);
        let jump = values
            .windows(2)
            .fold(0.0f64, |m, w| m.max((w[1] - w[0]).abs()));
        assert!(jump < 2e-3, "{blend:?}: a jump of {jump}");
    }
}

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
