//! `mesh`: the isosurface of a volume into a mesh file, and a picture of it if wanted.

use super::info::range_json;
use super::{labels, named, pick, region, seconds, thousands};
use crate::Outcome;
use crate::args::{BoundaryMode, InsideMode, Mesh, Shot, Space};
use crate::job::Job;
use crate::output::{self, Replace};
use crate::paint::{self, Paint, Painted};
use crate::picture;
use crate::render::{Raster, crossing_bounds, look};
use crate::shapes::{self, ShapeTally};
use crate::simplify::{self, simplified};
use crate::tally::{Figures, Tally};
use crate::tee::Tee;
use brickmarch::budget::human_bytes;
use brickmarch::iso::{Boundary, Extract, Part, Stats, extract, extract_part};
use brickmarch::mesh::{Components, Kept, Layout, Shapes, Simplification, Which};
use brickmarch::store::Volume;
use brickmarch::{Affine, Box3, Budget, Error, ErrorKind, Field, Inside, Kind, MeshSink, Result};
use serde_json::{Value, json};
use std::fs::File;
use std::path::Path;

pub(crate) fn run(args: &Mesh) -> anyhow::Result<Outcome> {
    if args.labels.is_some() {
        return labels::run(args);
    }
    let replace = Replace::from(&args.overwrite);
    let for_colours = match &args.color {
        Some(_) => args.run.limits.mem / paint::SHARE,
        None => 0,
    };
    let job = Job::without(for_colours, &args.run);
    if !args.dry_run {
        output::check_target(&args.out, replace)?;
        if let Some(shot) = &args.shot.picture {
            picture::check_png_name(shot)?;
            output::check_target(shot, replace)?;
        }
    }
    let volume = pick::open(&args.volume, &args.pick, &job.budget)?;
    let blame = named(&[&args.volume, &args.out]);
    let label;
    let field: &dyn Field = match args.label {
        Some(id) => {
            check_label(&volume, id).map_err(&blame)?;
            label = volume.label(id);
            &label
        }
        None => &volume,
    };
    let options = options(args, field).map_err(&blame)?;
    let paint = match &args.color {
        Some(color) => {
            let to_world = match args.space {
                Space::World => Affine::IDENTITY,
                Space::Index => field.grid().index_to_world,
            };
            let (map, window) = (args.color_map, args.color_window);
            let threads = job.budget.threads();
            let paint = Paint::open(color, map, window, to_world, for_colours, threads);
            Some(paint.map_err(named(&[color]))?)
        }
        None => None,
    };
    if args.dry_run {
        return dry_run(args, &job, field, &options).map_err(|e| anyhow::Error::new(blame(e)));
    }
    if let Some([number, of]) = args.part {
        let part = Part { number, of };
        return one_part(args, &job, field, &options, part, replace)
            .map_err(|e| anyhow::Error::new(blame(e)));
    }
    let made = make(args, &job, field, &options, paint.as_ref(), replace).map_err(&blame)?;
    let took = job.seconds();
    let bytes_in = std::fs::metadata(&args.volume).map(|m| m.len()).ok();
    let bytes_out = std::fs::metadata(&args.out).map(|m| m.len()).ok();
    let Made {
        passed: Passed {
            stats,
            figures,
            shapes,
        },
        kept,
        thinned,
        picture_bytes,
        plain,
    } = made;
    if let (Some(n @ 1..), Some(color)) = (plain, &args.color) {
        job.note(&format!(
            "{}: {} vertices have the colour of --colour: they lie beyond its samples, or where it has no value or no segment",
            color.display(),
            thousands(n)
        ));
    }
    let text = format!(
        "{}: {} triangles, {} vertices{}{}, {}, {}, peak {}\n",
        args.out.display(),
        thousands(stats.triangles),
        thousands(stats.vertices),
        kept.map_or(String::new(), |k| format!(
            ", {} of {} components",
            thousands(k.kept),
            thousands(k.found)
        )),
        figures.map_or(String::new(), |f| format!(
            ", {}, area {:.6}, volume {:.6}",
            if f.closed { "closed" } else { "open" },
            f.area,
            f.volume
        )),
        human_bytes(bytes_out.unwrap_or(0)),
        seconds(took),
        Job::peak_text(),
    );
    let mut json = json!({
        "schema": 1, "command": "mesh", "volume": args.volume, "out": args.out,
        "iso": options.iso, "inside": inside_name(options.inside.unwrap_or(field.kind().inside())),
        "label": args.label, "range": range_json(field.range(field.grid().domain)?),
        "seconds": took, "peak_rss_bytes": crate::system::peak_resident_bytes(),
        "budget_peak_bytes": job.budget.peak_bytes(), "mem_bytes": args.run.limits.mem,
        "bytes_in": bytes_in, "bytes_out": bytes_out,
        "picture": args.shot.picture, "picture_bytes": picture_bytes,
        "color": args.color, "vertices_without_color": plain,
    });
    add_figures(&mut json, &stats, figures.as_ref());
    if let Some(kept) = kept {
        json["components_found"] = json!(kept.found);
        json["components_kept"] = json!(kept.kept);
    }
    let text = text
        + &add_shapes(&mut json, shapes.as_ref())
        + &simplify::report(&mut json, thinned.as_ref());
    job.result(&text, &json)?;
    Ok(pick::outcome(&volume, &args.volume, &job))
}

