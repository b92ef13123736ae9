//! `check`: is a mesh closed, 2-manifold and oriented, and what does it measure?

use super::{named, thousands};
use crate::Outcome;
use crate::args::Check;
use crate::job::Job;
use brickmarch::Budget;
use brickmarch::mesh::{Report, check};
use serde_json::{Value, json};
use std::fmt::Write;

pub(crate) fn run(args: &Check) -> anyhow::Result<Outcome> {
    let job = Job::with_budget(Budget::bytes(args.mem), &args.say);
    let report = {
        let _watch = job.watch("checking");
        let mesh = brickmarch_formats::read_mesh(&args.mesh, &job.budget)?;
        check(&mesh, &job.budget).map_err(named(&[&args.mesh]))?
    };
    let sound = is_sound(&report, args.open_ok);
    let mut json = json!({
        "schema": 1, "command": "check", "mesh": args.mesh, "sound": sound,
        "seconds": job.seconds(), "peak_rss_bytes": crate::system::peak_resident_bytes(),
    });
    json["report"] = figures(&report);
    let text = format!("{}\n{}", args.mesh.display(), describe(&report));
    job.result(&text, &json)?;
    if sound {
        return Ok(Outcome::Done);
    }
    job.note(&format!(
        "{}: {}",
        args.mesh.display(),
        faults(&report, args.open_ok)
    ));
    Ok(Outcome::NotWhatWasAsked)
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
