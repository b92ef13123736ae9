//! Where a vertex lies on its lattice edge, in the world, and which way its normal points.
//!
//! The same edge gives the same bits from every block, tile and run: all that enters is the two
//! samples, the isovalue, and the lattice point in absolute coordinates.

use super::block::BlockSamples;
use crate::error::{Error, Result};
use crate::lattice::{Affine, Box3};
use crate::sample::Inside;

/// A vertex keeps at least this distance, in cells, from the ends of its edge, so that vertices of
/// different edges never coincide and no triangle degenerates where samples equal the isovalue.
pub(crate) const MIN_T: f32 = 1e-3;

/// Crossing of the isovalue on an edge, as a fraction from its lower end `a` to its upper `b`, at least `min_t`
/// away from both.
#[inline(always)]
pub(super) fn along(a: f32, b: f32, iso: f32, min_t: f32) -> f32 {
    let (part, whole) = (iso - a, b - a);
    let usual = part.is_finite() && whole.is_finite();
    let t = if usual {
        part / whole
    } else {
        unusual(a, b, iso)
    };
    t.clamp(min_t, 1.0 - min_t)
}

/// Map from edges to vertex positions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    map: Affine,
    gradient_rows: [[f64; 3]; 3],
    min_t: f32,
    /// Whether vertices inside cells are placed in coordinates of their cell.
    in_cells: bool,
    /// See [`is_diagonal`](Self::is_diagonal).
    diagonal: bool,
    /// Whether triangles must be turned.
    pub(super) mirrored: bool,
}

impl Placement {
    /// # Errors
    /// When f32 positions cannot tell neighbouring samples of `domain` apart.
    pub(super) fn new(map: Affine, domain: Box3) -> Result<Self> {
        map.validate()?;
        let far = (0..8)
            .flat_map(|c| {
                let end = |a: usize| {
                    f64::from(if c >> a & 1 == 1 {
                        domain.max[a]
                    } else {
                        domain.min[a]
                    })
                };
                map.apply([end(0), end(1), end(2)])
            })
            .fold(0.0, |far: f64, v| far.max(v.abs()));
        let spacing = map.spacing().into_iter().fold(f64::INFINITY, f64::min);
        // Two steps of f32 at the far end, in cells.
        let grain = far * f64::from(f32::EPSILON) / spacing;
        if grain > 0.125 {
            return Err(Error::bad_input(format!(
                "world coordinates reach {far:e} with samples {spacing:e} apart: 32-bit vertex positions cannot \
                 tell neighbouring samples apart; mesh in index space (--space index)"
            )));
        }
        Ok(Self {
            map,
            gradient_rows: map.gradient_rows(),
            min_t: MIN_T.max(grain as f32),
            in_cells: false,
            diagonal: (0..9).all(|i| i % 4 == 0 || map.rows[i / 3][i % 3].to_bits() == 0),
            mirrored: map.is_left_handed(),
        })
    }

    /// Crossing of the isovalue on an edge, as a fraction from its lower end `a` to its upper `b`.
    #[inline]
    pub(super) fn along(&self, a: f32, b: f32, iso: f32) -> f32 {
        along(a, b, iso, self.min_t)
    }

    /// Rows of the map from lattice to world.
    #[inline(always)]
    pub(super) fn rows(&self) -> &[[f64; 4]; 3] {
        &self.map.rows
    }

    /// Whether every axis of the lattice goes along its axis of the world: the other terms are positive
    /// zeros.
    #[inline(always)]
    pub(super) fn is_diagonal(&self) -> bool {
        self.diagonal
    }

    /// World position of the lattice point (0, j, k).
    #[inline(always)]
    pub(super) fn row(&self, j: i32, k: i32) -> [f64; 3] {
        let rows = &self.map.rows;
        let at = |a: usize| rows[a][1] * f64::from(j) + (rows[a][2] * f64::from(k) + rows[a][3]);
        [at(0), at(1), at(2)]
    }

    /// World position of the point at `t` on the edge along `axis` from point `i` of a row.
    #[inline(always)]
    pub(super) fn on_edge(&self, row: [f64; 3], i: i32, axis: usize, t: f32) -> [f32; 3] {
        let (i, t) = (f64::from(i), f64::from(t));
        let at =
            |a: usize| ((self.map.rows[a][0] * i + row[a]) + self.map.rows[a][axis] * t) as f32;
        [at(0), at(1), at(2)]
    }

    /// Unit normal out of the solid at `t` on the edge from sample `low` along `axis`: the gradient
    /// by central differences, one-sided where a neighbour is missing, interpolated along the edge.
    pub(super) fn edge_normal(
        &self,
        samples: &BlockSamples,
        low: usize,
        axis: usize,
        t: f32,
        inside: Inside,
    ) -> [f32; 3] {
        let high = low + samples.step[axis];
        let value = |i: usize| samples.values[i];
        let out = if inside == Inside::Above { -1.0 } else { 1.0 };
        if !value(low).is_nan() && !value(high).is_nan() {
            let (a, b) = (gradient(samples, low), gradient(samples, high));
            let t = f64::from(t);
            let g = std::array::from_fn(|k| out * (a[k] + (b[k] - a[k]) * t));
            if let Some(normal) = self.to_world(g) {
                return normal;
            }
        }
        // A cap, or a flat or infinite gradient: along the edge, from inside to outside.
        let mut g = [0.0; 3];
        let low_inside = value(high).is_nan()
            || (!value(low).is_nan() && (value(low) < value(high)) == (out > 0.0));
        g[axis] = if low_inside { 1.0 } else { -1.0 };
        self.to_world(g).unwrap_or([0.0, 0.0, 1.0])
    }

