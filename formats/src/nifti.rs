//! NIfTI-1 and NIfTI-2, one file (`.nii`) or two (`.hdr` and `.img`), also gzip-compressed.
//!
//! World coordinates are RAS+ (x to the right, y to the front, z up) as the format defines them.
//! The sform is preferred, then the qform, then the spacing alone.
//! Fields: <https://nifti.nimh.nih.gov/pub/dist/src/niftilib/nifti1.h> and `nifti2.h`.

use crate::input::Input;
use crate::limits::{bad, domain, unsupported};
use crate::nifti_header::{Header, is_nifti};
use crate::samples::{Encoding, Stored, Surplus, not_scalar};
use crate::volume::{Source, extension};
use brickmarch::{Affine, Error, Grid, Result, Units};
use std::path::{Path, PathBuf};

pub(crate) fn is_header(head: &[u8]) -> bool {
    is_nifti(head)
}

pub(crate) fn open(input: Input, volume: Option<u32>) -> Result<Source> {
    let mut input = input;
    if !is_nifti(&input.head) && extension(&input.path) == "img" {
        let header = sibling(&input.path, "img", "hdr");
        input = Input::open(&header)
            .map_err(|e| e.context(format!("{}: its header file", input.path.display())))?;
    }
    let path = input.path.clone();
    let header = Header::read(&mut input)?;
    let mut notes = Vec::new();
    let (stored, scale) = sample_type(&path, &header, &mut notes)?;
    let (dims, volumes) = dimensions(&path, &header)?;
    let domain = domain(&path, dims, stored.bytes())?;
    let volume = choose(&path, volumes, volume)?;
    let (index_to_world, place) = place(&path, &header, &mut notes)?;
    let units = match header.xyzt_units & 7 {
        1 => Units::Metre,
        2 => Units::Millimetre,
        3 => Units::Micrometre,
        _ => Units::Unknown,
    };
    let encoding = Encoding {
        stored,
        big_endian: header.big_endian,
        scale,
        surplus: if volumes > 1 {
            Surplus::Ignore
        } else {
            Surplus::Note
        },
    };
    let mut description = format!(
        "NIfTI-{} {}{}, world is RAS+ by {place}",
        header.version,
        stored.name(),
        if header.big_endian { " big-endian" } else { "" },
    );
    if let Some((slope, intercept)) = scale {
        description += &format!(", value = {slope} * stored + {intercept}");
    }
    if volumes > 1 {
        description += &format!(", volume {volume} of {volumes}");
    }

    let offset = header.data_offset(&mut notes)?;
    let mut data = if header.pair {
        let file = sibling(&path, "hdr", "img");
        let mut data = Input::open(&file)
            .map_err(|e| e.context(format!("{}: its data file", path.display())))?;
        data.skip(offset, "the bytes in front of the samples")?;
        data
    } else {
        input.skip(offset - header.bytes, "the header extensions")?;
        input
    };
    // Checked: one volume is at most 2^60 bytes.
    let bytes = domain.count() * stored.bytes() as u64;
    let front = bytes.checked_mul(volume).ok_or_else(|| {
        bad(
            &path,
            format!("volume {volume} of {dims:?} lies beyond any file"),
        )
    })?;
    data.skip(front, &format!("the volumes before number {volume}"))?;
    let grid = Grid {
        domain,
        index_to_world,
        units,
    };
    Source::from_input(data, encoding, grid, description, notes)
}

/// The other file of a pair: `a.hdr` and `a.img`, with `.gz` where the one has it or it exists.
fn sibling(path: &Path, from: &str, to: &str) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let lower = name.to_lowercase();
    let stem = lower.strip_suffix(".gz").unwrap_or(&lower);
    let stem = stem.strip_suffix(&format!(".{from}")).unwrap_or(stem);
    // Lower case keeps the length in ASCII only; other names keep their whole spelling.
    let stem = name.get(..stem.len()).unwrap_or(stem);
    let upper = name.contains(&format!(".{}", from.to_uppercase()));
    let ending = if upper {
        to.to_uppercase()
    } else {
        to.to_owned()
    };
    let plain = path.with_file_name(format!("{stem}.{ending}"));
    let packed = path.with_file_name(format!("{stem}.{ending}.gz"));
    if !plain.exists() && (packed.exists() || lower.ends_with(".gz")) {
        packed
    } else {
        plain
    }
}

