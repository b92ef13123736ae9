//! Reads a whole file and checks every checksum and every rule: the tree from the root down, which
//! tells what is lost in index space, and the log from front to back, which covers every byte.

use super::catalog::Counts;
use super::codec::decode;
use super::layout::*;
use super::open::{Contents, Opened, longest_payload};
use super::page::{Page, PageRules, Slot, slot_origin};
use super::record::{Footer, RecordKind, Ref, parse_head, parse_header};
use super::spec::{VolumeInfo, VolumeSpec, page_edge};
use super::storage::{FileStorage, Storage};
use super::value::{KeyRange, scan};
use super::writer::{info_of, rules_of};
use crate::budget::{Budget, Permit};
use crate::error::{Error, ErrorKind, Result};
use crate::lattice::{Box3, morton_encode};
use crate::sample::SampleType;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

/// What [`verify`] found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// What the file says about itself; `None` when its root is damaged.
    pub info: Option<VolumeInfo>,
    /// Bytes read.
    pub bytes: u64,
    /// Whole records in the log.
    pub records: u64,
    /// Whole bricks that the root reaches.
    pub bricks: u64,
    /// Whole node pages that the root reaches.
    pub pages: u64,
    /// Damage, at most [`MAX_PROBLEMS`] of them.
    pub problems: Vec<Problem>,
    /// Damage beyond those.
    pub more_problems: u64,
    /// What is worth knowing but no damage.
    pub notes: Vec<String>,
}

/// Most problems that a report lists.
pub const MAX_PROBLEMS: usize = 1000;

/// Damage may make the search read some stretches twice; a forged file would make it read a
/// megabyte for every eight bytes.
const SEARCH_TIMES: u64 = 8;

/// One damaged place.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// What is wrong, and where in the file.
    pub message: String,
    /// Samples that cannot be read because of it; `None` when none are lost by it.
    pub lost: Option<Box3>,
}

impl Report {
    /// Whether nothing is damaged.
    pub fn is_intact(&self) -> bool {
        self.problems.is_empty() && self.more_problems == 0
    }

    fn problem(&mut self, message: impl Into<String>, lost: Option<Box3>) {
        if self.problems.len() < MAX_PROBLEMS {
            self.problems.push(Problem {
                message: message.into(),
                lost,
            });
        } else {
            self.more_problems += 1;
        }
    }
}

/// Reads the file at `path` whole and says what is damaged and what is lost by it.
///
/// # Errors
/// The file cannot be read, is no volume, or is of a later version. Damage is no error.
///
/// # Memory
/// A few bricks.
pub fn verify(path: &Path, budget: &Budget) -> Result<Report> {
    let file = File::open(path).map_err(|e| Error::io(path, "opening the volume", e))?;
    verify_in(Arc::new(FileStorage(file)), path, budget)
}

/// [`verify`] for any storage; `name` is for messages.
///
/// # Errors
/// As [`verify`].
pub fn verify_in(storage: Arc<dyn Storage>, name: &Path, budget: &Budget) -> Result<Report> {
    let mut report = Report::default();
    let opened =
        Opened::open(storage, name).and_then(|file| file.all_contents().map(|c| (file, c)));
    let (file, contents) = match opened {
        Ok(both) => both,
        Err(e) => match e.kind() {
            ErrorKind::Damaged | ErrorKind::DamagedRoot | ErrorKind::Truncated => {
                report.problem(format!("everything is lost: {e}"), None);
                return Ok(report);
            }
            _ => return Err(e),
        },
    };
    for note in &file.notes {
        report.problem(note.clone(), None);
    }
    if file.length > file.root.log_end {
        report.notes.push(format!(
            "{} bytes of an unfinished commit follow the content",
            file.length - file.root.log_end
        ));
    }
    let first = &contents[0];
    report.info = Some(info_of(
        &first.spec,
        first.range,
        &first.counts,
        first.entry.root_level,
        &file.root,
        file.length,
    ));
    let longest = contents
        .iter()
        .map(|c| rules_of(&c.spec).brick_bytes)
        .max()
        .unwrap_or(0);
    let _permit = budget.take(
        u64::from(longest.max(CATALOG_BYTES_MAX as u32)) * 2 + 2 * u64::from(longest),
        "verifying",
    )?;
    budget.progress().start(file.root.log_end);
    let mut reached = Reached::new(budget);
    let mut live = record_bytes(file.root.catalog.length);
    for (number, contents) in contents.iter().enumerate() {
        let rules = rules_of(&contents.spec);
        let mut walk = Walk {
            file: &file,
            spec: &contents.spec,
            number: number as u16,
            rules,
            report: &mut report,
            budget,
            reached: &mut reached,
            buffer: Vec::new(),
            brick: vec![0; rules.brick_bytes as usize],
            planes: Vec::new(),
            counts: Counts::default(),
            live: 0,
        };
        walk.tree(contents)?;
        live += walk.live + record_bytes(contents.entry.attributes.length);
        if !contents.entry.history.is_none() {
            live += record_bytes(contents.entry.history.length);
        }
    }
    let mut log = Log {
        file: &file,
        report: &mut report,
        budget,
        buffer: Vec::new(),
        always_live: 0,
        all: 0,
        search_bytes: file.length.saturating_mul(SEARCH_TIMES),
    };
    log.walk(reached.sorted())?;
    live += log.always_live;
    let dead = log.all.saturating_sub(live);
    let said = (file.root.live, file.root.garbage);
    if report.is_intact() && said != (live, dead) {
        report.problem(
            format!(
                "the root says {} live and {} dead bytes, the file has {live} and {dead}",
                said.0, said.1
            ),
            None,
        );
    }
    Ok(report)
}

