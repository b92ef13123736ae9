//! The triangles of the active cells of a block.

use super::ambiguity::offsets;
use super::block::{
    Block, BlockOutput, BlockSamples, Emit, MASK_SHIFT, ROW_SHIFT, Style, TRIANGLES_SLACK, below,
    corner_values, push_zeros,
};
use super::inner::Cell;
use super::table::{EDGE_LANE, TABLE};
use crate::mesh::{EdgeKey, Piece};

/// What numbers the vertices around a row of cells: crossed edges and first number, of the four
/// rows of x edges (y, z), (y+1, z), (y, z+1), (y+1, z+1), of the rows of y edges at z and z + 1, and
/// of the rows of z edges at y and y + 1.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(32))]
pub(super) struct RowNumbers {
    /// The masks' low words: they hold the edges at the cells of rows of up to 32 cells.
    pub(super) low: [u32; 8],
    pub(super) base: [u32; 8],
    /// The masks' high words, for longer rows.
    pub(super) high: [u32; 8],
}

impl RowNumbers {
    /// Of the row of cells at `row`, when the first vertex of the block has number `first`.
    #[inline(always)]
    pub(super) fn new(block: &Block, row: usize, ny: usize, first: u32) -> Self {
        let [x, y, z] = &block.crossed;
        let [bx, by, bz] = &block.base;
        let (a, b, c, d) = (row, row + 1, row + ny, row + ny + 1);
        let crossed = [x[a], x[b], x[c], x[d], y[a], y[c], z[a], z[b]];
        Self {
            low: crossed.map(|mask| mask as u32),
            base: [
                first + bx[a],
                first + bx[b],
                first + bx[c],
                first + bx[d],
                first + by[a],
                first + by[c],
                first + bz[a],
                first + bz[b],
            ],
            high: crossed.map(|mask| (mask >> 32) as u32),
        }
    }

    /// Numbers of the vertices around cell `x`, by [`EDGE_LANE`]: of the edges at x, then of those
    /// at x + 1. Those of edges that are not crossed mean nothing.
    #[inline(always)]
    fn of_cell(&self, x: u32) -> [u32; 16] {
        let low = below(x);
        let mut ids = [0; 16];
        for i in 0..8 {
            let crossed = u64::from(self.low[i]) | u64::from(self.high[i]) << 32;
            let rank = self.base[i] + (crossed & low).count_ones();
            ids[i] = rank;
            // The edge at x + 1 follows the one at x where that is crossed.
            ids[8 + i] = rank + (crossed >> x & 1) as u32;
        }
        ids
    }
}

/// Writes the corners of the (at most five) triangles that `lanes` names.
#[inline(always)]
pub(super) fn write_triangles(numbers: &RowNumbers, x: u32, lanes: &[u8; 16], out: &mut [u32; 16]) {
    let ids = numbers.of_cell(x);
    for (corner, &lane) in out.iter_mut().zip(lanes) {
        *corner = ids[usize::from(lane & 15)];
    }
}

impl Block {
    /// One loop over all cells: with a loop over the cells of each row inside of one over the rows, its
    /// end would be mispredicted in nearly every row.
    #[inline(always)]
    pub(super) fn emit_triangles<R, U, E, P, O>(
        &mut self,
        samples: &BlockSamples,
        style: &Style,
        piece: &mut Piece,
        out: &mut BlockOutput,
        by: &Emit<
            R,
            U,
            E,
            P,
            O,
            impl Fn(&Block, usize, usize, u32) -> RowNumbers,
            impl Fn(&RowNumbers, u32, &[u8; 16], &mut [u32; 16]),
        >,
    ) {
        let table = &*TABLE;
        let ny = samples.size[1];
        let before = piece.triangles.len();
        push_zeros(&mut piece.triangles, self.triangles_max + TRIANGLES_SLACK);
        let mut numbers = std::mem::take(&mut self.numbers);
        numbers.resize(numbers.len().max(self.active.len()), RowNumbers::default());
        for (numbers, &(row, _)) in numbers.iter_mut().zip(&self.active) {
            *numbers = (by.numbers)(self, row as usize, ny, out.first);
        }
        let mut written = before;
        let mut decided = self.decided.iter();
        for &code in &self.cells {
            let x = code & 255;
            let mask = (code >> MASK_SHIFT) as usize & 255;
            let numbers = &numbers[(code >> ROW_SHIFT) as usize];
            let (mut lanes, mut count) = (&table.plain_lanes[mask], table.plain_triangles[mask]);
            if table.undecided[mask] != 0 {
                out.ambiguous_faces += u64::from(table.ambiguous[mask].count_ones());
                let number = *decided.next().expect("scanned");
                match table.case(number) {
                    Ok(entry) if entry.centre().is_empty() && entry.triangles().len() <= 5 => {
                        (lanes, count) = (entry.lanes(), entry.triangles().len() as u8);
                    }
                    _ => {
                        let row = self.active[(code >> ROW_SHIFT) as usize].0 as usize;
                        let cell = [x as usize, row % ny, row / ny];
                        let ids = numbers.of_cell(x);
                        let had = piece.positions.len();
                        written = emit_inner(samples, style, cell, number, &ids, piece, written);
                        out.interior_vertices += (piece.positions.len() - had) as u64;
                        continue;
                    }
                }
            }
            let corners = piece.triangles[written..].as_flattened_mut();
            let corners = corners
                .first_chunk_mut()
                .expect("room for a cell and slack");
            (by.triangles)(numbers, x, lanes, corners);
            written += usize::from(count);
        }
        piece.triangles.truncate(written);
        self.numbers = numbers;
        if style.placement.mirrored {
            piece.triangles[before..]
                .iter_mut()
                .for_each(|t| t.swap(1, 2));
        }
    }
}

/// The vertices and triangles of a cell that has vertices inside, or many triangles.
#[cold]
#[inline(never)]
fn emit_inner(
    samples: &BlockSamples,
    style: &Style,
    cell: [usize; 3],
    number: u16,
    ids: &[u32; 16],
    piece: &mut Piece,
    mut written: usize,
) -> usize {
    let values = corner_values(samples, cell);
    let frame = Cell {
        values: &values,
        offsets: offsets(&values, style.iso, style.inside),
        iso: style.iso,
        placement: &style.placement,
    };
    let mut points = Vec::new();
    let triangles = match TABLE.case(number) {
        Ok(entry) if entry.centre().is_empty() => entry.triangles(),
        Ok(entry) => {
            points.push(frame.centre(entry.centre()));
            entry.triangles()
        }
        Err(tunnel) => {
            frame.waist(tunnel, &mut points);
            &tunnel.triangles
        }
    };
    let first = piece.positions.len() as u32;
    let point = std::array::from_fn(|a| samples.origin[a] + cell[a] as i32);
    for (axis, at) in (3..).zip(points) {
        piece.own.push(piece.positions.len() as u32);
        piece.positions.push(style.placement.in_cell(point, at));
        if style.normals {
            let gradient = frame.interpolate(at).1;
            let normal = style.placement.normal(gradient, style.inside);
            piece.normals.push(normal.unwrap_or([0.0, 0.0, 1.0]));
        }
        if style.keys {
            piece.keys.push(EdgeKey { point, axis });
        }
    }
    for t in triangles {
        piece.triangles[written] = t.map(|v| match v {
            0..12 => ids[usize::from(EDGE_LANE[usize::from(v)])],
            _ => first + u32::from(v) - 12,
        });
        written += 1;
    }
    written
}
