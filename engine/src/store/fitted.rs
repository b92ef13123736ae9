//! Codecs 7 and 8: bricks of small integers, predicted by a filter that is fitted to each brick.
//!
//! The prediction is a weighted mean of four neighbours in rows before, at the same place along x, so
//! that whole rows go side by side. The weights are the least-squares ones of the brick: where a scan
//! is noise a mean of many predicts best, where it is smooth an extrapolation. Codec 7 packs what is
//! left with one number of bits for 16 samples and decodes fastest; codec 8 has an entropy
//! coder behind it and is smallest. Bytes: section 9 of `docs/format.md`.

use super::filter::build;
use super::rans;
use super::rows::{Lanes, WINDOW};
use crate::cpu::Level;
use crate::sample::SampleType;
use lz4_flex::block::{
    CompressTable, compress_into_with_table, decompress_into, get_maximum_output_size,
};

#[path = "fitted_vector.rs"]
mod vector;

/// Samples with one number of bits.
const GROUP: usize = 16;
/// Weights are in parts of `1 << SHIFT`.
const SHIFT: u32 = 6;
const HEADER: usize = 8;
/// Bits of a difference that the fit looks at: products of rows of 64 then fit into 32 bits.
const FIT_BITS: u32 = 12;

/// The prediction of a brick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Fit {
    /// Of the samples at (j-1, k), (j, k-1), (j-1, k-1), (j+1, k-1).
    weights: [i8; 4],
    offset: i32,
}

impl Fit {
    fn to_bytes(self) -> [u8; HEADER] {
        let [a, b, c, d] = self.weights.map(|w| w as u8);
        let [e, f, g, h] = self.offset.to_le_bytes();
        [a, b, c, d, e, f, g, h]
    }

    fn parse([a, b, c, d, e, f, g, h]: [u8; HEADER]) -> Self {
        Self {
            weights: [a, b, c, d].map(|w| w as i8),
            offset: i32::from_le_bytes([e, f, g, h]),
        }
    }
}

/// A sample of these codecs.
trait Sample {
    type Bytes: Copy + Default;
    fn all(raw: &[u8]) -> &[Self::Bytes];
    fn all_mut(raw: &mut [u8]) -> &mut [Self::Bytes];
    fn value(bytes: Self::Bytes) -> i32;
    /// The sample that is `value` modulo its range.
    fn bytes(value: i32) -> Self::Bytes;
    /// `difference` modulo the range, small magnitudes as small numbers.
    fn zigzag(difference: i32) -> u16;
}

macro_rules! samples {
    ($($type:ty, $signed:ty, $unsigned:ty);*) => {$(
        impl Sample for $type {
            type Bytes = [u8; size_of::<$type>()];
            #[inline(always)]
            fn all(raw: &[u8]) -> &[Self::Bytes] {
                raw.as_chunks().0
            }
            #[inline(always)]
            fn all_mut(raw: &mut [u8]) -> &mut [Self::Bytes] {
                raw.as_chunks_mut().0
            }
            #[inline(always)]
            fn value(bytes: Self::Bytes) -> i32 {
                <$type>::from_le_bytes(bytes).into()
            }
            #[inline(always)]
            fn bytes(value: i32) -> Self::Bytes {
                (value as $type).to_le_bytes()
            }
            #[inline(always)]
            fn zigzag(difference: i32) -> u16 {
                let d = difference as $signed;
                ((d << 1) ^ (d >> (<$signed>::BITS - 1))) as $unsigned as u16
            }
        }
    )*};
}
samples!(u8, i8, u8; i8, i8, u8; u16, i16, u16; i16, i16, u16);

/// Whether the codecs are for a type.
pub(super) fn is_for(sample: SampleType) -> bool {
    matches!(
        sample,
        SampleType::U8 | SampleType::I8 | SampleType::U16 | SampleType::I16
    )
}

#[inline(always)]
fn row<S: Sample, const E: usize>(samples: &[S::Bytes], row: usize) -> [i32; E] {
    let row: &[S::Bytes; E] = samples[row * E..]
        .first_chunk()
        .expect("row inside the brick");
    build(|i| S::value(row[i]))
}

/// The four neighbours of row `at`, which is not the first. What is missing is taken from the others.
#[inline(always)]
fn neighbours<S: Sample, const E: usize>(bytes: &[S::Bytes], at: usize) -> [[i32; E]; 4] {
    let (j, k) = (at % E, at / E);
    if k == 0 {
        return [row::<S, E>(bytes, at - 1); 4];
    }
    let b = row::<S, E>(bytes, at - E);
    let (a, c) = match j {
        0 => (b, b),
        _ => (row::<S, E>(bytes, at - 1), row::<S, E>(bytes, at - E - 1)),
    };
    let d = if j + 1 == E {
        b
    } else {
        row::<S, E>(bytes, at - E + 1)
    };
    [a, b, c, d]
}

