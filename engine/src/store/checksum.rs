//! The checksum of joined bytes from those of the parts. `crc32c_combine` builds the matrix of "so many
//! zero bytes follow" for each call, which for runs of a few KiB took as long as the checksums; runs of one
//! length have one matrix.

/// Lengths whose matrices are kept; runs have one or two, those at the end of a source others.
const KEPT: usize = 4;

/// Joins checksums (CRC32C) of parts in their order.
#[derive(Default)]
pub(super) struct Joiner {
    /// Lengths seen last, the newest at the end, and of each bit of a checksum what it becomes when so
    /// many zero bytes follow; none for a length that came once.
    kept: Vec<(usize, Option<[u32; 32]>)>,
}

impl Joiner {
    /// The checksum of what has `first`, followed by `length` bytes that have `second`.
    pub(super) fn join(&mut self, first: u32, second: u32, length: usize) -> u32 {
        let Some((_, columns)) = self.kept.iter_mut().find(|(of, _)| *of == length) else {
            if self.kept.len() == KEPT {
                self.kept.remove(0);
            }
            self.kept.push((length, None));
            return crc32c::crc32c_combine(first, second, length);
        };
        let columns = columns.get_or_insert_with(|| {
            std::array::from_fn(|bit| crc32c::crc32c_combine(1 << bit, 0, length))
        });
        let chosen = columns.iter().enumerate();
        chosen.fold(second, |sum, (bit, column)| {
            sum ^ column & (first >> bit & 1).wrapping_neg()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_of_parts_join_to_that_of_the_whole() {
        let bytes: Vec<u8> = (0..100_000u32)
            .map(|n| (n.wrapping_mul(n) / 7) as u8)
            .collect();
        for lengths in [
            [500, 500, 500, 500],
            [0, 0, 1, 1],
            [7, 7, 7, 8],
            [64, 4096, 4096, 64],
            [1, 2, 3, 500],
        ] {
            let mut joiner = Joiner::default();
            let (mut at, mut crc) = (0, 0);
            for length in lengths.into_iter().cycle().take(20) {
                let length = length + at / 1200;
                crc = joiner.join(crc, crc32c::crc32c(&bytes[at..][..length]), length);
                at += length;
                assert_eq!(crc, crc32c::crc32c(&bytes[..at]), "{lengths:?}");
            }
        }
    }
}
