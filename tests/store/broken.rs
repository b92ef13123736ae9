//! Writers and readers with one deliberate mistake in the protocol, made by a storage that stands
//! between the engine and the disk. If the harness does not catch each of them it proves nothing.

use super::disk::{Disk, Op};
use brickmarch::store::Storage;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The mistakes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mistake {
    /// Nothing between the data and the superblock.
    NoDataSync,
    /// Nothing after the superblock.
    NoFinalSync,
    /// Success is reported when the commit is asked for.
    AckAtOnce,
    /// Success is reported once the data is synced.
    AckBeforeSuperblock,
    /// Success is reported after the superblock is written, before it is synced.
    AckBeforeFinalSync,
    SuperblockFirst,
    /// The catalog is written after the sync of the data.
    LateCatalog,
    /// The node pages are written after the sync of the data.
    LatePages,
    /// The log is not filled up to the border of the commit.
    NoPadding,
    /// Both superblocks in one place, and a reader that does not walk the log.
    OneSlot,
    /// The superblock before is wiped together with the new one, and no walk.
    WipedSlot,
    /// Readers trust a superblock whose checksum does not hold.
    NoSuperblockCrc,
    /// With one superblock damaged readers take the other as it is.
    NoRollForward,
    /// Readers walk to any footer of the next generation and do not look at the records before it.
    TrustedFooter,
    /// Commits follow each other without border.
    Unaligned,
    /// A commit overwrites the one that it replaces.
    ReusedSpace,
}

impl Mistake {
    pub(crate) const ALL: [Mistake; 16] = [
        Mistake::NoDataSync,
        Mistake::NoFinalSync,
        Mistake::AckAtOnce,
        Mistake::AckBeforeSuperblock,
        Mistake::AckBeforeFinalSync,
        Mistake::SuperblockFirst,
        Mistake::LateCatalog,
        Mistake::LatePages,
        Mistake::NoPadding,
        Mistake::OneSlot,
        Mistake::WipedSlot,
        Mistake::NoSuperblockCrc,
        Mistake::NoRollForward,
        Mistake::TrustedFooter,
        Mistake::Unaligned,
        Mistake::ReusedSpace,
    ];
}

const SLOTS: [u64; 2] = [4096, 8192];
const LOG: u64 = 12288;
const ROOT: &[u8] = b"SVOLROOT";
const CATALOG: u8 = 4;
const PAGE: u8 = 3;
const FOOTER: u8 = 6;

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"))
}

/// Where logical offsets of the log lie on the disk: pieces by logical start.
pub(crate) type Map = Vec<(u64, u64)>;

#[derive(Debug, Default)]
struct State {
    held: Vec<(u64, Vec<u8>)>,
    published: bool,
    map: Map,
    /// Physical start and end of the running commit.
    start: u64,
    end: u64,
}

/// The storage that makes the mistake.
pub(crate) struct Broken {
    inner: Arc<dyn Storage>,
    /// The same disk, where a writer is broken.
    disk: Option<Arc<Disk>>,
    mistake: Mistake,
    state: Mutex<State>,
}

impl Broken {
    pub(crate) fn writer(disk: Arc<Disk>, mistake: Mistake) -> Self {
        Self {
            inner: disk.clone(),
            disk: Some(disk),
            mistake,
            state: Mutex::new(State {
                map: vec![(LOG, LOG)],
                start: LOG,
                end: LOG,
                ..State::default()
            }),
        }
    }

    pub(crate) fn reader(inner: Arc<dyn Storage>, mistake: Mistake, map: Map) -> Self {
        Self {
            inner,
            disk: None,
            mistake,
            state: Mutex::new(State {
                map,
                ..State::default()
            }),
        }
    }

