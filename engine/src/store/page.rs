//! A node page: three octree levels in one record, 8 x 8 x 8 slots in Morton order.
//!
//! In memory every slot and every inner node has its range, so that a search by range looks the same
//! at all levels; nodes outside of the domain have the empty range.

use super::layout::*;
use super::record::Ref;
use super::spec::page_edge;
use super::value::{KeyRange, bits_of_key, is_nan, is_valid, key_of};
use crate::lattice::{morton_decode, morton_encode};
use crate::sample::SampleType;

/// Slots, then 64 and 8 inner nodes, then the root.
pub(crate) const NODES: usize = PAGE_SLOTS + PAGE_INNER;
/// Index of the first node of each depth: slots, 64, 8, 1.
pub(crate) const FIRST_NODE: [usize; 4] = [0, PAGE_SLOTS, PAGE_SLOTS + 64, PAGE_SLOTS + 64 + 8];

/// One bit per slot.
pub(crate) type Mask = [u64; PAGE_SLOTS / 64];

#[inline]
pub(crate) fn has(mask: &Mask, slot: usize) -> bool {
    mask[slot / 64] >> (slot % 64) & 1 != 0
}

#[inline]
pub(crate) fn set(mask: &mut Mask, slot: usize) {
    mask[slot / 64] |= 1 << (slot % 64);
}

fn count(mask: &Mask) -> usize {
    mask.iter().map(|w| w.count_ones() as usize).sum()
}

/// Set bits before `slot`.
fn rank(mask: &Mask, slot: usize) -> usize {
    let whole: u32 = mask[..slot / 64].iter().map(|w| w.count_ones()).sum();
    let part = mask[slot / 64] & ((1u64 << (slot % 64)) - 1);
    (whole + part.count_ones()) as usize
}

/// What the volume says about every page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PageRules {
    pub(crate) sample: SampleType,
    /// Bits of the background.
    pub(crate) background: u32,
    /// Bricks per axis.
    pub(crate) bricks: [u32; 3],
    /// Bytes of a decoded brick.
    pub(crate) brick_bytes: u32,
}

/// Smallest brick of a slot of a page.
pub(crate) fn slot_origin(origin: [u32; 3], level: u8, slot: usize) -> [u32; 3] {
    let local = morton_decode(slot as u64);
    std::array::from_fn(|a| origin[a] + local[a] * page_edge(level - 1))
}

/// The slot of a page of `level` that holds `brick`.
#[inline]
pub(crate) fn slot_of(brick: [u32; 3], level: u8) -> usize {
    let shift = PAGE_LEVELS * (u32::from(level) - 1);
    morton_encode(brick.map(|b| b >> shift & (PAGE_EDGE - 1))) as usize
}

/// The smallest brick of the page of `level` that holds `brick`.
#[inline]
pub(crate) fn page_origin(brick: [u32; 3], level: u8) -> [u32; 3] {
    brick.map(|b| b & !(page_edge(level) - 1))
}

impl PageRules {
    pub(crate) fn in_domain(&self, brick: [u32; 3]) -> bool {
        (0..3).all(|a| brick[a] < self.bricks[a])
    }

    /// Bricks of the domain in a cube of `edge` bricks.
    pub(crate) fn bricks_in(&self, brick: [u32; 3], edge: u32) -> u64 {
        (0..3)
            .map(|a| u64::from(self.bricks[a].saturating_sub(brick[a]).min(edge)))
            .product()
    }
}

/// What a slot holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Slot {
    Background,
    /// Bits of the constant.
    Tile(u32),
    Child(Ref),
}

/// A decoded page.
#[derive(Debug)]
pub(crate) struct Page {
    pub(crate) level: u8,
    pub(crate) origin: [u32; 3],
    child: Mask,
    tile: Mask,
    refs: Vec<Ref>,
    tiles: Vec<u32>,
    low: Box<[u32; NODES]>,
    high: Box<[u32; NODES]>,
    nan: [u64; NODES.div_ceil(64)],
}

