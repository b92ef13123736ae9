//! One block of cells: from samples to vertices and triangles.
//!
//! Rows of samples become bit masks of "inside". Crossed lattice edges are XORs of neighbouring
//! masks, active cells are ORs and ANDs of four; samples are touched again only where a bit is set.
//! The number of a vertex is a rank: the vertices of the rows before, plus the bits below it.
//! (Rows as units of work: Schroeder, Maynard and Geveci 2015, "Flying Edges".)
//!
//! Samples outside the region that is meshed are NaN, and NaN is outside: that closes the solid
//! with a cap, and nothing else in here knows of borders.

use super::cells::RowNumbers;
use super::cube::{OTHER, corner};
use super::dispatch::Level;
use super::place::Placement;
use super::vertices::Placed;
use crate::mesh::Piece;
use crate::sample::Inside;

/// Samples of a block: `size` points from lattice point `origin`, and one more on every side when
/// normals are wanted.
#[derive(Debug, Default)]
pub(super) struct BlockSamples {
    /// Lattice point of sample (0, 0, 0).
    pub(super) origin: [i32; 3],
    /// Points per axis; one more than the cells.
    pub(super) size: [usize; 3],
    /// The array.
    pub(super) values: Vec<f32>,
    /// Offset of sample (0, 0, 0).
    pub(super) first: usize,
    /// Distance of samples along each axis: 1, row, slice.
    pub(super) step: [usize; 3],
}

/// Most points of a block along x: masks are 64 bits.
pub(super) const MAX_POINTS: usize = 64;

/// Masks and numbers of one block; kept between blocks to save the allocation.
#[derive(Debug, Default)]
pub(super) struct Block {
    /// Samples inside, a mask per row of points.
    pub(super) inside: Vec<u64>,
    /// Crossed edges, a mask per axis and row.
    pub(super) crossed: [Vec<u64>; 3],
    /// Number of the first vertex per axis and row.
    pub(super) base: [Vec<u32>; 3],
    /// Active cells, a mask per row of points.
    pub(super) active_masks: Vec<u64>,
    /// Place of every row in the codes of its edges, for blocks of the size that is named first.
    pub(super) row_codes: ([usize; 2], Vec<u32>),
    /// Room for a list of rows, and for a list of vertices.
    pub(super) rows: Vec<u32>,
    pub(super) on_face: Vec<u32>,
    /// Rows of cells that the surface crosses: row of points, and the end of its cells in `cells`.
    pub(super) active: Vec<(u32, u32)>,
    /// The active cells: x, the mask of its inside corners shifted by [`MASK_SHIFT`], and its place
    /// in `active` shifted by [`ROW_SHIFT`].
    pub(super) cells: Vec<u32>,
    /// Numbers in the table of the active cells whose mask does not tell the case, in order.
    pub(super) decided: Vec<u16>,
    /// Room for what numbers the vertices of the rows in `active`.
    pub(super) numbers: Vec<RowNumbers>,
    /// Room for the list of vertices of a block while it is emitted.
    pub(super) edges: Vec<u32>,
    /// Vertices on lattice edges.
    pub(super) edge_vertices: usize,
    /// All vertices.
    pub(super) vertices_max: usize,
    /// All triangles.
    pub(super) triangles_max: usize,
}

/// What a finished block tells its neighbours and the counters.
#[derive(Debug, Default)]
pub(super) struct BlockOutput {
    /// Per axis the vertices on the low face, by local number, in the order of the face.
    pub(super) low: [Vec<u32>; 3],
    /// The same for the high face.
    pub(super) high: [Vec<u32>; 3],
    /// Local number of the first vertex of this block.
    pub(super) first: u32,
    /// Vertices of this block.
    pub(super) count: u32,
    pub(super) active_cells: u64,
    pub(super) ambiguous_faces: u64,
    pub(super) interior_vertices: u64,
}

/// How a block is meshed; the same for all blocks of a run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Style {
    pub(super) iso: f32,
    pub(super) inside: Inside,
    pub(super) placement: Placement,
    pub(super) normals: bool,
    pub(super) keys: bool,
    /// Passes of relaxation; none when 0.
    pub(super) relax: u8,
    /// Instructions to use.
    pub(super) level: Level,
}

