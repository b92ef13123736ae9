//! A brick as stored bytes and back. Lossless; the decoded length is given by the caller from the
//! catalog and never read from the stream.
//!
//! Codec numbers (byte 5 of a record): 0 samples as they are; 1 one LZ4 block; from 2 on byte planes
//! of a [`Filter`]: one u32 per plane with its stored length, then the planes, each as it is (stored
//! length = plane length) or as an LZ4 block (shorter); 6 is [`rows`], 7 and 8 are [`fitted`], 9 is
//! [`binary`].

use super::binary::{self, BinaryEncoder};
use super::filter::{self, Filter};
use super::fitted::{self, FittedEncoder};
use super::layout::{brick_bytes, get_u32};
use super::rows::{self, RowsEncoder};
use crate::sample::SampleType;
use lz4_flex::block::{
    CompressTable, compress_into_with_table, decompress_into, get_maximum_output_size,
};

/// Samples as they are.
pub(crate) const CODEC_RAW: u8 = 0;
/// One LZ4 block.
pub(crate) const CODEC_LZ4: u8 = 1;
/// Rows of f32 with masks and packed residuals.
pub(crate) const CODEC_ROWS: u8 = 6;
/// Small integers, predicted by a fitted filter: packed.
pub(crate) const CODEC_FITTED: u8 = 7;
/// The same with an entropy coder.
pub(crate) const CODEC_CODED: u8 = 8;
/// Two values.
pub(crate) const CODEC_BINARY: u8 = 9;
const FIRST_FILTER: u8 = 2;
const FILTERS: [Filter; 4] = [
    Filter::Planes,
    Filter::Delta,
    Filter::Plane3,
    Filter::Smooth,
];

/// Inputs below this use the table of 16-bit entries. One kind of table per length, so that the
/// bytes do not depend on what was compressed before.
const SMALL_INPUT: usize = u16::MAX as usize;

/// Which codecs beside the basic ones a file may have, and what to choose by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Choice {
    /// Codec 6.
    pub(crate) rows: bool,
    /// Codecs 7 and 8.
    pub(crate) fitted: bool,
    /// Codec 9.
    pub(crate) binary: bool,
    /// Size alone counts; else codec 8, which decodes several times slower, is only for samples of a
    /// byte, and where it saves an eighth.
    pub(crate) smallest: bool,
}

/// The codecs worth a try for a type, cheapest decoder first.
fn candidates(sample: SampleType, rows: bool) -> &'static [u8] {
    match sample {
        SampleType::Bit => &[CODEC_LZ4],
        SampleType::U8 | SampleType::I8 => &[CODEC_LZ4, 3, 4],
        SampleType::U16 | SampleType::I16 => &[CODEC_LZ4, 2, 4],
        SampleType::U32 | SampleType::I32 => &[CODEC_LZ4, 2, 3, 4],
        SampleType::F32 if rows => &[CODEC_LZ4, 2, CODEC_ROWS, 4, 5],
        SampleType::F32 => &[CODEC_LZ4, 2, 4, 5],
    }
}

/// Bytes that [`Encoder`] holds for bricks of this kind, with its output.
pub(crate) fn encoder_bytes(sample: SampleType, edge: u32) -> u64 {
    let n = brick_bytes(sample, edge) as u64;
    10 * n + (64 << 10)
}

/// Compresses bricks; holds its working buffers.
pub(crate) struct Encoder {
    planes: Vec<u8>,
    packed: Vec<u8>,
    trial: Vec<u8>,
    rows: RowsEncoder,
    fitted: FittedEncoder,
    binary: BinaryEncoder,
    small: CompressTable,
    large: CompressTable,
}

impl Default for Encoder {
    fn default() -> Self {
        Self {
            planes: Vec::new(),
            packed: Vec::new(),
            trial: Vec::new(),
            rows: RowsEncoder::default(),
            fitted: FittedEncoder::default(),
            binary: BinaryEncoder::default(),
            small: CompressTable::small(),
            large: CompressTable::large(),
        }
    }
}