#[inline(always)]
fn predict<S: Sample, const E: usize>(fit: Fit, bytes: &[S::Bytes], at: usize) -> [i32; E] {
    let v = neighbours::<S, E>(bytes, at);
    let w: [i32; 4] = build(|t| i32::from(fit.weights[t]));
    let offset = fit.offset.wrapping_add(1 << (SHIFT - 1));
    build(|i| {
        let sum = (w[0] * v[0][i] + w[1] * v[1][i]) + (w[2] * v[2][i] + w[3] * v[3][i]);
        sum.wrapping_add(offset) >> SHIFT
    })
}

/// Zigzag residuals of all samples, two bytes each.
#[inline(always)]
fn residuals<S: Sample, const E: usize>(fit: Fit, raw: &[u8], out: &mut [[u8; 2]]) {
    let samples = S::all(raw);
    let rows = out.as_chunks_mut::<E>().0;
    let mut before = 0;
    let first: [i32; E] = row::<S, E>(samples, 0);
    for i in 0..E {
        rows[0][i] = S::zigzag(first[i].wrapping_sub(before)).to_le_bytes();
        before = first[i];
    }
    for (at, words) in rows.iter_mut().enumerate().skip(1) {
        let values = row::<S, E>(samples, at);
        let guess = predict::<S, E>(fit, samples, at);
        *words = build(|i| S::zigzag(values[i].wrapping_sub(guess[i])).to_le_bytes());
    }
}

#[inline(always)]
fn unzigzag(word: [u8; 2]) -> i32 {
    let word = i32::from(u16::from_le_bytes(word));
    (word >> 1) ^ -(word & 1)
}

/// Samples from their residuals.
#[inline(always)]
fn restore<S: Sample, const E: usize>(fit: Fit, words: &[[u8; 2]], out: &mut [u8]) {
    let samples = S::all_mut(out);
    let rows = words.as_chunks::<E>().0;
    let mut before = 0i32;
    for i in 0..E {
        samples[i] = S::bytes(before.wrapping_add(unzigzag(rows[0][i])));
        before = S::value(samples[i]);
    }
    for (at, words) in rows.iter().enumerate().skip(1) {
        let guess = predict::<S, E>(fit, samples, at);
        let line: &mut [S::Bytes; E] = samples[at * E..]
            .first_chunk_mut()
            .expect("row inside the brick");
        let values: [i32; E] = build(|i| guess[i].wrapping_add(unzigzag(words[i])));
        *line = build(|i| S::bytes(values[i]));
    }
}

/// Sums over the rows that have all neighbours: of the five values, and of their products.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Moments {
    count: i64,
    sums: [i64; 5],
    products: [[i64; 5]; 5],
    /// What was subtracted from the samples, and by how many bits they were shifted down.
    base: i32,
    shift: u32,
}

/// A plain loop: it is compiled for the instructions of its caller.
#[inline(always)]
fn total<const E: usize>(values: &[i32; E]) -> i64 {
    let mut sum = 0;
    for &value in values {
        sum += i64::from(value);
    }
    sum
}

#[inline(always)]
fn moments<S: Sample, const E: usize>(raw: &[u8]) -> Moments {
    let raw = S::all(raw);
    let (mut low, mut high) = (i32::MAX, i32::MIN);
    for at in 0..E * E {
        for v in row::<S, E>(raw, at) {
            (low, high) = (low.min(v), high.max(v));
        }
    }
    let bits = 32 - ((high - low) as u32).leading_zeros();
    let shift = bits.saturating_sub(FIT_BITS);
    let mut m = Moments {
        base: low,
        shift,
        ..Moments::default()
    };
    for k in 1..E {
        // Lanes of a slice stay below 2^(2 FIT_BITS) times 32.
        let (mut sums, mut products) = ([[0; E]; 5], [[[0; E]; 5]; 5]);
        // Every other row is enough.
        for j in (1 + k % 2..E).step_by(2) {
            let at = k * E + j;
            let [a, b, c, d] = neighbours::<S, E>(raw, at);
            let mut all = [a, b, c, d, row::<S, E>(raw, at)];
            for row in &mut all {
                *row = build(|i| (row[i] - low) >> shift);
            }
            for s in 0..5 {
                sums[s] = build(|i| sums[s][i] + all[s][i]);
                for t in s..5 {
                    products[s][t] = build(|i| products[s][t][i] + all[s][i] * all[t][i]);
                }
            }
            m.count += E as i64;
        }
        for s in 0..5 {
            m.sums[s] += total(&sums[s]);
            for t in s..5 {
                m.products[s][t] += total(&products[s][t]);
            }
        }
    }
    m
}

