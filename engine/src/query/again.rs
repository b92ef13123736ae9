//! Values and gradients at points that need not fit the memory: they are read from their source once for
//! every range of blocks that takes its turn.

use super::points::{Sampling, Space, sample_gradients, sample_points};
use super::scattered::{BlockOrder, next_bins};
use crate::budget::Budget;
use crate::error::{Error, Result};
use crate::field::Field;

/// Takes points, some at a time.
pub type TakePoints<'a> = dyn FnMut(&[[f64; 3]]) -> Result<()> + 'a;

/// Whether neighbours in a list of points seldom lie in the same block, so that
/// [`sample_points_again`] pays.
///
/// # Errors
/// A map without an inverse.
pub fn are_scattered(
    field: &dyn Field,
    points: &[[f64; 3]],
    space: Space,
    budget: &Budget,
) -> Result<bool> {
    let place = place_of(field, space)?;
    Ok(BlockOrder::new(field, budget).are_scattered(points.len(), |n| place(points[n])))
}

/// What [`sample_points`] gives at the points that `read(take)` hands to `take`, all of them in the same
/// order each time. Blocks are visited one after another, and decoded about once, however many points
/// there are.
///
/// # Errors
/// As [`sample_points`], of `read`, another number of points than `out` has room for.
///
/// # Memory
/// An eighth of the budget for points that are sorted, a sixty-fourth to count them; for those of the
/// eighth what [`sample_points`] takes.
pub fn sample_points_again(
    field: &dyn Field,
    read: impl FnMut(&mut TakePoints<'_>) -> Result<()>,
    options: &Sampling,
    out: &mut [f32],
    budget: &Budget,
) -> Result<()> {
    again(field, read, options.space, out, budget, |points, values| {
        sample_points(field, points, options, values, budget)
    })
}

/// The same for gradients, see [`sample_gradients`].
///
/// # Errors
/// As [`sample_points_again`].
///
/// # Memory
/// As [`sample_points_again`].
pub fn sample_gradients_again(
    field: &dyn Field,
    read: impl FnMut(&mut TakePoints<'_>) -> Result<()>,
    options: &Sampling,
    out: &mut [[f32; 3]],
    budget: &Budget,
) -> Result<()> {
    again(field, read, options.space, out, budget, |points, slopes| {
        sample_gradients(field, points, options, slopes, budget)
    })
}

fn again<T: Copy + Default>(
    field: &dyn Field,
    mut read: impl FnMut(&mut TakePoints<'_>) -> Result<()>,
    space: Space,
    out: &mut [T],
    budget: &Budget,
    answer: impl Fn(&[[f64; 3]], &mut [T]) -> Result<()>,
) -> Result<()> {
    let place = place_of(field, space)?;
    let order = BlockOrder::new(field, budget);
    let each = size_of::<[f64; 3]>() + size_of::<usize>() + size_of::<T>();
    let share = (budget.free_bytes() / 2).min(budget.memory_bytes() / 8) as usize;
    let most = (share / each).clamp(1, out.len().max(1));
    let bytes = most * each + order.bins() * size_of::<u64>();
    let _permit = budget.take(bytes as u64, "points in the order of their blocks")?;

    let mut counts = vec![0u64; order.bins()];
    let mut count = 0;
    read(&mut |points| {
        for &p in points {
            counts[order.bin(place(p))] += 1;
        }
        count += points.len();
        Ok(())
    })?;
    if count != out.len() {
        return Err(Error::bad_input(format!(
            "room for {} answers at {count} points",
            out.len()
        )));
    }

    let mut held: Vec<[f64; 3]> = Vec::with_capacity(most);
    let mut numbers = Vec::with_capacity(most);
    let mut answers = vec![T::default(); most];
    let mut first = 0;
    while first < counts.len() {
        let mut flush = |held: &mut Vec<[f64; 3]>, numbers: &mut Vec<usize>| -> Result<()> {
            let answers = &mut answers[..held.len()];
            answer(held, answers)?;
            for (&n, &value) in numbers.iter().zip(&*answers) {
                out[n] = value;
            }
            held.clear();
            numbers.clear();
            Ok(())
        };
        let bins = next_bins(&counts, first, most as u64);
        first = bins.end;
        let mut n = 0;
        read(&mut |points| {
            for &p in points {
                // The points of a single bin may be more than fit.
                if n < count && bins.contains(&order.bin(place(p))) {
                    if held.len() == most {
                        flush(&mut held, &mut numbers)?;
                    }
                    held.push(p);
                    numbers.push(n);
                }
                n += 1;
            }
            Ok(())
        })?;
        flush(&mut held, &mut numbers)?;
        if n != count {
            return Err(Error::bad_input(format!(
                "{count} points became {n} when they were read again"
            )));
        }
    }
    Ok(())
}

/// From coordinates to places in index space.
fn place_of(field: &dyn Field, space: Space) -> Result<impl Fn([f64; 3]) -> [f64; 3]> {
    let map = match space {
        Space::Index => None,
        Space::World => Some(field.grid().index_to_world.inverse()?),
    };
    Ok(move |p| map.as_ref().map_or(p, |map| map.apply(p)))
}
