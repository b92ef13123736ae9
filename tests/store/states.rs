//! What a loss of power may leave of a recorded run: any subset of the sectors that were not synced,
//! each in any of its versions, any length between, one sector torn or one block turned to noise.

use super::disk::{BLOCK, Op, SECTOR};
use crate::support::rng::Rng;
use brickmarch::store::Storage;
use std::collections::BTreeMap;
use std::io;
use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

/// The bytes after the crash; one buffer for millions of states.
#[derive(Debug, Default)]
pub(crate) struct Platter(RwLock<(Vec<u8>, usize)>);

impl Platter {
    fn write(&self) -> RwLockWriteGuard<'_, (Vec<u8>, usize)> {
        self.0.write().unwrap_or_else(PoisonError::into_inner)
    }

    fn read(&self) -> RwLockReadGuard<'_, (Vec<u8>, usize)> {
        self.0.read().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn image(&self) -> Vec<u8> {
        let both = self.read();
        both.0[..both.1].to_vec()
    }

    /// Turns a block to noise.
    pub(crate) fn spoil(&self, start: usize, rng: &mut Rng) {
        let mut both = self.write();
        for word in both.0[start..start + BLOCK].chunks_mut(8) {
            word.copy_from_slice(&rng.next().to_le_bytes());
        }
    }
}

impl Storage for Platter {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let both = self.read();
        let bytes = usize::try_from(offset)
            .ok()
            .and_then(|at| both.0[..both.1].get(at..at.checked_add(buffer.len())?))
            .ok_or(io::ErrorKind::UnexpectedEof)?;
        buffer.copy_from_slice(bytes);
        Ok(())
    }

    fn write_at(&self, _: &[u8], _: u64) -> io::Result<()> {
        Err(io::ErrorKind::ReadOnlyFilesystem.into())
    }

    fn len(&self) -> io::Result<u64> {
        Ok(self.read().1 as u64)
    }

    fn set_len(&self, _: u64) -> io::Result<()> {
        Err(io::ErrorKind::ReadOnlyFilesystem.into())
    }

    fn sync(&self) -> io::Result<()> {
        Ok(())
    }

    fn lock(&self) -> io::Result<bool> {
        Ok(true)
    }
}

/// A point of a recorded run at which the power may fail.
#[derive(Debug)]
pub(crate) struct Point {
    /// Calls that were made before.
    pub(crate) calls: usize,
    /// Commits reported as done; at most one more was asked for.
    pub(crate) acked: usize,
    pub(crate) begun: usize,
    /// The image at the last sync.
    durable: Vec<u8>,
    /// Contents of each sector that was written since, oldest first.
    dirty: Vec<(usize, Vec<[u8; SECTOR]>)>,
    lengths: Vec<usize>,
}

/// All points of a run on a disk that held `image`, of which commit `acked` was done.
pub(crate) fn points(image: &[u8], ops: &[Op], acked: usize) -> Vec<Point> {
    let mut durable = image.to_vec();
    let (mut acked, mut begun) = (acked, acked);
    let mut now = image.to_vec();
    let mut dirty: BTreeMap<usize, Vec<[u8; SECTOR]>> = BTreeMap::new();
    let mut lengths = vec![durable.len()];
    let mut all = Vec::new();
    for calls in 0..=ops.len() {
        all.push(Point {
            calls,
            acked,
            begun,
            durable: durable.clone(),
            dirty: dirty.iter().map(|(at, v)| (*at, v.clone())).collect(),
            lengths: lengths.clone(),
        });
        match ops.get(calls) {
            None => {}
            Some(Op::Begun(n)) => begun = begun.max(*n),
            Some(Op::Acked(n)) => acked = acked.max(*n),
            Some(Op::SetLen(length)) => {
                now.resize(*length as usize, 0);
                lengths.push(now.len());
            }
            Some(Op::Sync) => {
                durable.clone_from(&now);
                dirty.clear();
                lengths = vec![durable.len()];
            }
            Some(Op::Write { offset, bytes }) if !bytes.is_empty() => {
                let (start, end) = (*offset as usize, *offset as usize + bytes.len());
                if now.len() < end {
                    now.resize(end, 0);
                    lengths.push(end);
                }
                now[start..end].copy_from_slice(bytes);
                for sector in start / SECTOR..end.div_ceil(SECTOR) {
                    dirty
                        .entry(sector)
                        .or_default()
                        .push(sector_of(&now, sector));
                }
            }
            Some(Op::Write { .. }) => {}
        }
    }
    // A point where nothing is in flight tells nothing that its neighbour does not.
    all.dedup_by(|b, a| {
        a.dirty.is_empty()
            && b.dirty.is_empty()
            && (a.acked, a.begun) == (b.acked, b.begun)
            && a.durable == b.durable
    });
    all
}

fn sector_of(bytes: &[u8], sector: usize) -> [u8; SECTOR] {
    let mut out = [0; SECTOR];
    let start = sector * SECTOR;
    if let Some(rest) = bytes.get(start..) {
        let n = rest.len().min(SECTOR);
        out[..n].copy_from_slice(&rest[..n]);
    }
    out
}

/// The accident on top of lost sectors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Accident {
    None,
    /// Only the first bytes of this dirty sector are new.
    Torn(usize, usize),
    /// The block of this dirty sector is noise.
    Noise(usize, u64),
}

/// One state, to be printed when it is the one that fails.
#[derive(Clone, Debug)]
pub(crate) struct Choice {
    /// Version of each dirty sector, 0 = as it was at the last sync.
    pub(crate) versions: Vec<usize>,
    pub(crate) length: usize,
    pub(crate) accident: Accident,
}

