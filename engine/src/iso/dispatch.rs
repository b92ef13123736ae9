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
use super::block::{put_run, rows_with};
use super::cells::{RowNumbers, write_triangles};
use super::scan::{list_cells, portable_mask, row_masks};
use super::vertices::{list_edges, list_own, place};
pub(super) use crate::cpu::Level;
use crate::mesh::Piece;

impl Level {
    /// See [`Block::scan_with`].
    pub(super) fn scan(self, block: &mut Block, samples: &BlockSamples, style: &Style) -> bool {
        match self {
            Level::Portable => block.scan_with(
                samples,
                style,
                |samples, style, out| row_masks(samples, style, out, portable_mask),
                rows_with,
                list_cells,
            ),
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
                    rows_with,
                    put_run,
                    list_edges,
                    place,
                    list_own,
                    numbers: RowNumbers::new,
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
mod x86;

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
            // Blocks of 32 cells, plain and capped, and larger ones.
            ([33, 33, 33], false),
            ([33, 34, 34], true),
            ([17, 18, 18], true),
            ([33, 40, 40], false),
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
