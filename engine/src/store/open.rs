//! From bytes to the root of the newest generation. Nothing here writes, so a crash in the middle of
//! a recovery is harmless; an older generation is never shown in place of a damaged newer one.

use super::catalog::{self, Counts, Entry};
use super::layout::*;
use super::meta;
use super::record::{
    self, Footer, Head, RecordKind, Ref, Superblock, parse_head, parse_header, seed_of,
};
use super::spec::VolumeSpec;
use super::storage::Storage;
use super::value::KeyRange;
use crate::error::{Error, ErrorKind, Result};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A file whose root is known.
pub(crate) struct Opened {
    pub(crate) storage: Arc<dyn Storage>,
    pub(crate) path: PathBuf,
    pub(crate) seed: u32,
    pub(crate) root: Superblock,
    pub(crate) length: u64,
    /// What was not as it should be but did not matter, as phrases.
    pub(crate) notes: Vec<String>,
}

/// What the catalog says about the volume.
pub(crate) struct Contents {
    pub(crate) spec: VolumeSpec,
    pub(crate) range: KeyRange,
    pub(crate) counts: Counts,
    pub(crate) entry: Entry,
}

impl Opened {
    /// Finds the root.
    ///
    /// # Errors
    /// `NotAVolume`, `Newer`, `Truncated`, `DamagedRoot`.
    pub(crate) fn open(storage: Arc<dyn Storage>, path: &Path) -> Result<Opened> {
        let length = storage
            .len()
            .map_err(|e| Error::io(path, "asking for the length", e))?;
        let mut notes = Vec::new();
        let seed = find_seed(storage.as_ref(), path, length, &mut notes)?;
        let mut opened = Opened {
            storage,
            path: path.into(),
            seed,
            root: Superblock::default(),
            length,
            notes,
        };
        opened.root = opened.find_root()?;
        Ok(opened)
    }

    pub(crate) fn error(&self, kind: ErrorKind, message: impl std::fmt::Display) -> Error {
        Error::new(kind, format!("{}: {message}", self.path.display()))
    }

    fn read_at(&self, buffer: &mut [u8], offset: u64, what: &str) -> Result<()> {
        self.storage
            .read_at(buffer, offset)
            .map_err(|e| Error::io(&self.path, &format!("reading {what} at offset {offset}"), e))
    }

    fn find_root(&mut self) -> Result<Superblock> {
        let mut roots = [None; 2];
        for (slot, root) in roots.iter_mut().enumerate() {
            let offset = SUPERBLOCK_AT[slot];
            let mut block = [0; SECTOR];
            if offset + SECTOR as u64 <= self.length {
                self.read_at(&mut block, offset, "a superblock")?;
                *root = Superblock::parse(&block, self.seed, offset);
            }
            if root.is_none() {
                self.notes
                    .push(format!("the superblock at offset {offset} is damaged"));
            }
        }
        let root = match roots {
            [Some(a), Some(b)] => {
                if a.generation > b.generation {
                    a
                } else {
                    b
                }
            }
            [Some(root), None] | [None, Some(root)] => {
                let newest = self.roll_forward(root)?;
                // A superblock is written only after its commit is whole and synced: one that is
                // torn has a whole commit behind the other. Without it either the older superblock
                // is damaged, or the newest together with its commit.
                let more = self.length > root.log_end;
                if newest.generation == root.generation && root.generation > 0 && more {
                    return Err(self.older_only(&root));
                }
                newest
            }
            [None, None] => {
                let last = self.roll_forward(Superblock {
                    log_end: LOG_START,
                    ..Superblock::default()
                })?;
                if last.generation > 0 && self.commit_starts(&last)? {
                    return Err(self.older_only(&last));
                }
                last
            }
        };
        if root.generation == 0 {
            let kind = if self.length <= LOG_START {
                ErrorKind::Truncated
            } else {
                ErrorKind::DamagedRoot
            };
            return Err(self.error(
                kind,
                "no whole commit is left: the volume was never finished, or its root is damaged",
            ));
        }
        if root.log_end > self.length {
            return Err(self.error(
                ErrorKind::Truncated,
                format!(
                    "{} bytes, but its content ends at {}: copy the file again",
                    self.length, root.log_end
                ),
            ));
        }
        Ok(root)
    }

    /// An older state is never shown in place of a newer one that is damaged, nor where nobody can
    /// tell.
    fn older_only(&self, root: &Superblock) -> Error {
        self.error(
            ErrorKind::DamagedRoot,
            format!(
                "a superblock is damaged, and no whole commit follows generation {}: a newer one may be lost; \
                 to read generation {} cut a copy of the file to {} bytes",
                root.generation, root.generation, root.log_end
            ),
        )
    }