/// The least-squares prediction, in plain `f64` operations: the same on every machine.
fn fit(m: &Moments) -> Fit {
    let n = m.count as f64;
    let mean: [f64; 5] = build(|t| m.sums[t] as f64 / n);
    let covariance =
        |s: usize, t: usize| m.products[s.min(t)][s.max(t)] as f64 / n - mean[s] * mean[t];
    let mut rows = [[0.0; 5]; 4];
    let trace: f64 = (0..4).map(|t| covariance(t, t)).sum();
    for (s, row) in rows.iter_mut().enumerate() {
        for (t, value) in row.iter_mut().enumerate() {
            *value = covariance(s, t);
        }
        // Equal neighbours would leave the weights open.
        row[s] += trace * 1e-6 + 1e-6;
    }
    // Elimination; the matrix is symmetric and positive, so that no row need be exchanged.
    for p in 0..4 {
        for r in 0..4 {
            if r != p {
                let factor = rows[r][p] / rows[p][p];
                let pivot = rows[p];
                for (value, above) in rows[r].iter_mut().zip(pivot) {
                    *value -= factor * above;
                }
            }
        }
    }
    let one = f64::from(1 << SHIFT);
    let weights: [i8; 4] = build(|t| {
        let weight = rows[t][4] / rows[t][t];
        // A cast saturates; a NaN becomes 0.
        (weight * one).round() as i8
    });
    let scale = f64::from(1u32 << m.shift);
    let mean: [f64; 5] = build(|t| mean[t] * scale + f64::from(m.base));
    let predicted: f64 = (0..4).map(|t| f64::from(weights[t]) * mean[t]).sum();
    Fit {
        weights,
        offset: (one * mean[4] - predicted).round() as i32,
    }
}

/// Buffers of the encoder.
pub(super) struct FittedEncoder {
    residuals: Vec<[u8; 2]>,
    fit: Option<Fit>,
    words: Vec<u16>,
    widths: Vec<u8>,
    packed: Vec<u8>,
    table: CompressTable,
}

impl Default for FittedEncoder {
    fn default() -> Self {
        Self {
            residuals: Vec::new(),
            fit: None,
            words: Vec::new(),
            widths: Vec::new(),
            packed: Vec::new(),
            table: CompressTable::small(),
        }
    }
}

impl FittedEncoder {
    /// Predicts a brick; the other methods append it in their form.
    pub(super) fn predict(&mut self, sample: SampleType, edge: u32, raw: &[u8]) {
        self.predict_at(Level::detect(), sample, edge, raw);
    }

    fn predict_at(&mut self, level: Level, sample: SampleType, edge: u32, raw: &[u8]) {
        let moments = vector::moments(level, sample, edge, raw);
        let fit = fit(&moments);
        self.residuals.resize((edge as usize).pow(3), [0; 2]);
        vector::residuals(level, sample, edge, fit, raw, &mut self.residuals);
        self.fit = Some(fit);
    }

    fn put_fit(&self, out: &mut Vec<u8>) {
        out.extend(self.fit.expect("a brick was predicted").to_bytes());
    }

    /// Codec 7.
    pub(super) fn pack(&mut self, out: &mut Vec<u8>) {
        self.put_fit(out);
        let (groups, _) = self.residuals.as_chunks::<GROUP>();
        let width_of = |group: &[[u8; 2]; GROUP]| {
            let any = group.iter().fold(0, |any, w| any | u16::from_le_bytes(*w));
            // 15 stands for 16: four bits say it.
            (16 - any.leading_zeros()).min(15) as u8
        };
        self.widths.clear();
        let pairs = groups.as_chunks::<2>().0.iter();
        self.widths
            .extend(pairs.map(|[a, b]| width_of(a) | width_of(b) << 4));
        self.packed
            .resize(get_maximum_output_size(self.widths.len()), 0);
        let n = compress_into_with_table(&self.widths, &mut self.packed, &mut self.table)
            .expect("the buffer has the size of the bound");
        let widths = match n < self.widths.len() {
            true => &self.packed[..n],
            false => &self.widths,
        };
        out.extend((widths.len() as u16).to_le_bytes());
        out.extend(widths);
        out.reserve(self.residuals.len() * 2);
        for group in groups {
            let bits = bits_of(width_of(group));
            // Sixteen words end at a whole byte.
            let (mut all, mut filled) = (0u64, 0);
            for word in group {
                all |= u64::from(u16::from_le_bytes(*word)) << filled;
                filled += bits;
                if filled >= 32 {
                    out.extend((all as u32).to_le_bytes());
                    all >>= 32;
                    filled -= 32;
                }
            }
            out.extend(&all.to_le_bytes()[..filled as usize / 8]);
        }
    }

