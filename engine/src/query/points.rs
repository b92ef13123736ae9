//! Values and gradients at many points.

use super::cursor::{Cursor, Method};
use super::parts::each_part_of;
use super::scattered::{BlockOrder, by_block};
use crate::budget::Budget;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::lattice::Affine;

/// Points that one thread takes at a time.
const PART: usize = 4096;
/// Most bytes of answers that wait for their places.
const ANSWERS_BYTES: usize = 2 << 20;
/// Points in no order that are fetched together.
const STAGE: usize = 256;

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
/// Points in no order are visited block by block: 4 bytes for each of as many at a time as two fifths of
/// the budget hold; a cursor per thread.
pub fn sample_points(
    field: &dyn Field,
    points: &[[f64; 3]],
    options: &Sampling,
    out: &mut [f32],
    budget: &Budget,
) -> Result<()> {
    let answer = Values {
        method: options.method,
        outside: options.outside,
    };
    at_points(field, points, options.space, out, budget, &answer)
}

/// Gradients at `points`, into `out`: per step of the coordinates that the points have.
///
/// # Errors
/// As [`sample_points`].
///
/// # Memory
/// As [`sample_points`].
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
    let answer = Slopes {
        method: options.method,
        outside: options.outside,
        rows,
    };
    at_points(field, points, options.space, out, budget, &answer)
}

/// What is asked at each point.
trait Answer<T>: Sync {
    /// Answers at `place(0)`, `place(1)` and so on, in index space.
    fn fill(
        &self,
        cursor: &mut Cursor<'_>,
        place: impl Fn(usize) -> [f64; 3],
        out: &mut [T],
    ) -> Result<()>;
}

struct Values {
    method: Method,
    outside: f32,
}

impl Answer<f32> for Values {
    fn fill(
        &self,
        cursor: &mut Cursor<'_>,
        place: impl Fn(usize) -> [f64; 3],
        out: &mut [f32],
    ) -> Result<()> {
        if self.method == Method::Trilinear {
            return cursor.trilinear(place, self.outside, out);
        }
        for (n, value) in out.iter_mut().enumerate() {
            *value = cursor.value(place(n), self.method)?.unwrap_or(self.outside);
        }
        Ok(())
    }
}

struct Slopes {
    method: Method,
    outside: f32,
    /// From index steps to steps of the coordinates.
    rows: [[f64; 3]; 3],
}

impl Answer<[f32; 3]> for Slopes {
    fn fill(
        &self,
        cursor: &mut Cursor<'_>,
        place: impl Fn(usize) -> [f64; 3],
        out: &mut [[f32; 3]],
    ) -> Result<()> {
        for (n, slope) in out.iter_mut().enumerate() {
            *slope = match cursor.gradient(place(n), self.method)? {
                Some(g) => {
                    let g = g.map(f64::from);
                    self.rows
                        .map(|r| (r[0] * g[0] + r[1] * g[1] + r[2] * g[2]) as f32)
                }
                None => [self.outside; 3],
            };
        }
        Ok(())
    }
}

fn at_points<T: Copy + Default + Send>(
    field: &dyn Field,
    points: &[[f64; 3]],
    space: Space,
    out: &mut [T],
    budget: &Budget,
    answer: &impl Answer<T>,
) -> Result<()> {
    if points.len() != out.len() {
        return Err(Error::bad_input(format!(
            "room for {} answers at {} points",
            out.len(),
            points.len()
        )));
    }
    match space {
        Space::Index => at_places(field, points, |p| p, out, budget, answer),
        Space::World => {
            let map = field.grid().index_to_world.inverse()?;
            at_places(field, points, |p| map.apply(p), out, budget, answer)
        }
    }
}

fn at_places<T: Copy + Default + Send>(
    field: &dyn Field,
    points: &[[f64; 3]],
    place: impl Fn([f64; 3]) -> [f64; 3] + Sync,
    out: &mut [T],
    budget: &Budget,
    answer: &impl Answer<T>,
) -> Result<()> {
    let order = BlockOrder::new(field, budget);
    // Numbers of points have 32 bits.
    let chunks = points
        .chunks(u32::MAX as usize)
        .zip(out.chunks_mut(u32::MAX as usize));
    for (points, out) in chunks {
        let at = |n: usize| place(points[n]);
        if !order.are_scattered(points.len(), at) {
            each_part_of(out, PART, budget, field, |cursor, first, part| {
                answer.fill(cursor, |n| at(first + n), part)
            })?;
            continue;
        }
        let share = budget.free_bytes().min(budget.memory_bytes() / 5 * 2) as usize;
        let answers =
            (ANSWERS_BYTES.min(share / 4) / size_of::<T>()).clamp(PART, points.len().max(PART));
        let _permit = budget.take((answers * size_of::<T>()) as u64, "a batch of answers")?;
        let numbers = (share - share / 4) / size_of::<u32>();
        let most = numbers.saturating_sub(order.bins()).max(PART);
        let mut values = vec![T::default(); answers];
        by_block(&order, points.len(), most, budget, at, |numbers| {
            for numbers in numbers.chunks(answers) {
                let values = &mut values[..numbers.len()];
                each_part_of(values, PART, budget, field, |cursor, first, part| {
                    // Points are fetched together: single ones would each wait for memory.
                    let mut staged = [[0.0; 3]; STAGE];
                    let numbers = numbers[first..][..part.len()].chunks(STAGE);
                    for (numbers, part) in numbers.zip(part.chunks_mut(STAGE)) {
                        for (to, &n) in staged.iter_mut().zip(numbers) {
                            *to = points[n as usize];
                        }
                        answer.fill(cursor, |n| place(staged[n]), part)?;
                    }
                    Ok(())
                })?;
                for (&n, &value) in numbers.iter().zip(&*values) {
                    out[n as usize] = value;
                }
            }
            Ok(())
        })?;
    }
    Ok(())
}
