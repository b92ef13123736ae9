//! Triangles per case, derived from the numbering of the cube.
//!
//! A case is the mask of inside corners and, for each face whose corners alternate, whether its
//! inside corners are joined across the face. On every face the surface leaves oriented arcs, with
//! the inside on their right seen from outside the cell; the arcs close to loops; each loop bounds
//! a disk. The disk is cut into triangles so that no inner edge runs between two vertices of one
//! face: only then can an edge never be met from the neighbouring cell, and the mesh stays
//! 2-manifold (with the faces decided alike from both sides). Where no such cut exists the disk
//! becomes a fan around a vertex inside the cell.
//!
//! Arcs and loops: Nielson and Hamann 1991. The rule for inner edges: Montani, Scateni and Scopigno
//! 1994 discuss what happens without it.

use super::cube::{edge_axis, edge_between, edge_in_face, edge_origin, face_corners};
use super::waist::{TunnelCase, tunnel_case};
use std::sync::LazyLock;

/// Corner of a triangle beside the edges of the cell, 0 to 11: the vertex inside a loop.
pub(crate) const CENTRE: u8 = 12;

/// Most triangles of a case: a fan around the longest loop.
pub(crate) const TRIANGLES_MAX: usize = 12;

/// Where the number of the vertex on an edge stands among the 16 that a cell has: the four x edges,
/// the two y and two z edges at x, and from 8 on those at x + 1.
pub(crate) const EDGE_LANE: [u8; 12] = [0, 1, 2, 3, 4, 12, 5, 13, 6, 14, 7, 15];

/// What the surface looks like in one case. Fixed arrays: the mesher reads one per cell.
#[derive(Clone, Debug, Default)]
pub(crate) struct Entry {
    count: u8,
    triangles: [[u8; 3]; TRIANGLES_MAX],
    centre_length: u8,
    centre: [u8; 12],
    lanes: [u8; 16],
}

impl Entry {
    /// The corners of the triangles by [`EDGE_LANE`], for entries of at most five triangles and no
    /// vertex inside.
    #[inline(always)]
    pub(crate) fn lanes(&self) -> &[u8; 16] {
        &self.lanes
    }

    fn fill_lanes(&mut self) {
        let corners = self.triangles.as_flattened();
        for (lane, &edge) in self.lanes.iter_mut().zip(&corners[..15]) {
            *lane = EDGE_LANE.get(usize::from(edge)).copied().unwrap_or(0);
        }
    }

    /// Triangles, counter-clockwise seen from the outside of the solid.
    #[inline(always)]
    pub(crate) fn triangles(&self) -> &[[u8; 3]] {
        &self.triangles[..usize::from(self.count).min(TRIANGLES_MAX)]
    }

    /// The loop that has the vertex [`CENTRE`] inside, by the edges of its vertices; empty where
    /// there is none. No case has two.
    #[inline(always)]
    pub(crate) fn centre(&self) -> &[u8] {
        &self.centre[..usize::from(self.centre_length).min(12)]
    }

    fn push(&mut self, triangle: [u8; 3]) {
        self.triangles[usize::from(self.count)] = triangle;
        self.count += 1;
    }
}

/// All cases.
pub(crate) struct Table {
    /// Faces whose corners alternate, a bit each, per mask.
    pub(crate) ambiguous: [u8; 256],
    /// Not zero where the mask alone does not tell the case: it has ambiguous faces, or it may hold a
    /// tunnel without having any (two opposite corners against the rest).
    pub(crate) undecided: [u8; 256],
    /// Triangles of a mask that tells the case.
    pub(crate) plain_triangles: [u8; 256],
    /// Their corners, see [`Entry::lanes`].
    pub(crate) plain_lanes: [[u8; 16]; 256],
    first: [u16; 256],
    entries: Vec<Entry>,
}

/// The cases with a tunnel, apart from the table: most runs meet none, and it takes 8 ms to find them.
struct Tunnels {
    /// They are numbered after the entries.
    cases: Vec<TunnelCase>,
    /// Per entry the numbers of its tunnels, by [`slot`].
    slots: Vec<[u16; 8]>,
}

/// No such tunnel.
const NONE: u16 = u16::MAX;

/// Place of a tunnel in the list of an entry: its diagonal, and whether the box is inside.
fn slot(apex: usize, box_inside: bool) -> usize {
    let diagonal = if apex == 4 { 3 } else { apex };
    2 * diagonal + usize::from(box_inside)
}

impl Table {
    /// The number of `mask` when the inside corners of the faces in `joined` are joined; only the
    /// bits of ambiguous faces count.
    #[inline]
    pub(crate) fn number(&self, mask: u8, joined: u8) -> u16 {
        let first = self.first[mask as usize];
        match self.ambiguous[mask as usize] {
            0 => first,
            faces => first + u16::from(RANKS[usize::from(faces)][usize::from(joined & 63)]),
        }
    }

