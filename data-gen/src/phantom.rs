//! A chest as a CT scanner would see it: Hounsfield units in `i16`, with noise in every voxel.
//!
//! Organs are ellipsoids, elliptic cylinders and an elliptic shell, laid over each other in order.
//! An organ's weight falls from 1 to 0 over about two voxels, as partial volumes do in scans. The
//! noise is a hash of the voxel's place: sum of four bytes, about normal, standard deviation 18 HU.

use crate::fields::{scale_of, to_i16_value};
use crate::rng::hash_point;

/// Radiodensity where there is nothing.
const AIR: f32 = -1000.0;

/// Smallest and largest value that scanners write.
const LIMITS: (f32, f32) = (-1024.0, 3071.0);

/// Hounsfield units per unit of the noise sum.
const NOISE: f32 = 0.12;

/// Largest noise: four bytes of 255 or 0 about their mean 510.
const NOISE_MAX: f32 = 510.0 * NOISE;

/// Form of an organ around `q`, the squared distance from its centre in units of its radii.
#[derive(Clone, Copy, Debug)]
enum Form {
    /// Where q is below 1.
    Solid,
    /// Where q is near 1, in bands along z.
    Ribs { half_width: f32, bands: f32 },
}

/// Description in shares of half the scale, about the centre of the domain.
struct Plan {
    center: [f64; 3],
    /// Infinite for a cylinder.
    radii: [f64; 3],
    hounsfield: f32,
    form: Form,
}

const LONG: f64 = f64::INFINITY;

const PLANS: [Plan; 7] = [
    // body
    Plan {
        center: [0.0, 0.0, 0.0],
        radii: [0.86, 0.62, LONG],
        hounsfield: 40.0,
        form: Form::Solid,
    },
    // lungs
    Plan {
        center: [-0.37, -0.05, 0.05],
        radii: [0.26, 0.36, 0.72],
        hounsfield: -820.0,
        form: Form::Solid,
    },
    Plan {
        center: [0.37, -0.05, 0.0],
        radii: [0.25, 0.35, 0.74],
        hounsfield: -820.0,
        form: Form::Solid,
    },
    // heart
    Plan {
        center: [0.1, -0.14, -0.12],
        radii: [0.22, 0.24, 0.29],
        hounsfield: 60.0,
        form: Form::Solid,
    },
    // ribs
    Plan {
        center: [0.0, -0.02, 0.0],
        radii: [0.74, 0.5, LONG],
        hounsfield: 600.0,
        form: Form::Ribs {
            half_width: 0.09,
            bands: 9.0,
        },
    },
    // spine and its canal
    Plan {
        center: [0.0, 0.36, 0.0],
        radii: [0.13, 0.11, LONG],
        hounsfield: 520.0,
        form: Form::Solid,
    },
    Plan {
        center: [0.0, 0.44, 0.0],
        radii: [0.05, 0.045, LONG],
        hounsfield: 20.0,
        form: Form::Solid,
    },
];

/// An organ with its tables.
#[derive(Clone, Debug)]
struct Organ {
    hounsfield: f32,
    form: Form,
    /// Share of q per axis and lattice point.
    q: [Vec<f32>; 3],
    /// Weight per unit of q at the surface.
    slope: f32,
    /// Weight per slice: the bands of ribs, 1 otherwise.
    along_z: Vec<f32>,
}

impl Organ {
    fn new(plan: &Plan, size: [u32; 3]) -> Self {
        let half = f64::from(scale_of(size)) / 2.0;
        let place = |a: usize, i: u32| (f64::from(i) - f64::from(size[a] - 1) / 2.0) / half;
        let q = std::array::from_fn(|a| {
            let share = |i| ((place(a, i) - plan.center[a]) / plan.radii[a]).powi(2) as f32;
            (0..size[a]).map(share).collect()
        });
        let thinnest = plan.radii.iter().fold(LONG, |a, &b| a.min(b));
        let along_z = match plan.form {
            Form::Solid => vec![1.0; size[2] as usize],
            Form::Ribs { bands, .. } => (0..size[2])
                .map(|k| triangle_wave(place(2, k) * f64::from(bands) / 2.0))
                .collect(),
        };
        Self {
            hounsfield: plan.hounsfield,
            form: plan.form,
            q,
            // Near the surface q changes by 2 / radius per voxel; two voxels for the whole edge.
            slope: (thinnest * half / 4.0) as f32,
            along_z,
        }
    }

