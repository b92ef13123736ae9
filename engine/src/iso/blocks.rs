//! The cells that are meshed, cut into blocks, and the samples of a block.
//!
//! Blocks are cubes of `edge` cells anchored at the first sample of the domain. Where the solid is
//! capped, one more layer of cells lies around the samples, with NaN at its outer end; the layer
//! below the first samples goes to the first block.

use super::block::BlockSamples;
use super::extract::Boundary;
use crate::error::{Error, Result};
use crate::field::{Field, Range, Samples};
use crate::lattice::Box3;
use crate::sample::Inside;

/// Which cells are meshed, and how they are cut into blocks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Blocks {
    /// Block coordinates, half-open.
    pub(super) range: Box3,
    /// Cells per edge of a block.
    pub(super) edge: i32,
    /// Lowest corners of all cells, half-open.
    pub(super) cells: Box3,
    /// Samples that are used; all others read as NaN.
    pub(super) samples: Box3,
    /// Sample at the low corner of block (0, 0, 0).
    anchor: [i32; 3],
    /// Cells of the surface that these are a part of: beyond `cells` where pieces will be joined.
    whole: Box3,
    /// The samples of `whole`.
    pub(super) known: Box3,
}

impl Blocks {
    pub(super) fn new(field: &dyn Field, region: Option<Box3>, boundary: Boundary) -> Result<Self> {
        let domain = field.grid().domain;
        let region = region.unwrap_or(domain);
        if region.is_empty() || !domain.contains_box(&region) {
            return Err(Error::bad_input(format!(
                "region {region} is not inside the domain {domain}"
            )));
        }
        let with_far_side = Box3::new(
            region.min,
            std::array::from_fn(|a| (region.max[a] + 1).min(domain.max[a])),
        );
        let mut cells = region;
        for a in 0..3 {
            let capped_low = match boundary {
                Boundary::Cap => true,
                Boundary::Cut => false,
                Boundary::Tile => region.min[a] == domain.min[a],
            };
            let capped_high = match boundary {
                Boundary::Cap => true,
                Boundary::Cut => false,
                Boundary::Tile => region.max[a] == domain.max[a],
            };
            cells.min[a] -= i32::from(capped_low);
            cells.max[a] = with_far_side.max[a] - i32::from(!capped_high);
        }
        let edge = field.block_edge().clamp(8, 32) as i32;
        let anchor = domain.min;
        let block = |a: usize, point: i32| (point - anchor[a]).div_euclid(edge);
        // A region one sample thick has no cells unless it is capped.
        let range = if cells.is_empty() {
            Box3::from_size([0; 3])
        } else {
            Box3::new(
                std::array::from_fn(|a| block(a, region.min[a])),
                std::array::from_fn(|a| block(a, (cells.max[a] - 1).max(region.min[a])) + 1),
            )
        };
        let (whole, known) = match boundary {
            Boundary::Tile => (domain.grow(1, 0), domain),
            Boundary::Cap | Boundary::Cut => (cells, with_far_side),
        };
        Ok(Self {
            range,
            edge,
            cells,
            samples: with_far_side,
            anchor,
            whole,
            known,
        })
    }

    /// Cells of the cube of `2^level` blocks per edge at block coordinates `at`.
    pub(super) fn cells_of(&self, at: [i32; 3], level: u32) -> Box3 {
        let bound = |a: usize, block: i64, first: i32, last: i32| {
            if block <= i64::from(self.range.min[a]) {
                first
            } else if block >= i64::from(self.range.max[a]) {
                last
            } else {
                (i64::from(self.anchor[a]) + block * i64::from(self.edge)) as i32
            }
        };
        let size = 1i64 << level;
        Box3 {
            min: std::array::from_fn(|a| {
                bound(a, at[a].into(), self.cells.min[a], self.cells.max[a])
            }),
            max: std::array::from_fn(|a| {
                bound(
                    a,
                    i64::from(at[a]) + size,
                    self.cells.min[a],
                    self.cells.max[a],
                )
            }),
        }
    }

    /// The block of a cell.
    pub(super) fn block_of(&self, cell: [i32; 3]) -> [i32; 3] {
        std::array::from_fn(|a| {
            let block = (cell[a] - self.anchor[a]).div_euclid(self.edge);
            block.clamp(self.range.min[a], self.range.max[a] - 1)
        })
    }

    /// Whether the surface may cross one of `cells`.
    pub(super) fn may_cross(
        &self,
        field: &dyn Field,
        cells: Box3,
        iso: f32,
        inside: Inside,
    ) -> Result<bool> {
        let points = cells.grow(0, 1);
        let known = points.intersect(&self.samples);
        if known.is_empty() {
            return Ok(false);
        }
        let range = field.range(known)?;
        let capped = known != points;
        Ok(straddles(range, capped, iso, inside))
    }

    /// `cells` and what lies up to `rings` cells around them, as far as the surface goes on there.
    pub(super) fn around(&self, cells: Box3, rings: i32) -> Box3 {
        cells.grow(rings, rings).intersect(&self.whole)
    }

