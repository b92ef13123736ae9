//! A plane of samples as a picture: read along an axis or across the lattice, painted, with lines over it.

pub(crate) mod axis;
pub(crate) mod oblique;
pub(crate) mod overlay;
pub(crate) mod scale_bar;
pub(crate) mod svg;

use crate::args::MapName;
use crate::colourmap;
use crate::picture::Picture;
use brickmarch::iso::{Isolines, Raster, isolines};
use brickmarch::{Budget, Error, Inside, Permit, Result};
use oblique::Cover;

/// Largest side of a picture.
const SIDE_MAX: f64 = 32_768.0;
/// Parts of the values that the default window leaves black and white.
const CLIPPED: [f64; 2] = [0.005, 0.995];
/// What lies beyond the samples.
const PAPER: [u8; 3] = [255; 3];
/// NaN.
const NO_NUMBER: [u8; 3] = [255, 0, 200];

/// The values of a plane, and how they lie in the picture.
pub(crate) struct Sheet {
    values: Vec<f32>,
    size: [usize; 2],
    pixels: [u32; 2],
    /// Whether the second axis of the values goes up.
    up: bool,
    /// Length of a pixel in the world.
    pub unit: f64,
    /// Which of the values there are, if not all.
    cover: Option<Cover>,
    _permit: Permit,
}

/// The pixels of sides of these lengths.
///
/// # Errors
/// When a side is too long.
fn paper(sides: [f64; 2]) -> Result<[u32; 2]> {
    let pixels = sides.map(|p| p.round().max(1.0));
    if pixels.iter().any(|&p| p > SIDE_MAX) {
        return Err(Error::bad_input(format!(
            "the picture would have {} x {} pixels, more than {SIDE_MAX} on a side: give a smaller --scale or --roi",
            pixels[0], pixels[1]
        )));
    }
    Ok(pixels.map(|p| p as u32))
}

impl Sheet {
    /// The values below and above which half a percent of the finite values lie.
    pub(crate) fn window(&self) -> (f64, f64) {
        percentiles(&self.values)
    }

    /// The picture.
    ///
    /// # Errors
    /// `BudgetExceeded`.
    ///
    /// # Memory
    /// 3 bytes a pixel.
    pub(crate) fn paint(
        &self,
        map: MapName,
        window: (f64, f64),
        budget: &Budget,
    ) -> Result<Picture> {
        let [w, h] = self.pixels.map(|p| p as usize);
        let _paper = budget.take(
            (w * h * 3) as u64,
            "the picture (a smaller --scale takes less)",
        )?;
        let grey = map == MapName::Grey && self.values.iter().all(|v| !v.is_nan());
        let [width, height] = self.pixels;
        let mut picture = Picture::with_channels(width, height, if grey { 1 } else { 3 });
        let channels = picture.channels;
        for (y, row) in picture.bytes.chunks_exact_mut(w * channels).enumerate() {
            let y = if self.up { h - 1 - y } else { y };
            // Pixel centres to sample positions: samples lie in the middle of their cells.
            let v = (y as f64 + 0.5) / h as f64 * self.size[1] as f64 - 0.5;
            for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
                let u = (x as f64 + 0.5) / w as f64 * self.size[0] as f64 - 0.5;
                if self.cover.as_ref().is_some_and(|c| !c.has(x, y)) {
                    pixel.copy_from_slice(&PAPER);
                } else {
                    self.dot(u, v, map, window, pixel);
                }
            }
        }
        Ok(picture)
    }

    fn dot(&self, u: f64, v: f64, map: MapName, window: (f64, f64), pixel: &mut [u8]) {
        if map == MapName::Labels {
            let id = self.value(u.round(), v.round());
            pixel.copy_from_slice(&colourmap::label(id.abs() as u32));
            return;
        }
        let value = self.between(u, v);
        let place = (f64::from(value) - window.0) / (window.1 - window.0);
        if pixel.len() == 1 {
            pixel[0] = colourmap::grey(place as f32);
        } else if value.is_nan() {
            pixel.copy_from_slice(&NO_NUMBER);
        } else {
            pixel.copy_from_slice(&colourmap::colour(map, place as f32));
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

    /// The lines of an isovalue, in steps of the values. They end where the samples do.
    ///
    /// # Errors
    /// As [`isolines`].
    pub(crate) fn isolines(&self, iso: f32, inside: Inside, budget: &Budget) -> Result<Isolines> {
        let all = |x: usize, y: usize| {
            let Some(cover) = &self.cover else {
                return true;
            };
            [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)]
                .iter()
                .all(|&(x, y)| cover.has(x, y))
        };
        let raster = Raster {
            values: &self.values,
            size: self.size,
            squares: &all,
        };
        isolines(&raster, iso, inside, budget)
    }

    /// Where a position of the values is in the picture; pixel `n` reaches from `n` to `n + 1`.
    pub(crate) fn on_paper(&self, at: [f64; 2]) -> [f64; 2] {
        let [x, y] =
            [0, 1].map(|a| (at[a] + 0.5) / self.size[a] as f64 * f64::from(self.pixels[a]));
        [
            x,
            if self.up {
                f64::from(self.pixels[1]) - y
            } else {
                y
            },
        ]
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_of_odd_values() {
        assert_eq!(percentiles(&[]), (0.0, 1.0));
        assert_eq!(percentiles(&[f32::NAN, 3.0]), (2.5, 3.5));
        let mut mask = vec![0.0; 10_000];
        mask[7] = 1.0;
        assert_eq!(percentiles(&mask), (0.0, 1.0));
    }
}