impl Page {
    /// Makes a page out of its slots.
    pub(crate) fn build(
        rules: &PageRules,
        level: u8,
        origin: [u32; 3],
        slots: impl Iterator<Item = (usize, Slot, KeyRange)>,
    ) -> Page {
        let mut page = Page::blank(rules, level, origin);
        for (slot, state, range) in slots {
            page.put_slot(rules, slot, state, range);
        }
        page.fill_inner(rules);
        page
    }

    /// All background; `put_slot` in ascending order follows, then `fill_inner`.
    fn blank(rules: &PageRules, level: u8, origin: [u32; 3]) -> Page {
        let empty = KeyRange::empty(rules.sample);
        let mut page = Page {
            level,
            origin,
            child: [0; 8],
            tile: [0; 8],
            refs: Vec::new(),
            tiles: Vec::new(),
            low: Box::new([empty.low; NODES]),
            high: Box::new([empty.high; NODES]),
            nan: [0; NODES.div_ceil(64)],
        };
        let background = KeyRange::of_bits(rules.sample, rules.background);
        for slot in 0..PAGE_SLOTS {
            if rules.in_domain(slot_origin(origin, level, slot)) {
                page.set_range(slot, background);
            }
        }
        page
    }

    fn put_slot(&mut self, rules: &PageRules, slot: usize, state: Slot, range: KeyRange) {
        match state {
            Slot::Background => {}
            Slot::Tile(bits) => {
                set(&mut self.tile, slot);
                self.tiles.push(bits);
                self.set_range(slot, KeyRange::of_bits(rules.sample, bits));
            }
            Slot::Child(reference) => {
                set(&mut self.child, slot);
                self.refs.push(reference);
                self.set_range(slot, range);
            }
        }
    }

    fn set_range(&mut self, node: usize, range: KeyRange) {
        self.low[node] = range.low;
        self.high[node] = range.high;
        let bit = 1 << (node % 64);
        self.nan[node / 64] = self.nan[node / 64] & !bit | if range.has_nan { bit } else { 0 };
    }

    fn fill_inner(&mut self, rules: &PageRules) {
        for depth in 1..FIRST_NODE.len() {
            let (below, here) = (FIRST_NODE[depth - 1], FIRST_NODE[depth]);
            for n in 0..(here - below) / 8 {
                let union = (0..8).fold(KeyRange::empty(rules.sample), |range, c| {
                    range.union(self.range(below + 8 * n + c))
                });
                self.set_range(here + n, union);
            }
        }
    }

    /// Range of a node; see [`FIRST_NODE`].
    #[inline]
    pub(crate) fn range(&self, node: usize) -> KeyRange {
        KeyRange {
            low: self.low[node],
            high: self.high[node],
            has_nan: self.nan[node / 64] >> (node % 64) & 1 != 0,
        }
    }

    /// Range of the whole page.
    pub(crate) fn whole(&self) -> KeyRange {
        self.range(NODES - 1)
    }

    /// What a slot holds.
    pub(crate) fn slot(&self, slot: usize) -> Slot {
        if has(&self.child, slot) {
            Slot::Child(self.refs[rank(&self.child, slot)])
        } else if has(&self.tile, slot) {
            Slot::Tile(self.tiles[rank(&self.tile, slot)])
        } else {
            Slot::Background
        }
    }