type Scale = Option<(f64, f64)>;

fn sample_type(path: &Path, header: &Header, notes: &mut Vec<String>) -> Result<(Stored, Scale)> {
    let stored = match header.datatype {
        2 => Stored::U8,
        4 => Stored::I16,
        8 => Stored::I32,
        16 => Stored::F32,
        64 => Stored::F64,
        256 => Stored::I8,
        512 => Stored::U16,
        768 => Stored::U32,
        1024 => Stored::I64,
        1280 => Stored::U64,
        other => {
            let name = match other {
                1 => "1-bit",
                32 | 1792 | 2048 => "complex",
                128 => "RGB",
                1536 => "128-bit float",
                2304 => "RGBA",
                _ => "unknown",
            };
            return Err(not_scalar(path, &format!("{name} (datatype {other})")));
        }
    };
    if usize::from(header.bitpix.unsigned_abs()) != stored.bytes() * 8 {
        notes.push(format!(
            "bitpix {} disagrees with datatype {}, which was believed",
            header.bitpix, header.datatype
        ));
    }
    let (slope, intercept) = header.scale;
    // A slope of zero, or one that is not a number, means that there is no scale.
    if slope == 0.0 || !slope.is_finite() || (slope == 1.0 && intercept == 0.0) {
        return Ok((stored, None));
    }
    if !intercept.is_finite() {
        return Err(bad(
            path,
            format!("scl_slope is {slope} but scl_inter is {intercept}"),
        ));
    }
    notes.push(format!(
        "values are {slope} * stored + {intercept}, kept as f32"
    ));
    Ok((stored, Some((slope, intercept))))
}

/// x, y, z, and the number of volumes.
fn dimensions(path: &Path, header: &Header) -> Result<([i128; 3], u64)> {
    let all = &header.dim;
    let count = all[0];
    if !(1..=7).contains(&count) {
        return Err(bad(path, format!("dim[0] is {count}; it must be 1 to 7")));
    }
    let used = &all[1..=count as usize];
    if used.len() < 3 {
        return Err(unsupported(
            path,
            format!("an image of {count} dimensions {used:?}; a volume has three"),
        ));
    }
    if used.iter().any(|&n| n <= 0) {
        return Err(bad(
            path,
            format!("the dimensions {used:?} are not positive"),
        ));
    }
    if used.iter().skip(4).any(|&n| n != 1) {
        return Err(unsupported(
            path,
            format!(
                "dimensions {used:?}: more than one number per sample; extract one component first"
            ),
        ));
    }
    let volumes = used.get(3).map_or(1, |&n| n.unsigned_abs());
    Ok(([0, 1, 2].map(|a| i128::from(used[a])), volumes))
}

fn choose(path: &Path, volumes: u64, wanted: Option<u32>) -> Result<u64> {
    let last = volumes - 1;
    match wanted.map(u64::from) {
        None if volumes == 1 => Ok(0),
        Some(n) if n < volumes => Ok(n),
        None => Err(bad(
            path,
            format!("the file holds {volumes} volumes: choose one with --volume 0 to {last}"),
        )),
        Some(n) => Err(bad(
            path,
            format!("there is no volume {n}; the file holds {volumes} (0 to {last})"),
        )),
    }
}

/// Index to world, and the name of the rule that gave it.
fn place(path: &Path, header: &Header, notes: &mut Vec<String>) -> Result<(Affine, &'static str)> {
    let wrong = |what: &str, e: Error| e.context(format!("{}: the {what}", path.display()));
    if header.sform_code > 0 {
        let map = Affine { rows: header.srow };
        map.validate().map_err(|e| wrong("sform", e))?;
        return Ok((map, "sform"));
    }
    let spacing: [f64; 3] = std::array::from_fn(|a| match header.pixdim[a + 1] {
        v if v.is_finite() && v != 0.0 => v.abs(),
        v => {
            notes.push(format!("pixdim[{}] is {v}; taken as 1", a + 1));
            1.0
        }
    });
    if header.qform_code > 0 {
        let map = header.qform(spacing);
        map.validate().map_err(|e| wrong("qform", e))?;
        return Ok((map, "qform"));
    }
    notes.push("the file states no orientation; world axes follow the index axes".into());
    Ok((Affine::from_spacing(spacing, [0.0; 3]), "spacing"))
}
