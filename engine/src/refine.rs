//! Meshes of a model whose vertices lie on the surface of its formula, not on that of its samples.
//!
//! A vertex stays on its edge of the lattice, between two samples on different sides, so triangles
//! and topology are those of the mesh of the samples. Where on its edge depends on the edge alone.

use crate::budget::Budget;
use crate::error::Result;
use crate::field::Field;
use crate::mesh::{EdgeKey, Layout, MeshSink, Piece, Totals};
use crate::model::Model;
use std::array::from_fn;

/// Vertices that are moved at one time.
const BATCH: usize = 4096;

/// Most steps on the way to a root: bisection alone would need fewer than 60.
const STEPS: usize = 64;

/// Ends the search, in parts of the way: below the rounding of positions.
const NARROW: f64 = 1e-12;

/// A vertex keeps so far from the ends of its edge, in cells, as in a mesh of samples.
const MARGIN: f64 = 1e-3;

/// How far from where it was a vertex inside a cell is looked for, in cells.
const REACH: f64 = 0.25;

/// Passes a mesh on with its vertices moved onto the surface of a model: those on edges of the
/// lattice along their edge, those inside cells along the gradient, if the surface is within a
/// quarter of a cell there. A vertex without a root on its way, towards a cap or beside a value
/// that is not a number, stays. Normals stay those of the samples.
///
/// The mesh must come with keys, in world space, from this model, and not relaxed.
///
/// # Memory
/// A copy of each piece, for each thread that writes.
pub struct Refined<'a> {
    model: &'a Model,
    budget: &'a Budget,
    /// Whether keys are passed on.
    keys: bool,
    sink: &'a mut dyn MeshSink,
}

impl<'a> Refined<'a> {
    /// Between an extraction with keys and `sink`, which gets them too if `keys`.
    pub fn new(
        model: &'a Model,
        keys: bool,
        budget: &'a Budget,
        sink: &'a mut dyn MeshSink,
    ) -> Refined<'a> {
        Refined {
            model,
            budget,
            keys,
            sink,
        }
    }
}

impl MeshSink for Refined<'_> {
    fn capacity(&self) -> Totals {
        self.sink.capacity()
    }

    fn begin(&mut self, layout: Layout) -> Result<()> {
        self.sink.begin(Layout {
            keys: layout.keys && self.keys,
            ..layout
        })
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        let room = piece.capacity_bytes() + (BATCH * size_of::<Way>() * 2) as u64;
        let _room = self
            .budget
            .take(room, "vertices on the surface of a formula")?;
        let mut refined = piece.clone();
        for first in (0..piece.keys.len()).step_by(BATCH) {
            let last = (first + BATCH).min(piece.keys.len());
            self.refine(
                &piece.keys[first..last],
                &mut refined.positions[first..last],
            )?;
        }
        if !self.keys {
            refined.keys.clear();
        }
        self.sink.write(&refined)
    }

    fn finish(&mut self, totals: Totals) -> Result<()> {
        self.sink.finish(totals)
    }
}

/// The way on which a vertex may go, and the part of it where the root is.
struct Way {
    vertex: usize,
    from: [f64; 3],
    step: [f64; 3],
    /// Fractions of the way, and the values there.
    low: (f64, f64),
    high: (f64, f64),
    /// Which end moved last.
    side: i8,
}

impl Way {
    fn at(&self, t: f64) -> [f64; 3] {
        from_fn(|a| self.from[a] + t * self.step[a])
    }

    /// Where to look next: where the chord crosses, kept off the ends.
    fn next(&self) -> f64 {
        let ((a, fa), (b, fb)) = (self.low, self.high);
        let t = a + (b - a) * (fa / (fa - fb));
        let inner = 1e-3 * (b - a);
        if t.is_nan() {
            0.5 * (a + b)
        } else {
            t.clamp(a + inner, b - inner)
        }
    }

    /// Takes the value at `t`. The end that stays twice counts half (Dowell and Jarratt 1971, the
    /// "Illinois" method).
    fn narrow(&mut self, t: f64, value: f64) {
        if value == 0.0 {
            (self.low, self.high) = ((t, 0.0), (t, 0.0));
        } else if (value < 0.0) == (self.low.1 < 0.0) {
            self.low = (t, value);
            if self.side == -1 {
                self.high.1 *= 0.5;
            }
            self.side = -1;
        } else {
            self.high = (t, value);
            if self.side == 1 {
                self.low.1 *= 0.5;
            }
            self.side = 1;
        }
    }
}

