//! Codec 6: bricks of f32 as rows of 16 samples, each predicted from rows before it; made for
//! narrow bands, which are clipped to two values, and for smooth dense fields.
//!
//! Most samples of a band are one of two *clip* values; bit masks say which. Only the others, the
//! *active* ones, have a residual: the difference of their key to that of a prediction from active
//! samples of rows before (along y and z only, so that 16 samples go side by side). Residuals are
//! packed with one number of bits for the samples of a row that had enough neighbours, and another
//! for the rest of the row. There is no entropy coder behind: decoding is shifts, masks and a few
//! floating-point operations. Bytes: section 9 of `docs/format.md`.
//!
//! A missing neighbour is a NaN in the prediction, so whatever needs it is a NaN as well, and the
//! next weaker prediction is taken.

use super::filter::{build, f32_unkey};
use super::layout::{get_u32, put_u32};
use super::value::f32_key;
use crate::cpu::Level;

#[path = "rows_vector.rs"]
mod vector;

pub(super) use vector::Basic;
#[cfg(target_arch = "x86_64")]
pub(super) use vector::{Avx2, Avx512};

/// Samples of a group; bricks of edge 8 leave the upper half empty.
const LANES: usize = 16;
/// Lowest and highest clip value, bytes of masks, bytes of widths: four u32.
const HEADER: usize = 16;
/// The longest packed group: 16 words of 32 bits.
pub(super) const WINDOW: usize = 4 * LANES;
/// Bits of what is not there.
const MISSING: u32 = f32::NAN.to_bits();

/// How a group's masks are stored: two bits.
const LIKE_Y: u8 = 0;
const LIKE_Z: u8 = 1;
const INTERVAL: u8 = 2;

/// What differs between processors: floats and words of 16 lanes, on which all else is built.
pub(super) trait Lanes {
    type Floats: Copy;
    type Words: Copy;

