//! A volume file without dead bytes: live bricks in Morton order, then all pages, in one commit.

use super::aside::create_aside;
use super::catalog::Entry;
use super::encode::{Batch, Encoded};
use super::layout::RECORD_HEADER;
use super::lod::fits;
use super::open::{Contents, Opened};
use super::page::{PageRules, Slot, slot_origin};
use super::record::{Head, RecordKind, Ref, seal};
use super::spec::VolumeInfo;
use super::storage::{FileStorage, Storage};
use super::value::KeyRange;
use super::writer::{Part, VolumeWriter, rules_of, take_lock};
use crate::budget::Budget;
use crate::error::{Error, ErrorKind, Result};
use crate::lattice::morton_encode;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

/// Bytes of bricks that are written at a time.
const BATCH_BYTES: usize = 1 << 20;

/// Copies the newest generation of the file at `path` to `out`, which may be `path` itself: every
/// volume and level of detail (those that no longer fit their samples are left out), bricks in
/// Morton order without compressing them anew, no dead bytes, no older generations. The new file
/// is *sealed* until it is changed. Equal content gives equal files.
///
/// Readers of the old file are not disturbed.
///
/// # Errors
/// Damage, which is never copied; `ForeignWriter` when a file that is to be replaced by itself has
/// a writer; a write that fails. Nothing is then changed.
///
/// # Memory
/// 32 bytes for each stored brick and a few MiB.
pub fn compact(path: &Path, out: &Path, budget: &Budget) -> Result<VolumeInfo> {
    let file = File::open(path).map_err(|e| Error::io(path, "opening the volume", e))?;
    let source = Arc::new(FileStorage(file));
    if let (Ok(from), Ok(to)) = (path.canonicalize(), out.canonicalize())
        && from == to
    {
        // Held until the end: what a writer committed meanwhile would be lost.
        take_lock(source.as_ref(), path)?;
    }
    let file = Opened::open(source, path)?;
    let all = live_volumes(&file)?;
    let (target, aside) = create_aside(out)?;
    let storage = Arc::new(FileStorage(target));
    let is_locked = take_lock(storage.as_ref(), aside.path())?;
    let first = all[0].1.spec.clone();
    let writer = VolumeWriter::start(storage, is_locked, out, &first, budget, Some(aside))?;
    copy(&file, &all, writer, budget)
}

/// [`compact`] from one storage to another, empty one; `name` is for messages.
///
/// # Errors
/// As [`compact`].
pub fn compact_in(
    source: Arc<dyn Storage>,
    target: Arc<dyn Storage>,
    name: &Path,
    budget: &Budget,
) -> Result<VolumeInfo> {
    let file = Opened::open(source, name)?;
    let all = live_volumes(&file)?;
    let writer = VolumeWriter::create_in(target, name, &all[0].1.spec, budget)?;
    copy(&file, &all, writer, budget)
}

/// Number and contents of each volume that is to be copied.
fn live_volumes(file: &Opened) -> Result<Vec<(u16, Contents)>> {
    let all = file.all_contents()?;
    if all[0].counts.slabs != 0 {
        return Err(file.error(
            ErrorKind::BadInput,
            "an import that was not finished: resume it first",
        ));
    }
    let entries: Vec<Entry> = all.iter().map(|c| c.entry.clone()).collect();
    Ok((0u16..)
        .zip(all)
        .filter(|(_, c)| c.entry.lod == 0 || fits(&entries[usize::from(c.entry.parent)], &c.counts))
        .collect())
}

fn copy(
    file: &Opened,
    all: &[(u16, Contents)],
    mut writer: VolumeWriter,
    budget: &Budget,
) -> Result<VolumeInfo> {
    writer.sealed = true;
    let number = |old: u16| all.iter().position(|(n, _)| *n == old).unwrap_or(0) as u16;
    for (_, contents) in &all[1..] {
        let mut part = Part::new(&contents.spec, false, budget)?;
        (part.lod, part.parent) = (contents.entry.lod, number(contents.entry.parent));
        // It fits, and so does its copy.
        part.set_built(part.lod != 0);
        writer.add_part(part)?;
    }
    let bricks = all.iter().map(|(_, c)| c.counts.bricks);
    budget.progress().start(bricks.fold(0, u64::saturating_add));
    let longest = all
        .iter()
        .map(|(_, c)| u64::from(rules_of(&c.spec).brick_bytes))
        .max();
    let _permit = budget.take(
        BATCH_BYTES as u64 + 3 * (longest.unwrap_or(0) + 64) + (64 << 10),
        "copying bricks",
    )?;
    for (volume, (old, contents)) in all.iter().enumerate() {
        let mut copy = Copy {
            file,
            writer: &writer,
            budget,
            rules: rules_of(&contents.spec),
            old: *old,
            batch: Batch {
                volume,
                ..Batch::default()
            },
            buffer: Vec::new(),
        };
        if !contents.entry.root.is_none() {
            copy.page(contents.entry.root_level, [0; 3], contents.entry.root)?;
        }
        copy.flush()?;
    }
    writer.finish()
}

struct Copy<'a> {
    file: &'a Opened,
    writer: &'a VolumeWriter,
    budget: &'a Budget,
    rules: PageRules,
    /// Number of the volume in the old file.
    old: u16,
    batch: Batch,
    buffer: Vec<u8>,
}

impl Copy<'_> {
    /// Copies all below a page; depth is bounded by its level.
    fn page(&mut self, level: u8, origin: [u32; 3], reference: Ref) -> Result<()> {
        let page = self.file.read_page(
            &self.rules,
            self.old,
            level,
            origin,
            reference,
            &mut self.buffer,
        )?;
        for (slot, state) in page.slots() {
            let at = slot_origin(origin, level, slot);
            match state {
                Slot::Background => {}
                Slot::Tile(bits) => {
                    let volume = self.batch.volume;
                    self.writer
                        .put_constant_bits(volume, at, 3 * (level - 1), bits)?;
                }
                Slot::Child(child) if level > 1 => self.page(level - 1, at, child)?,
                Slot::Child(child) => self.brick(at, child, page.range(slot))?,
            }
        }
        Ok(())
    }

    fn brick(&mut self, at: [u32; 3], reference: Ref, range: KeyRange) -> Result<()> {
        self.budget.check_cancelled()?;
        let place = || format!("{at:?}");
        let head = self.file.read_record(
            &reference,
            RecordKind::Brick,
            self.old,
            &place,
            &mut self.buffer,
            None,
        )?;
        if head.key != morton_encode(at)
            || head.level != 0
            || head.decoded != self.rules.brick_bytes
        {
            return Err(self.file.error(
                ErrorKind::Damaged,
                format!("brick {at:?}: its record has another place or size"),
            ));
        }
        let out = &mut self.batch.bytes;
        let start = out.len();
        out.extend_from_slice(&self.buffer[..RECORD_HEADER + reference.length as usize]);
        let log = &self.writer.log;
        let head = Head {
            generation: log.generation(),
            volume: self.batch.volume as u16,
            ..head
        };
        let sealed = seal(out, start, &head, log.seed);
        self.batch.bricks.push((at, Encoded::Brick(sealed, range)));
        self.budget.progress().add(1);
        if self.batch.bytes.len() >= BATCH_BYTES {
            self.flush()?;
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<()> {
        self.writer.append(&self.batch)?;
        self.batch.clear();
        Ok(())
    }
}