    /// The entry of a number, or its tunnel.
    #[inline(always)]
    pub(crate) fn case(&self, number: u16) -> std::result::Result<&Entry, &TunnelCase> {
        let number = usize::from(number);
        (self.entries.get(number)).ok_or_else(|| &TUNNELS.cases[number - self.entries.len()])
    }

    /// Whether the loops of an entry allow a tunnel.
    #[inline]
    pub(crate) fn may_hold_tunnel(&self, number: u16) -> bool {
        TUNNELS.slots[usize::from(number)] != [NONE; 8]
    }

    /// The number of the tunnel of an entry around the diagonal from corner `apex` (0, 1, 2 or 4).
    pub(crate) fn tunnel_number(&self, number: u16, apex: usize, box_inside: bool) -> Option<u16> {
        let tunnel = TUNNELS.slots[usize::from(number)][slot(apex, box_inside)];
        (tunnel != NONE).then_some(tunnel)
    }

    /// Triangles and inside vertices of a number.
    pub(crate) fn size(&self, number: u16) -> (usize, usize) {
        match self.case(number) {
            Ok(entry) => (
                usize::from(entry.count),
                usize::from(entry.centre_length > 0),
            ),
            Err(tunnel) => (tunnel.triangles.len(), tunnel.waist.len()),
        }
    }
}

/// The one table.
pub(crate) static TABLE: LazyLock<Table> = LazyLock::new(build);

static TUNNELS: LazyLock<Tunnels> = LazyLock::new(|| find_tunnels(&TABLE));

/// By places and value: the bits of the value at the places, packed to the low end.
static RANKS: [[u8; 64]; 64] = {
    let mut out = [[0; 64]; 64];
    let mut places = 0;
    while places < 64 {
        let mut value = 0;
        while value < 64 {
            let (mut bit, mut n) = (0, 0);
            while bit < 6 {
                if places >> bit & 1 == 1 {
                    out[places][value] |= ((value >> bit & 1) << n) as u8;
                    n += 1;
                }
                bit += 1;
            }
            value += 1;
        }
        places += 1;
    }
    out
};

fn scatter_bits(value: u8, places: u8) -> u8 {
    let (mut out, mut n) = (0, 0);
    for bit in (0..6).filter(|bit| places >> bit & 1 == 1) {
        out |= (value >> n & 1) << bit;
        n += 1;
    }
    out
}

fn build() -> Table {
    let mut table = Table {
        ambiguous: [0; 256],
        undecided: [0; 256],
        plain_triangles: [0; 256],
        plain_lanes: [[0; 16]; 256],
        first: [0; 256],
        entries: Vec::new(),
    };
    for mask in 0..=255u8 {
        let faces = ambiguous_faces(mask);
        let m = mask as usize;
        table.ambiguous[m] = faces;
        table.first[m] = table.entries.len() as u16;
        for rank in 0..1u8 << faces.count_ones() {
            let mut entry = triangulate(&loops(mask, scatter_bits(rank, faces)));
            entry.fill_lanes();
            table.entries.push(entry);
        }
    }
    for mask in 0..256 {
        let first = table.first[mask];
        table.undecided[mask] = match table.ambiguous[mask] {
            0 => u8::from(two_opposite(mask as u8)),
            faces => faces,
        };
        if table.undecided[mask] == 0 {
            let entry = &table.entries[usize::from(first)];
            table.plain_triangles[mask] = entry.count;
            table.plain_lanes[mask] = entry.lanes;
        }
    }
    table
}

/// Whether two opposite corners stand against the rest.
fn two_opposite(mask: u8) -> bool {
    let few = if mask.count_ones() > 4 { !mask } else { mask };
    few.count_ones() == 2 && few == few.reverse_bits()
}

fn find_tunnels(table: &Table) -> Tunnels {
    let count = table.entries.len();
    let mut found = Tunnels {
        cases: Vec::new(),
        slots: vec![[NONE; 8]; count],
    };
    for mask in 0..=255u8 {
        let faces = ambiguous_faces(mask);
        for rank in 0..1u8 << faces.count_ones() {
            let joined = scatter_bits(rank, faces);
            for (apex, box_inside) in [0, 1, 2, 4]
                .into_iter()
                .flat_map(|a| [(a, false), (a, true)])
            {
                if let Some(case) = tunnel_case(mask, joined, apex, box_inside) {
                    let number = usize::from(table.number(mask, joined));
                    let tunnel = (count + found.cases.len()) as u16;
                    found.slots[number][slot(apex, box_inside)] = tunnel;
                    found.cases.push(case);
                }
            }
        }
    }
    found
}

