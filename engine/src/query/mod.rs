//! Questions to a field: samples between lattice points, bricks of a region one after another,
//! statistics, cells of an isovalue, planes and rays.
//!
//! Everything here knows only [`Field`](crate::Field), so it works the same on a file, a formula and
//! an array; a coarser level of a volume is a field of its own. Answers do not depend on the number
//! of threads, the size of caches or the order of points. The rules for borders and NaN are in
//! `docs/conventions.md`.

mod active;
mod again;
mod blocks;
mod cubic;
mod cursor;
mod ordered;
mod parts;
mod plane;
mod points;
mod ray;
mod reach;
mod scattered;
mod statistics;
mod stream;
#[cfg(test)]
mod tests;
mod weights;

pub use active::active_cells;
pub use again::{TakePoints, are_scattered, sample_gradients_again, sample_points_again};
pub use cursor::{Cursor, Method};
pub use plane::{Plane, sample_plane};
pub use points::{Sampling, Space, sample_gradients, sample_points};
pub use ray::{Crossing, Integral, Peak, Ray, Rays};
pub use statistics::{Bins, Histogram, Statistics, histogram, statistics};
pub use stream::{Brick, BrickSamples, Bricks, bricks_of};