    fn float(value: f32) -> Self::Floats;
    fn add(a: Self::Floats, b: Self::Floats) -> Self::Floats;
    fn sub(a: Self::Floats, b: Self::Floats) -> Self::Floats;
    fn mul(a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// `a`, or `b` where that is a NaN.
    fn or(a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// The lanes that are NaN.
    fn nans(a: Self::Floats) -> u16;
    fn bits(a: Self::Floats) -> Self::Words;
    fn floats(a: Self::Words) -> Self::Floats;

    fn word(value: u32) -> Self::Words;
    fn load(words: &[u32; LANES]) -> Self::Words;
    fn store(a: Self::Words, words: &mut [u32; LANES]);
    fn load_samples(samples: &[[u8; 4]; LANES]) -> Self::Words;
    fn store_samples(a: Self::Words, samples: &mut [[u8; 4]; LANES]);
    fn plus(a: Self::Words, b: Self::Words) -> Self::Words;
    fn minus(a: Self::Words, b: Self::Words) -> Self::Words;
    fn xor(a: Self::Words, b: Self::Words) -> Self::Words;
    fn and(a: Self::Words, b: Self::Words) -> Self::Words;
    /// Shifted right by one.
    fn half(a: Self::Words) -> Self::Words;
    /// All ones where the highest bit is set.
    fn sign(a: Self::Words) -> Self::Words;
    /// The lanes that are equal.
    fn equal(a: Self::Words, b: Self::Words) -> u16;
    /// Lanes of `yes` where `mask` is set, else of `no`.
    fn blend(mask: u16, yes: Self::Words, no: Self::Words) -> Self::Words;
    /// Words of `width` bits from the start of `window`, one for each lane of `mask`, the others 0.
    fn unpack(window: &[u8; WINDOW], width: u8, mask: u16) -> Self::Words;

    /// A number that sorts as the floats do, read as signed: differences are those of the keys.
    #[inline(always)]
    fn key(bits: Self::Words) -> Self::Words {
        let low = Self::and(Self::sign(bits), Self::word(0x7fff_ffff));
        Self::xor(bits, low)
    }

    #[inline(always)]
    fn zigzag(d: Self::Words) -> Self::Words {
        Self::xor(Self::plus(d, d), Self::sign(d))
    }

    #[inline(always)]
    fn unzigzag(word: Self::Words) -> Self::Words {
        let odd = Self::and(word, Self::word(1));
        Self::xor(Self::half(word), Self::minus(Self::word(0), odd))
    }
}

pub(super) struct Portable;

impl Lanes for Portable {
    type Floats = [f32; LANES];
    type Words = [u32; LANES];

    #[inline(always)]
    fn float(value: f32) -> [f32; LANES] {
        [value; LANES]
    }

    #[inline(always)]
    fn add(a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        build(|i| a[i] + b[i])
    }

    #[inline(always)]
    fn sub(a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        build(|i| a[i] - b[i])
    }

    #[inline(always)]
    fn mul(a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        build(|i| a[i] * b[i])
    }

    #[inline(always)]
    fn or(a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        build(|i| if a[i].is_nan() { b[i] } else { a[i] })
    }

    #[inline(always)]
    fn nans(a: [f32; LANES]) -> u16 {
        (0..LANES).fold(0, |m, i| m | u16::from(a[i].is_nan()) << i)
    }

    #[inline(always)]
    fn bits(a: [f32; LANES]) -> [u32; LANES] {
        build(|i| a[i].to_bits())
    }

    #[inline(always)]
    fn floats(a: [u32; LANES]) -> [f32; LANES] {
        build(|i| f32::from_bits(a[i]))
    }

    #[inline(always)]
    fn word(value: u32) -> [u32; LANES] {
        [value; LANES]
    }

    #[inline(always)]
    fn load(words: &[u32; LANES]) -> [u32; LANES] {
        *words
    }

    #[inline(always)]
    fn store(a: [u32; LANES], words: &mut [u32; LANES]) {
        *words = a;
    }

    #[inline(always)]
    fn load_samples(samples: &[[u8; 4]; LANES]) -> [u32; LANES] {
        build(|i| u32::from_le_bytes(samples[i]))
    }

    #[inline(always)]
    fn store_samples(a: [u32; LANES], samples: &mut [[u8; 4]; LANES]) {
        *samples = build(|i| a[i].to_le_bytes());
    }

    #[inline(always)]
    fn plus(a: [u32; LANES], b: [u32; LANES]) -> [u32; LANES] {
        build(|i| a[i].wrapping_add(b[i]))
    }

    #[inline(always)]
    fn minus(a: [u32; LANES], b: [u32; LANES]) -> [u32; LANES] {
        build(|i| a[i].wrapping_sub(b[i]))
    }

    #[inline(always)]
    fn xor(a: [u32; LANES], b: [u32; LANES]) -> [u32; LANES] {
        build(|i| a[i] ^ b[i])
    }

    #[inline(always)]
    fn and(a: [u32; LANES], b: [u32; LANES]) -> [u32; LANES] {
        build(|i| a[i] & b[i])
    }

    #[inline(always)]
    fn half(a: [u32; LANES]) -> [u32; LANES] {
        build(|i| a[i] >> 1)
    }

    #[inline(always)]
    fn sign(a: [u32; LANES]) -> [u32; LANES] {
        build(|i| (a[i] as i32 >> 31) as u32)
    }

    #[inline(always)]
    fn equal(a: [u32; LANES], b: [u32; LANES]) -> u16 {
        (0..LANES).fold(0, |m, i| m | u16::from(a[i] == b[i]) << i)
    }

    #[inline(always)]
    fn blend(mask: u16, yes: [u32; LANES], no: [u32; LANES]) -> [u32; LANES] {
        build(|i| {
            let on = 0u32.wrapping_sub(u32::from(mask >> i & 1));
            yes[i] & on | no[i] & !on
        })
    }

    #[inline(always)]
    fn unpack(window: &[u8; WINDOW], width: u8, mask: u16) -> [u32; LANES] {
        let mut words = [0; LANES];
        let mut bit = 0;
        for (i, word) in words.iter_mut().enumerate() {
            // All ones for a lane of the mask; branches would be guessed wrong.
            let on = 0u32.wrapping_sub(u32::from(mask >> i & 1));
            let four: &[u8; 4] = window[bit / 8..]
                .first_chunk()
                .expect("no word of these widths ends behind the window");
            *word = u32::from_le_bytes(*four) >> (bit % 8) & mask_of(width) & on;
            bit += usize::from(width) & on as usize;
        }
        words
    }
}

#[inline(always)]
fn mask_of(width: u8) -> u32 {
    ((1u64 << width) - 1) as u32
}

/// The least width that is stored for words of so many bits: a word never takes part in five bytes.
fn stored_width(bits: u32) -> u8 {
    match bits {
        0..=26 => bits as u8,
        27 | 28 => 28,
        _ => 32,
    }
}

#[inline(always)]
fn is_width(width: u8) -> bool {
    width <= 26 || width == 28 || width == 32
}

/// The last four slices of a stripe of 16 samples along x, for the slices that follow.
struct Ring {
    /// Bits of active samples; the others are NaN.
    values: [[[u32; LANES]; 64]; 4],
    /// Active lanes, and shifted by 16 the inactive lanes at the high clip value.
    masks: [[u32; 64]; 4],
}

impl Ring {
    #[inline(always)]
    fn new() -> Self {
        Self {
            values: [[[MISSING; LANES]; 64]; 4],
            masks: [[0; 64]; 4],
        }
    }

    /// Forgets the stripe before.
    #[inline(always)]
    fn clear(&mut self, edge: usize) {
        for (values, masks) in self.values.iter_mut().zip(&mut self.masks) {
            values[..edge].fill([MISSING; LANES]);
            masks[..edge].fill(0);
        }
    }
}

/// The neighbours of a group, carried from row to row: `a` at y - 1 to y - 3, `b` at z - 1 to
/// z - 3, `c` at y - 1 and y - 2 of z - 1, `d` of z - 2. Missing ones are NaN.
struct Near<L: Lanes> {
    a: [L::Floats; 3],
    b: [L::Floats; 3],
    c: [L::Floats; 2],
    d: [L::Floats; 2],
    masks_a: [u32; 3],
    masks_b: [u32; 3],
    masks_c: [u32; 2],
    masks_d: [u32; 2],
    /// The sample at y - 1, in the first row of a slice at z - 1: the prediction of last resort.
    last: L::Words,
}

impl<L: Lanes> Near<L> {
    /// Before the first row of a slice.
    #[inline(always)]
    fn new(last: L::Words) -> Self {
        let none = L::float(f32::NAN);
        Self {
            a: [none; 3],
            b: [none; 3],
            c: [none; 2],
            d: [none; 2],
            masks_a: [0; 3],
            masks_b: [0; 3],
            masks_c: [0; 2],
            masks_d: [0; 2],
            last,
        }
    }

    /// Goes on to row `j` of slice `k`.
    #[inline(always)]
    fn enter(&mut self, ring: &Ring, j: usize, k: usize) {
        let [s1, s2, s3] = [(k + 3) & 3, (k + 2) & 3, (k + 1) & 3];
        self.b = [
            L::floats(L::load(&ring.values[s1][j])),
            L::floats(L::load(&ring.values[s2][j])),
            L::floats(L::load(&ring.values[s3][j])),
        ];
        self.masks_b = [ring.masks[s1][j], ring.masks[s2][j], ring.masks[s3][j]];
    }

    /// Leaves row `j` of slice `k`, whose samples are `bits`.
    #[inline(always)]
    fn leave(&mut self, ring: &mut Ring, j: usize, k: usize, mask: u32, bits: L::Words) {
        let known = L::blend(mask as u16, bits, L::word(MISSING));
        L::store(known, &mut ring.values[k & 3][j]);
        ring.masks[k & 3][j] = mask;
        self.a = [L::floats(known), self.a[0], self.a[1]];
        self.c = [self.b[0], self.c[0]];
        self.d = [self.b[1], self.d[0]];
        self.masks_a = [mask, self.masks_a[0], self.masks_a[1]];
        self.masks_c = [self.masks_b[0], self.masks_c[0]];
        self.masks_d = [self.masks_b[1], self.masks_d[0]];
        self.last = bits;
    }

    /// Lanes whose neighbours allow a prediction of second order.
    #[inline(always)]
    fn good(&self) -> u16 {
        let (a, b, c, d) = (self.masks_a, self.masks_b, self.masks_c, self.masks_d);
        let mixed = a[0] & b[0] & c[0] & (a[1] & c[1] | b[1] & d[0]);
        (mixed | a[0] & a[1] & a[2] | b[0] & b[1] & b[2]) as u16
    }

    /// Keys of the predictions for the lanes of `active`. The order of the operations is part of
    /// the format.
    #[inline(always)]
    fn predict(&self, active: u16) -> L::Words {
        let ([a1, a2, a3], [b1, b2, b3]) = (self.a, self.b);
        let ([c1, c2], [d1, d2]) = (self.c, self.d);
        let two = L::float(2.0);
        // 2 f - g
        let on = |f: L::Floats, g: L::Floats| L::sub(L::mul(two, f), g);
        let line = on(a1, a2);
        let (miss, miss2) = (L::sub(b1, on(c1, c2)), L::sub(b2, on(d1, d2)));
        let mut guess = L::add(line, on(miss, miss2));
        if L::nans(guess) & active != 0 {
            let three = L::float(3.0);
            let square = |f, g, h| L::add(L::mul(three, L::sub(f, g)), h);
            let line_z = on(b1, b2);
            // From the weakest to the best, so that no choice waits for the one before.
            let ways = [
                L::floats(self.last),
                b1,
                a1,
                line_z,
                line,
                L::sub(L::add(a1, b1), c1),
                square(b1, b2, b3),
                square(a1, a2, a3),
                L::add(line_z, L::sub(a1, on(c1, d1))),
                L::add(line, miss),
                guess,
            ];
            guess = L::float(0.0);
            for way in ways {
                guess = L::or(way, guess);
            }
        }
        L::key(L::bits(guess))
    }
}

/// Place of a row of a stripe in the brick, in samples.
#[inline(always)]
fn row_at(edge: usize, stripe: usize, j: usize, k: usize) -> usize {
    (k * edge + j) * edge + stripe * LANES
}

/// The samples of a group; lanes beyond a short row are 0.
#[inline(always)]
fn load<L: Lanes>(samples: &[[u8; 4]], at: usize, edge: usize) -> L::Words {
    if edge < LANES {
        let mut row = [[0; 4]; LANES];
        row[..edge].copy_from_slice(&samples[at..at + edge]);
        return L::load_samples(&row);
    }
    L::load_samples(samples[at..].first_chunk().expect("a row of the brick"))
}

#[inline(always)]
fn store<L: Lanes>(words: L::Words, samples: &mut [[u8; 4]], at: usize, edge: usize) {
    if edge < LANES {
        let mut row = [[0; 4]; LANES];
        L::store_samples(words, &mut row);
        samples[at..at + edge].copy_from_slice(&row[..edge]);
        return;
    }
    let row = samples[at..].first_chunk_mut().expect("a row of the brick");
    L::store_samples(words, row);
}

/// Lanes of a group.
#[inline(always)]
fn lanes_of(edge: usize) -> u32 {
    edge.min(LANES) as u32
}

/// All lanes of a group.
#[inline(always)]
fn all_of(edge: usize) -> u16 {
    if edge < LANES { 0xff } else { 0xffff }
}

// ---- decoding ----------------------------------------------------------------------------------

/// Decodes a whole brick into `out`.
///
/// # Errors
/// What is wrong with the stream, as a phrase.
pub(crate) fn decode(stored: &[u8], edge: u32, out: &mut [u8]) -> Result<(), &'static str> {
    vector::decode(Level::detect(), stored, edge, out)
}

/// Takes the masks of the groups from their stream, one by one.
struct Masks<'a> {
    codes: &'a [u8],
    rest: &'a [u8],
    next: usize,
}

