//! Isosurface extraction: which cells the surface crosses, what triangles it has there, and the
//! march from cell to cell.

mod extract;

pub use extract::{Boundary, Extract, Stats, extract};
