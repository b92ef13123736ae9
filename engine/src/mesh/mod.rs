//! Triangle meshes: the mesh in memory, and sinks that take one while it is made.

mod feed;
mod indexed;
mod sink;

pub use feed::{feed, layout, pieces};
pub use indexed::Mesh;
pub use sink::{Collect, Count, EdgeKey, Layout, MeshSink, Piece, Totals};