/// Writes one part of the mesh.
fn one_part(
    args: &Mesh,
    job: &Job,
    field: &dyn Field,
    options: &Extract,
    part: Part,
    replace: Replace,
) -> Result<Outcome> {
    let mut stats = Ok(Stats::default());
    let bytes = output::write_whole(&args.out, replace, |file| {
        let _watch = job.watch("meshing");
        stats = extract_part(field, options, part, &job.budget, file, &args.out);
        match stats {
            Ok(_) => Ok(()),
            // The error itself is in `stats`; this only keeps the file from getting its name.
            Err(_) => Err(std::io::ErrorKind::Interrupted.into()),
        }
    });
    let stats = stats?;
    let bytes = bytes?;
    let text = format!(
        "{}: part {} of {}: {} triangles, {}, {}, peak {}\n",
        args.out.display(),
        part.number,
        part.of,
        thousands(stats.triangles),
        human_bytes(bytes),
        seconds(job.seconds()),
        Job::peak_text(),
    );
    let mut json = json!({
        "schema": 1, "command": "mesh", "volume": args.volume, "out": args.out,
        "part": part.number, "parts": part.of, "seconds": job.seconds(), "bytes_out": bytes,
        "peak_rss_bytes": crate::system::peak_resident_bytes(), "mem_bytes": args.run.limits.mem,
    });
    add_figures(&mut json, &stats, None);
    let printed = job.result(&text, &json);
    printed.map_err(|e| Error::io(Path::new("standard output"), "writing", e))?;
    Ok(Outcome::Done)
}

/// Counts of a mesh, and measures where they were taken, for programs.
pub(super) fn add_figures(json: &mut Value, stats: &Stats, figures: Option<&Figures>) {
    let mut more = json!({
        "vertices": stats.vertices, "triangles": stats.triangles,
        "interior_vertices": stats.interior_vertices, "active_cells": stats.active_cells,
        "ambiguous_faces": stats.ambiguous_faces, "blocks_visited": stats.blocks_visited,
        "blocks_decoded": stats.blocks_decoded, "front_bytes_max": stats.front_bytes_max,
    });
    if let Some(figures) = figures {
        more["closed"] = json!(figures.closed);
        more["euler"] = json!(figures.euler);
        more["area"] = json!(figures.area);
        more["signed_volume"] = json!(figures.volume);
    }
    if let (Some(to), Value::Object(from)) = (json.as_object_mut(), more) {
        to.extend(from);
    }
}

/// Shapes of the triangles, where they were counted, for programs and in words.
pub(super) fn add_shapes(json: &mut Value, shapes: Option<&[Shapes; 2]>) -> String {
    let Some(shapes) = shapes else {
        return String::new();
    };
    json["shapes"] = shapes::json(shapes);
    shapes::text(shapes)
}

