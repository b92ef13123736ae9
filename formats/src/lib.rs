//! File formats: volumes in ([`open_volume`]) and out, meshes in and out.

mod aside;
mod export;
mod input;
pub mod limits;
mod lines;
mod loaded;
mod mesh_file;
mod mesh_stream;
mod metaimage;
mod nifti;
mod nifti_header;
mod npy;
mod nrrd;
mod nrrd_geometry;
mod obj;
mod obj_read;
mod ply;
mod ply_read;
mod raw;
mod samples;
pub mod scene;
mod stl;
mod stl_read;
mod text;
mod volume;
mod waiting;
mod world;

#[cfg(test)]
mod mesh_read_tests;
#[cfg(test)]
mod shared_data;
#[cfg(test)]
mod testing;

pub use export::{Export, Exported, PlainParts, export_volume, plain_parts};
pub use loaded::Loaded;
pub use mesh_file::{
    create_colored_mesh_sink, create_labelled_mesh_sink, create_mesh_sink, mesh_capacity,
    mesh_in_place, read_mesh, scratch_file,
};
pub use raw::RawLayout;
pub use volume::{
    FormatRow, OpenOptions, PlainSamples, Source, VOLUME_FORMATS, VolumeFormat, open_volume,
};

/// The program of the front page, as a test.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
struct FrontPage;
