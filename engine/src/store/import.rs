//! Imports: new ones, ones that go on where they were stopped, and ones that were whole already.

use super::aside::Aside;
use super::open::Opened;
use super::slabs::fill;
use super::source::{SOURCE_CHUNK, Source};
use super::spec::{Compression, VolumeInfo, VolumeSpec};
use super::storage::{FileStorage, Storage};
use super::volume::Volume;
use super::writer::{VolumeWriter, take_lock};
use crate::budget::Budget;
use crate::error::{Error, ErrorKind, Result};
use crate::lattice::Box3;
use std::fs::{File, OpenOptions};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Samples (as raw bytes) between two commits of an import: what a kill costs at most.
const COMMIT_BYTES: u64 = 256 << 20;

/// How to import.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImportOptions {
    /// Go on with an import that was stopped, where there is one; see [`partial_path`].
    pub resume: bool,
    /// Coarser levels to build, at most; see [`Volume::level`](super::Volume::level).
    pub levels: u8,
    /// How to compress. An import that is resumed with another setting goes on with that one.
    pub compression: Compression,
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
    let source = Source::stream(source, spec);
    import_committing(source, spec, out, options, COMMIT_BYTES, budget)
}

/// [`import_with`] for samples that stand in `file` as they are from `offset` on: they are read there
/// once, in the order of the bricks, so that there is no scratch file. The bytes of the volume file are
/// the same. What follows the samples in the file is not looked at.
///
/// # Errors
/// As [`import_with`]. Nobody may write to the file meanwhile; what it holds then is imported.
///
/// # Memory
/// A few MiB per thread.
pub fn import_plain(
    file: &File,
    offset: u64,
    spec: &VolumeSpec,
    out: &Path,
    options: &ImportOptions,
    budget: &Budget,
) -> Result<VolumeInfo> {
    let source = Source::in_file(file, offset, spec)?;
    import_committing(source, spec, out, options, COMMIT_BYTES, budget)
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
        Source::stream(source, spec),
        name,
        name,
        options,
        commit_bytes,
        budget,
    )
}

pub(super) fn import_committing(
    source: Source<'_>,
    spec: &VolumeSpec,
    out: &Path,
    options: &ImportOptions,
    commit_bytes: u64,
    budget: &Budget,
) -> Result<VolumeInfo> {
    spec.validate().map_err(|e| e.context(out.display()))?;
    let begun = start(spec, out, options, budget)?;
    let place = partial_path(out);
    run(begun, source, &place, out, options, commit_bytes, budget)
}

/// Fills the file at `place`, which will be at `out`.
fn run(
    (mut writer, resumed): (VolumeWriter, bool),
    mut source: Source<'_>,
    place: &Path,
    out: &Path,
    options: &ImportOptions,
    commit_bytes: u64,
    budget: &Budget,
) -> Result<VolumeInfo> {
    writer.set_compression(options.compression);
    if resumed && writer.parts[0].mark().0 == 0 {
        // Killed before the rename.
        return match check_whole(&mut source, &mut writer, place, options, budget) {
            Ok(()) => writer.finish(),
            Err(e) => {
                writer.keep();
                Err(e)
            }
        };
    }
    let filled = fill(&mut source, &writer, out, commit_bytes, budget)
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
    source: &mut Source<'_>,
    writer: &mut VolumeWriter,
    place: &Path,
    options: &ImportOptions,
    budget: &Budget,
) -> Result<()> {
    let volume = Volume::open_in(writer.log.storage.clone(), place, budget)?;
    let Box3 { min, max } = volume.spec().grid.domain;
    let size = volume.spec().grid.domain.size().map(u64::from);
    let row = size[0].saturating_mul(volume.spec().sample.bytes() as u64);
    let rows = (SOURCE_CHUNK as u64 / row.max(1)).clamp(1, size[1]);
    let _permit = budget.take(2 * rows * row, "comparing with the source")?;
    let mut wanted = vec![0; (rows * row) as usize];
    let mut there = wanted.clone();
    let mut done = 0;
    for k in min[2]..max[2] {
        for j in (min[1]..max[1]).step_by(rows as usize) {
            budget.check_cancelled()?;
            let end = max[1].min(j.saturating_add(rows as i32));
            let n = ((end - j) as u64 * row) as usize;
            source.read(&mut wanted[..n])?;
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
    source.check_end()?;
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
    // Killed before the first commit; a loss of power then may leave zeros for the header.
    if !Opened::has_commit(storage.clone(), place)? {
        return Ok(None);
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
