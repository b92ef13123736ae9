//! The parts of scan and emit that are written by hand for AVX2 and AVX-512.

#![expect(
    unsafe_code,
    reason = "loads and stores of vectors, of places whose size was checked"
)]

use super::*;
use crate::iso::block::{MASK_SHIFT, below};
use crate::iso::vertices::{AXIS_SHIFT, Placed, Y_SHIFT, Z_SHIFT};
use crate::sample::Inside;
use std::arch::x86_64::*;

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
pub(super) fn run_avx2<R>(f: impl FnOnce() -> R) -> R {
    f()
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
pub(super) fn scan_avx2(block: &mut Block, samples: &BlockSamples, style: &Style) -> bool {
    block.scan_with(
        samples,
        style,
        |samples, style, out| {
            row_masks(samples, style, out, |row, iso, inside| {
                mask_avx2(row, iso, inside)
            })
        },
        rows_with,
        list_cells,
    )
}

#[target_feature(
    enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vpopcntdq,avx2,bmi1,bmi2,lzcnt,popcnt"
)]
pub(super) fn scan_avx512(block: &mut Block, samples: &BlockSamples, style: &Style) -> bool {
    block.scan_with(
        samples,
        style,
        |samples, style, out| row_masks_avx512(samples, style, out),
        |masks, bits, out| rows_with_avx512(masks, bits, out),
        |rows, cells, row, out| list_cells_avx512(rows, cells, row, out),
    )
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
pub(super) fn emit_avx2(
    block: &mut Block,
    samples: &BlockSamples,
    style: &Style,
    borrowed: [bool; 3],
    piece: &mut Piece,
    out: &mut BlockOutput,
) {
    block.emit_with(
        samples,
        style,
        borrowed,
        piece,
        out,
        // Closures, since these are compiled for the instructions of this function.
        Emit {
            rows_with: |masks: [&[u64]; 3], bits: u64, out: &mut [u32]| rows_with(masks, bits, out),
            put_run: |start: u32, count: u32, out: &mut [u32]| put_run(start, count, out),
            list_edges: |first: u32, mask: u64, out: &mut [u32]| list_edges(first, mask, out),
            place: |placed: &Placed<'_>, codes: &[u32], out: &mut [[f32; 3]]| {
                place(placed, codes, out)
            },
            list_own: |codes: &[u32], first: u32, borrowed: [bool; 3], out: &mut [u32]| {
                list_own(codes, first, borrowed, out)
            },
            numbers: |block: &Block, row: usize, ny: usize, first: u32| {
                RowNumbers::new(block, row, ny, first)
            },
            triangles: |numbers: &RowNumbers, x: u32, lanes: &[u8; 16], out: &mut [u32; 16]| {
                write_triangles(numbers, x, lanes, out)
            },
        },
    );
}

#[target_feature(
    enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vpopcntdq,avx2,bmi1,bmi2,lzcnt,popcnt"
)]
pub(super) fn emit_avx512(
    block: &mut Block,
    samples: &BlockSamples,
    style: &Style,
    borrowed: [bool; 3],
    piece: &mut Piece,
    out: &mut BlockOutput,
) {
    macro_rules! emit {
        ($write:ident) => {
            block.emit_with(
                samples,
                style,
                borrowed,
                piece,
                out,
                Emit {
                    rows_with: |masks: [&[u64]; 3], bits: u64, out: &mut [u32]| {
                        rows_with_avx512(masks, bits, out)
                    },
                    put_run: |start: u32, count: u32, out: &mut [u32]| {
                        put_run_avx512(start, count, out)
                    },
                    list_edges: |first: u32, mask: u64, out: &mut [u32]| {
                        list_edges_avx512(first, mask, out)
                    },
                    place: |placed: &Placed<'_>, codes: &[u32], out: &mut [[f32; 3]]| {
                        place_avx512(placed, codes, out)
                    },
                    list_own: |codes: &[u32], first: u32, borrowed: [bool; 3], out: &mut [u32]| {
                        list_own_avx512(codes, first, borrowed, out)
                    },
                    numbers: |block: &Block, row: usize, ny: usize, first: u32| {
                        numbers_avx512(block, row, ny, first)
                    },
                    triangles: |numbers: &RowNumbers,
                                x: u32,
                                lanes: &[u8; 16],
                                out: &mut [u32; 16]| {
                        $write(numbers, x, lanes, out)
                    },
                },
            )
        };
    }
    // The edges below x and x + 1 of the usual rows, of 32 cells at most, fit in words of 32 bits.
    if samples.size[0] <= 33 {
        emit!(write_short_avx512)
    } else {
        emit!(write_long_avx512)
    }
}