impl Point {
    /// Number of subsets of sectors, when it is small enough to try all.
    pub(crate) fn subsets(&self, most: usize) -> Option<usize> {
        self.dirty
            .iter()
            .try_fold(1usize, |n, (_, v)| n.checked_mul(v.len() + 1))
            .filter(|&n| n <= most)
    }

    /// The n-th subset, without accident.
    pub(crate) fn subset(&self, mut n: usize, choice: &mut Choice) {
        choice.versions.clear();
        for (_, versions) in &self.dirty {
            choice.versions.push(n % (versions.len() + 1));
            n /= versions.len() + 1;
        }
        choice.length = self.longest();
        choice.accident = Accident::None;
    }

    fn longest(&self) -> usize {
        self.lengths.last().copied().unwrap_or(0)
    }

    /// A random state.
    pub(crate) fn random(&self, rng: &mut Rng, choice: &mut Choice) {
        choice.versions.clear();
        let n = self.dirty.len();
        // Most sectors old, half, most new; all but one; in order of the file.
        let mode = rng.below(5);
        let one = rng.below(n.max(1) as u64) as usize;
        for (i, (_, versions)) in self.dirty.iter().enumerate() {
            let newest = versions.len();
            let any = rng.below(newest as u64 + 1) as usize;
            choice.versions.push(match mode {
                0 if rng.below(8) > 0 => 0,
                1 if rng.below(8) > 0 => newest,
                2 => (i != one) as usize * newest,
                3 => (i < one) as usize * newest,
                _ => any,
            });
        }
        choice.length = if rng.chance(6) {
            rng.pick(&self.lengths)
        } else {
            self.longest()
        };
        choice.accident = match rng.below(4) {
            0 if n > 0 => Accident::Torn(
                rng.below(n as u64) as usize,
                rng.below(SECTOR as u64) as usize,
            ),
            1 if n > 0 => Accident::Noise(rng.below(n as u64) as usize, rng.next()),
            _ => Accident::None,
        };
    }

    /// Puts the state on the platter, which must hold this point (see [`lay`](Self::lay)).
    pub(crate) fn apply(&self, choice: &Choice, platter: &Platter) {
        let mut both = platter.write();
        let (bytes, length) = &mut *both;
        for ((sector, versions), &version) in self.dirty.iter().zip(&choice.versions) {
            if version > 0 {
                bytes[sector * SECTOR..][..SECTOR].copy_from_slice(&versions[version - 1]);
            }
        }
        match choice.accident {
            Accident::None => {}
            Accident::Torn(at, cut) => {
                let (sector, versions) = &self.dirty[at];
                let newest = versions.last().expect("a dirty sector has a version");
                let new = &mut bytes[sector * SECTOR..][..SECTOR];
                new.copy_from_slice(&sector_of(&self.durable, *sector));
                new[..cut].copy_from_slice(&newest[..cut]);
            }
            Accident::Noise(at, seed) => {
                let start = self.dirty[at].0 * SECTOR / BLOCK * BLOCK;
                let mut rng = Rng::new(seed);
                let end = (start + BLOCK).min(bytes.len());
                for word in bytes[start..end].chunks_mut(8) {
                    word.copy_from_slice(&rng.next().to_le_bytes()[..word.len()]);
                }
            }
        }
        *length = choice.length;
        let room = bytes.len();
        bytes[choice.length.min(room)..].fill(0);
    }

    /// Makes the platter hold what was synced.
    pub(crate) fn lay(&self, platter: &Platter) {
        let mut both = platter.write();
        let (bytes, length) = &mut *both;
        bytes.clear();
        bytes.extend_from_slice(&self.durable);
        let last = self.dirty.last().map_or(0, |(s, _)| (s + 1) * SECTOR);
        let longest = self.lengths.iter().copied().max().unwrap_or(0);
        let room = last.max(longest).next_multiple_of(BLOCK);
        bytes.resize(room.max(bytes.len()), 0);
        *length = self.durable.len();
    }

    /// Takes back what [`apply`](Self::apply) did.
    pub(crate) fn restore(&self, choice: &Choice, platter: &Platter) {
        let mut both = platter.write();
        let bytes = &mut both.0;
        let mut back = |start: usize, end: usize| {
            let end = end.min(bytes.len());
            if start >= end {
                return;
            }
            let known = self.durable.len().clamp(start, end);
            if start < known {
                bytes[start..known].copy_from_slice(&self.durable[start..known]);
            }
            bytes[known..end].fill(0);
        };
        for (sector, _) in &self.dirty {
            back(sector * SECTOR, (sector + 1) * SECTOR);
        }
        if let Accident::Noise(at, _) = choice.accident {
            let start = self.dirty[at].0 * SECTOR / BLOCK * BLOCK;
            back(start, start + BLOCK);
        }
        if choice.length < self.durable.len() {
            back(choice.length, self.durable.len());
        }
        both.1 = self.durable.len();
    }

    /// Whether an unfinished commit, of a writer that was killed, follows the last one. With a
    /// superblock damaged nobody can then tell whether it is a newer one that was lost.
    pub(crate) fn has_tail(&self) -> bool {
        let ends = [4096 + 16, 8192 + 16].map(|at| {
            let bytes = self.durable.get(at..at + 8);
            bytes.map_or(0, |b| {
                u64::from_le_bytes(b.try_into().expect("eight bytes"))
            })
        });
        self.durable.len() as u64 > ends[0].max(ends[1])
    }

    /// Whether everything that was written is synced.
    pub(crate) fn is_at_rest(&self) -> bool {
        self.dirty.is_empty() && self.lengths.len() == 1 && self.acked == self.begun
    }
}
