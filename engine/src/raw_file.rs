//! A raw array on disk as a field, read in place: no import, no second copy of the data.
//!
//! Rows that lie close together in the file are fetched by one positioned read. Without
//! [`RawFile::scan_ranges`] nothing is known about the values of a box and nothing can be skipped.

mod bytes;
mod convert;
mod map;
mod ranges;

use crate::budget::{Budget, Permit};
use crate::error::{Error, ErrorKind, Result};
use crate::field::{Field, Range, Samples};
use crate::lattice::{Box3, Grid};
use crate::sample::{Kind, SampleType};
use bytes::{Bytes, Positioned};
use ranges::Ranges;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

/// Usual length of one read; a thread holds one buffer of it.
const READ_BYTES: usize = 256 << 10;
/// With less than this it is not worth to go on.
const MIN_READ_BYTES: usize = 4 << 10;
/// Rows with smaller gaps between them are read in one go: every page would be touched anyway.
const MAX_GAP_BYTES: u64 = 4 << 10;

/// How the samples lie in the file: `i` fastest, then `j`, then `k`, without gaps.
#[derive(Clone, Debug, PartialEq)]
pub struct RawSpec {
    /// Domain and place in the world.
    pub grid: Grid,
    /// Type of one sample; a `Bit` takes one byte, and every byte but 0 counts as 1.
    pub sample: SampleType,
    /// What the samples mean.
    pub kind: Kind,
    /// Most significant byte first.
    pub big_endian: bool,
    /// Bytes in front of the first sample.
    pub offset: u64,
    /// Whether the file may go on behind the last sample. Where it may not, a wrong size of the
    /// domain is noticed.
    pub more_follows: bool,
}

/// A raw array on disk, a [`Field`].
///
/// ```
/// use brickmarch::{Box3, Budget, Field, Grid, Kind, SampleType, Samples};
/// use brickmarch::raw_file::{RawFile, RawSpec};
/// # let folder = tempfile::tempdir().unwrap();
/// # let path = folder.path().join("small.raw");
/// std::fs::write(&path, [1u8, 2, 3, 4, 5, 6, 7, 8]).unwrap();
/// let spec = RawSpec::new(Grid::new(Box3::from_size([2, 2, 2])), SampleType::U8, Kind::Density);
/// let field = RawFile::open(&path, &spec, &Budget::mib(1)).unwrap();
/// let upper = Box3::new([0, 0, 1], [2, 2, 2]);
/// let mut values = [0.0; 4];
/// field.read(upper, &mut Samples::dense(&mut values, upper)).unwrap();
/// assert_eq!(values, [5.0, 6.0, 7.0, 8.0]);
/// ```
///
/// # Memory
/// One buffer of 256 KiB per thread that reads, under a permit of the budget (less where that is
/// short), kept for the next read; and the table of [`scan_ranges`](Self::scan_ranges).
pub struct RawFile {
    path: PathBuf,
    spec: RawSpec,
    bytes: Bytes,
    budget: Budget,
    idle: Mutex<Vec<Scratch>>,
    ranges: OnceLock<Ranges>,
}

/// A read buffer and its permit.
struct Scratch {
    // Dropped first: the memory is free before the permit is.
    buffer: Vec<u8>,
    _permit: Permit,
}

/// Bytes `start..end` of the file that hold rows `first..last` of a region.
#[derive(Clone, Copy)]
struct Run {
    start: u64,
    end: u64,
    first: usize,
    last: usize,
}

impl RawSpec {
    /// Little-endian samples that are the whole file.
    pub fn new(grid: Grid, sample: SampleType, kind: Kind) -> Self {
        Self {
            grid,
            sample,
            kind,
            big_endian: false,
            offset: 0,
            more_follows: false,
        }
    }

    /// Byte after the last sample, after a check of everything that the file has no part in.
    fn end(&self, path: &Path) -> Result<u64> {
        let domain = &self.grid.domain;
        if domain.is_empty() {
            return Err(Error::bad_input(format!(
                "{}: the domain {domain} of the raw samples is empty: every size must be at least 1",
                path.display()
            )));
        }
        self.grid
            .index_to_world
            .validate()
            .map_err(|e| e.context(path.display()))?;
        let size = domain.size();
        let samples: u128 = size.iter().map(|&n| u128::from(n)).product();
        // 2^96 samples at most: 128 bits suffice.
        let end = samples * self.sample.bytes() as u128 + u128::from(self.offset);
        u64::try_from(end)
            .ok()
            .filter(|&end| i64::try_from(end).is_ok())
            .ok_or_else(|| {
                Error::new(
                    ErrorKind::LimitExceeded,
                    format!(
                        "{}: {} x {} x {} samples of {} at byte {} end at byte {end}, beyond any file",
                        path.display(),
                        size[0],
                        size[1],
                        size[2],
                        self.sample.name(),
                        self.offset
                    ),
                )
            })
    }
}

