//! Solids that are not made from others, as operations. Distances after Quilez, "Distance
//! functions" (iquilezles.org).

use super::build::{Built, direction, finite, not_negative, positive};
use super::graph::{Graph, Id, Unary};
use super::shape::{Convention, Periodic, Primitive};
use crate::error::{Error, Result};
use std::sync::Arc;

/// Largest exponent of a polynomial term.
const MAX_EXPONENT: u16 = 64;

impl Primitive {
    pub(super) fn build(
        &self,
        graph: &mut Graph,
        point: [Id; 3],
        names: &[String],
    ) -> Result<Built> {
        let convention = self.convention();
        let value = self.value(graph, point)?;
        graph.check_size()?;
        Ok(Built::new(graph, value, convention, names))
    }

    fn convention(&self) -> Convention {
        match self {
            Primitive::QuadraticSphere { .. }
            | Primitive::Periodic { .. }
            | Primitive::Polynomial { .. }
            | Primitive::Heights { .. } => Convention::Level,
            Primitive::Metaballs { .. } => Convention::Density { iso: 1.0 },
            Primitive::Formula { convention, .. } | Primitive::Sampled { convention, .. } => {
                *convention
            }
            _ => Convention::Distance,
        }
    }

    fn value(&self, g: &mut Graph, p: [Id; 3]) -> Result<Id> {
        let [x, y, z] = p;
        Ok(match self {
            Primitive::Sphere { radius } => {
                positive("sphere: radius", &[*radius])?;
                let d = g.length(&p);
                g.sub_value(d, *radius)
            }
            Primitive::QuadraticSphere { radius } => {
                positive("sphere: radius", &[*radius])?;
                let squares = p.map(|c| g.square(c));
                let sum = g.linear(squares, [1.0; 3]);
                let d = g.sub_value(sum, radius * radius);
                g.scale(d, 0.5 / radius)
            }
            Primitive::Ellipsoid { radii } => {
                positive("ellipsoid: radii", radii)?;
                let smallest = radii.iter().copied().fold(f64::INFINITY, f64::min);
                let scaled = [0, 1, 2].map(|a| g.scale(p[a], smallest / radii[a]));
                let d = g.length(&scaled);
                g.sub_value(d, smallest)
            }
            Primitive::Box { size, rounding } => {
                positive("box: size", size)?;
                not_negative("box: rounding", &[*rounding])?;
                let least = size.iter().copied().fold(f64::INFINITY, f64::min);
                if 2.0 * rounding > least {
                    return Err(Error::bad_input(format!(
                        "box: rounding {rounding} is more than half of the shortest edge {least}: make it smaller"
                    )));
                }
                let q: [Id; 3] = std::array::from_fn(|a| {
                    let d = g.abs(p[a]);
                    g.sub_value(d, 0.5 * size[a] - rounding)
                });
                let d = corner(g, &q);
                g.sub_value(d, *rounding)
            }
            Primitive::Cylinder { radius, height } => {
                positive("cylinder: radius, height", &[*radius, *height])?;
                let rho = g.hypot(x, y);
                let side = g.sub_value(rho, *radius);
                let end = slab(g, z, *height);
                corner(g, &[side, end])
            }
            Primitive::Capsule { from, to, radius } => capsule(g, p, *from, *to, *radius)?,
            Primitive::Cone {
                bottom,
                top,
                height,
            } => {
                not_negative("cone: bottom, top", &[*bottom, *top])?;
                positive("cone: height", &[*height])?;
                positive("cone: the larger radius", &[bottom.max(*top)])?;
                // Distance from the slanted line through (bottom, -h/2) and (top, h/2).
                let slope = (top - bottom) / height;
                let cosine = 1.0 / (1.0 + slope * slope).sqrt();
                let rho = g.hypot(x, y);
                let by_height = g.scale(z, slope);
                let side = g.sub(rho, by_height);
                let side = g.sub_value(side, 0.5 * (top + bottom));
                let side = g.scale(side, cosine);
                let end = slab(g, z, *height);
                g.max(side, end)
            }
            Primitive::Torus { major, minor } => {
                positive("torus: major, minor", &[*major, *minor])?;
                let rho = g.hypot(x, y);
                let ring = g.sub_value(rho, *major);
                let d = g.hypot(ring, z);
                g.sub_value(d, *minor)
            }
            Primitive::HalfSpace { normal, offset } => {
                finite("half-space: offset", &[*offset])?;
                let n = direction("half-space: normal", *normal)?;
                let d = g.linear(p, n);
                g.sub_value(d, *offset)
            }
            Primitive::Extrude { profile, height } => {
                positive("extrude: height", &[*height])?;
                let zero = g.constant(0.0);
                let side = g.oracle(Arc::new(profile.clone()), [x, y, zero]);
                let end = slab(g, z, *height);
                corner(g, &[side, end])
            }
            Primitive::Revolve { profile } => {
                let rho = g.hypot(x, y);
                let zero = g.constant(0.0);
                g.oracle(Arc::new(profile.clone()), [rho, z, zero])
            }
            Primitive::Periodic {
                surface,
                period,
                thickness,
            } => {
                positive("periodic: period", &[*period])?;
                not_negative("periodic: thickness", &[*thickness])?;
                let value = periodic(g, p, *surface, *period);
                if *thickness > 0.0 {
                    let wall = g.abs(value);
                    g.sub_value(wall, 0.5 * thickness)
                } else {
                    value
                }
            }
            Primitive::Polynomial { terms } => polynomial(g, p, terms)?,
            Primitive::Formula { value, .. } => value.build(g, p)?,
            Primitive::Metaballs { balls, hardness } => metaballs(g, p, balls, *hardness)?,
            Primitive::Heights { heights, factor } => {
                finite("heights: factor", &[*factor])?;
                let zero = g.constant(0.0);
                let h = g.oracle(Arc::new(heights.clone()), [x, y, zero]);
                let h = g.scale(h, *factor);
                g.sub(z, h)
            }
            Primitive::Sampled {
                samples,
                convention,
            } => sampled(g, p, samples, *convention),
        })
    }
}