    pub(crate) fn map(&self) -> Map {
        self.state().map.clone()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_mapped(&self) -> bool {
        matches!(self.mistake, Mistake::Unaligned | Mistake::ReusedSpace)
    }

    fn never_walks(&self) -> bool {
        matches!(
            self.mistake,
            Mistake::OneSlot | Mistake::WipedSlot | Mistake::NoRollForward
        )
    }

    fn physical(&self, offset: u64) -> u64 {
        let state = self.state();
        let piece = state.map.iter().rev().find(|p| p.0 <= offset);
        match piece {
            Some(&(logical, physical)) if self.is_mapped() => physical + (offset - logical),
            _ => offset,
        }
    }

    fn ack(&self) {
        let disk = self.disk.as_ref().expect("only writers report success");
        if let Some(n) = disk.in_flight() {
            disk.mark(Op::Acked(n));
        }
    }

    /// The superblock of a slot as the broken reader sees it.
    fn superblock(&self, slot: u64) -> io::Result<Vec<u8>> {
        let mut block = vec![0; 4096];
        let place = if self.mistake == Mistake::OneSlot {
            SLOTS[0]
        } else {
            slot
        };
        self.inner.read_at(&mut block, place)?;
        let odd = u64_at(&block, 8) % 2 == 1;
        if self.mistake == Mistake::OneSlot && odd != (slot == SLOTS[0]) {
            block.fill(0);
        }
        if self.mistake == Mistake::NoSuperblockCrc && block.starts_with(ROOT) {
            let crc = self.crc_of(&block)?;
            block[4092..].copy_from_slice(&crc.to_le_bytes());
        }
        if self.mistake == Mistake::TrustedFooter && self.disk.is_none() {
            self.trust_footer(&mut block, slot)?;
        }
        Ok(block)
    }

    /// Makes a superblock for `slot` of a footer behind the newest root.
    fn trust_footer(&self, block: &mut [u8], slot: u64) -> io::Result<()> {
        let mut other = vec![0; 4096];
        let newest = SLOTS[usize::from(slot == SLOTS[0])];
        self.inner.read_at(&mut other, newest)?;
        let holds = |block: &[u8]| -> io::Result<bool> {
            Ok(block.starts_with(ROOT) && self.crc_of(block)?.to_le_bytes() == block[4092..])
        };
        if !holds(&other)? || (holds(block)? && u64_at(block, 8) > u64_at(&other, 8)) {
            return Ok(());
        }
        let (next, start) = (u64_at(&other, 8) + 1, u64_at(&other, 16));
        let mut tail = vec![0; self.inner.len()?.saturating_sub(start) as usize];
        self.inner.read_at(&mut tail, start)?;
        let found = (0..tail.len().saturating_sub(111)).step_by(8).find(|&at| {
            tail[at..].starts_with(b"SVrc")
                && tail[at + 4] == FOOTER
                && u64_at(&tail, at + 16) == next
        });
        if let Some(at) = found {
            let payload = &tail[at + 40..at + 112];
            let footer = start + at as u64;
            block.copy_from_slice(&other);
            block[8..16].copy_from_slice(&next.to_le_bytes());
            let end = (footer + 112).next_multiple_of(4096);
            block[16..24].copy_from_slice(&end.to_le_bytes());
            block[24..40].copy_from_slice(&payload[8..24]);
            block[40..48].copy_from_slice(&footer.to_le_bytes());
            let crc = self.crc_of(block)?;
            block[4092..].copy_from_slice(&crc.to_le_bytes());
        }
        Ok(())
    }

    fn crc_of(&self, block: &[u8]) -> io::Result<u32> {
        let mut id = [0; 16];
        self.inner.read_at(&mut id, 40)?;
        Ok(crc32c::crc32c_append(crc32c::crc32c(&id), &block[..4092]))
    }

    /// Log ends of the superblocks that hold.
    fn log_ends(&self) -> io::Result<Vec<u64>> {
        let mut ends = Vec::new();
        for slot in SLOTS {
            if let Ok(block) = self.superblock(slot)
                && block.starts_with(ROOT)
                && self.crc_of(&block)?.to_le_bytes() == block[4092..]
            {
                ends.push(u64_at(&block, 16));
            }
        }
        Ok(ends)
    }

    fn publish(&self, block: &[u8], slot: u64) -> io::Result<()> {
        if self.mistake == Mistake::SuperblockFirst {
            self.inner.write_at(block, slot)?;
            self.inner.sync()?;
            let held = std::mem::take(&mut self.state().held);
            for (offset, bytes) in held {
                self.inner.write_at(&bytes, offset)?;
            }
            self.state().published = true;
            return Ok(());
        }
        if self.mistake == Mistake::OneSlot {
            self.inner.write_at(block, SLOTS[0])?;
        } else {
            self.inner.write_at(block, slot)?;
        }
        if self.mistake == Mistake::WipedSlot {
            let other = SLOTS[usize::from(slot == SLOTS[0])];
            self.inner.write_at(&[0; 4096], other)?;
        }
        if self.mistake == Mistake::AckBeforeFinalSync {
            self.ack();
        }
        let mut state = self.state();
        state.published = true;
        let next = match self.mistake {
            Mistake::Unaligned => state.end,
            _ => state.start,
        };
        let logical = u64_at(block, 16);
        if state.map.last().is_none_or(|l| l.0 != logical) {
            state.map.push((logical, next));
        }
        (state.start, state.end) = (next, next);
        Ok(())
    }
}

/// Whether a record of `kind` starts in these records.
fn has_kind(bytes: &[u8], kind: u8) -> bool {
    let mut at = 0;
    while let Some(head) = bytes.get(at..at + 40)
        && head.starts_with(b"SVrc")
    {
        if head[4] == kind {
            return true;
        }
        let length = u32::from_le_bytes(head[8..12].try_into().expect("four bytes"));
        at += (40 + length as usize).next_multiple_of(8);
    }
    false
}

impl Storage for Broken {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        if SLOTS.contains(&offset) && buffer.len() == 4096 {
            buffer.copy_from_slice(&self.superblock(offset)?);
            return Ok(());
        }
        self.inner.read_at(buffer, self.physical(offset))
    }

    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<()> {
        if self.mistake == Mistake::AckAtOnce {
            self.ack();
        }
        if SLOTS.contains(&offset) && bytes.starts_with(ROOT) && u64_at(bytes, 8) > 0 {
            return self.publish(bytes, offset);
        }
        if SLOTS.contains(&offset) && self.mistake == Mistake::OneSlot {
            // The root of generation 0 stands in the one slot.
            return if bytes.starts_with(ROOT) {
                self.inner.write_at(bytes, SLOTS[0])
            } else {
                Ok(())
            };
        }
        let padding = offset > LOG
            && bytes.len() < 4096
            && (offset + bytes.len() as u64).is_multiple_of(4096)
            && bytes.iter().all(|&b| b == 0);
        if padding && (self.is_mapped() || self.mistake == Mistake::NoPadding) {
            return Ok(());
        }
        let physical = self.physical(offset);
        let hold = match self.mistake {
            Mistake::SuperblockFirst => offset >= LOG,
            Mistake::LateCatalog => has_kind(bytes, CATALOG),
            Mistake::LatePages => has_kind(bytes, PAGE),
            _ => false,
        };
        let mut state = self.state();
        if hold {
            state.held.push((offset, bytes.to_vec()));
            return Ok(());
        }
        if offset >= LOG {
            state.end = state.end.max(physical + bytes.len() as u64);
        }
        drop(state);
        self.inner.write_at(bytes, physical)
    }

