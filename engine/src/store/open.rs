//! From bytes to the root of the newest generation. Nothing here writes, so a crash in the middle of
//! a recovery is harmless; an older generation is never shown in place of a damaged newer one.

use super::ahead::Ahead;
use super::catalog::{self, Counts, Entry};
use super::layout::*;
use super::meta;
use super::page::{Page, PageRules};
use super::record::{
    self, Footer, Head, RecordKind, Ref, Superblock, parse_head, parse_header, seed_of,
};
use super::spec::VolumeSpec;
use super::storage::Storage;
use super::value::KeyRange;
use crate::error::{Error, ErrorKind, Result};
use crate::lattice::morton_encode;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Times that the root is looked for while a writer publishes.
const OPEN_TRIES: u32 = 100;

/// A file whose root is known.
#[derive(Clone)]
pub(crate) struct Opened {
    pub(crate) storage: Arc<dyn Storage>,
    pub(crate) path: PathBuf,
    pub(crate) seed: u32,
    pub(crate) root: Superblock,
    pub(crate) length: u64,
    /// The superblocks that hold, in their order in the file.
    pub(crate) superblocks: [Option<Superblock>; 2],
    /// Features without which the file may not be read, all known.
    pub(crate) incompat: u64,
    /// Features without which the file may be read, but not written.
    pub(crate) ro_compat: u64,
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
        let opened = Self::find(storage, path)?;
        if opened.root.generation == 0 {
            let kind = if opened.length <= LOG_START {
                ErrorKind::Truncated
            } else {
                ErrorKind::DamagedRoot
            };
            return Err(opened.error(
                kind,
                "no whole commit is left: the volume was never finished, or its root is damaged",
            ));
        }
        Ok(opened)
    }

    /// Whether the file has a commit to go on from: one that was cut off or begun only has none.
    ///
    /// # Errors
    /// `Newer`, `DamagedRoot` where a commit may be lost, `Io`.
    pub(crate) fn has_commit(storage: Arc<dyn Storage>, path: &Path) -> Result<bool> {
        match Self::find(storage, path) {
            Ok(opened) => Ok(opened.root.generation > 0),
            Err(e) if matches!(e.kind(), ErrorKind::Truncated | ErrorKind::NotAVolume) => Ok(false),
            Err(e) => Err(e),
        }
    }

    /// Finds the root; of generation 0 where there is no commit.
    fn find(storage: Arc<dyn Storage>, path: &Path) -> Result<Opened> {
        let length = length_of(storage.as_ref(), path)?;
        let mut notes = Vec::new();
        let (id, incompat, ro_compat) = find_id(storage.as_ref(), path, length, &mut notes)?;
        let mut opened = Opened {
            storage,
            path: path.into(),
            seed: seed_of(&id),
            root: Superblock::default(),
            length,
            superblocks: [None; 2],
            incompat,
            ro_compat,
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
            .map_err(|e| self.read_error(e, what, offset))
    }

    fn read_error(&self, error: std::io::Error, what: &str, offset: u64) -> Error {
        let doing = format!("reading {what} at offset {offset}");
        Error::io(&self.path, &doing, error)
    }

    /// A writer may be publishing meanwhile: a choice holds when both superblocks are whole, or are
    /// still the same afterwards.
    fn find_root(&mut self) -> Result<Superblock> {
        let mut roots = self.read_superblocks()?;
        for _ in 1..OPEN_TRIES {
            // After them: what they point to is there.
            self.length = length_of(self.storage.as_ref(), &self.path)?;
            let root = self.choose_root(roots);
            if root.is_ok() && roots.iter().all(Option::is_some) {
                return root;
            }
            let again = self.read_superblocks()?;
            if again == roots {
                for slot in (0..2).filter(|&slot| roots[slot].is_none()) {
                    let offset = SUPERBLOCK_AT[slot];
                    self.notes
                        .push(format!("the superblock at offset {offset} is damaged"));
                }
                return root;
            }
            roots = again;
        }
        Err(self.error(ErrorKind::Io, "the root changes faster than it can be read"))
    }

    fn read_superblocks(&self) -> Result<[Option<Superblock>; 2]> {
        let mut roots = [None; 2];
        for (root, offset) in roots.iter_mut().zip(SUPERBLOCK_AT) {
            let mut block = [0; SECTOR];
            if offset + SECTOR as u64 <= self.length {
                self.read_at(&mut block, offset, "a superblock")?;
                *root = Superblock::parse(&block, self.seed, offset);
            }
        }
        Ok(roots)
    }

    fn choose_root(&mut self, roots: [Option<Superblock>; 2]) -> Result<Superblock> {
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
        self.superblocks = roots;
        if root.generation > 0 && root.log_end > self.length {
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

    /// Makes an older generation the root, by the chain of footers.
    ///
    /// # Errors
    /// `BadInput` when the file has no such generation; `Damaged` when a footer on the way does not
    /// hold.
    pub(crate) fn go_back(&mut self, generation: u64) -> Result<()> {
        let newest = self.root.generation;
        if generation == 0 || generation > newest {
            return Err(self.error(
                ErrorKind::BadInput,
                format!("no generation {generation}: the file has 1 to {newest}"),
            ));
        }
        let mut footer = self.footer_at(self.root.footer, newest)?;
        let mut at = self.root.footer;
        while footer.generation > generation {
            if footer.previous >= footer.start || footer.start > at {
                return Err(self.error(
                    ErrorKind::Damaged,
                    format!("the footer at offset {at} points forward"),
                ));
            }
            at = footer.previous;
            footer = self.footer_at(at, footer.generation - 1)?;
        }
        if generation < newest {
            self.root = root_of(&footer, at).ok_or_else(|| {
                self.error(
                    ErrorKind::Damaged,
                    format!("no place for the footer at offset {at}"),
                )
            })?;
        }
        Ok(())
    }

    /// The root before the newest, by its footer.
    ///
    /// # Errors
    /// `Damaged` when a footer does not hold.
    pub(crate) fn root_before(&self) -> Result<Superblock> {
        let generation = self.root.generation.saturating_sub(1);
        if generation == 0 {
            return Ok(Superblock {
                log_end: LOG_START,
                ..Superblock::default()
            });
        }
        let mut file = self.clone();
        file.go_back(generation)?;
        Ok(file.root)
    }

    fn footer_at(&self, offset: u64, generation: u64) -> Result<Footer> {
        let mut buffer = Vec::new();
        let found = self.record_at(offset, &mut buffer)?;
        found
            .filter(|(head, reference)| {
                (head.kind, head.generation) == (RecordKind::Footer as u8, generation)
                    && offset + record_bytes(reference.length) <= self.root.log_end
            })
            .and_then(|(_, r)| Footer::parse(&buffer[RECORD_HEADER..][..r.length as usize]))
            .filter(|footer| footer.generation == generation)
            .ok_or_else(|| {
                self.error(
                    ErrorKind::Damaged,
                    format!("no footer of generation {generation} at offset {offset}"),
                )
            })
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
        // The index span, which the writer gave to the superblock of a first commit only.
        let mut pages: Option<[u64; 2]> = None;
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
                let next = root_of(&footer, at).filter(|_| fits);
                let index = pages
                    .filter(|_| head.generation == 1)
                    .map_or([0, 0], |[start, end]| [start, end - start]);
                return Ok(next.map(|next| Superblock { index, ..next }));
            }
            if head.kind == RecordKind::Page as u8 {
                let end = at + record_bytes(reference.length);
                pages = Some([pages.map_or(at, |p| p[0]), end]);
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
        let Some(found) = self.head_at(offset, buffer)? else {
            return Ok(None);
        };
        buffer.resize(record_bytes(found.1.length) as usize, 0);
        self.read_at(buffer, offset, "a record")?;
        Ok(record::open(buffer, self.seed).is_ok().then_some(found))
    }

    /// Reads the header of the record at `offset`, which is not checked; `None` when nothing that
    /// could be one starts there.
    pub(crate) fn head_at(&self, offset: u64, buffer: &mut Vec<u8>) -> Result<Option<(Head, Ref)>> {
        if offset
            .checked_add(RECORD_HEADER as u64)
            .is_none_or(|end| end > self.length)
        {
            return Ok(None);
        }
        buffer.resize(RECORD_HEADER, 0);
        self.read_at(buffer, offset, "a record")?;
        let Some((head, length, crc)) = parse_head(buffer) else {
            return Ok(None);
        };
        let fits = length as usize <= longest_payload(head.kind)
            && offset + record_bytes(length) <= self.length;
        let reference = Ref {
            offset,
            length,
            crc,
        };
        Ok(fits.then_some((head, reference)))
    }

    /// Reads the record that `reference` names into `buffer` and gives its head; the payload follows
    /// at [`RECORD_HEADER`]. Who reads many has an `ahead`.
    ///
    /// # Errors
    /// `Damaged` where the record is not the one that the reference was made for.
    pub(crate) fn read_record(
        &self,
        reference: &Ref,
        kind: RecordKind,
        volume: u16,
        place: &dyn Fn() -> String,
        buffer: &mut Vec<u8>,
        ahead: Option<&mut Ahead>,
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
        match ahead {
            Some(ahead) => ahead
                .read(
                    self.storage.as_ref(),
                    buffer,
                    reference.offset,
                    self.root.log_end,
                )
                .map_err(|e| self.read_error(e, kind.name(), reference.offset))?,
            None => self.read_at(buffer, reference.offset, kind.name())?,
        }
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
        if head.volume != volume {
            return Err(damaged(format!(
                "the record belongs to volume {}, not {volume}",
                head.volume
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

    /// Reads and checks the page of `level` at `origin` of a volume.
    ///
    /// # Errors
    /// `Damaged` where it is not the page that must be there.
    pub(crate) fn read_page(
        &self,
        rules: &PageRules,
        volume: u16,
        level: u8,
        origin: [u32; 3],
        reference: Ref,
        buffer: &mut Vec<u8>,
    ) -> Result<Page> {
        let place = || format!("of level {level} at brick {origin:?}");
        let head = self.read_record(&reference, RecordKind::Page, volume, &place, buffer, None)?;
        let damaged =
            |what: String| self.error(ErrorKind::Damaged, format!("node page {}: {what}", place()));
        if (head.level, head.key) != (level, morton_encode(origin)) {
            return Err(damaged("its record has another place".into()));
        }
        let payload = &buffer[RECORD_HEADER..][..reference.length as usize];
        Page::decode(rules, level, origin, reference.offset, payload).map_err(damaged)
    }

    /// The volumes of the file.
    ///
    /// # Errors
    /// `DamagedRoot` when the catalog does not hold.
    pub(crate) fn catalog(&self) -> Result<Vec<Entry>> {
        let mut buffer = Vec::new();
        let catalog = &self.root.catalog;
        let place = || "of the root".to_string();
        let head = self
            .read_record(catalog, RecordKind::Catalog, 0, &place, &mut buffer, None)
            .map_err(damaged_root)?;
        if head.generation != self.root.generation {
            return Err(self.error(
                ErrorKind::DamagedRoot,
                format!(
                    "the catalog of generation {} in the root of generation {}",
                    head.generation, self.root.generation
                ),
            ));
        }
        let payload = &buffer[RECORD_HEADER..][..catalog.length as usize];
        let entries = catalog::decode_catalog(payload)
            .map_err(|what| self.error(ErrorKind::DamagedRoot, what))?;
        if entries.is_empty() {
            return Err(self.error(ErrorKind::DamagedRoot, "the catalog names no volume"));
        }
        Ok(entries)
    }

    /// Reads attributes and history of volume number `volume`.
    ///
    /// # Errors
    /// `DamagedRoot` when any of them does not hold.
    pub(crate) fn contents(&self, volume: u16, entry: Entry) -> Result<Contents> {
        let wrong = |what: String| self.error(ErrorKind::DamagedRoot, what);
        let mut buffer = Vec::new();
        let mut read = |reference: &Ref, kind: RecordKind| -> Result<Vec<u8>> {
            let place = || format!("of volume {volume}");
            self.read_record(reference, kind, volume, &place, &mut buffer, None)
                .map_err(damaged_root)?;
            Ok(buffer[RECORD_HEADER..][..reference.length as usize].to_vec())
        };
        let attributes = read(&entry.attributes, RecordKind::Attributes)?;
        let (mut spec, range, counts) = catalog::decode_attributes(&attributes).map_err(wrong)?;
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
            let history = read(&entry.history, RecordKind::History)?;
            // A later version of the text is no reason to refuse the samples.
            spec.history = meta::decode(&history).unwrap_or_default();
        }
        Ok(Contents {
            spec,
            range,
            counts,
            entry,
        })
    }

    /// Attributes and history of every volume, in order.
    ///
    /// # Errors
    /// `DamagedRoot` when any of them does not hold.
    pub(crate) fn all_contents(&self) -> Result<Vec<Contents>> {
        let entries = self.catalog()?;
        (0u16..)
            .zip(entries)
            .map(|(volume, entry)| self.contents(volume, entry))
            .collect()
    }
}

fn damaged_root(error: Error) -> Error {
    match error.kind() {
        ErrorKind::Damaged => Error::new(ErrorKind::DamagedRoot, error.to_string()),
        _ => error,
    }
}

/// The root that the commit with this footer had; its superblock may be overwritten.
fn root_of(footer: &Footer, at: u64) -> Option<Superblock> {
    let whole = record_bytes(FOOTER_BYTES as u32);
    Some(Superblock {
        generation: footer.generation,
        log_end: align_up(at.checked_add(whole)?, SECTOR as u64)?,
        catalog: footer.catalog,
        footer: at,
        // As the superblock has it: with the footer itself.
        live: footer.live.saturating_add(whole),
        garbage: footer.garbage,
        writer: 0,
        index: [0, 0],
        sealed: false,
    })
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

fn length_of(storage: &dyn Storage, path: &Path) -> Result<u64> {
    storage
        .len()
        .map_err(|e| Error::io(path, "asking for the length", e))
}

/// File id and the words of features that must be known, from the header or from its copy in the log.
fn find_id(
    storage: &dyn Storage,
    path: &Path,
    length: u64,
    notes: &mut Vec<String>,
) -> Result<([u8; FILE_ID_BYTES], u64, u64)> {
    let read = |offset: u64, bytes: usize| -> Result<Vec<u8>> {
        let mut block = vec![0; bytes];
        if offset + bytes as u64 <= length {
            storage
                .read_at(&mut block, offset)
                .map_err(|e| Error::io(path, "reading the header", e))?;
        }
        Ok(block)
    };
    let header = read(0, SECTOR)?;
    let error = match parse_header(&header) {
        Ok(id) => return Ok(with_features(id, &header)),
        Err(error) => error,
    };
    if error.kind() != ErrorKind::Newer {
        let copy = read(LOG_START, record_bytes(SECTOR as u32) as usize)?;
        if let Ok(id) = parse_header(&copy[RECORD_HEADER..])
            && record::open(&copy, seed_of(&id)).is_ok()
        {
            notes.push("the file header is damaged; its copy was used".into());
            return Ok(with_features(id, &copy[RECORD_HEADER..]));
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

/// An id with the words of features that must be known: to read, and to write.
fn with_features(id: [u8; FILE_ID_BYTES], header: &[u8]) -> ([u8; FILE_ID_BYTES], u64, u64) {
    let incompat = get_u64(header, HEADER_INCOMPAT);
    (id, incompat, get_u64(header, HEADER_RO_COMPAT))
}
