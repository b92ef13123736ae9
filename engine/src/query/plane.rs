//! A plane through a field, in any direction.

use super::cursor::Method;
use super::parts::each_part_of;
use crate::budget::Budget;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::lattice::Grid;

/// Edge of the squares that a plane is read in, so that neighbours share bricks.
const SQUARE: usize = 32;

/// A raster of points, in index space: pixel (x, y) is at `first + x * right + y * down`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// The first pixel of the first row.
    pub first: [f64; 3],
    /// Step from a pixel to the next.
    pub right: [f64; 3],
    /// Step from a row to the next.
    pub down: [f64; 3],
    /// Pixels across and down.
    pub size: [u32; 2],
}

impl Plane {
    /// The plane whose `first`, `right` and `down` are given in the world.
    ///
    /// # Errors
    /// When the map of the grid cannot be turned around.
    pub fn from_world(self, grid: &Grid) -> Result<Plane> {
        let map = grid.index_to_world.inverse()?;
        let turn = |v: [f64; 3]| map.rows.map(|r| r[0] * v[0] + r[1] * v[1] + r[2] * v[2]);
        Ok(Plane {
            first: map.apply(self.first),
            right: turn(self.right),
            down: turn(self.down),
            size: self.size,
        })
    }

    /// Index position of a pixel.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> [f64; 3] {
        let (x, y) = (x as f64, y as f64);
        std::array::from_fn(|a| self.first[a] + x * self.right[a] + y * self.down[a])
    }
}

/// Values on a plane, rows from the first on; `outside` beyond the samples.
///
/// # Errors
/// An `out` of another length, what the field reports, `Cancelled`.
///
/// # Memory
/// A cursor per thread.
pub fn sample_plane(
    field: &dyn Field,
    plane: &Plane,
    method: Method,
    outside: f32,
    out: &mut [f32],
    budget: &Budget,
) -> Result<()> {
    let [w, h] = plane.size.map(|n| n as usize);
    if w.checked_mul(h) != Some(out.len()) {
        return Err(Error::bad_input(format!(
            "room for {} values of a plane of {w} x {h}",
            out.len()
        )));
    }
    if out.is_empty() {
        return Ok(());
    }
    each_part_of(out, SQUARE * w, budget, field, |cursor, first, rows| {
        for left in (0..w).step_by(SQUARE) {
            for (y, row) in rows.chunks_mut(w).enumerate() {
                for (x, value) in row[left..w.min(left + SQUARE)].iter_mut().enumerate() {
                    let at = plane.at(left + x, first / w + y);
                    *value = cursor.value(at, method)?.unwrap_or(outside);
                }
            }
        }
        Ok(())
    })
}