#[target_feature(enable = "avx2")]
#[inline]
fn mask_avx2(row: &[f32], iso: f32, inside: Inside) -> u64 {
    let (runs, rest) = row.as_chunks::<8>();
    let limit = _mm256_set1_ps(iso);
    let mut mask = portable_mask(rest, iso, inside) << (8 * runs.len());
    for (i, run) in runs.iter().enumerate() {
        // SAFETY: `run` is eight floats.
        let values = unsafe { _mm256_loadu_ps(run.as_ptr()) };
        let within = match inside {
            Inside::Above => _mm256_cmp_ps::<_CMP_GE_OQ>(values, limit),
            Inside::Below => _mm256_cmp_ps::<_CMP_LT_OQ>(values, limit),
        };
        mask |= u64::from(_mm256_movemask_ps(within) as u8) << (8 * i);
    }
    mask
}

/// [`row_masks`](super::row_masks). Where rows of 17 or 33 samples follow each other, as in most
/// blocks, all samples are compared as one row; the mask of row i of eight then lies at bit 17 i or 33 i
/// of its 17 or 33 bytes: i bits into word i.
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,popcnt")]
#[inline]
fn row_masks_avx512(samples: &BlockSamples, style: &Style, inside: &mut Vec<u64>) -> (u64, u64) {
    let [nx, ny, nz] = samples.size;
    let together = samples.step[1] == nx && samples.step[2] == nx * ny;
    let count = nx * ny * nz;
    // Capped blocks have a layer more.
    const MOST: usize = 34;
    if !(together && (nx == 17 || nx == 33) && ny <= MOST && nz <= MOST) {
        return row_masks(samples, style, inside, |row, iso, inside| {
            mask_avx512(row, iso, inside)
        });
    }
    // Two bytes for 16 samples, and room to read words behind the last.
    const ROOM: usize = 33 * MOST * MOST / 8 + 128;
    let mut bits = [0u8; ROOM];
    let values = &samples.values[samples.first..][..count];
    let limit = _mm512_set1_ps(style.iso);
    let within = |values: __m512| match style.inside {
        Inside::Above => _mm512_cmp_ps_mask::<_CMP_GE_OQ>(values, limit),
        Inside::Below => _mm512_cmp_ps_mask::<_CMP_LT_OQ>(values, limit),
    };
    let (groups, rest) = values.as_chunks::<16>();
    let (words, _) = bits.as_chunks_mut::<2>();
    assert!(
        groups.len() < words.len(),
        "not more points than there is room for"
    );
    for (group, word) in groups.iter().zip(&mut *words) {
        // SAFETY: 16 floats.
        let values = unsafe { _mm512_loadu_ps(group.as_ptr()) };
        *word = within(values).to_le_bytes();
    }
    let present = ((1u32 << rest.len()) - 1) as u16;
    // SAFETY: only the lanes that `rest` has are read.
    let last = unsafe { _mm512_maskz_loadu_ps(present, rest.as_ptr()) };
    words[groups.len()] = (within(last) & present).to_le_bytes();

    inside.resize(ny * nz, 0);
    let shifts = _mm512_setr_epi64(0, 1, 2, 3, 4, 5, 6, 7);
    let row = _mm512_set1_epi64(below(nx as u32) as i64);
    let (mut any, mut every) = (_mm512_setzero_si512(), row);
    for (n, rows) in inside.chunks_mut(8).enumerate() {
        let from: &[u8; 64] = bits[n * nx..].first_chunk().expect("room behind the last");
        // SAFETY: 64 bytes.
        let bytes = unsafe { _mm512_loadu_si512(from.as_ptr().cast()) };
        let words = if nx == 17 {
            // Words i and i + 1 of 16 bits into each lane.
            let pairs = _mm512_add_epi64(
                _mm512_mullo_epi64(shifts, _mm512_set1_epi64(0x1_0001)),
                _mm512_set1_epi64(0x1_0000),
            );
            _mm512_maskz_permutexvar_epi16(0x3333_3333, pairs, bytes)
        } else {
            let pairs = _mm512_add_epi64(
                _mm512_mullo_epi64(shifts, _mm512_set1_epi64(0x1_0000_0001)),
                _mm512_set1_epi64(0x1_0000_0000),
            );
            _mm512_permutexvar_epi32(pairs, bytes)
        };
        let masks = _mm512_and_si512(_mm512_srlv_epi64(words, shifts), row);
        let lanes = ((1u32 << rows.len()) - 1) as u8;
        any = _mm512_mask_or_epi64(any, lanes, any, masks);
        every = _mm512_mask_and_epi64(every, lanes, every, masks);
        // SAFETY: as many numbers as there are rows.
        unsafe { _mm512_mask_storeu_epi64(rows.as_mut_ptr().cast(), lanes, masks) };
    }
    (
        _mm512_reduce_or_epi64(any) as u64,
        _mm512_reduce_and_epi64(every) as u64,
    )
}

