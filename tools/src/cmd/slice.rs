//! `slice`: one plane of samples as a picture.
//!
//! Across z the picture has x to the right and y down; across x or y it has z up.

use super::{pick, region};
use crate::Outcome;
use crate::args::{MapName, Slice};
use crate::colourmap;
use crate::job::Job;
use crate::output::{self, Replace};
use crate::picture::{self, Picture};
use brickmarch::{Box3, Budget, Error, Field, Grid, Kind, Result, Samples};
use serde_json::json;

/// Largest side of a picture.
const SIDE_MAX: f64 = 32_768.0;
/// Parts of the values that the default window leaves black and white.
const CLIPPED: [f64; 2] = [0.005, 0.995];

pub(crate) fn run(args: &Slice) -> anyhow::Result<Outcome> {
    let replace = Replace::from(&args.overwrite);
    picture::check_png_name(&args.out)?;
    output::check_target(&args.out, replace)?;
    let job = Job::new(&args.run);
    let volume = pick::open(&args.volume, &args.pick, &job.budget)?;
    let region = region::resolve(&args.region, volume.grid())
        .map_err(|e| e.context(args.volume.display()))?
        .unwrap_or(volume.grid().domain);
    let axis = args.axis as usize;
    let index = match (args.index, args.position) {
        (Some(index), _) => index,
        (None, Some(position)) => nearest_slice(volume.grid(), region, axis, position),
        (None, None) => region.min[axis] + (region.size()[axis] / 2) as i32,
    };
    let options = Options {
        axis,
        index,
        window: args.window,
        map: args.map.unwrap_or(match volume.kind() {
            Kind::Label => MapName::Labels,
            _ => MapName::Grey,
        }),
        scale: args.scale,
    };
    let drawn = draw(&volume, region, &options, &job.budget)
        .map_err(|e| e.context(args.volume.display()))?;
    let bytes = drawn.picture.write_png(&args.out, replace)?;
    let (width, height) = (drawn.picture.width, drawn.picture.height);
    let (low, high) = drawn.window;
    let axis_name = ["x", "y", "z"][axis];
    let text = format!(
        "{}: slice {axis_name} = {index}, {width} x {height} pixels, values {low} to {high}\n",
        args.out.display()
    );
    let json = json!({
        "schema": 1, "command": "slice", "out": args.out, "axis": axis_name, "index": index,
        "width": width, "height": height, "window": [low, high], "bytes_out": bytes,
        "blocks_decoded": volume.blocks_decoded(), "seconds": job.seconds(),
        "peak_rss_bytes": crate::system::peak_resident_bytes(),
    });
    job.result(&text, &json)?;
    Ok(pick::outcome(&volume, &args.volume, &job))
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

/// What a slice shows.
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
    let plane = plane(region, options)?;
    let samples = plane.count();
    let _permit = budget.take(
        samples.saturating_mul(8),
        "the slice (a smaller --roi takes less)",
    )?;
    let mut values = vec![0f32; samples as usize];
    read_by_blocks(field, plane, &mut values, budget)?;

    let window = match options.window {
        Some(window) => window,
        None => percentiles(&values),
    };
    let size = sides(options.axis).map(|a| plane.size()[a] as usize);
    let pixels = pixels(field.grid(), plane, options)?;
    let _paper = budget.take(
        u64::from(pixels[0]) * u64::from(pixels[1]) * 3,
        "the picture (a smaller --scale takes less)",
    )?;
    let look = Pen {
        values: &values,
        size,
        window,
        map: options.map,
        up: options.axis != 2,
    };
    Ok(Drawn {
        picture: look.paint(pixels),
        window,
    })
}

/// The axes to the right and down (or up) of a slice across `axis`.
fn sides(axis: usize) -> [usize; 2] {
    [[1, 2], [0, 2], [0, 1]][axis]
}

/// The samples of a slice of `region`.
///
/// # Errors
/// When the slice is not in the region.
pub(crate) fn plane(region: Box3, options: &Options) -> Result<Box3> {
    let (axis, index) = (options.axis, options.index);
    if index < region.min[axis] || index >= region.max[axis] {
        return Err(Error::bad_input(format!(
            "slice {} = {index} is outside of {}..{}",
            ["x", "y", "z"][axis],
            region.min[axis],
            region.max[axis]
        )));
    }
    let mut plane = region;
    plane.min[axis] = index;
    plane.max[axis] = index + 1;
    Ok(plane)
}

/// Size of the picture of a plane, by the spacing of the samples.
///
/// # Errors
/// When it has a side that is too long.
pub(crate) fn pixels(grid: &Grid, plane: Box3, options: &Options) -> Result<[u32; 2]> {
    let spacing = grid.index_to_world.spacing();
    let sides = sides(options.axis);
    let fine = spacing[sides[0]].min(spacing[sides[1]]);
    let pixels = sides.map(|a| {
        (f64::from(plane.size()[a]) * spacing[a] / fine * options.scale)
            .round()
            .max(1.0)
    });
    if pixels.iter().any(|&p| p > SIDE_MAX) {
        return Err(Error::bad_input(format!(
            "the picture would have {} x {} pixels, more than {SIDE_MAX} on a side: give a smaller --scale or --roi",
            pixels[0], pixels[1]
        )));
    }
    Ok(pixels.map(|p| p as u32))
}