/// A label that no sample has is a mistake that is better said at once.
fn check_label(volume: &Volume, id: u32) -> Result<()> {
    let range = volume.range(volume.grid().domain)?;
    let value = f64::from(id);
    // The range is in f32, which is coarse for large numbers.
    let slack = f64::from(f32::EPSILON) * value;
    if value < f64::from(range.min) - slack || value > f64::from(range.max) + slack {
        return Err(Error::bad_input(format!(
            "no sample is {id}: the labels lie in {} to {}",
            range.min, range.max
        )));
    }
    Ok(())
}

/// Which components the command line asks for, if not all.
pub(super) fn keep(args: &Mesh) -> Option<Which> {
    let largest = args.component.map(Which::Largest);
    largest.or(args.min_triangles.map(Which::AtLeast))
}

/// Three nameless files in the folder of `beside`, for what waits until components are known.
pub(super) fn scratch_files(beside: &Path) -> Result<[File; 3]> {
    let file = || brickmarch_formats::scratch_file(beside);
    Ok([file()?, file()?, file()?])
}

/// The options of extraction that the command line asks for.
///
/// # Errors
/// When there is no isovalue, or the region is outside of the domain.
fn options(args: &Mesh, field: &dyn Field) -> Result<Extract> {
    let range = || field.range(field.grid().domain);
    let iso = match (args.iso, field.kind()) {
        (Some(iso), _) => iso,
        (None, Kind::Label) => {
            return Err(Error::bad_input(
                "a label volume has one surface per segment: give --label ID, --labels all (or --iso V)",
            ));
        }
        (None, kind) => match kind.default_iso() {
            Some(iso) => iso,
            None => {
                let range = range()?;
                return Err(Error::bad_input(format!(
                    "a {} has no isovalue of its own: give --iso V between {} and {}",
                    kind.name(),
                    range.min,
                    range.max
                )));
            }
        },
    };
    Ok(Extract {
        iso,
        inside: args.inside.map(|side| match side {
            InsideMode::Above => Inside::Above,
            InsideMode::Below => Inside::Below,
        }),
        region: cells(args, field)?,
        boundary: match args.boundary {
            BoundaryMode::Cap => Boundary::Cap,
            BoundaryMode::Cut => Boundary::Cut,
            BoundaryMode::Tile => Boundary::Tile,
        },
        seeds: args.seed.clone(),
        normals: args.normals || args.shot.picture.is_some(),
        keys: args.keys,
        index_space: args.space == Space::Index,
        relax: args.smooth.relax(),
        allow_empty: args.allow_empty,
    })
}

/// The cells of the region: `--roi` counts cells, `--roi-world` the cells between its samples.
pub(super) fn cells(args: &Mesh, field: &dyn Field) -> Result<Option<Box3>> {
    let found = region::resolve(&args.region, field.grid())?;
    if args.region.roi.is_some() {
        return Ok(found);
    }
    let Some(samples) = found else {
        return Ok(None);
    };
    let cells = Box3::new(samples.min, samples.max.map(|v| v - 1));
    if cells.is_empty() {
        return Err(Error::bad_input(
            "--roi-world holds no cell between samples: make it wider",
        ));
    }
    Ok(Some(cells))
}

/// A mesh that was written.
struct Made {
    passed: Passed,
    /// Where not all components were wanted.
    kept: Option<Kept>,
    thinned: Option<Simplification>,
    picture_bytes: Option<u64>,
    /// Vertices that have no colour of their own, where colours were asked for.
    plain: Option<u64>,
}