impl RawFile {
    /// Opens `path`, to be read by positioned reads.
    ///
    /// # Errors
    /// When the file cannot be opened or is not a regular file ([`ErrorKind::Io`],
    /// [`ErrorKind::BadInput`]), is shorter than the samples ([`ErrorKind::Truncated`]) or longer
    /// (`BadInput`, unless [`RawSpec::more_follows`]), or the domain makes no sense.
    pub fn open(path: &Path, spec: &RawSpec, budget: &Budget) -> Result<Self> {
        let file = Self::open_checked(path, spec)?;
        let bytes = Bytes::File(Positioned::new(file));
        Ok(Self::new(path, spec, budget, bytes))
    }

    fn new(path: &Path, spec: &RawSpec, budget: &Budget, bytes: Bytes) -> Self {
        Self {
            path: path.to_path_buf(),
            spec: spec.clone(),
            bytes,
            budget: budget.clone(),
            idle: Mutex::default(),
            ranges: OnceLock::new(),
        }
    }

    /// The file, after all checks that do not read samples.
    fn open_checked(path: &Path, spec: &RawSpec) -> Result<File> {
        let end = spec.end(path)?;
        let fail = |e| Error::io(path, "opening raw samples", e);
        // Looked at first: opening a pipe would wait for its other end.
        if !std::fs::metadata(path).map_err(fail)?.is_file() {
            return Err(Error::bad_input(format!(
                "{}: raw samples are read in place, which needs a regular file",
                path.display()
            )));
        }
        let file = File::open(path).map_err(fail)?;
        let found = file.metadata().map_err(fail)?.len();
        if found < end || (found > end && !spec.more_follows) {
            let kind = if found < end {
                ErrorKind::Truncated
            } else {
                ErrorKind::BadInput
            };
            let size = spec.grid.domain.size();
            return Err(Error::new(
                kind,
                format!(
                    "{}: the file has {found} bytes, but {} x {} x {} samples of {} at byte {} make {end}: check dimensions, type and offset",
                    path.display(),
                    size[0],
                    size[1],
                    size[2],
                    spec.sample.name(),
                    spec.offset,
                ),
            ));
        }
        Ok(file)
    }

    /// How the samples lie in the file.
    pub fn spec(&self) -> &RawSpec {
        &self.spec
    }

    /// Reads all samples once, in the order of the file, and keeps the smallest and largest of
    /// every block, so that [`Field::range`] can tell what to skip. A second call does nothing.
    ///
    /// Counts bytes in the progress of `budget`.
    ///
    /// # Errors
    /// When reading fails, the budget is cancelled, or it has no room for the table.
    ///
    /// # Memory
    /// 14 bytes per block as long as the field lives, under a permit of `budget`, while it runs
    /// also one read buffer per thread. Blocks are those of [`Field::block_edge`], or larger by a power
    /// of two such that the table takes at most a quarter of what is free.
    pub fn scan_ranges(&self, budget: &Budget) -> Result<()> {
        if self.ranges.get().is_none() {
            // Of two scans at one time the second result is dropped; they are equal.
            let _ = self.ranges.set(Ranges::scan(self, budget)?);
        }
        Ok(())
    }

    /// Offset in the file of a point of the domain.
    fn offset_of(&self, [i, j, k]: [i32; 3]) -> u64 {
        let Box3 { min, .. } = self.spec.grid.domain;
        let [nx, ny, _] = self.spec.grid.domain.size().map(u64::from);
        let local = |v: i32, a: usize| (i64::from(v) - i64::from(min[a])) as u64;
        let sample = local(i, 0) + nx * (local(j, 1) + ny * local(k, 2));
        self.spec.offset + sample * self.spec.sample.bytes() as u64
    }

    /// Hands the bytes `start..end` to `take`, in pieces of whole samples and in order.
    fn for_each_piece(
        &self,
        start: u64,
        end: u64,
        buffer: &mut [u8],
        mut take: impl FnMut(&[u8]) -> Result<()>,
    ) -> Result<()> {
        let width = self.spec.sample.bytes();
        let most = self.most(buffer) / width * width;
        let mut at = start;
        while at < end {
            let length = (end - at).min(most as u64) as usize;
            take(self.fetch(at, length, buffer)?)?;
            at += length as u64;
        }
        Ok(())
    }

    /// Bytes that one fetch may ask for.
    fn most(&self, buffer: &[u8]) -> usize {
        match self.bytes {
            Bytes::File(_) => buffer.len(),
            Bytes::Map { .. } => READ_BYTES,
        }
    }

    /// The `length` bytes at `offset`: a part of the map, or read into `buffer`.
    fn fetch<'a>(&'a self, offset: u64, length: usize, buffer: &'a mut [u8]) -> Result<&'a [u8]> {
        self.bytes.fetch(offset, length, buffer).map_err(|e| {
            let doing = format!("reading {length} bytes of raw samples at byte {offset}");
            Error::io(&self.path, &doing, e)
        })
    }

