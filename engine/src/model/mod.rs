//! Implicit models: a tree of shapes, booleans and blends as a [`Field`](crate::Field), at any
//! resolution.
//!
//! A [`Shape`] says what the solid is. [`Model`] turns it into one list of scalar operations and
//! evaluates that over rows of points, brick by brick; what cannot matter inside a brick is left
//! out first, so the work grows with the surface and with what is near it.
//!
//! ```
//! use brickmarch::model::{Boolean, Model, Primitive, Shape};
//! use brickmarch::{Field, Units};
//! let ball = Shape::Primitive(Primitive::Sphere { radius: 1.0 });
//! let part = Shape::Boolean(Boolean::Difference, vec![ball.clone(), ball.moved([0.8, 0.0, 0.0])]);
//! let grid = Model::lattice([[-1.1; 3], [1.1; 3]], 0.05, Units::Unknown).unwrap();
//! let model = Model::new(&part, grid).unwrap();
//! assert!(model.value([-0.9, 0.0, 0.0]).unwrap() < 0.0); // inside
//! assert!(model.value([0.5, 0.0, 0.0]).unwrap() > 0.0); // cut away
//! assert!(model.range(model.grid().domain).unwrap().min < 0.0);
//! ```

mod attribute;
mod blend;
mod build;
mod combine;
mod expression;
mod field;
mod graph;
mod interval;
mod listing;
mod near;
mod number;
mod oracle;
mod planes;
mod primitive;
mod profile;
mod sampled;
mod shape;
mod slope;
mod tape;
#[cfg(test)]
mod tests;
mod transform;

pub use attribute::AttributeField;
pub use expression::{Expression, FUNCTIONS};
pub use field::{Evaluated, Model};
pub use near::NearSurface;
pub use profile::Profile;
pub use sampled::Sampled;
pub use shape::{Blend, Boolean, Convention, Convert, Periodic, Primitive, Shape, Transform};
