//! Where the vertices inside a cell lie: on the trilinear surface, in coordinates of the cell.

use super::cube::{corner, edge_axis, edge_origin};
use super::interior::waist_box;
use super::place::Placement;
use super::waist::TunnelCase;

/// The cell that vertices are placed in.
pub(super) struct Cell<'a> {
    /// The eight corners.
    pub(super) values: &'a [f32; 8],
    /// The corners less the isovalue, all finite.
    pub(super) offsets: [f64; 8],
    pub(super) iso: f32,
    pub(super) placement: &'a Placement,
}

impl Cell<'_> {
    /// The fraction along edge `e` at which its vertex lies.
    fn crossing(&self, e: usize) -> f64 {
        let [x, y, z] = edge_origin(e);
        let low = x | y << 1 | z << 2;
        let (a, b) = (self.values[low], self.values[low | 1 << edge_axis(e)]);
        f64::from(self.placement.along(a, b, self.iso))
    }

    /// The corners of the waist of a tunnel.
    ///
    /// The box gives way to the vertices on the edges, which are rounded and kept away from the
    /// ends, and is never so thin that its corners coincide.
    pub(super) fn waist(&self, case: &TunnelCase, out: &mut Vec<[f64; 3]>) {
        let mut sides = waist_box(&self.offsets);
        let least = self.placement.min_t();
        for (axis, side) in sides.iter_mut().enumerate() {
            let (mut low, mut high) = (least, 1.0 - least);
            for e in 4 * axis..4 * axis + 4 {
                if case.below >> e & 1 == 1 {
                    low = low.max(self.crossing(e));
                }
                if case.above >> e & 1 == 1 {
                    high = high.min(self.crossing(e));
                }
            }
            *side = fit(*side, low, high, least);
        }
        out.extend((case.waist.iter()).map(|&c| {
            let p = corner(usize::from(c));
            std::array::from_fn(|axis| sides[axis][p[axis]])
        }));
    }

    /// A point of the surface near the middle of a loop.
    pub(super) fn centre(&self, ring: &[u8]) -> [f64; 3] {
        let mut middle = [0.0; 3];
        for &e in ring {
            let e = usize::from(e);
            let mut p = edge_origin(e).map(|v| v as f64);
            p[edge_axis(e)] = self.crossing(e);
            (0..3).for_each(|a| middle[a] += p[a] / ring.len() as f64);
        }
        // Along an axis the interpolant is linear: go along the steepest.
        let (value, gradient) = self.interpolate(middle);
        let axis = (0..3).fold(0, |best, a| {
            if gradient[a].abs() > gradient[best].abs() {
                a
            } else {
                best
            }
        });
        let to = middle[axis] - value / gradient[axis];
        let least = self.placement.min_t();
        if to >= least && to <= 1.0 - least {
            middle[axis] = to;
        }
        middle
    }

    /// The interpolant and its gradient.
    pub(super) fn interpolate(&self, at: [f64; 3]) -> (f64, [f64; 3]) {
        let (mut value, mut gradient) = (0.0, [0.0; 3]);
        for (c, offset) in self.offsets.iter().enumerate() {
            let high = corner(c).map(|v| v == 1);
            let weight = |a: usize| if high[a] { at[a] } else { 1.0 - at[a] };
            let w = [weight(0), weight(1), weight(2)];
            value += w[0] * w[1] * w[2] * offset;
            for a in 0..3 {
                let rest = w[(a + 1) % 3] * w[(a + 2) % 3] * offset;
                gradient[a] += if high[a] { rest } else { -rest };
            }
        }
        (value, gradient)
    }
}

/// Brings a side of the box between `low` and `high`, at least `least` wide.
fn fit(side: [f64; 2], low: f64, high: f64, least: f64) -> [f64; 2] {
    let (low, high) = (low.min(high), high.max(low));
    let [a, b] = side.map(|v| v.clamp(low, high));
    if b - a >= least {
        return [a, b];
    }
    let half = 0.5 * least;
    let (first, last) = (low + half, high - half);
    let middle = 0.5 * (a + b);
    // Where the crossings leave no room the box keeps its width all the same.
    let middle = if first <= last {
        middle.clamp(first, last)
    } else {
        (0.5 * (low + high)).clamp(least, 1.0 - least)
    };
    [middle - half, middle + half]
}

#[cfg(test)]
mod tests {
    use super::fit;

    #[test]
    fn the_box_stays_in_bounds_and_keeps_its_width() {
        let near = |a: [f64; 2], b: [f64; 2]| (0..2).all(|k| (a[k] - b[k]).abs() < 1e-12);
        assert!(near(fit([0.3, 0.6], 0.1, 0.9, 0.01), [0.3, 0.6]));
        assert!(near(fit([0.3, 0.6], 0.4, 0.5, 0.01), [0.4, 0.5]));
        assert!(near(fit([0.5, 0.5], 0.1, 0.9, 0.02), [0.49, 0.51]));
        assert!(near(fit([0.1, 0.1], 0.1, 0.9, 0.02), [0.1, 0.12]));
        assert!(near(fit([0.2, 0.8], 0.5, 0.5, 0.02), [0.49, 0.51]));
        assert!(near(
            fit([0.001, 0.001], 0.001, 0.001, 0.001),
            [0.0005, 0.0015]
        ));
    }
}
