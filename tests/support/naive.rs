//! The oracle of extraction: dense marching cubes without tables, from first principles.
//!
//! On each face of each cell the surface leaves oriented arcs; the arcs of a cell join into loops;
//! every loop bounds a disk, unless the trilinear interpolant has a tunnel that joins two of them.
//! That is all that decides the topology of a mesh, and it needs no case table. Nothing of the engine is used except the types in which a question is put.
//!
//! The rules, as `docs/conventions.md` states them:
//! - inside is `value >= iso` (above) or `value < iso` (below); NaN and what lies beyond the border
//!   of a capped region is outside;
//! - on a face whose corners alternate, the sign of the saddle decides, a saddle at the isovalue
//!   counting as above; NaN counts there as the largest finite value on the outside, infinities as
//!   the largest finite value;
//! - a vertex stands at `t = (iso - a) / (b - a)` from the lower lattice point, in f32, kept within
//!   `MIN_T..=1 - MIN_T`; next to an outside without a value it stands at `MIN_T` from the inside.

use super::tunnel::tunnel;
use brickmarch::{Box3, Inside};
use std::collections::{BTreeMap, HashMap};

/// Least distance of a vertex from a lattice point.
pub(crate) const MIN_T: f32 = 1e-3;

/// Lower lattice point of an edge, and its axis.
pub(crate) type Key = ([i32; 3], u8);

/// What is meshed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Question<'a> {
    /// All samples, `i` fastest.
    pub(crate) values: &'a [f32],
    /// The box that they fill.
    pub(crate) domain: Box3,
    pub(crate) iso: f32,
    pub(crate) inside: Inside,
    /// Whether the solid is closed by one layer of outside samples around the domain.
    pub(crate) cap: bool,
}

/// The answer.
#[derive(Clone, Debug, Default)]
pub(crate) struct Surface {
    /// Every crossed lattice edge of the cells, with the place of its vertex in index space.
    pub(crate) vertices: BTreeMap<Key, [f32; 3]>,
    /// Loops of each cell, by its lowest corner, in the direction in which the disk is
    /// counter-clockwise seen from outside the solid.
    pub(crate) loops: BTreeMap<[i32; 3], Vec<Vec<Key>>>,
    /// Two loops of a cell that bound a tunnel rather than two disks, by one vertex each.
    pub(crate) tunnels: BTreeMap<[i32; 3], [Key; 2]>,
    /// Faces whose corners alternate, counted in every cell that has them.
    pub(crate) ambiguous_faces: u64,
}

/// Topology of a surface in numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Shape {
    pub(crate) components: usize,
    pub(crate) euler: i64,
    /// Lengths of the open border loops, sorted.
    pub(crate) borders: Vec<usize>,
}

