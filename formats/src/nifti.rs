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
use crate::world::{RAS, phrase};
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
        "NIfTI-{} {}{}, {} by {place}",
        header.version,
        stored.name(),
        if header.big_endian { " big-endian" } else { "" },
        phrase(RAS),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{family, gzip, open_bytes, open_with, samples};
    use crate::volume::{OpenOptions, open_volume};
    use brickmarch::{ErrorKind, SampleType};

    /// A header of either version and byte order, fields by offset.
    struct Builder {
        raw: Vec<u8>,
        big_endian: bool,
    }

    impl Builder {
        fn new(version: u8, big_endian: bool) -> Self {
            let bytes = if version == 1 { 348usize } else { 540 };
            let mut new = Self {
                raw: vec![0; bytes + 4],
                big_endian,
            };
            new.put(0, (bytes as i32).to_le_bytes());
            if version == 1 {
                new.raw[344..348].copy_from_slice(b"n+1\0");
                new.put(108, 352f32.to_le_bytes());
            } else {
                new.raw[4..12].copy_from_slice(b"n+2\0\r\n\x1a\n");
                new.put(168, 544i64.to_le_bytes());
            }
            new
        }

        fn put<const N: usize>(&mut self, at: usize, mut bytes: [u8; N]) -> &mut Self {
            if self.big_endian {
                bytes.reverse();
            }
            self.raw[at..at + N].copy_from_slice(&bytes);
            self
        }

        fn dims(&mut self, dims: &[i16]) -> &mut Self {
            let two = self.raw.len() == 544;
            let all = [&[dims.len() as i16], dims].concat();
            for (n, &d) in all.iter().enumerate() {
                if two {
                    self.put(16 + 8 * n, i64::from(d).to_le_bytes());
                    self.put(104 + 8 * n, 1f64.to_le_bytes());
                } else {
                    self.put(40 + 2 * n, d.to_le_bytes());
                    self.put(76 + 4 * n, 1f32.to_le_bytes());
                }
            }
            self
        }

        fn kind(&mut self, datatype: i16, bits: i16) -> &mut Self {
            let at = if self.raw.len() == 544 { 12 } else { 70 };
            self.put(at, datatype.to_le_bytes());
            self.put(at + 2, bits.to_le_bytes())
        }

        fn with(&self, data: &[u8]) -> Vec<u8> {
            [&self.raw, data].concat()
        }
    }

    /// 2 x 3 x 4 of i16, version 1, little-endian.
    fn small() -> Builder {
        let mut builder = Builder::new(1, false);
        builder.dims(&[2, 3, 4]).kind(4, 16);
        builder
    }

    fn little() -> Vec<u8> {
        (0..24i16).flat_map(|v| (v - 9).to_le_bytes()).collect()
    }

    fn refused(bytes: &[u8]) -> Error {
        open_bytes("a.nii", bytes).err().expect("wrong")
    }

    #[test]
    fn nifti_versions_and_byte_orders() {
        let big: Vec<u8> = (0..24i16).flat_map(|v| (v - 9).to_be_bytes()).collect();
        for version in [1, 2] {
            for (big_endian, data) in [(false, little()), (true, big.clone())] {
                let mut builder = Builder::new(version, big_endian);
                let bytes = builder.dims(&[2, 3, 4]).kind(4, 16).with(&data);
                for (name, bytes) in [("a.nii", bytes.clone()), ("a.nii.gz", gzip(&bytes))] {
                    let mut source = open_bytes(name, &bytes).expect("opens");
                    assert_eq!(source.grid.domain.size(), [2, 3, 4]);
                    assert_eq!(source.sample, SampleType::I16);
                    assert_eq!(samples(&mut source).expect("reads"), little());
                }
            }
        }
    }

    #[test]
    fn nifti_pairs() {
        let folder = tempfile::tempdir().expect("folder");
        let at = |name: &str| folder.path().join(name);
        let mut header = small();
        header.raw[344..348].copy_from_slice(b"ni1\0");
        header.put(108, 2f32.to_le_bytes());
        std::fs::write(at("a.hdr"), &header.raw[..348]).expect("writes");
        let open = |name: &str| open_volume(&at(name), &OpenOptions::default());
        let missing = open("a.hdr").err().expect("missing").to_string();
        assert!(
            missing.contains("its data file") && missing.contains("a.img"),
            "{missing}"
        );
        let data = [b"xx".as_slice(), &little()].concat();
        std::fs::write(at("a.img.gz"), gzip(&data)).expect("writes");
        assert_eq!(
            samples(&mut open("a.hdr").expect("opens")).expect("reads"),
            little()
        );
        std::fs::write(at("a.img"), &data).expect("writes");
        for name in ["a.hdr", "a.img", "a.img.gz"] {
            assert_eq!(
                samples(&mut open(name).expect("opens")).expect("reads"),
                little()
            );
        }
        std::fs::write(at("b.img"), &data).expect("writes");
        assert!(
            open("b.img")
                .err()
                .expect("missing")
                .to_string()
                .contains("b.hdr")
        );
        std::fs::write(at("a.img"), &data[..40]).expect("writes");
        assert_eq!(
            open("a.hdr").err().expect("short").kind(),
            ErrorKind::Truncated
        );
    }

    #[test]
    fn nifti_scale_makes_floats() {
        let mut builder = small();
        let scaled = builder
            .put(112, 0.5f32.to_le_bytes())
            .put(116, 3f32.to_le_bytes())
            .with(&little());
        let mut source = open_bytes("a.nii", &scaled).expect("opens");
        assert_eq!((source.sample, source.background), (SampleType::F32, 3.0));
        let want: Vec<u8> = (0..24)
            .flat_map(|v| ((v - 9) as f32 * 0.5 + 3.0).to_le_bytes())
            .collect();
        assert_eq!(samples(&mut source).expect("reads"), want);
        // Not a scale: identity, a slope of zero, NaN.
        for (slope, intercept) in [(1.0, 0.0), (0.0, 7.0), (f32::NAN, 7.0)] {
            let bytes = builder
                .put(112, f32::to_le_bytes(slope))
                .put(116, f32::to_le_bytes(intercept))
                .with(&little());
            let source = open_bytes("a.nii", &bytes).expect("opens");
            assert_eq!(source.sample, SampleType::I16);
        }
        builder
            .put(112, 2f32.to_le_bytes())
            .put(116, f32::NAN.to_le_bytes());
        assert!(
            refused(&builder.with(&little()))
                .to_string()
                .contains("scl_inter")
        );
    }

    #[test]
    fn nifti_of_several_volumes_needs_a_choice() {
        let mut builder = Builder::new(1, false);
        let data: Vec<u8> = (0..18).collect();
        let bytes = builder.dims(&[1, 2, 3, 3]).kind(2, 8).with(&data);
        let error = refused(&bytes).to_string();
        assert!(
            error.contains("3 volumes") && error.contains("--volume 0 to 2"),
            "{error}"
        );
        let open = |bytes: &[u8], name, volume| {
            let options = OpenOptions {
                volume: Some(volume),
                ..OpenOptions::default()
            };
            open_with(name, bytes, &options)
        };
        for volume in 0..3u8 {
            for (name, bytes) in [("a.nii", bytes.clone()), ("a.nii.gz", gzip(&bytes))] {
                let mut source = open(&bytes, name, u32::from(volume)).expect("opens");
                let want: Vec<u8> = (6 * volume..6 * volume + 6).collect();
                assert_eq!(samples(&mut source).expect("reads"), want);
            }
        }
        assert!(open(&bytes, "a.nii", 3).is_err());
        assert_eq!(
            open(&bytes[..bytes.len() - 1], "a.nii", 2)
                .err()
                .expect("short")
                .kind(),
            ErrorKind::Truncated
        );
        let five = builder.dims(&[1, 2, 3, 1, 3]).with(&data);
        assert!(
            refused(&five)
                .to_string()
                .contains("more than one number per sample")
        );
    }

    #[test]
    fn nifti_places() {
        let place = |builder: &Builder| {
            let source = open_bytes("a.nii", &builder.with(&little())).expect("opens");
            (
                source.grid.index_to_world,
                source.grid.units,
                source.notes.len(),
            )
        };
        let mut builder = small();
        for (n, step) in [-1f32, 2.0, 3.0, 4.0].into_iter().enumerate() {
            builder.put(76 + 4 * n, step.to_le_bytes());
        }
        builder.raw[123] = 3 | 8;
        let (map, units, notes) = place(&builder);
        assert_eq!(map, Affine::from_spacing([2.0, 3.0, 4.0], [0.0; 3]));
        assert_eq!((units, notes), (Units::Micrometre, 1));
        // A quarter turn about z, third axis turned: (b, c, d) = (0, 0, sin 45).
        let half = std::f32::consts::FRAC_1_SQRT_2;
        builder.put(252, 1i16.to_le_bytes());
        builder.put(264, half.to_le_bytes());
        builder.put(268, 10f32.to_le_bytes());
        let (map, ..) = place(&builder);
        let want = [
            [0.0, -3.0, 0.0, 10.0],
            [2.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, -4.0, 0.0],
        ];
        for (got, want) in map.rows.iter().flatten().zip(want.iter().flatten()) {
            assert!((got - want).abs() < 1e-6, "{map:?}");
        }
        assert!(map.is_left_handed());
        // The sform goes first, whatever the qform says.
        builder.put(254, 2i16.to_le_bytes());
        let rows = [
            [0.5f32, 0.0, 0.1, -9.0],
            [0.0, -0.25, 0.0, 8.0],
            [0.0, 0.0, 1.5, 7.0],
        ];
        for (n, value) in rows.iter().flatten().enumerate() {
            builder.put(280 + 4 * n, value.to_le_bytes());
        }
        assert_eq!(place(&builder).0.rows, rows.map(|r| r.map(f64::from)));
        builder.put(320, 0f32.to_le_bytes());
        assert!(
            refused(&builder.with(&little()))
                .to_string()
                .contains("the sform")
        );
    }

    #[test]
    fn nifti_wrong_headers() {
        for datatype in [0, 1, 32, 128, 1536, 1792, 2304, 77] {
            let bytes = small().kind(datatype, 16).with(&little());
            assert_eq!(refused(&bytes).kind(), ErrorKind::Unsupported);
        }
        for dims in [&[0, 3, 4], &[2, -3, 4], &[2, 3, 5], &[i16::MAX; 3]] as [&[i16]; 4] {
            refused(&small().dims(dims).with(&little()));
        }
        assert_eq!(
            refused(&small().dims(&[4, 6]).with(&little())).kind(),
            ErrorKind::Unsupported
        );
        for count in [0i16, 8, -1, i16::MAX] {
            refused(&small().put(40, count.to_le_bytes()).with(&little()));
        }
        for offset in [-1f32, f32::NAN, f32::INFINITY, 400.5, 1e30, 400.0] {
            refused(&small().put(108, offset.to_le_bytes()).with(&little()));
        }
        refused(&small().put(0, 99i32.to_le_bytes()).with(&little()));
        let mut analyze = small();
        analyze.raw[344..348].fill(0);
        assert!(
            refused(&analyze.with(&little()))
                .to_string()
                .contains("Analyze")
        );
        assert!(open_bytes("a.nii", b"").is_err());
        // An offset inside the header is put right with a note.
        let bytes = small().put(108, 0f32.to_le_bytes()).with(&little());
        let mut source = open_bytes("a.nii", &bytes).expect("opens");
        assert_eq!(samples(&mut source).expect("reads"), little());
        assert!(source.notes.iter().any(|n| n.contains("vox_offset")));
    }

    #[test]
    fn nifti_huge_declared_sizes() {
        for dims in [[i64::MAX; 3], [1 << 20; 3], [1 << 27, 1, 1]] {
            let mut builder = Builder::new(2, false);
            builder.dims(&[1, 1, 1]).kind(4, 16);
            for (a, n) in dims.iter().enumerate() {
                builder.put(24 + 8 * a, n.to_le_bytes());
            }
            let bytes = builder.with(&little());
            refused(&bytes);
            let packed = open_bytes("a.nii.gz", &gzip(&bytes));
            assert!(packed.map(|mut s| samples(&mut s).map(|_| ())).failed());
        }
    }

    trait Failed {
        fn failed(&self) -> bool;
    }

    impl Failed for Result<std::io::Result<()>> {
        /// Refused when opened or when read.
        fn failed(&self) -> bool {
            !matches!(self, Ok(Ok(())))
        }
    }

    #[test]
    fn nifti_truncations_and_flips() {
        family("a.nii", &small().with(&little()));
        family("a.nii.gz", &gzip(&small().with(&little())));
        let mut two = Builder::new(2, true);
        family("a.nii", &two.dims(&[2, 3, 4]).kind(4, 16).with(&little()));
    }

    #[test]
    fn siblings_keep_their_spelling() {
        let of = |name: &str| sibling(Path::new(name), "hdr", "img").display().to_string();
        assert_eq!(of("x/Head.hdr"), "x/Head.img");
        assert_eq!(of("x/HEAD.HDR"), "x/HEAD.IMG");
        assert_eq!(of("x/head.hdr.gz"), "x/head.img.gz");
    }
}
