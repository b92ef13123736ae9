//! The octree while a volume is written: what was put into which slot since the last commit, over
//! the pages of that commit, and the new pages made of both.

use super::catalog::Counts;
use super::layout::{PAGE_SLOTS, RECORD_HEADER, record_bytes};
use super::open::Opened;
use super::page::{Mask, Page, PageRules, Slot, has, page_origin, set, slot_of, slot_origin};
use super::record::{Head, RecordKind, Ref};
use super::spec::page_edge;
use super::value::KeyRange;
use crate::budget::{Budget, Permit};
use crate::error::{Error, Result};
use crate::lattice::{morton_decode, morton_encode};
use std::collections::BTreeMap;
use std::rc::Rc;

/// A slot that was put and is not background.
#[derive(Clone, Copy)]
struct Entry {
    /// A tile has its bits in `length`.
    reference: Ref,
    low: u32,
    high: u32,
    slot: u16,
    has_nan: bool,
    holds: Holds,
    /// Made of the page of the last commit in this slot, which is then accounted for.
    rebuilt: bool,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Holds {
    Background,
    Tile,
    Child,
}

/// What the slots of a page that were not put hold.
#[derive(Clone, Copy)]
enum Below {
    /// What the last commit has there.
    File,
    /// The constant (bits) that was put over them since.
    Constant(u32),
}

struct Pending {
    below: Below,
    /// Slots that were put, and slots whose page is pending. Without entry and page: background.
    seen: Mask,
    entries: Vec<Entry>,
}

/// Slots by page, for each level in Morton order.
pub(crate) struct Tree {
    rules: PageRules,
    levels: Vec<BTreeMap<u64, Pending>>,
    /// Whether a slot may be put again.
    replace: bool,
    /// Bytes of records of this commit that were replaced by later ones.
    replaced: u64,
    permit: Permit,
    bytes: u64,
    budget: Budget,
}

/// The pages of the last commit.
pub(crate) struct Base<'a> {
    pub(crate) file: &'a Opened,
    pub(crate) volume: u16,
    pub(crate) root: Ref,
    pub(crate) root_level: u8,
}

/// What a commit makes of a volume.
pub(crate) struct Changes {
    pub(crate) root: Ref,
    pub(crate) range: KeyRange,
    pub(crate) counts: Counts,
    /// Bytes of records that the new root does not reach.
    pub(crate) dropped: u64,
}

/// Bytes that an empty page takes in the map, about.
const PENDING_BYTES: u64 = (size_of::<Pending>() + 48) as u64;
/// The permit grows in steps of this.
const STEP: u64 = 64 << 10;
/// Bytes of a few pages while they are made.
const PAGES_BYTES: u64 = 256 << 10;

impl Tree {
    pub(crate) fn new(
        rules: PageRules,
        root_level: u8,
        replace: bool,
        budget: &Budget,
    ) -> Result<Self> {
        Ok(Self {
            rules,
            levels: (0..root_level).map(|_| BTreeMap::new()).collect(),
            replace,
            replaced: 0,
            permit: budget.take(STEP, "the index of the volume")?,
            bytes: 0,
            budget: budget.clone(),
        })
    }

    /// Whether nothing was put.
    pub(crate) fn is_empty(&self) -> bool {
        self.levels.iter().all(BTreeMap::is_empty)
    }

    /// Forgets what was put.
    pub(crate) fn clear(&mut self) {
        self.levels.iter_mut().for_each(BTreeMap::clear);
        (self.replaced, self.bytes) = (0, 0);
        self.permit.try_resize(STEP);
    }

    /// Notes a stored brick.
    pub(crate) fn put_child(
        &mut self,
        brick: [u32; 3],
        reference: Ref,
        range: KeyRange,
    ) -> Result<()> {
        self.put(brick, 1, Slot::Child(reference), range)
    }

    /// Notes a constant in every slot of a cube of `2^level` bricks per axis.
    pub(crate) fn put_constant(&mut self, min: [u32; 3], level: u8, bits: u32) -> Result<()> {
        let page_level = (level / 3 + 1).min(self.levels.len() as u8);
        let slot_edge = page_edge(page_level - 1);
        let slots = (1u32 << level).div_ceil(slot_edge);
        let range = KeyRange::of_bits(self.rules.sample, bits);
        let slot = if bits == self.rules.background {
            Slot::Background
        } else {
            Slot::Tile(bits)
        };
        for n in 0..u64::from(slots).pow(3) {
            let local = morton_decode(n);
            let brick: [u32; 3] = std::array::from_fn(|a| min[a] + local[a] * slot_edge);
            if (0..3).all(|a| brick[a] < self.rules.bricks[a]) {
                self.put(brick, page_level, slot, range)?;
            }
        }
        Ok(())
    }

