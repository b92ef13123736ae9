//! Volume files: a bricked sparse octree, compressed and checksummed, read through a page cache.
//!
//! The byte layout is in `docs/format.md`. A volume is made by [`VolumeWriter`], [`import_stream`]
//! or [`write_field`], opened as [`Volume`] (which is a [`Field`](crate::Field)), and checked whole
//! by [`verify`].

pub mod cache;
mod catalog;
mod codec;
mod filter;
mod label;
mod layout;
mod log;
mod meta;
mod open;
mod page;
mod record;
mod spec;
mod storage;
#[cfg(test)]
mod tests;
mod tree;
mod value;
mod volume;
mod writer;

pub use label::LabelField;
pub use spec::{VolumeInfo, VolumeSpec, default_brick_edge};
pub use storage::{FileStorage, MemoryStorage, Storage};
pub use volume::Volume;
pub use writer::VolumeWriter;
