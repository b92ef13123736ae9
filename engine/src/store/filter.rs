//! Lossless transforms of the samples of a brick into byte planes that compress.
//!
//! A plane holds byte `b` of every word, so slowly changing high bytes stand together. The
//! predictors work along y and z only, row against row, so that both directions run as vertical
//! vector code: the residual of a smooth field is a few low bits, and the high planes are zero.
//! Words are native integers in wrapping arithmetic; f32 becomes an integer that sorts as the
//! numbers do.

use super::value::f32_key;
use crate::cpu::Level;

#[path = "filter_vector.rs"]
mod vector;

/// The transforms, in the order of their numbers in files (see [`super::codec`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Filter {
    /// Byte planes of the words.
    Planes,
    /// Difference to the word before (rows start anew from the row before).
    Delta,
    /// `f(y-1) + f(z-1) - f(y-1, z-1)` on integers.
    Plane3,
    /// Extrapolation of second order along y and z in f32 arithmetic; f32 only.
    Smooth,
}

/// Integer words of a sample width.
trait Word: Copy + Default {
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    /// Signed to unsigned: small magnitudes become small numbers.
    fn zigzag(self) -> Self;
    fn unzigzag(self) -> Self;
    fn byte(self, b: usize) -> u8;
    fn with_byte(self, b: usize, value: u8) -> Self;
}

macro_rules! words {
    ($($type:ty, $signed:ty);*) => {$(
        impl Word for $type {
            #[inline(always)]
            fn add(self, other: Self) -> Self { self.wrapping_add(other) }
            #[inline(always)]
            fn sub(self, other: Self) -> Self { self.wrapping_sub(other) }
            #[inline(always)]
            fn zigzag(self) -> Self {
                self.wrapping_shl(1) ^ ((self as $signed) >> (<$type>::BITS - 1)) as $type
            }
            #[inline(always)]
            fn unzigzag(self) -> Self { (self >> 1) ^ (0 as $type).wrapping_sub(self & 1) }
            #[inline(always)]
            fn byte(self, b: usize) -> u8 { (self >> (8 * b)) as u8 }
            #[inline(always)]
            fn with_byte(self, b: usize, value: u8) -> Self { self | ((value as $type) << (8 * b)) }
        }
    )*};
}
words!(u8, i8; u16, i16; u32, i32);

/// Bits of a key of [`f32_key`].
#[inline(always)]
pub(crate) fn f32_unkey(key: u32) -> u32 {
    key ^ ((!((key as i32) >> 31) as u32) | 0x8000_0000)
}

/// `[f(0), f(1), ...]`; unlike `array::map` it is always inlined into code for newer instructions.
#[inline(always)]
pub(crate) fn build<const E: usize, T: Copy + Default>(f: impl Fn(usize) -> T) -> [T; E] {
    let mut out = [T::default(); E];
    for (i, value) in out.iter_mut().enumerate() {
        *value = f(i);
    }
    out
}

/// Little-endian words of a row.
#[inline(always)]
fn load<const W: usize, T: Word, const E: usize>(samples: &[[u8; W]], row: usize) -> [T; E] {
    let row: &[[u8; W]; E] = samples[row * E..]
        .first_chunk()
        .expect("row inside the brick");
    build(|i| word::<W, T>(&row[i]))
}

#[inline(always)]
fn word<const W: usize, T: Word>(bytes: &[u8; W]) -> T {
    let mut word = T::default();
    for (b, &byte) in bytes.iter().enumerate() {
        word = word.with_byte(b, byte);
    }
    word
}

/// Transforms `raw` (whole slices of `edge * edge` samples) into its planes.
///
/// # Panics
/// When the lengths disagree, or [`Filter::Smooth`] is asked for words that are no f32.
pub(crate) fn forward(
    filter: Filter,
    width: usize,
    float: bool,
    edge: u32,
    raw: &[u8],
    planes: &mut [u8],
) {
    vector::forward(Level::detect(), filter, (width, float, edge), raw, planes);
}

