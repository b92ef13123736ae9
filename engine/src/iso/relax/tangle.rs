//! Triangles that go through each other.

use super::net::Net;
use super::surface::{FINE, Place};
use std::ops::Range;

/// Cells per axis of a tile with all around it, and a little more.
const ACROSS: i32 = 66;

/// Cells along z that are looked at together: a part of the tile at a time, to save memory.
const SLAB: i32 = 8;

/// Cells of a slab.
const SLAB_CELLS: usize = (ACROSS * ACROSS * SLAB) as usize;

/// In place of the first triangle of a cell: there is none, or nobody asks.
const NONE: u32 = u32::MAX;
const UNWANTED: u32 = u32::MAX - 1;

/// The bounds of a triangle: its lowest and highest coordinates.
type Bounds = [Place; 2];

/// Buffers.
#[derive(Debug, Default)]
pub(super) struct Tangles {
    /// Per cell the last entry in it.
    last: Vec<u32>,
    /// The triangle by its place in `bounds`, and the entry before it in the same cell.
    entries: Vec<[u32; 2]>,
    bounds: Vec<(u32, Bounds)>,
    /// Per slab the first triangle near two sheets that can meet it, and the one after the last.
    spans: Vec<[u32; 2]>,
}

impl Tangles {
    /// Finds which triangles near two sheets belong to which slab, for all that follows; bytes that
    /// the buffers will take.
    pub(super) fn prepare(&mut self, net: &Net, triangles: &[[u32; 3]]) -> u64 {
        self.spans.clear();
        self.spans
            .resize((ACROSS as usize).div_ceil(SLAB as usize), [u32::MAX, 0]);
        for (number, &t) in (0..).zip(triangles) {
            if t.iter().any(|&v| net.close[v as usize]) {
                let [low, high] = bounds(&net.start, t).map(|p| p[2]);
                // Wherever they go from there.
                let low = (low - (1 << (FINE - 1))).max(0) >> FINE;
                let high = (high + (1 << (FINE - 1))) >> FINE;
                for span in &mut self.spans[(low / SLAB) as usize..=(high / SLAB) as usize] {
                    *span = [span[0].min(number), span[1].max(number + 1)];
                }
            }
        }
        let spans = self.spans.iter().map(|s| s[1].saturating_sub(s[0]));
        let longest = u64::from(spans.max().unwrap_or(0));
        // Some four cells for each triangle.
        longest * (4 * 8 + size_of::<(u32, Bounds)>() as u64) + 4 * SLAB_CELLS as u64
    }

    /// Calls `found` with every two triangles that cross and have a vertex among `fresh`, and all
    /// vertices at most `rings` cells beyond the tile.
    pub(super) fn each_crossing(
        &mut self,
        net: &Net,
        triangles: &[[u32; 3]],
        rings: u8,
        fresh: &[bool],
        mut found: impl FnMut([[u32; 3]; 2]),
    ) {
        let is_fresh = |n: u32| {
            let [a, b, c] = triangles[n as usize];
            fresh[a as usize] || fresh[b as usize] || fresh[c as usize]
        };
        self.each_pair(net, triangles, rings, is_fresh, |first, second| {
            let (p, q) = (triangles[first as usize], triangles[second as usize]);
            if (is_fresh(first) || is_fresh(second)) && cross(&net.now, p, q, net.rounding) {
                found([p, q]);
            }
        });
    }

    /// Calls `f` once with the numbers of every two triangles near two sheets whose bounds meet in
    /// a cell where a triangle is `wanted`.
    #[inline(always)]
    fn each_pair(
        &mut self,
        net: &Net,
        triangles: &[[u32; 3]],
        rings: u8,
        wanted: impl Fn(u32) -> bool,
        mut f: impl FnMut(u32, u32),
    ) {
        let near = |t: [u32; 3]| {
            let [a, b, c] = [t[0] as usize, t[1] as usize, t[2] as usize];
            (net.close[a] || net.close[b] || net.close[c])
                && net.rings[a].max(net.rings[b]).max(net.rings[c]) <= rings
        };
        let (last, entries) = (&mut self.last, &mut self.entries);
        for (slab, &[from, to]) in (0..).zip(&self.spans) {
            let slab = slab * SLAB..(slab + 1) * SLAB;
            let mut any = false;
            for number in from..to {
                let t = triangles[number as usize];
                if !wanted(number) || !near(t) {
                    continue;
                }
                if !any {
                    last.clear();
                    last.resize(SLAB_CELLS, UNWANTED);
                    any = true;
                }
                each_cell(&bounds(&net.now, t), &slab, |cell| last[cell] = NONE);
            }
            if !any {
                continue;
            }
            entries.clear();
            self.bounds.clear();
            for number in from..to {
                let t = triangles[number as usize];
                if !near(t) {
                    continue;
                }
                let place = self.bounds.len() as u32;
                let its = bounds(&net.now, t);
                let mut kept = false;
                each_cell(&its, &slab, |cell| {
                    if last[cell] == UNWANTED {
                        return;
                    }
                    let mut at = last[cell];
                    while at != NONE {
                        let [other, before] = entries[at as usize];
                        let (other, others) = &self.bounds[other as usize];
                        if meet_first(&its, others, slab.start, cell) {
                            f(number, *other);
                        }
                        at = before;
                    }
                    entries.push([place, last[cell]]);
                    last[cell] = entries.len() as u32 - 1;
                    kept = true;
                });
                if kept {
                    self.bounds.push((number, its));
                }
            }
        }
    }
}

