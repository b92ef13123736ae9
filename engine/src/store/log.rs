//! The append-only log: hands out offsets, writes records, and commits them in the one order that
//! survives a crash at any point (docs/format.md, section Commit).

use super::layout::FILE_ID_BYTES;
use super::layout::{LOG_START, RECORD_HEADER, SECTOR, align_up, superblock_at};
use super::record::{Footer, Head, RecordKind, Ref, Superblock, header_block, seal, seed_of};
use super::storage::Storage;
use crate::error::{Error, ErrorKind, Result};
use std::io;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The writing end of a volume file.
pub(crate) struct Log {
    pub(crate) storage: Arc<dyn Storage>,
    path: PathBuf,
    pub(crate) seed: u32,
    pub(crate) generation: u64,
    state: Mutex<State>,
    failed: AtomicBool,
    poisoned: AtomicBool,
}

struct State {
    /// First free byte.
    end: u64,
    /// First record of the running commit.
    start: u64,
    records: u64,
    chain: u32,
    live: u64,
    root: Superblock,
}

impl Log {
    /// Starts a file in empty `storage`: header, both superblocks at generation 0, header copy.
    pub(crate) fn create(
        storage: Arc<dyn Storage>,
        path: PathBuf,
        file_id: &[u8; FILE_ID_BYTES],
    ) -> Result<Log> {
        let seed = seed_of(file_id);
        let root = Superblock {
            log_end: LOG_START,
            ..Superblock::default()
        };
        let log = Log {
            storage,
            path,
            seed,
            generation: 1,
            state: Mutex::new(State {
                end: LOG_START,
                start: LOG_START,
                records: 0,
                chain: seed,
                live: 0,
                root,
            }),
            failed: AtomicBool::new(false),
            poisoned: AtomicBool::new(false),
        };
        let header = header_block(file_id);
        log.write(&header, 0)?;
        // Slot A stays empty until the first commit: an invalid superblock.
        log.write(&[0; SECTOR], superblock_at(1))?;
        log.write(&root.to_block(seed), superblock_at(0))?;
        let mut copy = vec![0; RECORD_HEADER];
        copy.extend_from_slice(&header);
        log.append(&Head::new(RecordKind::Header, log.generation), copy)?;
        Ok(log)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn io(&self, doing: &str, error: io::Error) -> Error {
        Error::io(&self.path, doing, error)
    }

    fn write(&self, bytes: &[u8], offset: u64) -> Result<()> {
        self.storage.write_at(bytes, offset).map_err(|e| {
            self.failed.store(true, Ordering::Release);
            self.io(
                &format!("writing {} bytes at offset {offset}", bytes.len()),
                e,
            )
        })
    }

    /// Seals one record (a gap for the header, then the payload) and writes it.
    pub(crate) fn append(&self, head: &Head, mut record: Vec<u8>) -> Result<Ref> {
        let mut reference = seal(&mut record, 0, head, self.seed);
        reference.offset = self.reserve(&record, &[reference])?;
        self.write(&record, reference.offset)?;
        Ok(reference)
    }

    /// Hands out the place of sealed records, which stand in `bytes` where `refs` say, and counts
    /// them into the commit. The caller writes the bytes with [`write_reserved`](Self::write_reserved).
    pub(crate) fn reserve(&self, bytes: &[u8], refs: &[Ref]) -> Result<u64> {
        let mut state = self.state();
        let offset = state.end;
        state.end = offset
            .checked_add(bytes.len() as u64)
            .filter(|&end| end < i64::MAX as u64)
            .ok_or_else(|| {
                Error::new(
                    ErrorKind::LimitExceeded,
                    "the file is longer than 2^63 bytes",
                )
            })?;
        for reference in refs {
            let head = &bytes[reference.offset as usize..][..RECORD_HEADER];
            state.chain = crc32c::crc32c_append(state.chain, head);
        }
        state.records += refs.len() as u64;
        state.live += bytes.len() as u64;
        Ok(offset)
    }

    /// Writes what [`reserve`](Self::reserve) made room for.
    pub(crate) fn write_reserved(&self, bytes: &[u8], offset: u64) -> Result<()> {
        self.write(bytes, offset)
    }

    fn sync(&self, doing: &str) -> Result<()> {
        self.storage.sync().map_err(|e| {
            // The kernel may have dropped the dirty pages: a later success would prove nothing.
            self.poisoned.store(true, Ordering::Release);
            self.io(doing, e)
        })
    }

    /// Makes everything appended so far the next generation. Returns when it would survive a loss of
    /// power.
    pub(crate) fn commit(&self, catalog: Ref, index: [u64; 2]) -> Result<Superblock> {
        if self.poisoned.load(Ordering::Acquire) {
            return Err(Error::new(
                ErrorKind::Poisoned,
                format!(
                    "{}: an earlier sync failed: write the volume anew",
                    self.path.display()
                ),
            ));
        }
        if self.failed.load(Ordering::Acquire) {
            return Err(Error::new(
                ErrorKind::Io,
                format!(
                    "{}: an earlier write failed, so nothing is committed",
                    self.path.display()
                ),
            ));
        }
        // 1. The footer closes the records of the commit.
        let (footer, before) = {
            let state = self.state();
            let footer = Footer {
                generation: self.generation,
                catalog,
                start: state.start,
                previous: state.root.footer,
                records: state.records,
                live: state.live,
                garbage: 0,
                chain: state.chain,
            };
            (footer, state.root)
        };
        let mut record = vec![0; RECORD_HEADER];
        record.extend(footer.to_payload());
        let at = self.append(&Head::new(RecordKind::Footer, self.generation), record)?;
        let root = {
            let state = self.state();
            Superblock {
                generation: self.generation,
                log_end: align_up(state.end, SECTOR as u64).expect("checked when reserved"),
                catalog,
                footer: at.offset,
                live: state.live,
                garbage: 0,
                writer: 0,
                index,
            }
        };
        let written = self.state().end;
        self.write(&vec![0; (root.log_end - written) as usize], written)?;
        // 2. The data is durable before anything points to it.
        self.sync("syncing the data")?;
        // 3. Nobody else has published meanwhile (locks do not work everywhere).
        self.check_fence(&before)?;
        // 4. and 5. The root goes into the slot of the older generation.
        self.write(&root.to_block(self.seed), superblock_at(self.generation))?;
        self.sync("syncing the superblock")?;
        let mut state = self.state();
        state.root = root;
        state.end = root.log_end;
        state.start = root.log_end;
        state.records = 0;
        state.chain = self.seed;
        Ok(root)
    }

    fn check_fence(&self, expected: &Superblock) -> Result<()> {
        let mut newest = None;
        for slot in [0, 1].map(superblock_at) {
            let mut block = vec![0; SECTOR];
            self.storage
                .read_at(&mut block, slot)
                .map_err(|e| self.io("reading a superblock", e))?;
            let root = Superblock::parse(&block, self.seed, slot);
            newest = newest.max(root.map(|r| (r.generation, r.writer)));
        }
        if newest != Some((expected.generation, expected.writer)) {
            return Err(Error::new(
                ErrorKind::ForeignWriter,
                format!(
                    "{}: another writer has changed the file meanwhile",
                    self.path.display()
                ),
            ));
        }
        Ok(())
    }
}