    fn put(&mut self, brick: [u32; 3], level: u8, state: Slot, range: KeyRange) -> Result<()> {
        let slot = slot_of(brick, level);
        let replace = self.replace;
        let page = self.page(brick, level)?;
        let mut replaced = 0;
        if has(&page.seen, slot) {
            if !replace {
                return Err(twice(brick));
            }
            if let Some(n) = page.position(slot) {
                replaced += page.entries.swap_remove(n).record_bytes();
            }
        }
        set(&mut page.seen, slot);
        let mut grown = 0;
        if state != Slot::Background {
            let before = page.entries.capacity();
            page.entries.push(Entry::new(slot, state, range, false));
            grown = page.entries.capacity() - before;
        }
        if replace {
            replaced += self.forget_below(brick, level);
        }
        self.replaced += replaced;
        self.charge((grown * size_of::<Entry>()) as u64)
    }

    /// Drops pending pages below a slot of a page of `level`; gives the bytes of their bricks.
    fn forget_below(&mut self, brick: [u32; 3], level: u8) -> u64 {
        let first = morton_encode(page_origin(brick, level - 1));
        let end = first + u64::from(page_edge(level - 1)).pow(3);
        let mut bytes = 0;
        for below in &mut self.levels[..usize::from(level) - 1] {
            let keys: Vec<u64> = below.range(first..end).map(|(&key, _)| key).collect();
            for key in keys {
                let page = below.remove(&key).expect("just listed");
                bytes += page.entries.iter().map(Entry::record_bytes).sum::<u64>();
            }
        }
        bytes
    }

    /// The page of `level` that holds `brick`, made together with its parents when new.
    fn page(&mut self, brick: [u32; 3], level: u8) -> Result<&mut Pending> {
        let key_at = |level: u8| morton_encode(page_origin(brick, level));
        let top = self.levels.len() as u8;
        if !self.levels[usize::from(level) - 1].contains_key(&key_at(level)) {
            for here in (level..=top).rev() {
                if self.levels[usize::from(here) - 1].contains_key(&key_at(here)) {
                    continue;
                }
                self.charge(PENDING_BYTES)?;
                let below = if here == top {
                    Below::File
                } else {
                    self.levels[usize::from(here)]
                        .get_mut(&key_at(here + 1))
                        .expect("made before")
                        .open_slot(slot_of(brick, here + 1), &self.rules, self.replace)
                        .ok_or_else(|| twice(brick))?
                };
                let page = Pending {
                    below,
                    seen: Mask::default(),
                    entries: Vec::new(),
                };
                self.levels[usize::from(here) - 1].insert(key_at(here), page);
            }
        }
        Ok(self.levels[usize::from(level) - 1]
            .get_mut(&key_at(level))
            .expect("made above"))
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

    /// Writes all changed pages bottom-up through `append`, which gets the head and the payload
    /// behind a gap for the header. `before` and `counts` are what the last commit has. The tree is
    /// empty afterwards.
    pub(crate) fn commit(
        &mut self,
        before: Base<'_>,
        counts: Counts,
        generation: u64,
        append: &mut dyn FnMut(&Head, Vec<u8>) -> Result<Ref>,
    ) -> Result<Changes> {
        let _permit = self.budget.take(PAGES_BYTES, "making node pages")?;
        let top = self.levels.len() as u8;
        let volume = before.volume;
        let mut merge = Merge {
            rules: self.rules,
            base: before,
            path: Default::default(),
            counts,
            dropped: self.replaced,
            buffer: Vec::new(),
        };
        let mut root = None;
        for level in 1..=top {
            let pages = std::mem::take(&mut self.levels[usize::from(level) - 1]);
            for (key, pending) in pages {
                let origin = morton_decode(key);
                let rebuilt = matches!(pending.below, Below::File);
                let page = merge.page(level, origin, pending)?;
                let state = if page.is_background() {
                    Slot::Background
                } else if let Some(bits) = page.uniform(&self.rules).filter(|_| level < top) {
                    Slot::Tile(bits)
                } else {
                    merge.tally(&page, true);
                    let head = Head {
                        key,
                        level,
                        ..Head::new(RecordKind::Page, generation, volume)
                    };
                    let mut record = vec![0; RECORD_HEADER];
                    record.extend(page.encode(&self.rules));
                    Slot::Child(append(&head, record)?)
                };
                if level == top {
                    root = Some((state, page.whole()));
                } else {
                    let above = morton_encode(page_origin(origin, level + 1));
                    let slot = slot_of(origin, level + 1);
                    let entry = Entry::new(slot, state, page.whole(), rebuilt);
                    self.levels[usize::from(level)]
                        .get_mut(&above)
                        .expect("made with its child")
                        .entries
                        .push(entry);
                }
            }
        }
        let (state, range) = root.expect("the root page is pending when anything is");
        let changes = Changes {
            root: match state {
                Slot::Child(reference) => reference,
                _ => Ref::default(),
            },
            range,
            counts: merge.counts,
            dropped: merge.dropped,
        };
        self.clear();
        Ok(changes)
    }
}

impl Entry {
    fn new(slot: usize, state: Slot, range: KeyRange, rebuilt: bool) -> Self {
        let (reference, holds) = match state {
            Slot::Background => (Ref::default(), Holds::Background),
            Slot::Tile(bits) => (
                Ref {
                    length: bits,
                    ..Ref::default()
                },
                Holds::Tile,
            ),
            Slot::Child(reference) => (reference, Holds::Child),
        };
        Self {
            reference,
            low: range.low,
            high: range.high,
            slot: slot as u16,
            has_nan: range.has_nan,
            holds,
            rebuilt,
        }
    }

