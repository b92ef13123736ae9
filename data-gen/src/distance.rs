//! Exact distances: ball, two balls, torus.
//!
//! Evaluated in f64 from per-axis tables and rounded once. Every operation is monotonic in every
//! coordinate's distance from the centre, so the same operations on the nearest and the farthest
//! point of a box give a range that is conservative without any margin.

use crate::fields::scale_of;

/// Squared distance from a centre along one axis, per lattice point.
#[derive(Clone, Debug)]
struct Squares {
    table: Vec<f64>,
    center: f64,
}

impl Squares {
    fn new(size: u32, center: f64) -> Self {
        let square = |i| (f64::from(i) - center) * (f64::from(i) - center);
        Self {
            table: (0..size).map(square).collect(),
            center,
        }
    }

    /// Smallest and largest over the lattice points `low..=high`.
    fn range(&self, low: usize, high: usize) -> (f64, f64) {
        let nearest = |at: f64| self.table[(at.max(0.0) as usize).clamp(low, high)];
        (
            nearest(self.center.floor()).min(nearest(self.center.ceil())),
            self.table[low].max(self.table[high]),
        )
    }
}

/// Distance to a sphere.
#[derive(Clone, Debug)]
pub(crate) struct Ball {
    axes: [Squares; 3],
    radius: f64,
}

impl Ball {
    pub(crate) fn new(size: [u32; 3], center: [f64; 3], radius: f64) -> Self {
        Self {
            axes: std::array::from_fn(|a| Squares::new(size[a], center[a])),
            radius,
        }
    }

    pub(crate) fn scene(size: [u32; 3]) -> Self {
        Self::new(size, center_of(size), 0.4 * f64::from(scale_of(size)))
    }

    #[inline]
    fn distance(square_x: f64, square_yz: f64, radius: f64) -> f32 {
        ((square_x + square_yz).sqrt() - radius) as f32
    }

    pub(crate) fn value(&self, i: usize, j: usize, k: usize) -> f32 {
        let [x, y, z] = &self.axes;
        Self::distance(x.table[i], y.table[j] + z.table[k], self.radius)
    }

    pub(crate) fn fill_row(&self, j: usize, k: usize, i0: usize, out: &mut [f32]) {
        let [x, y, z] = &self.axes;
        let square_yz = y.table[j] + z.table[k];
        let radius = self.radius;
        let row = &x.table[i0..i0 + out.len()];
        for (value, &square_x) in out.iter_mut().zip(row) {
            *value = Self::distance(square_x, square_yz, radius);
        }
    }

    pub(crate) fn range(&self, low: [usize; 3], high: [usize; 3]) -> (f32, f32) {
        let [x, y, z] = std::array::from_fn(|a| self.axes[a].range(low[a], high[a]));
        (
            Self::distance(x.0, y.0 + z.0, self.radius),
            Self::distance(x.1, y.1 + z.1, self.radius),
        )
    }
}

/// Distance to the nearer of two spheres.
#[derive(Clone, Debug)]
pub(crate) struct TwoBalls([Ball; 2]);

/// Centre as a share of the domain, and radius as a share of the scale, of each sphere.
pub(crate) const TWO_BALLS: [([f64; 3], f64); 2] =
    [([0.3, 0.35, 0.4], 0.18), ([0.7, 0.65, 0.6], 0.2)];

impl TwoBalls {
    pub(crate) fn scene(size: [u32; 3]) -> Self {
        let n = f64::from(scale_of(size));
        Self(TWO_BALLS.map(|(share, radius)| {
            let center = std::array::from_fn(|a| share[a] * f64::from(size[a] - 1));
            Ball::new(size, center, radius * n)
        }))
    }

    pub(crate) fn value(&self, i: usize, j: usize, k: usize) -> f32 {
        self.0[0].value(i, j, k).min(self.0[1].value(i, j, k))
    }

    pub(crate) fn fill_row(&self, j: usize, k: usize, i0: usize, out: &mut [f32]) {
        let [first, second] = &self.0;
        let squares = |ball: &Ball| ball.axes[1].table[j] + ball.axes[2].table[k];
        let (first_yz, second_yz) = (squares(first), squares(second));
        let (first_r, second_r) = (first.radius, second.radius);
        let first_row = &first.axes[0].table[i0..i0 + out.len()];
        let second_row = &second.axes[0].table[i0..i0 + out.len()];
        for ((value, &a), &b) in out.iter_mut().zip(first_row).zip(second_row) {
            let near = Ball::distance(a, first_yz, first_r);
            let other = Ball::distance(b, second_yz, second_r);
            *value = near.min(other);
        }
    }

    pub(crate) fn range(&self, low: [usize; 3], high: [usize; 3]) -> (f32, f32) {
        let [a, b] = [0, 1].map(|n: usize| self.0[n].range(low, high));
        (a.0.min(b.0), a.1.min(b.1))
    }
}

/// Distance to a torus about the z axis.
#[derive(Clone, Debug)]
pub(crate) struct Torus {
    axes: [Squares; 3],
    ring: f64,
    tube: f64,
}

/// Radius of the ring and of the tube, as shares of the scale.
pub(crate) const TORUS: (f64, f64) = (0.3, 0.12);

impl Torus {
    pub(crate) fn scene(size: [u32; 3]) -> Self {
        let n = f64::from(scale_of(size));
        let center = center_of(size);
        Self {
            axes: std::array::from_fn(|a| Squares::new(size[a], center[a])),
            ring: TORUS.0 * n,
            tube: TORUS.1 * n,
        }
    }

    #[inline]
    fn distance(square_xy: f64, square_z: f64, ring: f64, tube: f64) -> f32 {
        let from_ring = square_xy.sqrt() - ring;
        ((from_ring * from_ring + square_z).sqrt() - tube) as f32
    }

    pub(crate) fn value(&self, i: usize, j: usize, k: usize) -> f32 {
        let [x, y, z] = &self.axes;
        Self::distance(x.table[i] + y.table[j], z.table[k], self.ring, self.tube)
    }

    pub(crate) fn fill_row(&self, j: usize, k: usize, i0: usize, out: &mut [f32]) {
        let [x, y, z] = &self.axes;
        let (square_y, square_z) = (y.table[j], z.table[k]);
        let (ring, tube) = (self.ring, self.tube);
        let row = &x.table[i0..i0 + out.len()];
        for (value, &square_x) in out.iter_mut().zip(row) {
            *value = Self::distance(square_x + square_y, square_z, ring, tube);
        }
    }

    pub(crate) fn range(&self, low: [usize; 3], high: [usize; 3]) -> (f32, f32) {
        let [x, y, z] = std::array::from_fn(|a| self.axes[a].range(low[a], high[a]));
        let (near, far) = ((x.0 + y.0).sqrt(), (x.1 + y.1).sqrt());
        // Squared distance from the ring: smallest on the ring itself when the box meets it.
        let (a, b) = (near - self.ring, far - self.ring);
        let smallest = if a <= 0.0 && b >= 0.0 {
            0.0
        } else {
            (a * a).min(b * b)
        };
        let largest = (a * a).max(b * b);
        (
            ((smallest + z.0).sqrt() - self.tube) as f32,
            ((largest + z.1).sqrt() - self.tube) as f32,
        )
    }
}

/// Centre of a lattice of `size`.
fn center_of(size: [u32; 3]) -> [f64; 3] {
    size.map(|s| f64::from(s - 1) / 2.0)
}
