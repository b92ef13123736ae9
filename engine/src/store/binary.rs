//! Codec 9: bricks of two values, as masks and most bricks of segmentations are. One bit a sample says which
//! value; each bit is predicted by the majority of five neighbours that come before it, a whole row at a time
//! by logic on words, and bytes of what the prediction misses are entropy-coded. Section 9 of
//! `docs/format.md`; why, and what else was tried: `docs/why.md`.

use super::codec::pack_bits;
use super::rans;
use crate::sample::SampleType;

/// Types that may have this codec: all but f32, whose files then stay readable without it.
pub(super) fn is_for(sample: SampleType) -> bool {
    sample != SampleType::F32
}

/// Holds the working buffers of encoding.
#[derive(Default)]
pub(super) struct BinaryEncoder {
    bits: Vec<u8>,
    residuals: Vec<u8>,
    words: Vec<u16>,
}

impl BinaryEncoder {
    /// Appends a whole brick to `out`; `false`, with nothing appended, when it has more than two values.
    pub(super) fn encode(
        &mut self,
        sample: SampleType,
        edge: u32,
        bytes: &[u8],
        out: &mut Vec<u8>,
    ) -> bool {
        let samples = (edge as usize).pow(3);
        self.bits.resize(samples / 8, 0);
        let found = match sample.bytes() {
            _ if sample == SampleType::Bit => {
                self.bits.copy_from_slice(bytes);
                true
            }
            1 => split(bytes.as_chunks::<1>().0, &mut self.bits, out),
            2 => split(bytes.as_chunks::<2>().0, &mut self.bits, out),
            _ => split(bytes.as_chunks::<4>().0, &mut self.bits, out),
        };
        if !found {
            return false;
        }
        self.residuals.resize(samples / 8, 0);
        match edge {
            8 => predict::<1>(&self.bits, &mut self.residuals),
            16 => predict::<2>(&self.bits, &mut self.residuals),
            32 => predict::<4>(&self.bits, &mut self.residuals),
            _ => predict::<8>(&self.bits, &mut self.residuals),
        }
        rans::encode(&self.residuals, 1, &mut self.words, out);
        true
    }
}

/// Decodes a brick into `out`, which has exactly its length.
///
/// # Errors
/// What is wrong with the stream, as a phrase.
pub(super) fn decode(
    stored: &[u8],
    sample: SampleType,
    edge: u32,
    out: &mut [u8],
    scratch: &mut Vec<u8>,
) -> Result<(), &'static str> {
    if sample == SampleType::Bit {
        return restore_from(stored, edge, out);
    }
    let width = sample.bytes();
    let (values, stored) = stored
        .split_at_checked(2 * width)
        .ok_or("the two values are cut off")?;
    let length = (edge as usize).pow(3) / 8;
    if scratch.len() < length {
        scratch.resize(length, 0);
    }
    let bits = &mut scratch[..length];
    restore_from(stored, edge, bits)?;
    match width {
        1 => join(bits, values.as_chunks().0, out.as_chunks_mut::<1>().0),
        2 => join(bits, values.as_chunks().0, out.as_chunks_mut::<2>().0),
        _ => join(bits, values.as_chunks().0, out.as_chunks_mut::<4>().0),
    }
    Ok(())
}

fn restore_from(mut stored: &[u8], edge: u32, bits: &mut [u8]) -> Result<(), &'static str> {
    rans::decode(&mut stored, 1, bits).ok_or("the bits of two values are malformed")?;
    if !stored.is_empty() {
        return Err("bytes are left over after the bits of two values");
    }
    match edge {
        8 => restore::<1>(bits),
        16 => restore::<2>(bits),
        32 => restore::<4>(bits),
        _ => restore::<8>(bits),
    }
    Ok(())
}

/// The bits of samples of two values, and the values appended to `out`: that of the first sample, which is
/// bit 0, and the other one. Nothing and `false` when there are others; they are met early.
fn split<const W: usize>(samples: &[[u8; W]], bits: &mut [u8], out: &mut Vec<u8>) -> bool {
    let zero = samples[0];
    let one = samples.iter().find(|&&s| s != zero).copied();
    let one = one.unwrap_or(zero);
    for (all, bits) in samples.chunks(64).zip(bits.chunks_mut(8)) {
        // Without a branch in the loop it is made of vectors.
        let other = |other, &s: &[u8; W]| other | ((s != zero) & (s != one));
        if all.iter().fold(false, other) {
            return false;
        }
        let mut flags = [0u8; 64];
        for (flag, &s) in flags.iter_mut().zip(all) {
            *flag = u8::from(s != zero);
        }
        pack_bits(&flags[..all.len()], bits);
    }
    out.extend(zero);
    out.extend(one);
    true
}

