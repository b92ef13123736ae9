//! `model`: a scene file into a volume, or directly into a mesh, with no file between.

use super::mesh::{Passed, add_figures, add_shapes, count_work, crossed_blocks, open_raster, pour};
use super::{named, seconds, thousands};
use crate::Outcome;
use crate::args::Model as Args;
use crate::job::Job;
use crate::output::{self, Replace};
use crate::picture;
use crate::simplify::{self, simplified};
use brickmarch::budget::human_bytes;
use brickmarch::iso::{Extract, extract};
use brickmarch::mesh::{Layout, Piece, Totals};
use brickmarch::model::{AttributeField, Convention, Model, NearSurface};
use brickmarch::refine::Refined;
use brickmarch::store::{VolumeInfo, VolumeSpec, bricks_to_evaluate, write_fields};
use brickmarch::{Error, Field, MeshSink, Result, SampleType};
use brickmarch_formats::scene::Scene;
use serde_json::{Value, json};

/// Cells along the longest edge when neither the command nor the scene says.
const DEFAULT_RESOLUTION: u32 = 256;

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let replace = Replace::from(&args.overwrite);
    let job = Job::new(&args.run);
    let to_volume = is_volume(args);
    check_usage(args, to_volume)?;
    if !args.dry_run {
        output::check_target(&args.out, replace)?;
        if let Some(shot) = &args.shot.picture {
            picture::check_png_name(shot)?;
            output::check_target(shot, replace)?;
        }
    }
    let scene = Scene::read(&args.scene, &job.budget)?;
    let blame = named(&[&args.scene, &args.out]);
    let grid = match args.voxel {
        Some(voxel) => Model::lattice(scene.bounds, voxel, scene.units),
        None => scene.lattice(
            args.resolution
                .or(scene.resolution)
                .unwrap_or(DEFAULT_RESOLUTION),
        ),
    }
    .map_err(&blame)?;
    let model = Model::new(&scene.shape, grid).map_err(&blame)?;
    let mut json = json!({
        "schema": 1, "command": "model", "scene": args.scene, "out": args.out, "title": scene.title,
        "size": grid.domain.size(), "voxel": grid.index_to_world.spacing()[0],
        "operations": model.operations(), "convention": model.convention().name(),
        "mem_bytes": args.run.limits.mem,
    });
    if args.dry_run {
        let text = dry_run(args, &scene, model, &job, &mut json).map_err(&blame)?;
        job.result(&text, &json)?;
        return Ok(Outcome::Done);
    }
    let text = if to_volume {
        volume(args, model, &job, &mut json).map_err(&blame)?
    } else {
        mesh(args, &model, &job, replace, &mut json).map_err(&blame)?
    };
    let took = job.seconds();
    add(
        &mut json,
        json!({
            "seconds": took, "peak_rss_bytes": crate::system::peak_resident_bytes(),
            "budget_peak_bytes": job.budget.peak_bytes(),
            "bytes_out": std::fs::metadata(&args.out).map(|m| m.len()).ok(),
        }),
    );
    let size = grid.domain.size();
    let text = format!(
        "{}: {} x {} x {}, {text}, {}, peak {}\n",
        args.out.display(),
        size[0],
        size[1],
        size[2],
        seconds(took),
        Job::peak_text(),
    );
    job.result(&text, &json)?;
    Ok(Outcome::Done)
}

fn is_volume(args: &Args) -> bool {
    let extension = args.out.extension();
    extension.is_some_and(|e| e.eq_ignore_ascii_case("bvol"))
}

/// Options that the kind of output has no use for are mistakes.
fn check_usage(args: &Args, to_volume: bool) -> Result<()> {
    let mesh_only = [
        ("--normals", args.normals),
        ("--refine", args.refine),
        ("--simplify", args.simplify.is_some()),
        ("--smooth", args.smooth.smooth.is_some()),
        ("--picture", args.shot.picture.is_some()),
        ("--allow-empty", args.allow_empty),
    ];
    if let (true, Some((name, _))) = (to_volume, mesh_only.iter().find(|(_, given)| *given)) {
        return Err(Error::bad_input(format!(
            "{}: {name} is for meshes: leave it out, or write a .ply",
            args.out.display()
        )));
    }
    if !(args.band >= 1.0 && args.band <= 1e6) {
        return Err(Error::bad_input(format!(
            "--band {}: give a number of voxels from 1",
            args.band
        )));
    }
    Ok(())
}

fn add(json: &mut Value, more: Value) {
    if let (Some(to), Value::Object(from)) = (json.as_object_mut(), more) {
        to.extend(from);
    }
}

