//! The samples of an import in the order of the source, made to bricks: slab by slab of one brick edge
//! of slices. A stream is read one slab ahead of what is encoded, into memory or, where two slabs do
//! not fit, through a scratch file. Samples that stand in a file already are read there, once.

use super::aside::{Aside, create_aside};
use super::checksum::Joiner;
use super::crew::{BATCH_EDGE, Crew, threads_for};
use super::encode::BrickEncoder;
use super::source::{SOURCE_CHUNK, Source, source_error};
use super::storage::{FileStorage, Storage};
use super::writer::VolumeWriter;
use crate::budget::{Budget, Permit};
use crate::error::{Error, Result};
use crossbeam::channel::{Receiver, Sender, bounded};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Bytes that a thread reads from a file for one job: long runs, as few calls as memory allows.
const SEGMENT_BYTES: u64 = 4 << 20;
/// Charged for the checksum of one run.
const RUN_BYTES: u64 = 64;

/// Where the samples of a slab are.
enum Place {
    Memory(Vec<u8>),
    /// Offset in the file.
    File(u64),
}

/// One slab; gives its place back when the last job is done with it.
struct Slab {
    place: Option<Place>,
    /// Index of the slab, and its slices.
    z: u32,
    slices: usize,
    /// Nobody waits for the places of a file that holds all of them.
    free: Option<Sender<Place>>,
}

impl Drop for Slab {
    fn drop(&mut self) {
        if let (Some(place), Some(free)) = (self.place.take(), &self.free) {
            // Nobody waits for it after the last slab.
            let _ = free.send(place);
        }
    }
}

/// Bricks `first..end` of brick row `y` of a slab.
struct Job {
    slab: Arc<Slab>,
    y: u32,
    first: u32,
    end: u32,
    ticket: u64,
}

/// What slabs are read from, where they are not in memory.
enum Backing {
    /// Samples that stand there as they are, the first at the offset.
    Plain(FileStorage, u64),
    /// Two slabs, written here and read again; the file goes when this is dropped.
    Scratch(FileStorage, Aside),
}

/// Checksum of bytes of the source, by the offset of the first.
struct Run {
    offset: u64,
    length: usize,
    crc: u32,
}

/// What all threads know.
struct Slabs<'a> {
    writer: &'a VolumeWriter,
    budget: &'a Budget,
    crew: Crew,
    size: [usize; 3],
    edge: usize,
    width: usize,
    /// Bricks along i of a job.
    batch: u32,
    /// Bytes of a job.
    segment_bytes: u64,
    backing: Option<Backing>,
    /// Of plain samples that were read since the last commit.
    runs: Mutex<Vec<Run>>,
}

/// Puts all bricks of the source, with a commit after each `commit_bytes` of it; the last slabs wait
/// for the commit of the caller.
pub(super) fn fill(
    source: &mut Source<'_>,
    writer: &VolumeWriter,
    out: &Path,
    commit_bytes: u64,
    budget: &Budget,
) -> Result<()> {
    let spec = writer.spec();
    let size = spec.grid.domain.size().map(|n| n as usize);
    let (edge, width) = (spec.brick_edge as usize, spec.sample.bytes());
    let slab_bytes =
        (size[0] as u64 * size[1] as u64).saturating_mul((edge.min(size[2]) * width) as u64);
    let (free_sender, free) = bounded(2);
    let permit: Permit;
    let backing = match source.file() {
        Some((file, offset)) => {
            let file = FileStorage(file.0.try_clone().map_err(|e| source_error(e, 0))?);
            permit = budget.take(0, "reading the source")?;
            Some(Backing::Plain(file, offset))
        }
        None => {
            let both = slab_bytes
                .checked_mul(2)
                .filter(|&both| both <= budget.free_bytes() / 2 && slab_bytes <= isize::MAX as u64);
            match both.and_then(|both| budget.try_take(both)) {
                Some(both) => {
                    permit = both;
                    for _ in 0..2 {
                        let _ = free_sender.send(Place::Memory(vec![0; slab_bytes as usize]));
                    }
                    None
                }
                None => {
                    permit = budget.take(SOURCE_CHUNK as u64, "reading the source")?;
                    let (file, aside) = create_aside(out)?;
                    for slot in 0..2 {
                        let _ = free_sender.send(Place::File(slot * slab_bytes));
                    }
                    Some(Backing::Scratch(FileStorage(file), aside))
                }
            }
        }
    };
    let brick_bytes = (edge.pow(3) * width) as u64;
    // As many bricks along i as make a batch; of a file as many as make long runs.
    let mut batch = u64::from((BATCH_EDGE / spec.brick_edge).pow(3).max(1));
    if backing.is_some() {
        batch = batch.max(SEGMENT_BYTES.min(budget.free_bytes() / 16) / brick_bytes);
    }
    let batch = batch.clamp(1, u64::from(writer.bricks()[0]));
    let slabs = Slabs {
        writer,
        budget,
        crew: Crew::default(),
        size,
        edge,
        width,
        batch: batch as u32,
        segment_bytes: brick_bytes * (batch + 1),
        backing,
        runs: Mutex::default(),
    };
    let per_thread = slabs.segment_bytes + writer.encoder_charge(0, batch);
    let threads = threads_for(budget, per_thread);
    let bricks = writer.bricks().into_iter().map(u64::from).product();
    budget.progress().start(bricks);
    let (jobs, queue) = bounded::<Job>(2 * threads);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            let (queue, slabs) = (queue.clone(), &slabs);
            scope.spawn(move || {
                slabs.crew.run(|| slabs.work(&queue));
                // After a failure the queue must not fill up.
                queue.iter().for_each(drop);
            });
        }
        drop(queue);
        let places = (free, free_sender);
        slabs
            .crew
            .run(|| slabs.feed(source, slab_bytes, commit_bytes, jobs, places));
    });
    drop(permit);
    slabs.crew.finish()
}

