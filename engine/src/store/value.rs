//! Single values and ranges in the native type of the samples.
//!
//! *Bits*: the native little-endian bytes of a sample, zero-extended to 32 bits; what files hold.
//! *Key*: an unsigned number that sorts as the samples do, exact for every type; what ranges are
//! made of, so that 32-bit labels never pass through a float.

use crate::error::{Error, Result};
use crate::field::Range;
use crate::sample::SampleType;

const SIGN: u32 = 0x8000_0000;

/// Bits of the sample at the start of `raw`.
pub(crate) fn bits_of_raw(sample: SampleType, raw: &[u8]) -> u32 {
    match sample.bytes() {
        1 => u32::from(raw[0]),
        2 => u32::from(u16::from_le_bytes([raw[0], raw[1]])),
        _ => u32::from_le_bytes([raw[0], raw[1], raw[2], raw[3]]),
    }
}

/// Bits of `value` saturated to the type.
pub(crate) fn bits_of(sample: SampleType, value: f64) -> u32 {
    let mut raw = [0; 4];
    sample.put(value, &mut raw);
    u32::from_le_bytes(raw)
}

/// Bits of `value`.
///
/// # Errors
/// When the type cannot hold the value (f32 rounds to nearest).
pub(crate) fn exact_bits_of(sample: SampleType, value: f64, what: &str) -> Result<u32> {
    let bits = bits_of(sample, value);
    let back = f64_of(sample, bits);
    if sample != SampleType::F32 && back != value {
        return Err(Error::bad_input(format!(
            "{what} {value} does not fit into samples of type {}",
            sample.name()
        )));
    }
    Ok(bits)
}

/// Whether the bits are those of some sample of the type.
pub(crate) fn is_valid(sample: SampleType, bits: u32) -> bool {
    match sample {
        SampleType::Bit => bits <= 1,
        _ => sample.bytes() == 4 || bits >> (8 * sample.bytes()) == 0,
    }
}

/// The value of the bits.
pub(crate) fn f64_of(sample: SampleType, bits: u32) -> f64 {
    sample.get(&bits.to_le_bytes())
}

/// The value of the bits, as reads give it.
pub(crate) fn f32_of(sample: SampleType, bits: u32) -> f32 {
    let mut value = [0.0];
    sample.to_f32(&bits.to_le_bytes()[..sample.bytes()], &mut value);
    value[0]
}

/// Whether the bits are a NaN.
pub(crate) fn is_nan(sample: SampleType, bits: u32) -> bool {
    sample == SampleType::F32 && f32::from_bits(bits).is_nan()
}

/// The key of the bits; not for NaN.
#[inline]
pub(crate) fn key_of(sample: SampleType, bits: u32) -> u32 {
    match sample {
        SampleType::I8 => (bits as u8 as i8 as i32 as u32) ^ SIGN,
        SampleType::I16 => (bits as u16 as i16 as i32 as u32) ^ SIGN,
        SampleType::I32 => bits ^ SIGN,
        SampleType::F32 => f32_key(bits),
        _ => bits,
    }
}

/// The bits of a key.
#[inline]
pub(crate) fn bits_of_key(sample: SampleType, key: u32) -> u32 {
    match sample {
        SampleType::I8 => (key ^ SIGN) & 0xff,
        SampleType::I16 => (key ^ SIGN) & 0xffff,
        SampleType::I32 => key ^ SIGN,
        SampleType::F32 => key ^ if key & SIGN != 0 { SIGN } else { u32::MAX },
        _ => key,
    }
}

/// Sorts f32 as numbers; -0 before +0.
#[inline]
pub(crate) fn f32_key(bits: u32) -> u32 {
    bits ^ (((bits as i32 >> 31) as u32) | SIGN)
}

/// Smallest and largest key, NaN aside; empty when `low > high`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct KeyRange {
    pub(crate) low: u32,
    pub(crate) high: u32,
    pub(crate) has_nan: bool,
}

impl KeyRange {
    pub(crate) fn empty(sample: SampleType) -> Self {
        let (low, high) = match sample {
            SampleType::Bit => (1, 0),
            SampleType::F32 => (
                f32_key(f32::INFINITY.to_bits()),
                f32_key(f32::NEG_INFINITY.to_bits()),
            ),
            SampleType::U8 => (0xff, 0),
            SampleType::U16 => (0xffff, 0),
            SampleType::I8 => (SIGN + 0x7f, SIGN - 0x80),
            SampleType::I16 => (SIGN + 0x7fff, SIGN - 0x8000),
            SampleType::U32 | SampleType::I32 => (u32::MAX, 0),
        };
        Self {
            low,
            high,
            has_nan: false,
        }
    }

    /// The range of one value.
    pub(crate) fn of_bits(sample: SampleType, bits: u32) -> Self {
        if is_nan(sample, bits) {
            return Self {
                has_nan: true,
                ..Self::empty(sample)
            };
        }
        let key = key_of(sample, bits);
        Self {
            low: key,
            high: key,
            has_nan: false,
        }
    }

    #[inline]
    pub(crate) fn union(self, other: Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            has_nan: self.has_nan | other.has_nan,
        }
    }

    /// Whether a union with `other` changes nothing.
    #[inline]
    pub(crate) fn covers(&self, other: &Self) -> bool {
        self.low <= other.low && other.high <= self.high && (self.has_nan || !other.has_nan)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.low > self.high
    }

    /// The range of the samples as reads give them.
    pub(crate) fn to_range(self, sample: SampleType) -> Range {
        if self.is_empty() {
            return Range {
                has_nan: self.has_nan,
                ..Range::EMPTY
            };
        }
        Range {
            min: f32_of(sample, bits_of_key(sample, self.low)),
            max: f32_of(sample, bits_of_key(sample, self.high)),
            has_nan: self.has_nan,
        }
    }
}

