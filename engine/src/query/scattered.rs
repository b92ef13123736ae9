//! Points in no order, visited block by block, so that each block is found and decoded once.
//!
//! Points are counted by the Morton order of their blocks (a counting sort, whose bins are blocks or
//! cubes of them). Where the numbers of all points do not fit the memory, ranges of bins take turns: the
//! points are gone through once for each, which costs far less than to decode blocks again.

use crate::budget::{Budget, Permit};
use crate::error::Result;
use crate::field::Field;
use crate::lattice::morton_encode;
use std::ops::Range;

/// Most bins, each of 4 bytes.
const BINS_BITS: u32 = 18;
pub(super) const BINS_BYTES: usize = size_of::<u32>() << BINS_BITS;
/// Bits of a Morton code that the blocks within a bin may differ in, and still all be held by a cursor.
const HELD_BITS: u32 = 3;
/// Of so many neighbours in the list, those that are looked at to see whether there is an order.
const PROBE: [usize; 2] = [4096, 512];

/// From points to places in the Morton order of the blocks of a field.
pub(super) struct BlockOrder {
    min: [f64; 3],
    /// BlockOrder along an index step.
    scale: f64,
    last: [u32; 3],
    /// Halvings that bring the number of blocks along an axis to what a Morton code holds.
    halvings: u32,
    /// Lowest bits of a Morton code that bins leave out.
    dropped: u32,
}

impl BlockOrder {
    pub(super) fn new(field: &dyn Field) -> BlockOrder {
        let (domain, edge) = (field.grid().domain, field.block_edge());
        let last = domain.size().map(|n| (n - 1) / edge);
        let most = last.into_iter().max().expect("three axes");
        let halvings = (u32::BITS - most.leading_zeros()).saturating_sub(21);
        let highest = morton_encode(last.map(|n| n >> halvings));
        BlockOrder {
            min: domain.min.map(f64::from),
            scale: 1.0 / f64::from(edge),
            last,
            halvings,
            dropped: (u64::BITS - highest.leading_zeros()).saturating_sub(BINS_BITS),
        }
    }

    /// Place of the block around an index position. Casts saturate: what is outside goes to a block at the
    /// border.
    #[inline]
    fn code(&self, index: [f64; 3]) -> u64 {
        morton_encode(std::array::from_fn(|a| {
            let block = ((index[a] - self.min[a]) * self.scale) as u32;
            block.min(self.last[a]) >> self.halvings
        }))
    }

    #[inline]
    fn bin(&self, index: [f64; 3]) -> usize {
        (self.code(index) >> self.dropped) as usize
    }

    fn bins(&self) -> usize {
        (morton_encode(self.last.map(|n| n >> self.halvings)) >> self.dropped) as usize + 1
    }

    /// Whether neighbours among `count` points seldom share a block.
    pub(super) fn are_scattered(&self, count: usize, place: impl Fn(usize) -> [f64; 3]) -> bool {
        let [stride, probe] = PROBE;
        let (mut jumps, mut seen) = (0, 0);
        for first in (0..count).step_by(stride) {
            let end = count.min(first + probe);
            let mut last = self.code(place(first));
            for n in first + 1..end {
                let code = self.code(place(n));
                jumps += usize::from(code != last);
                last = code;
            }
            seen += end - first;
        }
        jumps * 8 > seen
    }
}

/// Hands the numbers of `count` points (below 2^32) to `visit` in the order of their blocks, at most
/// `most` at a time.
///
/// # Errors
/// Those of `visit`, `BudgetExceeded`.
///
/// # Memory
/// 4 bytes for each of `most` numbers, and at most 1 MiB of counts.
pub(super) fn by_block(
    blocks: &BlockOrder,
    count: usize,
    most: usize,
    budget: &Budget,
    place: impl Fn(usize) -> [f64; 3],
    mut visit: impl FnMut(&[u32]) -> Result<()>,
) -> Result<()> {
    let most = most.min(count);
    let bytes = (blocks.bins() + most) * size_of::<u32>();
    let _permit: Permit = budget.take(bytes as u64, "the order of points")?;
    let mut ends = vec![0u32; blocks.bins()];
    for n in 0..count {
        ends[blocks.bin(place(n))] += 1;
    }
    let mut numbers = vec![0u32; most];
    let mut first = 0;
    while first < ends.len() {
        let bins = next_bins(&mut ends, first, most);
        first = bins.end;
        budget.check_cancelled()?;
        if bins.len() == 1 {
            // More than fits, maybe.
            let mut held = 0;
            for n in (0..count).filter(|&n| blocks.bin(place(n)) == bins.start) {
                numbers[held] = n as u32;
                held += 1;
                if held == most {
                    sort_within(blocks, &mut numbers, &place);
                    visit(&numbers)?;
                    held = 0;
                }
            }
            sort_within(blocks, &mut numbers[..held], &place);
            visit(&numbers[..held])?;
            continue;
        }
        for n in 0..count {
            let bin = blocks.bin(place(n));
            if bins.contains(&bin) {
                let at = &mut ends[bin];
                numbers[*at as usize] = n as u32;
                *at += 1;
            }
        }
        // Each bin's start has moved to its end.
        let mut start = 0;
        for &end in &ends[bins.clone()] {
            sort_within(blocks, &mut numbers[start..end as usize], &place);
            start = end as usize;
        }
        visit(&numbers[..start])?;
    }
    Ok(())
}

/// Bins from `first` on that hold at most `most` points together, at least one; their counts become the
/// places where they start.
fn next_bins(counts: &mut [u32], first: usize, most: usize) -> Range<usize> {
    let (mut end, mut sum) = (first, 0usize);
    while let Some(count) = counts.get_mut(end) {
        let with = sum + *count as usize;
        if end > first && with > most {
            break;
        }
        *count = sum as u32;
        (end, sum) = (end + 1, with);
    }
    first..end
}

/// Orders the points of a bin that holds more blocks than a cursor.
fn sort_within(blocks: &BlockOrder, numbers: &mut [u32], place: impl Fn(usize) -> [f64; 3]) {
    if blocks.dropped > HELD_BITS {
        numbers.sort_unstable_by_key(|&n| (blocks.code(place(n as usize)), n));
    }
}