    /// Slots of children and tiles, in order.
    pub(crate) fn slots(&self) -> impl Iterator<Item = (usize, Slot)> + '_ {
        (0..PAGE_SLOTS)
            .filter(|&s| has(&self.child, s) || has(&self.tile, s))
            .map(|s| (s, self.slot(s)))
    }

    /// Whether no slot holds anything.
    pub(crate) fn is_background(&self) -> bool {
        self.refs.is_empty() && self.tiles.is_empty()
    }

    /// The constant that every brick of the domain in this page has, when tiles cover it all.
    pub(crate) fn uniform(&self, rules: &PageRules) -> Option<u32> {
        let first = *self.tiles.first()?;
        if !self.refs.is_empty() || self.tiles.iter().any(|&t| t != first) {
            return None;
        }
        let inside = |s: usize| rules.in_domain(slot_origin(self.origin, self.level, s));
        (0..PAGE_SLOTS)
            .all(|s| has(&self.tile, s) || !inside(s))
            .then_some(first)
    }

    /// The payload of the page.
    pub(crate) fn encode(&self, rules: &PageRules) -> Vec<u8> {
        let mut out = vec![0; PAGE_BODY];
        out[PAGE_LEVEL] = self.level;
        for a in 0..3 {
            put_u32(&mut out, PAGE_ORIGIN + 4 * a, self.origin[a]);
        }
        put_mask(&mut out, PAGE_CHILD_MASK, &self.child);
        put_mask(&mut out, PAGE_TILE_MASK, &self.tile);
        let mut nan = [0; 8];
        for (slot, _) in self.slots().filter(|&(s, _)| self.range(s).has_nan) {
            set(&mut nan, slot);
        }
        put_mask(&mut out, PAGE_NAN_MASK, &nan);
        for reference in &self.refs {
            let at = out.len();
            out.resize(at + REF_BYTES, 0);
            reference.put(&mut out, at);
        }
        self.tiles
            .iter()
            .for_each(|tile| out.extend(tile.to_le_bytes()));
        let children = (0..PAGE_SLOTS).filter(|&s| has(&self.child, s));
        for node in children.chain(inner_top_down()) {
            let range = self.range(node);
            out.extend(bits_of_key(rules.sample, range.low).to_le_bytes());
            out.extend(bits_of_key(rules.sample, range.high).to_le_bytes());
        }
        out
    }

    /// Parses the payload of the page at `offset` of the file that must be of `level` with `origin`.
    ///
    /// # Errors
    /// The structural rule that does not hold, as a phrase.
    pub(crate) fn decode(
        rules: &PageRules,
        level: u8,
        origin: [u32; 3],
        offset: u64,
        bytes: &[u8],
    ) -> Result<Page, String> {
        if bytes.len() < PAGE_BODY || bytes.len() > PAGE_BYTES_MAX {
            return Err(format!("a page of {} bytes", bytes.len()));
        }
        let said: [u32; 3] = std::array::from_fn(|a| get_u32(bytes, PAGE_ORIGIN + 4 * a));
        if bytes[PAGE_LEVEL] != level || said != origin {
            return Err(format!(
                "a page of level {} at {said:?} in the place of level {level} at {origin:?}",
                bytes[PAGE_LEVEL]
            ));
        }
        let child = get_mask(bytes, PAGE_CHILD_MASK);
        let tile = get_mask(bytes, PAGE_TILE_MASK);
        let nan = get_mask(bytes, PAGE_NAN_MASK);
        let (children, tiles) = (count(&child), count(&tile));
        if bytes.len() != page_bytes(children, tiles) {
            return Err(format!(
                "{} bytes for {children} children and {tiles} tiles",
                bytes.len()
            ));
        }
        let refs_at = PAGE_BODY;
        let tiles_at = refs_at + children * REF_BYTES;
        let ranges_at = tiles_at + tiles * VALUE_BYTES;
        let inner_at = ranges_at + children * 2 * VALUE_BYTES;
        let range_at = |at: usize, has_nan: bool| -> Result<KeyRange, String> {
            let (low, high) = (get_u32(bytes, at), get_u32(bytes, at + VALUE_BYTES));
            let fits = |bits| is_valid(rules.sample, bits) && !is_nan(rules.sample, bits);
            if !fits(low) || !fits(high) {
                return Err("a range is not of the sample type".into());
            }
            Ok(KeyRange {
                low: key_of(rules.sample, low),
                high: key_of(rules.sample, high),
                has_nan,
            })
        };
        let mut page = Page::blank(rules, level, origin);
        page.refs.reserve_exact(children);
        page.tiles.reserve_exact(tiles);
        for slot in 0..PAGE_SLOTS {
            let (is_child, is_tile, is_nan_slot) =
                (has(&child, slot), has(&tile, slot), has(&nan, slot));
            if !is_child && !is_tile {
                if is_nan_slot {
                    return Err(format!("slot {slot} is absent and says NaN"));
                }
                continue;
            }
            if is_child && is_tile {
                return Err(format!("slot {slot} is both child and tile"));
            }
            if !rules.in_domain(slot_origin(origin, level, slot)) {
                return Err(format!("slot {slot} lies outside of the domain"));
            }
            if is_tile {
                let bits = get_u32(bytes, tiles_at + page.tiles.len() * VALUE_BYTES);
                if !is_valid(rules.sample, bits) || is_nan_slot != is_nan(rules.sample, bits) {
                    return Err(format!(
                        "the tile in slot {slot} is no sample or says NaN wrongly"
                    ));
                }
                page.put_slot(rules, slot, Slot::Tile(bits), KeyRange::empty(rules.sample));
                continue;
            }
            let n = page.refs.len();
            let reference = Ref::get(bytes, refs_at + n * REF_BYTES);
            check_child(rules, level, &reference, offset)
                .map_err(|e| format!("slot {slot}: {e}"))?;
            let range = range_at(ranges_at + n * 2 * VALUE_BYTES, is_nan_slot)?;
            if range.is_empty() && !is_nan_slot {
                return Err(format!("the range of slot {slot} is empty"));
            }
            page.put_slot(rules, slot, Slot::Child(reference), range);
        }
        page.fill_inner(rules);
        for (n, node) in inner_top_down().enumerate() {
            let said = range_at(inner_at + n * 2 * VALUE_BYTES, page.range(node).has_nan)?;
            if said != page.range(node) {
                return Err(format!(
                    "the range of inner node {n} is not that of its slots"
                ));
            }
        }
        Ok(page)
    }
}