    /// The map from the lattice to the world.
    pub(super) fn map(&self) -> &Affine {
        &self.map
    }

    /// The least distance, in cells, of a vertex from the ends of its edge.
    pub(super) fn min_t(&self) -> f64 {
        f64::from(self.min_t)
    }

    /// World position of a point inside the cell with lowest corner `cell`.
    pub(super) fn in_cell(&self, cell: [i32; 3], at: [f64; 3]) -> [f32; 3] {
        if self.in_cells {
            return at.map(|v| v as f32);
        }
        let index = std::array::from_fn(|a| f64::from(cell[a]) + at[a]);
        self.at(index)
    }

    /// The same, with vertices inside cells left in coordinates of their cell.
    pub(super) fn in_cells(self) -> Self {
        Self {
            in_cells: true,
            ..self
        }
    }

    /// World position of a point of the lattice.
    pub(super) fn at(&self, index: [f64; 3]) -> [f32; 3] {
        self.map.apply(index).map(|v| v as f32)
    }

    /// Unit normal out of the solid where the field has this gradient, if it has a direction.
    pub(super) fn normal(&self, gradient: [f64; 3], inside: Inside) -> Option<[f32; 3]> {
        let out = if inside == Inside::Above { -1.0 } else { 1.0 };
        self.to_world(gradient.map(|v| out * v))
    }

    fn to_world(self, g: [f64; 3]) -> Option<[f32; 3]> {
        unit(
            self.gradient_rows
                .map(|r| r[0] * g[0] + r[1] * g[1] + r[2] * g[2]),
        )
    }
}

/// `v` with length one; `None` when it has no direction.
pub(super) fn unit(v: [f64; 3]) -> Option<[f32; 3]> {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    (length.is_finite() && length > 0.0).then(|| v.map(|c| (c / length) as f32))
}

/// Crossing where an end is NaN (nothing is known: just beyond the other end), infinite (just
/// before it), or so large that the difference overflows.
#[cold]
fn unusual(a: f32, b: f32, iso: f32) -> f32 {
    match (a.is_nan(), b.is_nan(), a.is_infinite(), b.is_infinite()) {
        (false, true, ..) => 0.0,
        (true, false, ..) => 1.0,
        (_, _, true, true) => 0.5,
        (_, _, true, false) => 1.0,
        (_, _, false, true) => 0.0,
        _ => ((f64::from(iso) - f64::from(a)) / (f64::from(b) - f64::from(a))) as f32,
    }
}

/// The gradient at a sample by central differences, one-sided where a neighbour is missing.
pub(super) fn gradient(samples: &BlockSamples, at: usize) -> [f64; 3] {
    let value = |i: usize| f64::from(samples.values[i]);
    std::array::from_fn(|axis| {
        let step = samples.step[axis];
        let (low, mid, high) = (value(at - step), value(at), value(at + step));
        match (low.is_nan(), high.is_nan()) {
            (false, false) => (high - low) * 0.5,
            (true, false) => high - mid,
            (false, true) => mid - low,
            (true, true) => 0.0,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placement() -> Placement {
        Placement::new(Affine::IDENTITY, Box3::from_size([64; 3])).expect("plain")
    }

    #[test]
    fn crossing_is_linear_clamped_and_total() {
        let p = placement();
        assert_eq!(p.along(-1.0, 3.0, 0.0), 0.25);
        assert_eq!(p.along(0.0, 3.0, 0.0), MIN_T);
        assert_eq!(p.along(-3.0, 0.0, 0.0), 1.0 - MIN_T);
        assert_eq!(p.along(1.0, f32::NAN, 0.0), MIN_T);
        assert_eq!(p.along(f32::NAN, 1.0, 0.0), 1.0 - MIN_T);
        assert_eq!(p.along(f32::INFINITY, -1.0, 0.0), 1.0 - MIN_T);
        assert_eq!(p.along(f32::INFINITY, f32::NEG_INFINITY, 0.0), 0.5);
        assert_eq!(p.along(-3e38, 3e38, 0.0), 0.5);
    }

    #[test]
    fn far_away_worlds_are_refused() {
        let far = Affine::from_spacing([1e-3; 3], [1e6, 0.0, 0.0]);
        assert!(Placement::new(far, Box3::from_size([64; 3])).is_err());
        let wide =
            Placement::new(Affine::IDENTITY, Box3::from_size([1 << 17; 3])).expect("near enough");
        assert!(wide.min_t > MIN_T);
    }
}
