//! Statistics and histogram of a region: every sample counts, those of constant nodes without being
//! read.

use super::blocks::{Block, Blocks};
use super::ordered::{AHEAD, in_order};
use super::stream::{ahead, check_region};
use crate::budget::Budget;
use crate::error::{Error, Result};
use crate::field::{Field, Range, Samples};
use crate::lattice::Box3;

/// Most bins of a histogram.
const BINS_MAX: usize = 1 << 24;

/// What is known of the values of a region.
///
/// Sums are formed in double precision, brick by brick, and joined in Morton order, so that they have
/// the same bits whatever the number of threads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Statistics {
    /// Samples.
    pub count: u64,
    /// Samples that are NaN.
    pub nan: u64,
    /// Samples that are infinite. They count for the smallest and largest value, not for the mean.
    pub infinite: u64,
    /// Smallest and largest value, NaN aside.
    pub range: Range,
    /// Mean of the finite values; NaN when there are none.
    pub mean: f64,
    /// Standard deviation of the finite values (over their number); NaN when there are none.
    pub deviation: f64,
}

/// What a brick adds.
#[derive(Clone, Copy)]
struct Part {
    nan: u64,
    infinite: u64,
    finite: u64,
    range: Range,
    mean: f64,
    /// Sum of the squared distances to the mean.
    squares: f64,
}

impl Part {
    const EMPTY: Part = Part {
        nan: 0,
        infinite: 0,
        finite: 0,
        range: Range::EMPTY,
        mean: 0.0,
        squares: 0.0,
    };

    fn constant(value: f32, count: u64) -> Part {
        let mut part = Part::of(&[value]);
        (part.nan, part.infinite, part.finite) =
            (part.nan * count, part.infinite * count, part.finite * count);
        part
    }

    fn of(values: &[f32]) -> Part {
        let mut part = Part {
            range: Range::of_slice(values),
            ..Part::EMPTY
        };
        let finite = || {
            values
                .iter()
                .filter(|v| v.is_finite())
                .map(|&v| f64::from(v))
        };
        part.nan = values.iter().filter(|v| v.is_nan()).count() as u64;
        part.finite = finite().count() as u64;
        part.infinite = values.len() as u64 - part.nan - part.finite;
        if part.finite > 0 {
            part.mean = finite().sum::<f64>() / part.finite as f64;
            part.squares = finite().map(|v| (v - part.mean).powi(2)).sum();
        }
        part
    }

    /// Chan, Golub and LeVeque 1983.
    fn join(self, other: Part) -> Part {
        let (n, m) = (self.finite as f64, other.finite as f64);
        let mut joined = Part {
            nan: self.nan + other.nan,
            infinite: self.infinite + other.infinite,
            finite: self.finite + other.finite,
            range: self.range.union(other.range),
            ..self
        };
        if other.finite > 0 {
            let step = other.mean - self.mean;
            joined.mean = self.mean + step * (m / (n + m));
            joined.squares = self.squares + other.squares + step * step * (n * m / (n + m));
        }
        joined
    }
}

/// Statistics of the samples of `region`.
///
/// # Errors
/// When `region` is not inside the domain, what the field reports, `Cancelled`.
///
/// # Memory
/// A brick a thread.
pub fn statistics(field: &dyn Field, region: Box3, budget: &Budget) -> Result<Statistics> {
    let mut all = Part::EMPTY;
    by_blocks(
        field,
        region,
        ahead(field, budget),
        budget,
        |block, values| match block.constant {
            Some(value) => Part::constant(value, block.region.count()),
            None => Part::of(values),
        },
        |part| all = all.join(part),
    )?;
    let known = |v: f64| if all.finite > 0 { v } else { f64::NAN };
    Ok(Statistics {
        count: region.count(),
        nan: all.nan,
        infinite: all.infinite,
        range: all.range,
        mean: known(all.mean),
        deviation: known((all.squares / all.finite as f64).sqrt()),
    })
}