    /// Reads the samples of `cells` with `margin` more on every side.
    pub(super) fn gather(
        &self,
        field: &dyn Field,
        cells: Box3,
        margin: usize,
        out: &mut BlockSamples,
    ) -> Result<()> {
        gather(field, cells, margin, &self.samples, out)
    }

    /// [`gather`](Self::gather) for cells that [`around`](Self::around) gave.
    pub(super) fn gather_around(
        &self,
        field: &dyn Field,
        cells: Box3,
        margin: usize,
        out: &mut BlockSamples,
    ) -> Result<()> {
        gather(field, cells, margin, &self.known, out)
    }

    /// The samples that no block needs any more once `cells` of a block were gathered, with the blocks
    /// before it in Morton order gathered too. Those are all blocks with smaller coordinates, and a
    /// block reads one layer beyond its upper faces: so its own samples, or where gradients read
    /// beyond the lower faces as well, those of its neighbour below.
    pub(super) fn done_with(&self, cells: Box3, gradients: bool) -> Box3 {
        let points = cells.grow(0, 1);
        if !gradients {
            return points;
        }
        Box3 {
            min: points.min.map(|v| v.saturating_sub(self.edge)),
            max: points.min,
        }
    }
}

/// Reads the samples of `cells` with `margin` more on every side; those not in `samples` are NaN.
fn gather(
    field: &dyn Field,
    cells: Box3,
    margin: usize,
    samples: &Box3,
    out: &mut BlockSamples,
) -> Result<()> {
    let points = cells.grow(0, 1);
    let wide = points.grow(margin as i32, margin as i32);
    let [nx, ny, _] = wide.size().map(|n| n as usize);
    out.origin = points.min;
    out.size = points.size().map(|n| n as usize);
    out.step = [1, nx, nx * ny];
    out.first = margin * (1 + nx + nx * ny);
    let known = wide.intersect(samples);
    if known != wide {
        out.values.clear();
    }
    // What is not known is NaN; where all is known every value is overwritten.
    out.values.resize(wide.count() as usize, f32::NAN);
    let start = wide.offset_of(known.min);
    let mut block = Samples {
        values: &mut out.values[start..],
        row: nx,
        slice: nx * ny,
    };
    field.read(known, &mut block)
}

fn straddles(range: Range, capped: bool, iso: f32, inside: Inside) -> bool {
    let some_above = range.max >= iso;
    let some_below = range.min < iso;
    let unknown = capped || range.has_nan;
    match inside {
        Inside::Above => some_above && (some_below || unknown),
        Inside::Below => some_below && (some_above || unknown),
    }
}

/// Blocks that the surface may cross, in Morton order, found by descending the octree of blocks
/// and leaving out every node whose range does not straddle the isovalue.
pub(super) struct Candidates<'a> {
    pub(super) field: &'a dyn Field,
    pub(super) blocks: Blocks,
    iso: f32,
    inside: Inside,
    stack: Vec<([i32; 3], u32)>,
    /// How many are left out, and how many then follow.
    skip: u64,
    left: u64,
}

impl<'a> Candidates<'a> {
    pub(super) fn new(field: &'a dyn Field, blocks: Blocks, iso: f32, inside: Inside) -> Self {
        let mut stack = Vec::new();
        if !blocks.range.is_empty() {
            let widest = blocks.range.max.into_iter().max().unwrap_or(1) as u32;
            stack.push(([0; 3], widest.next_power_of_two().trailing_zeros()));
        }
        Self {
            field,
            blocks,
            iso,
            inside,
            stack,
            skip: 0,
            left: u64::MAX,
        }
    }

    /// Only those from number `from` to before number `to`.
    pub(super) fn only(self, from: u64, to: u64) -> Self {
        Self {
            skip: from,
            left: to - from,
            ..self
        }
    }

    /// The next block, or none.
    pub(super) fn next(&mut self) -> Result<Option<[i32; 3]>> {
        while self.left > 0 {
            match self.find()? {
                Some(_) if self.skip > 0 => self.skip -= 1,
                found => {
                    self.left -= 1;
                    return Ok(found);
                }
            }
        }
        Ok(None)
    }

    fn find(&mut self) -> Result<Option<[i32; 3]>> {
        while let Some((at, level)) = self.stack.pop() {
            let size = 1i64 << level;
            let touches = (0..3).all(|a| {
                i64::from(at[a]) < i64::from(self.blocks.range.max[a])
                    && i64::from(at[a]) + size > i64::from(self.blocks.range.min[a])
            });
            if !touches {
                continue;
            }
            let cells = self.blocks.cells_of(at, level);
            if !self
                .blocks
                .may_cross(self.field, cells, self.iso, self.inside)?
            {
                continue;
            }
            if level == 0 {
                return Ok(Some(at));
            }
            let half = 1 << (level - 1);
            for child in (0..8).rev() {
                let to =
                    std::array::from_fn(|a| at[a] + if child >> a & 1 == 1 { half } else { 0 });
                self.stack.push((to, level - 1));
            }
        }
        Ok(None)
    }
}
