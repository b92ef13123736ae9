//! The trilinear surface around a tile: places in fixed point, the interpolant, the metric.
//!
//! Places are whole multiples of 2^-20 of a cell, counted from the first sample of the tile.
//! Differences of places are then exact, and the same from every tile.

use super::super::block::BlockSamples;
use crate::lattice::Affine;

/// A place in units of 2^-20 of a cell.
pub(super) type Place = [i32; 3];

/// Fractional bits of a [`Place`].
pub(super) const FINE: u32 = 20;

/// Units of a place in a cell.
pub(super) const UNIT: f32 = (1 << FINE) as f32;

/// `a + d`, with `d` in cells.
#[inline(always)]
pub(super) fn moved(a: Place, d: [f32; 3]) -> Place {
    [
        a[0].wrapping_add(whole(d[0])),
        a[1].wrapping_add(whole(d[1])),
        a[2].wrapping_add(whole(d[2])),
    ]
}

/// The nearest whole number of units, half away from nought: one conversion on every processor.
#[inline(always)]
pub(super) fn whole(cells: f32) -> i32 {
    (cells * UNIT + 0.5f32.copysign(cells)) as i32
}

/// `b - a` in cells.
#[inline(always)]
pub(super) fn step(a: Place, b: Place) -> [f32; 3] {
    [
        b[0].wrapping_sub(a[0]) as f32 * (1.0 / UNIT),
        b[1].wrapping_sub(a[1]) as f32 * (1.0 / UNIT),
        b[2].wrapping_sub(a[2]) as f32 * (1.0 / UNIT),
    ]
}

#[inline(always)]
pub(super) fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(super) fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

#[inline(always)]
pub(super) fn scaled(a: [f32; 3], s: f32) -> [f32; 3] {
    [a[0] * s, a[1] * s, a[2] * s]
}

#[inline(always)]
pub(super) fn sum(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Lengths and angles of the world, in units of the smallest spacing: a triangular matrix that is
/// the map from the lattice to the world but for a rotation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Metric {
    /// Upper triangle, by rows: 00 01 02 11 12 22.
    to: [f32; 6],
    back: [f32; 6],
}

impl Metric {
    pub(super) fn new(map: &Affine) -> Self {
        let m = &map.rows;
        let small = map.spacing().into_iter().fold(f64::INFINITY, f64::min);
        let gram = |a: usize, b: usize| -> f64 {
            (0..3).map(|r| m[r][a] / small * (m[r][b] / small)).sum()
        };
        let a = gram(0, 0).sqrt();
        let (b, c) = (gram(0, 1) / a, gram(0, 2) / a);
        let d = (gram(1, 1) - b * b).sqrt();
        let e = (gram(1, 2) - b * c) / d;
        let f = (gram(2, 2) - c * c - e * e).sqrt();
        let f = if map.is_left_handed() { -f } else { f };
        let back = [
            1.0 / a,
            -b / (a * d),
            (b * e - c * d) / (a * d * f),
            1.0 / d,
            -e / (d * f),
            1.0 / f,
        ];
        Self {
            to: [a, b, c, d, e, f].map(|v| v as f32),
            back: back.map(|v| v as f32),
        }
    }

    /// From steps in cells to steps in the world.
    #[inline(always)]
    pub(super) fn world(&self, v: [f32; 3]) -> [f32; 3] {
        apply(&self.to, v)
    }

    /// From steps in the world to steps in cells.
    #[inline(always)]
    pub(super) fn cells(&self, v: [f32; 3]) -> [f32; 3] {
        apply(&self.back, v)
    }

    /// From a gradient by cells to a gradient in the world.
    #[inline(always)]
    pub(super) fn gradient(&self, g: [f32; 3]) -> [f32; 3] {
        let m = &self.back;
        [
            m[0] * g[0],
            m[1] * g[0] + m[3] * g[1],
            m[2] * g[0] + m[4] * g[1] + m[5] * g[2],
        ]
    }
}

#[inline(always)]
fn apply(m: &[f32; 6], v: [f32; 3]) -> [f32; 3] {
    [
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[3] * v[1] + m[4] * v[2],
        m[5] * v[2],
    ]
}

/// The interpolant of an array of samples.
#[derive(Clone, Copy)]
pub(super) struct Surface<'a> {
    values: &'a [f32],
    /// Samples per axis.
    size: [i32; 3],
    iso: f32,
    pub(super) metric: Metric,
}

impl<'a> Surface<'a> {
    /// `samples` with one more on every side than its size says, all of which are used.
    pub(super) fn new(samples: &'a BlockSamples, iso: f32, metric: Metric) -> Self {
        Self {
            values: &samples.values,
            size: samples.size.map(|n| n as i32 + 2),
            iso,
            metric,
        }
    }

