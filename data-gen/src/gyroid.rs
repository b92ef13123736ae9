//! The gyroid `f = sin x cos y + sin y cos z + sin z cos x`, raw and as a narrow band.
//!
//! Sines and cosines come from tables, so a sample costs two products and two sums. Samples are
//! evaluated in f32 from tables rounded from f64: within 4e-7 of the true value. Where symmetry makes
//! the true value zero, the sample is zero.
//!
//! Bounds used by the ranges, with the angle as the unit of length:
//! - `|f| <= 3/2`.
//! - `|grad f|^2 <= 3`: each component is the product of a unit vector with one of squared length
//!   `cos^2 + sin^2` of two other axes, and the three sum to 3.
//! - second derivatives: `|f_aa| <= sqrt 2`, `|f_ab| <= 1`; so the gradient changes by at most
//!   `sqrt 12` times the way.

use crate::fields::{BAND, GYROID_PERIODS, scale_of};
use crate::trig::sin_cos_turn;

/// Rounding of f in f32, well covered.
const MARGIN: f64 = 2e-6;

/// Half-sides in radians between which a box is cut in eight before it is bounded: below, the
/// bound is good as it is; above, nothing helps.
const CUT: (f64, f64) = (0.15, 1.3);

#[derive(Clone, Debug)]
pub(crate) struct Gyroid {
    sin: Vec<f32>,
    cos: Vec<f32>,
    /// `(sin, cos)` at every half step, for the centres of boxes.
    half: Vec<(f64, f64)>,
    /// Radians per voxel.
    k: f64,
}

/// Values that are the same along a row.
#[derive(Clone, Copy)]
struct Row {
    sin_y: f32,
    cos_y: f32,
    sin_z: f32,
    cos_z: f32,
    k: f32,
}

impl Row {
    #[inline]
    fn raw(&self, sin_x: f32, cos_x: f32) -> f32 {
        (sin_x * self.cos_y + self.sin_y * self.cos_z) + self.sin_z * cos_x
    }

    #[inline]
    fn band(&self, sin_x: f32, cos_x: f32) -> f32 {
        let f = self.raw(sin_x, cos_x);
        let gx = cos_x * self.cos_y - self.sin_z * sin_x;
        let gy = self.cos_y * self.cos_z - sin_x * self.sin_y;
        let gz = self.cos_z * cos_x - self.sin_y * self.sin_z;
        let length = self.k * (gx * gx + gy * gy + gz * gz).sqrt();
        (f / length.max(1e-12)).clamp(-BAND, BAND)
    }
}

impl Gyroid {
    pub(crate) fn scene(size: [u32; 3]) -> Self {
        let n = u64::from(scale_of(size));
        let longest = u64::from(size[0].max(size[1]).max(size[2]));
        let half: Vec<(f64, f64)> = (0..2 * longest)
            .map(|m| sin_cos_turn(u64::from(GYROID_PERIODS) * m, 2 * n))
            .collect();
        Self {
            sin: half.iter().step_by(2).map(|p| p.0 as f32).collect(),
            cos: half.iter().step_by(2).map(|p| p.1 as f32).collect(),
            half,
            k: std::f64::consts::TAU * f64::from(GYROID_PERIODS) / n as f64,
        }
    }

    fn row(&self, j: usize, k: usize) -> Row {
        Row {
            sin_y: self.sin[j],
            cos_y: self.cos[j],
            sin_z: self.sin[k],
            cos_z: self.cos[k],
            k: self.k as f32,
        }
    }

    pub(crate) fn value(&self, i: usize, j: usize, k: usize) -> f32 {
        self.row(j, k).raw(self.sin[i], self.cos[i])
    }

    pub(crate) fn band_value(&self, i: usize, j: usize, k: usize) -> f32 {
        self.row(j, k).band(self.sin[i], self.cos[i])
    }

    pub(crate) fn fill_row(&self, j: usize, k: usize, i0: usize, out: &mut [f32]) {
        let row = self.row(j, k);
        let end = i0 + out.len();
        let tables = self.sin[i0..end].iter().zip(&self.cos[i0..end]);
        for (value, (&s, &c)) in out.iter_mut().zip(tables) {
            *value = row.raw(s, c);
        }
    }

    pub(crate) fn fill_band_row(&self, j: usize, k: usize, i0: usize, out: &mut [f32]) {
        let row = self.row(j, k);
        let end = i0 + out.len();
        let tables = self.sin[i0..end].iter().zip(&self.cos[i0..end]);
        for (value, (&s, &c)) in out.iter_mut().zip(tables) {
            *value = row.band(s, c);
        }
    }