#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
#[inline]
fn mask_avx512(row: &[f32], iso: f32, inside: Inside) -> u64 {
    let limit = _mm512_set1_ps(iso);
    let within = |values: __m512| match inside {
        Inside::Above => _mm512_cmp_ps_mask::<_CMP_GE_OQ>(values, limit),
        Inside::Below => _mm512_cmp_ps_mask::<_CMP_LT_OQ>(values, limit),
    };
    let (runs, rest) = row.as_chunks::<16>();
    let mut mask = 0;
    for (i, run) in runs.iter().enumerate() {
        // SAFETY: `run` is 16 floats.
        let values = unsafe { _mm512_loadu_ps(run.as_ptr()) };
        mask |= u64::from(within(values)) << (16 * i);
    }
    let present = ((1u32 << rest.len()) - 1) as u16;
    if let [one] = rest {
        // The usual rest: a row of a block has one point more than cells.
        mask |= u64::from(inside.contains(*one, iso)) << (16 * runs.len());
    } else if present != 0 {
        // SAFETY: only the lanes that `rest` has are read.
        let values = unsafe { _mm512_maskz_loadu_ps(present, rest.as_ptr()) };
        mask |= u64::from(within(values) & present) << (16 * runs.len());
    }
    mask
}

#[target_feature(enable = "avx512f")]
#[inline]
fn iota() -> __m512i {
    _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
}

/// [`rows_with`](super::rows_with), eight rows at a time.
#[target_feature(enable = "avx512f,avx512vl,popcnt")]
#[inline]
fn rows_with_avx512([a, b, c]: [&[u64]; 3], bits: u64, out: &mut [u32]) -> usize {
    let (a, a_rest) = a.as_chunks::<8>();
    let (b, b_rest) = b.as_chunks::<8>();
    let (c, c_rest) = c.as_chunks::<8>();
    let bits_8 = _mm512_set1_epi64(bits as i64);
    let mut rows = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    let mut end = 0;
    for ((a, b), c) in a.iter().zip(b).zip(c) {
        // SAFETY: eight numbers each.
        let load = |masks: &[u64; 8]| unsafe { _mm512_loadu_si512(masks.as_ptr().cast()) };
        let any = _mm512_or_si512(_mm512_or_si512(load(a), load(b)), load(c));
        let found = _mm512_test_epi64_mask(any, bits_8);
        let out: &mut [u32; 8] = out[end..].first_chunk_mut().expect("room for a vector");
        let packed = _mm256_maskz_compress_epi32(found, rows);
        // SAFETY: eight numbers.
        unsafe { _mm256_storeu_si256(out.as_mut_ptr().cast(), packed) };
        end += found.count_ones() as usize;
        rows = _mm256_add_epi32(rows, _mm256_set1_epi32(8));
    }
    for (row, ((a, b), c)) in (8 * a.len() as u32..).zip(a_rest.iter().zip(b_rest).zip(c_rest)) {
        out[end] = row;
        end += usize::from((a | b | c) & bits != 0);
    }
    end
}

