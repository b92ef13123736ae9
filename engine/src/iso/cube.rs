//! Numbering of the corners, edges and faces of a cell. The only place.
//!
//! ```text
//!        6-------7        corner i sits at x = i & 1, y = i >> 1 & 1, z = i >> 2 & 1
//!       /|      /|        edge  a*4 + j runs along axis a; j = the other two coordinates,
//!      4-------5 |                lower axis in the lower bit
//!      | 2-----|-3        face  2*a + s is the side s (0 low, 1 high) of axis a
//!  z y |/      |/
//!  |/  0-------1
//!  +--x
//! ```

/// The two axes other than `axis`, lower first.
pub(crate) const OTHER: [[usize; 2]; 3] = [[1, 2], [0, 2], [0, 1]];

/// Coordinates of corner `i`.
pub(crate) const fn corner(i: usize) -> [usize; 3] {
    [i & 1, i >> 1 & 1, i >> 2 & 1]
}

const fn corner_index(p: [usize; 3]) -> usize {
    p[0] | p[1] << 1 | p[2] << 2
}

/// Axis of edge `e`.
pub(crate) const fn edge_axis(e: usize) -> usize {
    e / 4
}

/// Lower corner of edge `e`, as coordinates.
pub(crate) const fn edge_origin(e: usize) -> [usize; 3] {
    let [b, c] = OTHER[edge_axis(e)];
    let mut p = [0; 3];
    p[b] = e & 1;
    p[c] = e >> 1 & 1;
    p
}

/// The edge along `axis` from corner coordinates `origin` (whose `axis` coordinate is ignored).
pub(crate) const fn edge_index(axis: usize, origin: [usize; 3]) -> usize {
    let [b, c] = OTHER[axis];
    axis * 4 + origin[b] + 2 * origin[c]
}

/// The edge between two corners that differ in one coordinate.
pub(crate) fn edge_between(a: usize, b: usize) -> usize {
    let axis = (a ^ b).trailing_zeros() as usize;
    edge_index(axis, corner(a & b))
}

/// Whether edge `e` lies in face `f`.
pub(crate) const fn edge_in_face(e: usize, f: usize) -> bool {
    let axis = f / 2;
    edge_axis(e) != axis && edge_origin(e)[axis] == f & 1
}

/// Corners of face `f`, counter-clockwise seen from outside the cell.
pub(crate) const fn face_corners(f: usize) -> [usize; 4] {
    let (axis, side) = (f / 2, f & 1);
    // (u, v, axis) is right-handed, so u then v turns counter-clockwise seen from the high side.
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut out = [0; 4];
    let turn = [[0, 0], [1, 0], [1, 1], [0, 1]];
    let mut i = 0;
    while i < 4 {
        let [a, b] = turn[if side == 1 { i } else { 3 - i }];
        let mut p = [0; 3];
        p[axis] = side;
        p[u] = a;
        p[v] = b;
        out[i] = corner_index(p);
        i += 1;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbering_is_consistent() {
        for e in 0..12 {
            assert_eq!(edge_index(edge_axis(e), edge_origin(e)), e);
            assert_eq!(
                (0..6).filter(|&f| edge_in_face(e, f)).count(),
                2,
                "edge {e}"
            );
        }
        for f in 0..6 {
            let ring = face_corners(f);
            for i in 0..4 {
                let e = edge_between(ring[i], ring[(i + 1) % 4]);
                assert!(edge_in_face(e, f));
            }
            // The normal by the right-hand rule points out of the cell.
            let p = ring.map(|c| corner(c).map(|v| v as i32));
            let d = |a: usize, b: usize| -> [i32; 3] { std::array::from_fn(|k| p[b][k] - p[a][k]) };
            let (u, v) = (d(0, 1), d(1, 2));
            let n = [
                u[1] * v[2] - u[2] * v[1],
                u[2] * v[0] - u[0] * v[2],
                u[0] * v[1] - u[1] * v[0],
            ];
            assert_eq!(n[f / 2], if f & 1 == 1 { 1 } else { -1 });
        }
        // Every edge is walked once in each direction by its two faces.
        for e in 0..12 {
            let mut turns = 0;
            for f in (0..6).filter(|&f| edge_in_face(e, f)) {
                let ring = face_corners(f);
                for i in 0..4 {
                    if edge_between(ring[i], ring[(i + 1) % 4]) == e {
                        turns += if ring[i] < ring[(i + 1) % 4] { 1 } else { -1 };
                    }
                }
            }
            assert_eq!(turns, 0);
        }
    }
}
