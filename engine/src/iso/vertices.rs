//! The vertices on the crossed edges of a block.

use super::block::{Block, BlockSamples, Style};
use crate::mesh::{EdgeKey, Piece};

/// Places in the code of an edge: 6 bits each for x, y and z of its lower point, then its axis.
pub(super) const Y_SHIFT: u32 = 6;
/// See [`Y_SHIFT`].
pub(super) const Z_SHIFT: u32 = 12;
/// See [`Y_SHIFT`].
pub(super) const AXIS_SHIFT: u32 = 18;

/// An edge of a block.
#[derive(Clone, Copy)]
pub(super) struct Edge {
    /// Lower point, from the first of the block.
    pub(super) point: [u32; 3],
    pub(super) axis: usize,
}

impl Edge {
    #[inline(always)]
    pub(super) fn of(code: u32) -> Self {
        Self {
            point: [code & 63, code >> Y_SHIFT & 63, code >> Z_SHIFT & 63],
            axis: (code >> AXIS_SHIFT) as usize & 3,
        }
    }

    /// Lattice point of the lower end.
    #[inline(always)]
    pub(super) fn lattice(self, origin: [i32; 3]) -> [i32; 3] {
        let [i, j, k] = self.point;
        [
            origin[0] + i as i32,
            origin[1] + j as i32,
            origin[2] + k as i32,
        ]
    }

    /// Offset of the sample at the lower end.
    #[inline(always)]
    fn sample(self, samples: &BlockSamples) -> usize {
        let [x, y, z] = self.point.map(|v| v as usize);
        samples.first + x + y * samples.step[1] + z * samples.step[2]
    }
}

/// What places the vertices of a block.
pub(super) struct Placed<'a> {
    pub(super) samples: &'a BlockSamples,
    pub(super) style: &'a Style,
}

impl Placed<'_> {
    /// Position of the vertex on the edge of this code.
    #[inline(always)]
    pub(super) fn position(&self, code: u32) -> [f32; 3] {
        let (edge, t, _) = self.crossing(code);
        let point = edge.lattice(self.samples.origin);
        let place = &self.style.placement;
        place.on_edge(place.row(point[1], point[2]), point[0], edge.axis, t)
    }

    #[inline(always)]
    pub(super) fn crossing(&self, code: u32) -> (Edge, f32, usize) {
        let edge = Edge::of(code);
        let low = edge.sample(self.samples);
        let (a, b) = (
            self.samples.values[low],
            self.samples.values[low + self.samples.step[edge.axis]],
        );
        let t = self.style.placement.along(a, b, self.style.iso);
        (edge, t, low)
    }
}

/// Positions one by one.
#[inline(always)]
pub(super) fn place(placed: &Placed<'_>, codes: &[u32], out: &mut [[f32; 3]]) {
    for (position, &code) in out.iter_mut().zip(codes) {
        *position = placed.position(code);
    }
}

/// Appends the codes of the edges in `mask`, given the code of the one at x = 0.
#[inline(always)]
pub(super) fn list_edges(first: u32, mut mask: u64, out: &mut Vec<u32>) {
    while mask != 0 {
        out.push(first + mask.trailing_zeros());
        mask &= mask - 1;
    }
}

impl Block {
    /// Appends the vertices of the block in the order of its rows, then axes, then x.
    #[inline(always)]
    pub(super) fn emit_vertices(
        &mut self,
        samples: &BlockSamples,
        style: &Style,
        borrowed: [bool; 3],
        piece: &mut Piece,
        list_edges: impl Fn(u32, u64, &mut Vec<u32>),
        place: impl Fn(&Placed<'_>, &[u32], &mut [[f32; 3]]),
    ) {
        let [_, ny, nz] = samples.size;
        let mut codes = std::mem::take(&mut self.edges);
        codes.clear();
        for z in 0..nz {
            for y in 0..ny {
                let r = y + ny * z;
                let rows = [self.crossed[0][r], self.crossed[1][r], self.crossed[2][r]];
                if rows[0] | rows[1] | rows[2] == 0 {
                    continue;
                }
                let first = (y as u32) << Y_SHIFT | (z as u32) << Z_SHIFT;
                // A row that is crossed is mostly crossed along every axis: not asked, to save the branch.
                for (axis, row) in rows.into_iter().enumerate() {
                    list_edges(first | (axis as u32) << AXIS_SHIFT, row, &mut codes);
                }
            }
        }
        let first = piece.positions.len();
        piece.positions.resize(first + codes.len(), [0.0; 3]);
        let placed = Placed { samples, style };
        place(&placed, &codes, &mut piece.positions[first..]);
        list_own(&codes, first as u32, borrowed, &mut piece.own);
        if style.normals {
            piece.normals.extend(codes.iter().map(|&code| {
                let (edge, t, low) = placed.crossing(code);
                style
                    .placement
                    .edge_normal(samples, low, edge.axis, t, style.inside)
            }));
        }
        if style.keys {
            piece.keys.extend(codes.iter().map(|&code| {
                let edge = Edge::of(code);
                EdgeKey {
                    point: edge.lattice(samples.origin),
                    axis: edge.axis as u8,
                }
            }));
        }
        self.edges = codes;
    }
}

/// Appends the numbers, from `first` on, of those vertices that are not in a borrowed face: those
/// have a number already.
#[inline(always)]
fn list_own(codes: &[u32], first: u32, borrowed: [bool; 3], own: &mut Vec<u32>) {
    let last = first + codes.len() as u32;
    if borrowed == [false; 3] {
        own.extend(first..last);
        return;
    }
    let length = own.len();
    own.resize(length + codes.len(), 0);
    let mut end = length;
    for (local, &code) in (first..last).zip(codes) {
        let edge = Edge::of(code);
        let theirs = (0..3).any(|a| borrowed[a] && edge.point[a] == 0 && edge.axis != a);
        // Written in any case, kept where it is ours: no branch.
        own[end] = local;
        end += usize::from(!theirs);
    }
    own.truncate(end);
}