/// [`put_run`](super::put_run), 16 numbers at a time.
#[target_feature(enable = "avx512f")]
#[inline]
fn put_run_avx512(start: u32, count: u32, out: &mut [u32]) {
    let mut numbers = _mm512_add_epi32(iota(), _mm512_set1_epi32(start as i32));
    let mut at = 0;
    loop {
        let out: &mut [u32; 16] = out[at..].first_chunk_mut().expect("room for a vector");
        // SAFETY: 16 numbers.
        unsafe { _mm512_storeu_si512(out.as_mut_ptr().cast(), numbers) };
        at += 16;
        if at >= count as usize {
            return;
        }
        numbers = _mm512_add_epi32(numbers, _mm512_set1_epi32(16));
    }
}

/// Writes those lanes of `codes` that `lanes` names to the start of `out`, and what happens to stand
/// behind them.
#[target_feature(enable = "avx512f,popcnt")]
#[inline]
fn put_lanes(codes: __m512i, lanes: u16, out: &mut [u32]) -> usize {
    let out: &mut [u32; 16] = out.first_chunk_mut().expect("room for a vector");
    // Compressed in the register and stored whole: storing compressed is slow on Zen 4.
    let packed = _mm512_maskz_compress_epi32(lanes, codes);
    // SAFETY: 16 numbers.
    unsafe { _mm512_storeu_si512(out.as_mut_ptr().cast(), packed) };
    lanes.count_ones() as usize
}

/// [`list_cells`](super::list_cells), 16 cells at a time.
#[target_feature(enable = "avx512f,popcnt")]
#[inline]
fn list_cells_avx512(rows: [u64; 4], cells: u64, row: u32, out: &mut [u32]) -> usize {
    let (x, three) = (iota(), _mm512_set1_epi32(3));
    let (mut first, mut end) = (0, 0);
    while cells >> first != 0 {
        let pair = |i: usize| {
            let bits = _mm512_set1_epi32((rows[i] >> first) as i32);
            _mm512_and_si512(_mm512_srlv_epi32(bits, x), three)
        };
        let low = _mm512_or_si512(pair(0), _mm512_slli_epi32::<2>(pair(1)));
        let high = _mm512_or_si512(pair(2), _mm512_slli_epi32::<2>(pair(3)));
        let mask = _mm512_or_si512(low, _mm512_slli_epi32::<4>(high));
        let x = _mm512_add_epi32(x, _mm512_set1_epi32(first | row as i32));
        let codes = _mm512_or_si512(_mm512_slli_epi32::<MASK_SHIFT>(mask), x);
        end += put_lanes(codes, (cells >> first) as u16, &mut out[end..]);
        first += 16;
        if first >= 64 {
            break;
        }
    }
    end
}

/// [`list_edges`](super::list_edges), 16 edges at a time.
#[target_feature(enable = "avx512f,popcnt")]
#[inline]
fn list_edges_avx512(first: u32, mut mask: u64, out: &mut [u32]) -> usize {
    let mut codes = _mm512_add_epi32(iota(), _mm512_set1_epi32(first as i32));
    let mut end = 0;
    loop {
        end += put_lanes(codes, mask as u16, &mut out[end..]);
        mask >>= 16;
        if mask == 0 {
            return end;
        }
        codes = _mm512_add_epi32(codes, _mm512_set1_epi32(16));
    }
}