/// A child lies before its parent, inside the log, and is not longer than it may be.
fn check_child(rules: &PageRules, level: u8, child: &Ref, parent: u64) -> Result<(), String> {
    let longest = if level == 1 {
        rules.brick_bytes
    } else {
        PAGE_BYTES_MAX as u32
    };
    if child.length > longest {
        return Err(format!(
            "a child of {} bytes where {longest} are the most",
            child.length
        ));
    }
    let end = child.offset.checked_add(record_bytes(child.length));
    if child.offset < LOG_START
        || !child.offset.is_multiple_of(RECORD_ALIGN as u64)
        || end.is_none_or(|e| e > parent)
    {
        return Err(format!(
            "a child at offset {} of a page at {parent}",
            child.offset
        ));
    }
    Ok(())
}

/// Inner nodes in the order of the file: root, 8, 64.
fn inner_top_down() -> impl Iterator<Item = usize> {
    (1..FIRST_NODE.len()).rev().flat_map(|depth| {
        let end = FIRST_NODE.get(depth + 1).copied().unwrap_or(NODES);
        FIRST_NODE[depth]..end
    })
}

fn put_mask(out: &mut [u8], at: usize, mask: &Mask) {
    for (n, word) in mask.iter().enumerate() {
        put_u64(out, at + 8 * n, *word);
    }
}