#[inline(always)]
fn forward_all(
    filter: Filter,
    (width, float, edge): (usize, bool, u32),
    raw: &[u8],
    planes: &mut [u8],
) {
    assert_eq!(raw.len(), planes.len(), "planes are as long as samples");
    match edge {
        8 => forward_width::<8>(filter, width, float, raw, planes),
        16 => forward_width::<16>(filter, width, float, raw, planes),
        32 => forward_width::<32>(filter, width, float, raw, planes),
        _ => forward_width::<64>(filter, width, float, raw, planes),
    }
}

#[inline(always)]
fn forward_width<const E: usize>(
    filter: Filter,
    width: usize,
    float: bool,
    raw: &[u8],
    planes: &mut [u8],
) {
    match (width, float) {
        (1, _) => forward_rows::<1, u8, E>(filter, raw, planes, |w| w),
        (2, _) => forward_rows::<2, u16, E>(filter, raw, planes, |w| w),
        (_, false) => forward_rows::<4, u32, E>(filter, raw, planes, |w| w),
        (_, true) if filter == Filter::Smooth => forward_smooth::<E>(raw, planes),
        (_, true) if filter == Filter::Planes => {
            forward_rows::<4, u32, E>(filter, raw, planes, |w| w)
        }
        (_, true) => forward_rows::<4, u32, E>(filter, raw, planes, f32_key),
    }
}

#[inline(always)]
fn forward_rows<const W: usize, T: Word, const E: usize>(
    filter: Filter,
    raw: &[u8],
    planes: &mut [u8],
    map: impl Fn(T) -> T + Copy,
) {
    let (samples, _) = raw.as_chunks::<W>();
    let rows = samples.len() / E;
    let row_at = |row: usize| {
        let words = load::<W, T, E>(samples, row);
        build(|i| map(words[i]))
    };
    for row in 0..rows {
        let (y, z) = (row % E, row / E);
        let mut words = row_at(row);
        match filter {
            Filter::Planes => {}
            Filter::Delta => {
                let mut before = if row == 0 {
                    T::default()
                } else {
                    row_at(row - 1)[0]
                };
                for word in &mut words {
                    (*word, before) = (word.sub(before).zigzag(), *word);
                }
            }
            _ => {
                let prediction = predict_plane::<T, E>(y, z, |back| row_at(row - back));
                for i in 0..E {
                    words[i] = words[i].sub(prediction[i]).zigzag();
                }
            }
        }
        store_planes::<W, T, E>(&words, row, samples.len(), planes);
    }
}

#[inline(always)]
fn store_planes<const W: usize, T: Word, const E: usize>(
    words: &[T; E],
    row: usize,
    count: usize,
    planes: &mut [u8],
) {
    for b in 0..W {
        let target = &mut planes[b * count + row * E..][..E];
        for i in 0..E {
            target[i] = words[i].byte(b);
        }
    }
}

/// First order along y and z from the rows before; `row_back(n)` gives the row `n` before.
#[inline(always)]
fn predict_plane<T: Word, const E: usize>(
    y: usize,
    z: usize,
    row_back: impl Fn(usize) -> [T; E],
) -> [T; E] {
    match (y, z) {
        (0, 0) => [T::default(); E],
        (_, 0) => row_back(1),
        (0, _) => row_back(E),
        _ => {
            let (a, b, c) = (row_back(1), row_back(E), row_back(E + 1));
            build(|i| a[i].add(b[i]).sub(c[i]))
        }
    }
}

#[inline(always)]
fn forward_smooth<const E: usize>(raw: &[u8], planes: &mut [u8]) {
    let (samples, _) = raw.as_chunks::<4>();
    for row in 0..samples.len() / E {
        let prediction = predict_smooth::<E>(samples, row);
        let mut words = load::<4, u32, E>(samples, row);
        for i in 0..E {
            words[i] = f32_key(words[i]).wrapping_sub(prediction[i]).zigzag();
        }
        store_planes::<4, u32, E>(&words, row, samples.len(), planes);
    }
}

