//! Shaded pictures of a surface, drawn while the surface is made: a z-buffer that is a mesh sink.
//!
//! ```text
//! pieces --> Raster (nearest depth and normal a pixel, in any order) --> shade --> Picture
//! ```
//!
//! `cast` fills the same picture with a ray for each sample, without a mesh.
//!
//! Memory is that of the picture, whatever the size of the mesh.

mod bounds;
mod camera;
mod cast;
mod raster;
mod shade;

pub(crate) use bounds::crossing_bounds;
pub(crate) use camera::{View, WorldBox};
pub(crate) use cast::{Fog, Surface, fog, highest};
pub(crate) use raster::Raster;
pub(crate) use shade::{Look, from_srgb};

use crate::args::Camera;

/// What a picture of this size looks like that the command line asks for.
pub(crate) fn look(camera: &Camera, [width, height]: [u32; 2]) -> Look {
    Look {
        width,
        height,
        view: View {
            azimuth_deg: camera.view[0],
            elevation_deg: camera.view[1],
        },
        parallel: camera.parallel,
        colour: camera.colour,
        ..Look::default()
    }
}
