//! Triangle meshes: the mesh in memory, sinks that take one while it is made, and its examination.

mod around;
mod boxes;
mod buckets;
mod check;
mod components;
mod crew;
mod crossings;
mod feed;
mod indexed;
mod joined;
pub mod measure;
mod meet;
mod scratch;
mod shapes;
mod simplify;
mod sink;
mod slots;
mod spool;
mod stored;
#[cfg(test)]
mod test_meshes;

pub use check::{Report, check};
pub use components::{Components, Kept, Which};
pub use crossings::{Crossings, crossings};
pub use feed::{feed, layout, pieces};
pub use indexed::Mesh;
pub use shapes::{PERCENTILES, SLIVER_DEG, ShapeCount, Shapes, Spread, shapes};
pub use simplify::{Goal, Simplification, Simplified, Simplify};
pub use sink::{Collect, Count, EdgeKey, LabelSink, Layout, MeshSink, Piece, Totals};
pub use spool::{LabelSpool, Spool};
pub use stored::{Examined, MeshSource, examine};
