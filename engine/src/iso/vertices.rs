//! The vertices on the crossed edges of a block.

use super::block::{Block, BlockSamples, Emit, LIST_SLACK, Style, push_zeros};
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

/// Writes the codes of the edges in `mask`, given the code of the one at x = 0, and says how many
/// they are; it may write more behind them, [`LIST_SLACK`] in all.
#[inline(always)]
pub(super) fn list_edges(first: u32, mut mask: u64, out: &mut [u32]) -> usize {
    let count = mask.count_ones() as usize;
    for out in &mut out[..count] {
        *out = first + mask.trailing_zeros();
        mask &= mask - 1;
    }
    count
}

impl Block {
    /// Appends the vertices of the block in the order of its rows, then axes, then x.
    #[inline(always)]
    pub(super) fn emit_vertices<U, N, T>(
        &mut self,
        samples: &BlockSamples,
        style: &Style,
        borrowed: [bool; 3],
        piece: &mut Piece,
        by: &Emit<
            impl Fn([&[u64]; 3], u64, &mut [u32]) -> usize,
            U,
            impl Fn(u32, u64, &mut [u32]) -> usize,
            impl Fn(&Placed<'_>, &[u32], &mut [[f32; 3]]),
            impl Fn(&[u32], u32, [bool; 3], &mut [u32]) -> usize,
            N,
            T,
        >,
    ) {
        let mut codes = std::mem::take(&mut self.edges);
        codes.resize(codes.len().max(self.edge_vertices + LIST_SLACK), 0);
        let count = self.list_all(samples, &mut codes, by);
        codes.truncate(count);
        let first = piece.positions.len();
        push_zeros(&mut piece.positions, count);
        let placed = Placed { samples, style };
        (by.place)(&placed, &codes, &mut piece.positions[first..]);
        if borrowed == [false; 3] {
            piece.own.extend(first as u32..(first + count) as u32);
        } else {
            let length = piece.own.len();
            piece.own.resize(length + count, 0);
            let own = (by.list_own)(&codes, first as u32, borrowed, &mut piece.own[length..]);
            piece.own.truncate(length + own);
        }
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

    /// Lists the codes of all crossed edges, and counts them.
    #[inline(always)]
    fn list_all<U, P, O, N, T>(
        &mut self,
        samples: &BlockSamples,
        codes: &mut [u32],
        by: &Emit<
            impl Fn([&[u64]; 3], u64, &mut [u32]) -> usize,
            U,
            impl Fn(u32, u64, &mut [u32]) -> usize,
            P,
            O,
            N,
            T,
        >,
    ) -> usize {
        let [_, ny, nz] = samples.size;
        self.rows
            .resize(self.rows.len().max(ny * nz + LIST_SLACK), 0);
        if self.row_codes.0 != [ny, nz] {
            let codes = (0..nz as u32)
                .flat_map(|z| (0..ny as u32).map(move |y| y << Y_SHIFT | z << Z_SHIFT));
            self.row_codes = ([ny, nz], codes.collect());
        }
        let (_, row_codes) = &self.row_codes;
        let [xs, ys, zs] = &self.crossed;
        let count = (by.rows_with)([xs, ys, zs], u64::MAX, &mut self.rows);
        let mut end = 0;
        for &row in &self.rows[..count] {
            let r = row as usize;
            // A row that is crossed is mostly crossed along every axis: not asked, to save the branch.
            for (axis, row) in [xs[r], ys[r], zs[r]].into_iter().enumerate() {
                let first = row_codes[r] | (axis as u32) << AXIS_SHIFT;
                end += (by.list_edges)(first, row, &mut codes[end..]);
            }
        }
        end
    }
}

/// Writes the numbers, from `first` on, of those vertices that are not in a borrowed face, since
/// those have a number already, and says how many they are; `out` has room for all.
#[inline(always)]
pub(super) fn list_own(codes: &[u32], first: u32, borrowed: [bool; 3], out: &mut [u32]) -> usize {
    let mut end = 0;
    for (local, &code) in (first..).zip(codes) {
        let edge = Edge::of(code);
        let theirs = (0..3).any(|a| borrowed[a] && edge.point[a] == 0 && edge.axis != a);
        // Written in any case, kept where it is ours: no branch.
        out[end] = local;
        end += usize::from(!theirs);
    }
    end
}
