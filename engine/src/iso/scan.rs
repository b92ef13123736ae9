//! From samples to masks: what is inside, which edges are crossed, which cells are active and how.

use super::block::{Block, BlockSamples, MASK_SHIFT, MAX_POINTS, Style, below, corner_values};
use super::interior::decide;
use super::table::TABLE;
use crate::sample::Inside;

impl Block {
    /// Finds the crossed edges and active cells. False when there are none. `row_mask` gives the
    /// mask of the samples of a row that are inside; `list_cells` appends the active cells of a
    /// row, given the masks of its four rows of points and the mask of its active cells.
    #[inline(always)]
    pub(super) fn scan_with(
        &mut self,
        samples: &BlockSamples,
        style: &Style,
        row_mask: impl Fn(&[f32], f32, Inside) -> u64,
        list_cells: impl Fn([u64; 4], u64, &mut Vec<u32>),
    ) -> bool {
        let [nx, ny, nz] = samples.size;
        assert!(nx < MAX_POINTS, "a row of a block fits in a mask");
        self.inside.resize(ny * nz, 0);
        let (mut any, mut every) = (0, u64::MAX);
        for (z, masks) in self.inside.chunks_exact_mut(ny).enumerate() {
            let slice = samples.first + z * samples.step[2];
            for (y, mask) in masks.iter_mut().enumerate() {
                let row = &samples.values[slice + y * samples.step[1]..][..nx];
                *mask = row_mask(row, style.iso, style.inside);
                any |= *mask;
                every &= *mask;
            }
        }
        if any == 0 || every == below(nx as u32) {
            return false;
        }
        self.find_crossed_edges([nx, ny, nz]);
        self.find_active_cells(samples, style, list_cells);
        self.edge_vertices > 0
    }

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
        let (xs, ys, zs) = (&mut xs[..rows], &mut ys[..rows], &mut zs[..rows]);
        let (bx, by, bz) = (&mut bx[..rows], &mut by[..rows], &mut bz[..rows]);
        let cells = below(nx as u32 - 1);
        let mut count = 0;
        for z in 0..nz {
            let last_slice = z + 1 == nz;
            for y in 0..ny {
                let r = y + ny * z;
                let m = inside[r];
                // What follows the last row or slice is taken as equal.
                let next_row = if y + 1 < ny { inside[r + 1] } else { m };
                let next_slice = if last_slice { m } else { inside[r + ny] };
                let edges = [(m ^ m >> 1) & cells, m ^ next_row, m ^ next_slice];
                (xs[r], ys[r], zs[r]) = (edges[0], edges[1], edges[2]);
                bx[r] = count;
                count += edges[0].count_ones();
                by[r] = count;
                count += edges[1].count_ones();
                bz[r] = count;
                count += edges[2].count_ones();
            }
        }
        self.edge_vertices = count as usize;
    }

    #[inline(always)]
    fn find_active_cells(
        &mut self,
        samples: &BlockSamples,
        style: &Style,
        list_cells: impl Fn([u64; 4], u64, &mut Vec<u32>),
    ) {
        let [nx, ny, nz] = samples.size;
        let inside = &self.inside[..ny * nz];
        let all = below(nx as u32 - 1);
        self.active.clear();
        self.cells.clear();
        for z in 0..nz - 1 {
            for row in ny * z..ny * z + ny - 1 {
                let m = [
                    inside[row],
                    inside[row + 1],
                    inside[row + ny],
                    inside[row + ny + 1],
                ];
                let any = m[0] | m[1] | m[2] | m[3];
                let every = m[0] & m[1] & m[2] & m[3];
                let cells = (any | any >> 1) & !(every & every >> 1) & all;
                if cells != 0 {
                    list_cells(m, cells, &mut self.cells);
                    self.active.push((row as u32, self.cells.len() as u32));
                }
            }
        }
        self.decide_cells(samples, style);
    }

    /// Looks at the samples of those cells whose mask does not tell the case, and counts.
    #[inline(always)]
    fn decide_cells(&mut self, samples: &BlockSamples, style: &Style) {
        let table = &*TABLE;
        let ny = samples.size[1];
        self.decided.clear();
        let (mut triangles, mut interior) = (0, 0);
        let mut from = 0;
        for &(row, end) in &self.active {
            let mut undecided = 0;
            for &code in &self.cells[from..end as usize] {
                let mask = (code >> MASK_SHIFT) as usize & 255;
                triangles += usize::from(table.plain_triangles[mask]);
                undecided |= table.undecided[mask];
            }
            if undecided != 0 {
                let [y, z] = [row as usize % ny, row as usize / ny];
                for &code in &self.cells[from..end as usize] {
                    let mask = (code >> MASK_SHIFT) as usize & 255;
                    if table.undecided[mask] != 0 {
                        let cell = [(code & 255) as usize, y, z];
                        let values = corner_values(samples, cell);
                        let number = decide(&values, mask as u8, style.iso, style.inside);
                        let (t, v) = table.size(number);
                        triangles += t;
                        interior += v;
                        self.decided.push(number);
                    }
                }
            }
            from = end as usize;
        }
        self.triangles_max = triangles;
        self.vertices_max = self.edge_vertices + interior;
    }
}

/// Mask of the samples of a row that are inside, at most 64.
#[inline(always)]
pub(super) fn portable_mask(row: &[f32], iso: f32, inside: Inside) -> u64 {
    row.iter().enumerate().fold(0, |mask, (x, &v)| {
        mask | u64::from(inside.contains(v, iso)) << x
    })
}

/// Appends the active cells of a row.
#[inline(always)]
pub(super) fn list_cells(rows: [u64; 4], mut cells: u64, out: &mut Vec<u32>) {
    while cells != 0 {
        let x = cells.trailing_zeros();
        cells &= cells - 1;
        let pair = |i: usize| (rows[i] >> x) as u32 & 3;
        let mask = pair(0) | pair(1) << 2 | pair(2) << 4 | pair(3) << 6;
        out.push(x | mask << MASK_SHIFT);
    }
}
