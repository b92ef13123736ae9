//! Sparse out-of-core volumes: a bricked octree in a checksummed file, read through a cache with a
//! hard byte budget, and exact closed isosurfaces by surface-following marching cubes.
//!
//! The words: a [`Field`] gives samples for a box and a conservative range for a box; a
//! [`MeshSink`] takes a mesh while it is made; a [`Budget`] bounds memory and threads.

pub mod budget;
mod cpu;
pub mod error;
pub mod field;
pub mod iso;
pub mod lattice;
pub mod mesh;
pub mod model;
pub mod query;
pub mod raw_file;
pub mod redistance;
pub mod refine;
pub mod sample;
pub mod store;

pub use budget::{Budget, CancelToken, Permit, Progress};
pub use error::{Error, ErrorKind, Result};
pub use field::{Field, Range, Samples};
pub use lattice::{Affine, Box3, Grid, Units};
pub use mesh::{Mesh, MeshSink};
pub use sample::{Inside, Kind, SampleType};
