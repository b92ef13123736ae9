//! A stream of samples into a volume file: slab by slab of one brick edge of slices, one slab read
//! while the one before is encoded. Slabs that do not fit the budget go through a scratch file.

use super::aside::{Aside, create_aside};
use super::crew::{BATCH_EDGE, Crew, threads_for};
use super::encode::BrickEncoder;
use super::open::{NO_COMMIT, Opened};
use super::spec::{VolumeInfo, VolumeSpec};
use super::storage::{FileStorage, Storage};
use super::volume::Volume;
use super::writer::{VolumeWriter, take_lock};
use crate::budget::{Budget, Permit, human_bytes};
use crate::error::{Error, ErrorKind, Result};
use crate::lattice::Box3;
use crossbeam::channel::{Receiver, Sender, bounded};
use std::fs::{File, OpenOptions};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Bytes that are read from the source at a time.
const CHUNK: usize = 1 << 20;

/// Samples (as raw bytes) between two commits of an import: what a kill costs at most.
const COMMIT_BYTES: u64 = 256 << 20;

/// How to import.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImportOptions {
    /// Go on with an import that was stopped, where there is one; see [`partial_path`].
    pub resume: bool,
    /// Coarser levels to build, at most; see [`Volume::level`](super::Volume::level).
    pub levels: u8,
}

/// Where an import keeps what it has until it is whole: `OUT.partial`. It stays there when the
/// import is killed, cancelled or stopped by the medium after its first commit.
pub fn partial_path(out: &Path) -> PathBuf {
    let mut name = out.as_os_str().to_os_string();
    name.push(".partial");
    name.into()
}

/// [`import_with`] and its default options.
///
/// # Errors
/// As [`import_with`].
pub fn import_stream(
    source: &mut dyn Read,
    spec: &VolumeSpec,
    out: &Path,
    budget: &Budget,
) -> Result<VolumeInfo> {
    import_with(source, spec, out, &ImportOptions::default(), budget)
}

/// Writes the samples of `source` to a volume file at `out`. The source gives the raw little-endian
/// samples of the whole domain, `i` fastest, one byte per bit.
///
/// The bytes of the file do not depend on the number of threads, on the budget, or on whether the
/// import was stopped and resumed: bricks stand in the order of the source, by slabs, then rows of
/// bricks, then along `i`, with a commit after each 256 MiB of samples.
///
/// # Errors
/// A source that ends early, goes on after the last sample, fails, or when resuming is not the one
/// that the import began with; a write that fails; `ForeignWriter` while another import writes to
/// the same place. Nothing is then under `out`.
///
/// # Memory
/// Two slabs of `brick_edge` slices where half of the free budget holds them. Otherwise they go to a
/// scratch file beside `out`, and memory is a few MiB per thread.
pub fn import_with(
    source: &mut dyn Read,
    spec: &VolumeSpec,
    out: &Path,
    options: &ImportOptions,
    budget: &Budget,
) -> Result<VolumeInfo> {
    import_committing(source, None, spec, out, options, COMMIT_BYTES, budget)
}

/// [`import_with`] for samples that also stand in `file` as they are from `offset` on: they are read
/// there in the order of the bricks, so that there is no scratch file. The bytes of the volume file
/// are the same.
///
/// # Errors
/// As [`import_with`]. Nobody may write to the file meanwhile; what it holds then is imported.
///
/// # Memory
/// A few MiB per thread.
pub fn import_plain(
    source: &mut dyn Read,
    (file, offset): (&File, u64),
    spec: &VolumeSpec,
    out: &Path,
    options: &ImportOptions,
    budget: &Budget,
) -> Result<VolumeInfo> {
    let plain = Some((file, offset));
    import_committing(source, plain, spec, out, options, COMMIT_BYTES, budget)
}