impl<'a> Masks<'a> {
    /// None: all samples are active.
    fn new(bytes: &'a [u8], groups: usize) -> Result<Option<Self>, &'static str> {
        if bytes.is_empty() {
            return Ok(None);
        }
        let (codes, rest) = bytes
            .split_at_checked(groups / 4)
            .ok_or("the masks are cut off")?;
        Ok(Some(Self {
            codes,
            rest,
            next: 0,
        }))
    }

    #[inline(always)]
    fn next(&mut self, y: u32, z: u32, lanes: u32) -> Result<u32, &'static str> {
        let code = self.codes[self.next / 4] >> (self.next % 4 * 2) & 3;
        self.next += 1;
        match code {
            LIKE_Y => Ok(y),
            LIKE_Z => Ok(z),
            INTERVAL => {
                let (two, rest) = self.rest.split_first_chunk().ok_or("a mask is cut off")?;
                self.rest = rest;
                let word = u32::from(u16::from_le_bytes(*two));
                let (from, to) = (word & 31, word >> 5 & 31);
                if from > to || to > lanes || word >> 12 != 0 {
                    return Err("a mask is no interval");
                }
                let (low, below) = ((1 << from) - 1, (1 << to) - 1);
                let all = (1 << lanes) - 1;
                let high = (low * (word >> 10 & 1)) | ((all & !below) * (word >> 11 & 1));
                Ok(below & !low | high << LANES)
            }
            _ => {
                let (four, rest) = self.rest.split_first_chunk().ok_or("a mask is cut off")?;
                self.rest = rest;
                let mask = u32::from_le_bytes(*four);
                let (active, high) = (mask & 0xffff, mask >> 16);
                if active & high != 0 || (active | high) >> lanes != 0 {
                    return Err("masks contradict each other");
                }
                Ok(mask)
            }
        }
    }
}