    /// The interpolant less the isovalue and its gradient by cells, both scaled so that the largest
    /// corner of the cell is one. On the face between two cells `low` chooses the lower one, per
    /// axis. Not finite where a corner is not.
    #[inline(always)]
    pub(super) fn at(&self, place: Place, low: [i32; 3]) -> Option<(f32, [f32; 3])> {
        let at = [
            (place[0] >> FINE) - low[0],
            (place[1] >> FINE) - low[1],
            (place[2] >> FINE) - low[2],
        ];
        let inside = |a: usize| at[a] >= 0 && at[a] < self.size[a] - 1;
        if !(inside(0) && inside(1) && inside(2)) {
            return None;
        }
        let part = |a: usize| (place[a] - (at[a] << FINE)) as f32 * (1.0 / UNIT);
        let w = [part(0), part(1), part(2)];
        let row = self.size[0] as usize;
        let slice = row * self.size[1] as usize;
        let first = at[0] as usize + row * at[1] as usize + slice * at[2] as usize;
        let near = &self.values[first..first + slice + row + 2];
        let offset = |i: usize| near[i] - self.iso;
        let v = [
            offset(0),
            offset(1),
            offset(row),
            offset(row + 1),
            offset(slice),
            offset(slice + 1),
            offset(slice + row),
            offset(slice + row + 1),
        ];
        let largest = v.iter().fold(0.0f32, |m, x| m.max(x.abs()));
        let scale = 1.0 / largest;
        let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let along = [v[1] - v[0], v[3] - v[2], v[5] - v[4], v[7] - v[6]];
        let x = [
            v[0] + along[0] * w[0],
            v[2] + along[1] * w[0],
            v[4] + along[2] * w[0],
            v[6] + along[3] * w[0],
        ];
        let y = [x[1] - x[0], x[3] - x[2]];
        let (near, far) = (x[0] + y[0] * w[1], x[2] + y[1] * w[1]);
        let gx = mix(
            mix(along[0], along[1], w[1]),
            mix(along[2], along[3], w[1]),
            w[2],
        );
        let g = [gx, mix(y[0], y[1], w[2]), far - near];
        Some((mix(near, far, w[2]) * scale, scaled(g, scale)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_metric_keeps_lengths_angles_and_hands() {
        let map = Affine {
            rows: [
                [0.3, 0.1, -0.2, 5.0],
                [0.0, 0.8, 0.3, 6.0],
                [0.4, 0.0, -1.1, 7.0],
            ],
        };
        for mirror in [1.0, -1.0] {
            let mut map = map;
            map.rows[1] = map.rows[1].map(|v| v * mirror);
            let metric = Metric::new(&map);
            let small = map.spacing().into_iter().fold(f64::INFINITY, f64::min);
            let world = |v: [f32; 3]| -> [f64; 3] {
                std::array::from_fn(|r| {
                    (0..3)
                        .map(|a| map.rows[r][a] * f64::from(v[a]))
                        .sum::<f64>()
                        / small
                })
            };
            let dot64 = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| a[i] * b[i]).sum::<f64>();
            let (u, v, w) = ([1.0, -2.0, 0.5], [0.3, 0.4, 3.0], [-1.0, 0.1, 0.2]);
            let ours = dot(metric.world(u), metric.world(v));
            assert!((f64::from(ours) - dot64(world(u), world(v))).abs() < 1e-5);
            let volume = dot(metric.world(u), cross(metric.world(v), metric.world(w)));
            let (a, b, c) = (world(u), world(v), world(w));
            let across: [f64; 3] = std::array::from_fn(|i| {
                let (j, k) = ((i + 1) % 3, (i + 2) % 3);
                b[j] * c[k] - b[k] * c[j]
            });
            assert!((f64::from(volume) - dot64(a, across)).abs() < 1e-4);
            let again = metric.cells(metric.world(u));
            assert!((0..3).all(|a| (again[a] - u[a]).abs() < 1e-5));
            // A gradient applied to a step is the same number on both sides.
            let g = metric.gradient([0.2, -0.7, 1.3]);
            assert!((dot(g, metric.world(v)) - dot([0.2, -0.7, 1.3], v)).abs() < 1e-5);
        }
    }

    #[test]
    fn the_interpolant_is_trilinear_and_scaled() {
        let samples = BlockSamples {
            origin: [0; 3],
            size: [1; 3],
            values: (0..27)
                .map(|i| {
                    let [x, y, z] = [i % 3, i / 3 % 3, i / 9].map(|v| v as f32);
                    3.0 * x * y - z + 0.5 * x * y * z - 2.0
                })
                .collect(),
            first: 13,
            step: [1, 3, 9],
        };
        let surface = Surface::new(&samples, 1.0, Metric::new(&Affine::IDENTITY));
        let p = [0.25f32, 1.5, 1.75];
        let place = p.map(|v| (v * UNIT) as i32);
        let (value, gradient) = surface.at(place, [0; 3]).expect("inside");
        let [x, y, z] = p;
        let exact = [
            3.0 * x * y - z + 0.5 * x * y * z - 3.0,
            3.0 * y + 0.5 * y * z,
            3.0 * x + 0.5 * x * z,
            -1.0 + 0.5 * x * y,
        ];
        for a in 0..3 {
            assert!((gradient[a] / value - exact[a + 1] / exact[0]).abs() < 1e-4);
        }
        let face = [UNIT as i32, 5, 5];
        let (low, high) = (surface.at(face, [1, 0, 0]), surface.at(face, [0; 3]));
        let ratio = |v: Option<(f32, [f32; 3])>| {
            let (value, gradient) = v.expect("inside");
            value / gradient[1]
        };
        assert!((ratio(low) - ratio(high)).abs() < 1e-5);
        assert!(surface.at([-1, 0, 0], [0; 3]).is_none());
        assert!(surface.at([2 << FINE, 0, 0], [0; 3]).is_none());
    }
}