    /// Codec 8.
    pub(super) fn code(&mut self, sample: SampleType, out: &mut Vec<u8>) {
        self.put_fit(out);
        let bytes = self.residuals.as_flattened();
        for b in 0..sample.bytes() {
            rans::encode(&bytes[b..bytes.len() - 1 + b], 2, &mut self.words, out);
        }
    }
}

#[inline(always)]
fn bits_of(width: u8) -> u32 {
    if width == 15 { 16 } else { width.into() }
}

/// Decodes a brick of codec 7 (`is_packed`) or 8. `scratch` has two bytes for each sample.
///
/// # Errors
/// What is wrong with the stream, as a phrase.
pub(super) fn decode(
    is_packed: bool,
    stored: &[u8],
    sample: SampleType,
    edge: u32,
    out: &mut [u8],
    scratch: &mut [[u8; 2]],
) -> Result<(), &'static str> {
    decode_at(
        Level::detect(),
        is_packed,
        stored,
        (sample, edge),
        out,
        scratch,
    )
}

fn decode_at(
    level: Level,
    is_packed: bool,
    stored: &[u8],
    (sample, edge): (SampleType, u32),
    out: &mut [u8],
    scratch: &mut [[u8; 2]],
) -> Result<(), &'static str> {
    let (head, mut rest) = stored
        .split_first_chunk::<HEADER>()
        .ok_or("the prediction is cut off")?;
    if is_packed {
        let (length, after) = rest
            .split_first_chunk::<2>()
            .ok_or("the widths are cut off")?;
        let (packed, words) = after
            .split_at_checked(u16::from_le_bytes(*length).into())
            .ok_or("the widths are cut off")?;
        let mut all = [0; 64 * 64 * 64 / GROUP / 2];
        let widths = &mut all[..scratch.len() / GROUP / 2];
        if packed.len() == widths.len() {
            widths.copy_from_slice(packed);
        } else if decompress_into(packed, widths).ok() != Some(widths.len()) {
            return Err("the widths are malformed");
        }
        let most = if sample.bytes() == 1 { 8 } else { 15 };
        if widths.iter().any(|w| w & 15 > most || w >> 4 > most) {
            return Err("a width is none of those allowed");
        }
        vector::unpack(level, widths, words, scratch)?;
    } else {
        let bytes = scratch.as_flattened_mut();
        let length = bytes.len();
        if sample.bytes() == 1 {
            bytes.fill(0);
        }
        for b in 0..sample.bytes() {
            rans::decode(&mut rest, 2, &mut bytes[b..length - 1 + b])
                .ok_or("a coded plane is malformed")?;
        }
        if !rest.is_empty() {
            return Err("bytes are left over after the last plane");
        }
    }
    vector::restore(level, sample, edge, Fit::parse(*head), scratch, out);
    Ok(())
}

/// Residuals from their bits.
#[inline(always)]
fn unpack<L: Lanes>(
    widths: &[u8],
    mut words: &[u8],
    out: &mut [[u8; 2]],
) -> Result<(), &'static str> {
    for (n, group) in out.as_chunks_mut::<GROUP>().0.iter_mut().enumerate() {
        let bits = bits_of(widths[n / 2] >> (n % 2 * 4) & 15) as usize;
        let values = match words.first_chunk::<WINDOW>() {
            Some(window) => L::unpack(window, bits as u8, u16::MAX),
            None => {
                let mut window = [0; WINDOW];
                window[..words.len()].copy_from_slice(words);
                L::unpack(&window, bits as u8, u16::MAX)
            }
        };
        let mut all = [0; GROUP];
        L::store(values, &mut all);
        for (two, value) in group.iter_mut().zip(all) {
            *two = (value as u16).to_le_bytes();
        }
        words = words
            .get(bits * GROUP / 8..)
            .ok_or("the residuals are cut off")?;
    }
    match words {
        [] => Ok(()),
        _ => Err("bytes are left over after the residuals"),
    }
}

#[cfg(test)]
#[path = "fitted_tests.rs"]
mod tests;