#[inline(always)]
fn load_f32<const E: usize>(samples: &[[u8; 4]], row: usize) -> [f32; E] {
    let words = load::<4, u32, E>(samples, row);
    build(|i| f32::from_bits(words[i]))
}

/// Extrapolates row `row` with `(1, -2, 1)` along y of differences with `(1, -2, 1)` along z, of
/// lower order at the border, from the rows before it. The order of the operations is part of the
/// format. Gives keys.
#[inline(always)]
fn predict_smooth<const E: usize>(samples: &[[u8; 4]], row: usize) -> [u32; E] {
    let (y, z) = (row % E, row / E);
    let here = along_y::<E>(samples, row, y);
    let guess: [f32; E] = match z {
        0 => here,
        1 => {
            let a = missed::<E>(samples, row - E, y);
            build(|i| here[i] + a[i])
        }
        _ => {
            let (a, b) = (
                missed::<E>(samples, row - E, y),
                missed::<E>(samples, row - 2 * E, y),
            );
            build(|i| here[i] + (2.0 * a[i] - b[i]))
        }
    };
    // The bits of a NaN that arithmetic makes differ between machines.
    build(|i| {
        f32_key(if guess[i].is_nan() {
            0
        } else {
            guess[i].to_bits()
        })
    })
}

/// Prediction of row `row` from the rows before it in its slice.
#[inline(always)]
fn along_y<const E: usize>(samples: &[[u8; 4]], row: usize, y: usize) -> [f32; E] {
    match y {
        0 => [0.0; E],
        1 => load_f32(samples, row - 1),
        _ => {
            let (a, b): ([f32; E], [f32; E]) =
                (load_f32(samples, row - 1), load_f32(samples, row - 2));
            build(|i| 2.0 * a[i] - b[i])
        }
    }
}

/// What [`along_y`] misses of row `row`.
#[inline(always)]
fn missed<const E: usize>(samples: &[[u8; 4]], row: usize, y: usize) -> [f32; E] {
    let value: [f32; E] = load_f32(samples, row);
    let guess = along_y::<E>(samples, row, y);
    build(|i| value[i] - guess[i])
}

/// Inverse of [`forward`]: `planes[b]` is plane `b`, `raw` receives the samples.
///
/// # Panics
/// When the lengths disagree.
pub(crate) fn inverse(filter: Filter, float: bool, edge: u32, planes: &[&[u8]], raw: &mut [u8]) {
    vector::inverse(Level::detect(), filter, float, edge, planes, raw);
}

#[inline(always)]
fn inverse_all(filter: Filter, float: bool, edge: u32, planes: &[&[u8]], raw: &mut [u8]) {
    match edge {
        8 => inverse_width::<8>(filter, float, planes, raw),
        16 => inverse_width::<16>(filter, float, planes, raw),
        32 => inverse_width::<32>(filter, float, planes, raw),
        _ => inverse_width::<64>(filter, float, planes, raw),
    }
}

#[inline(always)]
fn inverse_width<const E: usize>(filter: Filter, float: bool, planes: &[&[u8]], raw: &mut [u8]) {
    match *planes {
        [a] => inverse_rows::<1, u8, E>(filter, [a], raw),
        [a, b] => inverse_rows::<2, u16, E>(filter, [a, b], raw),
        [a, b, c, d] if filter == Filter::Smooth => inverse_smooth::<E>([a, b, c, d], raw),
        [a, b, c, d] => {
            inverse_rows::<4, u32, E>(filter, [a, b, c, d], raw);
            if float && filter != Filter::Planes {
                for bytes in raw.as_chunks_mut::<4>().0 {
                    *bytes = f32_unkey(u32::from_le_bytes(*bytes)).to_le_bytes();
                }
            }
        }
        _ => unreachable!("samples have 1, 2 or 4 bytes"),
    }
}

#[inline(always)]
fn load_planes<const W: usize, T: Word, const E: usize>(planes: &[&[u8]; W], row: usize) -> [T; E] {
    let mut words = [T::default(); E];
    for (b, plane) in planes.iter().enumerate() {
        let bytes: &[u8; E] = plane[row * E..]
            .first_chunk()
            .expect("row inside the plane");
        for i in 0..E {
            words[i] = words[i].with_byte(b, bytes[i]);
        }
    }
    words
}