    /// Largest weight at `q` in a slice, before it is cut to 0..1.
    #[inline]
    fn weight(&self, q: f32, along_z: f32) -> f32 {
        match self.form {
            Form::Solid => solid_weight(q, self.slope),
            Form::Ribs { half_width, .. } => shell_weight(q, half_width, self.slope) * along_z,
        }
    }

    fn blend_row(&self, j: usize, k: usize, i0: usize, out: &mut [f32]) {
        let q_yz = self.q[1][j] + self.q[2][k];
        let along_z = self.along_z[k];
        let (slope, hounsfield) = (self.slope, self.hounsfield);
        let row = &self.q[0][i0..i0 + out.len()];
        match self.form {
            // A weight of zero changes nothing, and q only grows along x.
            Form::Solid if solid_weight(q_yz, slope) == 0.0 => {}
            Form::Ribs { .. } if along_z == 0.0 => {}
            Form::Solid => {
                for (value, &q) in out.iter_mut().zip(row) {
                    *value = blend(*value, hounsfield, solid_weight(q + q_yz, slope));
                }
            }
            Form::Ribs { half_width, .. } => {
                for (value, &q) in out.iter_mut().zip(row) {
                    let weight = shell_weight(q + q_yz, half_width, slope) * along_z;
                    *value = blend(*value, hounsfield, weight);
                }
            }
        }
    }

    /// Smallest and largest weight over the lattice points `low..=high`.
    fn weight_range(&self, low: [usize; 3], high: [usize; 3]) -> (f32, f32) {
        let axis = |a: usize| convex_range(&self.q[a][low[a]..=high[a]]);
        let (x, y, z) = (axis(0), axis(1), axis(2));
        let near = x.0 + (y.0 + z.0);
        let far = x.1 + (y.1 + z.1);
        let bands = &self.along_z[low[2]..=high[2]];
        let band = bands
            .iter()
            .fold((1.0f32, 0.0f32), |r, &b| (r.0.min(b), r.1.max(b)));
        match self.form {
            Form::Solid => (self.weight(far, 1.0), self.weight(near, 1.0)),
            Form::Ribs { .. } => {
                let ends = (self.weight(near, 1.0), self.weight(far, 1.0));
                let top = if near <= 1.0 && far >= 1.0 {
                    self.weight(1.0, 1.0)
                } else {
                    ends.0.max(ends.1)
                };
                (ends.0.min(ends.1) * band.0, top * band.1)
            }
        }
    }
}

#[inline]
fn solid_weight(q: f32, slope: f32) -> f32 {
    (0.5 + (1.0 - q) * slope).clamp(0.0, 1.0)
}

#[inline]
fn shell_weight(q: f32, half_width: f32, slope: f32) -> f32 {
    (0.5 + (half_width - (q - 1.0).abs()) * slope).clamp(0.0, 1.0)
}

#[inline]
fn blend(below: f32, above: f32, weight: f32) -> f32 {
    below + weight * (above - below)
}

/// Period 1, flat at 0 and 1 for a quarter of it each, straight between.
fn triangle_wave(at: f64) -> f32 {
    let part = at - at.floor();
    let height = 1.0 - (2.0 * part - 1.0).abs();
    (2.0 * height - 0.5).clamp(0.0, 1.0) as f32
}

/// Range of a table that falls and then rises, over one stretch of it.
fn convex_range(values: &[f32]) -> (f32, f32) {
    let last = values.len() - 1;
    // The lowest point by bisection on the sign of the slope.
    let (mut a, mut b) = (0, last);
    while a < b {
        let middle = a.midpoint(b);
        if values[middle + 1] < values[middle] {
            a = middle + 1;
        } else {
            b = middle;
        }
    }
    (values[a], values[0].max(values[last]))
}

/// The scan.
#[derive(Clone, Debug)]
pub(crate) struct Phantom {
    organs: Vec<Organ>,
}

impl Phantom {
    pub(crate) fn scene(size: [u32; 3]) -> Self {
        Self {
            organs: PLANS.iter().map(|plan| Organ::new(plan, size)).collect(),
        }
    }