/// Range of `raw` samples, and whether all of them have the same bytes.
///
/// # Panics
/// When `raw` is empty or not a whole number of samples.
pub(crate) fn scan(sample: SampleType, raw: &[u8]) -> (KeyRange, bool) {
    let width = sample.bytes();
    assert!(
        !raw.is_empty() && raw.len().is_multiple_of(width),
        "whole samples"
    );
    let constant = raw[width..] == raw[..raw.len() - width];
    if constant {
        return (KeyRange::of_bits(sample, bits_of_raw(sample, raw)), true);
    }
    fn ints<const N: usize, T: Ord + Copy>(raw: &[u8], value: impl Fn([u8; N]) -> T) -> (T, T) {
        let (samples, _) = raw.as_chunks::<N>();
        let first = value(samples[0]);
        samples.iter().fold((first, first), |(low, high), &s| {
            let v = value(s);
            (low.min(v), high.max(v))
        })
    }
    let range = |low: u32, high: u32| KeyRange {
        low,
        high,
        has_nan: false,
    };
    let range = match sample {
        SampleType::Bit | SampleType::U8 => {
            let (low, high) = ints(raw, |[b]: [u8; 1]| b);
            range(low.into(), high.into())
        }
        SampleType::I8 => {
            let (low, high) = ints(raw, |[b]: [u8; 1]| b as i8);
            range(low as i32 as u32 ^ SIGN, high as i32 as u32 ^ SIGN)
        }
        SampleType::U16 => {
            let (low, high) = ints(raw, u16::from_le_bytes);
            range(low.into(), high.into())
        }
        SampleType::I16 => {
            let (low, high) = ints(raw, i16::from_le_bytes);
            range(low as i32 as u32 ^ SIGN, high as i32 as u32 ^ SIGN)
        }
        SampleType::U32 => {
            let (low, high) = ints(raw, u32::from_le_bytes);
            range(low, high)
        }
        SampleType::I32 => {
            let (low, high) = ints(raw, i32::from_le_bytes);
            range(low as u32 ^ SIGN, high as u32 ^ SIGN)
        }
        SampleType::F32 => scan_f32(raw),
    };
    (range, false)
}

fn scan_f32(raw: &[u8]) -> KeyRange {
    let (samples, _) = raw.as_chunks::<4>();
    // Signed keys: SSE2 has no unsigned 32-bit comparison.
    let (mut low, mut high, mut nan) = (i32::MAX, i32::MIN, 0u32);
    for &bytes in samples {
        let bits = u32::from_le_bytes(bytes);
        let is_nan = (bits & !SIGN) > 0x7f80_0000;
        let key = (bits ^ (((bits as i32 >> 31) as u32) >> 1)) as i32;
        low = low.min(if is_nan { i32::MAX } else { key });
        high = high.max(if is_nan { i32::MIN } else { key });
        nan |= u32::from(is_nan);
    }
    let has_nan = nan != 0;
    if low > high {
        return KeyRange {
            has_nan,
            ..KeyRange::empty(SampleType::F32)
        };
    }
    KeyRange {
        low: low as u32 ^ SIGN,
        high: high as u32 ^ SIGN,
        has_nan,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_sort_as_values_and_round_trip() {
        for sample in SampleType::ALL {
            let values = [
                -1e30, -70_000.0, -129.0, -128.0, -1.0, -0.0, 0.0, 1.0, 127.0, 255.0, 3e9, 1e30,
            ];
            let mut last = None;
            for value in values {
                let bits = bits_of(sample, value);
                assert!(is_valid(sample, bits), "{sample:?} {value}");
                let key = key_of(sample, bits);
                assert_eq!(bits_of_key(sample, key), bits, "{sample:?} {value}");
                assert!(last.is_none_or(|k| k <= key), "{sample:?} {value}");
                last = Some(key);
                let empty = KeyRange::empty(sample);
                let one = KeyRange::of_bits(sample, bits);
                assert!(empty.is_empty() && one.covers(&empty));
                assert_eq!(empty.union(one), one);
                for end in [empty.low, empty.high] {
                    assert!(is_valid(sample, bits_of_key(sample, end)));
                }
            }
        }
    }

    #[test]
    fn scan_agrees_with_one_by_one() {
        for sample in SampleType::ALL {
            let raw: Vec<u8> = (0..1000u32)
                .flat_map(|n| {
                    let bits = n.wrapping_mul(2_654_435_761) ^ n << 7;
                    let bits = if sample == SampleType::Bit {
                        bits >> 31
                    } else {
                        bits
                    };
                    bits.to_le_bytes()[..sample.bytes()].to_vec()
                })
                .collect();
            let mut expected = KeyRange::empty(sample);
            for one in raw.chunks(sample.bytes()) {
                expected = expected.union(KeyRange::of_bits(sample, bits_of_raw(sample, one)));
            }
            assert_eq!(scan(sample, &raw), (expected, false), "{sample:?}");
        }
        let nan = f32::NAN.to_le_bytes();
        let (range, constant) = scan(SampleType::F32, &[nan, nan].concat());
        assert!(constant && range.has_nan && range.is_empty());
        let (range, constant) = scan(
            SampleType::F32,
            &[nan, 0xffff_ffffu32.to_le_bytes()].concat(),
        );
        assert!(!constant && range.has_nan && range.is_empty());
        let (range, _) = scan(SampleType::F32, &[nan, 1f32.to_le_bytes()].concat());
        assert_eq!(
            range.to_range(SampleType::F32),
            Range {
                min: 1.0,
                max: 1.0,
                has_nan: true
            }
        );
    }
}
