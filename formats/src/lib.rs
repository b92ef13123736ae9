//! File formats.

mod aside;
mod mesh_file;
mod mesh_stream;
mod obj;
mod ply;
mod stl;

pub use mesh_file::create_mesh_sink;
