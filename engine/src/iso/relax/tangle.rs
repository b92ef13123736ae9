//! Triangles that go through each other, and how all of them get back to where none did.
//!
//! Taking back the moves of the vertices of two triangles that cross can make others cross. Which,
//! nobody knows before; but those that could, whichever of their vertices go back, can be told.
//! Going from each crossing from pair to pair that could cross, and taking back all of their moves,
//! leaves nothing that crosses, as far as one goes.

use super::net::Net;
use super::settle::CROSSING_RINGS;
use super::surface::{FINE, Place};

/// How far from a crossing moves are taken back, in cells: along the way from pair to pair.
const FAR: i32 = 2;

/// Cells around a tile that decide what is taken back in it.
pub(super) const RINGS: u8 = FAR as u8 + 1 + CROSSING_RINGS;

/// Not to be taken back.
const OUT_OF_REACH: i32 = i32::MAX;

/// Buffers.
#[derive(Debug, Default)]
pub(super) struct Tangles {
    /// Cells and the triangles in them, cell first.
    bins: Vec<u64>,
    /// A bit for every cell: triangles to be compared with others are in it.
    wanted: Vec<u64>,
    /// Per vertex how far it is from a crossing, in units of a place.
    reach: Vec<i32>,
    /// Per triangle the round in which a vertex of it came into reach, from 1.
    since: Vec<u32>,
    /// Pairs that could cross.
    links: Vec<[[u32; 3]; 2]>,
}

impl Tangles {
    /// Bytes for each triangle of a tile.
    pub(in super::super) const TRIANGLE_BYTES: usize = 4 * 8 + 4;

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
        let is_fresh = |t: [u32; 3]| t.iter().any(|&v| fresh[v as usize]);
        let bounds = |t| bounds(net, t);
        self.fill(net, triangles, rings, bounds, |number| {
            is_fresh(triangles[number])
        });
        self.each_pair(triangles, bounds, |first, second| {
            let (p, q) = (triangles[first], triangles[second]);
            if (is_fresh(p) || is_fresh(q)) && cross(&net.now, p, q) {
                found([p, q]);
            }
        });
    }

    /// Takes back the moves around what crosses. Only triangles with a vertex among `fresh` can.
    pub(super) fn undo(&mut self, net: &mut Net, triangles: &[[u32; 3]], fresh: &[bool]) {
        let mut reach = std::mem::take(&mut self.reach);
        reach.clear();
        reach.resize(net.now.len(), OUT_OF_REACH);
        let mut any = false;
        self.each_crossing(net, triangles, RINGS, fresh, |pair| {
            any = true;
            for v in pair.into_iter().flatten() {
                reach[v as usize] = 0;
            }
        });
        if any {
            self.spread(net, triangles, &mut reach);
            for (v, &far) in reach.iter().enumerate() {
                if far != OUT_OF_REACH {
                    net.refuse(v);
                }
            }
        }
        self.reach = reach;
    }

    /// From the vertices of crossings to those of all pairs that could cross, one by one.
    fn spread(&mut self, net: &Net, triangles: &[[u32; 3]], reach: &mut [i32]) {
        let mut links = std::mem::take(&mut self.links);
        let mut since = std::mem::take(&mut self.since);
        links.clear();
        since.clear();
        since.resize(triangles.len(), 0);
        let hull = |t| hull(net, t);
        for round in 1.. {
            let mut any = false;
            for (t, since) in triangles.iter().zip(&mut since) {
                let reached = t.iter().any(|&v| reach[v as usize] != OUT_OF_REACH);
                if *since == 0 && reached {
                    *since = round;
                    any = true;
                }
            }
            if !any {
                break;
            }
            self.fill(net, triangles, RINGS, hull, |number| since[number] == round);
            self.each_pair(triangles, hull, |first, second| {
                let first_of = [since[first], since[second]].into_iter().filter(|&r| r > 0);
                let (p, q) = (triangles[first], triangles[second]);
                if first_of.min() == Some(round) && could_cross(net, p, q) {
                    links.push([p, q]);
                }
            });
            while links
                .iter()
                .fold(false, |any, link| any | pull(net, link, reach))
            {}
        }
        (self.links, self.since) = (links, since);
    }

    /// Sorts the triangles near two sheets into the cells that their bounds meet, as far as there
    /// is a triangle in the cell that is `wanted`, by its number.
    fn fill(
        &mut self,
        net: &Net,
        triangles: &[[u32; 3]],
        rings: u8,
        bounds: impl Fn([u32; 3]) -> [Place; 2],
        wanted: impl Fn(usize) -> bool,
    ) {
        self.wanted.clear();
        self.wanted.resize(1 << (3 * 7 - 6), 0);
        self.bins.clear();
        let is_near = |t: &[u32; 3]| {
            t.iter().any(|&v| net.close[v as usize])
                && t.iter().all(|&v| net.rings[v as usize] <= rings)
        };
        for (number, t) in triangles.iter().enumerate() {
            if is_near(t) && wanted(number) {
                each_bin(bounds(*t), |bin| {
                    self.wanted[bin as usize >> 6] |= 1 << (bin & 63)
                });
            }
        }
        for (number, t) in triangles.iter().enumerate() {
            if is_near(t) {
                each_bin(bounds(*t), |bin| {
                    if self.wanted[bin as usize >> 6] >> (bin & 63) & 1 == 1 {
                        self.bins.push(u64::from(bin) << 32 | number as u64);
                    }
                });
            }
        }
        self.bins.sort_unstable();
    }

    /// Calls `f` once with the numbers of every two triangles whose bounds meet in a cell.
    fn each_pair(
        &self,
        triangles: &[[u32; 3]],
        bounds: impl Fn([u32; 3]) -> [Place; 2],
        mut f: impl FnMut(usize, usize),
    ) {
        for bin in self.bins.chunk_by(|a, b| a >> 32 == b >> 32) {
            let number = |entry: u64| entry as u32 as usize;
            for (i, &entry) in bin.iter().enumerate() {
                for &other in &bin[..i] {
                    let (first, second) = (number(entry), number(other));
                    let boxes = (bounds(triangles[first]), bounds(triangles[second]));
                    if meet_first(boxes, (entry >> 32) as u32) {
                        f(first, second);
                    }
                }
            }
        }
    }
}