fn make(
    args: &Mesh,
    job: &Job,
    field: &dyn Field,
    options: &Extract,
    paint: Option<&Paint>,
    replace: Replace,
) -> Result<Made> {
    let overwrite = replace == Replace::Yes;
    let brush = paint
        .map(|p| p.brush(args.shot.camera.colour))
        .transpose()?;
    let (mut plain_file, mut painted);
    let file: &mut dyn MeshSink = match &brush {
        Some(brush) => {
            let inner = brickmarch_formats::create_colored_mesh_sink(&args.out, overwrite)?;
            painted = Some(Painted::new(inner, brush));
            painted.as_mut().expect("set above")
        }
        None => {
            painted = None;
            plain_file = brickmarch_formats::create_mesh_sink(&args.out, overwrite)?;
            plain_file.as_mut()
        }
    };
    let mut raster = match &args.shot.picture {
        Some(_) => Some(open_raster(&args.shot, field, options, &job.budget)?),
        None => None,
    };
    let wanted = Layout {
        normals: args.normals,
        keys: args.keys,
    };
    let (mut kept, mut thinned) = (None, None);
    let passed = {
        let _watch = job.watch_counted("meshing", || count_work(field, options, &job.budget))?;
        let raster = raster.as_mut().map(|r| r as &mut dyn MeshSink);
        let moved = options.relax > 0;
        pour(file, wanted, raster, (args.measure, moved), |sink| {
            let space = (field, options.index_space);
            let (stats, done) =
                simplified(args.simplify, space, &args.out, &job.budget, sink, |sink| {
                    let (stats, some) = extract_some(field, options, &job.budget, args, sink)?;
                    kept = some;
                    Ok(stats)
                })?;
            thinned = done;
            Ok(stats)
        })?
    };
    let mut picture_bytes = None;
    if let (Some(raster), Some(path)) = (raster, &args.shot.picture) {
        let picture = match &brush {
            Some(brush) => brush.picture(&raster, &job.budget)?,
            None => raster.picture(&job.budget)?,
        };
        picture_bytes = Some(picture.write_png(path, replace)?);
    }
    Ok(Made {
        passed,
        kept,
        thinned,
        picture_bytes,
        plain: painted.as_ref().map(Painted::plain),
    })
}

/// What passed into the sinks.
pub(super) struct Passed {
    pub(super) stats: Stats,
    pub(super) figures: Option<Figures>,
    /// Before and after relaxation.
    pub(super) shapes: Option<[Shapes; 2]>,
}

/// Extracts into a file, a tally if `measure`, and a picture if there is one, in one pass.
///
/// # Errors
/// What extraction and the sinks report.
pub(super) fn pass(
    field: &dyn Field,
    options: &Extract,
    budget: &Budget,
    file: &mut dyn MeshSink,
    wanted: Layout,
    raster: Option<&mut dyn MeshSink>,
    measure: bool,
) -> Result<Passed> {
    let moved = options.relax > 0;
    pour(file, wanted, raster, (measure, moved), |sink| {
        extract(field, options, budget, sink)
    })
}

/// The mesh that `make` makes, into a file, a tally and a picture. Shapes are counted when its
/// vertices have moved.
///
/// # Errors
/// What `make` and the sinks report.
pub(super) fn pour(
    file: &mut dyn MeshSink,
    wanted: Layout,
    raster: Option<&mut dyn MeshSink>,
    (measure, moved): (bool, bool),
    make: impl FnOnce(&mut dyn MeshSink) -> Result<Stats>,
) -> Result<Passed> {
    let mut tally = Tally::default();
    let mut shapes = (measure && moved).then(ShapeTally::default);
    let all = Layout {
        normals: true,
        keys: true,
    };
    let mut tee = Tee::default();
    tee.add(file, wanted);
    if measure {
        tee.add(&mut tally, all);
    }
    if let Some(shapes) = &mut shapes {
        tee.add(shapes, all);
    }
    if let Some(raster) = raster {
        tee.add(raster, all);
    }
    let stats = make(&mut tee)?;
    drop(tee);
    Ok(Passed {
        stats,
        figures: measure.then(|| tally.figures()),
        shapes: shapes.map(ShapeTally::shapes),
    })
}

/// Extracts into `sink` the components that are wanted.
fn extract_some(
    field: &dyn Field,
    options: &Extract,
    budget: &Budget,
    args: &Mesh,
    sink: &mut dyn MeshSink,
) -> Result<(Stats, Option<Kept>)> {
    let Some(which) = keep(args) else {
        return Ok((extract(field, options, budget, sink)?, None));
    };
    let scratch = scratch_files(&args.out)?;
    let mut some = Components::new(which, options.allow_empty, scratch, budget, sink)?;
    let mut stats = extract(field, options, budget, &mut some)?;
    let kept = some.kept();
    (stats.vertices, stats.triangles) = (kept.totals.vertices, kept.totals.triangles);
    Ok((stats, Some(kept)))
}