#[inline(always)]
fn store<const W: usize, T: Word, const E: usize>(words: &[T; E], out: &mut [[u8; W]]) {
    for (bytes, word) in out.iter_mut().zip(words) {
        for (b, byte) in bytes.iter_mut().enumerate() {
            *byte = word.byte(b);
        }
    }
}

#[inline(always)]
fn inverse_rows<const W: usize, T: Word, const E: usize>(
    filter: Filter,
    planes: [&[u8]; W],
    raw: &mut [u8],
) {
    let (samples, _) = raw.as_chunks_mut::<W>();
    for row in 0..samples.len() / E {
        let mut words = load_planes::<W, T, E>(&planes, row);
        let (done, rest) = samples.split_at_mut(row * E);
        match filter {
            Filter::Planes => {}
            Filter::Delta => {
                let mut before = if row == 0 {
                    T::default()
                } else {
                    load::<W, T, E>(done, row - 1)[0]
                };
                for word in &mut words {
                    *word = word.unzigzag().add(before);
                    before = *word;
                }
            }
            _ => {
                let back = |n: usize| load::<W, T, E>(done, row - n);
                let prediction = predict_plane::<T, E>(row % E, row / E, back);
                for i in 0..E {
                    words[i] = words[i].unzigzag().add(prediction[i]);
                }
            }
        }
        store::<W, T, E>(&words, &mut rest[..E]);
    }
}

#[inline(always)]
fn inverse_smooth<const E: usize>(planes: [&[u8]; 4], raw: &mut [u8]) {
    let (samples, _) = raw.as_chunks_mut::<4>();
    for row in 0..samples.len() / E {
        let mut words = load_planes::<4, u32, E>(&planes, row);
        let (done, rest) = samples.split_at_mut(row * E);
        let prediction = predict_smooth::<E>(done, row);
        for i in 0..E {
            words[i] = f32_unkey(words[i].unzigzag().wrapping_add(prediction[i]));
        }
        store::<4, u32, E>(&words, &mut rest[..E]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_levels_give_the_same_bytes() {
        let mut seed = 3u32;
        let mut random = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 8) as u8
        };
        for (edge, width, float) in [
            (8, 4, true),
            (16, 4, true),
            (32, 4, false),
            (32, 2, false),
            (16, 1, false),
        ] {
            let raw: Vec<u8> = (0..edge * edge * edge * width).map(|_| random()).collect();
            for filter in [
                Filter::Planes,
                Filter::Delta,
                Filter::Plane3,
                Filter::Smooth,
            ] {
                if filter == Filter::Smooth && !float {
                    continue;
                }
                let mut want = vec![0; raw.len()];
                forward_all(filter, (width, float, edge as u32), &raw, &mut want);
                for &level in Level::available() {
                    let mut planes = vec![0; raw.len()];
                    vector::forward(
                        level,
                        filter,
                        (width, float, edge as u32),
                        &raw,
                        &mut planes,
                    );
                    assert_eq!(planes, want, "{filter:?} {level:?}");
                    let mut back = vec![0; raw.len()];
                    let parts: Vec<&[u8]> = planes.chunks(raw.len() / width).collect();
                    vector::inverse(level, filter, float, edge as u32, &parts, &mut back);
                    assert_eq!(back, raw, "{filter:?} {level:?}");
                }
            }
        }
    }

    #[test]
    fn zigzag_and_keys_are_bijections() {
        for v in 0..=u16::MAX {
            assert_eq!(v.zigzag().unzigzag(), v);
            let bits = u32::from(v) << 16 | u32::from(v.wrapping_mul(31));
            assert_eq!(f32_unkey(f32_key(bits)), bits);
            assert_eq!(bits.zigzag().unzigzag(), bits);
        }
        assert_eq!((0u8.zigzag(), 255u8.zigzag(), 1u8.zigzag()), (0, 1, 2));
    }
}
