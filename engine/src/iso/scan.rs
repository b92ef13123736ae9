//! From samples to masks: what is inside, which edges are crossed, which cells are active and how.

use super::block::{
    Block, BlockSamples, LIST_SLACK, MASK_SHIFT, MAX_POINTS, ROW_SHIFT, Style, below, corner_values,
};
use super::interior::decide;
use super::table::TABLE;
use crate::sample::Inside;

impl Block {
    /// Finds the crossed edges and active cells. False when there are none. `row_masks` gives the
    /// masks of the samples of all rows that are inside, and their union and intersection; `rows_with` is
    /// [`rows_with`](super::block::rows_with); `list_cells` writes the active cells of a row,
    /// given the masks of its four rows of points, the mask of its active cells and the place of the
    /// row in their codes, and says how many they are: it may write more behind them.
    #[inline(always)]
    pub(super) fn scan_with(
        &mut self,
        samples: &BlockSamples,
        style: &Style,
        row_masks: impl Fn(&BlockSamples, &Style, &mut Vec<u64>) -> (u64, u64),
        rows_with: impl Fn([&[u64]; 3], u64, &mut [u32]) -> usize,
        list_cells: impl Fn([u64; 4], u64, u32, &mut [u32]) -> usize,
    ) -> bool {
        let [nx, ny, nz] = samples.size;
        assert!(nx < MAX_POINTS, "a row of a block fits in a mask");
        let (any, every) = row_masks(samples, style, &mut self.inside);
        if any == 0 || every == below(nx as u32) {
            return false;
        }
        self.find_crossed_edges([nx, ny, nz]);
        self.find_active_cells(samples, style, rows_with, list_cells);
        self.edge_vertices > 0
    }

    /// Loops over slices that are as plain as can be, for the compiler to make vectors of.
    #[inline(always)]
    fn find_crossed_edges(&mut self, [nx, ny, nz]: [usize; 3]) {
        let rows = ny * nz;
        let [xs, ys, zs] = &mut self.crossed;
        let [bx, by, bz] = &mut self.base;
        for masks in [&mut *xs, &mut *ys, &mut *zs] {
            masks.resize(rows, 0);
        }
        for base in [&mut *bx, &mut *by, &mut *bz] {
            base.resize(rows, 0);
        }
        let inside = &self.inside[..rows];
        let cells = below(nx as u32 - 1);
        for (x, m) in xs.iter_mut().zip(inside) {
            *x = (m ^ m >> 1) & cells;
        }
        for ((y, m), next) in ys.iter_mut().zip(inside).zip(&inside[1..]) {
            *y = m ^ next;
        }
        // What follows the last row or slice is taken as equal.
        ys.iter_mut().skip(ny - 1).step_by(ny).for_each(|y| *y = 0);
        for ((z, m), next) in zs.iter_mut().zip(inside).zip(&inside[ny..]) {
            *z = m ^ next;
        }
        zs[rows - ny..].fill(0);
        // Vertices per row and axis, summed up along the axes, then along the rows.
        let masks = xs.iter().zip(&*ys).zip(&*zs);
        let sums = bx.iter_mut().zip(&mut *by).zip(&mut *bz);
        for (((x, y), z), ((bx, by), bz)) in masks.zip(sums) {
            *bx = x.count_ones();
            *by = *bx + y.count_ones();
            *bz = *by + z.count_ones();
        }
        let mut count = 0;
        for bz in bz.iter_mut() {
            count += std::mem::replace(bz, count);
        }
        for ((bx, by), bz) in bx.iter_mut().zip(&mut *by).zip(&mut *bz) {
            let start = *bz;
            *bz += *by;
            *by = *bx + start;
            *bx = start;
        }
        self.edge_vertices = count as usize;
    }

