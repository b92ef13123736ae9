//! `info`: what is in a volume file.

use super::{pick, short, thousands};
use crate::Outcome;
use crate::args::Info;
use crate::job::Job;
use brickmarch::budget::human_bytes;
use brickmarch::query::{self, Bins};
use brickmarch::store::{Volume, VolumeInfo};
use brickmarch::{Box3, Error, Field, Grid, Result, Units};
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
    if let Some(bins) = args.histogram {
        let part = super::region::resolve(&args.region, &spec.grid)?;
        let (more, figures) = counted(&volume, part, bins, args.window, &job)
            .map_err(|e| e.context(args.volume.display()))?;
        text += &more;
        json["samples"] = figures;
    } else if args.region.roi.is_some() || args.region.roi_world.is_some() {
        return Err(Error::bad_input("a region is for --histogram: give that too").into());
    }
    job.result(&text, &json)?;
    Ok(Outcome::Done)
}

/// Statistics and histogram of the samples of a region.
fn counted(
    volume: &Volume,
    part: Option<Box3>,
    bins: u32,
    window: Option<(f64, f64)>,
    job: &Job,
) -> Result<(String, Value)> {
    let region = part.unwrap_or(volume.grid().domain);
    let found = query::statistics(volume, region, &job.budget)?;
    let (low, high) = window.unwrap_or_else(|| {
        let ends = [found.range.min, found.range.max];
        let [low, high] = ends.map(|v| f64::from(v.clamp(f32::MIN, f32::MAX)));
        if low < high {
            (low, high)
        } else {
            (low - 0.5, low + 0.5)
        }
    });
    let bins = Bins {
        low,
        high,
        count: bins as usize,
    };
    let histogram = query::histogram(volume, region, &bins, &job.budget)?;
    let mut text = format!(
        "  region       {region}: {} samples, {} NaN, {} infinite\n  values       {} to {}, mean {}, deviation {}\n",
        thousands(found.count),
        thousands(found.nan),
        thousands(found.infinite),
        found.range.min,
        found.range.max,
        short(found.mean),
        short(found.deviation),
    );
    let most = histogram.counts.iter().copied().max().unwrap_or(0).max(1);
    let step = (high - low) / bins.count as f64;
    for (n, &count) in histogram.counts.iter().enumerate() {
        // Lengths by the logarithm: most samples of most volumes are in one bin.
        let length = (40.0 * (1.0 + count as f64).ln() / (1.0 + most as f64).ln()).round();
        let _ = writeln!(
            text,
            "  {:>12} {:>15} {}",
            short(low + n as f64 * step),
            thousands(count),
            "#".repeat(length as usize)
        );
    }
    if histogram.below + histogram.above > 0 {
        let (below, above) = (thousands(histogram.below), thousands(histogram.above));
        let _ = writeln!(text, "  below and above the window: {below} and {above}");
    }
    let json = json!({
        "region": { "min": region.min, "max": region.max },
        "count": found.count, "nan": found.nan, "infinite": found.infinite,
        "range": range_json(found.range), "mean": found.mean, "deviation": found.deviation,
        "window": [low, high], "counts": histogram.counts, "below": histogram.below,
        "above": histogram.above,
    });
    Ok((text, json))
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
