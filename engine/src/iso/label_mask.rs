//! The labels of a block, and each of them as the samples of a mask.
//!
//! A label is looked at in its own box within the block, one point wider than itself: beyond that
//! box its mask is zero, so no edge is crossed there, and vertices and triangles come in the order
//! in which the whole block would give them.

use super::block::BlockSamples;
use super::blocks::Blocks;
use super::relax::TILE_SAMPLES;
use crate::error::Result;
use crate::field::{Field, Labels, Range, Samples};
use crate::lattice::{Box3, Grid};
use crate::sample::Kind;
use std::collections::HashMap;

/// Most passes of smoothing: so far every value is a multiple of 2^-24, so every sum is exact and
/// does not depend on where a block begins.
pub(super) const SMOOTH_MAX: u8 = 4;

/// How masks are made of labels; the same for all blocks of a run.
#[derive(Clone, Debug)]
pub(super) struct Masks {
    /// The labels that are meshed, in order; all but 0 when `None`.
    pub(super) wanted: Option<Vec<u32>>,
    /// Passes of the kernel 1/4, 1/2, 1/4 along each axis.
    pub(super) smooth: u8,
    pub(super) normals: bool,
}

impl Masks {
    fn wants(&self, label: u32) -> bool {
        match &self.wanted {
            None => label != 0,
            Some(list) => list.binary_search(&label).is_ok(),
        }
    }

    /// Whether a label between these two, inclusive, is meshed.
    pub(super) fn wants_between(&self, low: u32, high: u32) -> bool {
        match &self.wanted {
            None => high != 0,
            Some(list) => list[list.partition_point(|&l| l < low)..]
                .first()
                .is_some_and(|&l| l <= high),
        }
    }

    fn smooth(&self) -> i32 {
        i32::from(self.smooth)
    }

    fn margin(&self) -> i32 {
        i32::from(self.normals)
    }

    /// Bytes that the labels and masks of a tile take at most, whose vertices move in some passes.
    pub(super) fn tile_bytes(&self, passes: u8) -> u64 {
        let across = TILE_SAMPLES + 2 * u64::from(self.smooth);
        if passes > 0 { across.pow(3) * 12 } else { 0 }
    }

    /// Bytes that the buffers of a thread take at most.
    pub(super) fn scratch_bytes(&self, edge: i32) -> u64 {
        let across = (edge + 1 + 2 * (self.margin() + self.smooth())) as u64;
        // Labels, a mask, two buffers of smoothing, and a list with a label for every point.
        across.pow(3) * (4 * 4 + 64)
    }
}

/// The mask of one label as a field.
pub(super) struct OneLabel<'a> {
    pub(super) source: &'a dyn Labels,
    pub(super) label: u32,
    pub(super) masks: &'a Masks,
}

impl Field for OneLabel<'_> {
    fn grid(&self) -> &Grid {
        self.source.grid()
    }

    fn kind(&self) -> Kind {
        Kind::Mask
    }

    fn block_edge(&self) -> u32 {
        self.source.block_edge()
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()> {
        let reach = self.masks.smooth();
        let around = region.grow(reach, reach).intersect(&self.grid().domain);
        let mut labels = vec![0; around.count() as usize];
        self.source.read(around, &mut labels)?;
        let is_it = |&l: &u32| f32::from(u8::from(l == self.label));
        let mut mask: Vec<f32> = labels.iter().map(is_it).collect();
        if reach > 0 {
            let mut other = vec![0.0; mask.len()];
            for _ in 0..reach {
                smooth_once(&mut mask, &mut other, around);
            }
        }
        let [nx, ny, nz] = region.size().map(|n| n as usize);
        for k in 0..nz {
            for j in 0..ny {
                let at = [0, j as i32, k as i32];
                let start = around.offset_of(std::array::from_fn(|a| region.min[a] + at[a]));
                out.row_mut(j, k, nx)
                    .copy_from_slice(&mask[start..start + nx]);
            }
        }
        Ok(())
    }

    fn range(&self, _region: Box3) -> Result<Range> {
        let mut range = Range::of(0.0);
        range.add(1.0);
        Ok(range)
    }
}

/// The labels of the points of a block and around them.
#[derive(Debug, Default)]
pub(super) struct LabelBlock {
    /// The points of the block, and the box of `labels`; nothing before the first block.
    boxes: Option<(Box3, Box3)>,
    labels: Vec<u32>,
    /// The labels that are wanted, with their boxes, in order.
    pub(super) found: Vec<(u32, Box3)>,
    places: HashMap<u32, usize>,
    smoothed: Vec<f32>,
    other: Vec<f32>,
}