/// Offsets of the records that the trees reached and checked, so that the log need not be read
/// twice. Gives up when the budget does not hold them: then all of it is read again.
struct Reached {
    offsets: Vec<u64>,
    permit: Option<Permit>,
}

impl Reached {
    fn new(budget: &Budget) -> Self {
        Self {
            offsets: Vec::new(),
            permit: budget.try_take(0),
        }
    }

    fn push(&mut self, offset: u64) {
        let Some(permit) = &mut self.permit else {
            return;
        };
        if self.offsets.len() == self.offsets.capacity() {
            let more = self.offsets.len().max(512);
            // Old and new places are there together for a moment.
            if !permit.try_resize((8 * (2 * self.offsets.len() + more)) as u64) {
                *self = Self {
                    offsets: Vec::new(),
                    permit: None,
                };
                return;
            }
            self.offsets.reserve_exact(more);
        }
        self.offsets.push(offset);
    }

    fn sorted(&mut self) -> &[u64] {
        self.offsets.sort_unstable();
        &self.offsets
    }
}

struct Walk<'a> {
    file: &'a Opened,
    spec: &'a VolumeSpec,
    number: u16,
    rules: PageRules,
    report: &'a mut Report,
    budget: &'a Budget,
    reached: &'a mut Reached,
    buffer: Vec<u8>,
    brick: Vec<u8>,
    planes: Vec<u8>,
    counts: Counts,
    live: u64,
}

