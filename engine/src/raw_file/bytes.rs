//! Bytes of the file by offset: read into a buffer, or in place in a map.

use std::fs::File;
use std::io;
#[cfg(test)]
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

pub(super) enum Bytes {
    File(Positioned),
    Map {
        map: memmap2::Mmap,
        /// Offset in the file of the first byte of the map.
        start: u64,
    },
}

/// A file that any number of threads read at offsets of their own.
pub(super) struct Positioned {
    file: File,
    /// Where reads move a common position they take turns.
    #[cfg(not(unix))]
    turn: std::sync::Mutex<()>,
    #[cfg(test)]
    pub(super) reads: AtomicU64,
}

impl Bytes {
    /// The `length` bytes at `offset`; `buffer` has room for them unless this is a map.
    pub(super) fn fetch<'a>(
        &'a self,
        offset: u64,
        length: usize,
        buffer: &'a mut [u8],
    ) -> io::Result<&'a [u8]> {
        match self {
            Bytes::File(file) => {
                let buffer = &mut buffer[..length];
                file.read_exact_at(buffer, offset)?;
                Ok(buffer)
            }
            Bytes::Map { map, start } => offset
                .checked_sub(*start)
                .and_then(|at| usize::try_from(at).ok())
                .and_then(|at| map.get(at..at.checked_add(length)?))
                .ok_or_else(|| io::ErrorKind::UnexpectedEof.into()),
        }
    }
}

impl Positioned {
    pub(super) fn new(file: File) -> Self {
        Self {
            file,
            #[cfg(not(unix))]
            turn: std::sync::Mutex::default(),
            #[cfg(test)]
            reads: AtomicU64::new(0),
        }
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        #[cfg(test)]
        self.reads.fetch_add(1, Relaxed);
        #[cfg(unix)]
        {
            std::os::unix::fs::FileExt::read_exact_at(&self.file, buffer, offset)
        }
        #[cfg(not(unix))]
        {
            use std::io::{Read, Seek, SeekFrom};
            let _turn = self.turn.lock();
            let mut file = &self.file;
            file.seek(SeekFrom::Start(offset))?;
            file.read_exact(buffer)
        }
    }
}