/// Number of a cell of a slab; beyond all others for a cell below it.
#[inline(always)]
fn number(x: i32, y: i32, z: i32) -> usize {
    (x + ACROSS * (y + ACROSS * z)) as usize
}

/// Calls `f` with the cells of a slab that a box meets.
#[inline(always)]
fn each_cell([low, high]: &Bounds, slab: &Range<i32>, mut f: impl FnMut(usize)) {
    for z in (low[2] >> FINE).max(slab.start)..=(high[2] >> FINE).min(slab.end - 1) {
        for y in low[1] >> FINE..=high[1] >> FINE {
            for x in low[0] >> FINE..=high[0] >> FINE {
                f(number(x, y, z - slab.start));
            }
        }
    }
}

#[inline(always)]
fn bounds(places: &[Place], t: [u32; 3]) -> Bounds {
    let (a, b, c) = (
        places[t[0] as usize],
        places[t[1] as usize],
        places[t[2] as usize],
    );
    let (ab, ba) = (lower(a, b), upper(a, b));
    [lower(ab, c), upper(ba, c)]
}

#[inline(always)]
fn lower(a: Place, b: Place) -> Place {
    [a[0].min(b[0]), a[1].min(b[1]), a[2].min(b[2])]
}

#[inline(always)]
fn upper(a: Place, b: Place) -> Place {
    [a[0].max(b[0]), a[1].max(b[1]), a[2].max(b[2])]
}

/// Whether two boxes meet and `cell` is the first where they do, so that a pair is looked at once.
#[inline(always)]
fn meet_first(p: &Bounds, q: &Bounds, first: i32, cell: usize) -> bool {
    let (low, high) = (upper(p[0], q[0]), lower(p[1], q[1]));
    low[0] <= high[0]
        && low[1] <= high[1]
        && low[2] <= high[2]
        && number(low[0] >> FINE, low[1] >> FINE, (low[2] >> FINE) - first) == cell
}

/// Whether a side of one that has no end in the other goes through it, or could once every
/// coordinate is rounded, by less than `rounding`. Touching counts.
#[inline(always)]
fn cross(places: &[Place], p: [u32; 3], q: [u32; 3], rounding: f64) -> bool {
    if !may_cross(places, p, q, rounding) || !may_cross(places, q, p, rounding) {
        return false;
    }
    crossing(places, p, q, 0.0)
        || crossing(places, q, p, 0.0)
        || crossing(places, p, q, rounding)
        || crossing(places, q, p, rounding)
}

/// False when the corners of `p` that are not in `q` lie on one side of it.
#[inline(always)]
fn may_cross(places: &[Place], p: [u32; 3], q: [u32; 3], rounding: f64) -> bool {
    let [a, b, c] = corners(places, q);
    let (mut above, mut below) = (false, false);
    for v in p {
        if q[0] == v || q[1] == v || q[2] == v {
            continue;
        }
        let side = side(a, b, c, places[v as usize], rounding);
        above |= side >= 0;
        below |= side <= 0;
    }
    above && below
}

#[inline(always)]
fn corners(places: &[Place], t: [u32; 3]) -> [Place; 3] {
    [
        places[t[0] as usize],
        places[t[1] as usize],
        places[t[2] as usize],
    ]
}

/// Whether a side of `p` goes through `q`.
fn crossing(places: &[Place], p: [u32; 3], q: [u32; 3], rounding: f64) -> bool {
    let [a, b, c] = corners(places, q);
    for (from, to) in [(p[0], p[1]), (p[1], p[2]), (p[2], p[0])] {
        if q[0] == from || q[1] == from || q[2] == from || q[0] == to || q[1] == to || q[2] == to {
            continue;
        }
        let (from, to) = (places[from as usize], places[to as usize]);
        let here = side(a, b, c, from, rounding);
        let there = side(a, b, c, to, rounding);
        if here == 0 && there == 0 && rounding > 0.0 && opposed(corners(places, p), [a, b, c]) {
            // Two sheets so near each other that rounding may mingle them.
            return true;
        }
        if here * there > 0 || (here == 0 && there == 0) {
            continue;
        }
        let (x, y, z) = (
            side(from, to, a, b, rounding),
            side(from, to, b, c, rounding),
            side(from, to, c, a, rounding),
        );
        if (x >= 0 && y >= 0 && z >= 0) || (x <= 0 && y <= 0 && z <= 0) {
            return true;
        }
    }
    false
}

