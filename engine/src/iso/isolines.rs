//! Isolines of a raster: marching squares by the rule of the faces of cells, joined into polylines.
//!
//! A point is a crossed edge of the raster, a segment joins two of them in a square. Segments have the
//! inside on their left (x to the right, y up), so of the two squares at an edge one has the segment that
//! comes in there and the other the one that goes on: lines never branch, and are joined by number.

use super::ambiguity::{is_joined, offsets};
use super::place::{MIN_T, along};
use crate::budget::{Budget, Permit};
use crate::error::{Error, Result};
use crate::sample::Inside;

/// Memory of a segment: its two ends, the one after it, whether it has one before, its points, and its line
/// twice, since their list grows.
const SEGMENT_BYTES: u64 = 16 + 8 + 1 + 2 * 16 + 2 * 16;
const NONE: usize = usize::MAX;

/// Values on a raster, rows one after another.
#[derive(Clone, Copy)]
pub struct Raster<'a> {
    /// `values[x + y * size[0]]`.
    pub values: &'a [f32],
    /// Values in a row, and rows.
    pub size: [usize; 2],
    /// Whether the square whose lowest corner is at these `x` and `y` is looked at: lines end at those that
    /// are not.
    pub squares: &'a (dyn Fn(usize, usize) -> bool + Sync),
}

/// Lines of one isovalue.
#[derive(Debug)]
pub struct Isolines {
    points: Vec<[f64; 2]>,
    /// End of the points of each line, and whether it is closed.
    ends: Vec<(usize, bool)>,
    _permit: Permit,
}

/// One of them. The inside is on its left where x goes to the right and y up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Isoline<'a> {
    /// Positions in the raster; value `(x, y)` is at `[x, y]`.
    pub points: &'a [[f64; 2]],
    /// Whether the last point goes on to the first, which is not repeated.
    pub closed: bool,
}

impl Isolines {
    /// Number of lines.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// The lines: those that end somewhere first, then those that do not; each kind by its first point.
    pub fn iter(&self) -> impl Iterator<Item = Isoline<'_>> {
        self.ends.iter().enumerate().map(|(n, &(end, closed))| {
            let start = n.checked_sub(1).map_or(0, |before| self.ends[before].0);
            Isoline {
                points: &self.points[start..end],
                closed,
            }
        })
    }
}

/// The lines along which a raster has the value `iso`.
///
/// They are where the surface of the isovalue meets a lattice plane, with its points: at
/// `t = (iso - a) / (b - a)` of crossed edges, 0.001 away from their ends at least. Squares whose corners alternate are
/// decided by the saddle of the bilinear interpolant (Nielson and Hamann 1991), exactly; NaN is outside.
///
/// ```
/// use brickmarch::{Budget, Inside, iso::{Raster, isolines}};
/// let values: Vec<f32> = (0..9).map(|n| if n == 4 { 1.0 } else { 0.0 }).collect();
/// let raster = Raster { values: &values, size: [3, 3], squares: &|_, _| true };
/// let lines = isolines(&raster, 0.5, Inside::Above, &Budget::mib(1)).unwrap();
/// let line = lines.iter().next().unwrap();
/// assert!(line.closed && lines.len() == 1);
/// assert_eq!(line.points, [[1.0, 0.5], [1.5, 1.0], [1.0, 1.5], [0.5, 1.0]]);
/// ```
///
/// # Errors
/// Values that are not as many as the size says, `BudgetExceeded`, `Cancelled`.
///
/// # Memory
/// 89 bytes a segment, until the lines are dropped.
pub fn isolines(
    raster: &Raster<'_>,
    iso: f32,
    inside: Inside,
    budget: &Budget,
) -> Result<Isolines> {
    let [w, h] = raster.size;
    if w.checked_mul(h) != Some(raster.values.len()) {
        return Err(Error::bad_input(format!(
            "{} values of a raster of {w} x {h}",
            raster.values.len()
        )));
    }
    let squares = Squares {
        raster,
        iso,
        inside,
    };
    let mut count = 0u64;
    squares.each_segment(budget, |_, _| count += 1)?;
    let permit = budget.take(count.saturating_mul(SEGMENT_BYTES), "isolines")?;
    let mut segments = Vec::with_capacity(count as usize);
    squares.each_segment(budget, |from, to| segments.push((from, to)))?;
    segments.sort_unstable();

    let mut next = vec![NONE; segments.len()];
    let mut has_before = vec![false; segments.len()];
    for (n, &(_, to)) in segments.iter().enumerate() {
        if let Ok(after) = segments.binary_search_by_key(&to, |s| s.0) {
            next[n] = after;
            has_before[after] = true;
        }
    }
    let mut lines = Isolines {
        // An open line has one point more than segments.
        points: Vec::with_capacity(2 * segments.len()),
        ends: Vec::new(),
        _permit: permit,
    };
    let starts = (0..segments.len()).filter(|&n| !has_before[n]);
    for start in starts {
        let mut at = start;
        loop {
            lines.points.push(squares.point(segments[at].0));
            let after = std::mem::replace(&mut next[at], NONE);
            if after == NONE {
                break;
            }
            at = after;
        }
        lines.points.push(squares.point(segments[at].1));
        lines.ends.push((lines.points.len(), false));
    }
    // What is left goes around.
    for start in 0..segments.len() {
        let mut at = start;
        let before = lines.points.len();
        while next[at] != NONE {
            lines.points.push(squares.point(segments[at].0));
            at = std::mem::replace(&mut next[at], NONE);
        }
        if lines.points.len() > before {
            lines.ends.push((lines.points.len(), true));
        }
    }
    Ok(lines)
}