/// Faces of `mask` whose corners alternate.
pub(crate) fn ambiguous_faces(mask: u8) -> u8 {
    (0..6)
        .filter(|&f| {
            let inside = face_corners(f).map(|c| mask >> c & 1);
            inside[0] == inside[2] && inside[1] == inside[3] && inside[0] != inside[1]
        })
        .fold(0, |faces, f| faces | 1 << f)
}

/// The loops of a case: cyclic sequences of crossed edges.
pub(crate) fn loops(mask: u8, joined: u8) -> Vec<Vec<u8>> {
    let inside = |c: usize| mask >> c & 1 == 1;
    let mut next = [None; 12];
    for f in 0..6 {
        let ring = face_corners(f);
        let enters = |i: usize| !inside(ring[i % 4]) && inside(ring[(i + 1) % 4]);
        let leaves = |i: usize| inside(ring[i % 4]) && !inside(ring[(i + 1) % 4]);
        let edge = |i: usize| edge_between(ring[i % 4], ring[(i + 1) % 4]);
        for i in (0..4).filter(|&i| enters(i)) {
            // An arc starts where the ring enters the inside. It ends where the ring leaves it
            // next, or, with the inside joined across the face, where the ring left it last.
            let back = (ambiguous_faces(mask) & joined) >> f & 1 == 1;
            let end = (1..4)
                .map(|s| if back { i + 4 - s } else { i + s })
                .find(|&j| leaves(j));
            next[edge(i)] = Some(edge(end.expect("what is entered is left")));
        }
    }
    let mut out = Vec::new();
    for start in 0..12 {
        let mut ring = Vec::new();
        let mut at = start;
        while let Some(to) = next[at].take() {
            ring.push(at as u8);
            at = to;
        }
        if !ring.is_empty() {
            out.push(ring);
        }
    }
    out
}

fn triangulate(loops: &[Vec<u8>]) -> Entry {
    let mut entry = Entry::default();
    for ring in loops {
        if let Some(triangles) = cut(ring) {
            triangles.into_iter().for_each(|t| entry.push(t));
        } else {
            assert_eq!(entry.centre_length, 0, "one loop with a vertex inside");
            for (i, &a) in ring.iter().enumerate() {
                entry.push([a, ring[(i + 1) % ring.len()], CENTRE]);
            }
            entry.centre[..ring.len()].copy_from_slice(ring);
            entry.centre_length = ring.len() as u8;
        }
    }
    entry
}

fn share_face(a: u8, b: u8) -> bool {
    (0..6).any(|f| edge_in_face(a.into(), f) && edge_in_face(b.into(), f))
}

/// Squared distance of the middles of two edges, times four.
fn distance(a: u8, b: u8) -> u32 {
    let middle = |e: u8| {
        let mut p = edge_origin(e.into()).map(|v| 2 * v as i32);
        p[edge_axis(e.into())] = 1;
        p
    };
    let (p, q) = (middle(a), middle(b));
    (0..3).map(|k| (p[k] - q[k]).pow(2) as u32).sum()
}

