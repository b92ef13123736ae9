//! The fields of NIfTI-1 (348 bytes) and NIfTI-2 (540 bytes) headers that place and type samples.

use crate::input::Input;
use crate::limits::{bad, unsupported};
use brickmarch::{Affine, Result};
use std::path::PathBuf;

const ONE: usize = 348;
const TWO: usize = 540;

/// `magic` of both versions; the last letter but one tells a single file from a pair.
const MAGIC_ONE: [(&[u8; 4], bool); 2] = [(b"n+1\0", false), (b"ni1\0", true)];
const MAGIC_TWO: [(&[u8; 8], bool); 2] = [(b"n+2\0\r\n\x1a\n", false), (b"ni2\0\r\n\x1a\n", true)];

pub(crate) struct Header {
    path: PathBuf,
    pub(crate) version: u8,
    pub(crate) big_endian: bool,
    /// Samples are in a file of their own.
    pub(crate) pair: bool,
    /// Length of this header.
    pub(crate) bytes: u64,
    pub(crate) dim: [i64; 8],
    pub(crate) datatype: i16,
    pub(crate) bitpix: i16,
    pub(crate) pixdim: [f64; 8],
    vox_offset: f64,
    pub(crate) scale: (f64, f64),
    pub(crate) xyzt_units: u8,
    pub(crate) qform_code: i32,
    pub(crate) sform_code: i32,
    /// b, c, d of the rotation, then the offset.
    quaternion: [f64; 6],
    pub(crate) srow: [[f64; 4]; 3],
}

/// Whether `head` is the start of a NIfTI file or header file.
pub(crate) fn is_nifti(head: &[u8]) -> bool {
    magic(head).is_some()
}

/// Version and whether it is a pair.
fn magic(head: &[u8]) -> Option<(u8, bool)> {
    let one = |(magic, pair): (&[u8; 4], bool)| {
        (head.get(344..348) == Some(magic.as_slice())).then_some((1, pair))
    };
    let two = |(magic, pair): (&[u8; 8], bool)| {
        (head.get(4..12) == Some(magic.as_slice())).then_some((2, pair))
    };
    MAGIC_TWO
        .into_iter()
        .find_map(two)
        .or_else(|| MAGIC_ONE.into_iter().find_map(one))
}

/// Numbers by their offset in the header.
struct Fields<'a> {
    raw: &'a [u8],
    big_endian: bool,
}

impl Fields<'_> {
    fn get<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut bytes: [u8; N] = self.raw[at..at + N].try_into().expect("N bytes");
        if self.big_endian {
            bytes.reverse();
        }
        bytes
    }

    fn i16(&self, at: usize) -> i16 {
        i16::from_le_bytes(self.get(at))
    }

    fn i32(&self, at: usize) -> i32 {
        i32::from_le_bytes(self.get(at))
    }

    fn i64(&self, at: usize) -> i64 {
        i64::from_le_bytes(self.get(at))
    }

    fn f32(&self, at: usize) -> f64 {
        f64::from(f32::from_le_bytes(self.get(at)))
    }

    fn f64(&self, at: usize) -> f64 {
        f64::from_le_bytes(self.get(at))
    }
}

impl Header {
    pub(crate) fn read(input: &mut Input) -> Result<Header> {
        let path = input.path.clone();
        let Some((version, pair)) = magic(&input.head) else {
            let analyze = [348i32.to_le_bytes(), 348i32.to_be_bytes()]
                .iter()
                .any(|size| input.head.starts_with(size));
            return Err(if analyze {
                unsupported(
                    &path,
                    "an Analyze 7.5 header, which does not state the orientation; convert it to NIfTI",
                )
            } else {
                bad(&path, "does not hold the mark of a NIfTI header")
            });
        };
        let bytes = if version == 1 { ONE } else { TWO };
        let raw = input.read_array(bytes as u64, "the header")?;
        let size = i32::from_le_bytes(raw[..4].try_into().expect("four bytes"));
        let big_endian = match size {
            n if n == bytes as i32 => false,
            n if n.swap_bytes() == bytes as i32 => true,
            n => {
                return Err(bad(
                    &path,
                    format!("sizeof_hdr is {n}, expected is {bytes}"),
                ));
            }
        };
        let f = Fields {
            raw: &raw,
            big_endian,
        };
        let common = |header: Header| Header {
            path,
            version,
            big_endian,
            pair,
            bytes: bytes as u64,
            ..header
        };
        Ok(common(if version == 1 { one(&f) } else { two(&f) }))
    }

