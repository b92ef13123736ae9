//! The blocks of a region in Morton order, by way of the octree above them.

use crate::error::Result;
use crate::field::{Field, Range};
use crate::lattice::Box3;

/// A block, or a larger node that need not be taken apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Block {
    pub(super) region: Box3,
    /// The one value of all its samples.
    pub(super) constant: Option<f32>,
}

/// The nodes of a region that still wait, the next one on top.
pub(super) struct Blocks<'a, F> {
    field: &'a dyn Field,
    region: Box3,
    /// Lowest corner from that of the domain on, and edge.
    stack: Vec<([u64; 3], u64)>,
    /// Whether a node of one value is left whole.
    pub(super) whole: bool,
    /// Whether no range is asked for: all blocks come, and who takes them looks for those of one value.
    pub(super) unseen: bool,
    /// Samples beyond the node, upward, that count for it.
    pub(super) apron: i32,
    /// Whether a node with this range is wanted.
    pub(super) wanted: F,
}

impl<'a, F: FnMut(&Range) -> bool> Blocks<'a, F> {
    /// The blocks of `region`, which lies in the domain.
    pub(super) fn new(field: &'a dyn Field, region: Box3, wanted: F) -> Self {
        let (domain, mut edge) = (field.grid().domain, u64::from(field.block_edge()));
        let mut stack = Vec::new();
        if !region.is_empty() {
            let far = domain.local(region.max).map(u64::from);
            while far.iter().any(|&v| v > edge) {
                edge *= 2;
            }
            stack.push(([0; 3], edge));
        }
        Self {
            field,
            region,
            stack,
            whole: false,
            unseen: false,
            apron: 0,
            wanted,
        }
    }

    /// The next block.
    pub(super) fn next(&mut self) -> Result<Option<Block>> {
        let domain = self.field.grid().domain;
        while let Some((low, edge)) = self.stack.pop() {
            let point = |a: usize, v: u64| {
                let at = i64::from(domain.min[a]) + v as i64;
                at.min(i64::from(i32::MAX)) as i32
            };
            let node = Box3 {
                min: std::array::from_fn(|a| point(a, low[a])),
                max: std::array::from_fn(|a| point(a, low[a] + edge)),
            };
            let region = node.intersect(&self.region);
            if region.is_empty() {
                continue;
            }
            let leaf = edge <= u64::from(self.field.block_edge());
            if !self.unseen {
                let seen = Box3::new(region.min, region.max.map(|v| v.saturating_add(self.apron)));
                let range = self.field.range(seen.intersect(&domain))?;
                if !(self.wanted)(&range) {
                    continue;
                }
                let constant = one_value(&range);
                if leaf || (constant.is_some() && self.whole) {
                    return Ok(Some(Block { region, constant }));
                }
            } else if leaf {
                let constant = None;
                return Ok(Some(Block { region, constant }));
            }
            let half = edge / 2;
            for c in (0..8u64).rev() {
                let child = std::array::from_fn(|a| low[a] + half * (c >> a & 1));
                self.stack.push((child, half));
            }
        }
        Ok(None)
    }
}

/// The value of all samples, where a range tells it.
pub(super) fn one_value(range: &Range) -> Option<f32> {
    let one = !range.has_nan && range.min.to_bits() == range.max.to_bits();
    one.then_some(range.min)
}
