//! Raw samples of either byte order to f32.

use crate::sample::SampleType;

/// Converts whole samples; `raw` holds `out.len()` of them.
pub(super) fn to_f32(sample: SampleType, big_endian: bool, raw: &[u8], out: &mut [f32]) {
    fn each<const N: usize>(raw: &[u8], out: &mut [f32], convert: impl Fn([u8; N]) -> f32) {
        for (value, bytes) in out.iter_mut().zip(raw.as_chunks::<N>().0) {
            *value = convert(*bytes);
        }
    }
    match (sample, big_endian) {
        // Masks in the wild hold 255 as often as 1.
        (SampleType::Bit, _) => each(raw, out, |[b]| f32::from(b != 0)),
        (SampleType::U16, true) => each(raw, out, |b| f32::from(u16::from_be_bytes(b))),
        (SampleType::I16, true) => each(raw, out, |b| f32::from(i16::from_be_bytes(b))),
        (SampleType::U32, true) => each(raw, out, |b| u32::from_be_bytes(b) as f32),
        (SampleType::I32, true) => each(raw, out, |b| i32::from_be_bytes(b) as f32),
        (SampleType::F32, true) => each(raw, out, f32::from_be_bytes),
        (SampleType::U8 | SampleType::I8, true) | (_, false) => sample.to_f32(raw, out),
    }
}