/// The parts of [`Block::emit_with`] that differ between processors.
pub(super) struct Emit<R, U, E, P, O, N, T> {
    /// See [`rows_with`].
    pub(super) rows_with: R,
    /// See [`put_run`].
    pub(super) put_run: U,
    /// See [`list_edges`](super::vertices::list_edges).
    pub(super) list_edges: E,
    /// See [`place`](super::vertices::place).
    pub(super) place: P,
    /// See [`list_own`](super::vertices::list_own).
    pub(super) list_own: O,
    /// See [`RowNumbers::new`].
    pub(super) numbers: N,
    /// See [`write_triangles`](super::cells::write_triangles).
    pub(super) triangles: T,
}

impl BlockOutput {
    /// Empties the lists and zeroes the counters.
    pub(super) fn reset(&mut self) {
        self.low
            .iter_mut()
            .chain(&mut self.high)
            .for_each(Vec::clear);
        (
            self.active_cells,
            self.ambiguous_faces,
            self.interior_vertices,
        ) = (0, 0, 0);
    }
}

/// Place of the corner mask in an entry of [`Block::cells`].
pub(super) const MASK_SHIFT: u32 = 8;
/// Place of the row.
pub(super) const ROW_SHIFT: u32 = 16;

/// Room that lists need behind their end: they are written in whole vectors.
pub(super) const LIST_SLACK: usize = 64;

/// Triangles more than needed that a piece must have room for: they are written 16 numbers at a time.
pub(super) const TRIANGLES_SLACK: usize = 6;

#[inline(always)]
pub(super) const fn below(x: u32) -> u64 {
    (1 << x) - 1
}

impl Block {
    /// Finds the crossed edges and active cells. False when there are none.
    pub(super) fn scan(&mut self, samples: &BlockSamples, style: &Style) -> bool {
        style.level.scan(self, samples, style)
    }

    /// Local number of the vertex on the edge along `axis` from point (x, y, z).
    #[inline(always)]
    pub(super) fn vertex(&self, axis: usize, x: u32, row: usize) -> u32 {
        self.base[axis][row] + (self.crossed[axis][row] & below(x)).count_ones()
    }

    /// Appends vertices and triangles to `piece`. `borrowed[a]` says that the low face of axis `a`
    /// belongs to an earlier block.
    pub(super) fn emit(
        &mut self,
        samples: &BlockSamples,
        style: &Style,
        borrowed: [bool; 3],
        piece: &mut Piece,
        out: &mut BlockOutput,
    ) {
        style.level.emit(self, samples, style, borrowed, piece, out);
    }