/// Reads the plane block by block, so that a large one can be stopped.
fn read_by_blocks(field: &dyn Field, plane: Box3, out: &mut [f32], budget: &Budget) -> Result<()> {
    let edge = field.block_edge() as i32;
    let row = plane.size()[0] as usize;
    let slice = row * plane.size()[1] as usize;
    let origin = field.grid().domain.min;
    // Strips along x: a block row at a time.
    let next =
        |at: i32, a: usize| (origin[a] + ((at - origin[a]) / edge + 1) * edge).min(plane.max[a]);
    let mut k = plane.min[2];
    while k < plane.max[2] {
        let mut j = plane.min[1];
        while j < plane.max[1] {
            budget.check_cancelled()?;
            let strip = Box3::new([plane.min[0], j, k], [plane.max[0], next(j, 1), next(k, 2)]);
            let start = plane.offset_of(strip.min);
            let mut samples = Samples {
                values: &mut out[start..],
                row,
                slice,
            };
            field.read(strip, &mut samples)?;
            j = strip.max[1];
        }
        k = next(k, 2);
    }
    Ok(())
}

/// The values below and above which half a percent of the finite values lie.
fn percentiles(values: &[f32]) -> (f64, f64) {
    let mut finite: Vec<f32> = values.iter().copied().filter(|v| v.is_finite()).collect();
    if finite.is_empty() {
        return (0.0, 1.0);
    }
    let last = finite.len() - 1;
    let mut at = |part: f64| {
        let n = (part * last as f64).round() as usize;
        f64::from(*finite.select_nth_unstable_by(n, f32::total_cmp).1)
    };
    let (low, high) = (at(CLIPPED[0]), at(CLIPPED[1]));
    if low < high {
        return (low, high);
    }
    // Nearly everything has one value: show the rest as well.
    let (min, max) = (at(0.0), at(1.0));
    if min < max {
        (min, max)
    } else {
        (min - 0.5, min + 0.5)
    }
}

/// Paints values.
struct Pen<'a> {
    values: &'a [f32],
    size: [usize; 2],
    window: (f64, f64),
    map: MapName,
    up: bool,
}

impl Pen<'_> {
    fn paint(&self, pixels: [u32; 2]) -> Picture {
        let [w, h] = pixels.map(|p| p as usize);
        let grey = self.map == MapName::Grey && self.values.iter().all(|v| !v.is_nan());
        let mut picture = Picture::with_channels(pixels[0], pixels[1], if grey { 1 } else { 3 });
        let channels = picture.channels;
        for (y, row) in picture.bytes.chunks_exact_mut(w * channels).enumerate() {
            let y = if self.up { h - 1 - y } else { y };
            // Pixel centres to sample positions: samples lie in the middle of their cells.
            let v = (y as f64 + 0.5) / h as f64 * self.size[1] as f64 - 0.5;
            for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
                let u = (x as f64 + 0.5) / w as f64 * self.size[0] as f64 - 0.5;
                self.dot(u, v, pixel);
            }
        }
        picture
    }

    fn dot(&self, u: f64, v: f64, pixel: &mut [u8]) {
        if self.map == MapName::Labels {
            let id = self.value(u.round(), v.round());
            pixel.copy_from_slice(&colourmap::label(id.abs() as u32));
            return;
        }
        let value = self.between(u, v);
        let place = (f64::from(value) - self.window.0) / (self.window.1 - self.window.0);
        if pixel.len() == 1 {
            pixel[0] = colourmap::grey(place as f32);
        } else if value.is_nan() {
            pixel.copy_from_slice(&[255, 0, 200]);
        } else {
            pixel.copy_from_slice(&colourmap::colour(self.map, place as f32));
        }
    }

    fn value(&self, u: f64, v: f64) -> f32 {
        let clamp = |t: f64, n: usize| (t.max(0.0) as usize).min(n - 1);
        self.values[clamp(u, self.size[0]) + self.size[0] * clamp(v, self.size[1])]
    }

    /// Bilinear where all four neighbours are finite, the nearest otherwise.
    fn between(&self, u: f64, v: f64) -> f32 {
        let (u0, v0) = (u.floor(), v.floor());
        let (s, t) = ((u - u0) as f32, (v - v0) as f32);
        if s == 0.0 && t == 0.0 {
            return self.value(u0, v0);
        }
        let corner = |du: f64, dv: f64| self.value(u0 + du, v0 + dv);
        let low = corner(0.0, 0.0) * (1.0 - s) + corner(1.0, 0.0) * s;
        let high = corner(0.0, 1.0) * (1.0 - s) + corner(1.0, 1.0) * s;
        let mixed = low * (1.0 - t) + high * t;
        if mixed.is_finite() {
            mixed
        } else {
            self.value(u.round(), v.round())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use brickmarch::{Affine, field::Dense};

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

    #[test]
    fn windows_of_odd_values() {
        assert_eq!(percentiles(&[]), (0.0, 1.0));
        assert_eq!(percentiles(&[f32::NAN, 3.0]), (2.5, 3.5));
        let mut mask = vec![0.0; 10_000];
        mask[7] = 1.0;
        assert_eq!(percentiles(&mask), (0.0, 1.0));
    }
}
