//! The same code compiled for three kinds of processor, chosen when the program runs.
//!
//! Integer work gains from `popcnt` and the bit manipulation instructions; sign masks gain from
//! vector compares. Nothing is rounded differently: every path gives the same bits, which the
//! tests of this file check against the portable one.

#![expect(
    unsafe_code,
    reason = "calls into code compiled for instructions that were found present"
)]

use super::block::{Block, BlockOutput, BlockSamples, Emit, Style};
use super::cells::write_triangles;
use super::scan::{list_cells, portable_mask};
use super::vertices::{list_edges, place};
pub(super) use crate::cpu::Level;
use crate::mesh::Piece;

impl Level {
    /// See [`Block::scan_with`].
    pub(super) fn scan(self, block: &mut Block, samples: &BlockSamples, style: &Style) -> bool {
        match self {
            Level::Portable => block.scan_with(samples, style, portable_mask, list_cells),
            // SAFETY: a level exists only where `available` found its instructions.
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => unsafe { x86::scan_avx2(block, samples, style) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => unsafe { x86::scan_avx512(block, samples, style) },
        }
    }

    /// Runs `f` compiled for the instructions of this level, as far as it is inlined.
    pub(super) fn run<R>(self, f: impl FnOnce() -> R) -> R {
        match self {
            Level::Portable => f(),
            // SAFETY: a level exists only where `available` found its instructions.
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 | Level::Avx512 => unsafe { x86::run_avx2(f) },
        }
    }

    /// See [`Block::emit_with`].
    pub(super) fn emit(
        self,
        block: &mut Block,
        samples: &BlockSamples,
        style: &Style,
        borrowed: [bool; 3],
        piece: &mut Piece,
        out: &mut BlockOutput,
    ) {
        match self {
            Level::Portable => block.emit_with(
                samples,
                style,
                borrowed,
                piece,
                out,
                Emit {
                    list_edges,
                    place,
                    triangles: write_triangles,
                },
            ),
            // SAFETY: a level exists only where `available` found its instructions.
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => unsafe { x86::emit_avx2(block, samples, style, borrowed, piece, out) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => unsafe {
                x86::emit_avx512(block, samples, style, borrowed, piece, out)
            },
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::*;
    use crate::iso::block::{MASK_SHIFT, below};
    use crate::iso::cells::RowNumbers;
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
            |row, iso, inside| mask_avx2(row, iso, inside),
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
            |row, iso, inside| mask_avx512(row, iso, inside),
            |rows, cells, out| list_cells_avx512(rows, cells, out),
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
            Emit {
                list_edges,
                place,
                triangles: write_triangles,
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
        block.emit_with(
            samples,
            style,
            borrowed,
            piece,
            out,
            Emit {
                list_edges: |first: u32, mask: u64, out: &mut Vec<u32>| {
                    list_edges_avx512(first, mask, out)
                },
                place: |placed: &Placed<'_>, codes: &[u32], out: &mut [[f32; 3]]| {
                    place_avx512(placed, codes, out)
                },
                triangles: |numbers: &RowNumbers, x: u32, lanes: &[u8; 16], out: &mut [u32; 16]| {
                    write_triangles_avx512(numbers, x, lanes, out)
                },
            },
        );
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

    /// Appends those lanes of `codes` that `lanes` names.
    #[target_feature(enable = "avx512f,popcnt")]
    #[inline]
    fn push_lanes(codes: __m512i, lanes: u16, out: &mut Vec<u32>) {
        out.reserve(16);
        let length = out.len();
        // SAFETY: there is room for 16 numbers behind the last, and those that count were written.
        unsafe {
            // Compressed in the register and stored whole: storing compressed is slow on Zen 4.
            let packed = _mm512_maskz_compress_epi32(lanes, codes);
            _mm512_storeu_si512(out.as_mut_ptr().add(length).cast(), packed);
            out.set_len(length + lanes.count_ones() as usize);
        }
    }

    /// [`list_cells`](super::list_cells), 16 cells at a time.
    #[target_feature(enable = "avx512f,popcnt")]
    #[inline]
    fn list_cells_avx512(rows: [u64; 4], cells: u64, out: &mut Vec<u32>) {
        let (x, three) = (iota(), _mm512_set1_epi32(3));
        let mut first = 0;
        while cells >> first != 0 {
            let pair = |i: usize| {
                let bits = _mm512_set1_epi32((rows[i] >> first) as i32);
                _mm512_and_si512(_mm512_srlv_epi32(bits, x), three)
            };
            let low = _mm512_or_si512(pair(0), _mm512_slli_epi32::<2>(pair(1)));
            let high = _mm512_or_si512(pair(2), _mm512_slli_epi32::<2>(pair(3)));
            let mask = _mm512_or_si512(low, _mm512_slli_epi32::<4>(high));
            let x = _mm512_add_epi32(x, _mm512_set1_epi32(first));
            let codes = _mm512_or_si512(_mm512_slli_epi32::<MASK_SHIFT>(mask), x);
            push_lanes(codes, (cells >> first) as u16, out);
            first += 16;
            if first >= 64 {
                break;
            }
        }
    }

    /// [`list_edges`](super::list_edges), 16 edges at a time.
    #[target_feature(enable = "avx512f,popcnt")]
    #[inline]
    fn list_edges_avx512(first: u32, mut mask: u64, out: &mut Vec<u32>) {
        let mut codes = _mm512_add_epi32(iota(), _mm512_set1_epi32(first as i32));
        loop {
            push_lanes(codes, mask as u16, out);
            mask >>= 16;
            if mask == 0 {
                break;
            }
            codes = _mm512_add_epi32(codes, _mm512_set1_epi32(16));
        }
    }

    /// [`write_triangles`](super::write_triangles): eight ranks at one time, one permutation.
    #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512vpopcntdq")]
    #[inline]
    fn write_triangles_avx512(numbers: &RowNumbers, x: u32, lanes: &[u8; 16], out: &mut [u32; 16]) {
        // SAFETY: the arrays have the sizes that are read and written.
        unsafe {
            let crossed = _mm512_loadu_si512(numbers.crossed.as_ptr().cast());
            let base = _mm256_loadu_si256(numbers.base.as_ptr().cast());
            let low = _mm512_and_si512(crossed, _mm512_set1_epi64(below(x) as i64));
            let rank = _mm512_cvtepi64_epi32(_mm512_popcnt_epi64(low));
            let here = _mm256_add_epi32(base, rank);
            let bit = _mm512_set1_epi64(1 << x);
            let is_crossed = _mm512_test_epi64_mask(crossed, bit);
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
            let halves =
                |v: __m512i| (_mm512_castsi512_si256(v), _mm512_extracti32x8_epi32::<1>(v));
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::iso::place::Placement;
    use crate::sample::Inside;
    use crate::{Affine, Box3};

    fn random(count: usize, odd: bool) -> Vec<f32> {
        let mut seed = 1u64;
        let mut next = || {
            seed = seed
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            match seed >> 60 {
                0 if odd => f32::NAN,
                1 => 0.0,
                2 if odd => f32::INFINITY,
                _ => ((seed >> 33) as f32 / (1u64 << 30) as f32) - 1.0,
            }
        };
        (0..count).map(|_| next()).collect()
    }

    fn pieces(samples: &BlockSamples, map: Affine, inside: Inside) -> Vec<Piece> {
        let placement = Placement::new(map, Box3::from_size([64; 3])).expect("plain");
        let style = Style {
            iso: 0.0,
            inside,
            placement,
            normals: false,
            keys: true,
            relax: 0,
            level: Level::Portable,
        };
        let mesh = |level: &Level| {
            let (mut block, mut piece, mut out): (Block, Piece, BlockOutput) = Default::default();
            assert!(level.scan(&mut block, samples, &style));
            let borrowed = [true, false, true];
            // Twice, so that what a block leaves behind does not show.
            for _ in 0..2 {
                level.emit(&mut block, samples, &style, borrowed, &mut piece, &mut out);
            }
            piece
        };
        Level::available().iter().map(mesh).collect()
    }

    #[test]
    fn all_levels_give_the_same_bits() {
        let mut sheared = Affine::from_spacing([0.7, 0.3, 1.1], [5.0, -2.0, 0.1]);
        sheared.rows[0][1] = 0.21;
        sheared.rows[2][0] = -0.13;
        for (size, odd) in [
            ([35usize, 7, 9], true),
            ([17, 17, 17], false),
            ([34, 9, 8], false),
            ([9, 5, 4], false),
        ] {
            let samples = BlockSamples {
                origin: [-3, 4, 5],
                size,
                values: random(size.iter().product(), odd),
                first: 0,
                step: [1, size[0], size[0] * size[1]],
            };
            for (map, inside) in [(Affine::IDENTITY, Inside::Above), (sheared, Inside::Below)] {
                let pieces = pieces(&samples, map, inside);
                assert!(pieces[0].triangles.len() > 100);
                for (piece, level) in pieces.iter().zip(Level::available()) {
                    assert_eq!(piece.positions, pieces[0].positions, "{level:?}");
                    assert_eq!(piece.triangles, pieces[0].triangles, "{level:?}");
                    assert_eq!(
                        (&piece.own, &piece.keys),
                        (&pieces[0].own, &pieces[0].keys),
                        "{level:?}"
                    );
                }
            }
        }
    }
}