/// Takes the residuals of the groups from their streams.
struct Residuals<'a> {
    widths: &'a [u8],
    words: &'a [u8],
}

impl Residuals<'_> {
    #[inline(always)]
    fn next<L: Lanes>(&mut self, mask: u16) -> Result<L::Words, &'static str> {
        let (&width, widths) = self.widths.split_first().ok_or("a width is cut off")?;
        self.widths = widths;
        if !is_width(width) {
            return Err("a width is none of those allowed");
        }
        let bytes = (mask.count_ones() as usize * usize::from(width)).div_ceil(8);
        let words = match self.words.first_chunk() {
            Some(window) => L::unpack(window, width, mask),
            None => {
                let mut window = [0; WINDOW];
                window[..self.words.len()].copy_from_slice(self.words);
                L::unpack(&window, width, mask)
            }
        };
        self.words = self.words.get(bytes..).ok_or("the residuals are cut off")?;
        Ok(words)
    }
}

#[inline(always)]
fn decode_all<L: Lanes>(stored: &[u8], edge: u32, out: &mut [u8]) -> Result<(), &'static str> {
    match edge {
        8 => decode_edge::<L, 8>(stored, out),
        16 => decode_edge::<L, 16>(stored, out),
        32 => decode_edge::<L, 32>(stored, out),
        _ => decode_edge::<L, 64>(stored, out),
    }
}

