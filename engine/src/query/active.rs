//! The cells of a region that a surface passes.

use super::blocks::Blocks;
use super::ordered::in_order;
use super::stream::{ahead, check_region};
use crate::budget::Budget;
use crate::error::Result;
use crate::field::{Field, Range, Samples};
use crate::lattice::Box3;
use crate::sample::Inside;

/// Hands the cells of `region` that have corners inside and corners outside to `take`: lowest corners,
/// in lattice order within a block, blocks in Morton order; a call for each block that has some. A cell
/// belongs to the region when all its corners do. Returns their number.
///
/// # Errors
/// When `region` is not inside the domain, what the field and `take` report, `Cancelled`.
///
/// # Memory
/// A block and the list of its active cells a thread.
pub fn active_cells(
    field: &dyn Field,
    region: Box3,
    iso: f32,
    inside: Inside,
    budget: &Budget,
    mut take: impl FnMut(&[[i32; 3]]) -> Result<()>,
) -> Result<u64> {
    check_region(field, region)?;
    let cells = Box3::new(region.min, region.max.map(|v| v - 1));
    if cells.is_empty() {
        return Ok(0);
    }
    let mixed = |range: &Range| {
        let ends = [range.min, range.max].map(|v| inside.contains(v, iso));
        // NaN is outside: it is enough for a surface where anything is inside.
        (ends[0] || ends[1]) && (!ends[0] || !ends[1] || range.has_nan)
    };
    let mut blocks = Blocks::new(field, cells, mixed);
    blocks.apron = 1;
    let edge = u64::from(field.block_edge());
    let waiting = ahead(field, budget) as u64;
    let _permit = budget.take(waiting * edge.pow(3) * 12, "lists of active cells")?;
    let mut count = 0;
    in_order(
        budget,
        waiting as usize,
        || blocks.next(),
        |block| {
            let cells = block.region;
            let seen = cells.grow(0, 1);
            let _permit = budget.take(seen.count() * 4, "a block of cells")?;
            let mut values = vec![0.0; seen.count() as usize];
            field.read(seen, &mut Samples::dense(&mut values, seen))?;
            Ok(active_of(&values, seen, cells, iso, inside))
        },
        |found| {
            count += found.len() as u64;
            if found.is_empty() {
                Ok(())
            } else {
                take(&found)
            }
        },
    )?;
    Ok(count)
}

/// The active ones of `cells`, whose samples are the `values` of `seen`.
fn active_of(values: &[f32], seen: Box3, cells: Box3, iso: f32, inside: Inside) -> Vec<[i32; 3]> {
    let [nx, ny, _] = seen.size().map(|n| n as usize);
    let mut found = Vec::new();
    for k in cells.min[2]..cells.max[2] {
        for j in cells.min[1]..cells.max[1] {
            let start = seen.offset_of([cells.min[0], j, k]);
            let column = |at: usize| {
                [0, nx, nx * ny, nx * ny + nx]
                    .iter()
                    .filter(|&&step| inside.contains(values[at + step], iso))
                    .count()
            };
            let mut before = column(start);
            for i in cells.min[0]..cells.max[0] {
                let here = column(start + (i - cells.min[0]) as usize + 1);
                if !matches!(before + here, 0 | 8) {
                    found.push([i, j, k]);
                }
                before = here;
            }
        }
    }
    found
}