/// Samples of the two values, by their bits.
fn join<const W: usize>(bits: &[u8], values: &[[u8; W]], out: &mut [[u8; W]]) {
    let zero = values[0];
    let differ: [u8; W] = std::array::from_fn(|b| values[0][b] ^ values[1][b]);
    for (&byte, eight) in bits.iter().zip(out.as_chunks_mut::<8>().0) {
        let flags = spread(byte);
        for (s, flag) in eight.iter_mut().zip(flags) {
            *s = std::array::from_fn(|b| zero[b] ^ (differ[b] & flag));
        }
    }
}

/// For each bit, from the lowest on, all bits of a byte.
#[inline(always)]
fn spread(byte: u8) -> [u8; 8] {
    let ones = 0x0101_0101_0101_0101u64;
    let own_bit = (u64::from(byte) * ones) & 0x8040_2010_0804_0201;
    // No lane carries: at most 0x80 + 0x7f.
    let flags = (own_bit + ones * 0x7f) >> 7 & ones;
    (flags * 0xff).to_le_bytes()
}

/// Row of `B` bytes as a word.
#[inline(always)]
fn row<const B: usize>(bits: &[u8], row: usize) -> u64 {
    let mut word = [0; 8];
    word[..B].copy_from_slice(&bits[row * B..][..B]);
    u64::from_le_bytes(word)
}

/// Majority of the neighbours of each bit of row `n` (= j + edge k): the rows j-1 in the same slice at i-1,
/// i and i+1, and j and j+1 in the slice before. Where there is no such row, the next best one is it.
#[inline(always)]
fn guess<const B: usize>(bits: &[u8], n: usize) -> u64 {
    let edge = 8 * B;
    let (j, k) = (n % edge, n / edge);
    let [a, b, c] = match (j, k) {
        (0, 0) => return 0,
        (_, 0) => [row::<B>(bits, n - 1); 3],
        _ => {
            let before = row::<B>(bits, n - edge);
            let left = if j == 0 {
                before
            } else {
                row::<B>(bits, n - 1)
            };
            let right = if j + 1 == edge {
                before
            } else {
                row::<B>(bits, n - edge + 1)
            };
            [left, before, right]
        }
    };
    let low = a << 1 | a & 1;
    let high = a >> 1 | a & 1 << (edge - 1);
    // Two adders: of three, and of its sum with the other two.
    let (sum, twice) = (a ^ b ^ c, a & b | c & (a | b));
    let more = low & high | sum & (low | high);
    let sum = sum ^ low ^ high;
    // The count is 2 (twice + more) + sum.
    twice & more | (twice | more) & sum
}

/// What the prediction misses, in the places of the bits.
fn predict<const B: usize>(bits: &[u8], residuals: &mut [u8]) {
    for (n, out) in residuals.as_chunks_mut::<B>().0.iter_mut().enumerate() {
        let missed = row::<B>(bits, n) ^ guess::<B>(bits, n);
        out.copy_from_slice(&missed.to_le_bytes()[..B]);
    }
}