impl Question<'_> {
    /// Cells that a surface may cross, as a box of their lowest corners.
    fn cells(&self) -> Box3 {
        let low = i32::from(self.cap);
        let high = i32::from(!self.cap);
        Box3::new(
            self.domain.min.map(|v| v - low),
            self.domain.max.map(|v| v - high),
        )
    }

    /// The sample, or `None` where there is no value: NaN, or beyond the border.
    fn value(&self, p: [i32; 3]) -> Option<f32> {
        let known = self
            .domain
            .contains(p)
            .then(|| self.values[self.domain.offset_of(p)]);
        known.filter(|v| !v.is_nan())
    }

    fn is_inside(&self, p: [i32; 3]) -> bool {
        self.value(p).is_some_and(|v| match self.inside {
            Inside::Above => v >= self.iso,
            Inside::Below => v < self.iso,
        })
    }

    /// Value minus iso, never NaN or infinite.
    fn offset(&self, p: [i32; 3]) -> f64 {
        let far = match self.inside {
            Inside::Above => -f64::from(f32::MAX),
            Inside::Below => f64::from(f32::MAX),
        };
        self.value(p).map_or(far, |v| {
            f64::from(v.clamp(-f32::MAX, f32::MAX)) - f64::from(self.iso)
        })
    }

    /// Where the surface crosses the edge, from its lower end.
    fn crossing(&self, key: Key) -> f32 {
        let (a, b) = (
            self.value(key.0),
            self.value(step(key.0, usize::from(key.1), 1)),
        );
        let t = match (a, b) {
            (Some(a), Some(b)) => fraction(a, b, self.iso),
            (Some(_), None) => 0.0,
            _ => 1.0,
        };
        t.clamp(MIN_T, 1.0 - MIN_T)
    }

    /// All loops of all cells.
    pub(crate) fn march(&self) -> Surface {
        let mut surface = Surface::default();
        let cells = self.cells();
        for k in cells.min[2]..cells.max[2] {
            for j in cells.min[1]..cells.max[1] {
                for i in cells.min[0]..cells.max[0] {
                    self.march_cell([i, j, k], &mut surface);
                }
            }
        }
        surface
    }

    fn march_cell(&self, cell: [i32; 3], surface: &mut Surface) {
        let mut next: BTreeMap<Key, Key> = BTreeMap::new();
        for axis in 0..3 {
            for side in 0..2 {
                let ring = face_ring(cell, axis, side);
                surface.ambiguous_faces += u64::from(self.face_arcs(ring, &mut next));
            }
        }
        for &key in next.keys() {
            let mut p = key.0.map(|v| v as f64);
            p[usize::from(key.1)] += f64::from(self.crossing(key));
            surface.vertices.insert(key, p.map(|v| v as f32));
        }
        let loops = follow(next);
        if loops.len() > 1
            && let Some(joined) = self.tunnel(cell, &loops)
        {
            surface.tunnels.insert(cell, joined);
        }
        if !loops.is_empty() {
            surface.loops.insert(cell, loops);
        }
    }

    /// The two loops that a tunnel joins, if the cell holds one. A third loop, if any, cuts off a
    /// corner of the other side than the middle of the tunnel.
    fn tunnel(&self, cell: [i32; 3], loops: &[Vec<Key>]) -> Option<[Key; 2]> {
        let corner = |i: usize| -> [i32; 3] {
            std::array::from_fn(|a| cell[a] + i32::from(i >> a & 1 == 1))
        };
        let above = tunnel(&std::array::from_fn(|i| self.offset(corner(i))))?;
        let cuts_off = |ring: &&Vec<Key>| {
            (0..8).map(corner).any(|p| {
                let ends = |&(low, axis): &Key| low == p || step(low, usize::from(axis), 1) == p;
                ring.iter().all(ends) && (self.offset(p) >= 0.0) != above
            })
        };
        let mut left = loops
            .iter()
            .filter(|ring| loops.len() == 2 || !cuts_off(ring));
        let joined = [left.next()?[0], left.next()?[0]];
        assert!(
            left.next().is_none(),
            "cell {cell:?}: a tunnel joins two loops"
        );
        Some(joined)
    }

    /// Adds the arcs of a face, whose corners come counter-clockwise seen from outside the cell.
    /// An arc has the inside on its right. Returns whether the corners alternate.
    fn face_arcs(&self, ring: [[i32; 3]; 4], next: &mut BTreeMap<Key, Key>) -> bool {
        let inside = ring.map(|p| self.is_inside(p));
        let edge = |i: usize| key_between(ring[i % 4], ring[(i + 1) % 4]);
        // Edges where the walk around the face comes in, and where it goes out.
        let enters: Vec<usize> = (0..4)
            .filter(|&i| !inside[i] && inside[(i + 1) % 4])
            .collect();
        let leaves: Vec<usize> = (0..4)
            .filter(|&i| inside[i] && !inside[(i + 1) % 4])
            .collect();
        if let ([enter], [leave]) = (&enters[..], &leaves[..]) {
            next.insert(edge(*enter), edge(*leave));
        }
        if enters.len() == 2 {
            // Apart: the arc goes around one inside corner, to the edge after. Joined: around one
            // outside corner, to the edge before.
            let turn = if self.inside_joined(ring) { 3 } else { 1 };
            for enter in enters {
                next.insert(edge(enter), edge(enter + turn));
            }
            return true;
        }
        false
    }

    /// Whether the inside corners of an alternating face are joined across it.
    fn inside_joined(&self, ring: [[i32; 3]; 4]) -> bool {
        let [a, b, c, d] = ring.map(|p| self.offset(p));
        let (above, below) = if a >= 0.0 {
            (a * c, b * d)
        } else {
            (b * d, a * c)
        };
        let above_joined = above - below >= 0.0;
        match self.inside {
            Inside::Above => above_joined,
            Inside::Below => !above_joined,
        }
    }
}

