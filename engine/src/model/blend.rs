//! Soft passages between solids.
//!
//! Those of distances keep the sum of the slopes of their operands at 1, so the result is again a
//! distance in the sense of [`Convention::Distance`].

use super::build::{Built, finite, not_negative, positive};
use super::combine::{boolean, common_convention, complement, mix_attributes};
use super::graph::{Binary, Graph, Id};
use super::shape::{Blend, Boolean, Convention};
use crate::error::{Error, Result};

/// # Errors
/// When a blend gets values of another convention than its own, or too few parts.
pub(super) fn blend(op: Blend, parts: Vec<Built>, g: &mut Graph) -> Result<Built> {
    let what = name(op);
    let convention = common_convention(what, &parts)?;
    let is_density = matches!(convention, Convention::Density { .. });
    let wants_density = matches!(op, Blend::Ricci { .. } | Blend::Sum);
    if wants_density && !is_density {
        return Err(Error::bad_input(format!(
            "{what}: blends densities, not a {}: convert a distance with convert = \"density\"",
            convention.name()
        )));
    }
    if !wants_density && convention != Convention::Distance {
        return Err(Error::bad_input(format!(
            "{what}: blends distances, not a {}: convert a level with convert = \"distance\" and its slope",
            convention.name()
        )));
    }
    match op {
        Blend::Smooth { of, width } => {
            positive("smooth: width", &[width])?;
            fold(of, parts, g, &|g, a, b| smooth(g, a, b, width))
        }
        Blend::Circular { of, radius } => {
            positive("circular: radius", &[radius])?;
            fold(of, parts, g, &|g, a, b| circular(g, a, b, radius))
        }
        Blend::Ricci { power } => ricci(parts, power, convention, g),
        Blend::Sum => Ok(weighted_sum(parts, convention, g)),
        Blend::Contact { width, bulge, gap } => contact(parts, width, bulge, gap, g),
        Blend::Weld { radius } => {
            positive("weld: radius", &[radius])?;
            weld(parts, radius, g)
        }
    }
}

fn name(op: Blend) -> &'static str {
    match op {
        Blend::Smooth { .. } => "smooth",
        Blend::Circular { .. } => "circular",
        Blend::Ricci { .. } => "ricci",
        Blend::Sum => "sum",
        Blend::Contact { .. } => "contact",
        Blend::Weld { .. } => "weld",
    }
}

/// Value and share of the second of a soft minimum.
type Soft<'a> = &'a dyn Fn(&mut Graph, Id, Id) -> (Id, Id);

/// A soft minimum as any set operation: a maximum is a minimum of the complements.
fn fold(of: Boolean, parts: Vec<Built>, g: &mut Graph, soft: Soft<'_>) -> Result<Built> {
    if of == Boolean::Complement {
        return Err(Error::bad_input(
            "a blend cannot be a complement: use union, intersection or difference",
        ));
    }
    let distance = Convention::Distance;
    let mut parts = parts.into_iter();
    let mut out = parts
        .next()
        .ok_or_else(|| Error::bad_input("blend: give at least one part"))?;
    for next in parts {
        let (a, b) = match of {
            Boolean::Intersection => (complement(out, distance, g), complement(next, distance, g)),
            Boolean::Difference => (complement(out, distance, g), next),
            Boolean::Union | Boolean::Complement => (out, next),
        };
        let (value, share) = soft(g, a.value, b.value);
        let attributes = mix_attributes(&a, &b, share, g);
        out = Built {
            value,
            convention: distance,
            attributes,
        };
        if of != Boolean::Union {
            out = complement(out, distance, g);
        }
    }
    Ok(out)
}

/// How near two values are: 1 where equal, 0 where they differ by `width` or more.
fn nearness(g: &mut Graph, a: Id, b: Id, width: f64) -> Id {
    let apart = g.sub(a, b);
    let apart = g.abs(apart);
    let apart = g.scale(apart, -1.0 / width);
    let near = g.add_value(apart, 1.0);
    g.max_value(near, 0.0)
}

/// Share of the second: 0 where the first is far smaller, 1 where the second is.
fn share(g: &mut Graph, a: Id, b: Id, width: f64) -> Id {
    let t = g.sub(a, b);
    let t = g.scale(t, 0.5 / width);
    let t = g.add_value(t, 0.5);
    let t = g.max_value(t, 0.0);
    g.min_value(t, 1.0)
}

fn smooth(g: &mut Graph, a: Id, b: Id, width: f64) -> (Id, Id) {
    let near = nearness(g, a, b, width);
    let square = g.square(near);
    let lower = g.scale(square, 0.25 * width);
    let least = g.min(a, b);
    (g.sub(least, lower), share(g, a, b, width))
}

/// Quilez' circular minimum: in the passage the level curves in the (a, b) plane are circles, which
/// touch where one value is zero and the other is `radius`.
fn circular(g: &mut Graph, a: Id, b: Id, radius: f64) -> (Id, Id) {
    let h = nearness(g, a, b, radius);
    // radius / 2 * (1 + h - sqrt(1 - h (h - 2)))
    let two = g.sub_value(h, 2.0);
    let inner = g.mul(h, two);
    let one = g.constant(1.0);
    let inner = g.sub(one, inner);
    let root = g.sqrt(inner);
    let sum = g.add_value(h, 1.0);
    let depth = g.sub(sum, root);
    let lower = g.scale(depth, 0.5 * radius);
    let least = g.min(a, b);
    (g.sub(least, lower), share(g, a, b, radius))
}

