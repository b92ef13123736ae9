//! The program `brickmarch` as its users meet it.

mod ask;
mod bad_input;
mod batch;
mod check;
mod color;
mod components;
mod examples;
mod gallery;
mod labels;
mod model;
mod parts;
mod pipeline;
mod real_data;
mod serve;
mod signals;
mod slice;

use crate::support::fields::sphere;
use crate::support::scratch::{Scratch, f32_bytes};
use brickmarch::Box3;

/// A small distance field that is not a cube, as raw samples.
const DOMAIN: Box3 = Box3::from_size([30, 21, 26]);

fn samples() -> Vec<f32> {
    sphere(DOMAIN, [14.2, 10.1, 12.7], 8.3)
}

/// Scratch space with `field.raw` in it.
fn scratch_with_raw(name: &str) -> Scratch {
    let scratch = Scratch::new(name);
    scratch.write("field.raw", f32_bytes(&samples()));
    scratch
}

/// Arguments of a command line whose paths are inside the scratch directory: words that start with
/// `@` become paths.
fn words(scratch: &Scratch, line: &str) -> Vec<String> {
    let word = |w: &str| match w.strip_prefix('@') {
        Some(name) => scratch.path(name).to_string_lossy().into_owned(),
        None => w.to_string(),
    };
    line.split_whitespace().map(word).collect()
}