/// Equal intervals from `low` to `high`. A value belongs to the interval that starts at or below it;
/// `high` itself to the last one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bins {
    /// Start of the first bin.
    pub low: f64,
    /// End of the last bin.
    pub high: f64,
    /// Number of bins, at most 2^24.
    pub count: usize,
}

/// How many samples have values in each bin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Histogram {
    /// Samples in each bin.
    pub counts: Vec<u64>,
    /// Samples below the first bin.
    pub below: u64,
    /// Samples above the last bin.
    pub above: u64,
    /// Samples that are NaN.
    pub nan: u64,
}

impl Bins {
    /// The bin of a value: 0 for below, from 1 on, `count + 1` for above, `count + 2` for NaN.
    #[inline]
    fn slot(&self, value: f32) -> usize {
        let value = f64::from(value);
        if value.is_nan() {
            self.count + 2
        } else if value < self.low {
            0
        } else if value > self.high {
            self.count + 1
        } else {
            let at = (value - self.low) / (self.high - self.low) * self.count as f64;
            1 + (at as usize).min(self.count - 1)
        }
    }
}

/// Counts the samples of `region` by value.
///
/// # Errors
/// Bins that are none, a `region` that is not inside the domain, what the field reports, `Cancelled`.
///
/// # Memory
/// A brick, and 4 bytes a bin, a thread.
pub fn histogram(
    field: &dyn Field,
    region: Box3,
    bins: &Bins,
    budget: &Budget,
) -> Result<Histogram> {
    let span = bins.high - bins.low;
    let makes_sense = span > 0.0 && span.is_finite() && (1..=BINS_MAX).contains(&bins.count);
    if !makes_sense {
        return Err(Error::bad_input(format!(
            "a histogram of {} bins from {} to {}: from 1 to {BINS_MAX} bins, and a finite range",
            bins.count, bins.low, bins.high
        )));
    }
    let slots = bins.count + 3;
    // Counts of many bins are larger than the blocks that they come from.
    let waiting = ahead(field, budget).min(AHEAD * budget.threads());
    let bytes = slots as u64 * (8 + 4 * waiting as u64);
    let _permit = budget.take(bytes, "the bins of a histogram")?;
    let mut all = vec![0u64; slots];
    by_blocks(
        field,
        region,
        waiting,
        budget,
        |block, values| match block.constant {
            Some(value) => Counted::Same(bins.slot(value), block.region.count()),
            None => {
                let mut counts = vec![0u32; slots];
                values.iter().for_each(|&v| counts[bins.slot(v)] += 1);
                Counted::Each(counts)
            }
        },
        |counted| match counted {
            Counted::Same(slot, count) => all[slot] += count,
            Counted::Each(counts) => {
                for (sum, n) in all.iter_mut().zip(counts) {
                    *sum += u64::from(n);
                }
            }
        },
    )?;
    Ok(Histogram {
        counts: all[1..=bins.count].to_vec(),
        below: all[0],
        above: all[bins.count + 1],
        nan: all[bins.count + 2],
    })
}

enum Counted {
    Same(usize, u64),
    /// A block has at most 2^15 samples.
    Each(Vec<u32>),
}

/// `look` at each block of `region`, and at its samples where they are not of one value; the results
/// to `join` in Morton order; at most `waiting` of them are made and not joined.
fn by_blocks<T: Send>(
    field: &dyn Field,
    region: Box3,
    waiting: usize,
    budget: &Budget,
    look: impl Fn(&Block, &[f32]) -> T + Sync,
    mut join: impl FnMut(T),
) -> Result<()> {
    check_region(field, region)?;
    let mut blocks = Blocks::new(field, region, |_: &Range| true);
    blocks.whole = true;
    in_order(
        budget,
        waiting,
        || blocks.next(),
        |block| {
            if block.constant.is_some() {
                return Ok(look(&block, &[]));
            }
            let region = block.region;
            let _permit = budget.take(region.count() * 4, "a brick of a region")?;
            let mut values = vec![0.0; region.count() as usize];
            field.read(region, &mut Samples::dense(&mut values, region))?;
            Ok(look(&block, &values))
        },
        |part| {
            join(part);
            Ok(())
        },
    )
}