fn ricci(parts: Vec<Built>, power: f64, convention: Convention, g: &mut Graph) -> Result<Built> {
    finite("ricci: power", &[power])?;
    if power.abs() < 0.05 || power.abs() > 100.0 {
        return Err(Error::bad_input(format!(
            "ricci: power {power}: give one from 0.05 to 100, negative for an intersection"
        )));
    }
    let exponent = g.constant(power);
    let mut powers = Vec::new();
    for part in parts {
        let positive = g.max_value(part.value, 0.0);
        // Products of the value where they are few: a power of the system's library costs more than
        // all else in a row of points.
        let value = match small_whole(power) {
            Some(n) => g.power(positive, n),
            None => g.binary(Binary::Pow, positive, exponent),
        };
        powers.push(Built { value, ..part });
    }
    let mut out = weighted_sum(powers, convention, g);
    out.value = match small_whole(power) {
        Some(1) => out.value,
        Some(2) => g.sqrt(out.value),
        _ => {
            let root = g.constant(1.0 / power);
            g.binary(Binary::Pow, out.value, root)
        }
    };
    Ok(out)
}

/// The power as a count of factors, where there are few of them.
fn small_whole(power: f64) -> Option<i32> {
    let is_small = (1.0..=32.0).contains(&power) && power.fract() == 0.0;
    is_small.then_some(power as i32)
}

/// The sum; attributes weigh as much as the values do.
fn weighted_sum(parts: Vec<Built>, convention: Convention, g: &mut Graph) -> Built {
    let mut value = g.constant(0.0);
    for part in &parts {
        value = g.add(value, part.value);
    }
    let names = parts.first().map_or(0, |p| p.attributes.len());
    let attributes = (0..names)
        .map(|n| {
            let first = parts[0].attributes[n];
            if parts.iter().all(|p| p.attributes[n] == first) {
                return first;
            }
            let mut sum = g.constant(0.0);
            for part in &parts {
                let weighted = g.mul(part.value, part.attributes[n]);
                sum = g.add(sum, weighted);
            }
            let not_zero = g.max_value(value, 1e-300);
            g.div(sum, not_zero)
        })
        .collect();
    Built {
        value,
        convention,
        attributes,
    }
}

/// Two parts of `parts`.
fn two(what: &str, parts: Vec<Built>) -> Result<[Built; 2]> {
    let n = parts.len();
    <[Built; 2]>::try_from(parts)
        .map_err(|_| Error::bad_input(format!("{what}: {n} parts: give two")))
}

fn contact(parts: Vec<Built>, width: f64, bulge: f64, gap: f64, g: &mut Graph) -> Result<Built> {
    positive("contact: width", &[width])?;
    not_negative("contact: bulge, gap", &[bulge, gap])?;
    if bulge > 0.25 * width {
        return Err(Error::bad_input(format!(
            "contact: bulge {bulge} is more than a quarter of the width {width}: make it lower or wider"
        )));
    }
    let [a, b] = two("contact", parts)?;
    let deformed = |g: &mut Graph, own: Id, other: Id| {
        // Only where the solids overlap does the swelling begin: it grows with the distance from
        // the other solid and ends at `width`: 27/4 t (1 - t)^2, whose largest value is 1.
        let t = g.scale(other, 1.0 / width);
        let t = g.max_value(t, 0.0);
        let t = g.min_value(t, 1.0);
        let rest = g.constant(1.0);
        let rest = g.sub(rest, t);
        let rest = g.square(rest);
        let swell = g.mul(t, rest);
        let swell = g.scale(swell, 6.75 * bulge);
        let swollen = g.sub(own, swell);
        // The contact surface is where both distances are equal.
        let wall = g.sub(own, other);
        let wall = g.scale(wall, 0.5);
        let wall = g.add_value(wall, 0.5 * gap);
        g.max(swollen, wall)
    };
    let first = deformed(g, a.value, b.value);
    let second = deformed(g, b.value, a.value);
    // Slopes: 1 + 6.75 bulge / width at most, and 1 for the wall.
    let slope = 1.0 + 6.75 * bulge / width;
    let [first, second] = [first, second].map(|v| g.scale(v, 1.0 / slope));
    let parts = vec![Built { value: first, ..a }, Built { value: second, ..b }];
    boolean(Boolean::Union, parts, g)
}

/// The bead is a tube around the curve where both distances are zero.
fn weld(parts: Vec<Built>, radius: f64, g: &mut Graph) -> Result<Built> {
    let mut parts = parts.into_iter();
    let mut out = parts
        .next()
        .ok_or_else(|| Error::bad_input("weld: give at least two parts"))?;
    for next in parts {
        let curve = g.hypot(out.value, next.value);
        let bead = g.sub_value(curve, radius);
        // The slopes of both together can be sqrt(2).
        let bead = g.scale(bead, std::f64::consts::FRAC_1_SQRT_2);
        let both = boolean(Boolean::Union, vec![out, next], g)?;
        let value = g.min(both.value, bead);
        out = Built { value, ..both };
    }
    Ok(out)
}