/// `(iso - a) / (b - a)` in f32; where that overflows or an end is infinite, the limit.
pub(crate) fn fraction(a: f32, b: f32, iso: f32) -> f32 {
    let t = (iso - a) / (b - a);
    if t.is_finite() {
        return t;
    }
    match (a.is_infinite(), b.is_infinite()) {
        (true, true) => 0.5,
        (true, false) => 1.0,
        (false, true) => 0.0,
        (false, false) => ((f64::from(iso) - f64::from(a)) / (f64::from(b) - f64::from(a))) as f32,
    }
}

pub(crate) fn step(mut p: [i32; 3], axis: usize, by: i32) -> [i32; 3] {
    p[axis] += by;
    p
}

/// Corners of a face, counter-clockwise seen from outside the cell.
fn face_ring(cell: [i32; 3], axis: usize, side: i32) -> [[i32; 3]; 4] {
    let base = step(cell, axis, side);
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut ring = [
        base,
        step(base, u, 1),
        step(step(base, u, 1), v, 1),
        step(base, v, 1),
    ];
    if side == 0 {
        ring.reverse();
    }
    ring
}

fn key_between(p: [i32; 3], q: [i32; 3]) -> Key {
    let axis = (0..3).find(|&a| p[a] != q[a]).expect("neighbours differ");
    (if p[axis] < q[axis] { p } else { q }, axis as u8)
}

fn follow(mut next: BTreeMap<Key, Key>) -> Vec<Vec<Key>> {
    let mut loops = Vec::new();
    while let Some((first, mut at)) = next.pop_first() {
        let mut ring = vec![first];
        while at != first {
            ring.push(at);
            at = next
                .remove(&at)
                .expect("every crossed edge has one arc in and one out");
        }
        loops.push(ring);
    }
    loops
}

impl Surface {
    /// Loops of a cell that share a sheet, and the sheets.
    fn links(&self) -> impl Iterator<Item = (Key, Key)> + '_ {
        self.tunnels.values().map(|&[a, b]| (a, b))
    }

    /// Arcs of all loops, directed.
    pub(crate) fn arcs(&self) -> impl Iterator<Item = (Key, Key)> + '_ {
        self.loops
            .values()
            .flatten()
            .flat_map(|ring| ring_arcs(ring))
    }

    /// The part that is connected to the loops of `cell`.
    pub(crate) fn through(&self, cell: [i32; 3]) -> Surface {
        let number: HashMap<Key, u32> = self
            .vertices
            .keys()
            .zip(0..)
            .map(|(&k, n)| (k, n))
            .collect();
        let mut sets = super::topology::Sets::new(self.vertices.len());
        for (a, b) in self.arcs().chain(self.links()) {
            sets.join(number[&a], number[&b]);
        }
        let seeds = self.loops.get(&cell).into_iter().flatten();
        let roots: Vec<u32> = seeds.map(|ring| sets.root(number[&ring[0]])).collect();
        let mut reached = |key: &Key| roots.contains(&sets.root(number[key]));
        let mut part = self.clone();
        part.vertices.retain(|key, _| reached(key));
        for loops in part.loops.values_mut() {
            loops.retain(|ring| reached(&ring[0]));
        }
        part.loops.retain(|_, loops| !loops.is_empty());
        part.tunnels.retain(|_, joined| reached(&joined[0]));
        part
    }

    /// Components, Euler characteristic and open borders.
    pub(crate) fn shape(&self) -> Shape {
        let number: HashMap<Key, u32> = self
            .vertices
            .keys()
            .zip(0..)
            .map(|(&k, n)| (k, n))
            .collect();
        let numbers = |(a, b)| (number[&a], number[&b]);
        let arcs: Vec<(u32, u32)> = self.arcs().map(numbers).collect();
        let links: Vec<(u32, u32)> = self.links().map(numbers).collect();
        shape(
            self.vertices.len(),
            &arcs,
            self.loops.values().map(Vec::len).sum(),
            &links,
        )
    }
}