#[inline(always)]
fn decode_edge<L: Lanes, const E: usize>(
    stored: &[u8],
    out: &mut [u8],
) -> Result<(), &'static str> {
    let (head, rest) = stored
        .split_at_checked(HEADER)
        .ok_or("the start is cut off")?;
    let (low, high) = (get_u32(head, 0), get_u32(head, 4));
    let (masks, rest) = rest
        .split_at_checked(get_u32(head, 8) as usize)
        .ok_or("the masks are cut off")?;
    let (widths, words) = rest
        .split_at_checked(get_u32(head, 12) as usize)
        .ok_or("the widths are cut off")?;
    let (samples, _) = out.as_chunks_mut::<4>();
    let slices = samples.len() / (E * E);
    let stripes = E.div_ceil(LANES);
    let mut masks = Masks::new(masks, slices * E * stripes)?;
    let mut residuals = Residuals { widths, words };
    let (lanes, all) = (lanes_of(E), u32::from(all_of(E)));
    let (low, high) = (L::word(low), L::word(high));
    let mut ring = Ring::new();
    for stripe in 0..stripes {
        if stripe > 0 {
            ring.clear(E);
        }
        for k in 0..slices {
            let mut near = Near::<L>::new(match k {
                0 => L::word(0),
                _ => load::<L>(samples, row_at(E, stripe, 0, k - 1), E),
            });
            for j in 0..E {
                near.enter(&ring, j, k);
                let mask = match &mut masks {
                    None => all,
                    Some(masks) => masks.next(near.masks_a[0], near.masks_b[0], lanes)?,
                };
                let active = mask as u16;
                let mut bits = L::blend((mask >> 16) as u16, high, low);
                if active != 0 {
                    let good = near.good() & active;
                    let mut words = L::word(0);
                    if good != 0 {
                        words = residuals.next::<L>(good)?;
                    }
                    if good != active {
                        words = L::xor(words, residuals.next::<L>(active & !good)?);
                    }
                    let key = L::plus(near.predict(active), L::unzigzag(words));
                    bits = L::blend(active, L::key(key), bits);
                }
                store::<L>(bits, samples, row_at(E, stripe, j, k), E);
                near.leave(&mut ring, j, k, mask, bits);
            }
        }
    }
    if masks.is_some_and(|m| !m.rest.is_empty())
        || !residuals.widths.is_empty()
        || !residuals.words.is_empty()
    {
        return Err("bytes are left over");
    }
    Ok(())
}