impl Walk<'_> {
    fn tree(&mut self, contents: &Contents) -> Result<()> {
        let entry = &contents.entry;
        let before = self.report.problems.len();
        let range = if entry.root.is_none() {
            Some(KeyRange::of_bits(self.rules.sample, self.rules.background))
        } else {
            self.page(entry.root_level, [0; 3], entry.root)?
        };
        if self.report.problems.len() > before {
            // Counts and ranges of a volume with holes tell nothing.
            return Ok(());
        }
        if range.is_some_and(|r| r != contents.range) {
            self.report.problem(
                "the range in the attributes is not that of the samples",
                None,
            );
        }
        let found = Counts {
            slabs: contents.counts.slabs,
            source_crc: contents.counts.source_crc,
            ..self.counts
        };
        if contents.counts != found {
            self.report.problem(
                format!(
                    "the attributes count {:?}, the tree has {found:?}",
                    contents.counts
                ),
                None,
            );
        }
        Ok(())
    }

    /// Checks a page and all below it; gives its range when the page itself is whole.
    fn page(&mut self, level: u8, origin: [u32; 3], reference: Ref) -> Result<Option<KeyRange>> {
        self.budget.check_cancelled()?;
        let page = match self.load_page(level, origin, reference) {
            Ok(page) => page,
            Err(e) => {
                self.lost(e, origin, page_edge(level))?;
                return Ok(None);
            }
        };
        self.report.pages += 1;
        self.counts.pages += 1;
        for (slot, state) in page.slots() {
            let at = slot_origin(origin, level, slot);
            let edge = page_edge(level - 1);
            match state {
                Slot::Background => {}
                Slot::Tile(_) => {
                    self.counts.tiles += 1;
                    self.counts.tile_bricks += self.rules.bricks_in(at, edge);
                }
                Slot::Child(child) => {
                    let range = if level > 1 {
                        self.page(level - 1, at, child)?
                    } else {
                        match self.load_brick(at, child) {
                            Ok(range) => Some(range),
                            Err(e) => {
                                self.lost(e, at, 1)?;
                                None
                            }
                        }
                    };
                    if range.is_some_and(|r| r != page.range(slot)) {
                        let place = self.spec.node_box(at, edge);
                        self.report.problem(
                            format!("the range stored for {place} is not that of its samples"),
                            None,
                        );
                    }
                }
            }
        }
        Ok(Some(page.whole()))
    }

    /// Damage is noted; what the medium refuses ends the check.
    fn lost(&mut self, error: Error, brick: [u32; 3], edge: u32) -> Result<()> {
        if matches!(error.kind(), ErrorKind::Damaged | ErrorKind::Truncated) {
            self.report
                .problem(error.to_string(), Some(self.spec.node_box(brick, edge)));
            return Ok(());
        }
        Err(error)
    }

    /// Accounts for a record that was read whole.
    fn count(&mut self, reference: &Ref) {
        let bytes = record_bytes(reference.length);
        self.report.bytes += bytes;
        self.live += bytes;
        self.reached.push(reference.offset);
        self.budget.progress().add(bytes);
    }

    fn load_page(&mut self, level: u8, origin: [u32; 3], reference: Ref) -> Result<Page> {
        let page = self.file.read_page(
            &self.rules,
            self.number,
            level,
            origin,
            reference,
            &mut self.buffer,
        )?;
        self.count(&reference);
        let [start, length] = self.file.root.index;
        let end = reference.offset + record_bytes(reference.length);
        let spanned = start <= reference.offset && end - start <= length;
        if length > 0 && !spanned {
            self.report.problem(
                format!(
                    "node page of level {level} at brick {origin:?} lies outside of the index span {start} + {length}"
                ),
                None,
            );
        }
        Ok(page)
    }

    fn load_brick(&mut self, brick: [u32; 3], reference: Ref) -> Result<KeyRange> {
        let place = || format!("{brick:?}");
        let head = self.file.read_record(
            &reference,
            RecordKind::Brick,
            self.number,
            &place,
            &mut self.buffer,
            None,
        )?;
        let damaged = |what: &str| {
            self.file.error(
                ErrorKind::Damaged,
                format!("brick {brick:?} at offset {}: {what}", reference.offset),
            )
        };
        if head.key != morton_encode(brick)
            || head.level != 0
            || head.decoded != self.rules.brick_bytes
        {
            return Err(damaged("its record has another place or size"));
        }
        let stored = &self.buffer[RECORD_HEADER..][..reference.length as usize];
        decode(
            head.codec,
            stored,
            self.spec.sample,
            self.spec.brick_edge,
            &mut self.brick,
            &mut self.planes,
        )
        .map_err(damaged)?;
        self.count(&reference);
        self.report.bricks += 1;
        self.counts.bricks += 1;
        self.counts.stored += u64::from(reference.length);
        Ok(range_of(self.spec.sample, &self.brick))
    }
}

/// The log from front to back.
struct Log<'a> {
    file: &'a Opened,
    report: &'a mut Report,
    budget: &'a Budget,
    buffer: Vec<u8>,
    /// Bytes of footers and of the header copy.
    always_live: u64,
    /// Bytes of all records.
    all: u64,
    /// Bytes that the search for whole records in damaged stretches may still read.
    search_bytes: u64,
}