/// [`list_own`](super::list_own), 16 vertices at a time.
#[target_feature(enable = "avx512f,popcnt")]
#[inline]
fn list_own_avx512(codes: &[u32], first: u32, borrowed: [bool; 3], out: &mut [u32]) -> usize {
    // Places of an edge in its code, and its axis; theirs when the place is 0 and the axis another.
    let faces = [(0, 0), (Y_SHIFT, 1), (Z_SHIFT, 2)].map(|(shift, axis)| {
        (
            _mm512_set1_epi32(63 << shift),
            _mm512_set1_epi32(axis << AXIS_SHIFT),
        )
    });
    let axes = _mm512_set1_epi32(3 << AXIS_SHIFT);
    let ours = |codes: __m512i| {
        let axis = _mm512_and_si512(codes, axes);
        let mut theirs = 0;
        for (a, (place, along)) in faces.iter().enumerate() {
            if borrowed[a] {
                theirs |=
                    _mm512_testn_epi32_mask(codes, *place) & _mm512_cmpneq_epi32_mask(axis, *along);
            }
        }
        !theirs
    };
    let mut locals = _mm512_add_epi32(iota(), _mm512_set1_epi32(first as i32));
    let mut end = 0;
    let (groups, rest) = codes.as_chunks::<16>();
    for codes in groups {
        // SAFETY: 16 numbers.
        let codes = unsafe { _mm512_loadu_si512(codes.as_ptr().cast()) };
        end += put_lanes(locals, ours(codes), &mut out[end..]);
        locals = _mm512_add_epi32(locals, _mm512_set1_epi32(16));
    }
    if !rest.is_empty() {
        let mut last = [0; 16];
        last[..rest.len()].copy_from_slice(rest);
        // SAFETY: 16 numbers.
        let codes = unsafe { _mm512_loadu_si512(last.as_ptr().cast()) };
        let lanes = ours(codes) & ((1 << rest.len()) - 1);
        let count = put_lanes(locals, lanes, &mut last);
        out[end..end + count].copy_from_slice(&last[..count]);
        end += count;
    }
    end
}

/// [`RowNumbers::new`], in vectors.
#[target_feature(enable = "avx512f,avx512vl,avx512dq")]
#[inline]
fn numbers_avx512(block: &Block, row: usize, ny: usize, first: u32) -> RowNumbers {
    let [x, y, z] = &block.crossed;
    let [bx, by, bz] = &block.base;
    let (a, b) = (row, row + ny);
    let masks = |of: &[u64], at: usize| {
        let two: &[u64; 2] = of[at..].first_chunk().expect("a row above");
        // SAFETY: two numbers.
        unsafe { _mm_loadu_si128(two.as_ptr().cast()) }
    };
    let numbers = |of: &[u32], at: usize| {
        let two: &[u32; 2] = of[at..].first_chunk().expect("a row above");
        // SAFETY: two numbers.
        unsafe { _mm_loadl_epi64(two.as_ptr().cast()) }
    };
    let ys = _mm_set_epi64x(y[b] as i64, y[a] as i64);
    let yz = _mm256_set_m128i(masks(z, a), ys);
    let xs = _mm256_set_m128i(masks(x, b), masks(x, a));
    let crossed = _mm512_inserti64x4::<1>(_mm512_castsi256_si512(xs), yz);
    let ys = _mm_set_epi64x(0, (u64::from(by[b]) << 32 | u64::from(by[a])) as i64);
    let yz = _mm_unpacklo_epi64(ys, numbers(bz, a));
    let xs = _mm_unpacklo_epi64(numbers(bx, a), numbers(bx, b));
    let base = _mm256_add_epi32(_mm256_set_m128i(yz, xs), _mm256_set1_epi32(first as i32));
    let mut out = RowNumbers::default();
    let high = _mm512_cvtepi64_epi32(_mm512_srli_epi64::<32>(crossed));
    // SAFETY: eight numbers each, aligned by their type.
    unsafe {
        _mm256_store_si256(out.low.as_mut_ptr().cast(), _mm512_cvtepi64_epi32(crossed));
        _mm256_store_si256(out.base.as_mut_ptr().cast(), base);
        _mm256_store_si256(out.high.as_mut_ptr().cast(), high);
    }
    out
}

