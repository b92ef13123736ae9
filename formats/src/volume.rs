//! Opens a volume of any format, by its content first and its name second.

use crate::input::{Input, LateNotes};
use crate::limits::{bad, surplus, unsupported};
use crate::raw::RawLayout;
use crate::samples::{Encoding, SampleReader, Surplus};
use crate::{metaimage, nifti, npy, nrrd, raw};
use brickmarch::lattice::Grid;
use brickmarch::store::VolumeSpec;
use brickmarch::{Kind, Result, SampleType};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// A volume file, opened: its header is read, its samples come as a stream.
///
/// # Memory
/// Less than 1 MiB, whatever the size of the volume.
pub struct Source {
    /// Domain `0..dims`, index to world, units. World coordinates are those of the file.
    pub grid: Grid,
    /// Type of the samples that `reader` gives.
    pub sample: SampleType,
    /// A guess: `Mask` for bits, `Density` otherwise. Labels look like numbers; the user knows.
    pub kind: Kind,
    /// The value of empty space: zero, or what a stored zero means where the file has a scale.
    pub background: f64,
    /// Exactly `grid.domain.count() * sample.bytes()` bytes: little-endian, `i` fastest, a bit as one
    /// byte. Damaged or short files end in an `io::Error` whose message names file and place.
    pub reader: Box<dyn Read + Send>,
    /// Where those bytes stand as they are, for whoever wants to read them in another order.
    pub plain: Option<PlainSamples>,
    /// One line: format, stored type, axes of the world. For the history of the volume.
    pub description: String,
    /// What a user should know about the conversion.
    pub notes: Vec<String>,
    late: LateNotes,
}

/// Samples in a file, exactly as [`Source::reader`] gives them.
#[derive(Debug)]
pub struct PlainSamples {
    /// The file; its position means nothing.
    pub file: File,
    /// Offset of the first sample.
    pub offset: u64,
}

/// What a file does not say, or says more than once.
#[derive(Clone, Debug, Default)]
pub struct OpenOptions {
    /// Which volume of a file with several, from zero.
    pub volume: Option<u32>,
    /// Reads the file as raw samples of this layout, whatever its name.
    pub raw: Option<RawLayout>,
}

/// A volume format that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VolumeFormat {
    /// Samples and nothing else.
    Raw,
    /// NumPy `.npy`.
    Npy,
    /// Nearly raw raster data, `.nrrd` or `.nhdr`.
    Nrrd,
    /// NIfTI-1 and NIfTI-2.
    Nifti,
    /// MetaImage, `.mha` or `.mhd`.
    MetaImage,
}

/// A row of [`VOLUME_FORMATS`].
#[derive(Clone, Copy, Debug)]
pub struct FormatRow {
    /// The format.
    pub format: VolumeFormat,
    /// Its name for people.
    pub name: &'static str,
    /// File name endings, lower case, without `.gz`.
    pub extensions: &'static [&'static str],
    /// Whether volumes can be exported to it.
    pub writes: bool,
}

/// Every volume format.
pub const VOLUME_FORMATS: [FormatRow; 5] = [
    FormatRow {
        format: VolumeFormat::Raw,
        name: "raw samples",
        extensions: &["raw", "bin", "dat"],
        writes: true,
    },
    FormatRow {
        format: VolumeFormat::Npy,
        name: "NumPy",
        extensions: &["npy"],
        writes: true,
    },
    FormatRow {
        format: VolumeFormat::Nrrd,
        name: "NRRD",
        extensions: &["nrrd", "nhdr"],
        writes: true,
    },
    FormatRow {
        format: VolumeFormat::Nifti,
        name: "NIfTI",
        extensions: &["nii", "hdr", "img"],
        writes: false,
    },
    FormatRow {
        format: VolumeFormat::MetaImage,
        name: "MetaImage",
        extensions: &["mha", "mhd"],
        writes: false,
    },
];

/// Opens the volume at `path`. A gzip-compressed file is unwrapped while it is read.
///
/// The content decides the format; the name only where the content has no mark of its own.
///
/// # Errors
/// `Io` when the file cannot be read; `BadInput`, `Unsupported`, `Truncated` or `LimitExceeded` with
/// file, place and remedy when its header makes no sense or asks for what is not there.
///
/// # Memory
/// At most the header ([`HEADER_BYTES_MAX`](crate::limits::HEADER_BYTES_MAX)) and some buffers.
pub fn open_volume(path: &Path, options: &OpenOptions) -> Result<Source> {
    if let Some(layout) = &options.raw {
        return raw::open(path, layout);
    }
    let input = Input::open(path)?;
    let by_name = format_of_name(path);
    let by_content = format_of_content(&input.head);
    let Some(format) = by_content.or(by_name) else {
        return Err(unknown(&input));
    };
    let mut source = match format {
        VolumeFormat::Raw => return Err(raw_needs_layout(path)),
        VolumeFormat::Npy => npy::open(input),
        VolumeFormat::Nrrd => nrrd::open(input),
        VolumeFormat::Nifti => nifti::open(input, options.volume),
        VolumeFormat::MetaImage => metaimage::open(input),
    }?;
    if format != VolumeFormat::Nifti && options.volume.is_some_and(|v| v > 0) {
        return Err(bad(path, "the file holds one volume: leave --volume out"));
    }
    if by_name.is_some_and(|name| name != format) {
        source.notes.push(format!(
            "the name says another format than the content, which is {}",
            row(format).name
        ));
    }
    Ok(source)
}

