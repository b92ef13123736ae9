//! The `exact` command: known answers as text or JSON.

use anyhow::Result;
use brickmarch_data_gen::{Exact, Scene, Topology, lattice_euler};
use serde_json::{Value, json};
use std::fmt::Write;

/// What is known about a scene. `iso` replaces the scene's own isovalue, which the formulas do not
/// know about.
pub(crate) fn text(scene: &Scene, iso: Option<f32>, as_json: bool, count: bool) -> Result<String> {
    let own = iso.is_none_or(|iso| iso == scene.iso());
    let iso = iso.unwrap_or(scene.iso());
    let exact = own.then(|| scene.exact()).flatten();
    let lattice = count.then(|| lattice_euler(scene, iso, scene.inside()));
    if as_json {
        let value = json!({
            "scene": scene.name().name(),
            "size": scene.size(),
            "iso": iso,
            "inside": scene.inside(),
            "exact": exact,
            "lattice": lattice.map(|found| lattice_json(&found)),
        });
        return Ok(serde_json::to_string_pretty(&value)? + "\n");
    }
    let mut out = String::new();
    let [x, y, z] = scene.size();
    writeln!(out, "{} {x} x {y} x {z}, isovalue {iso}", scene.name())?;
    match exact {
        Some(exact) => exact_text(&mut out, &exact)?,
        None => writeln!(out, "no formula for area and volume")?,
    }
    if let Some(found) = lattice {
        lattice_text(&mut out, &found)?;
    }
    Ok(out)
}

fn exact_text(out: &mut String, exact: &Exact) -> Result<()> {
    writeln!(out, "area                {:.6}", exact.area)?;
    writeln!(out, "area of caps        {:.6}", exact.cap_area)?;
    writeln!(out, "volume              {:.6}", exact.volume)?;
    writeln!(out, "relative error      {:e}", exact.relative_error)?;
    if let (Some(components), Some(genus)) = (exact.components, exact.genus) {
        writeln!(out, "components, genus   {components}, {genus}")?;
    }
    Ok(())
}

fn lattice_text(out: &mut String, found: &Topology) -> Result<()> {
    let (cut, capped) = (&found.cut, &found.capped);
    let components = found.mesh_components();
    writeln!(out, "{:<20}{:>14}{:>14}", "on the lattice", "cut", "capped")?;
    let mut row = |name: &str, a: i128, b: i128| writeln!(out, "{name:<20}{a:>14}{b:>14}");
    row(
        "crossed edges",
        cut.crossed_edges.into(),
        capped.crossed_edges.into(),
    )?;
    row(
        "mixed faces",
        cut.mixed_faces.into(),
        capped.mixed_faces.into(),
    )?;
    row(
        "ambiguous faces",
        cut.ambiguous_faces.into(),
        capped.ambiguous_faces.into(),
    )?;
    row(
        "diagonal cells",
        cut.diagonal_cells.into(),
        capped.diagonal_cells.into(),
    )?;
    row(
        "active cells",
        cut.active_cells.into(),
        capped.active_cells.into(),
    )?;
    row(
        "inside points",
        cut.inside_points.into(),
        capped.inside_points.into(),
    )?;
    row(
        "Euler of the solid",
        cut.solid_euler().into(),
        capped.solid_euler().into(),
    )?;
    if found.is_unambiguous() {
        row(
            "triangles",
            cut.triangles().into(),
            capped.triangles().into(),
        )?;
        row(
            "Euler of the mesh",
            cut.mesh_euler().into(),
            capped.mesh_euler().into(),
        )?;
        row(
            "pieces of the mesh",
            components.0.into(),
            components.1.into(),
        )?;
        writeln!(out, "{:<20}{:>14}{:>14}", "genus", "-", found.genus())?;
    } else {
        writeln!(
            out,
            "ambiguous: topology of a mesh depends on how cells are resolved"
        )?;
    }
    writeln!(
        out,
        "inside in {} pieces, outside in {} ({} when capped)",
        found.inside_components, found.outside_components, found.outside_components_capped
    )?;
    Ok(())
}

fn lattice_json(found: &Topology) -> Value {
    let mut value = json!(found);
    let clear = found.is_unambiguous();
    value["unambiguous"] = json!(clear);
    if clear {
        let components = found.mesh_components();
        for (side, counts, pieces) in [
            ("cut", &found.cut, components.0),
            ("capped", &found.capped, components.1),
        ] {
            value[side]["triangles"] = json!(counts.triangles());
            value[side]["mesh_euler"] = json!(counts.mesh_euler());
            value[side]["mesh_components"] = json!(pieces);
        }
        value["capped"]["genus"] = json!(found.genus());
    }
    value
}
