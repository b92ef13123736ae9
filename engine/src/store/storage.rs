//! Where the bytes of a volume file live: one small trait, so that a test can own the disk.

use std::fs::{File, TryLockError};
use std::io;
use std::sync::{PoisonError, RwLock};

/// Bytes by offset. All calls may come from any thread at once; a writer never writes bytes that a
/// reader may be reading.
pub trait Storage: Send + Sync {
    /// Fills `buffer` from `offset`.
    ///
    /// # Errors
    /// `UnexpectedEof` when the storage ends before; otherwise what the medium reports.
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()>;

    /// Writes all of `bytes` at `offset`, growing the storage as needed.
    ///
    /// # Errors
    /// What the medium reports; any part of the bytes may then be written.
    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<()>;

    /// Length in bytes.
    ///
    /// # Errors
    /// What the medium reports.
    fn len(&self) -> io::Result<u64>;

    /// Whether nothing was written yet.
    ///
    /// # Errors
    /// What the medium reports.
    fn is_empty(&self) -> io::Result<bool> {
        Ok(self.len()? == 0)
    }

    /// Cuts or grows (with zeros) to `length`.
    ///
    /// # Errors
    /// What the medium reports.
    fn set_len(&self, length: u64) -> io::Result<()>;

    /// Returns when everything written before would survive a loss of power.
    ///
    /// # Errors
    /// What the medium reports; nothing may then be assumed about earlier writes.
    fn sync(&self) -> io::Result<()>;

    /// Takes the advisory lock of a writer. `false`: another one holds it.
    ///
    /// # Errors
    /// `Unsupported` where the medium has no locks.
    fn lock(&self) -> io::Result<bool>;
}

/// A file by positioned reads and writes.
#[derive(Debug)]
pub struct FileStorage(pub File);

#[cfg(unix)]
impl FileStorage {
    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        std::os::unix::fs::FileExt::read_exact_at(&self.0, buffer, offset)
    }

    fn write_all_at(&self, bytes: &[u8], offset: u64) -> io::Result<()> {
        std::os::unix::fs::FileExt::write_all_at(&self.0, bytes, offset)
    }
}

#[cfg(windows)]
impl FileStorage {
    fn read_exact_at(&self, mut buffer: &mut [u8], mut offset: u64) -> io::Result<()> {
        while !buffer.is_empty() {
            match std::os::windows::fs::FileExt::seek_read(&self.0, buffer, offset) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(n) => (buffer, offset) = (&mut buffer[n..], offset + n as u64),
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }

    fn write_all_at(&self, mut bytes: &[u8], mut offset: u64) -> io::Result<()> {
        while !bytes.is_empty() {
            match std::os::windows::fs::FileExt::seek_write(&self.0, bytes, offset) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(n) => (bytes, offset) = (&bytes[n..], offset + n as u64),
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }
}

impl Storage for FileStorage {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        self.read_exact_at(buffer, offset)
    }

    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<()> {
        self.write_all_at(bytes, offset)
    }

    fn len(&self) -> io::Result<u64> {
        Ok(self.0.metadata()?.len())
    }

    fn set_len(&self, length: u64) -> io::Result<()> {
        self.0.set_len(length)
    }

    fn sync(&self) -> io::Result<()> {
        self.0.sync_data()
    }

    fn lock(&self) -> io::Result<bool> {
        match self.0.try_lock() {
            Ok(()) => Ok(true),
            Err(TryLockError::WouldBlock) => Ok(false),
            Err(TryLockError::Error(error)) => Err(error),
        }
    }
}

/// Bytes in memory, for tests and small volumes.
#[derive(Debug, Default)]
pub struct MemoryStorage(RwLock<Vec<u8>>);

impl MemoryStorage {
    /// Storage that holds `bytes`.
    pub fn new(bytes: Vec<u8>) -> Self {
        Self(RwLock::new(bytes))
    }

    /// A copy of all bytes.
    pub fn to_vec(&self) -> Vec<u8> {
        self.0
            .read()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }
}

impl Storage for MemoryStorage {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let bytes = self.0.read().unwrap_or_else(PoisonError::into_inner);
        let source = usize::try_from(offset)
            .ok()
            .and_then(|start| bytes.get(start..start.checked_add(buffer.len())?))
            .ok_or(io::ErrorKind::UnexpectedEof)?;
        buffer.copy_from_slice(source);
        Ok(())
    }

    fn write_at(&self, new: &[u8], offset: u64) -> io::Result<()> {
        let mut bytes = self.0.write().unwrap_or_else(PoisonError::into_inner);
        let start = usize::try_from(offset).map_err(|_| io::ErrorKind::StorageFull)?;
        let end = start
            .checked_add(new.len())
            .ok_or(io::ErrorKind::StorageFull)?;
        if bytes.len() < end {
            bytes.resize(end, 0);
        }
        bytes[start..end].copy_from_slice(new);
        Ok(())
    }

    fn len(&self) -> io::Result<u64> {
        Ok(self.0.read().unwrap_or_else(PoisonError::into_inner).len() as u64)
    }

    fn set_len(&self, length: u64) -> io::Result<()> {
        let length = usize::try_from(length).map_err(|_| io::ErrorKind::StorageFull)?;
        self.0
            .write()
            .unwrap_or_else(PoisonError::into_inner)
            .resize(length, 0);
        Ok(())
    }

    fn sync(&self) -> io::Result<()> {
        Ok(())
    }

    fn lock(&self) -> io::Result<bool> {
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn conforms(storage: &dyn Storage) {
        assert!(storage.is_empty().expect("length"));
        storage.write_at(b"world", 6).expect("writes");
        storage.write_at(b"hello ", 0).expect("writes");
        let mut back = [0; 11];
        storage.read_at(&mut back, 0).expect("reads");
        assert_eq!(&back, b"hello world");
        let error = storage.read_at(&mut back, 1).expect_err("past the end");
        assert_eq!(error.kind(), io::ErrorKind::UnexpectedEof);
        assert!(storage.read_at(&mut back, u64::MAX).is_err());
        storage.set_len(13).expect("grows");
        storage.read_at(&mut back[..2], 11).expect("reads zeros");
        assert_eq!(&back[..2], &[0, 0]);
        storage.set_len(5).expect("cuts");
        assert_eq!(storage.len().expect("length"), 5);
        storage.sync().expect("syncs");
        assert!(storage.lock().expect("locks"));
    }

    #[test]
    fn storages_conform() {
        conforms(&MemoryStorage::default());
        conforms(&FileStorage(tempfile::tempfile().expect("scratch file")));
    }
}
