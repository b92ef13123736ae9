//! Better triangles: vertices slide along the surface towards the middle of their neighbours.
//!
//! README.md of the folder above says why pieces agree. A *tile* is a cube of blocks. It is meshed
//! once more with enough cells around it that what happens farther away cannot be seen from inside,
//! its vertices are moved, and the blocks of the tile take the places of their vertices from there.
//! Numbers of vertices and triangles are those of the mesh that is not relaxed.

mod net;
mod settle;
mod surface;
mod tangle;

use super::block::{Block, BlockOutput, BlockSamples, Style, below};
use super::blocks::Blocks;
use super::place::{Placement, gradient, unit};
use crate::budget::{Budget, Permit};
use crate::error::{Error, ErrorKind, Result};
use crate::field::Field;
use crate::lattice::{Box3, Grid};
use crate::mesh::{EdgeKey, Piece};
use net::Net;
use settle::{Settling, settle};
use std::ops::Range;
use surface::{FINE, Metric, Surface, UNIT};

/// Most passes: a tile with all its rings is as large as a block can be.
pub const MAX_RELAX_PASSES: u8 = 5;

/// Cells per edge of a tile.
const TILE: i32 = 32;

/// Most samples along an edge of a tile with all around it.
pub(super) const TILE_SAMPLES: u64 = 66;

/// The tile of the block at these block coordinates, of `edge` cells.
pub(super) fn tile_of(at: [i32; 3], edge: i32) -> [i32; 3] {
    let level = (TILE / edge).max(1).ilog2();
    at.map(|v| v >> level)
}

/// Moves the vertices of blocks; each thread has its own.
pub(super) struct Relaxer<'a> {
    blocks: Blocks,
    style: Style,
    budget: &'a Budget,
    metric: Metric,
    /// Number of the field and blocks of the tile at hand, in coordinates of tiles.
    at: Option<(u32, [i32; 3])>,
    block: Block,
    samples: BlockSamples,
    piece: Piece,
    out: BlockOutput,
    net: Net,
    settling: Settling,
    memory: Option<Permit>,
    /// For the search of triangles that cross.
    more: Option<Permit>,
}

impl<'a> Relaxer<'a> {
    /// None where the style does not ask for relaxation.
    pub(super) fn new(
        grid: &Grid,
        blocks: Blocks,
        style: Style,
        budget: &'a Budget,
    ) -> Option<Self> {
        let mut net = Net::default();
        net.rounding = rounding(&style.placement, grid.domain);
        (style.relax > 0).then(|| Self {
            blocks,
            style,
            budget,
            metric: Metric::new(style.placement.map()),
            at: None,
            block: Block::default(),
            samples: BlockSamples::default(),
            piece: Piece::default(),
            out: BlockOutput::default(),
            net,
            settling: Settling::default(),
            memory: None,
            more: None,
        })
    }

    /// Moves the vertices `range` of `piece`, those of the block `at`. Of several fields on one grid
    /// each has its `number`.
    ///
    /// # Errors
    /// What the field reports; `BudgetExceeded` when a tile does not fit; `Damaged` when the field
    /// gives different samples when it is read again.
    pub(super) fn relax(
        &mut self,
        (field, number): (&dyn Field, u32),
        at: [i32; 3],
        piece: &mut Piece,
        range: Range<usize>,
    ) -> Result<()> {
        let level = (TILE / self.blocks.edge).max(1).ilog2();
        let tile = tile_of(at, self.blocks.edge);
        if self.at != Some((number, tile)) {
            self.at = None;
            let cells = self.blocks.cells_of(tile.map(|v| v << level), level);
            if self.build(field, cells, false)? {
                self.build(field, cells, true)?;
            }
            self.at = Some((number, tile));
        }
        piece
            .unmoved
            .extend_from_slice(&piece.positions[range.clone()]);
        for v in range {
            let Some(i) = self.find(piece.keys[v]) else {
                return Err(Error::new(
                    ErrorKind::Damaged,
                    format!(
                        "the samples around {:?} differ from read to read, or the range of a block does not cover \
                         its samples",
                        piece.keys[v].point
                    ),
                ));
            };
            if self.net.now[i] == self.net.start[i] {
                continue;
            }
            piece.positions[v] = self.style.placement.at(self.index(i));
            if self.style.normals
                && let Some(normal) = self.normal(i)
            {
                piece.normals[v] = normal;
            }
        }
        Ok(())
    }

