//! Triangles of a tunnel.
//!
//! The waist is a hexagon on the edges of a box inside the cell (`interior.rs`). Seen from the two
//! ends of the diagonal that it goes around, `P` and `Q`, the box and the cell have their corners
//! in the same directions; the six other corners of the cell are a ring, each with a corner of the
//! hexagon, in turn neighbours of `P` and of `Q`. The space around the box falls into eight octants
//! at its corners, and what crosses the edges of the cell lies in the octants:
//!
//! - a ring corner on the other side of the surface than the box has one crossing in its octant,
//!   on its edge to `P` or `Q`;
//! - one on the same side has two, on its edges to its neighbours in the ring.
//!
//! Between them, on the six faces of the cell, run six arcs. Each arc, from `x` in the octant of
//! one neighbour of a ring corner to `y` in that of the other, and the hexagon corners `a m b` of
//! the three, bound a flap: triangles `x a m`, `x m y`, `m b y`. With two crossings in an octant a
//! triangle closes the gap. The flaps around `P` lead to one loop, those around `Q` to the other.
//!
//! **No two of these triangles cross**, however uneven the samples. Flaps of opposite faces lie on
//! the two sides of the box. Those of neighbouring faces overlap in one quadrant, seen along the
//! edge between the faces; there a straight line from the box to the edge of the cell, or to the
//! crossing that both share, has one on each side. Triangles of one octant that meet the flap of
//! its third face are two cones from one point over arcs that do not cross. The argument uses
//! nothing but the octants, so the box may be moved as long as the crossings stay in theirs.

use super::cube::edge_between;
use super::table::loops;

/// The first of the six vertices inside the cell, after the twelve edges.
pub(crate) const WAIST: u8 = 12;

/// The surface of a case in which two of its loops are joined by a tunnel.
#[derive(Clone, Debug)]
pub(crate) struct TunnelCase {
    /// Triangles over edges of the cell and, from [`WAIST`] on, corners of the waist.
    pub(crate) triangles: Vec<[u8; 3]>,
    /// Corners of the cell that the corners of the waist lie towards; empty where both loops have
    /// three vertices and are joined directly.
    pub(crate) waist: Vec<u8>,
    /// Edges whose vertex lies below and above the box along the axis of the edge, a bit each.
    pub(crate) below: u16,
    /// See [`below`](Self::below).
    pub(crate) above: u16,
}

/// The tunnel of a case around the diagonal from corner `apex`, with a box that is inside the solid
/// or outside of it; `None` when its loops do not allow it.
pub(crate) fn tunnel_case(
    mask: u8,
    joined: u8,
    apex: usize,
    box_inside: bool,
) -> Option<TunnelCase> {
    let ring = [1, 3, 2, 6, 4, 5].map(|bits| apex ^ bits);
    let of_box = |corner: usize| (mask >> corner & 1 == 1) == box_inside;
    let end = |k: usize| if k.is_multiple_of(2) { apex } else { apex ^ 7 };
    let after = |k: usize| (k + 1) % 6;
    let before = |k: usize| (k + 5) % 6;
    // The crossings in the octant of each ring corner, in the direction of the ring.
    let mut crossings = [[0u8; 2]; 6];
    let (mut below, mut above) = (0, 0);
    let mut note = |corner: usize, edge: usize| {
        if corner >> (edge / 4) & 1 == 0 {
            below |= 1 << edge;
        } else {
            above |= 1 << edge;
        }
        edge as u8
    };
    for k in 0..6 {
        let corner = ring[k];
        let others = if of_box(corner) {
            [ring[before(k)], ring[after(k)]]
        } else {
            [end(k); 2]
        };
        crossings[k] = others.map(|other| note(corner, edge_between(corner, other)));
    }
    for corner in [apex, apex ^ 7] {
        if !of_box(corner) {
            for axis in 0..3 {
                note(corner, edge_between(corner, corner ^ 1 << axis));
            }
        }
    }

    let direct = ring.iter().all(|&corner| !of_box(corner));
    let mut triangles = Vec::new();
    for k in 0..6 {
        let (x, y) = (crossings[before(k)][1], crossings[after(k)][0]);
        let (a, m, b) = if direct {
            (x, crossings[k][0], y)
        } else {
            (
                WAIST + before(k) as u8,
                WAIST + k as u8,
                WAIST + after(k) as u8,
            )
        };
        let flap = [[x, a, m], [x, m, y], [m, b, y]];
        let gap = [crossings[k][0], m, crossings[k][1]];
        let parts = flap.iter().chain([&gap]);
        let mut whole: Vec<[u8; 3]> = parts
            .copied()
            .filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0])
            .collect();
        // Around Q the ring runs the other way; a gap is beside the flaps before and after.
        let flaps = whole.len() - usize::from(crossings[k][0] != crossings[k][1]);
        for (i, t) in whole.iter_mut().enumerate() {
            if (k % 2 == 0) == (i < flaps) {
                t.swap(1, 2);
            }
        }
        triangles.extend(whole);
    }
    complete(&loops(mask, joined), triangles).map(|triangles| TunnelCase {
        triangles,
        waist: if direct {
            Vec::new()
        } else {
            ring.map(|corner| corner as u8).into()
        },
        below,
        above,
    })
}

