//! Types of samples, kinds of volumes, and which side of an isovalue is inside.

use crate::error::{Error, Result};
use std::str::FromStr;

/// Type of one stored sample. Little-endian in files and in raw buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs)]
pub enum SampleType {
    /// One bit in files; one byte, 0 or 1, in raw buffers.
    Bit,
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    F32,
}

impl SampleType {
    /// Every type, in the order of their numbers in files.
    pub const ALL: [SampleType; 8] = [
        SampleType::Bit,
        SampleType::U8,
        SampleType::I8,
        SampleType::U16,
        SampleType::I16,
        SampleType::U32,
        SampleType::I32,
        SampleType::F32,
    ];

    /// Bytes of one sample in a raw buffer (a bit takes one byte there).
    pub const fn bytes(self) -> usize {
        match self {
            SampleType::Bit | SampleType::U8 | SampleType::I8 => 1,
            SampleType::U16 | SampleType::I16 => 2,
            SampleType::U32 | SampleType::I32 | SampleType::F32 => 4,
        }
    }

    /// Name on the command line and in JSON: `bit`, `u8`, ... `f32`.
    pub const fn name(self) -> &'static str {
        match self {
            SampleType::Bit => "bit",
            SampleType::U8 => "u8",
            SampleType::I8 => "i8",
            SampleType::U16 => "u16",
            SampleType::I16 => "i16",
            SampleType::U32 => "u32",
            SampleType::I32 => "i32",
            SampleType::F32 => "f32",
        }
    }

    /// Reads one sample from the start of `raw`.
    ///
    /// # Panics
    /// When `raw` is shorter than [`bytes`](Self::bytes).
    pub fn get(self, raw: &[u8]) -> f64 {
        match self {
            SampleType::Bit | SampleType::U8 => f64::from(raw[0]),
            SampleType::I8 => f64::from(raw[0] as i8),
            SampleType::U16 => f64::from(u16::from_le_bytes([raw[0], raw[1]])),
            SampleType::I16 => f64::from(i16::from_le_bytes([raw[0], raw[1]])),
            SampleType::U32 => f64::from(u32::from_le_bytes([raw[0], raw[1], raw[2], raw[3]])),
            SampleType::I32 => f64::from(i32::from_le_bytes([raw[0], raw[1], raw[2], raw[3]])),
            SampleType::F32 => f64::from(f32::from_le_bytes([raw[0], raw[1], raw[2], raw[3]])),
        }
    }

    /// Writes `value`, saturated to the type, to the start of `raw`.
    pub fn put(self, value: f64, raw: &mut [u8]) {
        match self {
            SampleType::Bit => raw[0] = u8::from(value >= 0.5),
            SampleType::U8 => raw[0] = value as u8,
            SampleType::I8 => raw[0] = (value as i8) as u8,
            SampleType::U16 => raw[..2].copy_from_slice(&(value as u16).to_le_bytes()),
            SampleType::I16 => raw[..2].copy_from_slice(&(value as i16).to_le_bytes()),
            SampleType::U32 => raw[..4].copy_from_slice(&(value as u32).to_le_bytes()),
            SampleType::I32 => raw[..4].copy_from_slice(&(value as i32).to_le_bytes()),
            SampleType::F32 => raw[..4].copy_from_slice(&(value as f32).to_le_bytes()),
        }
    }

    /// Converts a run of raw samples to f32 (nearest for 32-bit integers beyond 2^24).
    ///
    /// # Panics
    /// When `raw` does not hold exactly `out.len()` samples.
    pub fn to_f32(self, raw: &[u8], out: &mut [f32]) {
        assert_eq!(raw.len(), out.len() * self.bytes(), "raw length");
        fn each<const N: usize>(raw: &[u8], out: &mut [f32], convert: impl Fn([u8; N]) -> f32) {
            for (value, bytes) in out.iter_mut().zip(raw.as_chunks::<N>().0) {
                *value = convert(*bytes);
            }
        }
        match self {
            SampleType::Bit | SampleType::U8 => each(raw, out, |[b]: [u8; 1]| f32::from(b)),
            SampleType::I8 => each(raw, out, |[b]: [u8; 1]| f32::from(b as i8)),
            SampleType::U16 => each(raw, out, |b| f32::from(u16::from_le_bytes(b))),
            SampleType::I16 => each(raw, out, |b| f32::from(i16::from_le_bytes(b))),
            SampleType::U32 => each(raw, out, |b| u32::from_le_bytes(b) as f32),
            SampleType::I32 => each(raw, out, |b| i32::from_le_bytes(b) as f32),
            SampleType::F32 => each(raw, out, f32::from_le_bytes),
        }
    }
}

