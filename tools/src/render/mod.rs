//! Shaded pictures of a surface, drawn while the surface is made: a z-buffer that is a mesh sink.
//!
//! ```text
//! pieces --> Raster (nearest depth and normal a pixel, in any order) --> shade --> Picture
//! ```
//!
//! Memory is that of the picture, whatever the size of the mesh.

mod bounds;
mod camera;
mod raster;
mod shade;

pub(crate) use bounds::crossing_bounds;
pub(crate) use camera::View;
#[cfg(test)]
use camera::WorldBox;
pub(crate) use raster::Raster;
pub(crate) use shade::Look;