impl LabelBlock {
    /// Reads what the cells need, and lists the labels.
    pub(super) fn gather(
        &mut self,
        source: &dyn Labels,
        blocks: &Blocks,
        cells: Box3,
        masks: &Masks,
    ) -> Result<()> {
        let points = cells.grow(0, 1);
        let domain = source.grid().domain;
        let smooth = masks.smooth();
        let near = |margin: i32| {
            let used = points.grow(margin, margin).intersect(&blocks.samples);
            used.grow(smooth, smooth).intersect(&domain)
        };
        let region = near(masks.margin());
        self.labels.resize(region.count() as usize, 0);
        source.read(region, &mut self.labels)?;
        self.boxes = Some((points, region));
        self.list(region, near(0), masks);
        Ok(())
    }

    fn list(&mut self, region: Box3, part: Box3, masks: &Masks) {
        self.found.clear();
        self.places.clear();
        let width = part.size()[0] as usize;
        for k in part.min[2]..part.max[2] {
            for j in part.min[1]..part.max[1] {
                let start = region.offset_of([part.min[0], j, k]);
                let row = &self.labels[start..][..width];
                let mut i = part.min[0];
                for run in row.chunk_by(|a, b| a == b) {
                    let end = i + run.len() as i32;
                    let here = Box3::new([i, j, k], [end, j + 1, k + 1]);
                    i = end;
                    if !masks.wants(run[0]) {
                        continue;
                    }
                    let place = *self.places.entry(run[0]).or_insert(self.found.len());
                    match self.found.get_mut(place) {
                        None => self.found.push((run[0], here)),
                        Some((_, known)) => {
                            *known = Box3 {
                                min: std::array::from_fn(|a| known.min[a].min(here.min[a])),
                                max: std::array::from_fn(|a| known.max[a].max(here.max[a])),
                            }
                        }
                    }
                }
            }
        }
        self.found.sort_unstable_by_key(|&(label, _)| label);
    }

    /// The samples of the mask of label `n` of `found`.
    pub(super) fn mask(
        &mut self,
        n: usize,
        blocks: &Blocks,
        domain: Box3,
        masks: &Masks,
        out: &mut BlockSamples,
    ) {
        let (label, its) = self.found[n];
        let (points, region) = self.boxes.expect("gathered");
        let reach = masks.smooth() + 1;
        let part = its.grow(reach, reach).intersect(&points);
        let margin = masks.margin();
        let wide = part.grow(margin, margin);
        let [nx, ny, _] = wide.size().map(|v| v as usize);
        out.origin = part.min;
        out.size = part.size().map(|v| v as usize);
        out.step = [1, nx, nx * ny];
        out.first = margin as usize * (1 + nx + nx * ny);
        let known = wide.intersect(&blocks.samples);
        out.values.clear();
        out.values.resize(wide.count() as usize, f32::NAN);
        let labels = &self.labels;
        if masks.smooth == 0 {
            each_row(known, wide, region, |to, from| {
                for (value, &l) in out.values[to].iter_mut().zip(&labels[from]) {
                    *value = f32::from(u8::from(l == label));
                }
            });
            return;
        }
        let around = known
            .grow(masks.smooth(), masks.smooth())
            .intersect(&domain);
        self.smoothed.resize(around.count() as usize, 0.0);
        self.other.resize(around.count() as usize, 0.0);
        each_row(around, around, region, |to, from| {
            for (value, &l) in self.smoothed[to].iter_mut().zip(&labels[from]) {
                *value = f32::from(u8::from(l == label));
            }
        });
        for _ in 0..masks.smooth {
            smooth_once(&mut self.smoothed, &mut self.other, around);
        }
        each_row(known, wide, around, |to, from| {
            out.values[to].copy_from_slice(&self.smoothed[from]);
        });
    }
}

/// Calls `row` with the places of each row of `part` in arrays over `to` and over `from`.
fn each_row(
    part: Box3,
    to: Box3,
    from: Box3,
    mut row: impl FnMut(std::ops::Range<usize>, std::ops::Range<usize>),
) {
    let width = part.size()[0] as usize;
    for k in part.min[2]..part.max[2] {
        for j in part.min[1]..part.max[1] {
            let [a, b] = [to, from].map(|over| over.offset_of([part.min[0], j, k]));
            row(a..a + width, b..b + width);
        }
    }
}

/// One pass along each axis. What lies beyond the array is taken as equal to its border: right
/// where that is the border of the domain, and wrong by one layer a pass elsewhere.
fn smooth_once(values: &mut Vec<f32>, other: &mut Vec<f32>, over: Box3) {
    let size = over.size().map(|n| n as usize);
    let steps = [1, size[0], size[0] * size[1]];
    for axis in 0..3 {
        let (step, n) = (steps[axis], size[axis]);
        for (at, out) in other.iter_mut().enumerate() {
            let place = at / step % n;
            let low = if place > 0 { at - step } else { at };
            let high = if place + 1 < n { at + step } else { at };
            *out = (values[low] + 2.0 * values[at] + values[high]) * 0.25;
        }
        std::mem::swap(values, other);
    }
}