impl Encoder {
    /// Appends the stored form of a brick to `out` and gives its codec. `bytes` is the brick as
    /// decoded (bits packed); the stored form is never longer.
    ///
    /// # Panics
    /// When `bytes` is not a whole brick.
    pub(crate) fn encode(
        &mut self,
        sample: SampleType,
        edge: u32,
        bytes: &[u8],
        choice: Choice,
        out: &mut Vec<u8>,
    ) -> u8 {
        assert_eq!(bytes.len(), brick_bytes(sample, edge), "a whole brick");
        let start = out.len();
        let mut codec = self.encode_best(sample, edge, bytes, choice, out);
        if out.len() - start >= bytes.len() {
            out.truncate(start);
            out.extend_from_slice(bytes);
            codec = CODEC_RAW;
        }
        codec
    }

    fn encode_best(
        &mut self,
        sample: SampleType,
        edge: u32,
        bytes: &[u8],
        choice: Choice,
        out: &mut Vec<u8>,
    ) -> u8 {
        let start = out.len();
        if choice.rows && sample == SampleType::F32 {
            // Nearly always the smallest for what it is made for, and cheaper than to try others.
            self.rows.encode(edge, bytes, out);
            if (out.len() - start) * 8 <= bytes.len() * 5 && !is_coarse(bytes) {
                return CODEC_ROWS;
            }
            out.truncate(start);
        }
        if choice.binary && binary::is_for(sample) && self.binary.encode(sample, edge, bytes, out) {
            let length = out.len() - start;
            // Four times fewer than bits, or matches of LZ4 may say more: stripes, checkerboards.
            if length * 32 <= (edge as usize).pow(3) {
                return CODEC_BINARY;
            }
            let packed = self.pack(bytes, None);
            if packed >= length {
                return CODEC_BINARY;
            }
            out.truncate(start);
            out.extend_from_slice(&self.packed[..packed]);
            return CODEC_LZ4;
        }
        let (other, expected) = self.choose(sample, edge, bytes, choice.rows);
        if !(choice.fitted && fitted::is_for(sample)) {
            self.encode_as(other, sample, edge, bytes, out);
            return other;
        }
        self.fitted.predict(sample, edge, bytes);
        self.fitted.pack(out);
        let mut codec = CODEC_FITTED;
        let mut length = out.len() - start;
        // Bytes with a steep distribution pack badly: there the slower decoder earns its keep.
        if choice.smallest || sample.bytes() == 1 {
            self.fitted.code(sample, out);
            let coded = out.len() - start - length;
            let enough = if choice.smallest {
                coded < length
            } else {
                coded * 8 <= length * 7
            };
            if enough {
                out.drain(start..start + length);
                (codec, length) = (CODEC_CODED, coded);
            } else {
                out.truncate(start + length);
            }
        }
        if length <= expected - expected / 32 {
            return codec;
        }
        let end = out.len();
        self.encode_as(other, sample, edge, bytes, out);
        if out.len() - end <= length {
            out.drain(start..end);
            return other;
        }
        out.truncate(end);
        codec
    }

    /// Tries the candidates on a few slices in the middle; gives the best and the length to expect of
    /// the whole brick.
    fn choose(&mut self, sample: SampleType, edge: u32, bytes: &[u8], rows: bool) -> (u8, usize) {
        let candidates = candidates(sample, rows);
        if let [only] = candidates {
            return (*only, bytes.len());
        }
        let slice = bytes.len() / edge as usize;
        let first = if edge <= 8 { 0 } else { edge as usize / 2 - 2 };
        let some = &bytes[first * slice..][..slice * if edge <= 8 { 8 } else { 4 }];
        let mut trial = std::mem::take(&mut self.trial);
        // A dearer decoder must save 3 % of the samples' bytes.
        let margin = some.len() * 3 / 100;
        let (mut best, mut best_len) = (CODEC_RAW, usize::MAX);
        for &codec in candidates {
            trial.clear();
            self.encode_as(codec, sample, edge, some, &mut trial);
            if trial.len() < best_len.saturating_sub(margin) {
                (best, best_len) = (codec, trial.len());
            }
        }
        self.trial = trial;
        (best, best_len.min(some.len()) * (bytes.len() / some.len()))
    }