/// Brings the vertices of a pair into reach if one of them is; whether one came nearer.
fn pull(net: &Net, link: &[[u32; 3]; 2], reach: &mut [i32]) -> bool {
    let mut any = false;
    for &from in link.as_flattened() {
        let far = reach[from as usize];
        if far == OUT_OF_REACH {
            continue;
        }
        for &to in link.as_flattened() {
            let (a, b) = (net.start[from as usize], net.start[to as usize]);
            let step = (0..3).fold(0, |most, k| most.max((a[k] - b[k]).abs()));
            let there = far.saturating_add(step);
            if there <= FAR << FINE && there < reach[to as usize] {
                reach[to as usize] = there;
                any = true;
            }
        }
    }
    any
}

/// Whether two triangles cross when some of their vertices, or none, go back to the start.
fn could_cross(net: &Net, p: [u32; 3], q: [u32; 3]) -> bool {
    // One after the other, those of both once.
    let mut all = [p[0], p[1], p[2], 0, 0, 0];
    let mut count = 3;
    let q = q.map(|v| {
        (0..count).find(|&i| all[i] == v).unwrap_or_else(|| {
            all[count] = v;
            count += 1;
            count - 1
        })
    });
    let q = q.map(|i| i as u32);
    if count < 5 {
        // With a side in common they only touch.
        return false;
    }
    let all = &all[..count];
    let mut places = [[0; 3]; 6];
    (0..1u32 << count).any(|back| {
        let mut same = false;
        for (i, &v) in all.iter().enumerate() {
            let (start, now) = (net.start[v as usize], net.now[v as usize]);
            same |= back >> i & 1 == 1 && start == now;
            places[i] = if back >> i & 1 == 1 { start } else { now };
        }
        !same && cross(&places, [0, 1, 2], q)
    })
}

/// Number of a cell of the tile.
#[inline(always)]
fn bin(cell: Place) -> u32 {
    (cell[0] | cell[1] << 7 | cell[2] << 14) as u32
}

/// Calls `f` with the cells that a box meets.
#[inline(always)]
fn each_bin(bounds: [Place; 2], mut f: impl FnMut(u32)) {
    let [low, high] = bounds.map(|p| p.map(|v| v >> FINE));
    for z in low[2]..=high[2] {
        for y in low[1]..=high[1] {
            for x in low[0]..=high[0] {
                f(bin([x, y, z]));
            }
        }
    }
}