impl FromStr for SampleType {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        Self::ALL
            .into_iter()
            .find(|t| t.name() == name)
            .ok_or_else(|| {
                Error::bad_input(format!(
                    "'{name}' is not a sample type: use one of bit, u8, i8, u16, i16, u32, i32, f32"
                ))
            })
    }
}

/// What the samples mean; decides the default isovalue and which side of it is inside.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Kind {
    /// More is inside: CT numbers, fog, intensity.
    #[default]
    Density,
    /// Signed distance, negative inside.
    Distance,
    /// 0 outside, 1 inside.
    Mask,
    /// Segment numbers; each is an object of its own.
    Label,
    /// Packed colour.
    Color,
}

impl Kind {
    /// Every kind, in the order of their numbers in files.
    pub const ALL: [Kind; 5] = [
        Kind::Density,
        Kind::Distance,
        Kind::Mask,
        Kind::Label,
        Kind::Color,
    ];

    /// Name on the command line and in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Kind::Density => "density",
            Kind::Distance => "distance",
            Kind::Mask => "mask",
            Kind::Label => "label",
            Kind::Color => "color",
        }
    }

    /// The side of the isovalue that is inside when the caller does not say.
    pub const fn inside(self) -> Inside {
        match self {
            Kind::Distance => Inside::Below,
            _ => Inside::Above,
        }
    }

    /// The isovalue when the caller does not say: 0 for a distance, 0.5 for a mask, none otherwise.
    pub const fn default_iso(self) -> Option<f32> {
        match self {
            Kind::Distance => Some(0.0),
            Kind::Mask => Some(0.5),
            _ => None,
        }
    }
}

impl FromStr for Kind {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|k| k.name() == name).ok_or_else(|| {
            Error::bad_input(format!(
                "'{name}' is not a kind of volume: use one of density, distance, mask, label, color"
            ))
        })
    }
}

/// Which side of the isovalue is inside. Ties (`value == iso`) are above. NaN is outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Inside {
    /// Inside is `value >= iso`.
    Above,
    /// Inside is `value < iso`.
    Below,
}

impl Inside {
    /// The one rule that decides inside.
    #[inline(always)]
    pub fn contains(self, value: f32, iso: f32) -> bool {
        match self {
            Inside::Above => value >= iso,
            Inside::Below => value < iso,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn put_get_and_bulk_conversion_agree() {
        for sample in SampleType::ALL {
            for value in [0.0, 1.0, -3.0, 100.0, 70_000.0] {
                let mut raw = [0u8; 4];
                sample.put(value, &mut raw);
                let mut bulk = [0f32];
                sample.to_f32(&raw[..sample.bytes()], &mut bulk);
                assert_eq!(f64::from(bulk[0]), sample.get(&raw), "{sample:?} {value}");
            }
            assert_eq!(
                sample.name().parse::<SampleType>().expect("own name"),
                sample
            );
        }
    }

    #[test]
    fn nan_is_outside_on_both_sides() {
        assert!(!Inside::Above.contains(f32::NAN, 0.0));
        assert!(!Inside::Below.contains(f32::NAN, 0.0));
        assert!(Inside::Above.contains(1.0, 1.0));
        assert!(!Inside::Below.contains(1.0, 1.0));
    }
}