impl Source {
    /// The samples at the current position of `input`, which are not wrapped in anything more.
    pub(crate) fn from_input(
        input: Input,
        encoding: Encoding,
        grid: Grid,
        description: String,
        mut notes: Vec<String>,
    ) -> Result<Source> {
        let needed = grid.domain.count() * encoding.stored.bytes() as u64;
        if let Some(rest) = input.remaining() {
            let extra = surplus(&input.path, needed, rest)?;
            if extra > 0 && encoding.surplus == Surplus::Note {
                notes.push(format!("{extra} bytes behind the samples were ignored"));
            }
        }
        let (path, late) = (input.path.clone(), input.late.clone());
        let plain = match encoding.is_plain() {
            true => input.plain()?,
            false => None,
        };
        // The length told already; nothing remains to be found out behind the samples.
        let surplus = if input.is_gzip() {
            encoding.surplus
        } else {
            Surplus::Ignore
        };
        let encoding = Encoding {
            surplus,
            ..encoding
        };
        let source = Source::from_stream(
            Box::new(input),
            &path,
            &late,
            encoding,
            grid,
            description,
            notes,
        )?;
        Ok(Source { plain, ..source })
    }

    /// The samples that `stream` gives.
    pub(crate) fn from_stream(
        stream: Box<dyn Read + Send>,
        path: &Path,
        late: &LateNotes,
        encoding: Encoding,
        grid: Grid,
        description: String,
        mut notes: Vec<String>,
    ) -> Result<Source> {
        grid.index_to_world
            .validate()
            .map_err(|e| e.context(path.display()))?;
        let sample = encoding.target();
        if encoding.scale.is_none() {
            notes.extend(encoding.stored.note());
        }
        Ok(Source {
            grid,
            sample,
            kind: if sample == SampleType::Bit {
                Kind::Mask
            } else {
                Kind::Density
            },
            background: encoding
                .scale
                .map_or(0.0, |(_, zero)| f64::from(zero as f32)),
            reader: Box::new(SampleReader::new(stream, path, late, encoding, grid.domain)),
            plain: None,
            description,
            notes,
            late: late.clone(),
        })
    }

    /// What a volume file of this source is: its `history` is the description.
    pub fn spec(&self, brick_edge: u32) -> VolumeSpec {
        VolumeSpec {
            kind: self.kind,
            background: self.background,
            brick_edge,
            history: self.description.clone(),
            ..VolumeSpec::new(self.grid, self.sample)
        }
    }

    /// Notes that reading the samples brought up, as bytes behind compressed data. Complete when
    /// `reader` is at its end.
    pub fn late_notes(&self) -> Vec<String> {
        self.late.get()
    }
}

fn row(format: VolumeFormat) -> &'static FormatRow {
    VOLUME_FORMATS
        .iter()
        .find(|row| row.format == format)
        .expect("every format has a row")
}

/// The ending of the name, lower case, a `.gz` taken off.
pub(crate) fn extension(path: &Path) -> String {
    let name = path
        .file_name()
        .map(|n| n.to_string_lossy().to_lowercase())
        .unwrap_or_default();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    name.rsplit_once('.')
        .map(|(_, ending)| ending.to_owned())
        .unwrap_or_default()
}

/// The format that the name of `path` stands for.
pub(crate) fn format_of_name(path: &Path) -> Option<VolumeFormat> {
    let ending = extension(path);
    VOLUME_FORMATS
        .iter()
        .find(|row| row.extensions.contains(&ending.as_str()))
        .map(|row| row.format)
}

fn format_of_content(head: &[u8]) -> Option<VolumeFormat> {
    if head.starts_with(nrrd::MAGIC) {
        Some(VolumeFormat::Nrrd)
    } else if head.starts_with(npy::MAGIC) {
        Some(VolumeFormat::Npy)
    } else if nifti::is_header(head) {
        Some(VolumeFormat::Nifti)
    } else if metaimage::is_header(head) {
        Some(VolumeFormat::MetaImage)
    } else {
        None
    }
}

fn raw_needs_layout(path: &Path) -> brickmarch::Error {
    bad(
        path,
        "raw samples do not say their layout: give --dims X,Y,Z --type T (and --endian, --spacing, --offset)",
    )
}

fn unknown(input: &Input) -> brickmarch::Error {
    let head = input.head.as_slice();
    let known: [(&[u8], usize, &str); 7] = [
        (
            b"PK\x03\x04",
            0,
            "a ZIP archive (for .npz: save one array as .npy)",
        ),
        (b"<?xml", 0, "XML, perhaps VTK"),
        (b"<VTKFile", 0, "a VTK file"),
        (b"# vtk", 0, "a legacy VTK file"),
        (b"DICM", 128, "DICOM"),
        (b"\x89HDF", 0, "HDF5"),
        (b"MAP ", 208, "an MRC map"),
    ];
    let tiff = head.starts_with(b"II*\0") || head.starts_with(b"MM\0*");
    let found = known
        .iter()
        .find(|(magic, at, _)| head.get(*at..).is_some_and(|h| h.starts_with(magic)))
        .map(|(_, _, name)| *name)
        .or(tiff.then_some("TIFF"));
    let endings: Vec<String> = VOLUME_FORMATS
        .iter()
        .flat_map(|row| row.extensions)
        .map(|e| format!(".{e}"))
        .collect();
    let readable = format!(
        "can read {}, also with .gz; raw samples of any name with --dims X,Y,Z --type T",
        endings.join(" ")
    );
    match found {
        Some(name) => unsupported(
            &input.path,
            format!("this is {name}, which is not read; {readable}"),
        ),
        None => unsupported(
            &input.path,
            format!("not a volume format that is known here; {readable}"),
        ),
    }
}