    pub(crate) fn range(&self, low: [usize; 3], high: [usize; 3]) -> (f32, f32) {
        let bound = self.cut(low, high, &|low, high| {
            let part = self.bound(low, high);
            (part.low, part.high)
        });
        (bound.0 as f32, bound.1 as f32)
    }

    pub(crate) fn band_range(&self, low: [usize; 3], high: [usize; 3]) -> (f32, f32) {
        let bound = self.cut(low, high, &|low, high| self.bound(low, high).band(self.k));
        // Rounding of quotient and root in f32, well covered.
        let margin = 1e-5;
        let wide = |v: f64, sign: f64| v + sign * margin * (1.0 + v.abs());
        let band = f64::from(BAND);
        // A box that is all beyond the band is exactly constant.
        let low = if bound.0 >= band * 1.001 {
            band
        } else {
            wide(bound.0, -1.0)
        };
        let high = if bound.1 <= -band * 1.001 {
            -band
        } else {
            wide(bound.1, 1.0)
        };
        (
            low.clamp(-band, band) as f32,
            high.clamp(-band, band) as f32,
        )
    }

    /// The union of `bound` over the eight parts of a box when that is worth it, or of the box.
    fn cut(
        &self,
        low: [usize; 3],
        high: [usize; 3],
        bound: &dyn Fn([usize; 3], [usize; 3]) -> (f64, f64),
    ) -> (f64, f64) {
        let half_sides: [f64; 3] =
            std::array::from_fn(|a| self.k * (high[a] - low[a]) as f64 / 2.0);
        let longest = half_sides.iter().fold(0.0, |a: f64, &b| a.max(b));
        if !(CUT.0..CUT.1).contains(&longest) {
            return bound(low, high);
        }
        let mut all = (f64::INFINITY, f64::NEG_INFINITY);
        for part in 0..8usize {
            let mut part_low = low;
            let mut part_high = high;
            for a in 0..3 {
                let middle = low[a].midpoint(high[a]);
                if part >> a & 1 == 0 {
                    part_high[a] = middle;
                } else {
                    part_low[a] = (middle + 1).min(high[a]);
                }
            }
            let (lo, hi) = bound(part_low, part_high);
            all = (all.0.min(lo), all.1.max(hi));
        }
        all
    }

    /// Bounds of f and of the length of its gradient over the lattice points `low..=high`.
    fn bound(&self, low: [usize; 3], high: [usize; 3]) -> Bound {
        let h: [f64; 3] = std::array::from_fn(|a| self.k * (high[a] - low[a]) as f64 / 2.0);
        let [(sx, cx), (sy, cy), (sz, cz)] = std::array::from_fn(|a| self.half[low[a] + high[a]]);
        let f = sx * cy + sy * cz + sz * cx;
        let g = [cx * cy - sz * sx, cy * cz - sx * sy, cz * cx - sy * sz];
        let squares = h[0] * h[0] + h[1] * h[1] + h[2] * h[2];
        let products = h[0] * h[1] + h[1] * h[2] + h[2] * h[0];
        let rest = (0.5 * std::f64::consts::SQRT_2) * squares + products;
        let linear = g[0].abs() * h[0] + g[1].abs() * h[1] + g[2].abs() * h[2];
        let diagonal = squares.sqrt();
        let reach = (linear + rest).min(3f64.sqrt() * diagonal) + MARGIN;
        let length = (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]).sqrt();
        Bound {
            low: (f - reach).max(-1.5 - MARGIN),
            high: (f + reach).min(1.5 + MARGIN),
            gradient_low: (length - 12f64.sqrt() * diagonal - MARGIN).max(0.0),
            gradient_high: (length + 12f64.sqrt() * diagonal + MARGIN).min(3f64.sqrt()),
        }
    }
}

struct Bound {
    low: f64,
    high: f64,
    gradient_low: f64,
    gradient_high: f64,
}

impl Bound {
    /// Bounds of f divided by the length of its gradient, in voxels.
    fn band(&self, k: f64) -> (f64, f64) {
        let quotient = |f: f64, gradient: f64| f / (k * gradient).max(1e-12);
        let low = if self.low >= 0.0 {
            self.gradient_high
        } else {
            self.gradient_low
        };
        let high = if self.high >= 0.0 {
            self.gradient_low
        } else {
            self.gradient_high
        };
        (quotient(self.low, low), quotient(self.high, high))
    }
}
