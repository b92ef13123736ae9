//! Placing and bending: the shape is asked at another point.

use super::build::{Built, direction, finite, positive};
use super::graph::{Binary, Graph, Id, Unary};
use super::shape::{Convention, Shape, Transform};
use crate::error::{Error, Result};

impl Transform {
    pub(super) fn build(
        &self,
        of: &Shape,
        g: &mut Graph,
        p: [Id; 3],
        names: &[String],
    ) -> Result<Built> {
        match *self {
            Transform::Move(by) => {
                finite("move", &by)?;
                let q = [0, 1, 2].map(|a| g.sub_value(p[a], by[a]));
                of.build(g, q, names)
            }
            Transform::Rotate { axis, degrees } => {
                finite("rotate: degrees", &[degrees])?;
                let axis = direction("rotate: axis", axis)?;
                let rows = rotation(axis, -degrees);
                let q = rows.map(|row| g.linear(p, row));
                of.build(g, q, names)
            }
            Transform::Scale(factors) => scale(of, factors, g, p, names),
            Transform::Mirror { axis } => {
                if axis > 2 {
                    return Err(Error::bad_input(format!(
                        "mirror: there is no axis {axis}: give 0, 1 or 2"
                    )));
                }
                let mut q = p;
                q[axis] = g.abs(p[axis]);
                of.build(g, q, names)
            }
            Transform::Repeat { step, count } => {
                let q = repeat(g, p, step, count)?;
                of.build(g, q, names)
            }
            Transform::Around { count } => {
                let q = around(g, p, count)?;
                of.build(g, q, names)
            }
            Transform::Twist { rate } => {
                finite("twist: rate", &[rate])?;
                let angle = g.scale(p[2], -rate.to_radians());
                let q = turned(g, p, angle);
                let mut built = of.build(g, q, names)?;
                if built.convention == Convention::Distance {
                    built.convention = Convention::Level;
                }
                Ok(built)
            }
        }
    }
}

/// Rows of the matrix that turns around a unit vector (Rodrigues 1840). Quarter turns are exact.
fn rotation(axis: [f64; 3], degrees: f64) -> [[f64; 3]; 3] {
    let turn = degrees.rem_euclid(360.0);
    let (s, c) = match turn {
        0.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        _ => turn.to_radians().sin_cos(),
    };
    let [x, y, z] = axis;
    let cross = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]];
    std::array::from_fn(|r| {
        std::array::from_fn(|k| {
            let same = if r == k { c } else { 0.0 };
            same + (1.0 - c) * axis[r] * axis[k] + s * cross[r][k]
        })
    })
}

fn scale(
    of: &Shape,
    factors: [f64; 3],
    g: &mut Graph,
    p: [Id; 3],
    names: &[String],
) -> Result<Built> {
    finite("scale", &factors)?;
    positive("scale, without its sign", &factors.map(f64::abs))?;
    let q = [0, 1, 2].map(|a| {
        let f = g.constant(factors[a]);
        g.div(p[a], f)
    });
    let mut built = of.build(g, q, names)?;
    if built.convention == Convention::Distance {
        // The smallest factor keeps it a lower bound.
        let least = factors.iter().fold(f64::INFINITY, |m, f| m.min(f.abs()));
        built.value = g.scale(built.value, least);
    }
    Ok(built)
}

fn repeat(g: &mut Graph, p: [Id; 3], step: [f64; 3], count: [u32; 3]) -> Result<[Id; 3]> {
    finite("repeat: step", &step)?;
    let mut q = p;
    for a in 0..3 {
        if step[a] == 0.0 {
            continue;
        }
        positive("repeat: step", &[step[a]])?;
        let cell = g.scale(p[a], 1.0 / step[a]);
        let cell = g.add_value(cell, 0.5);
        let cell = g.unary(Unary::Floor, cell);
        let cell = if count[a] > 0 {
            let cell = g.max_value(cell, 0.0);
            g.min_value(cell, f64::from(count[a] - 1))
        } else {
            cell
        };
        let by = g.scale(cell, step[a]);
        q[a] = g.sub(p[a], by);
    }
    Ok(q)
}

fn around(g: &mut Graph, p: [Id; 3], count: u32) -> Result<[Id; 3]> {
    if count == 0 {
        return Err(Error::bad_input("around: count 0: give 1 or more"));
    }
    let sector = std::f64::consts::TAU / f64::from(count);
    let angle = g.binary(Binary::Atan2, p[1], p[0]);
    let nearest = g.scale(angle, 1.0 / sector);
    let nearest = g.add_value(nearest, 0.5);
    let nearest = g.unary(Unary::Floor, nearest);
    let back = g.scale(nearest, -sector);
    Ok(turned(g, p, back))
}

/// `p` turned around z by an angle that may depend on `p`.
fn turned(g: &mut Graph, p: [Id; 3], angle: Id) -> [Id; 3] {
    let (s, c) = (g.unary(Unary::Sin, angle), g.unary(Unary::Cos, angle));
    let [xc, xs, yc, ys] = [(p[0], c), (p[0], s), (p[1], c), (p[1], s)].map(|(a, b)| g.mul(a, b));
    [g.sub(xc, ys), g.add(xs, yc), p[2]]
}
