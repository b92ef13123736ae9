//! Ways to damage a file, the same on every machine.

use crate::rng::Rng;
use std::io;
use std::ops::Range;
use std::path::Path;

/// One way to damage a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Damage {
    /// Only this many bytes are left.
    Truncate(usize),
    /// These bits of one byte are turned.
    Flip {
        /// Which byte.
        at: usize,
        /// Which bits; not zero.
        bits: u8,
    },
    /// Random bytes at the end.
    Extend {
        /// How many.
        bytes: usize,
        /// Seed of the bytes.
        seed: u64,
    },
    /// Zeros over a range, as a lost block of a disk reads.
    Zero(Range<usize>),
    /// A range is replaced by the bytes at another place of the file.
    Splice {
        /// The range that is overwritten.
        to: Range<usize>,
        /// Where its new bytes start.
        from: usize,
    },
}

impl Damage {
    /// Applies the damage. Ranges beyond the end are cut off at the end.
    pub fn apply(&self, bytes: &mut Vec<u8>) {
        let length = bytes.len();
        let cut = |r: &Range<usize>| r.start.min(length)..r.end.clamp(r.start.min(length), length);
        match self {
            Damage::Truncate(left) => bytes.truncate(*left),
            Damage::Flip { at, bits } => {
                if let Some(byte) = bytes.get_mut(*at) {
                    *byte ^= bits;
                }
            }
            Damage::Extend { bytes: more, seed } => {
                let mut rng = Rng::new(*seed);
                bytes.extend((0..*more).map(|_| rng.next_u64() as u8));
            }
            Damage::Zero(range) => bytes[cut(range)].fill(0),
            Damage::Splice { to, from } => {
                let to = cut(to);
                let from = (*from).min(length);
                let count = to.len().min(length - from);
                bytes.copy_within(from..from + count, to.start);
            }
        }
    }

    /// The damaged copy of `bytes`.
    pub fn applied(&self, bytes: &[u8]) -> Vec<u8> {
        let mut copy = bytes.to_vec();
        self.apply(&mut copy);
        copy
    }

    /// Writes a damaged copy of the file `from` to `to`.
    ///
    /// # Errors
    /// When a file cannot be read or written.
    ///
    /// # Memory
    /// The whole file.
    pub fn copy_file(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut bytes = std::fs::read(from)?;
        self.apply(&mut bytes);
        std::fs::write(to, bytes)
    }

    /// Random damage of a file of `length` bytes, each kind as often as the others, that changes
    /// the length or touches at least one byte (a splice or zeros may still leave equal bytes).
    pub fn random(length: usize, rng: &mut Rng) -> Damage {
        let below = |bound: usize, rng: &mut Rng| rng.below(bound.max(1) as u64) as usize;
        let range = |rng: &mut Rng| {
            let start = below(length, rng);
            let longest = (length - start).min(1 << (1 + below(12, rng)));
            start..start + 1 + below(longest, rng)
        };
        match rng.below(5) {
            0 => Damage::Truncate(below(length, rng)),
            1 => Damage::Flip {
                at: below(length, rng),
                bits: 1 << rng.below(8),
            },
            2 => Damage::Extend {
                bytes: 1 + below(4096, rng),
                seed: rng.next_u64(),
            },
            3 => Damage::Zero(range(rng)),
            _ => Damage::Splice {
                to: range(rng),
                from: below(length, rng),
            },
        }
    }
}

/// Every length shorter than `length`, thinned to at most `count` when there are more; always with
/// the shortest and the longest.
pub fn truncations(length: usize, count: usize) -> impl Iterator<Item = Damage> {
    thinned(length, count).map(Damage::Truncate)
}

/// One flipped bit in every byte, thinned to at most `count` bytes.
pub fn flips(length: usize, count: usize, seed: u64) -> impl Iterator<Item = Damage> {
    let mut rng = Rng::new(seed);
    thinned(length, count).map(move |at| Damage::Flip {
        at,
        bits: 1 << rng.below(8),
    })
}

/// Numbers below `length`, at most `count` of them, evenly spread, with both ends.
fn thinned(length: usize, count: usize) -> impl Iterator<Item = usize> {
    let count = count.min(length);
    let last = length.saturating_sub(1) as u128;
    (0..count).map(move |m| {
        let steps = (count - 1).max(1) as u128;
        (last * m as u128 / steps) as usize
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kind_does_what_it_says() {
        let file: Vec<u8> = (1..=10).collect();
        assert_eq!(Damage::Truncate(3).applied(&file), [1, 2, 3]);
        let flipped = Damage::Flip { at: 1, bits: 0x80 }.applied(&file);
        assert_eq!(flipped[..3], [1, 0x82, 3]);
        let longer = Damage::Extend { bytes: 5, seed: 1 }.applied(&file);
        assert_eq!((longer.len(), &longer[..10]), (15, &file[..]));
        assert_eq!(Damage::Zero(8..20).applied(&file)[7..], [8, 0, 0]);
        let spliced = Damage::Splice { to: 0..4, from: 7 }.applied(&file);
        assert_eq!(spliced, [8, 9, 10, 4, 5, 6, 7, 8, 9, 10]);
        let beyond = Damage::Splice {
            to: 40..44,
            from: 70,
        }
        .applied(&file);
        assert_eq!(beyond, file);
    }

    #[test]
    fn random_damage_stays_inside_and_repeats() {
        let mut kinds = [0; 5];
        for length in [1usize, 2, 100, 5000] {
            let file = vec![0x5a; length];
            let mut rng = Rng::new(9);
            let mut again = Rng::new(9);
            for _ in 0..500 {
                let damage = Damage::random(length, &mut rng);
                assert_eq!(damage, Damage::random(length, &mut again));
                kinds[match &damage {
                    Damage::Truncate(left) => usize::from(*left >= length) * 9,
                    Damage::Flip { at, .. } => 1 + usize::from(*at >= length) * 9,
                    Damage::Extend { .. } => 2,
                    Damage::Zero(range) => 3 + usize::from(range.end > length) * 9,
                    Damage::Splice { to, .. } => 4 + usize::from(to.end > length) * 9,
                }] += 1;
                let _ = damage.applied(&file);
            }
        }
        assert!(kinds.iter().all(|&n| n > 250), "{kinds:?}");
    }

    #[test]
    fn thinned_lists_keep_both_ends() {
        let all: Vec<_> = truncations(5, 100).collect();
        assert_eq!(all, (0..5).map(Damage::Truncate).collect::<Vec<_>>());
        let some: Vec<_> = truncations(1000, 10).collect();
        assert_eq!(some.len(), 10);
        assert_eq!(some[0], Damage::Truncate(0));
        assert_eq!(some[9], Damage::Truncate(999));
        assert_eq!(flips(0, 10, 1).count(), 0);
    }
}