pub(super) fn open_raster(
    shot: &Shot,
    field: &dyn Field,
    options: &Extract,
    budget: &Budget,
) -> Result<Raster> {
    if options.index_space {
        return Err(Error::new(
            ErrorKind::Unsupported,
            "--picture is drawn in world space: leave --space index out, or draw it in a second run",
        ));
    }
    let domain = field.grid().domain;
    let region = options
        .region
        .unwrap_or(domain)
        .grow(0, 1)
        .intersect(&domain);
    let inside = options.inside.unwrap_or(field.kind().inside());
    let bounds = crossing_bounds(field, region, options.iso, inside)?;
    Raster::new(&look(&shot.camera, shot.picture_size), &bounds, budget)
}

/// Blocks that extraction will look at; 0 where seeds decide.
///
/// # Errors
/// What the field reports.
pub(super) fn count_work(field: &dyn Field, options: &Extract, budget: &Budget) -> Result<u64> {
    if !options.seeds.is_empty() {
        return Ok(0);
    }
    let region = options.region.unwrap_or(field.grid().domain);
    crossed_blocks(field, region, options.iso, budget)
}

/// Counts the blocks that the surface can cross, and says what meshing them takes.
fn dry_run(args: &Mesh, job: &Job, field: &dyn Field, options: &Extract) -> Result<Outcome> {
    let edge = field.block_edge();
    let region = options.region.unwrap_or(field.grid().domain);
    let blocks = crossed_blocks(field, region, options.iso, &job.budget)?;
    let bytes = blocks * u64::from(edge).pow(3) * 4;
    let memory = job.budget.memory_bytes();
    let text = format!(
        "{}: would read up to {} blocks of {edge}^3 samples ({} decoded), in at most {} of memory\n",
        args.volume.display(),
        thousands(blocks),
        human_bytes(bytes),
        human_bytes(memory),
    );
    let json = json!({
        "schema": 1, "command": "mesh", "dry_run": true, "volume": args.volume,
        "blocks": blocks, "block_edge": edge, "bytes_decoded": bytes,
        "peak_memory_bytes": memory, "iso": options.iso,
    });
    let printed = job.result(&text, &json);
    printed.map_err(|e| Error::io(Path::new("standard output"), "writing", e))?;
    Ok(Outcome::Done)
}

/// Blocks of `region` whose range holds the isovalue, found by halving.
pub(crate) fn crossed_blocks(
    field: &dyn Field,
    part: Box3,
    iso: f32,
    budget: &Budget,
) -> Result<u64> {
    budget.check_cancelled()?;
    let domain = field.grid().domain;
    // Cells reach one sample beyond their own.
    let range = field.range(part.grow(0, 1).intersect(&domain))?;
    if part.is_empty() || range.min > iso || range.max < iso {
        return Ok(0);
    }
    let edge = field.block_edge() as i32;
    let block = |v: i32, a: usize| (v - domain.min[a]).div_euclid(edge);
    let spans = [0, 1, 2].map(|a| block(part.max[a] - 1, a) - block(part.min[a], a) + 1);
    let axis = (0..3).max_by_key(|&a| spans[a]).expect("three axes");
    if spans[axis] == 1 {
        return Ok(1);
    }
    let middle = domain.min[axis] + (block(part.min[axis], axis) + spans[axis] / 2) * edge;
    let (mut low, mut high) = (part, part);
    low.max[axis] = middle;
    high.min[axis] = middle;
    Ok(crossed_blocks(field, low, iso, budget)? + crossed_blocks(field, high, iso, budget)?)
}

pub(super) fn inside_name(inside: Inside) -> &'static str {
    match inside {
        Inside::Above => "above",
        Inside::Below => "below",
    }
}