impl Log<'_> {
    /// Every byte of the log: records one after the other, commit by commit. Of those `reached` (in
    /// order) only the header is read.
    fn walk(&mut self, mut reached: &[u64]) -> Result<()> {
        let end = self.file.root.log_end;
        let (mut at, mut start, mut chain, mut records) =
            (LOG_START, LOG_START, self.file.seed, 0u64);
        let (mut whole, mut last) = (true, None);
        self.report.bytes += LOG_START;
        while at < end {
            self.budget.check_cancelled()?;
            while reached.first().is_some_and(|&r| r < at) {
                reached = &reached[1..];
            }
            let known = reached.first() == Some(&at);
            let mut buffer = std::mem::take(&mut self.buffer);
            let found = if known {
                self.file.head_at(at, &mut buffer)?
            } else {
                self.file.record_at(at, &mut buffer)?
            };
            self.buffer = buffer;
            let Some((head, reference)) = found else {
                let next = self.next_record(at, end)?;
                self.report.problem(
                    format!(
                        "no whole record at offset {at}; {} bytes are skipped",
                        next - at
                    ),
                    None,
                );
                (at, whole) = (next, false);
                continue;
            };
            let bytes = record_bytes(reference.length);
            self.report.records += 1;
            self.all += bytes;
            if at == LOG_START {
                self.check_header_copy()?;
            }
            if !known {
                self.report.bytes += bytes;
                self.budget.progress().add(bytes);
            }
            if head.kind == RecordKind::Header as u8 {
                self.always_live += bytes;
            }
            if head.kind == RecordKind::Footer as u8 {
                self.always_live += bytes;
                let payload = &self.buffer[RECORD_HEADER..][..reference.length as usize];
                let footer = Footer::parse(payload);
                let fits = footer
                    .is_some_and(|f| (f.start, f.records, f.chain) == (start, records, chain));
                last = footer.map(|f| (at, f.generation, f.catalog));
                if whole && !fits {
                    self.report.problem(
                        format!("the footer at offset {at} does not fit its commit"),
                        None,
                    );
                }
                let next = align_up(at + bytes, SECTOR as u64).unwrap_or(end);
                self.check_zero(at + bytes, next.min(end))?;
                (at, start, chain, records, whole) = (next, next, self.file.seed, 0, true);
                continue;
            }
            chain = crc32c::crc32c_append(chain, &self.buffer[..RECORD_HEADER]);
            records += 1;
            at += bytes;
        }
        let root = &self.file.root;
        if last.is_some_and(|l| l != (root.footer, root.generation, root.catalog)) {
            self.report
                .problem("the last footer is not that of the root", None);
        }
        Ok(())
    }

    /// The next place after `from` where a whole record starts.
    ///
    /// Gives `end` where false starts of records cost too many reads: a file may be made of them.
    fn next_record(&mut self, from: u64, end: u64) -> Result<u64> {
        let mut at = from + RECORD_ALIGN as u64;
        let mut window = [0; SECTOR];
        while at < end {
            let n = (end - at).min(SECTOR as u64) as usize;
            self.file
                .storage
                .read_at(&mut window[..n], at)
                .map_err(|e| Error::io(&self.file.path, &format!("reading at offset {at}"), e))?;
            self.budget.check_cancelled()?;
            for step in (0..n.saturating_sub(RECORD_HEADER - 1)).step_by(RECORD_ALIGN) {
                let Some((head, length, _)) = parse_head(&window[step..]) else {
                    continue;
                };
                let longest = longest_payload(head.kind).min(length as usize);
                let Some(left) = self.search_bytes.checked_sub(longest as u64) else {
                    self.report
                        .notes
                        .push(format!("the search for records ended at offset {at}"));
                    return Ok(end);
                };
                self.search_bytes = left;
                if self
                    .file
                    .record_at(at + step as u64, &mut self.buffer)?
                    .is_some()
                {
                    return Ok(at + step as u64);
                }
            }
            // A header may stand across the border of two windows.
            at += (n.saturating_sub(RECORD_HEADER - RECORD_ALIGN)).max(RECORD_ALIGN) as u64
                & !(RECORD_ALIGN as u64 - 1);
        }
        Ok(end)
    }

    /// The first record, which is in the buffer, holds the file header again.
    fn check_header_copy(&mut self) -> Result<()> {
        let mut header = vec![0; SECTOR];
        self.file
            .storage
            .read_at(&mut header, 0)
            .map_err(|e| Error::io(&self.file.path, "reading the header", e))?;
        if parse_header(&header).is_ok()
            && self.buffer.get(RECORD_HEADER..RECORD_HEADER + SECTOR) != Some(&header[..])
        {
            self.report
                .problem("the copy of the file header is another one", None);
        }
        Ok(())
    }

    fn check_zero(&mut self, from: u64, to: u64) -> Result<()> {
        let mut gap = vec![0; (to.saturating_sub(from)) as usize];
        self.file
            .storage
            .read_at(&mut gap, from)
            .map_err(|e| Error::io(&self.file.path, &format!("reading at offset {from}"), e))?;
        self.report.bytes += gap.len() as u64;
        if gap.iter().any(|&b| b != 0) {
            self.report
                .problem(format!("the gap at offset {from} is not zero"), None);
        }
        Ok(())
    }
}

fn range_of(sample: SampleType, brick: &[u8]) -> KeyRange {
    if sample == SampleType::Bit {
        let (any, all) = (
            brick.iter().any(|&b| b != 0),
            brick.iter().all(|&b| b == 0xff),
        );
        return KeyRange {
            low: all.into(),
            high: any.into(),
            has_nan: false,
        };
    }
    scan(sample, brick).0
}
