//! Raw samples: a file of nothing but numbers, whose layout the user states.

use crate::input::Input;
use crate::limits::{bad, domain};
use crate::samples::{Encoding, Stored, Surplus};
use crate::volume::Source;
use brickmarch::lattice::Grid;
use brickmarch::{Affine, Result, SampleType};
use std::path::Path;

/// How raw samples lie in a file: `i` fastest, then `j`, then `k`.
#[derive(Clone, Debug, PartialEq)]
pub struct RawLayout {
    /// Samples along x, y, z.
    pub dims: [u32; 3],
    /// Type of one sample; a `Bit` takes one byte, 0 is outside.
    pub sample: SampleType,
    /// Most significant byte first.
    pub big_endian: bool,
    /// World units per step.
    pub spacing: [f64; 3],
    /// Bytes in front of the first sample.
    pub offset: u64,
}

impl Default for RawLayout {
    /// No samples of type u8, spacing 1, offset 0.
    fn default() -> Self {
        Self {
            dims: [0; 3],
            sample: SampleType::U8,
            big_endian: false,
            spacing: [1.0; 3],
            offset: 0,
        }
    }
}

/// The file must hold exactly the samples of the layout; a raw file has no other check.
pub(crate) fn open(path: &Path, layout: &RawLayout) -> Result<Source> {
    let gzip_name = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("gz"));
    let mut input = if gzip_name {
        Input::open(path)?
    } else {
        Input::open_plain(path)?
    };
    let width = layout.sample.bytes();
    let domain = domain(path, layout.dims.map(i128::from), width)?;
    if layout.spacing.iter().any(|s| !s.is_finite() || *s <= 0.0) {
        return Err(bad(
            path,
            format!("the spacing {:?} is not positive", layout.spacing),
        ));
    }
    if let Some(length) = input.remaining()
        && length.checked_sub(layout.offset) != Some(domain.count() * width as u64)
    {
        return Err(bad(path, wrong_length(length, layout)));
    }
    input.skip(layout.offset, "the bytes in front of the samples")?;
    let encoding = Encoding {
        stored: stored(layout.sample),
        big_endian: layout.big_endian,
        scale: None,
        surplus: Surplus::Refuse,
    };
    let endian = match (width, layout.big_endian) {
        (1, _) => "",
        (_, true) => " big-endian",
        (_, false) => " little-endian",
    };
    let description = format!(
        "raw samples, {}{endian}, offset {}, index space times spacing",
        layout.sample.name(),
        layout.offset
    );
    let grid = Grid {
        index_to_world: Affine::from_spacing(layout.spacing, [0.0; 3]),
        ..Grid::new(domain)
    };
    Source::from_input(input, encoding, grid, description, Vec::new())
}

fn stored(sample: SampleType) -> Stored {
    match sample {
        SampleType::Bit => Stored::Bool,
        SampleType::U8 => Stored::U8,
        SampleType::I8 => Stored::I8,
        SampleType::U16 => Stored::U16,
        SampleType::I16 => Stored::I16,
        SampleType::U32 => Stored::U32,
        SampleType::I32 => Stored::I32,
        SampleType::F32 => Stored::F32,
    }
}

