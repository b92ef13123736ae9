//! `check`: is a mesh closed, 2-manifold and oriented, and what does it measure?

use super::{named, thousands};
use crate::Outcome;
use crate::args::Check;
use crate::job::Job;
use crate::shapes::{shapes_json, spread};
use brickmarch::mesh::{Examined, Report, SLIVER_DEG, check, crossings, examine, shapes};
use brickmarch::{Budget, ErrorKind, Result};
use brickmarch_formats as formats;
use serde_json::{Value, json};
use std::fmt::Write;

pub(crate) fn run(args: &Check) -> anyhow::Result<Outcome> {
    let job = Job::with_budget(Budget::bytes(args.mem), &args.say);
    let (found, in_parts) = {
        let _watch = job.watch("checking");
        look(args, &job.budget).map_err(named(&[&args.mesh]))?
    };
    let report = &found.report;
    let sound = is_sound(report, args.open_ok);
    let mut json = json!({
        "schema": 1, "command": "check", "mesh": args.mesh, "sound": sound,
        "seconds": job.seconds(), "peak_rss_bytes": crate::system::peak_resident_bytes(),
    });
    json["in_parts"] = json!(in_parts);
    json["report"] = figures(report);
    json["shapes"] = shapes_json(&found.shapes);
    json["crossings"] = found.crossings.map_or(Value::Null, |c| {
        json!({
            "crossing_pairs": c.crossing_pairs, "overlapping_pairs": c.overlapping_pairs,
            "checked_triangles": c.checked_triangles,
        })
    });
    let text = format!(
        "{}\n{}{}",
        args.mesh.display(),
        describe(report),
        describe_triangles(&found)
    );
    job.result(&text, &json)?;
    if sound {
        return Ok(Outcome::Done);
    }
    job.note(&format!(
        "{}: {}",
        args.mesh.display(),
        faults(report, args.open_ok)
    ));
    Ok(Outcome::NotWhatWasAsked)
}

/// Everything about the mesh, and whether it was read in parts because it does not fit.
fn look(args: &Check, budget: &Budget) -> Result<(Examined, bool)> {
    let whole = || -> Result<Examined> {
        let mesh = formats::read_mesh(&args.mesh, budget)?;
        let report = check(&mesh, budget)?;
        let shapes = shapes(&mesh, budget)?;
        let crossings = match args.crossings {
            0 => None,
            most => Some(crossings(&mesh, most, budget)?),
        };
        Ok(Examined {
            report,
            shapes,
            crossings,
        })
    };
    let refused = match whole() {
        Ok(found) => return Ok((found, false)),
        Err(e) if e.kind() == ErrorKind::BudgetExceeded => e,
        Err(e) => return Err(e),
    };
    let Some(source) = formats::mesh_in_place(&args.mesh, budget)? else {
        return Err(refused);
    };
    let beside = match &args.scratch {
        Some(folder) => folder.join("scratch"),
        None => args.mesh.clone(),
    };
    let file = || {
        formats::scratch_file(&beside).map_err(|e| {
            e.context("a mesh that does not fit is checked with scratch files (--scratch DIR)")
        })
    };
    let scratch = [file()?, file()?, file()?];
    let found = examine(source.as_ref(), args.crossings, scratch, budget)?;
    Ok((found, true))
}

/// Closed (unless a border is allowed), 2-manifold, oriented, finite. Triangles without area are
/// reported, but do not make a mesh unsound: samples may equal the isovalue.
pub(super) fn is_sound(report: &Report, open_ok: bool) -> bool {
    (report.closed || open_ok)
        && report.is_manifold()
        && report.is_oriented()
        && report.nonfinite_vertices == 0
}

/// What is wrong, in a line.
fn faults(report: &Report, open_ok: bool) -> String {
    let counts = [
        (
            if open_ok { 0 } else { report.border_edges },
            "border edges",
        ),
        (report.nonmanifold_edges, "edges of more than two triangles"),
        (
            report.misoriented_edges,
            "edges between triangles that disagree on the outside",
        ),
        (report.nonmanifold_vertices, "vertices where sheets touch"),
        (report.nonfinite_vertices, "vertices that are not finite"),
    ];
    let found: Vec<String> = counts
        .into_iter()
        .filter(|&(count, _)| count > 0)
        .map(|(count, what)| format!("{} {what}", thousands(count)))
        .collect();
    format!("not sound: {}", found.join(", "))
}

fn describe(report: &Report) -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: String| {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "  {name:<12} {value}");
    };
    let fault = |count: u64, good: &str, bad: &str| match count {
        0 => good.to_string(),
        n => format!("no: {} {bad}", thousands(n)),
    };
    line("triangles", thousands(report.triangles));
    line("vertices", thousands(report.vertices));
    line("closed", fault(report.border_edges, "yes", "border edges"));
    let manifold = fault(
        report.nonmanifold_edges + report.nonmanifold_vertices,
        "yes",
        "edges or vertices where sheets touch",
    );
    line("2-manifold", manifold);
    line("oriented", fault(report.misoriented_edges, "yes", "edges"));
    line("components", thousands(report.components));
    line("euler", report.euler.to_string());
    if let Some(genus) = report.genus {
        line("genus", thousands(genus));
    }
    line("area", report.area.to_string());
    line("volume", report.volume.to_string());
    if let Some([low, high]) = report.bounds {
        line("bounds", format!("{low:?} to {high:?}"));
    }
    for (count, what) in [
        (report.degenerate_triangles, "triangles without area"),
        (report.unused_vertices, "vertices that no triangle uses"),
        (report.nonfinite_vertices, "vertices that are not finite"),
    ] {
        if count > 0 {
            line("remark", format!("{} {what}", thousands(count)));
        }
    }
    text
}

/// Angles, ratios and crossings for people.
fn describe_triangles(found: &Examined) -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: String| {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "  {name:<12} {value}");
    };
    let shapes = &found.shapes;
    if shapes.measured > 0 {
        line("min angle", spread(&shapes.min_angle_deg, 2));
        line("radius ratio", spread(&shapes.radius_ratio, 3));
        let part = 100.0 * shapes.slivers as f64 / shapes.measured as f64;
        let slivers = thousands(shapes.slivers);
        line(
            "slivers",
            format!("{slivers} ({part:.2} %) below {SLIVER_DEG} degrees"),
        );
    }
    if let Some(c) = found.crossings {
        let among = match c.checked_triangles == shapes.measured {
            true => String::new(),
            false => format!(
                " at {} of {} triangles (--crossings all for all)",
                thousands(c.checked_triangles),
                thousands(shapes.measured)
            ),
        };
        let pairs = format!(
            "{} crossing and {} overlapping pairs{among}",
            thousands(c.crossing_pairs),
            thousands(c.overlapping_pairs)
        );
        line("crossings", pairs);
    }
    text
}

/// The report for programs.
pub(super) fn figures(report: &Report) -> Value {
    json!({
        "vertices": report.vertices, "triangles": report.triangles, "edges": report.edges,
        "closed": report.closed, "manifold": report.is_manifold(),
        "oriented": report.is_oriented(), "border_edges": report.border_edges,
        "nonmanifold_edges": report.nonmanifold_edges,
        "misoriented_edges": report.misoriented_edges,
        "nonmanifold_vertices": report.nonmanifold_vertices,
        "degenerate_triangles": report.degenerate_triangles,
        "unused_vertices": report.unused_vertices,
        "nonfinite_vertices": report.nonfinite_vertices,
        "components": report.components, "euler": report.euler, "genus": report.genus,
        "area": report.area, "volume": report.volume, "bounds": report.bounds,
    })
}