/// The bits below x, eight times, and those below x + 1.
static BELOW: [[u32; 16]; 32] = {
    let mut all = [[0; 16]; 32];
    let mut i = 0;
    while i < 32 * 16 {
        let bits = i / 16 + i % 16 / 8;
        all[i / 16][i % 16] = below(bits as u32) as u32;
        i += 1;
    }
    all
};

/// [`write_triangles`](super::write_triangles): sixteen ranks at one time, one permutation.
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512vpopcntdq")]
#[inline]
fn write_short_avx512(numbers: &RowNumbers, x: u32, lanes: &[u8; 16], out: &mut [u32; 16]) {
    // SAFETY: the arrays have the sizes that are read and written.
    unsafe {
        let below = _mm512_loadu_si512(BELOW[x as usize & 31].as_ptr().cast());
        let crossed = _mm256_load_si256(numbers.low.as_ptr().cast());
        let base = _mm256_load_si256(numbers.base.as_ptr().cast());
        let crossed = _mm512_and_si512(_mm512_broadcast_i32x8(crossed), below);
        let rank = _mm512_popcnt_epi32(crossed);
        let ids = _mm512_add_epi32(_mm512_broadcast_i32x8(base), rank);
        let lanes = _mm512_cvtepu8_epi32(_mm_loadu_si128(lanes.as_ptr().cast()));
        let corners = _mm512_permutexvar_epi32(lanes, ids);
        _mm512_storeu_si512(out.as_mut_ptr().cast(), corners);
    }
}

/// The same for rows of up to 64 points.
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512vpopcntdq")]
#[inline]
fn write_long_avx512(numbers: &RowNumbers, x: u32, lanes: &[u8; 16], out: &mut [u32; 16]) {
    // SAFETY: the arrays have the sizes that are read and written.
    unsafe {
        let low = _mm256_load_si256(numbers.low.as_ptr().cast());
        let high = _mm256_load_si256(numbers.high.as_ptr().cast());
        let high = _mm512_slli_epi64::<32>(_mm512_cvtepu32_epi64(high));
        let crossed = _mm512_or_si512(_mm512_cvtepu32_epi64(low), high);
        let base = _mm256_load_si256(numbers.base.as_ptr().cast());
        let before = _mm512_and_si512(crossed, _mm512_set1_epi64(below(x) as i64));
        let rank = _mm512_cvtepi64_epi32(_mm512_popcnt_epi64(before));
        let here = _mm256_add_epi32(base, rank);
        let is_crossed = _mm512_test_epi64_mask(crossed, _mm512_set1_epi64(1 << x));
        let next = _mm256_mask_add_epi32(here, is_crossed, here, _mm256_set1_epi32(1));
        let ids = _mm512_inserti32x8::<1>(_mm512_castsi256_si512(here), next);
        let lanes = _mm512_cvtepu8_epi32(_mm_loadu_si128(lanes.as_ptr().cast()));
        let corners = _mm512_permutexvar_epi32(lanes, ids);
        _mm512_storeu_si512(out.as_mut_ptr().cast(), corners);
    }
}

/// [`place`](super::place), 16 vertices at a time with the operations of
/// [`Placed::position`] in their order.
#[target_feature(enable = "avx512f,avx512vl,avx512dq")]
#[inline]
fn place_avx512(placed: &Placed<'_>, codes: &[u32], out: &mut [[f32; 3]]) {
    let samples = placed.samples;
    let (groups, rest) = codes.as_chunks::<16>();
    let (done, left) = out.split_at_mut(16 * groups.len());
    for (codes, out) in groups.iter().zip(done.as_chunks_mut::<16>().0) {
        place_16(placed, samples, codes, out);
    }
    if !rest.is_empty() {
        // The last group again and again up to its end: every lane is a true edge.
        let codes = std::array::from_fn(|i| rest[i % rest.len()]);
        let mut some = [[0.0; 3]; 16];
        place_16(placed, samples, &codes, &mut some);
        left.copy_from_slice(&some[..left.len()]);
    }
}