/// `|z| - height / 2`.
fn slab(g: &mut Graph, z: Id, height: f64) -> Id {
    let d = g.abs(z);
    g.sub_value(d, 0.5 * height)
}

/// Distance to the common part of two or three perpendicular slabs.
fn corner(g: &mut Graph, q: &[Id]) -> Id {
    let out: Vec<Id> = q.iter().map(|&d| g.max_value(d, 0.0)).collect();
    let outside = g.length(&out);
    let largest = q.iter().copied().reduce(|a, b| g.max(a, b));
    let largest = largest.unwrap_or(outside);
    let inside = g.min_value(largest, 0.0);
    g.add(outside, inside)
}

fn capsule(g: &mut Graph, p: [Id; 3], from: [f64; 3], to: [f64; 3], radius: f64) -> Result<Id> {
    finite("capsule: from, to", &[from, to].concat())?;
    positive("capsule: radius", &[radius])?;
    let way: [f64; 3] = std::array::from_fn(|a| to[a] - from[a]);
    let square: f64 = way.iter().map(|w| w * w).sum();
    let local = [0, 1, 2].map(|a| g.sub_value(p[a], from[a]));
    let rest = if square < 1e-30 {
        local
    } else {
        let t = g.linear(local, way.map(|w| w / square));
        let t = g.max_value(t, 0.0);
        let t = g.min_value(t, 1.0);
        [0, 1, 2].map(|a| {
            let along = g.scale(t, way[a]);
            g.sub(local[a], along)
        })
    };
    let d = g.length(&rest);
    Ok(g.sub_value(d, radius))
}

