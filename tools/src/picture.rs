//! Pictures in memory and as PNG files.

use crate::output::{self, Replace};
use brickmarch::{Error, Result};
use std::path::Path;

/// An 8-bit picture, rows from the top.
#[derive(Clone, Debug)]
pub(crate) struct Picture {
    pub width: u32,
    pub height: u32,
    /// 1 (grey) or 3 (red, green, blue).
    pub channels: usize,
    pub bytes: Vec<u8>,
}

impl Picture {
    /// A black colour picture.
    pub(crate) fn rgb(width: u32, height: u32) -> Picture {
        Picture::with_channels(width, height, 3)
    }

    /// A black picture of `channels` bytes a pixel.
    pub(crate) fn with_channels(width: u32, height: u32, channels: usize) -> Picture {
        Picture {
            width,
            height,
            channels,
            bytes: vec![0; width as usize * height as usize * channels],
        }
    }

    /// Writes a PNG file, whole or not at all. Returns its size in bytes.
    ///
    /// # Errors
    /// When the file exists and may not be replaced, or cannot be written.
    pub(crate) fn write_png(&self, path: &Path, replace: Replace) -> Result<u64> {
        output::write_whole(path, replace, |file| {
            self.encode_png(file, png::Compression::High)
        })
    }

    /// Encodes as PNG.
    ///
    /// # Errors
    /// When `out` cannot be written.
    pub(crate) fn encode_png(
        &self,
        out: &mut dyn std::io::Write,
        compression: png::Compression,
    ) -> std::io::Result<()> {
        let mut encoder = png::Encoder::new(out, self.width, self.height);
        encoder.set_color(match self.channels {
            1 => png::ColorType::Grayscale,
            _ => png::ColorType::Rgb,
        });
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(compression);
        encoder.set_filter(png::Filter::Adaptive);
        let as_io = |e: png::EncodingError| match e {
            png::EncodingError::IoError(e) => e,
            other => std::io::Error::other(other.to_string()),
        };
        let mut writer = encoder.write_header().map_err(as_io)?;
        writer.write_image_data(&self.bytes).map_err(as_io)?;
        writer.finish().map_err(as_io)
    }
}

/// Refuses what is not a PNG name before any work is done.
///
/// # Errors
/// When the name does not end in .png.
pub(crate) fn check_png_name(path: &Path) -> Result<()> {
    if path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("png"))
    {
        return Ok(());
    }
    Err(Error::bad_input(format!(
        "{}: pictures are written as PNG: give the file a name that ends in .png",
        path.display()
    )))
}