/// [`import_with`] into `storage`, whose content is replaced unless it is an import that `options`
/// say to resume; a commit after each `commit_bytes` of samples. `name` is for messages.
///
/// # Errors
/// As [`import_with`]; the storage then holds the last commit.
///
/// # Memory
/// As [`import_with`]; a scratch file would be beside `name`.
pub fn import_in(
    storage: Arc<dyn Storage>,
    name: &Path,
    source: &mut dyn Read,
    spec: &VolumeSpec,
    options: &ImportOptions,
    commit_bytes: u64,
    budget: &Budget,
) -> Result<VolumeInfo> {
    spec.validate().map_err(|e| e.context(name.display()))?;
    let is_locked = take_lock(storage.as_ref(), name)?;
    let resumed = match options.resume {
        true => resume(storage.clone(), is_locked, spec, name, name, budget)?,
        false => None,
    };
    let begun = match resumed {
        Some(writer) => (writer, true),
        None => {
            storage
                .set_len(0)
                .map_err(|e| Error::io(name, "removing what an earlier import left", e))?;
            let writer = VolumeWriter::start(storage, is_locked, name, spec, budget, None)?;
            (writer, false)
        }
    };
    run(
        begun,
        source,
        None,
        name,
        name,
        options,
        commit_bytes,
        budget,
    )
}

fn import_committing(
    source: &mut dyn Read,
    plain: Option<(&File, u64)>,
    spec: &VolumeSpec,
    out: &Path,
    options: &ImportOptions,
    commit_bytes: u64,
    budget: &Budget,
) -> Result<VolumeInfo> {
    spec.validate().map_err(|e| e.context(out.display()))?;
    let begun = start(spec, out, options, budget)?;
    let place = partial_path(out);
    run(
        begun,
        source,
        plain,
        &place,
        out,
        options,
        commit_bytes,
        budget,
    )
}

/// Fills the file at `place`, which will be at `out`.
#[expect(clippy::too_many_arguments, reason = "the parts of an import")]
fn run(
    (mut writer, resumed): (VolumeWriter, bool),
    source: &mut dyn Read,
    plain: Option<(&File, u64)>,
    place: &Path,
    out: &Path,
    options: &ImportOptions,
    commit_bytes: u64,
    budget: &Budget,
) -> Result<VolumeInfo> {
    if resumed && writer.parts[0].mark().0 == 0 {
        // Killed before the rename.
        return match check_whole(source, &mut writer, place, options, budget) {
            Ok(()) => writer.finish(),
            Err(e) => {
                writer.keep();
                Err(e)
            }
        };
    }
    let filled = fill(source, plain, &writer, out, commit_bytes, budget)
        .and_then(|()| match options.levels {
            0 => Ok(()),
            levels => writer.build_levels(levels),
        })
        .and_then(|()| {
            writer.parts[0].set_mark((0, 0));
            writer.commit()
        });
    match filled {
        Ok(_) => writer.finish(),
        Err(e) => {
            let slabs = writer.committed_slabs();
            let again = !matches!(e.kind(), ErrorKind::Truncated | ErrorKind::BadInput);
            let e = if again { e } else { e.context(out.display()) };
            if resumed || (again && slabs > 0) {
                let all = writer.bricks()[2];
                writer.keep();
                return Err(e.followed_by(&format!(
                    "; {} keeps {slabs} of {all} slabs: resume the import to go on",
                    place.display()
                )));
            }
            Err(e)
        }
    }
}

/// Compares the source with the whole volume that an import left, which no longer knows the checksum
/// of its source.
fn check_whole(
    source: &mut dyn Read,
    writer: &mut VolumeWriter,
    place: &Path,
    options: &ImportOptions,
    budget: &Budget,
) -> Result<()> {
    let volume = Volume::open_in(writer.log.storage.clone(), place, budget)?;
    let Box3 { min, max } = volume.spec().grid.domain;
    let size = volume.spec().grid.domain.size().map(u64::from);
    let row = size[0].saturating_mul(volume.spec().sample.bytes() as u64);
    let rows = (CHUNK as u64 / row.max(1)).clamp(1, size[1]);
    let total = row.saturating_mul(size[1]).saturating_mul(size[2]);
    let _permit = budget.take(2 * rows * row, "comparing with the source")?;
    let mut wanted = vec![0; (rows * row) as usize];
    let mut there = wanted.clone();
    let mut done = 0;
    for k in min[2]..max[2] {
        for j in (min[1]..max[1]).step_by(rows as usize) {
            budget.check_cancelled()?;
            let end = max[1].min(j.saturating_add(rows as i32));
            let n = ((end - j) as u64 * row) as usize;
            read_all(source, &mut wanted[..n], done, total)?;
            volume.read_raw(
                Box3::new([min[0], j, k], [max[0], end, k + 1]),
                &mut there[..n],
            )?;
            if wanted[..n] != there[..n] {
                return Err(Error::bad_input(format!(
                    "{}: a whole volume, but not of this source (bytes {done} to {} differ): import again without resuming",
                    place.display(),
                    done + n as u64
                )));
            }
            done += n as u64;
        }
    }
    check_end(source, total)?;
    if volume.levels() < options.levels {
        writer.build_levels(options.levels)?;
        writer.commit()?;
    }
    Ok(())
}