    fn idle(&self) -> MutexGuard<'_, Vec<Scratch>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn scratch(&self) -> Result<Scratch> {
        if let Some(scratch) = self.idle().pop() {
            return Ok(scratch);
        }
        let bytes = match self.bytes {
            Bytes::File(_) => READ_BYTES,
            Bytes::Map { .. } => 0,
        };
        Scratch::new(&self.budget, bytes)
    }

    fn put_back(&self, scratch: Scratch) {
        let mut idle = self.idle();
        if idle.len() < self.budget.threads() && scratch.buffer.len() == READ_BYTES {
            idle.push(scratch);
        }
    }

    /// The runs of rows of `region` that one read each should fetch.
    fn runs(&self, region: Box3, most: usize) -> impl Iterator<Item = Run> + use<'_> {
        let [nx, ny, nz] = region.size().map(|n| n as usize);
        let row_bytes = nx as u64 * self.spec.sample.bytes() as u64;
        let row = move |at: usize| {
            let [x, y, z] = region.min;
            self.offset_of([x, y + (at % ny) as i32, z + (at / ny) as i32])
        };
        let mut next = 0;
        std::iter::from_fn(move || {
            if next >= ny * nz {
                return None;
            }
            let start = row(next);
            let mut run = Run {
                start,
                end: start + row_bytes,
                first: next,
                last: next + 1,
            };
            while run.last < ny * nz {
                let follows = row(run.last);
                let end = follows + row_bytes;
                if follows - run.end > MAX_GAP_BYTES || end - start > most as u64 {
                    break;
                }
                run = Run {
                    end,
                    last: run.last + 1,
                    ..run
                };
            }
            next = run.last;
            Some(run)
        })
    }

    fn read_with(&self, region: Box3, out: &mut Samples<'_>, buffer: &mut [u8]) -> Result<()> {
        let [nx, ny, _] = region.size().map(|n| n as usize);
        let width = self.spec.sample.bytes();
        for run in self.runs(region, self.most(buffer)) {
            if run.last - run.first == 1 {
                // A row may be longer than the buffer.
                let mut row = out.row_mut(run.first % ny, run.first / ny, nx);
                self.for_each_piece(run.start, run.end, buffer, |raw| {
                    let (now, rest) = std::mem::take(&mut row).split_at_mut(raw.len() / width);
                    self.convert(raw, now);
                    row = rest;
                    Ok(())
                })?;
                continue;
            }
            let raw = self.fetch(run.start, (run.end - run.start) as usize, buffer)?;
            for at in run.first..run.last {
                let (j, k) = (at % ny, at / ny);
                let [x, y, z] = region.min;
                let offset = self.offset_of([x, y + j as i32, z + k as i32]) - run.start;
                let raw = &raw[offset as usize..][..nx * width];
                self.convert(raw, out.row_mut(j, k, nx));
            }
        }
        Ok(())
    }

    fn convert(&self, raw: &[u8], out: &mut [f32]) {
        convert::to_f32(self.spec.sample, self.spec.big_endian, raw, out);
    }
}

impl Scratch {
    /// A buffer of `bytes`, or of less where the budget is short.
    fn new(budget: &Budget, bytes: usize) -> Result<Self> {
        let mut bytes = bytes;
        let permit = loop {
            if let Some(permit) = budget.try_take(bytes as u64) {
                break permit;
            }
            if bytes <= MIN_READ_BYTES {
                break budget.take(bytes as u64, "a buffer to read raw samples")?;
            }
            bytes /= 2;
        };
        Ok(Self {
            buffer: vec![0; bytes],
            _permit: permit,
        })
    }
}

impl Field for RawFile {
    fn grid(&self) -> &Grid {
        &self.spec.grid
    }

    fn kind(&self) -> Kind {
        self.spec.kind
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()> {
        let domain = &self.spec.grid.domain;
        if !domain.contains_box(&region) {
            return Err(Error::bad_input(format!(
                "{}: region {region} is not inside the domain {domain}",
                self.path.display()
            )));
        }
        if region.is_empty() {
            return Ok(());
        }
        let mut scratch = self.scratch()?;
        let result = self.read_with(region, out, &mut scratch.buffer);
        self.put_back(scratch);
        result
    }

    fn range(&self, region: Box3) -> Result<Range> {
        let region = region.intersect(&self.spec.grid.domain);
        if region.is_empty() {
            return Ok(Range::EMPTY);
        }
        Ok(match self.ranges.get() {
            Some(ranges) => ranges.of(region),
            None => Range::UNKNOWN,
        })
    }
}

impl std::fmt::Debug for RawFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RawFile")
            .field("path", &self.path)
            .field("spec", &self.spec)
            .field("mapped", &matches!(self.bytes, Bytes::Map { .. }))
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests;
