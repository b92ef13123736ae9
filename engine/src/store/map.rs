//! A sealed volume file as a memory map, which only the caller can know to be sound.

#![expect(
    unsafe_code,
    reason = "a map changes under our feet when another process writes to the file"
)]

use super::open::Opened;
use super::storage::{FileStorage, Storage};
use super::volume::Volume;
use crate::budget::Budget;
use crate::error::{Error, Result};
use memmap2::Mmap;
use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;

/// A file that is only read, through a map.
struct MappedStorage(Mmap);

fn read_only() -> io::Error {
    io::Error::new(io::ErrorKind::Unsupported, "a memory map is only read")
}

impl Storage for MappedStorage {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let start = usize::try_from(offset).ok();
        let bytes = start.and_then(|at| self.0.get(at..)?.get(..buffer.len()));
        buffer.copy_from_slice(bytes.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }

    fn write_at(&self, _: &[u8], _: u64) -> io::Result<()> {
        Err(read_only())
    }

    fn len(&self) -> io::Result<u64> {
        Ok(self.0.len() as u64)
    }

    fn set_len(&self, _: u64) -> io::Result<()> {
        Err(read_only())
    }

    fn sync(&self) -> io::Result<()> {
        Err(read_only())
    }

    fn lock(&self) -> io::Result<bool> {
        Err(read_only())
    }
}

impl Volume {
    /// Opens a *sealed* file (made by [`compact`](super::compact) and not changed since) through a
    /// memory map: the same samples as [`open`](Self::open), without a system call for each brick.
    ///
    /// # Safety
    /// As long as the volume lives nobody, in this process or another, writes to the file or cuts it.
    /// Changed bytes under a map are undefined behaviour, and a page that was cut off or cannot be
    /// read from the disk ends the process by a signal. Only the caller knows whether that is so;
    /// [`open`](Self::open) makes an error of all of it.
    ///
    /// # Errors
    /// As [`open`](Self::open); `BadInput` when the file is not sealed.
    ///
    /// # Memory
    /// Pages of the file that are in memory count as resident of this process but are not under the
    /// budget: the system takes them back when it needs them.
    pub unsafe fn open_mapped(path: &Path, budget: &Budget) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io(path, "opening the volume", e))?;
        // Read before it is mapped: a file that others may write to must never be.
        let handle = file
            .try_clone()
            .map_err(|e| Error::io(path, "opening the volume", e))?;
        let opened = Opened::open(Arc::new(FileStorage(handle)), path)?;
        if !opened.root.sealed {
            return Err(Error::bad_input(format!(
                "{}: only a sealed file can be mapped: compact it first",
                path.display()
            )));
        }
        // SAFETY: the map is only read, and the caller promises that nobody changes the file while
        // it lives.
        let map =
            unsafe { Mmap::map(&file) }.map_err(|e| Error::io(path, "mapping the volume", e))?;
        Self::open_in(Arc::new(MappedStorage(map)), path, budget)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Dense, mixed, spec};
    use super::super::{VolumeWriter, compact, import_stream};
    use super::*;
    use crate::sample::SampleType;

    #[test]
    fn a_mapped_volume_reads_the_same_and_only_a_sealed_one_is_mapped() {
        let folder = tempfile::tempdir().expect("scratch folder");
        let out = folder.path().join("v.bvol");
        let budget = Budget::mib(24);
        let dense = Dense::new(spec([75, 64, 37], SampleType::I16, 8), mixed);
        import_stream(&mut &dense.raw[..], &dense.spec, &out, &budget).expect("imports");
        // SAFETY: nobody else knows the scratch file.
        let refused = unsafe { Volume::open_mapped(&out, &budget) };
        let refused = refused.map(drop).expect_err("not sealed").to_string();
        assert!(refused.contains("compact"), "{refused}");
        compact(&out, &out, &budget).expect("compacts");
        // SAFETY: as above, until it is dropped.
        let volume = unsafe { Volume::open_mapped(&out, &budget) }.expect("sealed");
        dense.check(&volume, dense.spec.grid.domain);
        drop(volume);
        let writer = VolumeWriter::open(&out, &budget).expect("opens");
        writer.put_constant([0; 3], 0, 5.0).expect("puts");
        writer.commit().expect("commits");
        // SAFETY: as above.
        assert!(unsafe { Volume::open_mapped(&out, &budget) }.is_err());
    }
}
