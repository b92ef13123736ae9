//! `--simplify`: fewer triangles on the way to the file.

use crate::cmd::thousands;
use crate::parse;
use brickmarch::iso::Stats;
use brickmarch::mesh::{Goal, Simplification, Simplified, Simplify};
use brickmarch::{Affine, Budget, Field, MeshSink, Result};
use serde_json::{Value, json};
use std::path::Path;

/// Cells along the edge of a cube in which triangles are simplified together.
const CUBE: f64 = 30.0;

/// Where the corner of a cube is, in cells from the corner of the domain: far from the borders of
/// blocks, which are multiples of eight.
const OFFSET: f64 = 11.37;

/// Gives `make` a sink, `out` if nothing is asked for, that passes fewer triangles on to `out`.
/// Scratch files are in the folder of `beside`.
///
/// # Errors
/// What `make` and simplification report.
pub(crate) fn simplified(
    asked: Option<parse::Simplify>,
    (field, index_space): (&dyn Field, bool),
    beside: &Path,
    budget: &Budget,
    out: &mut dyn MeshSink,
    make: impl FnOnce(&mut dyn MeshSink) -> Result<Stats>,
) -> Result<(Stats, Option<Simplification>)> {
    let goal = match asked {
        None => return Ok((make(out)?, None)),
        Some(parse::Simplify::Ratio(r)) => Goal::Ratio(r),
        Some(parse::Simplify::Error(e)) => Goal::Error(e),
    };
    let grid = field.grid();
    let map = match index_space {
        true => Affine::IDENTITY,
        false => grid.index_to_world,
    };
    let options = Simplify {
        goal,
        cube: CUBE * map.spacing().into_iter().fold(0.0, f64::max),
        corner: map.apply(grid.domain.min.map(|v| f64::from(v) + OFFSET)),
    };
    let file = || brickmarch_formats::scratch_file(beside);
    let scratch = [file()?, file()?];
    let mut sink = Simplified::new(options, scratch, budget, out)?;
    let mut stats = make(&mut sink)?;
    let done = sink.result();
    (stats.vertices, stats.triangles) = (done.after.vertices, done.after.triangles);
    Ok((stats, Some(done)))
}

/// What was done, for programs and in words.
pub(crate) fn report(json: &mut Value, done: Option<&Simplification>) -> String {
    let Some(done) = done else {
        return String::new();
    };
    json["simplified"] = json!({
        "vertices_before": done.before.vertices, "triangles_before": done.before.triangles,
        "distance": done.distance, "patches_given_up": done.given_up,
    });
    let share = 100.0 * done.after.triangles as f64 / done.before.triangles.max(1) as f64;
    let given_up = match done.given_up {
        0 => String::new(),
        n => format!(", {} patches stayed as they were", thousands(n)),
    };
    format!(
        "  simplified: {share:.2} % of {} triangles, Hausdorff distance {:.3e} at most{given_up}\n",
        thousands(done.before.triangles),
        done.distance,
    )
}
