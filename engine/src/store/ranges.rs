//! What the index knows of a region without a brick: the octree from its root down.

use super::page::{FIRST_NODE, Page, Slot};
use super::spec::page_edge;
use super::value::KeyRange;
use super::volume::Volume;
use crate::error::Result;
use crate::lattice::{Box3, morton_decode};

/// Bricks that a region meets, inclusive.
struct Query {
    low: [u32; 3],
    high: [u32; 3],
}

impl Volume {
    /// [`range`](Field::range) in the native type.
    pub(super) fn key_range(&self, region: Box3) -> Result<KeyRange> {
        let mut union = KeyRange::empty(self.spec.sample);
        if let Some((low, high)) = self.few_bricks(region) {
            let mut cursor = None;
            for z in low[2]..=high[2] {
                for y in low[1]..=high[1] {
                    for x in low[0]..=high[0] {
                        union = union.union(self.brick_range([x, y, z], &mut cursor)?);
                    }
                }
            }
            return Ok(union);
        }
        self.visit_ranges(region, &mut |range, leaf, inside| {
            if union.covers(&range) {
                return false;
            }
            if leaf || inside {
                union = union.union(range);
            }
            !inside
        })?;
        Ok(union)
    }

    /// The bricks that `region` meets, inclusive, where those are so few that going down the octree would
    /// look at more nodes than there are bricks: a block and its neighbours.
    fn few_bricks(&self, region: Box3) -> Option<([u32; 3], [u32; 3])> {
        let domain = self.spec.grid.domain;
        let region = region.intersect(&domain);
        if region.is_empty() || self.root.is_none() {
            return None;
        }
        let edge = self.spec.brick_edge;
        let brick = |point| domain.local(point).map(|v| v / edge);
        let (low, high) = (brick(region.min), brick(region.max.map(|v| v - 1)));
        (0..3).all(|a| high[a] - low[a] < 2).then_some((low, high))
    }

    /// Visits octree nodes that meet `region`, coarse to fine: `visit(range, is_leaf, is_inside)`
    /// says whether to go on to the parts of the node. A node is inside when no brick of it lies
    /// outside of the bricks that `region` meets.
    pub(super) fn visit_ranges(
        &self,
        region: Box3,
        visit: &mut impl FnMut(KeyRange, bool, bool) -> bool,
    ) -> Result<()> {
        let domain = self.spec.grid.domain;
        let region = region.intersect(&domain);
        if region.is_empty() {
            return Ok(());
        }
        let Some(root) = &self.root else {
            visit(
                KeyRange::of_bits(self.spec.sample, self.rules.background),
                true,
                true,
            );
            return Ok(());
        };
        let edge = self.spec.brick_edge;
        let brick = |point| domain.local(point).map(|v| v / edge);
        let query = Query {
            low: brick(region.min),
            high: brick(region.max.map(|v| v - 1)),
        };
        self.visit_node(root, 3, 0, [0; 3], &query, visit)
    }

    /// Depth is bounded by the level of the root, four per page.
    fn visit_node(
        &self,
        page: &Page,
        depth: u32,
        index: usize,
        min: [u32; 3],
        query: &Query,
        visit: &mut impl FnMut(KeyRange, bool, bool) -> bool,
    ) -> Result<()> {
        let edge = page_edge(page.level - 1) << depth;
        let mut inside = true;
        for a in 0..3 {
            let last = (min[a] + edge).min(self.rules.bricks[a]).wrapping_sub(1);
            if last < query.low[a] || query.high[a] < min[a] {
                return Ok(());
            }
            inside &= query.low[a] <= min[a] && last <= query.high[a];
        }
        let child = match depth {
            0 if page.level > 1 => match page.slot(index) {
                Slot::Child(reference) => Some(reference),
                _ => None,
            },
            _ => None,
        };
        let leaf = depth == 0 && child.is_none();
        if !visit(page.range(FIRST_NODE[depth as usize] + index), leaf, inside) || leaf {
            return Ok(());
        }
        if let Some(reference) = child {
            return match self.page(page.level - 1, min, reference) {
                Ok(below) => self.visit_node(&below, 3, 0, min, query, visit),
                Err(e) => {
                    self.damage.substitute(e, self.spec.node_box(min, edge))?;
                    visit(page.range(FIRST_NODE[0] + index), true, inside);
                    Ok(())
                }
            };
        }
        for c in 0..8 {
            let step = morton_decode(c as u64);
            let at = std::array::from_fn(|a| min[a] + step[a] * (edge / 2));
            self.visit_node(page, depth - 1, index * 8 + c, at, query, visit)?;
        }
        Ok(())
    }
}