/// Directed arcs of a loop.
pub(crate) fn ring_arcs(ring: &[Key]) -> impl Iterator<Item = (Key, Key)> + '_ {
    (0..ring.len()).map(|i| (ring[i], ring[(i + 1) % ring.len()]))
}

/// Shape of a complex of `vertices` points and the directed `edges` around `loops`, which are borders
/// of disks, but for pairs with a vertex in each of two that are linked by a tunnel.
pub(crate) fn shape(
    vertices: usize,
    edges: &[(u32, u32)],
    loops: usize,
    links: &[(u32, u32)],
) -> Shape {
    let mut directed: HashMap<(u32, u32), i32> = HashMap::new();
    let mut sets = super::topology::Sets::new(vertices);
    for &(a, b) in edges {
        *directed.entry((a, b)).or_default() += 1;
        sets.join(a, b);
    }
    links.iter().for_each(|&(a, b)| sets.join(a, b));
    let undirected = directed
        .keys()
        .filter(|&&(a, b)| a < b || !directed.contains_key(&(b, a)))
        .count();
    let mut open: BTreeMap<u32, u32> = BTreeMap::new();
    for &(a, b) in directed
        .keys()
        .filter(|&&(a, b)| !directed.contains_key(&(b, a)))
    {
        assert!(open.insert(a, b).is_none(), "two borders leave vertex {a}");
    }
    let mut borders = Vec::new();
    while let Some((first, mut at)) = open.pop_first() {
        let mut length = 1;
        while at != first {
            at = open.remove(&at).expect("a border is a loop");
            length += 1;
        }
        borders.push(length);
    }
    borders.sort_unstable();
    Shape {
        components: sets.count(),
        euler: vertices as i64 - undirected as i64 + loops as i64 - 2 * links.len() as i64,
        borders,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn question(values: &[f32], size: [i32; 3], cap: bool) -> Question<'_> {
        Question {
            values,
            domain: Box3::from_size(size),
            iso: 0.0,
            inside: Inside::Above,
            cap,
        }
    }

    #[test]
    fn one_sample_is_an_octahedron() {
        let surface = question(&[1.0], [1; 3], true).march();
        assert_eq!(surface.vertices.len(), 6);
        assert_eq!(surface.loops.len(), 8);
        let want = Shape {
            components: 1,
            euler: 2,
            borders: vec![],
        };
        assert_eq!(surface.shape(), want);
        // Outward: the loop in the first octant turns x, y, z.
        let key = |axis| ([0; 3], axis);
        assert_eq!(surface.loops[&[0; 3]], [[key(0), key(1), key(2)]]);
    }

    #[test]
    fn the_tie_joins_above() {
        // Two opposite corners of one face of a cell, equal strength: joined when above.
        let mut values = [-1.0; 8];
        (values[0], values[3]) = (1.0, 1.0);
        let above = question(&values, [2; 3], false);
        assert_eq!(above.march().loops[&[0; 3]].len(), 1);
        let below = Question {
            inside: Inside::Below,
            ..above
        };
        assert_eq!(below.march().loops[&[0; 3]].len(), 1);
        values[3] = 0.5;
        assert_eq!(
            question(&values, [2; 3], false).march().loops[&[0; 3]].len(),
            2
        );
    }

    #[test]
    fn f32_crossings_are_near_the_exact_ones() {
        let mut rng = super::super::rng::Rng::new(3);
        for _ in 0..100_000 {
            let (a, b, iso) = (rng.signed(), rng.signed(), rng.signed());
            if (a >= iso) != (b >= iso) {
                let exact = (f64::from(iso) - f64::from(a)) / (f64::from(b) - f64::from(a));
                let t = f64::from(fraction(a, b, iso));
                assert!((t - exact).abs() < 2e-7, "{a} {b} {iso}: {t} {exact}");
            }
        }
    }
}