    fn len(&self) -> io::Result<u64> {
        let length = self.inner.len()?;
        if self.disk.is_none() && self.never_walks() {
            let ends = self.log_ends()?;
            // A log that is walked no further than the root that is known.
            if ends.len() < 2 {
                return Ok(length.min(ends.first().copied().unwrap_or(LOG)));
            }
        }
        if self.is_mapped() {
            let state = self.state();
            let piece = state.map.iter().rev().find(|p| p.1 <= length);
            return Ok(piece.map_or(length, |&(logical, physical)| logical + length - physical));
        }
        Ok(length)
    }

    fn set_len(&self, length: u64) -> io::Result<()> {
        self.inner.set_len(length)
    }

    fn sync(&self) -> io::Result<()> {
        let published = std::mem::take(&mut self.state().published);
        match (self.mistake, published) {
            (Mistake::NoDataSync | Mistake::SuperblockFirst, false)
            | (Mistake::NoFinalSync, true) => return Ok(()),
            _ => {}
        }
        self.inner.sync()?;
        if !published {
            let held = std::mem::take(&mut self.state().held);
            for (offset, bytes) in held {
                self.inner.write_at(&bytes, offset)?;
            }
            if self.mistake == Mistake::AckBeforeSuperblock {
                self.ack();
            }
        }
        Ok(())
    }

    fn lock(&self) -> io::Result<bool> {
        self.inner.lock()
    }
}