// ---- encoding ----------------------------------------------------------------------------------

/// Working buffers.
#[derive(Default)]
pub(crate) struct RowsEncoder {
    codes: Vec<u8>,
    masks: Vec<u8>,
    widths: Vec<u8>,
    words: Vec<u8>,
}

impl RowsEncoder {
    /// Appends the stored form of whole slices of a brick.
    pub(crate) fn encode(&mut self, edge: u32, raw: &[u8], out: &mut Vec<u8>) {
        self.encode_at(Level::detect(), edge, raw, out);
    }

    fn encode_at(&mut self, level: Level, edge: u32, raw: &[u8], out: &mut Vec<u8>) {
        self.codes.clear();
        self.masks.clear();
        self.widths.clear();
        self.words.clear();
        let clips = vector::encode(level, self, edge, raw);
        let start = out.len();
        out.resize(start + HEADER, 0);
        let (low, high) = clips.unwrap_or((0, 0));
        put_u32(out, start, low);
        put_u32(out, start + 4, high);
        let masks = self.codes.len() + self.masks.len();
        put_u32(out, start + 8, masks as u32);
        put_u32(out, start + 12, self.widths.len() as u32);
        for part in [&self.codes, &self.masks, &self.widths, &self.words] {
            out.extend_from_slice(part);
        }
    }

    #[inline(always)]
    fn encode_all<L: Lanes>(&mut self, edge: u32, raw: &[u8]) -> Option<(u32, u32)> {
        let (samples, _) = raw.as_chunks::<4>();
        let clips = clips_of(samples);
        match edge {
            8 => self.encode_edge::<L, 8>(samples, clips),
            16 => self.encode_edge::<L, 16>(samples, clips),
            32 => self.encode_edge::<L, 32>(samples, clips),
            _ => self.encode_edge::<L, 64>(samples, clips),
        }
        clips
    }

    #[inline(always)]
    fn encode_edge<L: Lanes, const E: usize>(
        &mut self,
        samples: &[[u8; 4]],
        clips: Option<(u32, u32)>,
    ) {
        let mut ring = Ring::new();
        let mut groups = 0;
        for stripe in 0..E.div_ceil(LANES) {
            if stripe > 0 {
                ring.clear(E);
            }
            for k in 0..samples.len() / (E * E) {
                let mut near = Near::<L>::new(match k {
                    0 => L::word(0),
                    _ => load::<L>(samples, row_at(E, stripe, 0, k - 1), E),
                });
                for j in 0..E {
                    near.enter(&ring, j, k);
                    let bits = load::<L>(samples, row_at(E, stripe, j, k), E);
                    let mut mask = u32::from(all_of(E));
                    if let Some((low, high)) = clips {
                        let low = L::equal(bits, L::word(low)) & all_of(E);
                        let high = L::equal(bits, L::word(high)) & all_of(E) & !low;
                        mask = mask & !u32::from(low | high) | u32::from(high) << 16;
                        let before = (near.masks_a[0], near.masks_b[0]);
                        self.put_mask(groups, mask, before, lanes_of(E));
                    }
                    groups += 1;
                    let active = mask as u16;
                    if active != 0 {
                        let d = L::minus(L::key(bits), near.predict(active));
                        let words = L::zigzag(d);
                        let good = near.good() & active;
                        if good != 0 {
                            self.put_words::<L>(good, words);
                        }
                        if good != active {
                            self.put_words::<L>(active & !good, words);
                        }
                    }
                    near.leave(&mut ring, j, k, mask, bits);
                }
            }
        }
    }

