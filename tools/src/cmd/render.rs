//! `render`: a picture of a volume, or of a scene, by casting rays.

use super::{named, pick, region, seconds};
use crate::Outcome;
use crate::args::{InsideMode, Render};
use crate::colourmap;
use crate::job::Job;
use crate::output::{self, Replace};
use crate::picture::{self, Picture};
use crate::render::{Fog, Look, Raster, Surface, crossing_bounds, fog, from_srgb, highest, look};
use brickmarch::model::Model;
use brickmarch::query::Rays;
use brickmarch::{Box3, Error, Field, Inside, Result};
use brickmarch_formats::scene::Scene;
use serde_json::json;

/// Cells along the longest edge of a scene when nobody says.
const DEFAULT_RESOLUTION: u32 = 256;
/// What memory is for.
const SHADING: &str = "shading the picture (a smaller --size takes less)";
const SEEN: &str = "what rays see (a smaller --size takes less)";

pub(crate) fn run(args: &Render) -> anyhow::Result<Outcome> {
    let replace = Replace::from(&args.overwrite);
    picture::check_png_name(&args.out)?;
    output::check_target(&args.out, replace)?;
    if !(args.opacity > 0.0 && args.opacity < 1.0) {
        return Err(Error::bad_input(format!(
            "--opacity {}: give a part of the light, between 0 and 1",
            args.opacity
        ))
        .into());
    }
    let job = Job::new(&args.run);
    let blame = named(&[&args.volume, &args.out]);
    let is_scene = args
        .volume
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("toml"));
    let (drawn, decoded, lost) = if is_scene {
        let scene = Scene::read(&args.volume, &job.budget)?;
        let resolution = args
            .resolution
            .or(scene.resolution)
            .unwrap_or(DEFAULT_RESOLUTION);
        let grid = scene.lattice(resolution).map_err(&blame)?;
        let model = Model::new(&scene.shape, grid).map_err(&blame)?;
        let iso = model.convention().iso();
        let drawn = draw(args, &model, Some(iso), &job).map_err(&blame)?;
        (drawn, 0, false)
    } else {
        let volume = pick::open(&args.volume, &args.pick, &job.budget)?;
        let drawn = draw(args, &volume, None, &job).map_err(&blame)?;
        let lost = pick::report_substituted(&volume, &args.volume, &job);
        (drawn, volume.blocks_decoded(), lost)
    };
    let bytes = drawn.write_png(&args.out, replace)?;
    let (width, height) = (drawn.width, drawn.height);
    let text = format!(
        "{}: {width} x {height} pixels, {}, peak {}\n",
        args.out.display(),
        seconds(job.seconds()),
        Job::peak_text()
    );
    let json = json!({
        "schema": 1, "command": "render", "out": args.out, "width": width, "height": height,
        "bytes_out": bytes, "blocks_decoded": decoded, "seconds": job.seconds(),
        "budget_peak_bytes": job.budget.peak_bytes(),
        "peak_rss_bytes": crate::system::peak_resident_bytes(),
    });
    job.result(&text, &json)?;
    Ok(match lost {
        true => Outcome::NotWhatWasAsked,
        false => Outcome::Done,
    })
}

fn draw(args: &Render, field: &dyn Field, iso: Option<f32>, job: &Job) -> Result<Picture> {
    let part = region::resolve(&args.region, field.grid())?;
    let part = part.unwrap_or(field.grid().domain);
    let look = Look {
        occlusion: !args.no_occlusion,
        ..look(&args.camera, args.size)
    };
    let _watch = job.watch("casting rays");
    if args.fog || args.max {
        return veil(args, field, part, &look, job);
    }
    let Some(iso) = args.iso.or(iso).or(field.kind().default_iso()) else {
        return Err(Error::bad_input(
            "a density has no isovalue of its own: give --iso, or --fog, or --max",
        ));
    };
    let inside = match args.inside {
        Some(InsideMode::Above) => Inside::Above,
        Some(InsideMode::Below) => Inside::Below,
        None => field.kind().inside(),
    };
    let bounds = crossing_bounds(field, part, iso, inside)?;
    let raster = Raster::new(&look, &bounds, &job.budget)?;
    let rays = Rays::new(field, part, &job.budget)?;
    // So that the end of a long work is not where it fails.
    let shading = job.budget.take(raster.shading_bytes(), SHADING)?;
    raster.cast(&rays, Surface { iso, inside }, &job.budget)?;
    drop(shading);
    raster.picture(&job.budget)
}

/// What is seen through: fog, or the largest values.
fn veil(args: &Render, field: &dyn Field, part: Box3, look: &Look, job: &Job) -> Result<Picture> {
    let window = match args.window {
        Some(window) => window,
        None => {
            let range = field.range(part)?;
            let (low, high) = (f64::from(range.min), f64::from(range.max));
            if !(low < high && (high - low).is_finite()) {
                return Err(Error::bad_input(format!(
                    "the values go from {low} to {high}: give a --window"
                )));
            }
            (low, high)
        }
    };
    // What is above the lower end is in the picture.
    let bounds = crossing_bounds(field, part, (window.0 as f32).next_up(), Inside::Above)?;
    let raster = Raster::new(look, &bounds, &job.budget)?;
    let rays = Rays::new(field, part, &job.budget)?;
    let samples = u64::from(look.width) * u64::from(look.height) * 4;
    let each = if args.max {
        size_of::<f32>()
    } else {
        size_of::<[f32; 4]>()
    };
    let _permit = job.budget.take(samples * each as u64, SEEN)?;
    // So that the end of a long work is not where it fails.
    let shading = job.budget.take(raster.shading_bytes(), SHADING)?;
    // A step of a ray through fog should not wait for a power.
    let linear: [f32; 256] = std::array::from_fn(|v| from_srgb([v as u8; 3]).x);
    let colour = |place: f32| colourmap::colour(args.map, place).map(|v| linear[usize::from(v)]);
    if args.max {
        let values = highest(&rays, &raster, &job.budget)?;
        drop(shading);
        let span = window.1 - window.0;
        let shown = |at: usize| {
            let value = values[at];
            if value.is_nan() {
                return [0.0; 4];
            }
            let place = ((f64::from(value) - window.0) / span).clamp(0.0, 1.0) as f32;
            let [r, g, b] = colour(place);
            [r, g, b, 1.0]
        };
        return raster.behind(shown, &job.budget);
    }
    let how = Fog {
        window,
        opacity: args.opacity,
        colour: &colour,
    };
    let seen = fog(&rays, &raster, &how, &job.budget)?;
    drop(shading);
    raster.behind(|at| seen[at], &job.budget)
}
