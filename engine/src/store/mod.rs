//! Volume files: a bricked sparse octree, compressed and checksummed, read through a page cache.
//!
//! The byte layout is in `docs/format.md`. A volume is made by [`VolumeWriter`], [`import_stream`]
//! or [`write_field`], opened as [`Volume`] (which is a [`Field`](crate::Field)), and checked whole
//! by [`verify`].

mod ahead;
mod aside;
mod binary;
pub mod cache;
mod catalog;
mod checksum;
mod codec;
mod commit;
mod compact;
mod crew;
mod damage;
#[cfg(test)]
mod damage_tests;
#[cfg(test)]
mod edit_tests;
mod encode;
mod fill;
mod filter;
mod fitted;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
#[cfg(test)]
mod hostile_tests;
mod import;
#[cfg(test)]
mod import_tests;
mod label;
mod layout;
mod lod;
mod log;
mod map;
#[cfg(test)]
mod measure;
mod meta;
mod open;
mod page;
mod patch;
mod pin;
mod ranges;
mod rans;
#[cfg(test)]
mod reader_tests;
mod record;
mod rows;
mod slabs;
mod source;
mod spare;
mod spec;
mod storage;
#[cfg(test)]
mod tests;
mod tree;
mod value;
mod verify;
mod volume;
mod write_field;
mod writer;

pub use compact::{compact, compact_in};
pub use damage::OnDamage;
pub use import::{
    ImportOptions, import_in, import_plain, import_stream, import_with, partial_path,
};
pub use label::{LabelField, LabelNumbers};
pub use spec::{Compression, VolumeInfo, VolumeSpec, default_brick_edge};
pub use storage::{FileStorage, MemoryStorage, Storage};
pub use verify::{MAX_PROBLEMS, Problem, Report, verify, verify_in};
pub use volume::Volume;
pub use write_field::{bricks_to_evaluate, write_field, write_fields};
pub use writer::VolumeWriter;