    #[inline(always)]
    fn find_active_cells(
        &mut self,
        samples: &BlockSamples,
        style: &Style,
        rows_with: impl Fn([&[u64]; 3], u64, &mut [u32]) -> usize,
        list_cells: impl Fn([u64; 4], u64, u32, &mut [u32]) -> usize,
    ) {
        let [nx, ny, nz] = samples.size;
        let inside = &self.inside[..ny * nz];
        let all = below(nx as u32 - 1);
        let rows = ny * (nz - 1) - 1;
        let active = &mut self.active_masks;
        active.resize(active.len().max(rows), 0);
        let active = &mut active[..rows];
        let corners =
            (inside.iter().zip(&inside[1..])).zip(inside[ny..].iter().zip(&inside[ny + 1..]));
        for (cells, ((a, b), (c, d))) in active.iter_mut().zip(corners) {
            let any = a | b | c | d;
            let every = a & b & c & d;
            *cells = (any | any >> 1) & !(every & every >> 1) & all;
        }
        // Between the last row of a slice and the first of the next lie no cells.
        (active.iter_mut().skip(ny - 1).step_by(ny)).for_each(|cells| *cells = 0);
        self.rows.resize(self.rows.len().max(rows + LIST_SLACK), 0);
        let count = rows_with([active, active, active], u64::MAX, &mut self.rows);
        let most: usize = active.iter().map(|cells| cells.count_ones() as usize).sum();
        self.cells
            .resize(self.cells.len().max(most + LIST_SLACK), 0);
        self.active.clear();
        let mut end = 0;
        for (i, &r) in (0..).zip(&self.rows[..count]) {
            let row = r as usize;
            let m = [
                inside[row],
                inside[row + 1],
                inside[row + ny],
                inside[row + ny + 1],
            ];
            end += list_cells(m, active[row], i << ROW_SHIFT, &mut self.cells[end..]);
            self.active.push((r, end as u32));
        }
        self.cells.truncate(end);
        self.decide_cells(samples, style);
    }

    /// Looks at the samples of those cells whose mask does not tell the case, and counts.
    #[inline(always)]
    fn decide_cells(&mut self, samples: &BlockSamples, style: &Style) {
        let table = &*TABLE;
        let ny = samples.size[1];
        self.decided.clear();
        let (mut triangles, mut interior, mut undecided) = (0, 0, 0);
        for &code in &self.cells {
            let mask = (code >> MASK_SHIFT) as usize & 255;
            triangles += usize::from(table.plain_triangles[mask]);
            undecided |= table.undecided[mask];
        }
        if undecided != 0 {
            for &code in &self.cells {
                let mask = (code >> MASK_SHIFT) as usize & 255;
                if table.undecided[mask] != 0 {
                    let row = self.active[(code >> ROW_SHIFT) as usize].0 as usize;
                    let cell = [(code & 255) as usize, row % ny, row / ny];
                    let values = corner_values(samples, cell);
                    let number = decide(&values, mask as u8, style.iso, style.inside);
                    let (t, v) = table.size(number);
                    triangles += t;
                    interior += v;
                    self.decided.push(number);
                }
            }
        }
        self.triangles_max = triangles;
        self.vertices_max = self.edge_vertices + interior;
    }
}

/// Masks of the samples of all rows that are inside, what they have together and what all have; by
/// `row_mask` for each row.
#[inline(always)]
pub(super) fn row_masks(
    samples: &BlockSamples,
    style: &Style,
    inside: &mut Vec<u64>,
    row_mask: impl Fn(&[f32], f32, Inside) -> u64,
) -> (u64, u64) {
    let [nx, ny, nz] = samples.size;
    inside.resize(ny * nz, 0);
    let (mut any, mut every) = (0, u64::MAX);
    for (z, masks) in inside.chunks_exact_mut(ny).enumerate() {
        let slice = samples.first + z * samples.step[2];
        for (y, mask) in masks.iter_mut().enumerate() {
            let row = &samples.values[slice + y * samples.step[1]..][..nx];
            *mask = row_mask(row, style.iso, style.inside);
            any |= *mask;
            every &= *mask;
        }
    }
    (any, every)
}

/// Mask of the samples of a row that are inside, at most 64.
#[inline(always)]
pub(super) fn portable_mask(row: &[f32], iso: f32, inside: Inside) -> u64 {
    row.iter().enumerate().fold(0, |mask, (x, &v)| {
        mask | u64::from(inside.contains(v, iso)) << x
    })
}

/// Writes the active cells of a row.
#[inline(always)]
pub(super) fn list_cells(rows: [u64; 4], mut cells: u64, row: u32, out: &mut [u32]) -> usize {
    let count = cells.count_ones() as usize;
    for out in &mut out[..count] {
        let x = cells.trailing_zeros();
        cells &= cells - 1;
        let pair = |i: usize| (rows[i] >> x) as u32 & 3;
        let mask = pair(0) | pair(1) << 2 | pair(2) << 4 | pair(3) << 6;
        *out = x | mask << MASK_SHIFT | row;
    }
    count
}
