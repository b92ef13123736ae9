//! What a shape has become in the graph, and checks of the numbers that made it.

use super::graph::{Graph, Id};
use super::shape::Convention;
use crate::error::{Error, Result};

/// The operations that a shape ended in.
#[derive(Clone, Debug)]
pub(super) struct Built {
    pub(super) value: Id,
    pub(super) convention: Convention,
    /// One for each name.
    pub(super) attributes: Vec<Id>,
}

impl Built {
    /// A solid with default attributes: a light grey, and zero for other names.
    pub(super) fn new(
        graph: &mut Graph,
        value: Id,
        convention: Convention,
        names: &[String],
    ) -> Built {
        let attributes = names
            .iter()
            .map(|name| graph.constant(default_attribute(name)))
            .collect();
        Built {
            value,
            convention,
            attributes,
        }
    }
}

pub(super) fn default_attribute(name: &str) -> f64 {
    match name {
        "red" | "green" | "blue" => 0.8,
        _ => 0.0,
    }
}

/// # Errors
/// When a number is infinite or none.
pub(super) fn finite(what: &str, values: &[f64]) -> Result<()> {
    match values.iter().find(|v| !v.is_finite() || v.abs() > 1e30) {
        None => Ok(()),
        Some(v) => Err(Error::bad_input(format!(
            "{what}: {v} is not a usable number: give one between -1e30 and 1e30"
        ))),
    }
}

/// # Errors
/// When a number is not finite, or not above zero.
pub(super) fn positive(what: &str, values: &[f64]) -> Result<()> {
    finite(what, values)?;
    match values.iter().find(|&&v| v < 1e-30) {
        None => Ok(()),
        Some(v) => Err(Error::bad_input(format!(
            "{what}: {v} is too small: give a number above 0"
        ))),
    }
}

/// # Errors
/// When a number is not finite, or below zero.
pub(super) fn not_negative(what: &str, values: &[f64]) -> Result<()> {
    finite(what, values)?;
    match values.iter().find(|&&v| v < 0.0) {
        None => Ok(()),
        Some(v) => Err(Error::bad_input(format!(
            "{what}: {v} is negative: give 0 or more"
        ))),
    }
}

/// A direction as a unit vector.
///
/// # Errors
/// When it has no length.
pub(super) fn direction(what: &str, v: [f64; 3]) -> Result<[f64; 3]> {
    finite(what, &v)?;
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    if length < 1e-15 {
        return Err(Error::bad_input(format!(
            "{what}: a direction of length 0: give one that points somewhere, as in [0, 0, 1]"
        )));
    }
    Ok(v.map(|c| c / length))
}