    /// Appends `bytes` (whole slices) in the form of `codec`.
    pub(crate) fn encode_as(
        &mut self,
        codec: u8,
        sample: SampleType,
        edge: u32,
        bytes: &[u8],
        out: &mut Vec<u8>,
    ) {
        match codec {
            CODEC_RAW => out.extend_from_slice(bytes),
            CODEC_LZ4 => {
                let n = self.pack(bytes, None);
                out.extend_from_slice(&self.packed[..n]);
            }
            CODEC_ROWS => self.rows.encode(edge, bytes, out),
            CODEC_BINARY => assert!(
                self.binary.encode(sample, edge, bytes, out),
                "a brick of two values"
            ),
            CODEC_FITTED | CODEC_CODED => {
                self.fitted.predict(sample, edge, bytes);
                match codec {
                    CODEC_FITTED => self.fitted.pack(out),
                    _ => self.fitted.code(sample, out),
                }
            }
            _ => {
                let width = sample.bytes();
                let mut planes = std::mem::take(&mut self.planes);
                planes.resize(bytes.len(), 0);
                let filter = FILTERS[usize::from(codec - FIRST_FILTER)];
                filter::forward(
                    filter,
                    width,
                    sample == SampleType::F32,
                    edge,
                    bytes,
                    &mut planes,
                );
                let lengths = out.len();
                out.resize(lengths + 4 * width, 0);
                for (b, plane) in planes.chunks(bytes.len() / width).enumerate() {
                    let n = self.pack(plane, Some(7));
                    let n = if n * 8 <= plane.len() * 7 {
                        out.extend_from_slice(&self.packed[..n]);
                        n
                    } else {
                        out.extend_from_slice(plane);
                        plane.len()
                    };
                    out[lengths + 4 * b..][..4].copy_from_slice(&(n as u32).to_le_bytes());
                }
                self.planes = planes;
            }
        }
    }

    /// LZ4 of `bytes` into `self.packed`; gives its length. With `eighths`, noise is not tried to
    /// the end: a length that cannot win is given at once.
    fn pack(&mut self, bytes: &[u8], eighths: Option<usize>) -> usize {
        if eighths.is_some() && looks_random(bytes) {
            return usize::MAX / 8;
        }
        let bound = get_maximum_output_size(bytes.len());
        if self.packed.len() < bound {
            self.packed.resize(bound, 0);
        }
        let table = if bytes.len() < SMALL_INPUT {
            &mut self.small
        } else {
            &mut self.large
        };
        compress_into_with_table(bytes, &mut self.packed, table)
            .expect("the buffer has the size of the bound")
    }
}

/// Whether the histogram of some of the bytes is so flat that LZ4 would find no matches.
fn looks_random(bytes: &[u8]) -> bool {
    const SOME: usize = 512;
    if bytes.len() < 2 * SOME {
        return false;
    }
    let mut counts = [0u16; 256];
    for &byte in &bytes[bytes.len() / 2..][..SOME] {
        counts[usize::from(byte)] += 1;
    }
    // 512 equal chances: the expected sum of squares is about 512 * 3.
    let squares: u32 = counts.iter().map(|&c| u32::from(c) * u32::from(c)).sum();
    squares < SOME as u32 * 4
}

/// Whether f32 samples have few digits (whole numbers, labels, converted bytes): matches of LZ4 may
/// then say more than predictions.
fn is_coarse(bytes: &[u8]) -> bool {
    bytes.as_chunks::<4>().0.iter().fold(0, |any, s| any | s[0]) == 0
}

