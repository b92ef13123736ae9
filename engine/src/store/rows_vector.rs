//! Codec 6 compiled for three kinds of processor; the same bytes. Only the lanes are
//! written by hand.

#![expect(
    unsafe_code,
    reason = "calls into code compiled for instructions that were found present"
)]

#[cfg(not(target_arch = "x86_64"))]
pub(in crate::store) use super::Portable as Basic;
use super::{Level, RowsEncoder, decode_all};
#[cfg(target_arch = "x86_64")]
pub(in crate::store) use x86::{Avx2, Avx512, Sse2 as Basic};

pub(super) fn decode(
    level: Level,
    stored: &[u8],
    edge: u32,
    out: &mut [u8],
) -> Result<(), &'static str> {
    match level {
        Level::Portable => decode_all::<Basic>(stored, edge, out),
        // SAFETY: a level exists only where the processor has its instructions.
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => unsafe { x86::decode_avx2(stored, edge, out) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => unsafe { x86::decode_avx512(stored, edge, out) },
    }
}

pub(super) fn encode(
    level: Level,
    encoder: &mut RowsEncoder,
    edge: u32,
    raw: &[u8],
) -> Option<(u32, u32)> {
    match level {
        Level::Portable => encoder.encode_all::<Basic>(edge, raw),
        // SAFETY: a level exists only where the processor has its instructions.
        #[cfg(target_arch = "x86_64")]
        Level::Avx2 => unsafe { x86::encode_avx2(encoder, edge, raw) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Level::Avx512 => unsafe { x86::encode_avx512(encoder, edge, raw) },
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::super::{LANES, Lanes, Portable, RowsEncoder, WINDOW, decode_all, mask_of};
    use std::arch::x86_64::*;

    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) fn decode_avx2(
        stored: &[u8],
        edge: u32,
        out: &mut [u8],
    ) -> Result<(), &'static str> {
        decode_all::<Avx2>(stored, edge, out)
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) fn decode_avx512(
        stored: &[u8],
        edge: u32,
        out: &mut [u8],
    ) -> Result<(), &'static str> {
        decode_all::<Avx512>(stored, edge, out)
    }

    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) fn encode_avx2(
        encoder: &mut RowsEncoder,
        edge: u32,
        raw: &[u8],
    ) -> Option<(u32, u32)> {
        encoder.encode_all::<Avx2>(edge, raw)
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) fn encode_avx512(
        encoder: &mut RowsEncoder,
        edge: u32,
        raw: &[u8],
    ) -> Option<(u32, u32)> {
        encoder.encode_all::<Avx512>(edge, raw)
    }

    /// Bytes to take for each word of a width: four words from each of the four places
    /// [`offset`]; and by how many bits to shift them.
    struct Places {
        bytes: [u8; WINDOW],
        shifts: [u32; LANES],
    }

    /// Byte where four words start, and a little before for odd widths.
    #[inline(always)]
    const fn offset(four: usize, width: usize) -> usize {
        four * width / 2
    }

    static PLACES: [Places; 33] = {
        const NONE: Places = Places {
            bytes: [0; WINDOW],
            shifts: [0; LANES],
        };
        let mut all = [NONE; 33];
        let mut width = 0;
        while width < 33 {
            let mut i = 0;
            while i < LANES {
                let bit = i * width;
                all[width].shifts[i] = (bit % 8) as u32;
                let mut b = 0;
                while b < 4 {
                    // Beyond the 16 bytes only for widths that are not allowed, and for bytes that
                    // the mask removes.
                    let byte = bit / 8 + b - offset(i / 4, width);
                    all[width].bytes[4 * i + b] = if byte < 16 { byte as u8 } else { 0x80 };
                    b += 1;
                }
                i += 1;
            }
            width += 1;
        }
        all
    };

    /// For each mask of eight lanes the number of lanes set below each lane.
    static RANKS: [[u8; 8]; 256] = {
        let mut all = [[0; 8]; 256];
        let mut mask = 0;
        while mask < 256 {
            let (mut i, mut rank) = (0, 0);
            while i < 8 {
                all[mask][i] = rank;
                rank += (mask >> i & 1) as u8;
                i += 1;
            }
            mask += 1;
        }
        all
    };

    /// Four words lie in the 16 bytes at their offset.
    #[inline(always)]
    fn four(window: &[u8; WINDOW], n: usize, width: u8) -> __m128i {
        let bytes: &[u8; 16] = window[offset(n, usize::from(width))..]
            .first_chunk()
            .expect("widths end at 32");
        // SAFETY: 16 bytes that may be read; SSE2 is part of the architecture.
        unsafe { _mm_loadu_si128(bytes.as_ptr().cast()) }
    }

    /// Methods that are one expression of intrinsics, all of one level.
    macro_rules! lanes {
        ($($name:ident($($arg:ident: $type:ty),*) -> $out:ty { $($body:tt)* })*) => {$(
            #[inline(always)]
            fn $name($($arg: $type),*) -> $out {
                // SAFETY: only called from code for this level; loads and stores are of arrays that
                // have the length of what is loaded.
                unsafe { $($body)* }
            }
        )*};
    }

    pub(in crate::store) struct Avx512;

    impl Lanes for Avx512 {
        type Floats = __m512;
        type Words = __m512i;

        lanes! {
            float(value: f32) -> __m512 { _mm512_set1_ps(value) }
            add(a: __m512, b: __m512) -> __m512 { _mm512_add_ps(a, b) }
            sub(a: __m512, b: __m512) -> __m512 { _mm512_sub_ps(a, b) }
            mul(a: __m512, b: __m512) -> __m512 { _mm512_mul_ps(a, b) }
            or(a: __m512, b: __m512) -> __m512 {
                _mm512_mask_blend_ps(_mm512_cmp_ps_mask::<_CMP_UNORD_Q>(a, a), a, b)
            }
            nans(a: __m512) -> u16 { _mm512_cmp_ps_mask::<_CMP_UNORD_Q>(a, a) }
            bits(a: __m512) -> __m512i { _mm512_castps_si512(a) }
            floats(a: __m512i) -> __m512 { _mm512_castsi512_ps(a) }
            word(value: u32) -> __m512i { _mm512_set1_epi32(value as i32) }
            load(words: &[u32; LANES]) -> __m512i { _mm512_loadu_si512(words.as_ptr().cast()) }
            store(a: __m512i, words: &mut [u32; LANES]) -> () {
                _mm512_storeu_si512(words.as_mut_ptr().cast(), a)
            }
            load_samples(samples: &[[u8; 4]; LANES]) -> __m512i {
                _mm512_loadu_si512(samples.as_ptr().cast())
            }
            store_samples(a: __m512i, samples: &mut [[u8; 4]; LANES]) -> () {
                _mm512_storeu_si512(samples.as_mut_ptr().cast(), a)
            }
            plus(a: __m512i, b: __m512i) -> __m512i { _mm512_add_epi32(a, b) }
            minus(a: __m512i, b: __m512i) -> __m512i { _mm512_sub_epi32(a, b) }
            xor(a: __m512i, b: __m512i) -> __m512i { _mm512_xor_si512(a, b) }
            and(a: __m512i, b: __m512i) -> __m512i { _mm512_and_si512(a, b) }
            half(a: __m512i) -> __m512i { _mm512_srli_epi32::<1>(a) }
            sign(a: __m512i) -> __m512i { _mm512_srai_epi32::<31>(a) }
            equal(a: __m512i, b: __m512i) -> u16 { _mm512_cmpeq_epi32_mask(a, b) }
            blend(mask: u16, yes: __m512i, no: __m512i) -> __m512i {
                _mm512_mask_blend_epi32(mask, no, yes)
            }
        }

        #[inline(always)]
        fn unpack(window: &[u8; WINDOW], width: u8, mask: u16) -> __m512i {
            let (a, b) = (four(window, 0, width), four(window, 1, width));
            let (c, d) = (four(window, 2, width), four(window, 3, width));
            let places = &PLACES[usize::from(width)];
            // SAFETY: only called from code for this level; the tables have 64 bytes.
            unsafe {
                let ab = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(a), b);
                let cd = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(c), d);
                let all = _mm512_inserti64x4::<1>(_mm512_castsi256_si512(ab), cd);
                let bytes = _mm512_loadu_si512(places.bytes.as_ptr().cast());
                let shifts = _mm512_loadu_si512(places.shifts.as_ptr().cast());
                let words = _mm512_srlv_epi32(_mm512_shuffle_epi8(all, bytes), shifts);
                let words = _mm512_and_si512(words, _mm512_set1_epi32(mask_of(width) as i32));
                _mm512_maskz_expand_epi32(mask, words)
            }
        }
    }

    pub(in crate::store) struct Avx2;

    /// Eight lanes all ones where the low bits of `mask` are set.
    #[inline(always)]
    fn wide(mask: u16) -> __m256i {
        // SAFETY: only called from code for AVX2.
        unsafe {
            let bits = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            let mask = _mm256_set1_epi32(i32::from(mask));
            _mm256_cmpeq_epi32(_mm256_and_si256(mask, bits), bits)
        }
    }

    /// Words 8 HALF to 8 HALF + 7 of `window`.
    #[inline(always)]
    fn eight<const HALF: usize>(window: &[u8; WINDOW], width: u8) -> __m256i {
        let (a, b) = (
            four(window, 2 * HALF, width),
            four(window, 2 * HALF + 1, width),
        );
        let places = &PLACES[usize::from(width)];
        // SAFETY: only called from code for AVX2; each half has 32 bytes.
        unsafe {
            let ab = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(a), b);
            let bytes = _mm256_loadu_si256(places.bytes[32 * HALF..].as_ptr().cast());
            let shifts = _mm256_loadu_si256(places.shifts[8 * HALF..].as_ptr().cast());
            let words = _mm256_srlv_epi32(_mm256_shuffle_epi8(ab, bytes), shifts);
            _mm256_and_si256(words, _mm256_set1_epi32(mask_of(width) as i32))
        }
    }

    /// For each of eight lanes the number of lanes of the mask below it.
    #[inline(always)]
    fn ranks(lanes: u16) -> __m256i {
        let bytes = RANKS[usize::from(lanes)].as_ptr();
        // SAFETY: only called from code for AVX2; ranks have 8 bytes.
        unsafe { _mm256_cvtepu8_epi32(_mm_loadl_epi64(bytes.cast())) }
    }

    /// Two halves.
    #[inline(always)]
    fn pair<A: Copy, B: Copy, C>(a: [A; 2], b: [B; 2], f: impl Fn(A, B) -> C) -> [C; 2] {
        [f(a[0], b[0]), f(a[1], b[1])]
    }

    type Floats2 = [__m256; 2];
    type Words2 = [__m256i; 2];

    impl Lanes for Avx2 {
        type Floats = Floats2;
        type Words = Words2;

        lanes! {
            float(value: f32) -> Floats2 { [_mm256_set1_ps(value); 2] }
            add(a: Floats2, b: Floats2) -> Floats2 { pair(a, b, |a, b| _mm256_add_ps(a, b)) }
            sub(a: Floats2, b: Floats2) -> Floats2 { pair(a, b, |a, b| _mm256_sub_ps(a, b)) }
            mul(a: Floats2, b: Floats2) -> Floats2 { pair(a, b, |a, b| _mm256_mul_ps(a, b)) }
            or(a: Floats2, b: Floats2) -> Floats2 {
                pair(a, b, |a, b| _mm256_blendv_ps(a, b, _mm256_cmp_ps::<_CMP_UNORD_Q>(a, a)))
            }
            nans(a: Floats2) -> u16 {
                let [a, b] = pair(a, a, |a, b| {
                    _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_UNORD_Q>(a, b))
                });
                (a | b << 8) as u16
            }
            bits(a: Floats2) -> Words2 { pair(a, a, |a, _| _mm256_castps_si256(a)) }
            floats(a: Words2) -> Floats2 { pair(a, a, |a, _| _mm256_castsi256_ps(a)) }
            word(value: u32) -> Words2 { [_mm256_set1_epi32(value as i32); 2] }
            load(words: &[u32; LANES]) -> Words2 {
                let half: *const __m256i = words.as_ptr().cast();
                [_mm256_loadu_si256(half), _mm256_loadu_si256(half.add(1))]
            }
            store(a: Words2, words: &mut [u32; LANES]) -> () {
                let half: *mut __m256i = words.as_mut_ptr().cast();
                _mm256_storeu_si256(half, a[0]);
                _mm256_storeu_si256(half.add(1), a[1])
            }
            load_samples(samples: &[[u8; 4]; LANES]) -> Words2 {
                let half: *const __m256i = samples.as_ptr().cast();
                [_mm256_loadu_si256(half), _mm256_loadu_si256(half.add(1))]
            }
            store_samples(a: Words2, samples: &mut [[u8; 4]; LANES]) -> () {
                let half: *mut __m256i = samples.as_mut_ptr().cast();
                _mm256_storeu_si256(half, a[0]);
                _mm256_storeu_si256(half.add(1), a[1])
            }
            plus(a: Words2, b: Words2) -> Words2 { pair(a, b, |a, b| _mm256_add_epi32(a, b)) }
            minus(a: Words2, b: Words2) -> Words2 { pair(a, b, |a, b| _mm256_sub_epi32(a, b)) }
            xor(a: Words2, b: Words2) -> Words2 { pair(a, b, |a, b| _mm256_xor_si256(a, b)) }
            and(a: Words2, b: Words2) -> Words2 { pair(a, b, |a, b| _mm256_and_si256(a, b)) }
            half(a: Words2) -> Words2 { pair(a, a, |a, _| _mm256_srli_epi32::<1>(a)) }
            sign(a: Words2) -> Words2 { pair(a, a, |a, _| _mm256_srai_epi32::<31>(a)) }
            equal(a: Words2, b: Words2) -> u16 {
                let [a, b] = pair(a, b, |a, b| {
                    _mm256_movemask_ps(_mm256_castsi256_ps(_mm256_cmpeq_epi32(a, b)))
                });
                (a | b << 8) as u16
            }
            blend(mask: u16, yes: Words2, no: Words2) -> Words2 {
                [
                    _mm256_blendv_epi8(no[0], yes[0], wide(mask)),
                    _mm256_blendv_epi8(no[1], yes[1], wide(mask >> 8)),
                ]
            }
        }

        #[inline(always)]
        fn unpack(window: &[u8; WINDOW], width: u8, mask: u16) -> Words2 {
            let (low, high) = (eight::<0>(window, width), eight::<1>(window, width));
            let (first, second) = (mask & 0xff, mask >> 8);
            // SAFETY: only called from code for this level.
            unsafe {
                let a = _mm256_permutevar8x32_epi32(low, ranks(first));
                let before = _mm256_set1_epi32(first.count_ones() as i32);
                let at = _mm256_add_epi32(ranks(second), before);
                let b = _mm256_blendv_epi8(
                    _mm256_permutevar8x32_epi32(low, at),
                    _mm256_permutevar8x32_epi32(high, at),
                    _mm256_cmpgt_epi32(at, _mm256_set1_epi32(7)),
                );
                [
                    _mm256_and_si256(a, wide(first)),
                    _mm256_and_si256(b, wide(second)),
                ]
            }
        }
    }

    /// What every processor of the architecture has.
    pub(in crate::store) struct Sse2;

    type Floats4 = [__m128; 4];
    type Words4 = [__m128i; 4];

    /// Four quarters.
    #[inline(always)]
    fn quads<A: Copy, B: Copy, C>(a: [A; 4], b: [B; 4], f: impl Fn(A, B) -> C) -> [C; 4] {
        [f(a[0], b[0]), f(a[1], b[1]), f(a[2], b[2]), f(a[3], b[3])]
    }

    /// `yes` where `mask` is all ones, else `no`.
    #[inline(always)]
    fn choose(mask: __m128i, yes: __m128i, no: __m128i) -> __m128i {
        // SAFETY: SSE2 is part of the architecture.
        unsafe { _mm_or_si128(_mm_and_si128(mask, yes), _mm_andnot_si128(mask, no)) }
    }

    /// The sign bits of each lane.
    #[inline(always)]
    fn signs(a: Floats4) -> u16 {
        // SAFETY: as above.
        let bits = quads(a, a, |a, _| unsafe { _mm_movemask_ps(a) });
        (bits[0] | bits[1] << 4 | bits[2] << 8 | bits[3] << 12) as u16
    }

    impl Lanes for Sse2 {
        type Floats = Floats4;
        type Words = Words4;

        lanes! {
            float(value: f32) -> Floats4 { [_mm_set1_ps(value); 4] }
            add(a: Floats4, b: Floats4) -> Floats4 { quads(a, b, |a, b| _mm_add_ps(a, b)) }
            sub(a: Floats4, b: Floats4) -> Floats4 { quads(a, b, |a, b| _mm_sub_ps(a, b)) }
            mul(a: Floats4, b: Floats4) -> Floats4 { quads(a, b, |a, b| _mm_mul_ps(a, b)) }
            or(a: Floats4, b: Floats4) -> Floats4 {
                quads(a, b, |a, b| {
                    let nan = _mm_castps_si128(_mm_cmpunord_ps(a, a));
                    _mm_castsi128_ps(choose(nan, _mm_castps_si128(b), _mm_castps_si128(a)))
                })
            }
            nans(a: Floats4) -> u16 { signs(quads(a, a, |a, b| _mm_cmpunord_ps(a, b))) }
            bits(a: Floats4) -> Words4 { quads(a, a, |a, _| _mm_castps_si128(a)) }
            floats(a: Words4) -> Floats4 { quads(a, a, |a, _| _mm_castsi128_ps(a)) }
            word(value: u32) -> Words4 { [_mm_set1_epi32(value as i32); 4] }
            load(words: &[u32; LANES]) -> Words4 {
                let p: *const __m128i = words.as_ptr().cast();
                quads([0, 1, 2, 3], [(); 4], |n, ()| _mm_loadu_si128(p.add(n)))
            }
            store(a: Words4, words: &mut [u32; LANES]) -> () {
                let p: *mut __m128i = words.as_mut_ptr().cast();
                quads([0, 1, 2, 3], a, |n, a| _mm_storeu_si128(p.add(n), a));
            }
            load_samples(samples: &[[u8; 4]; LANES]) -> Words4 {
                let p: *const __m128i = samples.as_ptr().cast();
                quads([0, 1, 2, 3], [(); 4], |n, ()| _mm_loadu_si128(p.add(n)))
            }
            store_samples(a: Words4, samples: &mut [[u8; 4]; LANES]) -> () {
                let p: *mut __m128i = samples.as_mut_ptr().cast();
                quads([0, 1, 2, 3], a, |n, a| _mm_storeu_si128(p.add(n), a));
            }
            plus(a: Words4, b: Words4) -> Words4 { quads(a, b, |a, b| _mm_add_epi32(a, b)) }
            minus(a: Words4, b: Words4) -> Words4 { quads(a, b, |a, b| _mm_sub_epi32(a, b)) }
            xor(a: Words4, b: Words4) -> Words4 { quads(a, b, |a, b| _mm_xor_si128(a, b)) }
            and(a: Words4, b: Words4) -> Words4 { quads(a, b, |a, b| _mm_and_si128(a, b)) }
            half(a: Words4) -> Words4 { quads(a, a, |a, _| _mm_srli_epi32::<1>(a)) }
            sign(a: Words4) -> Words4 { quads(a, a, |a, _| _mm_srai_epi32::<31>(a)) }
            equal(a: Words4, b: Words4) -> u16 {
                signs(quads(a, b, |a, b| _mm_castsi128_ps(_mm_cmpeq_epi32(a, b))))
            }
            blend(mask: u16, yes: Words4, no: Words4) -> Words4 {
                let bits = _mm_setr_epi32(1, 2, 4, 8);
                let on = |n: i32| {
                    let mask = _mm_set1_epi32(i32::from(mask) >> (4 * n));
                    _mm_cmpeq_epi32(_mm_and_si128(mask, bits), bits)
                };
                let on = [on(0), on(1), on(2), on(3)];
                let no = quads(on, no, |on, no| _mm_andnot_si128(on, no));
                let yes = quads(on, yes, |on, yes| _mm_and_si128(on, yes));
                quads(yes, no, |a, b| _mm_or_si128(a, b))
            }
        }

        #[inline(always)]
        fn unpack(window: &[u8; WINDOW], width: u8, mask: u16) -> Words4 {
            Self::load(&Portable::unpack(window, width, mask))
        }
    }
}