    fn put_mask(&mut self, group: usize, mask: u32, (y, z): (u32, u32), lanes: u32) {
        if group.is_multiple_of(4) {
            self.codes.push(0);
        }
        let code = if mask == y {
            LIKE_Y
        } else if mask == z {
            LIKE_Z
        } else if let Some(word) = interval(mask, lanes) {
            self.masks.extend_from_slice(&word.to_le_bytes());
            INTERVAL
        } else {
            self.masks.extend_from_slice(&mask.to_le_bytes());
            3
        };
        if let Some(codes) = self.codes.last_mut() {
            *codes |= code << (group % 4 * 2);
        }
    }

    /// Words of the lanes of `mask`.
    #[inline(always)]
    fn put_words<L: Lanes>(&mut self, mask: u16, all: L::Words) {
        let mut words = [0; LANES];
        L::store(L::blend(mask, all, L::word(0)), &mut words);
        let any = words.iter().fold(0, |any, word| any | word);
        let width = stored_width(u32::BITS - any.leading_zeros());
        self.widths.push(width);
        let mut packed = [0u8; WINDOW + 8];
        let (mut held, mut bits, mut at, mut left) = (0u64, 0u32, 0, mask);
        while left != 0 {
            held |= u64::from(words[left.trailing_zeros() as usize & 15]) << bits;
            left &= left - 1;
            bits += u32::from(width);
            // At most 7 bits stay, and 32 more come.
            packed[at..at + 8].copy_from_slice(&held.to_le_bytes());
            at += (bits / 8) as usize;
            held >>= bits & !7;
            bits &= 7;
        }
        let length = (mask.count_ones() as usize * usize::from(width)).div_ceil(8);
        self.words.extend_from_slice(&packed[..length]);
    }
}

/// The mask as one run of active lanes, when it is.
fn interval(mask: u32, lanes: u32) -> Option<u16> {
    let (active, high) = (mask & 0xffff, mask >> 16);
    let (from, to) = if active == 0 {
        // Where the clip values change.
        let from = if high & 1 != 0 {
            high.trailing_ones()
        } else {
            high.trailing_zeros().min(lanes)
        };
        (from, from)
    } else {
        (active.trailing_zeros(), 32 - active.leading_zeros())
    };
    let (low, below, all) = ((1 << from) - 1, (1 << to) - 1, (1u32 << lanes) - 1);
    let left = high & 1;
    let right = high >> (lanes - 1) & 1;
    let fits = active == below & !low && high == (low * left) | ((all & !below) * right);
    // An empty side says 0, so that there is one form only.
    let (left, right) = (left * u32::from(from > 0), right * u32::from(to < lanes));
    fits.then_some((from | to << 5 | left << 10 | right << 11) as u16)
}

/// Bits of the smallest and largest sample, of those that are frequent enough to be worth masks.
#[inline(always)]
fn clips_of(samples: &[[u8; 4]]) -> Option<(u32, u32)> {
    let keys = samples.iter().map(|s| f32_key(u32::from_le_bytes(*s)));
    let (low, high) = keys.fold((u32::MAX, 0), |(low, high), key| {
        (low.min(key), high.max(key))
    });
    let (low, high) = (f32_unkey(low), f32_unkey(high));
    let count = |bits: u32| -> usize {
        let same = samples.iter().map(|s| u32::from(*s == bits.to_le_bytes()));
        same.sum::<u32>() as usize
    };
    let enough = samples.len() / 64;
    match (count(low) > enough, count(high) > enough) {
        (true, true) => Some((low, high)),
        (true, false) => Some((low, low)),
        (false, true) => Some((high, high)),
        (false, false) => None,
    }
}

#[cfg(test)]
#[path = "rows_tests.rs"]
mod tests;
