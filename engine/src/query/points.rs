//! Values and gradients at many points.

use super::cursor::{Cursor, Method};
use crate::budget::Budget;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::lattice::{Affine, morton_encode};
use std::sync::Mutex;

/// Bits of a sort key that number the points of a batch; the rest is the place of the block.
const NUMBER_BITS: u32 = 22;
/// Points that one thread takes at a time.
const PART: usize = 4096;

/// What coordinates mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Space {
    /// Steps of the lattice.
    Index,
    /// Through the grid's map from index to world.
    #[default]
    World,
}

/// How points are read.
#[derive(Clone, Copy, Debug)]
pub struct Sampling {
    /// Between lattice points.
    pub method: Method,
    /// What the coordinates of points, and of gradients, mean.
    pub space: Space,
    /// Value outside of the first and last samples.
    pub outside: f32,
}

impl Default for Sampling {
    /// Trilinear, world, NaN outside.
    fn default() -> Self {
        Self {
            method: Method::default(),
            space: Space::default(),
            outside: f32::NAN,
        }
    }
}

/// Values at `points`, into `out`.
///
/// # Errors
/// An `out` of another length, a map without an inverse, what the field reports, `Cancelled`.
///
/// # Memory
/// Points in no order are visited block by block: 12 bytes for each of at most 4 million at a time,
/// fewer in a small budget; a cursor per thread.
pub fn sample_points(
    field: &dyn Field,
    points: &[[f64; 3]],
    options: &Sampling,
    out: &mut [f32],
    budget: &Budget,
) -> Result<()> {
    let outside = options.outside;
    at_points(field, points, options.space, out, budget, |cursor, p| {
        Ok(cursor.value(p, options.method)?.unwrap_or(outside))
    })
}

/// Gradients at `points`, into `out`: per step of the coordinates that the points have.
///
/// # Errors
/// As [`sample_points`].
///
/// # Memory
/// As [`sample_points`], with 20 bytes for a point.
pub fn sample_gradients(
    field: &dyn Field,
    points: &[[f64; 3]],
    options: &Sampling,
    out: &mut [[f32; 3]],
    budget: &Budget,
) -> Result<()> {
    let rows = match options.space {
        Space::Index => Affine::IDENTITY.gradient_rows(),
        Space::World => field.grid().index_to_world.gradient_rows(),
    };
    at_points(field, points, options.space, out, budget, |cursor, p| {
        let Some(g) = cursor.gradient(p, options.method)? else {
            return Ok([options.outside; 3]);
        };
        let g = g.map(f64::from);
        Ok(rows.map(|r| (r[0] * g[0] + r[1] * g[1] + r[2] * g[2]) as f32))
    })
}