struct Squares<'a> {
    raster: &'a Raster<'a>,
    iso: f32,
    inside: Inside,
}

impl Squares<'_> {
    /// Calls `take(from, to)` with the edges that each segment joins.
    fn each_segment(&self, budget: &Budget, mut take: impl FnMut(u64, u64)) -> Result<()> {
        let [w, h] = self.raster.size;
        if w < 2 {
            return Ok(());
        }
        let side = |value: f32| self.inside.contains(value, self.iso);
        for y in 1..h {
            budget.check_cancelled()?;
            let low = &self.raster.values[(y - 1) * w..y * w];
            let high = &self.raster.values[y * w..(y + 1) * w];
            let mut left = [side(low[0]), side(high[0])];
            for x in 1..w {
                let right = [side(low[x]), side(high[x])];
                let mixed = left != right || left[0] != left[1];
                if mixed && (self.raster.squares)(x - 1, y - 1) {
                    let ring = [left[0], right[0], right[1], left[1]];
                    let values = [low[x - 1], low[x], high[x], high[x - 1]];
                    let edges = self.edges(x - 1, y - 1);
                    self.square(ring, &values, |from, to| take(edges[from], edges[to]));
                }
                left = right;
            }
        }
        Ok(())
    }

    /// Numbers of the edges of a square, in the order of its corners; edge `n` starts at corner `n`.
    fn edges(&self, x: usize, y: usize) -> [u64; 4] {
        let w = self.raster.size[0];
        let edge = |x: usize, y: usize, axis: u64| 2 * (x + w * y) as u64 + axis;
        [
            edge(x, y, 0),
            edge(x + 1, y, 1),
            edge(x, y + 1, 0),
            edge(x, y, 1),
        ]
    }

    /// The segments of a square, as edges of it, given its corners around it.
    fn square(&self, ring: [bool; 4], values: &[f32; 4], mut take: impl FnMut(usize, usize)) {
        let leaves = |edge: usize| ring[edge] && !ring[(edge + 1) % 4];
        let alternates = ring[0] == ring[2] && ring[1] == ring[3];
        if !alternates {
            let from = (0..4).find(|&e| leaves(e)).expect("corners differ");
            let enters = |edge: usize| !ring[edge] && ring[(edge + 1) % 4];
            let to = (0..4).find(|&e| enters(e)).expect("corners differ");
            return take(from, to);
        }
        // Around the corner outside that comes after, or around the corner inside.
        let joined = is_joined(offsets(values, self.iso, self.inside), self.inside);
        let step = if joined { 1 } else { 3 };
        for from in (0..4).filter(|&e| leaves(e)) {
            take(from, (from + step) % 4);
        }
    }

    /// Where the isovalue crosses an edge.
    fn point(&self, edge: u64) -> [f64; 2] {
        let w = self.raster.size[0];
        let low = (edge / 2) as usize;
        let along_y = edge % 2 == 1;
        let high = low + if along_y { w } else { 1 };
        let values = self.raster.values;
        let t = f64::from(along(values[low], values[high], self.iso, MIN_T));
        let (x, y) = ((low % w) as f64, (low / w) as f64);
        if along_y { [x, y + t] } else { [x + t, y] }
    }
}
