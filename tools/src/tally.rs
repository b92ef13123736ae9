//! Figures of a mesh of any size, gathered while it passes: area, volume, and whether it is closed.

use brickmarch::mesh::{Layout, Piece, Totals};
use brickmarch::{MeshSink, Result};
use std::sync::Mutex;

/// Fixed point of the sums, so that the order of pieces does not show.
const FRACTION: f64 = (1u128 << 64) as f64;

/// Counts a passing mesh.
///
/// Closed and oriented means that every edge is used as often in one direction as in the other. The
/// tally adds a 64-bit hash of each edge for one direction and subtracts it for the other: a sum of
/// zero is proof up to a chance of 2^-64. `check` finds the place where one is not zero.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    sums: Mutex<Sums>,
    totals: Totals,
}

#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    edges: u64,
    area: i128,
    volume: i128,
}

/// What a [`Tally`] found.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Figures {
    pub closed: bool,
    pub area: f64,
    /// Enclosed volume; meaningful where closed.
    pub volume: f64,
    /// Vertices minus edges plus triangles, for a closed mesh.
    pub euler: Option<i64>,
}

impl Tally {
    /// The figures, after `finish`.
    pub(crate) fn figures(&self) -> Figures {
        let sums = *self.sums.lock().expect("no writer panicked");
        let closed = sums.edges == 0;
        let euler = self.totals.vertices as i64 - (self.totals.triangles / 2) as i64;
        Figures {
            closed,
            area: sums.area as f64 / FRACTION,
            volume: sums.volume as f64 / FRACTION,
            euler: closed.then_some(euler),
        }
    }
}

impl MeshSink for Tally {
    fn begin(&mut self, _layout: Layout) -> Result<()> {
        *self = Tally::default();
        Ok(())
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        let mut here = Sums::default();
        let (mut area, mut volume) = (0.0, 0.0);
        for (t, corners) in piece.triangles.iter().enumerate() {
            let ids = piece.triangle_ids(t);
            for (a, b) in [(ids[0], ids[1]), (ids[1], ids[2]), (ids[2], ids[0])] {
                here.edges = if a < b {
                    here.edges.wrapping_add(hash(a, b))
                } else {
                    here.edges.wrapping_sub(hash(b, a))
                };
            }
            let [p, q, r] = corners.map(|v| piece.positions[v as usize].map(f64::from));
            let cross = cross(sub(q, p), sub(r, p));
            area += dot(cross, cross).sqrt() / 2.0;
            volume += dot(p, cross) / 6.0;
        }
        here.area = (area * FRACTION) as i128;
        here.volume = (volume * FRACTION) as i128;
        let mut sums = self.sums.lock().expect("no writer panicked");
        sums.edges = sums.edges.wrapping_add(here.edges);
        sums.area = sums.area.saturating_add(here.area);
        sums.volume = sums.volume.saturating_add(here.volume);
        Ok(())
    }

    fn finish(&mut self, totals: Totals) -> Result<()> {
        self.totals = totals;
        Ok(())
    }
}

/// Mixes both ends of an edge (the finalizer of splitmix64, twice).
fn hash(a: u64, b: u64) -> u64 {
    let mix = |mut z: u64| {
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    };
    mix(mix(a.wrapping_add(0x9e37_79b9_7f4a_7c15)) ^ b)
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use brickmarch::Mesh;
    use brickmarch::mesh::feed;

    fn tetrahedron() -> Mesh {
        Mesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
            ..Mesh::default()
        }
    }

    fn figures(mesh: &Mesh, piece: usize) -> Figures {
        let mut tally = Tally::default();
        feed(mesh, &mut tally, piece).expect("valid");
        tally.figures()
    }

    #[test]
    fn a_tetrahedron_is_closed_and_measured() {
        for piece in [1, 4] {
            let found = figures(&tetrahedron(), piece);
            assert!(found.closed);
            assert_eq!(found.euler, Some(2));
            assert!((found.volume - 1.0 / 6.0).abs() < 1e-9);
            assert!((found.area - (1.5 + 3f64.sqrt() / 2.0)).abs() < 1e-9);
        }
    }

    #[test]
    fn a_hole_and_a_turned_triangle_are_seen() {
        let mut open = tetrahedron();
        open.triangles.pop();
        assert!(!figures(&open, 4).closed);
        let mut turned = tetrahedron();
        turned.triangles[0] = [0, 1, 2];
        assert!(!figures(&turned, 4).closed);
    }
}