fn at_points<T: Copy + Default + Send>(
    field: &dyn Field,
    points: &[[f64; 3]],
    space: Space,
    out: &mut [T],
    budget: &Budget,
    ask: impl Fn(&mut Cursor<'_>, [f64; 3]) -> Result<T> + Sync,
) -> Result<()> {
    if points.len() != out.len() {
        return Err(Error::bad_input(format!(
            "room for {} answers at {} points",
            out.len(),
            points.len()
        )));
    }
    let to_index = match space {
        Space::Index => None,
        Space::World => Some(field.grid().index_to_world.inverse()?),
    };
    let place = |p: [f64; 3]| to_index.map_or(p, |map| map.apply(p));
    let each = (8 + size_of::<T>()) as u64;
    let share = budget.free_bytes().min(budget.memory_bytes() / 5 * 2) / each;
    let batch = (share as usize).clamp(PART, 1 << NUMBER_BITS);
    for (points, out) in points.chunks(batch).zip(out.chunks_mut(batch)) {
        let _permit = budget.take(points.len() as u64 * each, "a batch of points")?;
        let keys = order(field, points, &place);
        match keys {
            None => each_part(out, budget, field, |cursor, first, part| {
                for (value, &p) in part.iter_mut().zip(&points[first..]) {
                    *value = ask(cursor, place(p))?;
                }
                Ok(())
            })?,
            Some(keys) => {
                let number = |key: u64| (key & ((1 << NUMBER_BITS) - 1)) as usize;
                let mut values = vec![T::default(); points.len()];
                each_part(&mut values, budget, field, |cursor, first, part| {
                    for (value, &key) in part.iter_mut().zip(&keys[first..]) {
                        *value = ask(cursor, place(points[number(key)]))?;
                    }
                    Ok(())
                })?;
                for (&key, value) in keys.iter().zip(values) {
                    out[number(key)] = value;
                }
            }
        }
    }
    Ok(())
}

/// Numbers of the points, sorted by the Morton order of their blocks; `None` where neighbours in the
/// list mostly share a block already.
fn order(
    field: &dyn Field,
    points: &[[f64; 3]],
    place: &impl Fn([f64; 3]) -> [f64; 3],
) -> Option<Vec<u64>> {
    let (min, edge) = (field.grid().domain.min, f64::from(field.block_edge()));
    let block = |&p: &[f64; 3]| {
        let index = place(p);
        // Casts saturate: what is outside goes to the first or the last block.
        morton_encode(std::array::from_fn(|a| {
            ((index[a] - f64::from(min[a])) / edge) as u32
        }))
    };
    let mut keys: Vec<u64> = points.iter().map(block).collect();
    let jumps = keys.windows(2).filter(|pair| pair[0] != pair[1]).count();
    if jumps * 8 <= points.len() {
        return None;
    }
    for (n, key) in keys.iter_mut().enumerate() {
        *key = *key << NUMBER_BITS | n as u64;
    }
    keys.sort_unstable();
    Some(keys)
}

/// Fills `out` on the threads of the budget: `fill(cursor, place of the part, part)`.
pub(super) fn each_part<T: Send>(
    out: &mut [T],
    budget: &Budget,
    field: &dyn Field,
    fill: impl Fn(&mut Cursor<'_>, usize, &mut [T]) -> Result<()> + Sync,
) -> Result<()> {
    each_part_of(out, PART, budget, field, fill)
}

/// The same with parts of `size`.
pub(super) fn each_part_of<T: Send>(
    out: &mut [T],
    size: usize,
    budget: &Budget,
    field: &dyn Field,
    fill: impl Fn(&mut Cursor<'_>, usize, &mut [T]) -> Result<()> + Sync,
) -> Result<()> {
    let count = out.len().div_ceil(size);
    let parts = Mutex::new(out.chunks_mut(size).enumerate());
    let failed: Mutex<Option<(usize, Error)>> = Mutex::new(None);
    let work = |cursor: &mut Cursor<'_>| {
        loop {
            let next = parts.lock().expect("no holder panics").next();
            let Some((n, part)) = next else { break };
            let done = budget
                .check_cancelled()
                .and_then(|()| fill(cursor, n * size, part));
            if let Err(e) = done {
                // Of several errors that of the first part is told. The rest is left undone.
                let mut failed = failed.lock().expect("no holder panics");
                if failed.as_ref().is_none_or(|(at, _)| n < *at) {
                    *failed = Some((n, e));
                }
                parts
                    .lock()
                    .expect("no holder panics")
                    .by_ref()
                    .for_each(drop);
                break;
            }
        }
    };
    let mut own = Cursor::new(field, budget)?;
    std::thread::scope(|scope| {
        for _ in 1..budget.threads().min(count) {
            // Threads for which there is no memory are done without.
            let Ok(mut cursor) = Cursor::new(field, budget) else {
                break;
            };
            let work = &work;
            scope.spawn(move || work(&mut cursor));
        }
        work(&mut own);
    });
    match failed.into_inner().expect("no holder panics") {
        Some((_, error)) => Err(error),
        None => Ok(()),
    }
}