    /// Whether a record of the generation after `root` stands at its log end.
    fn commit_starts(&self, root: &Superblock) -> Result<bool> {
        let mut head = [0; RECORD_HEADER];
        if root.log_end.saturating_add(RECORD_HEADER as u64) > self.length {
            return Ok(false);
        }
        self.read_at(&mut head, root.log_end, "a record")?;
        Ok(parse_head(&head)
            .is_some_and(|(head, ..)| Some(head.generation) == root.generation.checked_add(1)))
    }

    /// Walks whole commits from the end of `from` and gives the root of the last.
    fn roll_forward(&self, from: Superblock) -> Result<Superblock> {
        let mut root = from;
        while let Some(next) = self.next_commit(&root)? {
            root = next;
        }
        Ok(root)
    }

    /// The commit that starts at the log end of `root`, if all of it is whole.
    fn next_commit(&self, root: &Superblock) -> Result<Option<Superblock>> {
        let (mut chain, mut records, mut at) = (self.seed, 0u64, root.log_end);
        let mut buffer = Vec::new();
        loop {
            let Some((head, reference)) = self.record_at(at, &mut buffer)? else {
                return Ok(None);
            };
            if Some(head.generation) != root.generation.checked_add(1) {
                return Ok(None);
            }
            if head.kind == RecordKind::Footer as u8 {
                let Ok((_, payload)) = record::open(&buffer, self.seed) else {
                    return Ok(None);
                };
                let Some(footer) = Footer::parse(payload) else {
                    return Ok(None);
                };
                let fits = footer.generation == head.generation
                    && footer.start == root.log_end
                    && footer.previous == root.footer
                    && (footer.records, footer.chain) == (records, chain);
                let end = align_up(at + record_bytes(reference.length), SECTOR as u64);
                return Ok(end.filter(|_| fits).map(|log_end| Superblock {
                    generation: footer.generation,
                    log_end,
                    catalog: footer.catalog,
                    footer: at,
                    // As the superblock has it: with the footer itself.
                    live: footer.live.saturating_add(record_bytes(reference.length)),
                    garbage: footer.garbage,
                    writer: 0,
                    index: [0, 0],
                }));
            }
            chain = crc32c::crc32c_append(chain, &buffer[..RECORD_HEADER]);
            records += 1;
            at += record_bytes(reference.length);
        }
    }

    /// Reads and checks the record at `offset`; `None` when none or a damaged one starts there.
    pub(crate) fn record_at(
        &self,
        offset: u64,
        buffer: &mut Vec<u8>,
    ) -> Result<Option<(Head, Ref)>> {
        let mut head = [0; RECORD_HEADER];
        if offset
            .checked_add(RECORD_HEADER as u64)
            .is_none_or(|end| end > self.length)
        {
            return Ok(None);
        }
        self.read_at(&mut head, offset, "a record")?;
        let Some((fields, length, crc)) = parse_head(&head) else {
            return Ok(None);
        };
        let whole = record_bytes(length);
        if length as usize > longest_payload(fields.kind) || offset + whole > self.length {
            return Ok(None);
        }
        buffer.resize(whole as usize, 0);
        self.read_at(buffer, offset, "a record")?;
        let whole = record::open(buffer, self.seed).is_ok();
        Ok(whole.then_some((
            fields,
            Ref {
                offset,
                length,
                crc,
            },
        )))
    }

    /// Reads the record that `reference` names into `buffer` and gives its head; the payload follows
    /// at [`RECORD_HEADER`]. The caller has checked that the length is one that may be.
    ///
    /// # Errors
    /// `Damaged` where the record is not the one that the reference was made for.
    pub(crate) fn read_record(
        &self,
        reference: &Ref,
        kind: RecordKind,
        place: &dyn Fn() -> String,
        buffer: &mut Vec<u8>,
    ) -> Result<Head> {
        let damaged = |what: String| {
            self.error(
                ErrorKind::Damaged,
                format!(
                    "{} {} at offset {}: {what}",
                    kind.name(),
                    place(),
                    reference.offset
                ),
            )
        };
        let whole = record_bytes(reference.length);
        let end = reference.offset.checked_add(whole);
        if reference.length as usize > longest_payload(kind as u8)
            || reference.offset < LOG_START
            || end.is_none_or(|end| end > self.root.log_end)
        {
            return Err(damaged(format!(
                "a reference to {} bytes outside of the log",
                reference.length
            )));
        }
        buffer.resize(whole as usize, 0);
        self.read_at(buffer, reference.offset, kind.name())?;
        let (head, payload) = record::open(buffer, self.seed).map_err(&damaged)?;
        if get_u32(buffer, RECORD_CRC) != reference.crc
            || payload.len() != reference.length as usize
        {
            return Err(damaged(
                "another record than the one that its parent knows".into(),
            ));
        }
        if head.generation > self.root.generation {
            return Err(damaged(format!(
                "a record of generation {} in generation {}",
                head.generation, self.root.generation
            )));
        }
        if head.kind != kind as u8 {
            return Err(damaged(format!(
                "a record of kind {} in its place",
                head.kind
            )));
        }
        Ok(head)
    }