/// The writer of a new import, or of the one that is to go on.
fn start(
    spec: &VolumeSpec,
    out: &Path,
    options: &ImportOptions,
    budget: &Budget,
) -> Result<(VolumeWriter, bool)> {
    let place = partial_path(out);
    let open = |new: bool| {
        OpenOptions::new()
            .read(true)
            .write(true)
            .create_new(new)
            .open(&place)
    };
    match open(false) {
        Ok(file) => {
            let storage = Arc::new(FileStorage(file));
            let is_locked = take_lock(storage.as_ref(), &place)?;
            if options.resume
                && let Some(writer) = resume(storage, is_locked, spec, &place, out, budget)?
            {
                return Ok((writer.with_aside(Aside::existing(place)), true));
            }
            std::fs::remove_file(&place)
                .map_err(|e| Error::io(&place, "removing what an earlier import left", e))?;
        }
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {}
        Err(e) => return Err(Error::io(&place, "opening what an earlier import left", e)),
    }
    let file = open(true).map_err(|e| Error::io(&place, "creating the file", e))?;
    let aside = Aside::existing(place.clone());
    let storage = Arc::new(FileStorage(file));
    let is_locked = take_lock(storage.as_ref(), &place)?;
    let writer = VolumeWriter::start(storage, is_locked, out, spec, budget, Some(aside))?;
    Ok((writer, false))
}

/// The writer that goes on with `storage`; `None` when there is no commit yet.
fn resume(
    storage: Arc<dyn Storage>,
    is_locked: bool,
    spec: &VolumeSpec,
    place: &Path,
    out: &Path,
    budget: &Budget,
) -> Result<Option<VolumeWriter>> {
    match Opened::open(storage.clone(), place) {
        // Killed before the first commit; a loss of power then may leave zeros for the header.
        Err(e) if matches!(e.kind(), ErrorKind::Truncated | ErrorKind::NotAVolume) => {
            return Ok(None);
        }
        Err(e) if e.kind() == ErrorKind::DamagedRoot && e.to_string().contains(NO_COMMIT) => {
            return Ok(None);
        }
        Err(e) if storage.is_empty().unwrap_or(false) => {
            drop(e);
            return Ok(None);
        }
        Err(e) => return Err(e),
        Ok(_) => {}
    }
    let writer = VolumeWriter::resume(storage, is_locked, place, out, false, budget)?;
    if writer.spec() != spec {
        return Err(Error::bad_input(format!(
            "{}: begun from another source or with other settings: import again without resuming",
            place.display()
        )));
    }
    Ok(Some(writer))
}

/// Where the samples of a slab are.
enum Place {
    Memory(Vec<u8>),
    /// Offset in the scratch file.
    Scratch(u64),
}

/// One slab; gives its place back when the last job is done with it.
struct Slab {
    place: Option<Place>,
    /// Index of the slab, and its slices.
    z: u32,
    slices: usize,
    free: Sender<Place>,
}

