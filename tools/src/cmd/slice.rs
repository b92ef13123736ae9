//! `slice`: one plane of samples as a picture, with isolines and a scale bar.
//!
//! Across z the picture has x to the right and y down; across x or y it has z up.

use super::{pick, region};
use crate::Outcome;
use crate::args::{MapName, Slice, Space};
use crate::job::Job;
use crate::output::{self, Replace};
use crate::picture::Picture;
use crate::section::oblique::{self, Frame};
use crate::section::overlay::{self, Contour, hex};
use crate::section::scale_bar::ScaleBar;
use crate::section::{Sheet, axis, svg};
use brickmarch::query::Method;
use brickmarch::store::Volume;
use brickmarch::{Affine, Box3, Budget, Error, Field, Grid, Kind, Result};
use glam::DVec3;
use serde_json::{Value, json};
use std::path::Path;

/// What is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Png,
    Svg,
}

pub(crate) fn run(args: &Slice) -> anyhow::Result<Outcome> {
    let replace = Replace::from(&args.overwrite);
    let format = format_of(&args.out)?;
    if args.no_image && format == Format::Png {
        return Err(Error::bad_input(format!(
            "{}: --no-image leaves nothing of a PNG file: give it a name that ends in .svg",
            args.out.display()
        ))
        .into());
    }
    output::check_target(&args.out, replace)?;
    let job = Job::new(&args.run);
    let volume = pick::open(&args.volume, &args.pick, &job.budget)?;
    let blame = |e: Error| e.context(args.volume.display());
    let region = region::resolve(&args.region, volume.grid())
        .map_err(blame)?
        .unwrap_or(volume.grid().domain);
    let (sheet, place) = read(args, &volume, region, &job.budget).map_err(blame)?;
    let window = args.window.unwrap_or_else(|| match args.window_level {
        Some([width, level]) => (level - width / 2.0, level + width / 2.0),
        None => sheet.window(),
    });
    let map = map_of(args.map, volume.kind());
    let mut picture = sheet.paint(map, window, &job.budget).map_err(blame)?;
    let mut contours = Vec::new();
    for (n, &iso) in args.iso.iter().enumerate() {
        let lines = sheet
            .isolines(iso, volume.kind().inside(), &job.budget)
            .map_err(blame)?;
        contours.push(Contour::new(n, iso, args.line_colour, lines));
    }
    let size = [picture.width, picture.height];
    let bar = match args.scale_bar {
        true => Some(ScaleBar::new(size, sheet.unit, volume.grid().units).map_err(blame)?),
        false => None,
    };
    let bytes = match format {
        Format::Png => {
            draw_over(
                &mut picture,
                &sheet,
                &contours,
                args,
                bar.as_ref(),
                &job.budget,
            )?;
            picture.write_png(&args.out, replace)?
        }
        Format::Svg => output::write_whole(&args.out, replace, |file| {
            let image = (!args.no_image).then_some(&picture);
            let width = args.line_width;
            svg::write(file, size, image, &sheet, &contours, width, bar.as_ref())
        })?,
    };
    let (low, high) = window;
    let mut text = format!(
        "{}: slice {}, {} x {} pixels, values {low} to {high}\n",
        args.out.display(),
        place.text,
        size[0],
        size[1]
    );
    let mut json = json!({
        "schema": 1, "command": "slice", "out": args.out, "axis": place.axis, "index": place.index,
        "frame": place.frame, "width": size[0], "height": size[1], "window": [low, high],
        "pixel": sheet.unit, "bytes_out": bytes,
        "blocks_decoded": volume.blocks_decoded(), "seconds": job.seconds(),
        "peak_rss_bytes": crate::system::peak_resident_bytes(),
    });
    json["isolines"] = contours
        .iter()
        .map(|c| {
            let (lines, closed, length) = (c.lines.len(), c.closed(), c.length(&sheet));
            text += &format!(
                "  isoline {}: {lines} lines, {closed} closed, length {length:.6}, {}\n",
                c.iso,
                hex(c.colour)
            );
            json!({"iso": c.iso, "lines": lines, "closed": closed, "length": length, "colour": hex(c.colour)})
        })
        .collect();
    if let Some(bar) = &bar {
        json["scale_bar"] = json!({"length": bar.length, "pixels": bar.size[0]});
    }
    job.result(&text, &json)?;
    Ok(pick::outcome(&volume, &args.volume, &job))
}