impl Slabs<'_> {
    /// Hands out the jobs of slab after slab, read before where the source is a stream.
    fn feed(
        &self,
        source: &mut Source<'_>,
        slab_bytes: u64,
        commit_bytes: u64,
        jobs: Sender<Job>,
        (free, free_sender): (Receiver<Place>, Sender<Place>),
    ) -> Result<()> {
        let [bx, by, bz] = self.writer.bricks();
        let slice_bytes = self.size[0] as u64 * self.size[1] as u64 * self.width as u64;
        let (first_slab, wanted_crc) = self.writer.parts[0].mark();
        let per_commit =
            u32::try_from(commit_bytes / slab_bytes.max(1)).map_or(bz, |slabs| slabs.max(1));
        let mut done = slice_bytes
            .saturating_mul(self.edge as u64)
            .saturating_mul(u64::from(first_slab))
            .min(slice_bytes.saturating_mul(self.size[2] as u64));
        let mut crc = source.skip(done, self.budget)?;
        if crc != wanted_crc {
            return Err(Error::bad_input(format!(
                "the first {done} bytes of the source are not those that the import began with: import again without resuming"
            )));
        }
        let progress = self.budget.progress();
        progress.add(u64::from(bx) * u64::from(by) * u64::from(first_slab));
        let runs = commit_bytes.min(slab_bytes.saturating_mul(bz.into())) / self.run_bytes() + 1;
        let _permit = match &self.backing {
            Some(Backing::Plain(..)) => self.budget.take(runs * RUN_BYTES, "checksums")?,
            _ => self.budget.take(0, "checksums")?,
        };
        let mut ticket = 0u64;
        let mut chunk = Vec::new();
        for z in first_slab..bz {
            let slices = self.edge.min(self.size[2] - z as usize * self.edge);
            let bytes = slice_bytes * slices as u64;
            let (place, free) = match &self.backing {
                Some(Backing::Plain(_, offset)) => (Place::File(offset + done), None),
                _ => {
                    let Some(mut place) = self.wait_for_place(&free)? else {
                        return Ok(());
                    };
                    crc = self.read_slab(source, &mut place, bytes, crc, &mut chunk)?;
                    (place, Some(free_sender.clone()))
                }
            };
            done += bytes;
            let slab = Arc::new(Slab {
                place: Some(place),
                z,
                slices,
                free,
            });
            for y in 0..by {
                for first in (0..bx).step_by(self.batch as usize) {
                    let end = bx.min(first + self.batch);
                    let job = Job {
                        slab: slab.clone(),
                        y,
                        first,
                        end,
                        ticket,
                    };
                    ticket += 1;
                    if jobs.send(job).is_err() {
                        return Ok(());
                    }
                }
            }
            drop(slab);
            let last = z + 1 == bz;
            // By number of slabs, so that the bytes of the file depend on nothing else.
            if last || (z + 1) % per_commit == 0 {
                if !self.crew.wait_for(ticket) {
                    return Ok(());
                }
                crc = self.join_runs(crc);
                self.writer.parts[0].set_mark((z + 1, crc));
                if !last {
                    self.writer.commit()?;
                }
            }
        }
        source.check_end()
    }

    /// Bytes of the shortest run of whole jobs.
    fn run_bytes(&self) -> u64 {
        (self.size[0].min(self.batch as usize * self.edge) * self.width) as u64
    }

    /// A place that no job needs any more; none after a failure.
    fn wait_for_place(&self, free: &Receiver<Place>) -> Result<Option<Place>> {
        loop {
            self.budget.check_cancelled()?;
            if self.crew.has_failed() {
                return Ok(None);
            }
            if let Ok(place) = free.recv_timeout(Duration::from_millis(100)) {
                return Ok(Some(place));
            }
        }
    }

    /// Reads the next `bytes` of a stream into `place`, and goes on with their checksum.
    fn read_slab(
        &self,
        source: &mut Source<'_>,
        place: &mut Place,
        bytes: u64,
        mut crc: u32,
        chunk: &mut Vec<u8>,
    ) -> Result<u32> {
        let mut at = 0;
        while at < bytes {
            self.budget.check_cancelled()?;
            let n = (bytes - at).min(SOURCE_CHUNK as u64) as usize;
            let target = match place {
                Place::Memory(slab) => &mut slab[at as usize..][..n],
                Place::File(_) => {
                    chunk.resize(SOURCE_CHUNK, 0);
                    &mut chunk[..n]
                }
            };
            source.read(target)?;
            crc = crc32c::crc32c_append(crc, target);
            if let (Place::File(base), Some(Backing::Scratch(file, aside))) =
                (&*place, &self.backing)
            {
                file.write_at(&chunk[..n], base + at)
                    .map_err(|e| Error::io(aside.path(), "writing the scratch file", e))?;
            }
            at += n as u64;
        }
        Ok(crc)
    }

    /// Goes on with the checksum `crc` over the runs that were read since the last time.
    fn join_runs(&self, crc: u32) -> u32 {
        let mut runs = self.runs.lock().unwrap_or_else(PoisonError::into_inner);
        runs.sort_unstable_by_key(|run| run.offset);
        let mut joiner = Joiner::default();
        runs.drain(..)
            .fold(crc, |crc, run| joiner.join(crc, run.crc, run.length))
    }

    /// Encodes jobs until there are no more.
    fn work(&self, queue: &Receiver<Job>) -> Result<()> {
        let mut encoder = self.writer.new_encoder(0, self.batch.into())?;
        let _permit = self.budget.take(self.segment_bytes, "gathering bricks")?;
        let mut raw = vec![0; self.edge.pow(3) * self.width];
        let mut segment = Vec::new();
        for job in queue {
            self.budget.check_cancelled()?;
            if self.crew.has_failed() {
                return Ok(());
            }
            encoder.batch.clear();
            self.encode(&job, &mut encoder, &mut raw, &mut segment)?;
            let (ticket, bricks) = (job.ticket, job.end - job.first);
            // The slab may be filled anew while this thread waits for its turn.
            drop(job);
            self.crew.append(ticket, self.writer, &encoder)?;
            self.budget.progress().add(bricks.into());
        }
        Ok(())
    }

    fn encode(
        &self,
        job: &Job,
        encoder: &mut BrickEncoder,
        raw: &mut [u8],
        segment: &mut Vec<u8>,
    ) -> Result<()> {
        let ([nx, ny, _], edge, width) = (self.size, self.edge, self.width);
        let (i0, i1) = (job.first as usize * edge, (job.end as usize * edge).min(nx));
        let j0 = job.y as usize * edge;
        let rows = edge.min(ny - j0);
        // The samples of the job: a view of the slab, or a copy out of the file.
        let (data, row, slice, start) = match &job.slab.place {
            Some(Place::Memory(slab)) => (
                &slab[..],
                nx * width,
                nx * ny * width,
                (i0 + nx * j0) * width,
            ),
            Some(Place::File(base)) => {
                self.read_segment(*base, [i0, i1], [j0, rows, job.slab.slices], segment)?;
                let row = (i1 - i0) * width;
                (&segment[..], row, row * rows, 0)
            }
            None => unreachable!("a slab has its place until it is dropped"),
        };
        for x in job.first..job.end {
            let from = (x - job.first) as usize * edge;
            let n = edge.min(i1 - i0 - from) * width;
            for k in 0..job.slab.slices {
                for j in 0..rows {
                    let line = &data[start + k * slice + j * row + from * width..][..n];
                    raw[(k * edge + j) * edge * width..][..n].copy_from_slice(line);
                }
            }
            encoder.encode(self.writer, [x, job.y, job.slab.z], raw);
        }
        Ok(())
    }

    /// Reads columns `i0..i1` of `rows` rows from `j0` on, of each slice of the slab at `base`.
    fn read_segment(
        &self,
        base: u64,
        [i0, i1]: [usize; 2],
        [j0, rows, slices]: [usize; 3],
        segment: &mut Vec<u8>,
    ) -> Result<()> {
        let ([nx, ny, _], width) = (self.size, self.width);
        let row = (i1 - i0) * width;
        segment.resize(row * rows * slices, 0);
        // Full rows of a slice lie together.
        let (count, length) = if row == nx * width {
            (1, row * rows)
        } else {
            (rows, row)
        };
        let mut sums = Vec::new();
        for (n, run) in segment.chunks_exact_mut(length).enumerate() {
            let (k, j) = (n / count, n % count);
            let at = base + ((i0 + nx * (j0 + j + ny * k)) * width) as u64;
            match &self.backing {
                Some(Backing::Plain(file, offset)) => {
                    file.read_at(run, at)
                        .map_err(|e| source_error(e, at - offset))?;
                    sums.push(Run {
                        offset: at,
                        length,
                        crc: crc32c::crc32c(run),
                    });
                }
                Some(Backing::Scratch(file, aside)) => file
                    .read_at(run, at)
                    .map_err(|e| Error::io(aside.path(), "reading the scratch file", e))?,
                None => unreachable!("a place in a file has one"),
            }
        }
        let mut runs = self.runs.lock().unwrap_or_else(PoisonError::into_inner);
        runs.append(&mut sums);
        Ok(())
    }
}