fn dry_run(
    args: &Args,
    scene: &Scene,
    model: Model,
    job: &Job,
    json: &mut Value,
) -> Result<String> {
    let (grid, edge) = (*model.grid(), model.block_edge());
    let operations = model.operations();
    let all = blocks_of(&model);
    let to_volume = is_volume(args);
    let (what, count) = if to_volume {
        let bricks = to_bricks(args, model, |_, field, spec| {
            bricks_to_evaluate(field, spec, &job.budget)
        })?;
        add(json, json!({"bricks": bricks, "bricks_all": all}));
        ("bricks", bricks)
    } else {
        let iso = model.convention().iso();
        let blocks = crossed_blocks(&model, grid.domain, iso, &job.budget)?;
        add(
            json,
            json!({"blocks": blocks, "blocks_all": all, "block_edge": edge}),
        );
        ("blocks", blocks)
    };
    add(json, json!({"dry_run": true}));
    Ok(format!(
        "{}{operations} operations; would evaluate up to {} of {} {what} of {edge}^3 samples ({:.3} %)\n",
        scene.shape.outline(),
        thousands(count),
        thousands(all),
        100.0 * count as f64 / all as f64,
    ))
}

/// Blocks, or bricks, of the whole lattice.
fn blocks_of(model: &Model) -> u64 {
    let edge = model.block_edge();
    let size = model.grid().domain.size().into_iter();
    size.map(|n| u64::from(n.div_ceil(edge))).product()
}

/// Calls `each` with the model as what a volume of it is written from, and how.
fn to_bricks<T>(
    args: &Args,
    model: Model,
    each: impl FnOnce(&Model, &dyn Field, &VolumeSpec) -> Result<T>,
) -> Result<T> {
    let grid = *model.grid();
    let mut spec = VolumeSpec::new(grid, SampleType::F32);
    spec.kind = model.kind();
    let name = args.scene.file_name().unwrap_or_default().to_string_lossy();
    spec.name = name.chars().take(60).collect();
    if args.full {
        spec.history = format!("model {name}, every sample");
        spec.background = far_value(&model)?.into();
        each(&model, &model, &spec)
    } else if model.convention() == Convention::Distance {
        let band = f64::from((args.band * grid.index_to_world.spacing()[0]) as f32);
        spec.history = format!("model {name}, distance within {} voxels", args.band);
        spec.background = band;
        let model = model.narrow(band)?;
        each(&model, &model, &spec)
    } else {
        spec.history = format!("model {name}, bricks near the surface");
        let near = NearSurface::new(&model, model.convention().iso(), far_value(&model)?);
        spec.background = near.outside().into();
        each(&model, &near, &spec)
    }
}

fn volume(args: &Args, model: Model, job: &Job, json: &mut Value) -> Result<String> {
    let grid = *model.grid();
    let bricks = blocks_of(&model);
    let _watch = job.watch("evaluating");
    let (info, evaluated) = to_bricks(args, model, |model, field, spec| {
        let info = with_attributes(args, model, field, spec, job)?;
        Ok((info, model.evaluated()))
    })?;
    let share = evaluated.regions as f64 / bricks.max(1) as f64;
    add(
        json,
        json!({
            "volume": super::info::figures(&info, &grid), "bricks": bricks,
            "bricks_evaluated": evaluated.regions, "samples_evaluated": evaluated.samples,
            "share_evaluated": share,
        }),
    );
    Ok(format!(
        "{} of {} bricks evaluated ({:.3} %), {}",
        thousands(evaluated.regions),
        thousands(bricks),
        100.0 * share,
        human_bytes(info.bytes_file)
    ))
}

