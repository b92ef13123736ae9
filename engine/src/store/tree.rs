//! The octree while a volume is written: what was put into which slot, and the pages made of it.

use super::layout::{PAGE_SLOTS, RECORD_HEADER};
use super::page::{Mask, Page, PageRules, Slot, has, page_origin, set, slot_of};
use super::record::{Head, RecordKind, Ref};
use super::spec::page_edge;
use super::value::KeyRange;
use crate::budget::{Budget, Permit};
use crate::error::{Error, Result};
use crate::lattice::{morton_decode, morton_encode};
use std::collections::BTreeMap;

/// A slot that is not background.
#[derive(Clone, Copy)]
struct Entry {
    /// Offset 0: a tile whose bits are in `length`.
    reference: Ref,
    low: u32,
    high: u32,
    slot: u16,
    has_nan: bool,
}

#[derive(Default)]
struct Pending {
    seen: Mask,
    entries: Vec<Entry>,
}

/// Slots by page, for each level in Morton order.
pub(crate) struct Tree {
    rules: PageRules,
    levels: Vec<BTreeMap<u64, Pending>>,
    permit: Permit,
    bytes: u64,
    budget: Budget,
}

/// Bytes that an empty page takes in the map, about.
const PENDING_BYTES: u64 = (size_of::<Pending>() + 48) as u64;
/// The permit grows in steps of this.
const STEP: u64 = 64 << 10;

impl Tree {
    pub(crate) fn new(rules: PageRules, root_level: u8, budget: &Budget) -> Result<Self> {
        Ok(Self {
            rules,
            levels: (0..root_level).map(|_| BTreeMap::new()).collect(),
            permit: budget.take(STEP, "the index of the volume")?,
            bytes: 0,
            budget: budget.clone(),
        })
    }

    /// Notes a stored brick.
    pub(crate) fn put_child(
        &mut self,
        brick: [u32; 3],
        reference: Ref,
        range: KeyRange,
    ) -> Result<()> {
        self.put(brick, 1, reference, range)
    }

    /// Notes a constant in every slot of a cube of `2^level` bricks per axis.
    pub(crate) fn put_tile(&mut self, min: [u32; 3], level: u8, bits: u32) -> Result<()> {
        let page_level = (level / 3 + 1).min(self.levels.len() as u8);
        let slot_edge = page_edge(page_level - 1);
        let slots = (1u32 << level).div_ceil(slot_edge);
        let range = KeyRange::of_bits(self.rules.sample, bits);
        let tile = Ref {
            offset: 0,
            length: bits,
            crc: 0,
        };
        for n in 0..u64::from(slots).pow(3) {
            let local = morton_decode(n);
            let brick: [u32; 3] = std::array::from_fn(|a| min[a] + local[a] * slot_edge);
            if (0..3).all(|a| brick[a] < self.rules.bricks[a]) {
                self.put(brick, page_level, tile, range)?;
            }
        }
        Ok(())
    }

    fn put(&mut self, brick: [u32; 3], level: u8, reference: Ref, range: KeyRange) -> Result<()> {
        let slot = slot_of(brick, level);
        let page = self.page(brick, level)?;
        if has(&page.seen, slot) {
            return Err(twice(brick));
        }
        set(&mut page.seen, slot);
        let before = page.entries.capacity();
        page.entries.push(Entry {
            reference,
            low: range.low,
            high: range.high,
            slot: slot as u16,
            has_nan: range.has_nan,
        });
        let grown = page.entries.capacity() - before;
        self.charge((grown * size_of::<Entry>()) as u64)
    }

    /// The page of `level` that holds `brick`, made together with its parents when new.
    fn page(&mut self, brick: [u32; 3], level: u8) -> Result<&mut Pending> {
        let key_at = |level: u8| morton_encode(page_origin(brick, level));
        let top = self.levels.len() as u8;
        // The first page above that exists. A refusal changes nothing: a page that was made below a
        // tile would take the next brick without a word.
        let known = (level..=top)
            .find(|&above| self.levels[usize::from(above) - 1].contains_key(&key_at(above)));
        if let Some(above) = known
            && above > level
            && has(
                &self.levels[usize::from(above) - 1][&key_at(above)].seen,
                slot_of(brick, above),
            )
        {
            return Err(twice(brick));
        }
        let new = level..known.unwrap_or(top + 1);
        self.charge(PENDING_BYTES * new.len() as u64)?;
        for above in new.clone() {
            self.levels[usize::from(above) - 1].insert(key_at(above), Pending::default());
        }
        for child in new.filter(|&child| child < top) {
            let page = self.levels[usize::from(child)].get_mut(&key_at(child + 1));
            set(
                &mut page.expect("known or made above").seen,
                slot_of(brick, child + 1),
            );
        }
        Ok(self.levels[usize::from(level) - 1]
            .get_mut(&key_at(level))
            .expect("made above"))
    }

