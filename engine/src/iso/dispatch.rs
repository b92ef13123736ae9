//! The same code compiled for three kinds of processor, chosen when the program runs.
//!
//! Integer work gains from `popcnt` and the bit manipulation instructions; sign masks gain from
//! vector compares. Nothing is rounded differently: every path gives the same bits, which the
//! tests of this file check against the portable one.

#![expect(
    unsafe_code,
    reason = "calls into code compiled for instructions that were found present"
)]

use super::block::{Block, BlockOutput, BlockSamples, Style};
pub(super) use crate::cpu::Level;
use crate::mesh::Piece;
use crate::sample::Inside;

impl Level {
    /// See [`Block::scan_with`].
    pub(super) fn scan(self, block: &mut Block, samples: &BlockSamples, style: &Style) -> bool {
        match self {
            Level::Portable => block.scan_with(samples, style, portable_mask),
            // SAFETY: a level exists only where `available` found its instructions.
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => unsafe { x86::scan_avx2(block, samples, style) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => unsafe { x86::scan_avx512(block, samples, style) },
        }
    }

    /// See [`Block::emit_all`].
    pub(super) fn emit(
        self,
        block: &Block,
        samples: &BlockSamples,
        style: &Style,
        borrowed: [bool; 3],
        piece: &mut Piece,
        out: &mut BlockOutput,
    ) {
        match self {
            Level::Portable => block.emit_all(samples, style, borrowed, piece, out),
            // SAFETY: a level exists only where `available` found its instructions.
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 | Level::Avx512 => unsafe {
                x86::emit(block, samples, style, borrowed, piece, out)
            },
        }
    }
}

/// Mask of the samples of a row that are inside, at most 64.
pub(super) fn portable_mask(row: &[f32], iso: f32, inside: Inside) -> u64 {
    row.iter().enumerate().fold(0, |mask, (x, &v)| {
        mask | u64::from(inside.contains(v, iso)) << x
    })
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{Block, BlockOutput, BlockSamples, Inside, Piece, Style, portable_mask};
    use std::arch::x86_64::{
        _CMP_GE_OQ, _CMP_LT_OQ, _mm256_cmp_ps, _mm256_loadu_ps, _mm256_movemask_ps, _mm256_set1_ps,
        _mm512_cmp_ps_mask, _mm512_maskz_loadu_ps, _mm512_set1_ps,
    };

    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) fn scan_avx2(block: &mut Block, samples: &BlockSamples, style: &Style) -> bool {
        block.scan_with(samples, style, |row, iso, inside| {
            mask_avx2(row, iso, inside)
        })
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) fn scan_avx512(block: &mut Block, samples: &BlockSamples, style: &Style) -> bool {
        block.scan_with(samples, style, |row, iso, inside| {
            mask_avx512(row, iso, inside)
        })
    }

    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) fn emit(
        block: &Block,
        samples: &BlockSamples,
        style: &Style,
        borrowed: [bool; 3],
        piece: &mut Piece,
        out: &mut BlockOutput,
    ) {
        block.emit_all(samples, style, borrowed, piece, out);
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
        let mut mask = 0;
        for (i, run) in row.chunks(16).enumerate() {
            let present = ((1u32 << run.len()) - 1) as u16;
            // SAFETY: only the lanes that `run` has are read.
            let values = unsafe { _mm512_maskz_loadu_ps(present, run.as_ptr()) };
            let within = match inside {
                Inside::Above => _mm512_cmp_ps_mask::<_CMP_GE_OQ>(values, limit),
                Inside::Below => _mm512_cmp_ps_mask::<_CMP_LT_OQ>(values, limit),
            };
            mask |= u64::from(within & present) << (16 * i);
        }
        mask
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::iso::place::Placement;
    use crate::{Affine, Box3};

    #[test]
    fn all_levels_give_the_same_bits() {
        let size = [35usize, 7, 9];
        let mut seed = 1u64;
        let values: Vec<f32> = (0..size.iter().product())
            .map(|_| {
                seed = seed
                    .wrapping_mul(6364136223846793005)
                    .wrapping_add(1442695040888963407);
                match seed >> 60 {
                    0 => f32::NAN,
                    1 => 0.0,
                    2 => f32::INFINITY,
                    _ => ((seed >> 33) as f32 / (1u64 << 30) as f32) - 1.0,
                }
            })
            .collect();
        let samples = BlockSamples {
            origin: [-3, 4, 5],
            size,
            values,
            first: 0,
            step: [1, size[0], size[0] * size[1]],
        };
        for inside in [Inside::Above, Inside::Below] {
            let placement =
                Placement::new(Affine::IDENTITY, Box3::from_size([64; 3])).expect("plain");
            let style = Style {
                iso: 0.0,
                inside,
                placement,
                normals: false,
                keys: true,
                level: Level::Portable,
            };
            let results: Vec<Piece> = Level::available()
                .iter()
                .map(|level| {
                    let (mut block, mut piece, mut out) = Default::default();
                    assert!(level.scan(&mut block, &samples, &style));
                    level.emit(
                        &block,
                        &samples,
                        &style,
                        [true, false, true],
                        &mut piece,
                        &mut out,
                    );
                    piece
                })
                .collect();
            for (piece, level) in results.iter().zip(Level::available()) {
                assert_eq!(piece.positions, results[0].positions, "{level:?}");
                assert_eq!(piece.triangles, results[0].triangles, "{level:?}");
                assert_eq!(
                    (&piece.own, &piece.keys),
                    (&results[0].own, &results[0].keys),
                    "{level:?}"
                );
            }
        }
    }
}
