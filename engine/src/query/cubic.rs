//! The trilinear interpolant of a cell along a ray: a cubic in the ray's parameter (Marmitt et al. 2004,
//! "Fast and accurate ray-voxel intersection techniques for iso-surface ray tracing").

/// `c[0] + c[1] s + c[2] s^2 + c[3] s^3` for `s` from 0 to `length`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cubic {
    c: [f64; 4],
    length: f64,
}

impl Cubic {
    /// Along `start + s * step`, in the coordinates of a cell with these corners (x lowest).
    pub(super) fn new(corners: [f32; 8], start: [f64; 3], step: [f64; 3], length: f64) -> Cubic {
        let v = corners.map(f64::from);
        let [x, y, z] = [0, 1, 2].map(|a| [start[a], step[a]]);
        // Linear along x on the four edges, then two products with linear factors.
        let along = |a: usize| {
            let d = v[a + 1] - v[a];
            [v[a] + d * x[0], d * x[1]]
        };
        let edges = [along(0), along(2), along(4), along(6)];
        let blend = |a: [f64; 2], b: [f64; 2]| {
            let d = [b[0] - a[0], b[1] - a[1]];
            [
                a[0] + y[0] * d[0],
                a[1] + y[0] * d[1] + y[1] * d[0],
                y[1] * d[1],
            ]
        };
        let (low, high) = (blend(edges[0], edges[1]), blend(edges[2], edges[3]));
        let d: [f64; 3] = std::array::from_fn(|n| high[n] - low[n]);
        Cubic {
            c: [
                low[0] + z[0] * d[0],
                low[1] + z[0] * d[1] + z[1] * d[0],
                low[2] + z[0] * d[2] + z[1] * d[1],
                z[1] * d[2],
            ],
            length,
        }
    }

    pub(super) fn length(&self) -> f64 {
        self.length
    }

    #[inline]
    pub(super) fn at(&self, s: f64) -> f64 {
        let [a, b, c, d] = self.c;
        a + s * (b + s * (c + s * d))
    }

    /// Where the cubic turns, and its ends, in order: between two of them it is monotone.
    fn stops(&self) -> [f64; 4] {
        let [_, b, c, d] = self.c;
        let mut turns = [self.length; 2];
        // Roots of b + 2 c s + 3 d s^2, without cancellation.
        let root = c * c - 3.0 * b * d;
        if root >= 0.0 {
            let q = -(c + c.signum() * root.sqrt());
            turns = [q / (3.0 * d), b / q];
        }
        let mut turns = turns.map(|s| {
            if s > 0.0 && s < self.length {
                s
            } else {
                self.length
            }
        });
        turns.sort_by(f64::total_cmp);
        [0.0, turns[0], turns[1], self.length]
    }

    /// First `s` at which the cubic comes to the other side of `iso` than `above`.
    pub(super) fn leaves(&self, iso: f64, above: bool) -> Option<f64> {
        let stops = self.stops();
        if (self.at(0.0) >= iso) != above {
            return Some(0.0);
        }
        let part = stops.windows(2).find(|w| (self.at(w[1]) >= iso) != above)?;
        Some(self.root(part[0], part[1], iso, above))
    }

    /// The root between `low`, which is on the side `above`, and `high`, which is not: Newton's steps
    /// where they stay between, halves otherwise.
    fn root(&self, mut low: f64, mut high: f64, iso: f64, above: bool) -> f64 {
        let [_, b, c, d] = self.c;
        let mut s = 0.5 * (low + high);
        // Halves alone would take as many steps as a double has bits.
        for _ in 0..64 {
            let value = self.at(s) - iso;
            if (value >= 0.0) == above {
                low = s;
            } else {
                high = s;
            }
            let slope = b + s * (2.0 * c + s * 3.0 * d);
            let mut next = s - value / slope;
            if value == 0.0 || (next - s).abs() <= 1e-15 * self.length {
                return s;
            }
            // Not between, or not a number where the slope is 0.
            if !(low < next && next < high) {
                next = 0.5 * (low + high);
                if next <= low || next >= high {
                    return s;
                }
            }
            s = next;
        }
        s
    }

    /// The largest value, and the first place that has it.
    pub(super) fn highest(&self) -> (f64, f64) {
        let mut best = (0.0, self.at(0.0));
        for s in self.stops() {
            let value = self.at(s);
            if value > best.1 {
                best = (s, value);
            }
        }
        best
    }

    /// The integral over the whole length, exact for a cubic (Simpson).
    pub(super) fn integral(&self) -> f64 {
        let ends = self.at(0.0) + self.at(self.length);
        self.length / 6.0 * (ends + 4.0 * self.at(0.5 * self.length))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_product_of_three_has_its_three_roots() {
        // x y z shifted: f = (x - 1/4)(y - 1/2)(z - 3/4) along the diagonal.
        let corners = std::array::from_fn(|c| {
            let at = |a: usize| (c >> a & 1) as f32;
            (at(0) - 0.25) * (at(1) - 0.5) * (at(2) - 0.75)
        });
        let cubic = Cubic::new(corners, [0.0; 3], [1.0; 3], 1.0);
        let first = cubic.leaves(0.0, false).expect("a root");
        assert!((first - 0.25).abs() < 1e-12, "{first}");
        let rest = Cubic::new(corners, [0.3; 3], [1.0; 3], 0.7);
        let second = rest.leaves(0.0, true).expect("a root");
        assert!((second - 0.2).abs() < 1e-12, "{second}");
        assert!((cubic.integral() - 0.0).abs() < 1e-15);
        let (s, value) = cubic.highest();
        assert!(s == 1.0 && (value - 0.09375).abs() < 1e-12, "{s} {value}");
    }

    #[test]
    fn two_roots_in_one_cell_are_not_missed() {
        // Above only in the middle of the diagonal: 4 x (1 - y), thinner than a step of any marcher.
        let corners = [0.0, 4.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0];
        let cubic = Cubic::new(corners, [0.0; 3], [1.0; 3], 1.0);
        let root = cubic.leaves(0.999_999, false).expect("a root");
        assert!((root - 0.4995).abs() < 1e-6, "{root}");
        assert_eq!(cubic.leaves(1.000_001, false), None);
        assert_eq!(cubic.leaves(-1.0, false), Some(0.0));
    }

    #[test]
    fn constant_and_linear_cells() {
        let flat = Cubic::new([2.0; 8], [0.1, 0.2, 0.3], [1.0, 0.0, 0.0], 0.5);
        assert_eq!(flat.leaves(2.0, true), None);
        assert_eq!(flat.highest(), (0.0, 2.0));
        assert!((flat.integral() - 1.0).abs() < 1e-15);
        let ramp = Cubic::new(
            [0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0],
            [0.0; 3],
            [1.0, 0.0, 0.0],
            1.0,
        );
        assert_eq!(ramp.leaves(0.25, false), Some(0.25));
    }
}