    fn parent_of(&mut self, origin: [u32; 3], level: u8) -> &mut Pending {
        let above = morton_encode(page_origin(origin, level + 1));
        self.levels[usize::from(level)]
            .get_mut(&above)
            .expect("made with its child")
    }

    fn charge(&mut self, bytes: u64) -> Result<()> {
        self.bytes += bytes;
        if self.bytes > self.permit.bytes() {
            let wanted = self.bytes.next_multiple_of(STEP);
            if !self.permit.try_resize(wanted) {
                // Gives the error with the figures.
                self.budget
                    .take(wanted - self.permit.bytes(), "the index of the volume")?;
            }
        }
        Ok(())
    }

    /// Writes all pages bottom-up through `append`, which gets the head and the payload behind a gap
    /// for the header. Gives the root and its range; the root is nowhere when all is background.
    pub(crate) fn finish(
        mut self,
        generation: u64,
        mut append: impl FnMut(&Head, Vec<u8>) -> Result<Ref>,
    ) -> Result<Finished> {
        let rules = self.rules;
        let top = self.levels.len() as u8;
        let mut done = Finished {
            root: Ref::default(),
            range: KeyRange::of_bits(rules.sample, rules.background),
            tiles: 0,
            tile_bricks: 0,
            pages: 0,
        };
        for level in 1..=top {
            let pages = std::mem::take(&mut self.levels[usize::from(level) - 1]);
            for (key, mut pending) in pages {
                let origin = morton_decode(key);
                pending.entries.sort_unstable_by_key(|e| e.slot);
                if pending.entries.is_empty() {
                    continue;
                }
                let slots = pending.entries.iter().map(|e| {
                    let range = KeyRange {
                        low: e.low,
                        high: e.high,
                        has_nan: e.has_nan,
                    };
                    let state = if e.reference.offset == 0 {
                        Slot::Tile(e.reference.length)
                    } else {
                        Slot::Child(e.reference)
                    };
                    (usize::from(e.slot), state, range)
                });
                let page = Page::build(&rules, level, origin, slots);
                drop(pending);
                let mut entry = Entry {
                    reference: Ref::default(),
                    low: page.whole().low,
                    high: page.whole().high,
                    slot: if level < top {
                        slot_of(origin, level + 1) as u16
                    } else {
                        0
                    },
                    has_nan: page.whole().has_nan,
                };
                if let Some(bits) = page.uniform(&rules).filter(|_| level < top) {
                    entry.reference = Ref {
                        offset: 0,
                        length: bits,
                        crc: 0,
                    };
                    self.parent_of(origin, level).entries.push(entry);
                    continue;
                }
                for (slot, state) in page.slots() {
                    if let Slot::Tile(_) = state {
                        done.tiles += 1;
                        let brick = super::page::slot_origin(origin, level, slot);
                        done.tile_bricks += rules.bricks_in(brick, page_edge(level - 1));
                    }
                }
                done.pages += 1;
                let head = Head {
                    key,
                    level,
                    ..Head::new(RecordKind::Page, generation)
                };
                let mut record = vec![0; RECORD_HEADER];
                record.extend(page.encode(&rules));
                entry.reference = append(&head, record)?;
                if level < top {
                    self.parent_of(origin, level).entries.push(entry);
                } else {
                    done.root = entry.reference;
                    done.range = page.whole();
                }
            }
        }
        Ok(done)
    }
}

/// What [`Tree::finish`] made.
pub(crate) struct Finished {
    pub(crate) root: Ref,
    pub(crate) range: KeyRange,
    pub(crate) tiles: u64,
    pub(crate) tile_bricks: u64,
    pub(crate) pages: u64,
}

fn twice(brick: [u32; 3]) -> Error {
    Error::bad_input(format!(
        "brick {brick:?} is written twice: each brick may be put once"
    ))
}

const _: () = assert!(PAGE_SLOTS <= u16::MAX as usize);