/// The usual approximations by sines, divided so that the slope at the surface is near 1 (von
/// Schnering and Nesper 1991).
fn periodic(g: &mut Graph, p: [Id; 3], surface: Periodic, period: f64) -> Id {
    let rate = std::f64::consts::TAU / period;
    let turn = p.map(|c| g.scale(c, rate));
    let s = turn.map(|c| g.unary(Unary::Sin, c));
    let c = turn.map(|c| g.unary(Unary::Cos, c));
    let product = |g: &mut Graph, a: Id, b: Id, c: Id| {
        let ab = g.mul(a, b);
        g.mul(ab, c)
    };
    let sum = |g: &mut Graph, t: [Id; 3]| g.linear(t, [1.0; 3]);
    let (value, slope) = match surface {
        Periodic::Gyroid => {
            let t = [0, 1, 2].map(|a| g.mul(s[a], c[(a + 1) % 3]));
            (sum(g, t), 1.5)
        }
        Periodic::SchwarzP => (sum(g, c), 1.5),
        Periodic::Diamond => {
            let a = product(g, s[0], s[1], s[2]);
            let t = [0, 1, 2].map(|a| product(g, s[a], c[(a + 1) % 3], c[(a + 2) % 3]));
            let rest = sum(g, t);
            (g.add(a, rest), 1.0)
        }
        Periodic::Neovius => {
            let first = sum(g, c);
            let first = g.scale(first, 3.0);
            let last = product(g, c[0], c[1], c[2]);
            let last = g.scale(last, 4.0);
            (g.add(first, last), 5.0)
        }
        Periodic::Iwp => {
            let t = [0, 1, 2].map(|a| g.mul(c[a], c[(a + 1) % 3]));
            let first = sum(g, t);
            let first = g.scale(first, 2.0);
            let twice = turn.map(|v| {
                let v = g.scale(v, 2.0);
                g.unary(Unary::Cos, v)
            });
            let second = sum(g, twice);
            (g.sub(first, second), 4.0)
        }
        Periodic::Lidinoid => {
            let (s2, c2) = {
                let twice = turn.map(|v| g.scale(v, 2.0));
                (
                    twice.map(|v| g.unary(Unary::Sin, v)),
                    twice.map(|v| g.unary(Unary::Cos, v)),
                )
            };
            let t = [0, 1, 2].map(|a| product(g, s2[a], c[(a + 1) % 3], s[(a + 2) % 3]));
            let first = sum(g, t);
            let t = [0, 1, 2].map(|a| g.mul(c2[a], c2[(a + 1) % 3]));
            let second = sum(g, t);
            let d = g.sub(first, second);
            let d = g.scale(d, 0.5);
            (g.add_value(d, 0.15), 1.5)
        }
    };
    g.scale(value, 1.0 / (slope * rate))
}

fn polynomial(g: &mut Graph, p: [Id; 3], terms: &[(f64, [u16; 3])]) -> Result<Id> {
    let mut sum = g.constant(0.0);
    for (coefficient, exponents) in terms {
        finite("polynomial: coefficient", &[*coefficient])?;
        if let Some(e) = exponents.iter().find(|&&e| e > MAX_EXPONENT) {
            return Err(Error::bad_input(format!(
                "polynomial: exponent {e}: give one up to {MAX_EXPONENT}"
            )));
        }
        let mut term = g.constant(*coefficient);
        for (axis, &e) in exponents.iter().enumerate() {
            let power = g.power(p[axis], i32::from(e));
            term = g.mul(term, power);
        }
        sum = g.add(sum, term);
    }
    Ok(sum)
}

/// Each ball alone has the value 1 at its radius: `w exp(h (1 - |p - c|^2 / r^2))`.
fn metaballs(
    g: &mut Graph,
    p: [Id; 3],
    balls: &[([f64; 3], f64, f64)],
    hardness: f64,
) -> Result<Id> {
    positive("metaballs: hardness", &[hardness])?;
    let mut sum = g.constant(0.0);
    for (center, radius, weight) in balls {
        finite(
            "metaballs: center, weight",
            &[&center[..], &[*weight]].concat(),
        )?;
        positive("metaballs: radius", &[*radius])?;
        let squares = [0, 1, 2].map(|a| {
            let d = g.sub_value(p[a], center[a]);
            g.square(d)
        });
        let square = g.linear(squares, [1.0; 3]);
        let power = g.scale(square, -hardness / (radius * radius));
        let power = g.add_value(power, hardness);
        let bump = g.unary(Unary::Exp, power);
        let bump = g.scale(bump, *weight);
        sum = g.add(sum, bump);
    }
    Ok(sum)
}

/// Samples inside of their box; outside of it nothing is solid.
fn sampled(
    g: &mut Graph,
    p: [Id; 3],
    samples: &super::sampled::Sampled,
    convention: Convention,
) -> Id {
    let value = g.oracle(Arc::new(samples.clone()), p);
    let index = samples.to_index(g, p);
    let (low, high) = samples.ends();
    let spacing = samples.spacing();
    let q: Vec<Id> = (0..3)
        .map(|a| {
            let middle = 0.5 * (low[a] + high[a]);
            let d = g.sub_value(index[a], middle);
            let d = g.abs(d);
            let d = g.sub_value(d, 0.5 * (high[a] - low[a]));
            g.scale(d, spacing[a])
        })
        .collect();
    let border = q.iter().copied().reduce(|a, b| g.max(a, b));
    let border = border.unwrap_or(value);
    match convention {
        Convention::Density { iso } => {
            let shown = g.constant(iso);
            let cut = g.sub(shown, border);
            g.min(value, cut)
        }
        _ => g.max(value, border),
    }
}
