//! A small volume written in several commits, and what it must hold after each of them.

use super::disk::{Disk, Op};
use crate::support::rng::Rng;
use brickmarch::store::{ImportOptions, Storage, Volume, VolumeSpec, VolumeWriter, import_in};
use brickmarch::{Box3, Budget, ErrorKind, Grid, Result, SampleType};
use std::io;
use std::path::Path;
use std::sync::Arc;

/// Eight bricks of 512 bytes.
pub(crate) const DOMAIN: Box3 = Box3::from_size([16, 16, 16]);
/// Samples of the domain.
pub(crate) const BYTES: usize = 4096;
const EDGE: usize = 8;

pub(crate) fn spec() -> VolumeSpec {
    VolumeSpec {
        brick_edge: EDGE as u32,
        ..VolumeSpec::new(Grid::new(DOMAIN), SampleType::U8)
    }
}

pub(crate) fn name() -> &'static Path {
    Path::new("disk.bvol")
}

/// Samples after each commit; state 0 is a disk on which nothing was ever finished.
pub(crate) type States = Vec<Vec<u8>>;

/// Other samples for some brick, of a kind that each codec meets: constant, background, smooth,
/// few values, noise.
fn fresh_brick(rng: &mut Rng) -> Vec<u8> {
    let base = rng.next() as u8;
    let at = |n: usize| [n % EDGE, n / EDGE % EDGE, n / EDGE / EDGE];
    let kind = rng.below(6);
    (0..EDGE.pow(3))
        .map(|n| match kind {
            0 => base,
            1 => 0,
            2 | 3 => base.wrapping_add((2 * at(n)[0] + 3 * at(n)[1] + 5 * at(n)[2]) as u8),
            4 => base.wrapping_add((at(n)[0] == at(n)[2]) as u8),
            _ => rng.next() as u8,
        })
        .collect()
}

/// Changes `bricks` bricks of the samples and says which.
pub(crate) fn change(samples: &mut [u8], bricks: usize, rng: &mut Rng) -> Vec<([u32; 3], Vec<u8>)> {
    let first = rng.below(8) as usize;
    let changed = (0..bricks).map(|n| (first + 3 * n) % 8);
    changed
        .map(|b| {
            let brick = [b & 1, b >> 1 & 1, b >> 2];
            let raw = fresh_brick(rng);
            for k in 0..EDGE {
                for j in 0..EDGE {
                    let to = brick[0] * 8 + 16 * (brick[1] * 8 + j + 16 * (brick[2] * 8 + k));
                    samples[to..to + EDGE].copy_from_slice(&raw[EDGE * (j + EDGE * k)..][..EDGE]);
                }
            }
            (brick.map(|v| v as u32), raw)
        })
        .collect()
}

/// Starts the volume on `storage`.
pub(crate) fn start(storage: Arc<dyn Storage>, budget: &Budget) -> Result<VolumeWriter> {
    VolumeWriter::create_in(storage, name(), &spec(), budget)
}

/// Goes on with the volume on `storage`.
pub(crate) fn reopen(storage: Arc<dyn Storage>, budget: &Budget) -> Result<VolumeWriter> {
    VolumeWriter::open_in(storage, name(), budget)
}

/// One commit with changes of `bricks` bricks; the new state is known before it is asked for.
pub(crate) fn step(
    writer: &VolumeWriter,
    disk: &Disk,
    states: &mut States,
    bricks: usize,
    rng: &mut Rng,
) -> Result<()> {
    let mut samples = states.last().expect("there is a state").clone();
    samples.resize(BYTES, 0);
    let changes = change(&mut samples, bricks, rng);
    states.push(samples);
    let n = states.len() - 1;
    for (brick, raw) in changes {
        writer.put_brick(brick, &raw)?;
    }
    disk.mark(Op::Begun(n));
    writer.commit()?;
    disk.mark(Op::Acked(n));
    Ok(())
}

/// Samples of the source of an import.
pub(crate) fn source(rng: &mut Rng) -> Vec<u8> {
    let mut samples = vec![0; BYTES];
    change(&mut samples, 8, rng);
    samples
}

/// What is there after the first of the two commits of an import.
pub(crate) fn first_slab(source: &[u8]) -> Vec<u8> {
    let mut samples = source.to_vec();
    samples[BYTES / 2..].fill(0);
    samples
}

/// A source that says on the disk which commit of the import may come next, and which one is done,
/// when the import asks for samples behind them.
struct Told<'a> {
    samples: &'a [u8],
    at: usize,
    disk: &'a Disk,
    /// Number of the state of the first slab.
    first: usize,
}

impl io::Read for Told<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        // A slab at a time; the second is asked for when the first is committed.
        let slab = BYTES / 2;
        let end = (self.at / slab + 1) * slab;
        let n = buffer.len().min(end.min(BYTES) - self.at);
        buffer[..n].copy_from_slice(&self.samples[self.at..self.at + n]);
        if self.at >= slab {
            self.disk.mark(Op::Acked(self.first));
            self.disk.mark(Op::Begun(self.first + 1));
        } else {
            self.disk.mark(Op::Begun(self.first));
        }
        self.at += n;
        Ok(n)
    }
}

/// Imports `samples` in two commits, or goes on with such an import. The states of both must be the
/// last two of `states`.
pub(crate) fn import(
    storage: Arc<dyn Storage>,
    disk: &Disk,
    samples: &[u8],
    states: &States,
    budget: &Budget,
) -> Result<()> {
    let first = states.len() - 2;
    let mut source = Told {
        samples,
        at: 0,
        disk,
        first,
    };
    let options = ImportOptions {
        resume: true,
        levels: 0,
        ..ImportOptions::default()
    };
    let slab = BYTES as u64 / 2;
    import_in(
        storage,
        name(),
        &mut source,
        &spec(),
        &options,
        slab,
        budget,
    )?;
    disk.mark(Op::Acked(first + 1));
    Ok(())
}

/// Reads all samples into `out`.
pub(crate) fn read(storage: Arc<dyn Storage>, budget: &Budget, out: &mut [u8]) -> Result<()> {
    Volume::open_in(storage, name(), budget)?.read_raw(DOMAIN, out)
}

/// What is wrong with a disk whose last acknowledged state is `acked` and whose last begun state is
/// `begun`; else the state that it holds.
pub(crate) fn judge(
    storage: Arc<dyn Storage>,
    budget: &Budget,
    states: &[Vec<u8>],
    acked: usize,
    begun: usize,
    out: &mut [u8],
) -> std::result::Result<usize, String> {
    match read(storage, budget, out) {
        // The newest first: states may happen to be equal.
        Ok(()) => match (acked..=begun).rev().find(|&n| states[n] == out) {
            Some(n) => Ok(n),
            None => Err(match states.iter().position(|s| s == out) {
                Some(n) => format!("state {n} came out"),
                None => "samples came out that were never committed".into(),
            }),
        },
        Err(e) => match e.kind() {
            ErrorKind::Truncated
            | ErrorKind::Damaged
            | ErrorKind::DamagedRoot
            | ErrorKind::NotAVolume
                if acked == 0 =>
            {
                Ok(0)
            }
            _ => Err(format!("unreadable: {e}")),
        },
    }
}
