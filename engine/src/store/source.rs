//! Where the samples of an import come from.

use super::spec::VolumeSpec;
use super::storage::{FileStorage, Storage};
use crate::budget::{Budget, human_bytes};
use crate::error::{Error, ErrorKind, Result};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Bytes that are read at a time.
pub(super) const SOURCE_CHUNK: usize = 1 << 20;

/// The samples of a whole domain, from first to last.
pub(super) struct Source<'a> {
    from: From<'a>,
    /// Bytes that were read.
    done: u64,
    /// Bytes of the domain. Only named in messages where it does not fit 64 bits: such a domain is
    /// never read to its end.
    total: u64,
}

enum From<'a> {
    Stream(&'a mut dyn Read),
    /// The file, and the offset of the first sample.
    File(FileStorage, u64),
}

impl<'a> Source<'a> {
    pub(super) fn stream(reader: &'a mut dyn Read, spec: &VolumeSpec) -> Self {
        Self::new(From::Stream(reader), spec)
    }

    /// Samples that stand in `file` from `offset` on.
    pub(super) fn in_file(file: &File, offset: u64, spec: &VolumeSpec) -> Result<Source<'static>> {
        let file = file
            .try_clone()
            .map_err(|e| Error::io(Path::new("source"), "opening once more", e))?;
        Ok(Source::new(From::File(FileStorage(file), offset), spec))
    }

    fn new(from: From<'a>, spec: &VolumeSpec) -> Self {
        let size = spec.grid.domain.size().map(u64::from);
        let total = (size[0] * size[1])
            .saturating_mul(size[2])
            .saturating_mul(spec.sample.bytes() as u64);
        Self {
            from,
            done: 0,
            total,
        }
    }

    /// The file that the samples stand in, and the offset of the first.
    pub(super) fn file(&self) -> Option<(&FileStorage, u64)> {
        match &self.from {
            From::Stream(_) => None,
            From::File(file, offset) => Some((file, *offset)),
        }
    }

    /// Fills `target` with the next bytes.
    ///
    /// # Errors
    /// `Truncated` when there are fewer; what the source reports.
    pub(super) fn read(&mut self, target: &mut [u8]) -> Result<()> {
        let wanted = target.len();
        match &mut self.from {
            From::Stream(reader) => {
                let mut rest = &mut *target;
                while !rest.is_empty() {
                    match reader.read(rest) {
                        Ok(0) => {
                            let got = self.done + (wanted - rest.len()) as u64;
                            return Err(Error::new(
                                ErrorKind::Truncated,
                                format!(
                                    "the source ends after {got} of {} bytes: check dimensions and type",
                                    self.total
                                ),
                            ));
                        }
                        Ok(n) => rest = &mut rest[n..],
                        Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                        Err(e) => return Err(source_error(e, self.done)),
                    }
                }
            }
            From::File(file, offset) => file
                .read_at(target, *offset + self.done)
                .map_err(|e| source_error(e, self.done))?,
        }
        self.done += wanted as u64;
        Ok(())
    }

    /// Reads over the next `bytes` and gives their checksum.
    pub(super) fn skip(&mut self, bytes: u64, budget: &Budget) -> Result<u32> {
        let (mut left, mut crc) = (bytes, 0);
        let mut chunk = vec![0; bytes.min(SOURCE_CHUNK as u64) as usize];
        while left > 0 {
            budget.check_cancelled()?;
            let n = left.min(SOURCE_CHUNK as u64) as usize;
            self.read(&mut chunk[..n])?;
            crc = crc32c::crc32c_append(crc, &chunk[..n]);
            left -= n as u64;
        }
        Ok(crc)
    }

    /// Nothing follows the bytes of the domain. A file may hold other things behind them.
    pub(super) fn check_end(&mut self) -> Result<()> {
        let From::Stream(reader) = &mut self.from else {
            return Ok(());
        };
        match reader.read(&mut [0]) {
            Ok(0) => Ok(()),
            Ok(_) => Err(Error::bad_input(format!(
                "the source goes on after the {} bytes ({}) of the domain: check dimensions and type",
                self.total,
                human_bytes(self.total)
            ))),
            Err(e) => Err(source_error(e, self.total)),
        }
    }
}

/// An importer's reader may carry an error of this crate; its message says more than ours could.
pub(super) fn source_error(error: std::io::Error, at: u64) -> Error {
    Error::io(
        Path::new("source"),
        &format!("reading samples near byte {at}"),
        error,
    )
}