    /// Meshes the tile and moves its vertices. True when that must be done again, because sheets
    /// of the surface are close to each other here.
    fn build(&mut self, field: &dyn Field, cells: Box3, close: bool) -> Result<bool> {
        let rings = self.style.relax + settle::rings(close);
        let wide = self.blocks.around(cells, i32::from(rings));
        self.blocks
            .gather_around(field, wide, 1, &mut self.samples)?;
        let style = Style {
            placement: self.style.placement.in_cells(),
            normals: false,
            keys: true,
            ..self.style
        };
        let piece = &mut self.piece;
        piece.positions.clear();
        piece.keys.clear();
        piece.own.clear();
        piece.triangles.clear();
        (self.memory, self.more) = (None, None);
        if !self.block.scan(&self.samples, &style) {
            return Ok(false);
        }
        let bytes = self.samples.values.len() * 4
            + self.block.vertices_max * (Net::VERTEX_BYTES + 12 + 4 + size_of::<EdgeKey>())
            + self.block.triangles_max * 12;
        self.memory = Some(
            self.budget
                .take(bytes as u64, "relaxing a tile of dense surface")?,
        );
        self.out.reset();
        self.block
            .emit(&self.samples, &style, [false; 3], piece, &mut self.out);
        self.net.start(
            &self.block,
            &self.samples,
            piece,
            &style,
            &cells,
            &self.blocks.known,
        );
        if !close && self.net.is_close_within(settle::rings(false)) {
            return Ok(true);
        }
        if close {
            let bytes = self.settling.tangles.prepare(&self.net, &piece.triangles);
            self.more = Some(
                self.budget
                    .take(bytes, "relaxing a tile of dense surface")?,
            );
        }
        let surface = Surface::new(&self.samples, style.iso, self.metric);
        let (net, settling) = (&mut self.net, &mut self.settling);
        let (triangles, metric) = (&piece.triangles[..], &self.metric);
        style.level.run(|| {
            net.find_normals(&surface, style.inside, rings - 1);
            for pass in 1..=style.relax {
                net.pass(&surface, style.inside, triangles, rings - pass);
            }
            settle(net, metric, triangles, close, settling);
        });
        Ok(false)
    }

    /// Number of a vertex in the tile.
    fn find(&self, key: EdgeKey) -> Option<usize> {
        let [nx, ny, nz] = self.samples.size;
        let mut at = [0; 3];
        for a in 0..3 {
            at[a] = usize::try_from(key.point[a] - self.samples.origin[a]).ok()?;
        }
        let [x, y, z] = at;
        if x >= nx || y >= ny || z >= nz {
            return None;
        }
        if key.axis >= 3 {
            let inner = &self.piece.keys[self.block.edges.len()..];
            let order = |k: &EdgeKey| (k.point[2], k.point[1], k.point[0], k.axis);
            let found = inner.binary_search_by_key(&order(&key), order).ok()?;
            return Some(self.block.edges.len() + found);
        }
        let (axis, row) = (usize::from(key.axis), y + ny * z);
        let crossed = self.block.crossed[axis].get(row)? >> x & 1 == 1;
        let rank = (self.block.crossed[axis][row] & below(x as u32)).count_ones();
        crossed.then(|| (self.block.base[axis][row] + rank) as usize)
    }

    /// Where vertex `i` of the tile is, in index space.
    fn index(&self, i: usize) -> [f64; 3] {
        std::array::from_fn(|a| {
            let first = f64::from(self.samples.origin[a] - 1);
            first + f64::from(self.net.now[i][a]) / f64::from(UNIT)
        })
    }

    /// The normal from the gradients at the corners of the cell; none on a cap, where the one that
    /// is there is right, or where the gradient has no direction.
    fn normal(&self, i: usize) -> Option<[f32; 3]> {
        let kind = self.net.kinds[i];
        if kind & net::kind::FLAT != 0 {
            return None;
        }
        let place = self.net.now[i];
        let mut g = [0.0; 3];
        let mut first = 0;
        let mut w = [0.0; 3];
        for a in 0..3 {
            let low = i32::from(kind >> (net::kind::HIGH as usize + a) & 1);
            let cell = (place[a] >> FINE) - low;
            w[a] = f64::from(place[a] - (cell << FINE)) / f64::from(UNIT);
            first += cell as usize * self.samples.step[a];
        }
        for corner in 0..8 {
            let mut at = first;
            let mut weight = 1.0;
            for a in 0..3 {
                let high = corner >> a & 1 == 1;
                at += if high { self.samples.step[a] } else { 0 };
                weight *= if high { w[a] } else { 1.0 - w[a] };
            }
            if weight > 0.0 {
                let of_corner = gradient(&self.samples, at);
                (0..3).for_each(|a| g[a] += weight * of_corner[a]);
            }
        }
        unit(g)?;
        self.style.placement.normal(g, self.style.inside)
    }
}

/// By how much the coordinates of vertices change at most when they become numbers of 24 bits, in
/// units of a place.
fn rounding(placement: &Placement, domain: Box3) -> f64 {
    let map = placement.map();
    let largest = (0..8).fold(0.0f64, |most, corner| {
        let at = std::array::from_fn(|a| {
            let [low, high] = [domain.min[a] - 1, domain.max[a]];
            f64::from(if corner >> a & 1 == 1 { high } else { low })
        });
        map.apply(at).into_iter().fold(most, |m, v| m.max(v.abs()))
    });
    let small = map.spacing().into_iter().fold(f64::INFINITY, f64::min);
    // Half a unit in the last place, and places are rounded to whole units themselves.
    largest / small * 2f64.powi(FINE as i32 - 24) + 1.0
}