    fn state(&self) -> Slot {
        match self.holds {
            Holds::Background => Slot::Background,
            Holds::Tile => Slot::Tile(self.reference.length),
            Holds::Child => Slot::Child(self.reference),
        }
    }

    fn range(&self) -> KeyRange {
        KeyRange {
            low: self.low,
            high: self.high,
            has_nan: self.has_nan,
        }
    }

    fn record_bytes(&self) -> u64 {
        match self.holds {
            Holds::Child => record_bytes(self.reference.length),
            _ => 0,
        }
    }
}

impl Pending {
    fn position(&self, slot: usize) -> Option<usize> {
        self.entries
            .iter()
            .position(|e| usize::from(e.slot) == slot)
    }

    /// Makes room for a pending page in `slot`: gives what is below it. `None` when the slot was put
    /// and may not be put again.
    fn open_slot(&mut self, slot: usize, rules: &PageRules, replace: bool) -> Option<Below> {
        if !has(&self.seen, slot) {
            set(&mut self.seen, slot);
            return Some(self.below);
        }
        if !replace {
            return None;
        }
        let tile = self.position(slot).map(|n| self.entries.swap_remove(n));
        Some(Below::Constant(
            tile.map_or(rules.background, |t| t.reference.length),
        ))
    }
}

/// What the last commit has at a page.
enum Old {
    Page(Rc<Page>, Ref),
    Constant(u32),
}

/// Pages of the last commit and what is pending over them, into new pages.
struct Merge<'a> {
    rules: PageRules,
    base: Base<'a>,
    /// The page of each level that was met last, so that neighbours need not go down from the root.
    path: [Option<(Rc<Page>, Ref)>; super::layout::MAX_PAGE_LEVEL as usize + 1],
    counts: Counts,
    dropped: u64,
    buffer: Vec<u8>,
}