/// Decodes a stored brick into `out`, which has exactly the length of the brick; `scratch` is
/// working space. Fails on any stream that does not decode to exactly that length.
///
/// # Errors
/// What is wrong with the stream, as a phrase.
pub(crate) fn decode(
    codec: u8,
    stored: &[u8],
    sample: SampleType,
    edge: u32,
    out: &mut [u8],
    scratch: &mut Vec<u8>,
) -> Result<(), &'static str> {
    if stored.len() > out.len() {
        return Err("stored longer than decoded");
    }
    match codec {
        CODEC_RAW if stored.len() == out.len() => {
            out.copy_from_slice(stored);
            Ok(())
        }
        CODEC_RAW => Err("stored length differs from the brick's"),
        CODEC_LZ4 => unpack(stored, out),
        CODEC_ROWS if sample == SampleType::F32 => rows::decode(stored, edge, out),
        CODEC_FITTED | CODEC_CODED if fitted::is_for(sample) => {
            let samples = out.len() / sample.bytes();
            if scratch.len() < 2 * samples {
                scratch.resize(2 * samples, 0);
            }
            let words = &mut scratch.as_chunks_mut::<2>().0[..samples];
            fitted::decode(codec == CODEC_FITTED, stored, sample, edge, out, words)
        }
        CODEC_BINARY if binary::is_for(sample) => {
            binary::decode(stored, sample, edge, out, scratch)
        }
        CODEC_ROWS | CODEC_FITTED | CODEC_CODED | CODEC_BINARY => {
            Err("the codec does not fit the sample type")
        }
        _ => decode_planes(codec, stored, sample, edge, out, scratch),
    }
}

fn unpack(stored: &[u8], out: &mut [u8]) -> Result<(), &'static str> {
    match decompress_into(stored, out) {
        Ok(n) if n == out.len() => Ok(()),
        Ok(_) => Err("an LZ4 block is too short"),
        Err(_) => Err("an LZ4 block is malformed"),
    }
}

fn decode_planes(
    codec: u8,
    stored: &[u8],
    sample: SampleType,
    edge: u32,
    out: &mut [u8],
    scratch: &mut Vec<u8>,
) -> Result<(), &'static str> {
    let width = sample.bytes();
    let filter = *FILTERS
        .get(usize::from(codec.wrapping_sub(FIRST_FILTER)))
        .ok_or("unknown codec")?;
    if sample == SampleType::Bit || (filter == Filter::Smooth && sample != SampleType::F32) {
        return Err("the codec does not fit the sample type");
    }
    let plane_len = out.len() / width;
    let (lengths, mut rest) = stored
        .split_at_checked(4 * width)
        .ok_or("the plane lengths are cut off")?;
    if scratch.len() < out.len() {
        scratch.resize(out.len(), 0);
    }
    let mut planes: [&[u8]; 4] = [&[]; 4];
    let mut free = &mut scratch[..out.len()];
    for (b, plane) in planes[..width].iter_mut().enumerate() {
        let n = get_u32(lengths, 4 * b) as usize;
        let (bytes, after) = rest.split_at_checked(n).ok_or("a plane is cut off")?;
        rest = after;
        *plane = if n == plane_len {
            bytes
        } else {
            let (place, others) = free.split_at_mut(plane_len);
            free = others;
            unpack(bytes, place)?;
            place
        };
    }
    if !rest.is_empty() {
        return Err("bytes are left over after the last plane");
    }
    filter::inverse(
        filter,
        sample == SampleType::F32,
        edge,
        &planes[..width],
        out,
    );
    Ok(())
}

/// Packs samples of one byte, 0 or not 0, to bits; bit `i % 8` of byte `i / 8`.
pub(crate) fn pack_bits(raw: &[u8], packed: &mut [u8]) {
    for (byte, eight) in packed.iter_mut().zip(raw.as_chunks::<8>().0) {
        // Any bit of a byte to its highest one; these eight, at distances of 8, to distances of 1.
        let word = u64::from_le_bytes(*eight);
        let flags = (((word & 0x7f7f_7f7f_7f7f_7f7f) + 0x7f7f_7f7f_7f7f_7f7f) | word) >> 7;
        let ones = flags & 0x0101_0101_0101_0101;
        *byte = (ones.wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8;
    }
}

/// Sample `i` of packed bits as 0 or 1.
#[inline(always)]
pub(crate) fn bit_at(packed: &[u8], i: usize) -> u8 {
    packed[i / 8] >> (i % 8) & 1
}

#[cfg(test)]
#[path = "codec_tests.rs"]
mod tests;
