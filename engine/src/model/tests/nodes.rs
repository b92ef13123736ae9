//! Every kind of node, for the suites that ask all of them.

use super::{Random, ball, block, formula, shape};
use crate::field::Dense;
use crate::lattice::{Affine, Box3, Grid};
use crate::model::*;
use std::sync::Arc;

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

/// Every kind of node, by name.
pub(super) fn nodes() -> Vec<(String, Shape)> {
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
    for power in [1.0, 2.0, 3.0, 7.0, 2.5, -2.5] {
        add(
            &format!("ricci {power}"),
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
