//! What a formula cannot say: outlines, sampled data.

use super::interval::Interval;
use crate::error::Result;

/// A function of a point with conservative ranges of its values and of its derivatives.
pub(super) trait Oracle: Send + Sync + std::fmt::Debug {
    /// Values at points given by their three coordinates.
    fn values(&self, point: [&[f64]; 3], out: &mut [f64]) -> Result<()>;

    /// A range of the values over a box.
    fn range(&self, cube: [Interval; 3]) -> Result<Interval>;

    /// Ranges of the partial derivatives over a box; the derivatives where the box is a point.
    fn slopes(&self, cube: [Interval; 3]) -> Result<[Interval; 3]>;

    /// How far rounding may move a value in a box from the exact one.
    fn rounding(&self, cube: [Interval; 3]) -> Result<f64>;
}