/// Says what was expected and which small change of the layout would fit.
fn wrong_length(length: u64, layout: &RawLayout) -> String {
    let [nx, ny, nz] = layout.dims.map(u64::from);
    let (name, width) = (layout.sample.name(), layout.sample.bytes() as u64);
    // The product was checked before.
    let needed = nx * ny * nz * width;
    let mut message = format!(
        "{nx},{ny},{nz} samples of {name} behind {} bytes take {} bytes, the file has {length}",
        layout.offset,
        u128::from(needed) + u128::from(layout.offset),
    );
    let Some(rest) = length.checked_sub(layout.offset).filter(|&n| n > 0) else {
        return message + ": the offset leaves no samples";
    };
    let mut fits = Vec::new();
    let (count, slice) = (nx * ny * nz, nx * ny * width);
    if rest.is_multiple_of(slice) {
        fits.push(format!("--dims {nx},{ny},{}", rest / slice));
    }
    if rest.is_multiple_of(count) && matches!(rest / count, 1 | 2 | 4) {
        let types: Vec<&str> = SampleType::ALL
            .iter()
            .filter(|t| t.bytes() as u64 == rest / count)
            .map(|t| t.name())
            .collect();
        fits.push(format!("--type {}", types.join("|")));
    }
    if length > needed && layout.offset == 0 {
        fits.push(format!("--offset {} (a header in front)", length - needed));
    }
    if rest.is_multiple_of(width) {
        let edge = ((rest / width) as f64).cbrt().round() as u64;
        if edge.checked_pow(3) == Some(rest / width) {
            fits.push(format!("--dims {edge},{edge},{edge}"));
        }
    }
    if !fits.is_empty() {
        message += &format!("; what would fit: {}", fits.join(", or "));
    }
    message
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{OpenOptions, open_volume};
    use std::io::{Read, Write};

    fn layout() -> RawLayout {
        RawLayout {
            dims: [2, 3, 4],
            sample: SampleType::U16,
            big_endian: true,
            spacing: [0.5, 1.0, 2.0],
            offset: 5,
        }
    }

    fn try_open(bytes: &[u8], layout: &RawLayout) -> Result<Source> {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("volume.raw");
        std::fs::write(&path, bytes).expect("writes");
        let options = OpenOptions {
            raw: Some(layout.clone()),
            ..OpenOptions::default()
        };
        open_volume(&path, &options)
    }

    #[test]
    fn raw_reads_what_was_stated() {
        let mut bytes = vec![9; 5];
        bytes.extend((0..24u16).flat_map(|v| v.to_be_bytes()));
        let mut source = try_open(&bytes, &layout()).expect("opens");
        let mut out = Vec::new();
        source.reader.read_to_end(&mut out).expect("reads");
        let want: Vec<u8> = (0..24u16).flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(out, want);
        assert_eq!(source.grid.domain.size(), [2, 3, 4]);
        assert_eq!(source.grid.index_to_world.spacing(), [0.5, 1.0, 2.0]);
        assert_eq!(source.sample, SampleType::U16);
    }

    #[test]
    fn raw_every_other_length_is_refused() {
        for n in (0..53).chain(54..80) {
            assert!(try_open(&vec![0; n], &layout()).is_err(), "{n} bytes");
        }
    }

    #[test]
    fn raw_says_what_would_fit() {
        let of = |bytes: usize, layout: RawLayout| {
            try_open(&vec![0; bytes], &layout)
                .err()
                .expect("wrong length")
                .to_string()
        };
        let plain = |dims| RawLayout {
            dims,
            ..RawLayout::default()
        };
        assert!(of(4 * 4 * 7, plain([4, 4, 5])).contains("--dims 4,4,7"));
        assert!(of(2 * 64, plain([4, 4, 4])).contains("--type u16|i16"));
        assert!(of(352 + 60, plain([4, 5, 3])).contains("--offset 352"));
        assert!(of(125, plain([4, 4, 4])).contains("--dims 5,5,5"));
        assert!(
            of(
                4,
                RawLayout {
                    offset: 9,
                    ..plain([1, 1, 1])
                }
            )
            .contains("offset leaves")
        );
    }

    #[test]
    fn raw_absurd_layouts_are_refused() {
        for wrong in [
            RawLayout {
                dims: [0, 1, 1],
                ..layout()
            },
            RawLayout {
                dims: [u32::MAX; 3],
                ..layout()
            },
            RawLayout {
                spacing: [0.0, 1.0, 1.0],
                ..layout()
            },
            RawLayout {
                spacing: [f64::NAN, 1.0, 1.0],
                ..layout()
            },
            RawLayout {
                offset: u64::MAX,
                ..layout()
            },
        ] {
            assert!(try_open(&[0; 53], &wrong).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn raw_gz_must_be_exact_too() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("volume.raw.gz");
        let options = OpenOptions {
            raw: Some(layout()),
            ..OpenOptions::default()
        };
        for (bytes, fine) in [(53, true), (52, false), (54, false)] {
            let file = std::fs::File::create(&path).expect("creates");
            let mut encoder = flate2::write::GzEncoder::new(file, flate2::Compression::fast());
            encoder.write_all(&vec![1; bytes]).expect("writes");
            encoder.finish().expect("writes");
            let mut source = open_volume(&path, &options).expect("opens");
            let read = source.reader.read_to_end(&mut Vec::new());
            assert_eq!(read.is_ok(), fine, "{bytes} bytes");
        }
    }
}