impl Drop for Slab {
    fn drop(&mut self) {
        if let Some(place) = self.place.take() {
            // Nobody waits for it after the last slab.
            let _ = self.free.send(place);
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

/// Sizes that everybody needs.
struct Shape {
    size: [usize; 3],
    edge: usize,
    width: usize,
    /// The file that slabs are read from, its name, and what removes it when it is scratch.
    file: Option<(FileStorage, PathBuf, Option<Aside>)>,
    /// Offset of the first sample where that file is the source.
    plain: Option<u64>,
}

fn fill(
    source: &mut dyn Read,
    plain: Option<(&File, u64)>,
    writer: &VolumeWriter,
    out: &Path,
    commit_bytes: u64,
    budget: &Budget,
) -> Result<()> {
    let spec = writer.spec();
    let size = spec.grid.domain.size().map(|n| n as usize);
    let (edge, width) = (spec.brick_edge as usize, spec.sample.bytes());
    // As many bricks along i as make a batch.
    let batch =
        u64::from((BATCH_EDGE / spec.brick_edge).pow(3).max(1)).min(u64::from(writer.bricks()[0]));
    let segment_bytes = (edge.pow(3) * width) as u64 * (batch + 1);
    let per_thread = segment_bytes + writer.encoder_charge(0, batch);
    let slab_bytes = size[0] as u64 * size[1] as u64 * edge.min(size[2]) as u64 * width as u64;
    let in_memory = slab_bytes
        .checked_mul(2)
        .filter(|_| plain.is_none())
        .and_then(|both| {
            (both <= budget.free_bytes() / 2 && slab_bytes <= isize::MAX as u64)
                .then(|| budget.try_take(both))
                .flatten()
        });
    let (free_sender, free) = bounded(2);
    let mut shape = Shape {
        size,
        edge,
        width,
        file: None,
        plain: plain.map(|(_, offset)| offset),
    };
    let slabs_permit: Permit;
    match (plain, in_memory) {
        (Some((file, offset)), _) => {
            slabs_permit = budget.take(CHUNK as u64, "reading the source")?;
            let file = file
                .try_clone()
                .map_err(|e| Error::io(Path::new("source"), "opening once more", e))?;
            shape.file = Some((FileStorage(file), PathBuf::from("source"), None));
            for _ in 0..2 {
                let _ = free_sender.send(Place::Scratch(offset));
            }
        }
        (None, Some(permit)) => {
            slabs_permit = permit;
            for _ in 0..2 {
                let _ = free_sender.send(Place::Memory(vec![0; slab_bytes as usize]));
            }
        }
        (None, None) => {
            slabs_permit = budget.take(CHUNK as u64, "reading the source")?;
            let (file, aside) = create_aside(out)?;
            let path = aside.path().to_path_buf();
            shape.file = Some((FileStorage(file), path, Some(aside)));
            for slot in 0..2 {
                let _ = free_sender.send(Place::Scratch(slot * slab_bytes));
            }
        }
    }
    let threads = threads_for(budget, per_thread);
    budget
        .progress()
        .start(writer.bricks().into_iter().map(u64::from).product());
    let crew = Crew::default();
    let (jobs, queue) = bounded::<Job>(2 * threads);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            let queue = queue.clone();
            let (crew, shape) = (&crew, &shape);
            scope.spawn(move || {
                crew.run(|| work(&queue, crew, shape, writer, batch, segment_bytes, budget));
                // After a failure the queue must not fill up.
                queue.iter().for_each(drop);
            });
        }
        drop(queue);
        crew.run(|| {
            feed(
                source,
                &crew,
                &shape,
                writer,
                batch,
                jobs,
                &free,
                &free_sender,
                commit_bytes,
                budget,
            )
        });
    });
    drop(slabs_permit);
    crew.finish()
}

