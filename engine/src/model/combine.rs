//! Solids as sets: minimum and maximum, in the convention of the values; and explicit conversions
//! between conventions.

use super::build::{Built, finite, positive};
use super::graph::{Binary, Graph, Id};
use super::shape::{Boolean, Convention, Convert};
use crate::error::{Error, Result};

/// The convention of a combination.
///
/// # Errors
/// When densities are mixed with values that are negative inside, or densities of different
/// isovalues with each other.
pub(super) fn common_convention(what: &str, parts: &[Built]) -> Result<Convention> {
    let mut all = parts.iter().map(|p| p.convention);
    let first = all.next().ok_or_else(|| {
        Error::bad_input(format!(
            "{what}: nothing to combine: give at least one part"
        ))
    })?;
    all.try_fold(first, |so_far, next| match (so_far, next) {
        (Convention::Density { iso: a }, Convention::Density { iso: b }) if a == b => Ok(so_far),
        (Convention::Density { iso: a }, Convention::Density { iso: b }) => {
            Err(Error::bad_input(format!(
                "{what}: densities with isovalues {a} and {b}: convert them with convert = \"level\""
            )))
        }
        (Convention::Density { .. }, other) | (other, Convention::Density { .. }) => {
            Err(Error::bad_input(format!(
                "{what}: a density (inside is above) with a {} (inside is below): convert the density with convert = \"level\", or the distance with convert = \"density\"",
                other.name()
            )))
        }
        (Convention::Distance, Convention::Distance) => Ok(Convention::Distance),
        _ => Ok(Convention::Level),
    })
}

/// # Errors
/// When parts cannot be combined, or their number is wrong.
pub(super) fn boolean(op: Boolean, parts: Vec<Built>, g: &mut Graph) -> Result<Built> {
    let what = name(op);
    let convention = common_convention(what, &parts)?;
    if op == Boolean::Complement && parts.len() != 1 {
        return Err(Error::bad_input(format!(
            "complement: {} parts: give one",
            parts.len()
        )));
    }
    let mut parts = parts.into_iter();
    let first = parts
        .next()
        .ok_or_else(|| Error::bad_input(format!("{what}: give at least one part")))?;
    let first = match op {
        Boolean::Complement => complement(first, convention, g),
        _ => first,
    };
    let mut out = parts.fold(first, |a, b| match op {
        Boolean::Union => pick(a, b, true, convention, g),
        Boolean::Intersection => pick(a, b, false, convention, g),
        Boolean::Difference | Boolean::Complement => {
            let b = complement(b, convention, g);
            pick(a, b, false, convention, g)
        }
    });
    out.convention = convention;
    Ok(out)
}

pub(super) fn name(op: Boolean) -> &'static str {
    match op {
        Boolean::Complement => "complement",
        Boolean::Union => "union",
        Boolean::Intersection => "intersection",
        Boolean::Difference => "difference",
    }
}

/// What is inside becomes outside. Its attributes stay: they colour the cut.
pub(super) fn complement(mut part: Built, convention: Convention, g: &mut Graph) -> Built {
    part.value = match convention {
        Convention::Density { iso } => {
            let twice = g.constant(2.0 * iso);
            g.sub(twice, part.value)
        }
        _ => g.neg(part.value),
    };
    part
}

/// The smaller or larger value, with the attributes of the one that won. The first wins a tie.
fn pick(a: Built, b: Built, union: bool, convention: Convention, g: &mut Graph) -> Built {
    let lower = union != matches!(convention, Convention::Density { .. });
    let (value, second) = if lower {
        (
            g.min(a.value, b.value),
            g.binary(Binary::Less, b.value, a.value),
        )
    } else {
        (
            g.max(a.value, b.value),
            g.binary(Binary::Less, a.value, b.value),
        )
    };
    Built {
        value,
        convention,
        attributes: mix_attributes(&a, &b, second, g),
    }
}

/// Attributes of `a` where `t` is 0, of `b` where it is 1.
pub(super) fn mix_attributes(a: &Built, b: &Built, t: Id, g: &mut Graph) -> Vec<Id> {
    let pairs = a.attributes.iter().zip(&b.attributes);
    pairs.map(|(&a, &b)| g.mix(a, b, t)).collect()
}

/// # Errors
/// When the part has another convention than the conversion takes.
pub(super) fn convert(op: Convert, mut part: Built, g: &mut Graph) -> Result<Built> {
    let wrong = |takes: &str, remedy: &str| {
        Error::bad_input(format!(
            "this conversion takes a {takes}, not a {}: {remedy}",
            part.convention.name()
        ))
    };
    match (op, part.convention) {
        (Convert::ToLevel, Convention::Density { iso }) => {
            let iso = g.constant(iso);
            part.value = g.sub(iso, part.value);
            part.convention = Convention::Level;
        }
        (Convert::ToLevel, _) => part.convention = Convention::Level,
        (Convert::ToDistance { slope }, Convention::Level) => {
            positive("slope", &[slope])?;
            part.value = g.scale(part.value, 1.0 / slope);
            part.convention = Convention::Distance;
        }
        (Convert::ToDistance { .. }, _) => {
            return Err(wrong(
                "level",
                "leave the conversion out of a distance; a density needs convert = \"level\" first",
            ));
        }
        (Convert::ToDensity { reach }, Convention::Distance) => {
            positive("reach", &[reach])?;
            let t = g.scale(part.value, -0.5 / reach);
            let t = g.add_value(t, 0.5);
            let t = g.max_value(t, 0.0);
            let t = g.min_value(t, 1.0);
            let square = g.square(t);
            let rest = g.scale(t, -2.0);
            let rest = g.add_value(rest, 3.0);
            part.value = g.mul(square, rest);
            part.convention = Convention::Density { iso: 0.5 };
        }
        (Convert::Offset { by }, Convention::Distance) => {
            finite("offset", &[by])?;
            part.value = g.sub_value(part.value, by);
        }
        (Convert::Shell { thickness }, Convention::Distance) => {
            positive("shell", &[thickness])?;
            let wall = g.abs(part.value);
            part.value = g.sub_value(wall, 0.5 * thickness);
        }
        _ => {
            return Err(wrong(
                "distance",
                "put convert = \"distance\" with the slope of the values before it",
            ));
        }
    }
    Ok(part)
}