fn format_of(path: &Path) -> Result<Format> {
    let extension = path.extension().map(|e| e.to_ascii_lowercase());
    match extension.as_deref().and_then(|e| e.to_str()) {
        Some("png") => Ok(Format::Png),
        Some("svg") => Ok(Format::Svg),
        _ => Err(Error::bad_input(format!(
            "{}: slices are written as PNG or SVG: give the file a name that ends in .png or .svg",
            path.display()
        ))),
    }
}

fn map_of(asked: Option<MapName>, kind: Kind) -> MapName {
    asked.unwrap_or(match kind {
        Kind::Label => MapName::Labels,
        _ => MapName::Grey,
    })
}

/// Which slice was read, for people and for programs.
struct Place {
    text: String,
    axis: Option<&'static str>,
    index: Option<i32>,
    frame: Value,
}

/// Reads the plane that was asked for.
fn read(args: &Slice, volume: &Volume, region: Box3, budget: &Budget) -> Result<(Sheet, Place)> {
    let grid = volume.grid();
    if let Some(frame) = frame(args, grid, region)? {
        let method = match (args.method, volume.kind()) {
            (Some(method), _) => method.into(),
            (None, Kind::Label) => Method::Nearest,
            (None, _) => Method::Trilinear,
        };
        let sheet = oblique::sheet(volume, &frame, region, args.scale, method, budget)?;
        let [through, right, up] = [frame.through, frame.right, frame.up].map(|v| v.to_array());
        let place = Place {
            text: format!("through {through:?}"),
            axis: None,
            index: None,
            frame: json!({"through": through, "right": right, "up": up}),
        };
        return Ok((sheet, place));
    }
    let axis = args.axis as usize;
    let index = match (args.index, args.position) {
        (Some(index), _) => index,
        (None, Some(position)) => nearest_slice(grid, region, axis, position),
        (None, None) => region.min[axis] + (region.size()[axis] / 2) as i32,
    };
    let plane = axis::plane(region, axis, index)?;
    let sheet = axis::sheet(volume, plane, axis, args.scale, budget)?;
    let name = ["x", "y", "z"][axis];
    let place = Place {
        text: format!("{name} = {index}"),
        axis: Some(name),
        index: Some(index),
        frame: Value::Null,
    };
    Ok((sheet, place))
}

/// The oblique plane that was asked for, if one was.
fn frame(args: &Slice, grid: &Grid, region: Box3) -> Result<Option<Frame>> {
    let map = match args.space {
        Space::World => Affine::IDENTITY,
        Space::Index => grid.index_to_world,
    };
    let point = |p: [f64; 3]| DVec3::from(map.apply(p));
    // A direction goes with the points, a normal stays across the plane.
    let direction = |v: [f64; 3]| point(v) - point([0.0; 3]);
    if !args.through.is_empty() {
        let points: [[f64; 3]; 3] = args.through.clone().try_into().map_err(|all: Vec<_>| {
            Error::bad_input(format!(
                "--through was given {} times: give it three times, once for each point of the plane",
                all.len()
            ))
        })?;
        return Frame::through(points.map(point)).map(Some);
    }
    let Some(normal) = args.normal else {
        return Ok(None);
    };
    let rows = map.gradient_rows();
    let normal = DVec3::from(rows.map(|r| r[0] * normal[0] + r[1] * normal[1] + r[2] * normal[2]));
    let middle = || {
        let index = std::array::from_fn(|a| {
            0.5 * (f64::from(region.min[a]) + f64::from(region.max[a] - 1))
        });
        DVec3::from(grid.index_to_world.apply(index))
    };
    let through = args.origin.map_or_else(middle, point);
    Frame::across(normal, args.up.map(direction), through).map(Some)
}

