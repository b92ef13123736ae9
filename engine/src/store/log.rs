//! The append-only log: hands out offsets, writes records, and commits them in the one order that
//! survives a crash at any point (docs/format.md, section Commit).

use super::layout::FILE_ID_BYTES;
use super::layout::{LOG_START, RECORD_HEADER, SECTOR, align_up, superblock_at};
use super::open::Opened;
use super::record::{Footer, Head, RecordKind, Ref, Superblock, header_block, seal, seed_of};
use super::storage::Storage;
use crate::error::{Error, ErrorKind, Result};
use std::io;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The writing end of a volume file.
pub(crate) struct Log {
    pub(crate) storage: Arc<dyn Storage>,
    path: PathBuf,
    pub(crate) seed: u32,
    /// Generation of the running commit.
    generation: AtomicU64,
    state: Mutex<State>,
    health: AtomicU8,
    /// Whether a lock keeps other writers away.
    is_locked: bool,
}

/// Everything is as it should be.
const SOUND: u8 = 0;
/// A write failed: the running commit is lost, the next may try again.
const FAILED: u8 = 1;
/// A sync or the publication failed: nothing is known of what the medium holds.
const POISONED: u8 = 2;
/// Somebody else wrote the file.
const FOREIGN: u8 = 3;

struct State {
    /// First free byte.
    end: u64,
    /// Records of the running commit, and the checksum over their headers.
    records: u64,
    chain: u32,
    /// Bytes of them.
    appended: u64,
    /// What this writer last read or wrote as root.
    root: Superblock,
}

/// What a commit publishes beside its records.
pub(crate) struct Publish {
    pub(crate) catalog: Ref,
    /// Offset and length of the run of all node pages, or zeros.
    pub(crate) index: [u64; 2],
    /// Bytes of records that the root does not reach any more.
    pub(crate) dropped: u64,
    /// Writer id.
    pub(crate) writer: u64,
    pub(crate) sealed: bool,
}

/// The generation after it is the number of a running commit, which has to exist as well.
const LAST_GENERATION: u64 = u64::MAX - 1;

fn no_commit_after(generation: u64) -> String {
    format!("no commit fits after generation {generation}: compact it into a new file")
}

impl Log {
    /// Starts a file in empty `storage`: header, both superblocks at generation 0, header copy.
    pub(crate) fn create(
        storage: Arc<dyn Storage>,
        is_locked: bool,
        path: PathBuf,
        file_id: &[u8; FILE_ID_BYTES],
        incompat: u64,
    ) -> Result<Log> {
        let seed = seed_of(file_id);
        let root = Superblock {
            log_end: LOG_START,
            ..Superblock::default()
        };
        let log = Log::at(storage, is_locked, path, seed, root);
        let header = header_block(file_id, incompat);
        log.write(&header, 0)?;
        // Slot A stays empty until the first commit: an invalid superblock.
        log.write(&[0; SECTOR], superblock_at(1))?;
        log.write(&root.to_block(seed), superblock_at(0))?;
        let mut copy = vec![0; RECORD_HEADER];
        copy.extend_from_slice(&header);
        log.append(&Head::new(RecordKind::Header, 1, 0), copy)?;
        Ok(log)
    }

    /// Goes on where `file` ends.
    pub(crate) fn open(file: &Opened, is_locked: bool) -> Result<Log> {
        if file.root.generation >= LAST_GENERATION {
            return Err(file.error(
                ErrorKind::LimitExceeded,
                no_commit_after(file.root.generation),
            ));
        }
        let log = Log::at(
            file.storage.clone(),
            is_locked,
            file.path.clone(),
            file.seed,
            file.root,
        );
        // A writer that was killed may have left what nobody synced.
        log.sync("syncing what is there")?;
        // A superblock that does not hold is made good before anything is appended: the next commit
        // overwrites one of them, and with the other damaged nobody could tell whether what follows
        // the last commit is a newer one that was lost.
        let held = |generation: u64| file.superblocks[usize::from(generation.is_multiple_of(2))];
        if held(file.root.generation) != Some(file.root) {
            log.repair(&file.root)?;
        }
        if held(file.root.generation - 1).is_none() {
            log.repair(&file.root_before()?)?;
        }
        Ok(log)
    }

    fn repair(&self, root: &Superblock) -> Result<()> {
        let slot = superblock_at(root.generation);
        self.write(&root.to_block(self.seed), slot)?;
        self.sync("syncing a repaired superblock")
    }

    fn at(
        storage: Arc<dyn Storage>,
        is_locked: bool,
        path: PathBuf,
        seed: u32,
        root: Superblock,
    ) -> Log {
        Log {
            storage,
            path,
            seed,
            generation: AtomicU64::new(root.generation + 1),
            state: Mutex::new(State {
                end: root.log_end,
                records: 0,
                chain: seed,
                appended: 0,
                root,
            }),
            health: AtomicU8::new(SOUND),
            is_locked,
        }
    }