/// The inverse of [`predict`], in place.
fn restore<const B: usize>(bits: &mut [u8]) {
    for n in 0..bits.len() / B {
        let word = row::<B>(bits, n) ^ guess::<B>(bits, n);
        bits[n * B..][..B].copy_from_slice(&word.to_le_bytes()[..B]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn random(seed: &mut u64) -> u64 {
        *seed ^= *seed << 13;
        *seed ^= *seed >> 7;
        *seed ^= *seed << 17;
        *seed
    }

    /// Bits of a ball, of noise, of one sample, of none and of a checkerboard.
    fn masks(edge: usize) -> Vec<Vec<bool>> {
        let mut seed = 77 + edge as u64;
        let at = |n: usize| [n % edge, n / edge % edge, n / edge / edge].map(|v| v as i64);
        let half = edge as i64 / 2;
        let all = 0..edge.pow(3);
        vec![
            all.clone()
                .map(|n| at(n).iter().map(|v| (v - half).pow(2)).sum::<i64>() < half * half)
                .collect(),
            all.clone().map(|_| random(&mut seed) & 1 == 0).collect(),
            all.clone().map(|n| n == edge.pow(3) - 1).collect(),
            all.clone().map(|_| false).collect(),
            all.map(|n| at(n).iter().sum::<i64>() % 2 == 0).collect(),
        ]
    }

    /// The prediction by the words of the document, a bit at a time.
    fn plain_residual(mask: &[bool], edge: usize, n: usize) -> bool {
        let f = |i: usize, j: usize, k: usize| mask[i + edge * (j + edge * k)];
        let (i, j, k) = (n % edge, n / edge % edge, n / edge / edge);
        let guess = if j == 0 && k == 0 {
            false
        } else {
            let a = |i: usize| {
                if j > 0 {
                    f(i, j - 1, k)
                } else {
                    f(i, 0, k - 1)
                }
            };
            let b = if k > 0 { f(i, j, k - 1) } else { a(i) };
            let c = match k {
                0 => a(i),
                _ if j + 1 < edge => f(i, j + 1, k - 1),
                _ => b,
            };
            let five = [a(i), b, c, a(i.saturating_sub(1)), a((i + 1).min(edge - 1))];
            five.into_iter().filter(|&v| v).count() >= 3
        };
        f(i, j, k) != guess
    }

    #[test]
    fn binary_predicts_by_the_words_of_the_document() {
        for edge in [8usize, 16, 32, 64] {
            for mask in masks(edge) {
                let flags: Vec<u8> = mask.iter().map(|&v| v.into()).collect();
                let mut bits = vec![0; flags.len() / 8];
                pack_bits(&flags, &mut bits);
                let mut residuals = vec![0; bits.len()];
                match edge {
                    8 => predict::<1>(&bits, &mut residuals),
                    16 => predict::<2>(&bits, &mut residuals),
                    32 => predict::<4>(&bits, &mut residuals),
                    _ => predict::<8>(&bits, &mut residuals),
                }
                for n in 0..flags.len() {
                    let own = residuals[n / 8] >> (n % 8) & 1 == 1;
                    assert_eq!(own, plain_residual(&mask, edge, n), "{n} of {edge}^3");
                }
            }
        }
    }

    #[test]
    fn binary_round_trip_of_all_types_and_edges() {
        let mut encoder = BinaryEncoder::default();
        let (mut stored, mut scratch) = (Vec::new(), Vec::new());
        for sample in SampleType::ALL.into_iter().filter(|&s| is_for(s)) {
            for edge in [8u32, 16, 32, 64] {
                for (low, high) in [(0u32, 1), (0x8000_00ff, 7), (255, 254)] {
                    for mask in masks(edge as usize) {
                        let width = sample.bytes();
                        let mut brick: Vec<u8> = mask
                            .iter()
                            .flat_map(|&v| {
                                if v { high } else { low }.to_le_bytes()[..width].to_vec()
                            })
                            .collect();
                        if sample == SampleType::Bit {
                            let flags: Vec<u8> = mask.iter().map(|&v| v.into()).collect();
                            brick = vec![0; flags.len() / 8];
                            pack_bits(&flags, &mut brick);
                        }
                        stored.clear();
                        assert!(encoder.encode(sample, edge, &brick, &mut stored));
                        let mut back = vec![0xaa; brick.len()];
                        decode(&stored, sample, edge, &mut back, &mut scratch).expect("decodes");
                        assert!(back == brick, "{sample:?} {edge}");
                    }
                }
            }
        }
    }

    /// Damage gives an error or some samples, never a panic.
    #[test]
    fn binary_every_truncation_and_every_bit_flip() {
        let mut encoder = BinaryEncoder::default();
        let (mut stored, mut scratch) = (Vec::new(), Vec::new());
        for sample in [
            SampleType::Bit,
            SampleType::U8,
            SampleType::I16,
            SampleType::U32,
        ] {
            for mask in masks(8) {
                let flags: Vec<u8> = mask.iter().map(|&v| v.into()).collect();
                let mut brick: Vec<u8> = flags
                    .iter()
                    .flat_map(|&v| vec![v; sample.bytes()])
                    .collect();
                if sample == SampleType::Bit {
                    brick = vec![0; flags.len() / 8];
                    pack_bits(&flags, &mut brick);
                }
                stored.clear();
                assert!(encoder.encode(sample, 8, &brick, &mut stored));
                let mut out = vec![0; brick.len()];
                for end in 0..stored.len() {
                    assert!(decode(&stored[..end], sample, 8, &mut out, &mut scratch).is_err());
                }
                for bit in 0..stored.len() * 8 {
                    let mut bad = stored.clone();
                    bad[bit / 8] ^= 1 << (bit % 8);
                    let _any = decode(&bad, sample, 8, &mut out, &mut scratch);
                }
                stored.push(0);
                assert!(decode(&stored, sample, 8, &mut out, &mut scratch).is_err());
            }
        }
    }

    #[test]
    fn binary_leaves_three_values_to_others() {
        let mut encoder = BinaryEncoder::default();
        for place in [0, 1, 4095] {
            let mut brick: Vec<u8> = (0..4096u32).map(|n| (n / 100 % 2) as u8).collect();
            brick[place] = 2;
            let mut out = vec![5];
            assert!(!encoder.encode(SampleType::U8, 16, &brick, &mut out));
            assert_eq!(out, [5]);
        }
    }

    #[test]
    fn binary_spreads_every_byte() {
        for byte in 0..=255u8 {
            let plain = std::array::from_fn(|i| if byte >> i & 1 == 1 { 0xff } else { 0 });
            assert_eq!(spread(byte), plain);
        }
    }
}