fn get_mask(bytes: &[u8], at: usize) -> Mask {
    std::array::from_fn(|n| get_u64(bytes, at + 8 * n))
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: PageRules = PageRules {
        sample: SampleType::I16,
        background: 7,
        bricks: [8, 6, 8],
        brick_bytes: 8192,
    };
    const AT: u64 = 1 << 20;

    fn page() -> Page {
        let range = |low: i16, high: i16| KeyRange {
            low: key_of(SampleType::I16, low as u16 as u32),
            high: key_of(SampleType::I16, high as u16 as u32),
            has_nan: false,
        };
        let child = |n: u64| {
            Slot::Child(Ref {
                offset: LOG_START + 64 * n,
                length: 10,
                crc: n as u32,
            })
        };
        let none = KeyRange::empty(SampleType::I16);
        let slots = [
            (0, child(0), range(-5, 9)),
            (9, Slot::Tile(0xfffe), none),
            (100, child(2), range(1, 300)),
        ];
        Page::build(&RULES, 1, [0, 0, 0], slots.into_iter())
    }

    fn decode(bytes: &[u8]) -> Result<Page, String> {
        Page::decode(&RULES, 1, [0, 0, 0], AT, bytes)
    }

    #[test]
    fn page_round_trip() {
        let page = page();
        let back = decode(&page.encode(&RULES)).expect("decodes");
        for slot in 0..PAGE_SLOTS {
            assert_eq!(back.slot(slot), page.slot(slot));
        }
        for node in 0..NODES {
            assert_eq!(back.range(node), page.range(node), "{node}");
        }
        let whole = back.whole().to_range(SampleType::I16);
        assert_eq!((whole.min, whole.max), (-5.0, 300.0));
        let outside = morton_encode([0, 6, 0]) as usize;
        assert!(back.range(outside).is_empty() && !back.range(1).is_empty());
    }

    #[test]
    fn page_empty_is_background() {
        let page = Page::build(&RULES, 1, [0; 3], std::iter::empty());
        let back = decode(&page.encode(&RULES)).expect("decodes");
        assert_eq!(back.whole(), KeyRange::of_bits(SampleType::I16, 7));
        assert_eq!(back.slots().count(), 0);
    }

    #[test]
    fn page_every_truncation_and_extra_bytes() {
        let bytes = page().encode(&RULES);
        for end in 0..bytes.len() {
            assert!(decode(&bytes[..end]).is_err(), "{end}");
        }
        assert!(decode(&[&bytes[..], &[0; 8]].concat()).is_err());
    }

    #[test]
    fn page_every_bit_flip_is_bounded() {
        let bytes = page().encode(&RULES);
        for bit in 0..bytes.len() * 8 {
            let mut bad = bytes.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            if let Ok(page) = decode(&bad) {
                assert!(page.refs.len() + page.tiles.len() <= PAGE_SLOTS);
            }
        }
    }

    #[test]
    fn page_refuses_broken_rules() {
        let good = page().encode(&RULES);
        let refused = |change: &dyn Fn(&mut Vec<u8>)| {
            let mut bytes = good.clone();
            change(&mut bytes);
            decode(&bytes).expect_err("refused")
        };
        let at_level = Page::decode(&RULES, 2, [0; 3], AT, &good).expect_err("wrong level");
        assert!(at_level.contains("level"), "{at_level}");
        assert!(
            Page::decode(&RULES, 1, [8, 0, 0], AT, &good).is_err(),
            "wrong key"
        );
        assert!(
            Page::decode(&RULES, 1, [0; 3], LOG_START + 100, &good).is_err(),
            "child after parent"
        );
        assert!(refused(&|b| put_u64(b, PAGE_BODY, u64::MAX - 7)).contains("offset"));
        assert!(refused(&|b| put_u64(b, PAGE_BODY, 0)).contains("offset"));
        assert!(refused(&|b| put_u32(b, PAGE_BODY + REF_LENGTH, 8193)).contains("8193"));
        assert!(refused(&|b| b[PAGE_TILE_MASK] |= 1).contains("children"));
        let both = refused(&|b| {
            b[PAGE_TILE_MASK] |= 1;
            b[PAGE_TILE_MASK + 1] &= !2;
        });
        assert!(both.contains("both"), "{both}");
        let inner = good.len() - 8;
        assert!(refused(&|b| b[inner] ^= 1).contains("inner node"));
        assert!(refused(&|b| b[PAGE_NAN_MASK + 60] |= 1).contains("NaN"));
    }

    #[test]
    fn slots_and_origins_agree() {
        for level in 1..=MAX_PAGE_LEVEL {
            let brick = [5u32, 123_456, 2_000_000].map(|b| b & (page_edge(level) - 1));
            let slot = slot_of(brick, level);
            assert_eq!(
                slot_origin(page_origin(brick, level), level, slot),
                page_origin(brick, level - 1)
            );
        }
    }
}