    /// Generation of the running commit.
    pub(crate) fn generation(&self) -> u64 {
        self.generation.load(Ordering::Acquire)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn io(&self, doing: &str, error: io::Error) -> Error {
        Error::io(&self.path, doing, error)
    }

    fn error(&self, kind: ErrorKind, message: &str) -> Error {
        Error::new(kind, format!("{}: {message}", self.path.display()))
    }

    /// # Errors
    /// Why nothing can be written now.
    pub(crate) fn check(&self) -> Result<()> {
        let last = self.generation() - 1;
        if last >= LAST_GENERATION {
            return Err(self.error(ErrorKind::LimitExceeded, &no_commit_after(last)));
        }
        match self.health.load(Ordering::Acquire) {
            SOUND => Ok(()),
            FAILED => Err(self.error(
                ErrorKind::Io,
                "an earlier write failed, so this commit is given up: what was put since the last commit must be put again",
            )),
            FOREIGN => Err(self.error(
                ErrorKind::ForeignWriter,
                "another writer has changed the file meanwhile: open it again",
            )),
            _ => Err(self.error(
                ErrorKind::Poisoned,
                "an earlier sync failed, so nothing is known of what the medium holds: open the file again",
            )),
        }
    }

    /// A worse state than before stays.
    fn worsen(&self, health: u8) {
        self.health.fetch_max(health, Ordering::AcqRel);
    }

    fn write(&self, bytes: &[u8], offset: u64) -> Result<()> {
        self.storage.write_at(bytes, offset).map_err(|e| {
            self.worsen(FAILED);
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
        self.check()?;
        let mut state = self.state();
        if (state.records == 0 || !self.is_locked) && state.root.generation > 0 {
            // Bytes of a foreign commit must not be overwritten either; without a lock it may come
            // at any time.
            self.check_fence(&state.root)?;
        }
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
        state.appended += bytes.len() as u64;
        Ok(offset)
    }

    /// Writes what [`reserve`](Self::reserve) made room for.
    pub(crate) fn write_reserved(&self, bytes: &[u8], offset: u64) -> Result<()> {
        self.write(bytes, offset)
    }

    fn sync(&self, doing: &str) -> Result<()> {
        self.storage.sync().map_err(|e| {
            // The kernel may have dropped the dirty pages: a later success would prove nothing.
            self.worsen(POISONED);
            self.io(doing, e)
        })
    }

    /// Forgets what was appended since the last commit; its place is used again.
    pub(crate) fn forget(&self) {
        let mut state = self.state();
        let root = state.root;
        state.restart(root, self.seed);
        // Worse than a failed write stays.
        let _ = self
            .health
            .compare_exchange(FAILED, SOUND, Ordering::AcqRel, Ordering::Acquire);
    }

    /// Makes everything appended so far the next generation. Returns when it would survive a loss of
    /// power. The caller lets nobody append meanwhile.
    pub(crate) fn commit(&self, publish: &Publish) -> Result<Superblock> {
        self.check()?;
        let generation = self.generation();
        // 1. The footer closes the records of the commit.
        let (footer, before) = {
            let state = self.state();
            let root = state.root;
            let footer = Footer {
                generation,
                catalog: publish.catalog,
                start: root.log_end,
                previous: root.footer,
                records: state.records,
                // Saturating: what the file says of itself is not to be trusted.
                live: root
                    .live
                    .saturating_add(state.appended)
                    .saturating_sub(publish.dropped),
                garbage: root.garbage.saturating_add(publish.dropped),
                chain: state.chain,
            };
            (footer, root)
        };
        let mut record = vec![0; RECORD_HEADER];
        record.extend(footer.to_payload());
        let whole = record.len().next_multiple_of(8) as u64;
        let at = self.append(&Head::new(RecordKind::Footer, generation, 0), record)?;
        let written = self.state().end;
        let root = Superblock {
            generation,
            log_end: align_up(written, SECTOR as u64).expect("checked when reserved"),
            catalog: publish.catalog,
            footer: at.offset,
            live: footer.live.saturating_add(whole),
            garbage: footer.garbage,
            writer: publish.writer,
            index: publish.index,
            sealed: publish.sealed,
        };
        self.write(&vec![0; (root.log_end - written) as usize], written)?;
        // 2. The data is durable before anything points to it.
        self.sync("syncing the data")?;
        // 3. Nobody else has published meanwhile (locks do not work everywhere).
        self.check_fence(&before)?;
        // 4. and 5. The root goes into the slot of the older generation.
        self.write(&root.to_block(self.seed), superblock_at(generation))
            .inspect_err(|_| {
                // The commit is whole in the log: whether readers see it is not known.
                self.worsen(POISONED);
            })?;
        self.sync("syncing the superblock")?;
        self.state().restart(root, self.seed);
        self.generation.store(generation + 1, Ordering::Release);
        Ok(root)
    }

    fn check_fence(&self, expected: &Superblock) -> Result<()> {
        let mut newest = None;
        for slot in [0, 1].map(superblock_at) {
            let mut block = vec![0; SECTOR];
            self.storage.read_at(&mut block, slot).map_err(|e| {
                self.worsen(FAILED);
                self.io("reading a superblock", e)
            })?;
            let root = Superblock::parse(&block, self.seed, slot);
            newest = newest.max(root.map(|r| (r.generation, r.writer)));
        }
        if newest != Some((expected.generation, expected.writer)) {
            self.worsen(FOREIGN);
            return self.check();
        }
        Ok(())
    }
}

impl State {
    fn restart(&mut self, root: Superblock, seed: u32) {
        *self = State {
            end: root.log_end,
            records: 0,
            chain: seed,
            appended: 0,
            root,
        };
    }
}