/// Writes `field`, and with `--colors` volumes beside it: the colour as `color.r`, `color.g` and `color.b`, each
/// other attribute under its name.
fn with_attributes(
    args: &Args,
    model: &Model,
    field: &dyn Field,
    spec: &VolumeSpec,
    job: &Job,
) -> Result<VolumeInfo> {
    let mut beside = Vec::new();
    if args.colors {
        let channels = ["red", "green", "blue"];
        let others = model.attribute_names().filter(|n| !channels.contains(n));
        for name in channels {
            let field = AttributeField::color(model, name)?;
            beside.push((field, SampleType::U8, format!("color.{}", &name[..1])));
        }
        for name in others {
            let field = AttributeField::new(model, name);
            beside.push((field, SampleType::F32, name.to_string()));
        }
    }
    let beside: Vec<(AttributeField<'_>, VolumeSpec)> = beside
        .into_iter()
        .map(|(field, sample, name)| {
            let field = if args.full { field.everywhere() } else { field };
            let own = VolumeSpec {
                background: field.background().into(),
                history: format!("{}: {name}", spec.history),
                name,
                ..VolumeSpec::new(spec.grid, sample)
            };
            (field, own)
        })
        .collect();
    let mut all: Vec<(&dyn Field, &VolumeSpec)> = vec![(field, spec)];
    all.extend(beside.iter().map(|(f, s)| (f as &dyn Field, s)));
    write_fields(&all, &args.out, &job.budget)
}

/// A value that is clearly away from the surface: a power of two beyond those at the corners.
fn far_value(model: &Model) -> Result<f32> {
    let domain = model.grid().domain;
    let map = model.grid().index_to_world;
    let iso = f64::from(model.convention().iso());
    let mut largest = 0.0f64;
    for c in 0..8 {
        let corner = std::array::from_fn(|a| {
            f64::from(if c >> a & 1 == 0 {
                domain.min[a]
            } else {
                domain.max[a] - 1
            })
        });
        let value = (model.value(map.apply(corner))? - iso).abs();
        if value.is_finite() {
            largest = largest.max(value);
        }
    }
    if largest < 1e-30 {
        return Ok(1.0);
    }
    Ok(largest.log2().ceil().exp2().clamp(1e-30, 1e30) as f32)
}

fn mesh(
    args: &Args,
    model: &Model,
    job: &Job,
    replace: Replace,
    json: &mut Value,
) -> Result<String> {
    let options = Extract {
        iso: model.convention().iso(),
        normals: args.normals || args.shot.picture.is_some(),
        relax: args.smooth.relax(),
        keys: args.refine,
        allow_empty: args.allow_empty,
        ..Extract::default()
    };
    let overwrite = replace == Replace::Yes;
    let mut file: Box<dyn MeshSink + '_> = if args.colors {
        Box::new(Colored {
            inner: brickmarch_formats::create_colored_mesh_sink(&args.out, overwrite)?,
            model,
        })
    } else {
        brickmarch_formats::create_mesh_sink(&args.out, overwrite)?
    };
    let mut raster = match &args.shot.picture {
        Some(_) => Some(open_raster(&args.shot, model, &options, &job.budget)?),
        None => None,
    };
    let wanted = Layout {
        normals: args.normals,
        keys: false,
    };
    let mut thinned = None;
    let Passed {
        stats,
        figures,
        shapes,
    } = {
        let _watch = job.watch_counted("meshing", || count_work(model, &options, &job.budget))?;
        let raster = raster.as_mut().map(|r| r as &mut dyn MeshSink);
        let moved = options.relax > 0;
        pour(file.as_mut(), wanted, raster, (true, moved), |sink| {
            let space = (model as &dyn Field, false);
            let (stats, done) =
                simplified(args.simplify, space, &args.out, &job.budget, sink, |sink| {
                    if !args.refine {
                        return extract(model, &options, &job.budget, sink);
                    }
                    let mut refined = Refined::new(model, false, &job.budget, sink);
                    extract(model, &options, &job.budget, &mut refined)
                })?;
            thinned = done;
            Ok(stats)
        })?
    };
    if let (Some(raster), Some(path)) = (raster, &args.shot.picture) {
        let shot_colour = args.shot.camera.colour;
        // A point whose colour cannot be read keeps that of the option.
        let colours = |points: &[[f32; 3]]| {
            let found = model.colors(points);
            found.unwrap_or_else(|_| vec![shot_colour; points.len()])
        };
        let named = ["red", "green", "blue"];
        let has_colours = model.attribute_names().any(|n| named.contains(&n));
        let picture = raster.painted(has_colours.then_some(&colours), &job.budget)?;
        let bytes = picture.write_png(path, replace)?;
        add(json, json!({"picture": path, "picture_bytes": bytes}));
    }
    add_figures(json, &stats, figures.as_ref());
    add_shapes(json, shapes.as_ref());
    let said = simplify::report(json, thinned.as_ref());
    let figures = figures.unwrap_or_default();
    let blocks = blocks_of(model);
    let evaluated = model.evaluated();
    add(
        json,
        json!({
            "blocks": blocks, "blocks_evaluated": evaluated.regions,
            "samples_evaluated": evaluated.samples,
            "share_evaluated": evaluated.regions as f64 / blocks.max(1) as f64,
        }),
    );
    Ok(format!(
        "{} triangles, {} vertices, {}, area {:.6}, volume {:.6}{}{}, {} of {} blocks evaluated",
        thousands(stats.triangles),
        thousands(stats.vertices),
        if figures.closed { "closed" } else { "open" },
        figures.area,
        figures.volume,
        if said.is_empty() { "" } else { ", " },
        said.trim(),
        thousands(evaluated.regions),
        thousands(blocks),
    ))
}

/// Gives every vertex the colour of the solid that it lies on.
struct Colored<'a> {
    inner: Box<dyn MeshSink>,
    model: &'a Model,
}

impl MeshSink for Colored<'_> {
    fn capacity(&self) -> Totals {
        self.inner.capacity()
    }

    fn begin(&mut self, layout: Layout) -> Result<()> {
        self.inner.begin(layout)
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        let mut colored = piece.clone();
        colored.colors = self.model.colors(&piece.positions)?;
        self.inner.write(&colored)
    }

    fn finish(&mut self, totals: Totals) -> Result<()> {
        self.inner.finish(totals)
    }
}