impl Merge<'_> {
    fn page(&mut self, level: u8, origin: [u32; 3], mut pending: Pending) -> Result<Page> {
        let old = match pending.below {
            Below::Constant(bits) => Old::Constant(bits),
            Below::File => self.find(level, origin)?,
        };
        if let Old::Page(page, reference) = &old {
            self.tally(page, false);
            self.dropped += record_bytes(reference.length);
        }
        pending.entries.sort_unstable_by_key(|e| e.slot);
        let mut entries = pending.entries.iter().peekable();
        let mut slots = Vec::with_capacity(PAGE_SLOTS);
        let empty = KeyRange::empty(self.rules.sample);
        for slot in 0..PAGE_SLOTS {
            let at = slot_origin(origin, level, slot);
            if !self.rules.in_domain(at) {
                continue;
            }
            let (state, range) = if has(&pending.seen, slot) {
                let entry = entries.next_if(|e| usize::from(e.slot) == slot);
                if let Old::Page(page, _) = &old
                    && let Slot::Child(child) = page.slot(slot)
                    && !entry.is_some_and(|e| e.rebuilt)
                {
                    self.drop_child(level, at, child)?;
                }
                entry.map_or((Slot::Background, empty), |e| (e.state(), e.range()))
            } else {
                match &old {
                    Old::Page(page, _) => (page.slot(slot), page.range(slot)),
                    Old::Constant(bits) if *bits == self.rules.background => {
                        (Slot::Background, empty)
                    }
                    Old::Constant(bits) => (Slot::Tile(*bits), empty),
                }
            };
            if state != Slot::Background {
                slots.push((slot, state, range));
            }
        }
        Ok(Page::build(&self.rules, level, origin, slots.into_iter()))
    }

    fn load(&mut self, level: u8, origin: [u32; 3], reference: Ref) -> Result<Page> {
        let Base { file, volume, .. } = self.base;
        file.read_page(
            &self.rules,
            volume,
            level,
            origin,
            reference,
            &mut self.buffer,
        )
    }

    fn find(&mut self, level: u8, origin: [u32; 3]) -> Result<Old> {
        if self.base.root.is_none() {
            return Ok(Old::Constant(self.rules.background));
        }
        let mut here = self.base.root_level;
        let mut reference = self.base.root;
        loop {
            let at = page_origin(origin, here);
            let known = self.path[usize::from(here)]
                .as_ref()
                .filter(|(page, _)| page.origin == at)
                .cloned();
            let (page, reference_here) = match known {
                Some(known) => known,
                None => {
                    let page = Rc::new(self.load(here, at, reference)?);
                    self.path[usize::from(here)] = Some((page.clone(), reference));
                    (page, reference)
                }
            };
            if here == level {
                return Ok(Old::Page(page, reference_here));
            }
            match page.slot(slot_of(origin, here)) {
                Slot::Child(child) => (here, reference) = (here - 1, child),
                Slot::Tile(bits) => return Ok(Old::Constant(bits)),
                Slot::Background => return Ok(Old::Constant(self.rules.background)),
            }
        }
    }

    /// Accounts for a brick (level 1) or a page and all below it that is no longer reached from a
    /// page of `level`, which is itself accounted for.
    fn drop_child(&mut self, level: u8, at: [u32; 3], child: Ref) -> Result<()> {
        self.dropped += record_bytes(child.length);
        if level == 1 {
            return Ok(());
        }
        let page = self.load(level - 1, at, child)?;
        self.tally(&page, false);
        for (slot, state) in page.slots() {
            if let Slot::Child(below) = state {
                self.drop_child(level - 1, slot_origin(at, level - 1, slot), below)?;
            }
        }
        Ok(())
    }

    /// Counts a page in or out. The numbers of a hostile file may be anything.
    fn tally(&mut self, page: &Page, add: bool) {
        let mut one = Counts {
            pages: 1,
            ..Counts::default()
        };
        for (slot, state) in page.slots() {
            match state {
                Slot::Tile(_) => {
                    one.tiles += 1;
                    let at = slot_origin(page.origin, page.level, slot);
                    one.tile_bricks += self.rules.bricks_in(at, page_edge(page.level - 1));
                }
                Slot::Child(child) if page.level == 1 => {
                    one.bricks += 1;
                    one.stored += u64::from(child.length);
                }
                _ => {}
            }
        }
        let change = |count: &mut u64, by: u64| {
            *count = if add {
                count.wrapping_add(by)
            } else {
                count.wrapping_sub(by)
            };
        };
        let counts = &mut self.counts;
        change(&mut counts.pages, one.pages);
        change(&mut counts.tiles, one.tiles);
        change(&mut counts.tile_bricks, one.tile_bricks);
        change(&mut counts.bricks, one.bricks);
        change(&mut counts.stored, one.stored);
    }
}

fn twice(brick: [u32; 3]) -> Error {
    Error::bad_input(format!(
        "brick {brick:?} is written twice: each brick may be put once"
    ))
}

const _: () = assert!(PAGE_SLOTS <= u16::MAX as usize);