/// Turns the tunnel to the direction of the loops and adds the loops that it leaves, which are
/// triangles. `None` when the border of the tunnel is not two of the loops.
fn complete(loops: &[Vec<u8>], mut triangles: Vec<[u8; 3]>) -> Option<Vec<[u8; 3]>> {
    let sides = |triangles: &[[u8; 3]]| -> Vec<(u8, u8)> {
        let sides = triangles.iter();
        sides
            .flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])])
            .collect()
    };
    let all = sides(&triangles);
    let border: Vec<_> = all
        .iter()
        .filter(|(a, b)| !all.contains(&(*b, *a)))
        .copied()
        .collect();
    let of_loop = |ring: &[u8]| -> Vec<(u8, u8)> {
        (0..ring.len())
            .map(|i| (ring[i], ring[(i + 1) % ring.len()]))
            .collect()
    };
    let forward = |ring: &&Vec<u8>| of_loop(ring).iter().all(|side| border.contains(side));
    let backward = |ring: &&Vec<u8>| (of_loop(ring).iter()).all(|&(a, b)| border.contains(&(b, a)));
    let turned = loops.iter().any(|ring| backward(&ring));
    let (met, left): (Vec<_>, Vec<_>) = loops.iter().partition(|ring| {
        if turned {
            backward(ring)
        } else {
            forward(ring)
        }
    });
    let length: usize = met.iter().map(|ring| ring.len()).sum();
    if met.len() != 2 || length != border.len() || left.iter().any(|ring| ring.len() != 3) {
        return None;
    }
    if turned {
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    triangles.extend(left.iter().map(|ring| [ring[0], ring[1], ring[2]]));
    Some(triangles)
}

#[cfg(test)]
mod tests {
    use super::super::cube::{corner, edge_axis, edge_in_face, edge_origin};
    use super::super::table::ambiguous_faces;
    use super::*;
    use std::collections::{BTreeSet, HashMap};

    fn all() -> Vec<(u8, u8, usize, TunnelCase)> {
        let mut out = Vec::new();
        for mask in 0..=255u8 {
            let faces = ambiguous_faces(mask);
            for joined in (0..64u8).filter(|joined| joined & !faces == 0) {
                for apex in [0, 1, 2, 4] {
                    for box_inside in [false, true] {
                        let case = tunnel_case(mask, joined, apex, box_inside);
                        out.extend(case.map(|case| (mask, joined, apex, case)));
                    }
                }
            }
        }
        out
    }

    #[test]
    fn every_tunnel_joins_two_loops_and_leaves_the_others_disks() {
        let cases = all();
        for (mask, joined, _, case) in &cases {
            let rings = loops(*mask, *joined);
            let mut sides: HashMap<(u8, u8), u32> = HashMap::new();
            let mut vertices: BTreeSet<u8> = BTreeSet::new();
            for t in &case.triangles {
                vertices.extend(t);
                for k in 0..3 {
                    *sides.entry((t[k], t[(k + 1) % 3])).or_default() += 1;
                }
            }
            assert!(sides.values().all(|&n| n == 1), "{mask:08b} {joined:06b}");
            let border: BTreeSet<_> = (sides.keys().copied())
                .filter(|&(a, b)| !sides.contains_key(&(b, a)))
                .collect();
            let want: BTreeSet<_> = rings
                .iter()
                .flat_map(|ring| (0..ring.len()).map(|i| (ring[i], ring[(i + 1) % ring.len()])))
                .collect();
            assert_eq!(border, want, "{mask:08b} {joined:06b}");
            let inner = (sides.len() - border.len()) / 2;
            let euler =
                (vertices.len() + case.triangles.len()) as i32 - (border.len() + inner) as i32;
            assert_eq!(euler, rings.len() as i32 - 2);
            for &(a, b) in sides.keys().filter(|side| !border.contains(side)) {
                let in_face = |f| edge_in_face(a.into(), f) && edge_in_face(b.into(), f);
                assert!(a >= WAIST || b >= WAIST || !(0..6).any(in_face));
            }
            assert_eq!(case.below & case.above, 0);
        }
        let with_waist = cases.iter().filter(|case| !case.3.waist.is_empty()).count();
        let most = cases.iter().map(|case| case.3.triangles.len()).max();
        // Per diagonal and side of the box: corners of the ring that are on the side of the box, no
        // two of them neighbours, 18 ways; and twice three of them with an end of the diagonal
        // cut off.
        assert_eq!(cases.len(), 4 * 2 * (18 + 2));
        assert_eq!((with_waist, most), (cases.len() - 8, Some(22)));
    }

    fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| a[k] - b[k])
    }

    /// Sign of the volume of a tetrahedron, 0 where rounding might decide.
    fn side(p: [f64; 3], q: [f64; 3], r: [f64; 3], s: [f64; 3]) -> i32 {
        let (a, b, c) = (sub(p, s), sub(q, s), sub(r, s));
        let (mut volume, mut size) = (0.0, 0.0);
        for k in 0..3 {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            volume += a[k] * (b[i] * c[j] - b[j] * c[i]);
            size += a[k].abs() * ((b[i] * c[j]).abs() + (b[j] * c[i]).abs());
        }
        super::super::exact::sign(volume) * i32::from(volume.abs() > 1e-14 * size)
    }

    fn pierces(p: [f64; 3], q: [f64; 3], t: [[f64; 3]; 3]) -> bool {
        let (a, b) = (side(t[0], t[1], t[2], p), side(t[0], t[1], t[2], q));
        let around = [0, 1, 2].map(|k| side(p, q, t[k], t[(k + 1) % 3]));
        a * b < 0 && around[0] != 0 && around.iter().all(|&s| s == around[0])
    }

    /// The claim at the head of this file, for boxes and crossings of all proportions.
    #[test]
    fn no_two_triangles_of_a_tunnel_cross() {
        let mut state = 9u64;
        let mut unit = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            ((state >> 11) as f64 + 1.0) / ((1u64 << 53) as f64 + 2.0)
        };
        let rounds = if cfg!(debug_assertions) { 40 } else { 2000 };
        for (mask, joined, _, case) in all() {
            for _ in 0..rounds {
                // Thin and wide boxes, crossings close to the box and far from it.
                let even = unit();
                let mut part = || {
                    let v = unit();
                    if unit() < even { v } else { v.powi(12) }
                };
                let sides = [(); 3].map(|()| {
                    let (a, b) = (part(), part());
                    let (a, b) = if part() < 0.5 {
                        (a, 1.0 - b)
                    } else {
                        (1.0 - a, b)
                    };
                    [a.min(b), a.max(b)]
                });
                let mut points = vec![[0.0; 3]; 18];
                for e in 0..12 {
                    let axis = edge_axis(e);
                    points[e] = edge_origin(e).map(|v| v as f64);
                    points[e][axis] = if case.below >> e & 1 == 1 {
                        sides[axis][0] * (1.0 - part())
                    } else {
                        1.0 - (1.0 - sides[axis][1]) * (1.0 - part())
                    };
                }
                for (k, &c) in case.waist.iter().enumerate() {
                    let p = corner(c.into());
                    points[12 + k] = std::array::from_fn(|a| sides[a][p[a]]);
                }
                for (i, t) in case.triangles.iter().enumerate() {
                    for u in &case.triangles[..i] {
                        let apart = |t: &[u8; 3], u: &[u8; 3]| {
                            let at = t.map(|v| points[usize::from(v)]);
                            (0..3).any(|k| {
                                let (a, b) = (u[k], u[(k + 1) % 3]);
                                !t.contains(&a)
                                    && !t.contains(&b)
                                    && pierces(points[usize::from(a)], points[usize::from(b)], at)
                            })
                        };
                        assert!(
                            !apart(t, u) && !apart(u, t),
                            "{mask:08b} {joined:06b}: {t:?} {u:?} {points:?}"
                        );
                    }
                }
            }
        }
    }
}