/// Reads slab after slab and hands out its jobs.
#[expect(clippy::too_many_arguments, reason = "one call; the parts of fill")]
fn feed(
    source: &mut dyn Read,
    crew: &Crew,
    shape: &Shape,
    writer: &VolumeWriter,
    batch: u64,
    jobs: Sender<Job>,
    free: &Receiver<Place>,
    free_sender: &Sender<Place>,
    commit_bytes: u64,
    budget: &Budget,
) -> Result<()> {
    let [bx, by, bz] = writer.bricks();
    let slice_bytes = shape.size[0] as u64 * shape.size[1] as u64 * shape.width as u64;
    // Only named in messages: a domain beyond 64 bits is never read to its end.
    let total = slice_bytes.saturating_mul(shape.size[2] as u64);
    let (first_slab, wanted_crc) = writer.parts[0].mark();
    let slab_bytes = slice_bytes.saturating_mul(shape.edge as u64);
    let slabs_per_commit = u32::try_from(commit_bytes / slab_bytes.max(1)).map_or(bz, |n| n.max(1));
    let mut done = slab_bytes.saturating_mul(u64::from(first_slab)).min(total);
    let mut ticket = 0u64;
    let mut chunk = Vec::new();
    let mut crc = skip(source, done, total, budget)?;
    if crc != wanted_crc {
        return Err(Error::bad_input(format!(
            "the first {done} bytes of the source are not those that the import began with: import again without resuming"
        )));
    }
    budget
        .progress()
        .add(u64::from(bx) * u64::from(by) * u64::from(first_slab));
    for z in first_slab..bz {
        let slices = shape.edge.min(shape.size[2] - z as usize * shape.edge);
        let mut place = loop {
            budget.check_cancelled()?;
            if crew.has_failed() {
                return Ok(());
            }
            if let Ok(place) = free.recv_timeout(std::time::Duration::from_millis(100)) {
                break place;
            }
        };
        let bytes = slice_bytes * slices as u64;
        if let Some(offset) = shape.plain {
            place = Place::Scratch(offset + done);
        }
        let mut at = 0u64;
        while at < bytes {
            budget.check_cancelled()?;
            let n = (bytes - at).min(CHUNK as u64) as usize;
            let target = match &mut place {
                Place::Memory(slab) => &mut slab[at as usize..][..n],
                Place::Scratch(_) => {
                    chunk.resize(CHUNK, 0);
                    &mut chunk[..n]
                }
            };
            read_all(source, target, done + at, total)?;
            crc = crc32c::crc32c_append(crc, target);
            if let (Place::Scratch(base), Some((file, path, Some(_)))) = (&place, &shape.file) {
                file.write_at(&chunk[..n], base + at)
                    .map_err(|e| Error::io(path, "writing the scratch file", e))?;
            }
            at += n as u64;
        }
        done += bytes;
        let slab = Arc::new(Slab {
            place: Some(place),
            z,
            slices,
            free: free_sender.clone(),
        });
        for y in 0..by {
            for first in (0..bx).step_by(batch as usize) {
                let end = bx.min(first + batch as u32);
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
        // By number of slabs, so that the bytes of the file depend on nothing else.
        if (z + 1) % slabs_per_commit == 0 && z + 1 < bz {
            if !crew.wait_for(ticket) {
                return Ok(());
            }
            writer.parts[0].set_mark((z + 1, crc));
            writer.commit()?;
        }
    }
    check_end(source, total)?;
    writer.parts[0].set_mark((bz, crc));
    Ok(())
}

/// Nothing follows the `total` bytes of the domain.
fn check_end(source: &mut dyn Read, total: u64) -> Result<()> {
    match source.read(&mut [0]) {
        Ok(0) => Ok(()),
        Ok(_) => Err(Error::bad_input(format!(
            "the source goes on after the {total} bytes ({}) of the domain: check dimensions and type",
            human_bytes(total)
        ))),
        Err(e) => Err(source_error(e, total)),
    }
}

/// Reads over the first `bytes` of the source and gives their checksum.
fn skip(source: &mut dyn Read, bytes: u64, total: u64, budget: &Budget) -> Result<u32> {
    let (mut at, mut crc) = (0, 0);
    let mut chunk = vec![0; bytes.min(CHUNK as u64) as usize];
    while at < bytes {
        budget.check_cancelled()?;
        let n = (bytes - at).min(CHUNK as u64) as usize;
        read_all(source, &mut chunk[..n], at, total)?;
        crc = crc32c::crc32c_append(crc, &chunk[..n]);
        at += n as u64;
    }
    Ok(crc)
}

fn read_all(source: &mut dyn Read, mut target: &mut [u8], before: u64, total: u64) -> Result<()> {
    let wanted = target.len();
    while !target.is_empty() {
        match source.read(target) {
            Ok(0) => {
                let got = before + (wanted - target.len()) as u64;
                return Err(Error::new(
                    ErrorKind::Truncated,
                    format!(
                        "the source ends after {got} of {total} bytes: check dimensions and type"
                    ),
                ));
            }
            Ok(n) => target = &mut target[n..],
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
            Err(e) => return Err(source_error(e, before)),
        }
    }
    Ok(())
}

/// An importer's reader may carry an error of this crate; its message says more than ours could.
fn source_error(error: std::io::Error, at: u64) -> Error {
    Error::io(
        Path::new("source"),
        &format!("reading samples near byte {at}"),
        error,
    )
}

/// Encodes jobs until there are no more.
fn work(
    queue: &Receiver<Job>,
    crew: &Crew,
    shape: &Shape,
    writer: &VolumeWriter,
    batch: u64,
    segment_bytes: u64,
    budget: &Budget,
) -> Result<()> {
    let mut encoder = writer.new_encoder(0, batch)?;
    let _permit = budget.take(segment_bytes, "gathering bricks")?;
    let mut raw = vec![0; shape.edge.pow(3) * shape.width];
    let mut segment = Vec::new();
    for job in queue {
        budget.check_cancelled()?;
        if crew.has_failed() {
            return Ok(());
        }
        encoder.batch.clear();
        encode_job(&job, shape, writer, &mut encoder, &mut raw, &mut segment)?;
        let (ticket, bricks) = (job.ticket, job.end - job.first);
        // The slab may be filled anew while this thread waits for its turn.
        drop(job);
        crew.append(ticket, writer, &encoder)?;
        budget.progress().add(bricks.into());
    }
    Ok(())
}

fn encode_job(
    job: &Job,
    shape: &Shape,
    writer: &VolumeWriter,
    encoder: &mut BrickEncoder,
    raw: &mut [u8],
    segment: &mut Vec<u8>,
) -> Result<()> {
    let Shape {
        size: [nx, ny, _],
        edge,
        width,
        ..
    } = *shape;
    let (i0, i1) = (job.first as usize * edge, (job.end as usize * edge).min(nx));
    let (j0, j1) = (
        job.y as usize * edge,
        (job.y as usize * edge + edge).min(ny),
    );
    let rows = j1 - j0;
    // The samples of the job: a view of the slab, or a copy out of the scratch file.
    let (data, row, slice, start) = match (&job.slab.place, &shape.file) {
        (Some(Place::Memory(slab)), _) => (
            &slab[..],
            nx * width,
            nx * ny * width,
            (i0 + nx * j0) * width,
        ),
        (Some(Place::Scratch(base)), Some((file, path, _))) => {
            let row = (i1 - i0) * width;
            segment.resize(row * rows * job.slab.slices, 0);
            for k in 0..job.slab.slices {
                let at = |j: usize| base + ((i0 + nx * (j0 + j + ny * k)) * width) as u64;
                // Full rows of a slice lie together.
                let (runs, run) = if row == nx * width {
                    (1, row * rows)
                } else {
                    (rows, row)
                };
                for j in 0..runs {
                    file.read_at(&mut segment[k * row * rows + j * run..][..run], at(j))
                        .map_err(|e| Error::io(path, "reading samples", e))?;
                }
            }
            (&segment[..], row, row * rows, 0)
        }
        _ => unreachable!("a slab has its place until it is dropped"),
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
        encoder.encode(writer, [x, job.y, job.slab.z], raw);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Dense, mixed, spec};
    use super::super::{Volume, verify};
    use super::*;
    use crate::{Field, Grid, SampleType};

    #[test]
    fn same_bytes_for_any_number_of_threads_and_through_the_scratch_file() {
        let folder = tempfile::tempdir().expect("scratch folder");
        let kinds = [
            SampleType::Bit,
            SampleType::U8,
            SampleType::I16,
            SampleType::F32,
        ];
        for (sample, edge) in kinds
            .map(|s| (s, 32))
            .into_iter()
            .chain([(SampleType::U16, 8)])
        {
            let dense = Dense::new(spec([70, 600, 40], sample, edge), mixed);
            let import = |threads: usize, bytes: u64| {
                let out = folder.path().join("v.bvol");
                let budget = Budget::bytes(bytes).with_threads(threads);
                let info = import_stream(&mut &dense.raw[..], &dense.spec, &out, &budget)
                    .expect("imports");
                assert_eq!(budget.used_bytes(), 0);
                assert_eq!(std::fs::read_dir(folder.path()).expect("lists").count(), 1);
                (info, std::fs::read(&out).expect("is there"))
            };
            let one = import(1, 64 << 20);
            // Two slabs of 1.3 MiB per byte of sample do not fit the last: it goes through the file.
            let small = (1300 << 10) + sample.bytes() as u64 * (2500 << 10);
            for (threads, bytes) in [(8, 64 << 20), (2, small)] {
                assert!(
                    import(threads, bytes) == one,
                    "{sample:?} {edge} {threads} {bytes}"
                );
            }
            let out = folder.path().join("v.bvol");
            let budget = Budget::mib(24);
            let volume = Volume::open(&out, &budget).expect("opens");
            dense.check(&volume, dense.spec.grid.domain);
            let report = verify(&out, &budget).expect("verifies");
            assert!(report.is_intact(), "{:?}", report.problems);
        }
    }

    /// Gives the first `left` bytes, then what `end` makes.
    struct Stops<'a> {
        raw: &'a [u8],
        left: usize,
        end: &'a dyn Fn() -> std::io::Error,
    }

    impl Read for Stops<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
            if self.left == 0 {
                return Err((self.end)());
            }
            let n = buffer.len().min(self.left).min(self.raw.len());
            buffer[..n].copy_from_slice(&self.raw[..n]);
            (self.raw, self.left) = (&self.raw[n..], self.left - n);
            Ok(n)
        }
    }

    #[test]
    fn samples_in_a_file_give_the_same_bytes_and_no_scratch_file() {
        use std::io::Write;
        let folder = tempfile::tempdir().expect("scratch folder");
        for (size, sample) in [
            ([75, 64, 37], SampleType::F32),
            ([300, 9, 20], SampleType::U8),
        ] {
            let dense = Dense::new(spec(size, sample, 8), mixed);
            let want = folder.path().join("want.bvol");
            import_stream(&mut &dense.raw[..], &dense.spec, &want, &Budget::mib(24))
                .expect("imports");
            let mut file = tempfile::tempfile().expect("a file");
            file.write_all(b"header").expect("written");
            file.write_all(&dense.raw).expect("written");
            for (mib, threads) in [(4, 1), (24, 3)] {
                let budget = Budget::mib(mib).with_threads(threads);
                let out = folder.path().join("out.bvol");
                let options = ImportOptions::default();
                let source = &mut &dense.raw[..];
                import_plain(source, (&file, 6), &dense.spec, &out, &options, &budget)
                    .expect("imports");
                assert!(std::fs::read(&out).expect("out") == std::fs::read(&want).expect("want"));
                assert_eq!(std::fs::read_dir(folder.path()).expect("folder").count(), 2);
                assert_eq!(budget.used_bytes(), 0);
            }
        }
    }

    #[test]
    fn a_stopped_import_goes_on() {
        let folder = tempfile::tempdir().expect("scratch folder");
        let out = folder.path().join("v.bvol");
        let spec = spec([100, 60, 90], SampleType::U16, 8);
        let dense = Dense::new(spec.clone(), mixed);
        let slab = 100 * 60 * 8 * 2;
        let entries = || std::fs::read_dir(folder.path()).expect("lists").count();
        for levels in [0, 2] {
            let options = ImportOptions {
                resume: true,
                levels,
            };
            let import = |source: &mut dyn Read, threads: usize| {
                let budget = Budget::mib(24).with_threads(threads);
                import_committing(
                    source,
                    None,
                    &spec,
                    &out,
                    &options,
                    3 * slab as u64,
                    &budget,
                )
            };
            import(&mut &dense.raw[..], 2).expect("in one go");
            let whole = std::fs::read(&out).expect("is there");
            std::fs::remove_file(&out).expect("removes");
            let broken = || std::io::Error::other("the cable");
            let stops = |left: usize, threads: usize| {
                let mut source = Stops {
                    raw: &dense.raw,
                    left,
                    end: &broken,
                };
                import(&mut source, threads).expect_err("stops")
            };
            // Before the first commit nothing is kept.
            let error = stops(slab * 5 / 2, 1);
            assert!(!error.to_string().contains("partial"), "{error}");
            assert_eq!(entries(), 0);
            for (cut, kept) in [(4, 3), (5, 3), (7, 6), (11, 9)] {
                let error = stops(slab * cut + 77, cut).to_string();
                assert!(error.contains(&format!("keeps {kept} of 12")), "{error}");
                assert!(!out.exists() && entries() == 1);
                let partial = Volume::open(&partial_path(&out), &Budget::mib(24)).expect("opens");
                assert_eq!(partial.info().expect("info").unfinished_slabs, Some(kept));
                let mut done = spec.grid.domain;
                done.max[2] = done.min[2] + 8 * kept as i32;
                dense.check(&partial, done);
                let report = verify(&partial_path(&out), &Budget::mib(24)).expect("verifies");
                assert!(report.is_intact(), "{:?}", report.problems);
            }
            // Another source, other settings, a writer for changes: refused, and nothing is lost.
            let mut other = dense.raw.clone();
            other[slab] ^= 1;
            let error = import(&mut &other[..], 1).expect_err("another source");
            assert_eq!(error.kind(), ErrorKind::BadInput, "{error}");
            let coarse = VolumeSpec {
                brick_edge: 16,
                ..spec.clone()
            };
            let budget = Budget::mib(24);
            let error = import_with(&mut &dense.raw[..], &coarse, &out, &options, &budget)
                .expect_err("other settings");
            assert_eq!(error.kind(), ErrorKind::BadInput, "{error}");
            assert!(VolumeWriter::open(&partial_path(&out), &budget).is_err());
            assert_eq!(entries(), 1);
            import(&mut &dense.raw[..], 3).expect("goes on");
            assert!(std::fs::read(&out).expect("is there") == whole);
            assert_eq!(entries(), 1);
            std::fs::remove_file(&out).expect("removes");
            // Killed before the rename: it is renamed when it is of this source.
            std::fs::write(partial_path(&out), &whole).expect("writes");
            let error = import(&mut &other[..], 1).expect_err("another source");
            assert_eq!(error.kind(), ErrorKind::BadInput, "{error}");
            import(&mut &dense.raw[..], 1).expect("renames");
            assert!(std::fs::read(&out).expect("is there") == whole);
            assert_eq!(entries(), 1);
            std::fs::remove_file(&out).expect("removes");
            // Without resuming what is left over is replaced; rubbish too small for a commit as well.
            stops(slab * 4, 1);
            import_stream(&mut &dense.raw[..], &spec, &out, &budget).expect("anew");
            std::fs::remove_file(&out).expect("removes");
            for rubbish in [&[][..], &whole[..5000], &whole[..12288], &[0; 20_000]] {
                std::fs::write(partial_path(&out), rubbish).expect("writes");
                import(&mut &dense.raw[..], 1).expect("anew");
                assert!(std::fs::read(&out).expect("is there") == whole);
                std::fs::remove_file(&out).expect("removes");
            }
        }
    }

    #[test]
    fn sources_of_the_wrong_length_are_refused() {
        let folder = tempfile::tempdir().expect("scratch folder");
        let out = folder.path().join("v.bvol");
        let spec = spec([30, 20, 20], SampleType::U16, 8);
        for (bytes, kind) in [
            (0, ErrorKind::Truncated),
            (23_999, ErrorKind::Truncated),
            (24_001, ErrorKind::BadInput),
        ] {
            let error = import_stream(&mut &vec![1; bytes][..], &spec, &out, &Budget::mib(24))
                .expect_err("refused");
            assert_eq!(error.kind(), kind, "{error}");
            assert!(error.to_string().contains("24000"), "{error}");
            assert_eq!(std::fs::read_dir(folder.path()).expect("lists").count(), 0);
        }
    }

    /// A real scan, big-endian 16-bit, against the dense array.
    #[test]
    #[expect(clippy::print_stderr, reason = "a skipped comparison says so")]
    fn tooth_reads_back_in_random_boxes() {
        let shared = std::env::var_os("BRICKMARCH_DATA").map_or_else(
            || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
            PathBuf::from,
        );
        let Ok(big_endian) = std::fs::read(shared.join("volumes/tooth.raw")) else {
            eprintln!(
                "SKIPPED tooth_reads_back_in_random_boxes: no volumes/tooth.raw; set BRICKMARCH_DATA"
            );
            return;
        };
        let raw: Vec<u8> = big_endian
            .as_chunks::<2>()
            .0
            .iter()
            .flat_map(|&[a, b]| [b, a])
            .collect();
        let folder = tempfile::tempdir().expect("scratch folder");
        let out = folder.path().join("tooth.bvol");
        let domain = Box3::from_size([103, 94, 161]);
        for edge in [8, 16, 32, 64] {
            let spec = VolumeSpec {
                brick_edge: edge,
                ..VolumeSpec::new(Grid::new(domain), SampleType::U16)
            };
            let dense = Dense {
                spec,
                raw: raw.clone(),
            };
            let budget = Budget::mib(24);
            let info = import_stream(&mut &raw[..], &dense.spec, &out, &budget).expect("imports");
            assert_eq!((info.range.min, info.range.max), (0.0, 1300.0));
            assert!(info.compression > 1.2, "{}", info.compression);
            let volume = Volume::open(&out, &budget).expect("opens");
            let mut state = 1u32;
            let mut random = |n: i32| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as i32 % n
            };
            dense.check(&volume, domain);
            for _ in 0..20 {
                let a: [i32; 3] = std::array::from_fn(|axis| random(domain.max[axis]));
                let b: [i32; 3] = std::array::from_fn(|axis| random(domain.max[axis]));
                let region = Box3::new(
                    std::array::from_fn(|axis| a[axis].min(b[axis])),
                    std::array::from_fn(|axis| a[axis].max(b[axis]) + 1),
                );
                dense.check(&volume, region);
            }
            assert!(verify(&out, &budget).expect("verifies").is_intact());
            assert_eq!(volume.range(domain).expect("range"), info.range);
        }
    }
}
