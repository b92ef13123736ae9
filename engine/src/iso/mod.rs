//! Isosurface extraction: which cells the surface crosses, what triangles it has there, and the
//! march from block to block.

mod ambiguity;
mod block;
mod blocks;
mod cells;
mod cube;
mod dispatch;
mod exact;
mod extract;
mod inner;
mod interior;
mod isolines;
mod label_mask;
mod labels;
#[cfg(test)]
mod measure;
mod numbering;
mod parts;
mod place;
mod relax;
mod scan;
mod sweep;
mod table;
#[cfg(test)]
mod tests;
mod vertices;
mod waist;
mod walker;

pub use extract::{Boundary, Extract, Stats, extract};
pub use isolines::{Isoline, Isolines, Raster, isolines};
pub use labels::{ExtractLabels, LabelStats, extract_labels, label_blocks};
pub use parts::{Part, extract_part, join_parts, part_of};
pub use relax::MAX_RELAX_PASSES;