/// Lowest and highest coordinates of a triangle.
#[inline(always)]
fn bounds(net: &Net, t: [u32; 3]) -> [Place; 2] {
    around(t.map(|v| net.now[v as usize]))
}

/// The same wherever its vertices are, moved or not.
fn hull(net: &Net, t: [u32; 3]) -> [Place; 2] {
    let [a, b] = bounds(net, t);
    let [c, d] = around(t.map(|v| net.start[v as usize]));
    [
        [0, 1, 2].map(|k| a[k].min(c[k])),
        [0, 1, 2].map(|k| b[k].max(d[k])),
    ]
}

#[inline(always)]
fn around([a, b, c]: [Place; 3]) -> [Place; 2] {
    let least = |k: usize| a[k].min(b[k]).min(c[k]);
    let most = |k: usize| a[k].max(b[k]).max(c[k]);
    [[least(0), least(1), least(2)], [most(0), most(1), most(2)]]
}

/// Whether two boxes meet and `at` is the first cell where they do, so that a pair is looked at
/// once.
#[inline(always)]
fn meet_first(([p_low, p_high], [q_low, q_high]): ([Place; 2], [Place; 2]), at: u32) -> bool {
    let low = |k: usize| p_low[k].max(q_low[k]);
    let meet = |k: usize| low(k) <= p_high[k].min(q_high[k]);
    meet(0) && meet(1) && meet(2) && bin([low(0) >> FINE, low(1) >> FINE, low(2) >> FINE]) == at
}

/// Whether a side of one that has no end in the other goes through it. Touching counts.
#[inline(always)]
fn cross(places: &[Place], p: [u32; 3], q: [u32; 3]) -> bool {
    crossing(places, p, q) || crossing(places, q, p)
}

/// Whether a side of `p` goes through `q`.
fn crossing(places: &[Place], p: [u32; 3], q: [u32; 3]) -> bool {
    let place = |v: u32| places[v as usize];
    let [a, b, c] = q.map(place);
    (0..3).any(|k| {
        let (from, to) = (p[k], p[(k + 1) % 3]);
        if q.contains(&from) || q.contains(&to) {
            return false;
        }
        let (from, to) = (place(from), place(to));
        let (here, there) = (side(a, b, c, from), side(a, b, c, to));
        if here * there > 0 || (here == 0 && there == 0) {
            return false;
        }
        let around = [
            side(from, to, a, b),
            side(from, to, b, c),
            side(from, to, c, a),
        ];
        around.iter().all(|&s| s >= 0) || around.iter().all(|&s| s <= 0)
    })
}

/// The sign of the volume of a tetrahedron, exactly.
#[inline(always)]
fn side(a: Place, b: Place, c: Place, d: Place) -> i32 {
    let from = |p: Place| [0, 1, 2].map(|k| f64::from(p[k] - d[k]));
    let (p, q, r) = (from(a), from(b), from(c));
    let (mut volume, mut size) = (0.0, 0.0);
    for k in 0..3 {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        let (left, right) = (q[i] * r[j], q[j] * r[i]);
        volume += p[k] * (left - right);
        size += p[k].abs() * (left.abs() + right.abs());
    }
    // A few roundings, each at most 2^-53 of the size.
    if volume.abs() > 1e-15 * size {
        return if volume > 0.0 { 1 } else { -1 };
    }
    side_exactly(a, b, c, d)
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
        assert!(crossing(&places, [3, 4, 5], [0, 1, 2]));
        assert!(crossing(&places, [0, 1, 2], [3, 4, 5]));
        assert!(!crossing(&places, [6, 4, 5], [0, 1, 2]));
        // Neighbours do not cross in their common corner or side.
        assert!(!crossing(&places, [0, 4, 5], [0, 1, 2]));
        assert!(!crossing(&places, [0, 1, 4], [0, 1, 2]));
    }

    #[test]
    fn sides_are_exact() {
        // In a plane through large numbers, and one unit beside it.
        let (a, b, c) = ([1 << 26, 3, 1], [5, (1 << 26) + 1, 1], [9, 7, 1]);
        assert_eq!(side(a, b, c, [12_345, 54_321, 1]), 0);
        let above = side(a, b, c, [12_345, 54_321, 2]);
        assert_eq!(above.abs(), 1);
        assert_eq!(side(a, b, c, [12_345, 54_321, 0]), -above);
        assert_eq!(side(b, a, c, [12_345, 54_321, 2]), -above);
    }
}