/// Draws what lies over the picture.
fn draw_over(
    picture: &mut Picture,
    sheet: &Sheet,
    contours: &[Contour],
    args: &Slice,
    bar: Option<&ScaleBar>,
    budget: &Budget,
) -> Result<()> {
    if !contours.is_empty() {
        overlay::draw(picture, sheet, contours, args.line_width, budget)?;
    }
    if let Some(bar) = bar {
        overlay::in_colour(picture);
        bar.draw(picture);
    }
    Ok(())
}

/// The slice across index axis `axis` whose middle is nearest to `position` on the world axis that
/// it follows best.
fn nearest_slice(grid: &Grid, region: Box3, axis: usize, position: f64) -> i32 {
    let rows = grid.index_to_world.rows;
    let world = (0..3)
        .max_by(|&a, &b| rows[a][axis].abs().total_cmp(&rows[b][axis].abs()))
        .expect("three axes");
    let mut middle: [f64; 3] =
        std::array::from_fn(|a| f64::from(region.min[a]) + f64::from(region.size()[a] - 1) / 2.0);
    middle[axis] = 0.0;
    let at_zero = grid.index_to_world.apply(middle)[world];
    ((position - at_zero) / rows[world][axis]).round() as i32
}

/// What a slice across an axis shows.
pub(crate) struct Options {
    pub axis: usize,
    pub index: i32,
    pub window: Option<(f64, f64)>,
    pub map: MapName,
    pub scale: f64,
}

/// A slice as a picture, and the window that it was shown in.
pub(crate) struct Drawn {
    pub picture: Picture,
    pub window: (f64, f64),
}

/// Draws the slice of `region`.
///
/// # Errors
/// When the slice is not in the region, or does not fit the budget.
///
/// # Memory
/// 8 bytes a sample of the slice and 3 a pixel.
pub(crate) fn draw(
    field: &dyn Field,
    region: Box3,
    options: &Options,
    budget: &Budget,
) -> Result<Drawn> {
    let plane = axis::plane(region, options.axis, options.index)?;
    let sheet = axis::sheet(field, plane, options.axis, options.scale, budget)?;
    let window = options.window.unwrap_or_else(|| sheet.window());
    Ok(Drawn {
        picture: sheet.paint(options.map, window, budget)?,
        window,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use brickmarch::field::Dense;

    fn ramp() -> Dense {
        let domain = Box3::from_size([40, 3, 5]);
        let values = (0..600).map(|i| (i % 40) as f32).collect();
        let grid = Grid {
            index_to_world: Affine::from_spacing([1.0, 1.0, 4.0], [0.0, 0.0, 100.0]),
            ..Grid::new(domain)
        };
        Dense::new(grid, values).expect("counts")
    }

    #[test]
    fn spacing_gives_the_aspect_ratio() {
        let field = ramp();
        let options = Options {
            axis: 1,
            index: 2,
            window: Some((0.0, 39.0)),
            map: MapName::Grey,
            scale: 2.0,
        };
        let drawn = draw(&field, field.grid().domain, &options, &Budget::mib(4))
            .expect("draws")
            .picture;
        assert_eq!((drawn.width, drawn.height), (80, 40));
        assert_eq!((drawn.bytes[0], drawn.bytes[79]), (0, 255));
        assert!(drawn.bytes[..80].is_sorted());
    }

    #[test]
    fn a_position_finds_its_slice() {
        let field = ramp();
        let domain = field.grid().domain;
        assert_eq!(nearest_slice(field.grid(), domain, 2, 107.0), 2);
        assert_eq!(nearest_slice(field.grid(), domain, 0, 3.4), 3);
    }
}