/// Whether two triangles face against each other.
#[cold]
fn opposed(p: [Place; 3], q: [Place; 3]) -> bool {
    let [p, q] = [p, q].map(|[a, b, c]| {
        let step = |to: Place, k: usize| f64::from(to[k] - a[k]);
        [0, 1, 2].map(|k| {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            step(b, i) * step(c, j) - step(b, j) * step(c, i)
        })
    });
    p[0] * q[0] + p[1] * q[1] + p[2] * q[2] < 0.0
}

/// The sign of the volume of a tetrahedron, exactly; 0 where it can change when the coordinates are
/// rounded.
#[inline(always)]
fn side(a: Place, b: Place, c: Place, d: Place, rounding: f64) -> i32 {
    let from = |p: Place, k: usize| f64::from(p[k].wrapping_sub(d[k]));
    let p = [from(a, 0), from(a, 1), from(a, 2)];
    let q = [from(b, 0), from(b, 1), from(b, 2)];
    let r = [from(c, 0), from(c, 1), from(c, 2)];
    let (mut volume, mut size) = (0.0, 0.0);
    for k in 0..3 {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        let (left, right) = (q[i] * r[j], q[j] * r[i]);
        volume += p[k] * (left - right);
        size += p[k].abs() * (left.abs() + right.abs());
    }
    if rounding > 0.0 {
        // Each difference changes by less than twice the rounding.
        let area = area(p, q) + area(q, r) + area(r, p);
        if volume.abs() <= 2.0 * rounding * area {
            return 0;
        }
    }
    // A few roundings, each at most 2^-53 of the size.
    if volume.abs() > 1e-15 * size {
        return if volume > 0.0 { 1 } else { -1 };
    }
    side_exactly(a, b, c, d)
}

/// The sum of the coordinates of a vector product.
#[inline(always)]
fn area(p: [f64; 3], q: [f64; 3]) -> f64 {
    (p[1] * q[2] - p[2] * q[1]).abs()
        + (p[2] * q[0] - p[0] * q[2]).abs()
        + (p[0] * q[1] - p[1] * q[0]).abs()
}

/// Places have 27 bits, so the volume has fewer than 90.
#[cold]
fn side_exactly(a: Place, b: Place, c: Place, d: Place) -> i32 {
    let from = |p: Place| [0, 1, 2].map(|k| i128::from(p[k]) - i128::from(d[k]));
    let (a, b, c) = (from(a), from(b), from(c));
    let volume = a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0]);
    volume.signum() as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crossing_triangles_are_found() {
        let u = 1 << FINE;
        let places = [
            [0, 0, 0],
            [2 * u, 0, 0],
            [0, 2 * u, 0],
            [u / 2, u / 2, -u],
            [u / 2, u / 2, u],
            [3 * u, 3 * u, u],
            [u / 2, u / 2, u / 9],
        ];
        assert!(crossing(&places, [3, 4, 5], [0, 1, 2], 0.0));
        assert!(crossing(&places, [0, 1, 2], [3, 4, 5], 0.0));
        assert!(!crossing(&places, [6, 4, 5], [0, 1, 2], 0.0));
        // Apart by less than the coordinates are rounded.
        let near = [
            [0, 0, 0],
            [2 * u, 0, 0],
            [0, 2 * u, 0],
            [u / 2, u / 2, 3],
            [u / 2, u / 2, u],
            [3 * u, 3 * u, u],
        ];
        assert!(!cross(&near, [3, 4, 5], [0, 1, 2], 0.0));
        assert!(!cross(&near, [3, 4, 5], [0, 1, 2], 1.0));
        assert!(cross(&near, [3, 4, 5], [0, 1, 2], 4.0));
        // Neighbours do not cross in their common corner or side.
        assert!(!crossing(&places, [0, 4, 5], [0, 1, 2], 0.0));
        assert!(!crossing(&places, [0, 1, 4], [0, 1, 2], 0.0));
    }

    #[test]
    fn sides_are_exact() {
        // In a plane through large numbers, and one unit beside it.
        let (a, b, c) = ([1 << 26, 3, 1], [5, (1 << 26) + 1, 1], [9, 7, 1]);
        assert_eq!(side(a, b, c, [12_345, 54_321, 1], 0.0), 0);
        let above = side(a, b, c, [12_345, 54_321, 2], 0.0);
        assert_eq!(above.abs(), 1);
        assert_eq!(side(a, b, c, [12_345, 54_321, 0], 0.0), -above);
        assert_eq!(side(b, a, c, [12_345, 54_321, 2], 0.0), -above);
    }
}