    /// Where the samples start in their file.
    pub(crate) fn data_offset(&self, notes: &mut Vec<String>) -> Result<u64> {
        // Behind the header there are always four bytes that announce extensions.
        let lowest = if self.pair { 0 } else { self.bytes + 4 };
        let offset = self.vox_offset;
        if !offset.is_finite() || offset < 0.0 || offset.fract() != 0.0 || offset > 2f64.powi(53) {
            return Err(bad(
                &self.path,
                format!("vox_offset is {offset}; it must be a count of bytes"),
            ));
        }
        let offset = offset as u64;
        if offset < lowest {
            notes.push(format!(
                "vox_offset {offset} lies inside the header; samples are taken from byte {lowest}"
            ));
        }
        Ok(offset.max(lowest))
    }

    /// The map of the qform: a rotation as a unit quaternion, and a third axis that may be turned.
    pub(crate) fn qform(&self, spacing: [f64; 3]) -> Affine {
        let [mut b, mut c, mut d, x, y, z] = self.quaternion;
        let rest = 1.0 - (b * b + c * c + d * d);
        let a = if rest < 1e-7 {
            // Half a turn, rounded: the vector part alone makes the unit.
            let length = (b * b + c * c + d * d).sqrt();
            (b, c, d) = (b / length, c / length, d / length);
            0.0
        } else {
            rest.sqrt()
        };
        let turn = if self.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
        let [sx, sy, sz] = [spacing[0], spacing[1], spacing[2] * turn];
        let scaled = |column: [f64; 3], step: f64| column.map(|v| v * step);
        let columns = [
            scaled(
                [
                    a * a + b * b - c * c - d * d,
                    2.0 * (b * c + a * d),
                    2.0 * (b * d - a * c),
                ],
                sx,
            ),
            scaled(
                [
                    2.0 * (b * c - a * d),
                    a * a + c * c - b * b - d * d,
                    2.0 * (c * d + a * b),
                ],
                sy,
            ),
            scaled(
                [
                    2.0 * (b * d + a * c),
                    2.0 * (c * d - a * b),
                    a * a + d * d - c * c - b * b,
                ],
                sz,
            ),
        ];
        Affine::from_columns(columns, [x, y, z])
    }
}

fn one(f: &Fields<'_>) -> Header {
    Header {
        dim: std::array::from_fn(|n| i64::from(f.i16(40 + 2 * n))),
        datatype: f.i16(70),
        bitpix: f.i16(72),
        pixdim: std::array::from_fn(|n| f.f32(76 + 4 * n)),
        vox_offset: f.f32(108),
        scale: (f.f32(112), f.f32(116)),
        xyzt_units: f.raw[123],
        qform_code: i32::from(f.i16(252)),
        sform_code: i32::from(f.i16(254)),
        quaternion: std::array::from_fn(|n| f.f32(256 + 4 * n)),
        srow: std::array::from_fn(|r| std::array::from_fn(|c| f.f32(280 + 16 * r + 4 * c))),
        ..blank()
    }
}

fn two(f: &Fields<'_>) -> Header {
    Header {
        datatype: f.i16(12),
        bitpix: f.i16(14),
        dim: std::array::from_fn(|n| f.i64(16 + 8 * n)),
        pixdim: std::array::from_fn(|n| f.f64(104 + 8 * n)),
        vox_offset: f.i64(168) as f64,
        scale: (f.f64(176), f.f64(184)),
        qform_code: f.i32(344),
        sform_code: f.i32(348),
        quaternion: std::array::from_fn(|n| f.f64(352 + 8 * n)),
        srow: std::array::from_fn(|r| std::array::from_fn(|c| f.f64(400 + 32 * r + 8 * c))),
        // A 32-bit number here; units take its low byte.
        xyzt_units: f.i32(500) as u8,
        ..blank()
    }
}

fn blank() -> Header {
    Header {
        path: PathBuf::new(),
        version: 0,
        big_endian: false,
        pair: false,
        bytes: 0,
        dim: [0; 8],
        datatype: 0,
        bitpix: 0,
        pixdim: [0.0; 8],
        vox_offset: 0.0,
        scale: (0.0, 0.0),
        xyzt_units: 0,
        qform_code: 0,
        sform_code: 0,
        quaternion: [0.0; 6],
        srow: [[0.0; 4]; 3],
    }
}