    pub(crate) fn value(&self, i: usize, j: usize, k: usize) -> f32 {
        let mut value = AIR;
        for organ in &self.organs {
            let q = organ.q[0][i] + (organ.q[1][j] + organ.q[2][k]);
            value = blend(value, organ.hounsfield, organ.weight(q, organ.along_z[k]));
        }
        finish(value, i as u32, row_seed(j, k))
    }

    pub(crate) fn fill_row(&self, j: usize, k: usize, i0: usize, out: &mut [f32]) {
        out.fill(AIR);
        for organ in &self.organs {
            organ.blend_row(j, k, i0, out);
        }
        let seed = row_seed(j, k);
        for (at, value) in out.iter_mut().enumerate() {
            *value = finish(*value, (i0 + at) as u32, seed);
        }
    }

    pub(crate) fn range(&self, low: [usize; 3], high: [usize; 3]) -> (f32, f32) {
        // Rounding of the blends in f32, well covered.
        let margin = 0.01;
        let (mut lo, mut hi) = (AIR, AIR);
        for organ in &self.organs {
            let (light, heavy) = organ.weight_range(low, high);
            // A blend is linear in the value and in the weight: its extremes are at the ends.
            let ends = |v: f32| {
                let (a, b) = (
                    blend(v, organ.hounsfield, light),
                    blend(v, organ.hounsfield, heavy),
                );
                (a.min(b), a.max(b))
            };
            (lo, hi) = (ends(lo).0, ends(hi).1);
        }
        let cut = |v: f32| to_i16_value(v.clamp(LIMITS.0, LIMITS.1));
        (cut(lo - NOISE_MAX - margin), cut(hi + NOISE_MAX + margin))
    }
}

fn row_seed(j: usize, k: usize) -> u32 {
    hash_point(7, 0, j as u32, k as u32) as u32
}

/// Adds the noise of voxel `i` of a row and rounds.
#[inline]
fn finish(value: f32, i: u32, seed: u32) -> f32 {
    let mut bits = i.wrapping_mul(0x9e37_79b1) ^ seed;
    bits = (bits ^ (bits >> 15)).wrapping_mul(0x85eb_ca77);
    bits = (bits ^ (bits >> 13)).wrapping_mul(0xc2b2_ae3d);
    bits ^= bits >> 16;
    let pairs = (bits & 0x00ff_00ff) + (bits >> 8 & 0x00ff_00ff);
    let sum = (pairs & 0xffff) + (pairs >> 16);
    let noisy = value + NOISE * (sum as i32 - 510) as f32;
    to_i16_value(noisy.clamp(LIMITS.0, LIMITS.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_the_stated_spread() {
        let values: Vec<f32> = (0..100_000)
            .map(|i| finish(0.0, i, row_seed(3, 4)))
            .collect();
        let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / 1e5;
        let square = values.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>() / 1e5;
        assert!(mean.abs() < 0.3, "{mean}");
        assert!((square.sqrt() - 17.7).abs() < 0.3, "{}", square.sqrt());
        assert!(values.iter().all(|v| v.abs() <= NOISE_MAX + 0.5));
    }

    #[test]
    fn organs_are_where_they_should_be() {
        let n = 128;
        let phantom = Phantom::scene([n; 3]);
        let at = |x: f64, y: f64, z: f64| {
            let index = |v: f64| (v * 64.0 + 63.5) as usize;
            phantom.value(index(x), index(y), index(z))
        };
        let near = |value: f32, hounsfield: f32| (value - hounsfield).abs() <= NOISE_MAX + 1.0;
        assert!(at(-0.97, -0.97, 0.0) < -930.0);
        assert!(near(at(-0.37, 0.0, 0.0), -820.0));
        assert!(near(at(0.1, -0.14, -0.12), 60.0));
        assert!(near(at(0.0, 0.34, 0.3), 520.0));
        assert!(near(at(0.0, 0.44, 0.3), 20.0));
        let ribs = (0..n as usize).map(|k| phantom.value(111, 64, k));
        let bone = ribs.filter(|&v| v > 250.0).count();
        assert!(
            (20..110).contains(&bone),
            "{bone} slices of bone along a rib line"
        );
    }
}