#[target_feature(enable = "avx512f,avx512vl,avx512dq")]
#[inline]
fn place_16(
    placed: &Placed<'_>,
    samples: &BlockSamples,
    codes: &[u32; 16],
    out: &mut [[f32; 3]; 16],
) {
    let style = placed.style;
    // SAFETY: 16 numbers are read.
    let code = unsafe { _mm512_loadu_si512(codes.as_ptr().cast()) };
    let six = _mm512_set1_epi32(63);
    let set = |v: usize| _mm512_set1_epi32(v as i32);
    let x = _mm512_and_si512(code, six);
    let y = _mm512_and_si512(_mm512_srli_epi32::<Y_SHIFT>(code), six);
    let z = _mm512_and_si512(_mm512_srli_epi32::<Z_SHIFT>(code), six);
    let axis = _mm512_srli_epi32::<AXIS_SHIFT>(code);
    let rows = _mm512_mullo_epi32(y, set(samples.step[1]));
    let slices = _mm512_mullo_epi32(z, set(samples.step[2]));
    let low = _mm512_add_epi32(
        _mm512_add_epi32(x, set(samples.first)),
        _mm512_add_epi32(rows, slices),
    );
    let steps = _mm512_setr_epi32(
        samples.step[0] as i32,
        samples.step[1] as i32,
        samples.step[2] as i32,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
        0,
    );
    let high = _mm512_add_epi32(low, _mm512_permutexvar_epi32(axis, steps));
    let most = _mm512_reduce_max_epu32(high) as usize;
    assert!(most < samples.values.len(), "an edge of the block");
    // SAFETY: all indices are at most `most`, which is inside; none is negative, since arrays of
    // samples are shorter than 2^31.
    let (a, b) = unsafe {
        let values = samples.values.as_ptr();
        (
            _mm512_i32gather_ps::<4>(low, values),
            _mm512_i32gather_ps::<4>(high, values),
        )
    };
    let part = _mm512_sub_ps(_mm512_set1_ps(style.iso), a);
    let whole = _mm512_sub_ps(b, a);
    // NaN and infinities of either sign.
    const UNUSUAL: i32 = 0x01 | 0x08 | 0x10 | 0x80;
    let unusual =
        _mm512_fpclass_ps_mask::<UNUSUAL>(part) | _mm512_fpclass_ps_mask::<UNUSUAL>(whole);
    if unusual != 0 {
        super::place(placed, codes, out);
        return;
    }
    let min = style.placement.min_t() as f32;
    let t = _mm512_div_ps(part, whole);
    let t = _mm512_min_ps(
        _mm512_max_ps(t, _mm512_set1_ps(min)),
        _mm512_set1_ps(1.0 - min),
    );
    let origin = samples.origin;
    let at = |v: __m512i, a: usize| _mm512_add_epi32(v, _mm512_set1_epi32(origin[a]));
    let points = [at(x, 0), at(y, 1), at(z, 2)];
    if style.placement.is_diagonal() {
        let halves = |v: __m512i| (_mm512_castsi512_si256(v), _mm512_extracti32x8_epi32::<1>(v));
        let (t0, t1) = (_mm512_castps512_ps256(t), _mm512_extractf32x8_ps::<1>(t));
        let (t0, t1) = (_mm512_cvtps_pd(t0), _mm512_cvtps_pd(t1));
        let mut xyz = [t; 3];
        for (a, row) in style.placement.rows().iter().enumerate() {
            // The terms of the other axes are zeros, which add nothing; the step along another axis
            // as well, but it makes a negative zero positive.
            let along = _mm512_cmpeq_epi32_mask(axis, _mm512_set1_epi32(a as i32));
            let (factor, shift) = (_mm512_set1_pd(row[a]), _mm512_set1_pd(row[3]));
            let half = |v: __m256i, t: __m512d, along: u8| {
                let start = _mm512_add_pd(_mm512_mul_pd(factor, _mm512_cvtepi32_pd(v)), shift);
                let step = _mm512_maskz_mul_pd(along, factor, t);
                _mm512_cvtpd_ps(_mm512_add_pd(start, step))
            };
            let (low, high) = halves(points[a]);
            let (low, high) = (
                half(low, t0, along as u8),
                half(high, t1, (along >> 8) as u8),
            );
            xyz[a] = _mm512_insertf32x8::<1>(_mm512_castps256_ps512(low), high);
        }
        store_interleaved(xyz, out);
        return;
    }
    let mut xyz = [_mm512_setzero_ps(); 3];
    let map = style.placement.rows();
    for (a, row) in map.iter().enumerate() {
        let table = _mm512_setr_pd(row[0], row[1], row[2], 0.0, 0.0, 0.0, 0.0, 0.0);
        let half = |i: __m256i, j: __m256i, k: __m256i, t: __m256, axis: __m256i| {
            let (i, j, k) = (
                _mm512_cvtepi32_pd(i),
                _mm512_cvtepi32_pd(j),
                _mm512_cvtepi32_pd(k),
            );
            let times = |f: f64, v: __m512d| _mm512_mul_pd(_mm512_set1_pd(f), v);
            let last = _mm512_add_pd(times(row[2], k), _mm512_set1_pd(row[3]));
            let start = _mm512_add_pd(times(row[1], j), last);
            let along = _mm512_permutexvar_pd(_mm512_cvtepu32_epi64(axis), table);
            let step = _mm512_mul_pd(along, _mm512_cvtps_pd(t));
            let sum = _mm512_add_pd(_mm512_add_pd(times(row[0], i), start), step);
            _mm512_cvtpd_ps(sum)
        };
        let halves = |v: __m512i| (_mm512_castsi512_si256(v), _mm512_extracti32x8_epi32::<1>(v));
        let (i, j, k, ax) = (
            halves(points[0]),
            halves(points[1]),
            halves(points[2]),
            halves(axis),
        );
        let (t0, t1) = (_mm512_castps512_ps256(t), _mm512_extractf32x8_ps::<1>(t));
        let first = half(i.0, j.0, k.0, t0, ax.0);
        let second = half(i.1, j.1, k.1, t1, ax.1);
        xyz[a] = _mm512_insertf32x8::<1>(_mm512_castps256_ps512(first), second);
    }
    store_interleaved(xyz, out);
}