    /// [`emit`](Self::emit), in parts that are written anew for newer processors.
    #[inline(always)]
    pub(super) fn emit_with(
        &mut self,
        samples: &BlockSamples,
        style: &Style,
        borrowed: [bool; 3],
        piece: &mut Piece,
        out: &mut BlockOutput,
        by: Emit<
            impl Fn([&[u64]; 3], u64, &mut [u32]) -> usize,
            impl Fn(u32, u32, &mut [u32]),
            impl Fn(u32, u64, &mut [u32]) -> usize,
            impl Fn(&Placed<'_>, &[u32], &mut [[f32; 3]]),
            impl Fn(&[u32], u32, [bool; 3], &mut [u32]) -> usize,
            impl Fn(&Block, usize, usize, u32) -> RowNumbers,
            impl Fn(&RowNumbers, u32, &[u8; 16], &mut [u32; 16]),
        >,
    ) {
        out.first = piece.positions.len() as u32;
        self.emit_vertices(samples, style, borrowed, piece, &by);
        self.emit_triangles(samples, style, piece, out, &by);
        out.count = piece.positions.len() as u32 - out.first;
        out.active_cells = self.cells.len() as u64;
        let size = samples.size;
        for axis in 0..3 {
            let (low, high) = (&mut out.low[axis], &mut out.high[axis]);
            low.clear();
            high.clear();
            if borrowed[axis] {
                low.extend_from_slice(self.face(size, axis, 0, out.first, &by));
            }
            high.extend_from_slice(self.face(size, axis, size[axis] - 1, out.first, &by));
        }
    }

    /// Calls `f` with the row of points, x and the mask of inside corners of every active cell.
    pub(super) fn each_cell(&self, mut f: impl FnMut(usize, u32, usize)) {
        let mut from = 0;
        for &(row, end) in &self.active {
            for &code in &self.cells[from..end as usize] {
                f(
                    row as usize,
                    code & 255,
                    (code >> MASK_SHIFT) as usize & 255,
                );
            }
            from = end as usize;
        }
    }

    /// Vertices on the plane `at` of `axis`, in an order that both blocks of the plane agree on.
    #[inline(always)]
    fn face<E, P, O, N, T>(
        &mut self,
        [_, ny, nz]: [usize; 3],
        axis: usize,
        at: usize,
        first: u32,
        by: &Emit<
            impl Fn([&[u64]; 3], u64, &mut [u32]) -> usize,
            impl Fn(u32, u32, &mut [u32]),
            E,
            P,
            O,
            N,
            T,
        >,
    ) -> &[u32] {
        let mut out = std::mem::take(&mut self.on_face);
        // Not more than the points of a plane, twice.
        out.resize(out.len().max(2 * MAX_POINTS * ny.max(nz) + LIST_SLACK), 0);
        let mut end = 0;
        if axis == 0 {
            let mut rows = std::mem::take(&mut self.rows);
            rows.resize(rows.len().max(ny * nz + LIST_SLACK), 0);
            let [_, y, z] = &self.crossed;
            let count = (by.rows_with)([y, z, z], 1 << at, &mut rows);
            for &row in &rows[..count] {
                let row = row as usize;
                for along in OTHER[0] {
                    // Written in any case, kept where it is crossed.
                    out[end] = first + self.vertex(along, at as u32, row);
                    end += (self.crossed[along][row] >> at & 1) as usize;
                }
            }
            self.rows = rows;
        } else {
            // All crossed edges of a row: their numbers follow each other.
            let (start, step, count) = match axis {
                1 => (at, ny, nz),
                _ => (at * ny, 1, ny),
            };
            for row in (0..count).map(|i| start + i * step) {
                for along in OTHER[axis] {
                    let count = self.crossed[along][row].count_ones();
                    (by.put_run)(first + self.base[along][row], count, &mut out[end..]);
                    end += count as usize;
                }
            }
        }
        self.on_face = out;
        &self.on_face[..end]
    }
}

/// Lists the rows that have one of `bits` in one of their three masks, and counts them.
#[inline(always)]
pub(super) fn rows_with([a, b, c]: [&[u64]; 3], bits: u64, out: &mut [u32]) -> usize {
    let mut end = 0;
    for (row, ((a, b), c)) in (0..).zip(a.iter().zip(b).zip(c)) {
        // Written in any case: no branch.
        out[end] = row;
        end += usize::from((a | b | c) & bits != 0);
    }
    end
}

/// Writes `count` numbers from `start` on, and may write more behind them, [`LIST_SLACK`] in all.
#[inline(always)]
pub(super) fn put_run(start: u32, count: u32, out: &mut [u32]) {
    for (out, number) in out.iter_mut().zip(start..start + count) {
        *out = number;
    }
}

/// Appends `count` zeros, by copying, which for elements of 12 bytes is faster than setting.
#[inline(always)]
pub(super) fn push_zeros<T: Copy + Default>(list: &mut Vec<[T; 3]>, count: usize) {
    let zeros = [[T::default(); 3]; 128];
    let mut left = count;
    while left > 0 {
        let some = left.min(zeros.len());
        list.extend_from_slice(&zeros[..some]);
        left -= some;
    }
}

/// The samples at the corners of a cell.
pub(super) fn corner_values(samples: &BlockSamples, cell: [usize; 3]) -> [f32; 8] {
    std::array::from_fn(|c| {
        let p = corner(c);
        let at = (0..3)
            .map(|a| (cell[a] + p[a]) * samples.step[a])
            .sum::<usize>();
        samples.values[samples.first + at]
    })
}