impl Refined<'_> {
    /// Moves the vertices with these keys.
    fn refine(&self, keys: &[EdgeKey], positions: &mut [[f32; 3]]) -> Result<()> {
        let mut ways = Vec::with_capacity(keys.len());
        for (vertex, (&key, &position)) in keys.iter().zip(&*positions).enumerate() {
            let way = match key.axis {
                0..3 => self.edge(key),
                _ => self.along_gradient(key, position)?,
            };
            if let Some((from, step)) = way {
                let none = (0.0, 0.0);
                ways.push(Way {
                    vertex,
                    from,
                    step,
                    low: none,
                    high: (1.0, 0.0),
                    side: 0,
                });
            }
        }
        let lows = self.offsets(&ways, |_| 0.0)?;
        let highs = self.offsets(&ways, |_| 1.0)?;
        for ((way, low), high) in ways.iter_mut().zip(lows).zip(highs) {
            (way.low.1, way.high.1) = (low, high);
        }
        ways.retain(|way| {
            let (low, high) = (way.low.1, way.high.1);
            low.is_finite() && high.is_finite() && (low < 0.0) != (high < 0.0)
        });
        for _ in 0..STEPS {
            let values = self.offsets(&ways, Way::next)?;
            for (way, value) in ways.iter_mut().zip(values) {
                // What is not a number stands for no side: the half with the larger value goes.
                let value = if value.is_nan() { way.high.1 } else { value };
                way.narrow(way.next(), value);
            }
            self.settle(&mut ways, keys, positions, NARROW);
            if ways.is_empty() {
                break;
            }
        }
        self.settle(&mut ways, keys, positions, f64::INFINITY);
        Ok(())
    }

    /// Places the vertices whose root is known to `narrow` and takes their ways from the list.
    fn settle(
        &self,
        ways: &mut Vec<Way>,
        keys: &[EdgeKey],
        positions: &mut [[f32; 3]],
        narrow: f64,
    ) {
        ways.retain(|way| {
            let (low, high) = (way.low, way.high);
            if high.0 - low.0 > narrow {
                return true;
            }
            // The nearer of both ends, by value.
            let t = if low.1.abs() < high.1.abs() {
                low.0
            } else {
                high.0
            };
            let axis = usize::from(keys[way.vertex].axis);
            let position = &mut positions[way.vertex];
            if axis < 3 {
                position[axis] = way.at(t.clamp(MARGIN, 1.0 - MARGIN))[axis] as f32;
            } else {
                *position = way.at(t).map(|v| v as f32);
            }
            false
        });
    }

    /// World coordinate of an index.
    fn world(&self, axis: usize, index: i32) -> f64 {
        let row = self.model.grid().index_to_world.rows[axis];
        row[3] + row[axis] * f64::from(index)
    }

    /// An edge of the lattice, unless it leads to a cap.
    fn edge(&self, key: EdgeKey) -> Option<([f64; 3], [f64; 3])> {
        let axis = usize::from(key.axis);
        let mut end = key.point;
        end[axis] += 1;
        let domain = self.model.grid().domain;
        if !domain.contains(key.point) || !domain.contains(end) {
            return None;
        }
        let from = from_fn(|a| self.world(a, key.point[a]));
        let mut step = [0.0; 3];
        step[axis] = self.world(axis, end[axis]) - from[axis];
        Some((from, step))
    }

    /// A way through a vertex inside a cell, along the gradient and inside the cell.
    fn along_gradient(
        &self,
        key: EdgeKey,
        position: [f32; 3],
    ) -> Result<Option<([f64; 3], [f64; 3])>> {
        let at = position.map(f64::from);
        let gradient = self.model.gradient(at)?;
        let edges: [f64; 3] = from_fn(|a| self.model.grid().index_to_world.rows[a][a]);
        // In cells, of a length of one.
        let slope: [f64; 3] = from_fn(|a| gradient[a] * edges[a]);
        let length = slope.iter().map(|v| v * v).sum::<f64>().sqrt();
        if !length.is_finite() || length == 0.0 {
            return Ok(None);
        }
        let direction = slope.map(|v| v / length);
        let mut reach = REACH;
        for a in 0..3 {
            let inside = (at[a] - self.world(a, key.point[a])) / edges[a];
            let room = (inside - MARGIN).min(1.0 - MARGIN - inside);
            if direction[a] != 0.0 {
                reach = reach.min(room / direction[a].abs());
            }
        }
        if reach <= 0.0 {
            return Ok(None);
        }
        let half: [f64; 3] = from_fn(|a| direction[a] * reach * edges[a]);
        Ok(Some((from_fn(|a| at[a] - half[a]), half.map(|v| 2.0 * v))))
    }

    /// The values less that of the surface, at a fraction of each way.
    fn offsets(&self, ways: &[Way], at: impl Fn(&Way) -> f64) -> Result<Vec<f64>> {
        let mut points = [const { Vec::new() }; 3];
        for way in ways {
            let p = way.at(at(way));
            (0..3).for_each(|a| points[a].push(p[a]));
        }
        let [x, y, z] = &points;
        let mut values = vec![0.0; ways.len()];
        self.model.values([x, y, z], &mut values)?;
        let iso = f64::from(self.model.convention().iso());
        values.iter_mut().for_each(|v| *v -= iso);
        Ok(values)
    }
}
