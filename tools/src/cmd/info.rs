//! `info`: what is in a volume file.

use super::{pick, short, thousands};
use crate::Outcome;
use crate::args::Info;
use crate::job::Job;
use brickmarch::budget::human_bytes;
use brickmarch::store::VolumeInfo;
use brickmarch::{Grid, Units};
use serde_json::{Value, json};
use std::fmt::Write;

pub(crate) fn run(args: &Info) -> anyhow::Result<Outcome> {
    let job = Job::new(&args.run);
    let volume = pick::named(&args.volume, args.name.as_deref(), &job.budget)?;
    let info = volume.info()?;
    let spec = volume.spec();
    let mut text = format!("{}\n", args.volume.display());
    text += &describe(&info, &spec.grid);
    let mut line = |name: &str, value: &str| {
        if !value.is_empty() {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "  {name:<12} {value}");
        }
    };
    line("background", &spec.background.to_string());
    line("name", &spec.name);
    line("history", &spec.history.replace('\n', "; "));
    if volume.names().len() > 1 {
        line("volumes", &volume.names().join(", "));
    }
    if volume.levels() > 0 {
        line("levels", &format!("{} coarser", volume.levels()));
    }
    let sealed = if info.sealed { ", sealed" } else { "" };
    line("commits", &format!("{}{sealed}", info.generation));
    if let Some(slabs) = info.unfinished_slabs {
        let all = spec.bricks()[2];
        line("unfinished", &format!("{slabs} of {all} slabs imported"));
    }
    let mut json = json!({
        "schema": 1, "command": "info", "file": args.volume, "background": spec.background,
        "name": spec.name, "history": spec.history,
    });
    json["volumes"] = json!(volume.names());
    json["levels"] = json!(volume.levels());
    json["generation"] = json!(info.generation);
    json["sealed"] = json!(info.sealed);
    json["unfinished_slabs"] = json!(info.unfinished_slabs);
    json["volume"] = figures(&info, &spec.grid);
    job.result(&text, &json)?;
    Ok(Outcome::Done)
}

/// What is known of a volume, a line each.
pub(super) fn describe(info: &VolumeInfo, grid: &Grid) -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: String| {
        let _ = writeln!(text, "  {name:<12} {value}");
    };
    let size = info.domain.size();
    let spacing = grid.index_to_world.spacing();
    let unit = unit_text(grid);
    line(
        "size",
        format!("{} x {} x {} samples", size[0], size[1], size[2]),
    );
    if info.domain.min != [0; 3] {
        line("domain", info.domain.to_string());
    }
    line(
        "samples",
        format!("{}, kind {}", info.sample.name(), info.kind.name()),
    );
    let nan = if info.range.has_nan {
        ", some are NaN"
    } else {
        ""
    };
    line(
        "range",
        format!("{} to {}{nan}", info.range.min, info.range.max),
    );
    let [dx, dy, dz] = spacing.map(short);
    line("spacing", format!("{dx} x {dy} x {dz}{unit}"));
    let map = grid.index_to_world;
    let [x, y, z] = map.apply(info.domain.min.map(f64::from)).map(short);
    line("first sample", format!("{x}, {y}, {z}{unit}"));
    let [x, y, z] = map
        .apply(info.domain.max.map(|v| f64::from(v) - 1.0))
        .map(short);
    line("last sample", format!("{x}, {y}, {z}{unit}"));
    if map.is_left_handed() {
        line(
            "handedness",
            "left: meshes are turned so that they face outward".to_string(),
        );
    }
    line(
        "bricks",
        format!(
            "{} stored of {} samples per edge, {} constant (in {} tiles), {} background",
            thousands(info.bricks_stored),
            info.brick_edge,
            thousands(info.bricks_constant),
            thousands(info.tiles),
            thousands(info.bricks_background),
        ),
    );
    line(
        "index",
        format!(
            "{} pages on {} levels",
            thousands(info.pages),
            info.page_levels
        ),
    );
    line(
        "bytes",
        format!(
            "{} in the file, {} as a plain array: {:.2} times smaller; {} dead",
            human_bytes(info.bytes_file),
            human_bytes(info.bytes_raw),
            info.compression,
            human_bytes(info.bytes_dead),
        ),
    );
    text
}

/// The same for programs.
pub(crate) fn figures(info: &VolumeInfo, grid: &Grid) -> Value {
    json!({
        "domain": { "min": info.domain.min, "max": info.domain.max },
        "size": info.domain.size(),
        "sample": info.sample.name(),
        "kind": info.kind.name(),
        "spacing": grid.index_to_world.spacing(),
        "index_to_world": grid.index_to_world.rows,
        "units": grid.units.name(),
        "range": range_json(info.range),
        "brick_edge": info.brick_edge,
        "bricks_stored": info.bricks_stored,
        "bricks_constant": info.bricks_constant,
        "bricks_background": info.bricks_background,
        "tiles": info.tiles,
        "pages": info.pages,
        "page_levels": info.page_levels,
        "bytes_raw": info.bytes_raw,
        "bytes_stored": info.bytes_stored,
        "bytes_live": info.bytes_live,
        "bytes_dead": info.bytes_dead,
        "bytes_file": info.bytes_file,
        "compression": info.compression,
    })
}

/// A range for programs; infinite ends, which JSON has no number for, are null.
pub(super) fn range_json(range: brickmarch::Range) -> Value {
    json!({ "min": range.min, "max": range.max, "has_nan": range.has_nan })
}

/// " mm", or nothing where the unit is unknown.
pub(super) fn unit_text(grid: &Grid) -> String {
    match grid.units {
        Units::Unknown => String::new(),
        unit => format!(" {}", unit.name()),
    }
}