    /// Reads catalog, attributes and history.
    ///
    /// # Errors
    /// `DamagedRoot` when any of them does not hold.
    pub(crate) fn contents(&self) -> Result<Contents> {
        let root = |e: Error| Error::new(ErrorKind::DamagedRoot, e.to_string());
        let wrong = |what: String| self.error(ErrorKind::DamagedRoot, what);
        let mut buffer = Vec::new();
        let at_root = || "of the root".to_string();
        let head = self
            .read_record(
                &self.root.catalog,
                RecordKind::Catalog,
                &at_root,
                &mut buffer,
            )
            .map_err(root)?;
        if head.generation != self.root.generation {
            return Err(wrong(format!(
                "the catalog of generation {} in the root of generation {}",
                head.generation, self.root.generation
            )));
        }
        let payload = &buffer[RECORD_HEADER..][..self.root.catalog.length as usize];
        let entries = catalog::decode_catalog(payload).map_err(wrong)?;
        let [entry] = <[Entry; 1]>::try_from(entries).map_err(|all| {
            self.error(
                ErrorKind::Unsupported,
                format!(
                    "{} volumes in one file: this program reads files of one",
                    all.len()
                ),
            )
        })?;
        self.read_record(
            &entry.attributes,
            RecordKind::Attributes,
            &at_root,
            &mut buffer,
        )
        .map_err(root)?;
        let payload = &buffer[RECORD_HEADER..][..entry.attributes.length as usize];
        let (mut spec, range, counts) = catalog::decode_attributes(payload).map_err(wrong)?;
        let level = if entry.root.is_none() {
            0
        } else {
            spec.root_level()
        };
        if entry.root_level != level {
            return Err(wrong(format!(
                "a root of level {} for {:?} bricks",
                entry.root_level,
                spec.bricks()
            )));
        }
        if entry.root.length as usize > PAGE_BYTES_MAX {
            return Err(wrong(format!(
                "a root page of {} bytes where {PAGE_BYTES_MAX} are the most",
                entry.root.length
            )));
        }
        spec.name = entry.name.clone();
        if !entry.history.is_none() {
            self.read_record(&entry.history, RecordKind::History, &at_root, &mut buffer)
                .map_err(root)?;
            let payload = &buffer[RECORD_HEADER..][..entry.history.length as usize];
            // A later version of the text is no reason to refuse the samples.
            spec.history = meta::decode(payload).unwrap_or_default();
        }
        Ok(Contents {
            spec,
            range,
            counts,
            entry,
        })
    }
}

/// Most bytes that a reader accepts as payload of a record of this kind.
pub(crate) fn longest_payload(kind: u8) -> usize {
    match kind {
        k if k == RecordKind::Header as u8 => SECTOR,
        k if k == RecordKind::Brick as u8 => 64 * 64 * 64 * 4,
        k if k == RecordKind::Page as u8 => PAGE_BYTES_MAX,
        k if k == RecordKind::Catalog as u8 => CATALOG_BYTES_MAX,
        k if k == RecordKind::Footer as u8 => FOOTER_BYTES,
        _ => ATTR_BYTES_MAX,
    }
}

/// The seed of the checksums, from the header or from its copy in the log.
fn find_seed(
    storage: &dyn Storage,
    path: &Path,
    length: u64,
    notes: &mut Vec<String>,
) -> Result<u32> {
    let read = |offset: u64, bytes: usize| -> Result<Vec<u8>> {
        let mut block = vec![0; bytes];
        if offset + bytes as u64 <= length {
            storage
                .read_at(&mut block, offset)
                .map_err(|e| Error::io(path, "reading the header", e))?;
        }
        Ok(block)
    };
    let first = parse_header(&read(0, SECTOR)?);
    let error = match first {
        Ok(id) => return Ok(seed_of(&id)),
        Err(error) => error,
    };
    if error.kind() != ErrorKind::Newer {
        let copy = read(LOG_START, record_bytes(SECTOR as u32) as usize)?;
        if let Ok(id) = parse_header(&copy[RECORD_HEADER..])
            && record::open(&copy, seed_of(&id)).is_ok()
        {
            notes.push("the file header is damaged; its copy was used".into());
            return Ok(seed_of(&id));
        }
    }
    let mut start = vec![0; MAGIC.len().min(length as usize)];
    storage
        .read_at(&mut start, 0)
        .map_err(|e| Error::io(path, "reading the header", e))?;
    if length < LOG_START && !start.is_empty() && MAGIC.starts_with(&start) {
        return Err(Error::new(
            ErrorKind::Truncated,
            format!(
                "{}: {length} bytes, a volume has at least {LOG_START}: copy the file again",
                path.display()
            ),
        ));
    }
    Err(error.context(path.display()))
}