/// Cuts a loop into triangles with the shortest inner edges, none of them inside a face.
fn cut(ring: &[u8]) -> Option<Vec<[u8; 3]>> {
    let n = ring.len();
    // best[i][j]: cost and apex of the polygon i..=j whose side (i, j) is given.
    let mut best = vec![vec![None; n]; n];
    for i in 0..n - 1 {
        best[i][i + 1] = Some((0, i));
    }
    for span in 2..n {
        for i in 0..n - span {
            let j = i + span;
            let whole = (i, j) == (0, n - 1);
            if !whole && share_face(ring[i], ring[j]) {
                continue;
            }
            let side = if whole { 0 } else { distance(ring[i], ring[j]) };
            best[i][j] = (i + 1..j)
                .filter_map(|k| {
                    let (left, _) = best[i][k]?;
                    let (right, _) = best[k][j]?;
                    Some((left + right + side, k))
                })
                .min();
        }
    }
    best[0][n - 1]?;
    let mut triangles = Vec::new();
    let mut stack = vec![(0, n - 1)];
    while let Some((i, j)) = stack.pop() {
        if j - i < 2 {
            continue;
        }
        let (_, k) = best[i][j].expect("part of a solution");
        triangles.push([ring[i], ring[k], ring[j]]);
        stack.push((k, j));
        stack.push((i, k));
    }
    Some(triangles)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    fn all_cases() -> impl Iterator<Item = (u8, u8)> {
        (0..=255u8).flat_map(|mask| {
            let faces = ambiguous_faces(mask);
            (0..1u8 << faces.count_ones()).map(move |rank| (mask, scatter_bits(rank, faces)))
        })
    }

    fn disks(mask: u8, joined: u8) -> &'static Entry {
        let case = TABLE.case(TABLE.number(mask, joined));
        case.expect("numbers of entries come first")
    }

    #[test]
    fn every_case_is_a_set_of_disks_whose_border_is_its_loops() {
        for (mask, joined) in all_cases() {
            let entry = disks(mask, joined);
            let rings = loops(mask, joined);
            let mut sides: HashMap<(u8, u8), i32> = HashMap::new();
            for t in entry.triangles() {
                for k in 0..3 {
                    *sides.entry((t[k], t[(k + 1) % 3])).or_default() += 1;
                }
            }
            for ring in &rings {
                for (i, &a) in ring.iter().enumerate() {
                    let side = sides.remove(&(a, ring[(i + 1) % ring.len()]));
                    assert_eq!(
                        side,
                        Some(1),
                        "case {mask:08b} {joined:06b}: border {ring:?}"
                    );
                }
            }
            for (&(a, b), &n) in &sides {
                assert_eq!(
                    (n, sides.get(&(b, a))),
                    (1, Some(&1)),
                    "case {mask:08b} {joined:06b}"
                );
                assert!(
                    a >= CENTRE || b >= CENTRE || !share_face(a, b),
                    "inner edge in a face"
                );
            }
            let crossed = (0..12).filter(|&e| {
                let low = edge_origin(e);
                let c = low[0] | low[1] << 1 | low[2] << 2;
                (mask >> c ^ mask >> (c | 1 << edge_axis(e))) & 1 == 1
            });
            let mut met: Vec<u8> = rings.iter().flatten().copied().collect();
            met.sort_unstable();
            assert!(crossed.map(|e| e as u8).eq(met), "every crossed edge once");
        }
    }

    #[test]
    fn worked_cases_have_the_known_number_of_triangles() {
        assert_eq!(disks(0b0000_0001, 0).triangles().len(), 1);
        assert_eq!(disks(0b0000_1111, 0).triangles().len(), 2);
        assert_eq!(disks(0b0000_0111, 0).triangles().len(), 3);
        assert_eq!(disks(0b1111_1110, 0).triangles().len(), 1);
    }

    #[test]
    fn a_lone_inside_corner_faces_outwards() {
        let [a, b, c] = disks(1, 0).triangles()[0].map(|e| edge_axis(e.into()));
        assert!([[0, 1, 2], [1, 2, 0], [2, 0, 1]].contains(&[a, b, c]));
    }

    #[test]
    fn orbits_of_the_masks() {
        // Rotations, then with complement, then with mirror images too: 23, 15, 14.
        let maps = cube_symmetries();
        for (mirror, complement, want) in [(false, false, 23), (false, true, 15), (true, true, 14)]
        {
            let mut seen = std::collections::HashSet::new();
            for mask in 0..=255u8 {
                let smallest = maps
                    .iter()
                    .filter(|(_, is_mirror)| mirror || !is_mirror)
                    .map(|(map, _)| (0..8).fold(0u8, |m, c| m | (mask >> c & 1) << map[c]))
                    .flat_map(|m| [m, if complement { !m } else { m }])
                    .min();
                seen.insert(smallest);
            }
            assert_eq!(seen.len(), want);
        }
    }

    fn cube_symmetries() -> Vec<([usize; 8], bool)> {
        let mut out = Vec::new();
        for perm in [
            [0, 1, 2],
            [0, 2, 1],
            [1, 0, 2],
            [1, 2, 0],
            [2, 0, 1],
            [2, 1, 0],
        ] {
            for flips in 0..8usize {
                let map = std::array::from_fn(|c| {
                    let p = crate::iso::cube::corner(c);
                    (0..3).fold(0, |m, a| m | (p[perm[a]] ^ (flips >> a & 1)) << a)
                });
                let odd = [[0, 2, 1], [1, 0, 2], [2, 1, 0]].contains(&perm);
                out.push((map, odd ^ (flips.count_ones() % 2 == 1)));
            }
        }
        out
    }

    #[test]
    fn few_cases_need_a_vertex_inside() {
        let with: Vec<_> = all_cases()
            .filter(|&(m, j)| !disks(m, j).centre().is_empty())
            .collect();
        for &(mask, _) in &with {
            assert_ne!(TABLE.ambiguous[mask as usize], 0, "{mask:08b}");
        }
        assert_eq!((with.len(), all_cases().count()), (116, 656));
    }

    #[test]
    fn masks_that_tell_the_case_hold_no_tunnel() {
        for mask in 0..=255u8 {
            let m = usize::from(mask);
            let expected = match TABLE.ambiguous[m] {
                0 => u8::from(TABLE.may_hold_tunnel(TABLE.first[m])),
                faces => faces,
            };
            assert_eq!(TABLE.undecided[m], expected, "{mask:08b}");
        }
    }
}
