//! Smooth noise: octaves of random values at coarse knots, joined by smooth steps.
//!
//! Between knots an octave is multilinear in the smooth step of each coordinate, so over a box its
//! extremes lie on knots and box ends: its range is exact.

use crate::fields::scale_of;
use crate::rng::hash_point;

/// Cells along the scale, and amplitude.
const OCTAVES: [(u32, f32); 3] = [(24, 1.0), (48, 0.5), (96, 0.25)];

/// Knots per octave that a range looks at before it gives the amplitude instead.
const KNOTS_MAX: usize = 4096;

/// Rounding of the sums in f32, well covered.
const MARGIN: f32 = 4e-6;

#[derive(Clone, Debug)]
pub(crate) struct Noise {
    octaves: [Octave; 3],
}

/// One octave: where each lattice point lies between the knots.
#[derive(Clone, Debug)]
struct Octave {
    stream: u64,
    amplitude: f32,
    axes: [Vec<Place>; 3],
}

/// Knot below a lattice point, and the smooth step of the rest of the way to the next knot.
#[derive(Clone, Copy, Debug)]
struct Place {
    knot: u32,
    step: f32,
}

impl Place {
    fn new(index: u32, cells: u32, n: u32) -> Self {
        let (at, span) = (u64::from(index) * u64::from(cells), u64::from(n - 1));
        let part = (at % span) as f64 / span as f64;
        Self {
            knot: (at / span) as u32,
            step: (part * part * (3.0 - 2.0 * part)) as f32,
        }
    }
}

#[inline]
fn between(a: f32, b: f32, step: f32) -> f32 {
    a * (1.0 - step) + b * step
}

impl Octave {
    fn new(stream: u64, cells: u32, amplitude: f32, size: [u32; 3]) -> Self {
        let n = scale_of(size);
        let axis = |s: u32| (0..s).map(|i| Place::new(i, cells, n)).collect();
        Self {
            stream,
            amplitude,
            axes: size.map(axis),
        }
    }

    /// Value at a knot, in `-amplitude..amplitude`, with 24 random bits.
    #[inline]
    fn knot(&self, x: u32, y: u32, z: u32) -> f32 {
        let bits = (hash_point(self.stream, x, y, z) >> 40) as i32;
        (bits - (1 << 23)) as f32 * (self.amplitude / (1 << 23) as f32)
    }

    /// Value on the line of knots `x`, at a place in y and z.
    #[inline]
    fn on_line(&self, x: u32, y: Place, z: Place) -> f32 {
        let at_z = |z: u32| between(self.knot(x, y.knot, z), self.knot(x, y.knot + 1, z), y.step);
        between(at_z(z.knot), at_z(z.knot + 1), z.step)
    }

    fn value(&self, i: usize, j: usize, k: usize) -> f32 {
        let (x, y, z) = (self.axes[0][i], self.axes[1][j], self.axes[2][k]);
        between(
            self.on_line(x.knot, y, z),
            self.on_line(x.knot + 1, y, z),
            x.step,
        )
    }

    fn add_row(&self, j: usize, k: usize, i0: usize, out: &mut [f32]) {
        let (y, z) = (self.axes[1][j], self.axes[2][k]);
        let places = &self.axes[0][i0..i0 + out.len()];
        let mut next = None;
        let mut start = 0;
        while start < out.len() {
            let knot = places[start].knot;
            let length = places[start..].partition_point(|p| p.knot == knot);
            let a = match next {
                Some((at, value)) if at == knot => value,
                _ => self.on_line(knot, y, z),
            };
            let b = self.on_line(knot + 1, y, z);
            next = Some((knot + 1, b));
            let end = start + length;
            for (value, place) in out[start..end].iter_mut().zip(&places[start..end]) {
                *value += between(a, b, place.step);
            }
            start = end;
        }
    }

    /// Places on one axis where the octave can have an extreme over `low..=high`.
    fn turning_places(&self, axis: usize, low: usize, high: usize) -> impl Iterator<Item = Place> {
        let (first, last) = (self.axes[axis][low], self.axes[axis][high]);
        let knots = first.knot + 1..=last.knot;
        let inner = knots.map(|knot| Place { knot, step: 0.0 });
        std::iter::once(first)
            .chain(inner)
            .chain(std::iter::once(last))
    }

    fn range(&self, low: [usize; 3], high: [usize; 3]) -> (f32, f32) {
        let knots: [usize; 3] = std::array::from_fn(|a| {
            let (first, last) = (self.axes[a][low[a]].knot, self.axes[a][high[a]].knot);
            (last - first) as usize + 2
        });
        let work = knots.iter().fold(1usize, |n, &k| n.saturating_mul(k));
        if work > KNOTS_MAX {
            return (-self.amplitude, self.amplitude);
        }
        let mut range = (f32::INFINITY, f32::NEG_INFINITY);
        for z in self.turning_places(2, low[2], high[2]) {
            for y in self.turning_places(1, low[1], high[1]) {
                for x in self.turning_places(0, low[0], high[0]) {
                    let a = self.on_line(x.knot, y, z);
                    let b = self.on_line(x.knot + 1, y, z);
                    let value = between(a, b, x.step);
                    range = (range.0.min(value), range.1.max(value));
                }
            }
        }
        range
    }
}

impl Noise {
    pub(crate) fn scene(size: [u32; 3]) -> Self {
        let octave = |n: usize| Octave::new(n as u64 + 1, OCTAVES[n].0, OCTAVES[n].1, size);
        Self {
            octaves: [octave(0), octave(1), octave(2)],
        }
    }

    pub(crate) fn value(&self, i: usize, j: usize, k: usize) -> f32 {
        self.octaves
            .iter()
            .fold(0.0, |sum, octave| sum + octave.value(i, j, k))
    }

    pub(crate) fn fill_row(&self, j: usize, k: usize, i0: usize, out: &mut [f32]) {
        out.fill(0.0);
        for octave in &self.octaves {
            octave.add_row(j, k, i0, out);
        }
    }

    pub(crate) fn range(&self, low: [usize; 3], high: [usize; 3]) -> (f32, f32) {
        let mut range = (-MARGIN, MARGIN);
        for octave in &self.octaves {
            let (lo, hi) = octave.range(low, high);
            range = (range.0 + lo, range.1 + hi);
        }
        range
    }
}
