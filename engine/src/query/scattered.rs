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

/// Most bits of the number of a bin.
const BINS_BITS: u32 = 18;
/// Bits of a Morton code that the blocks within a bin may differ in, and still all be held by a cursor.
const HELD_BITS: u32 = 3;
/// Most bits of a place along an axis that are told apart by bins.
const AXIS_BITS: u32 = 12;
/// Of so many neighbours in the list, those that are looked at to see whether there is an order.
const PROBE: [usize; 2] = [4096, 512];

/// From points to places in the Morton order of the blocks of a field.
pub(super) struct BlockOrder {
    min: [f64; 3],
    /// Blocks along an index step.
    scale: f64,
    last: [u32; 3],
    /// Halvings that bring the number of blocks along an axis to what a Morton code holds.
    halvings: u32,
    axes: [Axis; 3],
    bins: usize,
    /// Whether a bin may be more than what a cursor holds.
    coarse: bool,
}

/// What a place along an axis adds to the number of a bin.
struct Axis {
    min: f64,
    scale: f64,
    parts: Vec<u32>,
}

impl BlockOrder {
    /// The order of the blocks of `field`, in bins whose counts take a small part of the budget.
    pub(super) fn new(field: &dyn Field, budget: &Budget) -> BlockOrder {
        let (domain, edge) = (field.grid().domain, field.block_edge());
        let last = domain.size().map(|n| (n - 1) / edge);
        let bits = |n: u64| u64::BITS - n.leading_zeros();
        let most = last.into_iter().max().expect("three axes");
        let halvings = bits(most.into()).saturating_sub(21);
        let highest = morton_encode(last.map(|n| n >> halvings));
        let counts = budget.memory_bytes() / 64 / size_of::<u64>() as u64;
        let dropped = bits(highest).saturating_sub(BINS_BITS.min(bits(counts)));
        let min = domain.min.map(f64::from);
        let scale = 1.0 / f64::from(edge);
        let cut = last.map(|n| bits(n.into()).saturating_sub(AXIS_BITS));
        let axes = [0, 1, 2].map(|a| Axis {
            min: min[a],
            scale: scale / f64::from(1u32 << cut[a]),
            parts: (0..=last[a] >> cut[a])
                .map(|n| {
                    let mut place = [0; 3];
                    place[a] = n << cut[a] >> halvings;
                    (morton_encode(place) >> dropped) as u32
                })
                .collect(),
        });
        BlockOrder {
            min,
            scale,
            last,
            halvings,
            axes,
            bins: (highest >> dropped) as usize + 1,
            coarse: dropped > HELD_BITS || halvings > 0 || cut.into_iter().any(|n| n > 1),
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

    /// Number of the bin of an index position.
    #[inline]
    pub(super) fn bin(&self, index: [f64; 3]) -> usize {
        let part = |a: usize| {
            let axis = &self.axes[a];
            let place = ((index[a] - axis.min) * axis.scale) as u32 as usize;
            axis.parts[place.min(axis.parts.len() - 1)]
        };
        (part(0) | part(1) | part(2)) as usize
    }

    /// Number of bins.
    pub(super) fn bins(&self) -> usize {
        self.bins
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
/// 4 bytes for each of `most` numbers, and for each bin.
pub(super) fn by_block(
    order: &BlockOrder,
    count: usize,
    most: usize,
    budget: &Budget,
    place: impl Fn(usize) -> [f64; 3],
    mut visit: impl FnMut(&[u32]) -> Result<()>,
) -> Result<()> {
    let most = most.min(count);
    let bytes = (order.bins() + most) * size_of::<u32>();
    let _permit: Permit = budget.take(bytes as u64, "the order of points")?;
    let mut ends = vec![0u32; order.bins()];
    for n in 0..count {
        ends[order.bin(place(n))] += 1;
    }
    let mut numbers = vec![0u32; most];
    let mut first = 0;
    while first < ends.len() {
        let bins = next_bins(&ends, first, most as u64);
        first = bins.end;
        budget.check_cancelled()?;
        if bins.len() == 1 {
            // More than fits, maybe.
            let mut held = 0;
            for n in (0..count).filter(|&n| order.bin(place(n)) == bins.start) {
                numbers[held] = n as u32;
                held += 1;
                if held == most {
                    sort_within(order, &mut numbers, &place);
                    visit(&numbers)?;
                    held = 0;
                }
            }
            sort_within(order, &mut numbers[..held], &place);
            visit(&numbers[..held])?;
            continue;
        }
        // Counts become the places where the bins start.
        let mut sum = 0;
        for end in &mut ends[bins.clone()] {
            sum += std::mem::replace(end, sum);
        }
        for n in 0..count {
            let bin = order.bin(place(n));
            if bins.contains(&bin) {
                let at = &mut ends[bin];
                numbers[*at as usize] = n as u32;
                *at += 1;
            }
        }
        // Each bin's start has moved to its end.
        let mut start = 0;
        for &end in &ends[bins.clone()] {
            sort_within(order, &mut numbers[start..end as usize], &place);
            start = end as usize;
        }
        visit(&numbers[..start])?;
    }
    Ok(())
}

/// Bins from `first` on that hold at most `most` points together; at least one.
pub(super) fn next_bins<N: Copy + Into<u64>>(
    counts: &[N],
    first: usize,
    most: u64,
) -> Range<usize> {
    let mut left = most;
    let fits = |&count: &N| {
        let enough = count.into() <= left;
        left = left.saturating_sub(count.into());
        enough
    };
    let number = counts[first..].iter().copied().take_while(fits).count();
    first..first + number.max(1)
}

/// Orders the points of a bin that holds more blocks than a cursor.
fn sort_within(order: &BlockOrder, numbers: &mut [u32], place: impl Fn(usize) -> [f64; 3]) {
    if order.coarse {
        numbers.sort_unstable_by_key(|&n| (order.code(place(n as usize)), n));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::FromFn;
    use crate::{Box3, Grid, Kind, Range as Values};

    fn field(size: [u32; 3]) -> impl Field {
        let domain = Box3::new(
            [-7, 0, 11],
            [0, 1, 2].map(|a| [-7, 0, 11][a] + size[a] as i32),
        );
        FromFn::new(
            Grid::new(domain),
            Kind::Density,
            |_| 0.0,
            |_| Values::UNKNOWN,
        )
    }

    /// Points all over a box and somewhat beyond it, half of them in its lowest blocks.
    fn points(size: [u32; 3]) -> Vec<[f64; 3]> {
        let mut seed = 9u64;
        let mut next = move || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..6000)
            .map(|n| {
                let part = if n % 2 == 0 { 1.1 } else { 1e-3 };
                std::array::from_fn(|a| {
                    [-7.0, 0.0, 11.0][a] + (next() - 0.02) * part * f64::from(size[a])
                })
            })
            .collect()
    }

    #[test]
    fn every_point_comes_once_and_blocks_one_after_another() {
        let budget = Budget::mib(4);
        for size in [[300, 200, 100], [9, 3, 1], [1 << 30, 5, 70], [100_000; 3]] {
            let field = field(size);
            let order = BlockOrder::new(&field, &budget);
            let points = points(size);
            for most in [6000, 700, 1] {
                let mut seen = vec![0; points.len()];
                let mut codes = Vec::new();
                by_block(
                    &order,
                    points.len(),
                    most,
                    &budget,
                    |n| points[n],
                    |numbers| {
                        assert!(numbers.len() <= most);
                        for &n in numbers {
                            seen[n as usize] += 1;
                            codes.push(order.code(points[n as usize]));
                        }
                        Ok(())
                    },
                )
                .expect("fits");
                assert!(seen.iter().all(|&n| n == 1), "{size:?} {most}");
                // Within a bin of few blocks, which a cursor holds together, they may take turns.
                let held = |code: u64| {
                    if order.coarse {
                        code
                    } else {
                        code >> HELD_BITS
                    }
                };
                // A bin that did not fit is sorted part by part.
                if most == 6000 {
                    assert!(codes.is_sorted_by_key(|&c| held(c)), "{size:?}");
                }
            }
            assert_eq!(budget.used_bytes(), 0);
        }
    }

    #[test]
    fn bins_follow_the_morton_order_and_stay_below_their_number() {
        for size in [
            [300, 200, 100],
            [9, 3, 1],
            [1 << 30, 5, 70],
            [1 << 24, 1 << 24, 1 << 24],
        ] {
            let order = BlockOrder::new(&field(size), &Budget::mib(64));
            let mut points = points(size);
            points.push([f64::NAN; 3]);
            points.push([f64::INFINITY; 3]);
            assert!(points.iter().all(|&p| order.bin(p) < order.bins()));
            points.retain(|p| !p[0].is_nan());
            points.sort_by_key(|&p| order.code(p));
            let orders = points
                .windows(2)
                .filter(|w| order.bin(w[0]) > order.bin(w[1]))
                .count();
            assert_eq!(orders, 0, "{size:?}");
        }
    }
}