/// Stores x, y, z of 16 points as points.
#[target_feature(enable = "avx512f")]
#[inline]
fn store_interleaved([x, y, z]: [__m512; 3], out: &mut [[f32; 3]; 16]) {
    // Number n of the 48 is component n % 3 of point n / 3; lane 16 + p is of the second source.
    const fn lanes(first: usize, with_z: bool) -> [i32; 16] {
        let mut out = [0; 16];
        let mut i = 0;
        while i < 16 {
            let (point, component) = ((first + i) / 3, (first + i) % 3);
            out[i] = match (component, with_z) {
                (0, false) => point as i32,
                (1, false) => 16 + point as i32,
                (2, true) => 16 + point as i32,
                _ => i as i32,
            };
            i += 1;
        }
        out
    }
    const XY: [[i32; 16]; 3] = [lanes(0, false), lanes(16, false), lanes(32, false)];
    const Z: [[i32; 16]; 3] = [lanes(0, true), lanes(16, true), lanes(32, true)];
    let flat = out.as_flattened_mut();
    for part in 0..3 {
        // SAFETY: index arrays have 16 numbers; the three stores cover the 48 of `out`.
        unsafe {
            let xy = _mm512_loadu_si512(XY[part].as_ptr().cast());
            let with_z = _mm512_loadu_si512(Z[part].as_ptr().cast());
            let pairs = _mm512_permutex2var_ps(x, xy, y);
            let all = _mm512_permutex2var_ps(pairs, with_z, z);
            _mm512_storeu_ps(flat.as_mut_ptr().add(16 * part), all);
        }
    }
}
