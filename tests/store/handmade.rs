//! A small u8 volume written with [`Image`], piece by piece from `docs/format.md`, with a place to
//! interfere at each piece.
use super::image::{Image, Record, Ref, kind, put};

/// Samples per brick edge.
const EDGE: u32 = 8;

/// What a slot of a page holds.
#[derive(Clone, Copy)]
pub(crate) enum Slot {
    Child(Ref, [u8; 2]),
    Tile(u8),
}

pub(crate) fn morton(p: [u32; 3]) -> u64 {
    (0..21).fold(0, |code, bit| {
        (0..3).fold(code, |code, a| {
            code | u64::from(p[a] >> bit & 1) << (3 * bit + a as u32)
        })
    })
}

fn unmorton(code: usize) -> [u32; 3] {
    std::array::from_fn(|a| (0..3).fold(0, |v, bit| v | (code >> (3 * bit + a) & 1) << bit) as u32)
}

/// The payload of a page (section 8); the background is 0.
pub(crate) fn page(level: u8, bricks: [u32; 3], slots: &[(usize, Slot)]) -> Vec<u8> {
    page_at(level, [0; 3], bricks, slots)
}

fn page_at(level: u8, origin: [u32; 3], bricks: [u32; 3], slots: &[(usize, Slot)]) -> Vec<u8> {
    let mut out = vec![0; 216];
    out[0] = level;
    for a in 0..3 {
        put(&mut out, 8 + 4 * a, origin[a].to_le_bytes());
    }
    let edge = 1 << (3 * (level - 1));
    // No values: (largest, smallest).
    let mut ranges: Vec<[u8; 2]> = (0..512)
        .map(|slot| {
            let local = unmorton(slot);
            let inside = (0..3).all(|a| origin[a] + local[a] * edge < bricks[a]);
            if inside { [0, 0] } else { [255, 0] }
        })
        .collect();
    let (mut refs, mut tiles, mut ends) = (Vec::new(), Vec::new(), Vec::new());
    let value = |v: u8| u32::from(v).to_le_bytes();
    for &(slot, state) in slots {
        match state {
            Slot::Child(reference, range) => {
                out[24 + slot / 8] |= 1 << (slot % 8);
                refs.extend(reference.to_bytes());
                ends.extend([value(range[0]), value(range[1])].concat());
                ranges[slot] = range;
            }
            Slot::Tile(v) => {
                out[88 + slot / 8] |= 1 << (slot % 8);
                tiles.extend(value(v));
                ranges[slot] = [v, v];
            }
        }
    }
    let up = |below: &[[u8; 2]]| -> Vec<[u8; 2]> {
        let eight = below.as_chunks::<8>().0.iter();
        eight
            .map(|c| {
                c.iter()
                    .fold([255, 0], |u, r| [u[0].min(r[0]), u[1].max(r[1])])
            })
            .collect()
    };
    let d2 = up(&ranges);
    let d1 = up(&d2);
    for range in up(&d1).iter().chain(&d1).chain(&d2) {
        ends.extend([value(range[0]), value(range[1])].concat());
    }
    [out, refs, tiles, ends].concat()
}

/// One volume of a catalog.
#[derive(Clone, Default)]
pub(crate) struct Entry {
    pub(crate) attributes: Ref,
    pub(crate) history: Ref,
    pub(crate) root: Ref,
    pub(crate) level: u8,
    pub(crate) name: Vec<u8>,
}

/// The payload of a catalog (section 7).
pub(crate) fn catalog(entries: &[Entry]) -> Vec<u8> {
    let mut out = vec![0; 8];
    put(&mut out, 0, 1u16.to_le_bytes());
    put(&mut out, 2, (entries.len() as u16).to_le_bytes());
    for entry in entries {
        out.extend(entry.attributes.to_bytes());
        out.extend(entry.history.to_bytes());
        out.extend(entry.root.to_bytes());
        out.extend([entry.level, 0, 0, 0, 0, 0]);
        out.extend((entry.name.len() as u16).to_le_bytes());
        out.extend(&entry.name);
        out.resize(out.len().next_multiple_of(8), 0);
    }
    out
}

/// The piece of a file that is about to be written.
pub(crate) enum Piece<'a> {
    Brick([u32; 3], &'a mut Record),
    /// With the references of its children.
    Page(u8, &'a mut Record, &'a [Ref]),
    Attributes(&'a mut Record),
    History(&'a mut Record),
    Entry(&'a mut Entry),
    Catalog(&'a mut Record),
}

/// What the volume is: noise in all bricks but one tile and one of background.
#[derive(Clone, Copy)]
pub(crate) struct Plan {
    pub(crate) size: [u32; 3],
    pub(crate) seed: u32,
}

impl Plan {
    /// Twelve bricks in one page.
    pub(crate) const SMALL: Plan = Plan {
        size: [20, 12, 9],
        seed: 1,
    };
    /// Ten bricks along x in two pages under a root.
    pub(crate) const LONG: Plan = Plan {
        size: [76, 8, 8],
        seed: 1,
    };

    fn bricks(&self) -> [u32; 3] {
        self.size.map(|n| n.div_ceil(EDGE))
    }

    fn value(&self, p: [u32; 3]) -> u8 {
        match p.map(|v| v / EDGE) {
            [0, 0, 0] => 9,
            [1, 0, 0] => 0,
            _ => {
                let mix = p[0] * 31 + p[1] * 57 + p[2] * 91 + self.seed * 101;
                (mix.wrapping_mul(0x9e37_79b1) >> 24) as u8
            }
        }
    }

    /// Samples of the domain.
    pub(crate) fn samples(&self) -> Vec<u8> {
        let [nx, ny, nz] = self.size;
        (0..nx * ny * nz)
            .map(|n| self.value([n % nx, n / nx % ny, n / nx / ny]))
            .collect()
    }

    fn brick(&self, brick: [u32; 3]) -> Vec<u8> {
        let last = self.size.map(|n| n - 1);
        (0..EDGE.pow(3))
            .map(|n| {
                let at = [n % EDGE, n / EDGE % EDGE, n / EDGE / EDGE];
                self.value(std::array::from_fn(|a| {
                    (brick[a] * EDGE + at[a]).min(last[a])
                }))
            })
            .collect()
    }

    fn attributes(&self, counts: [u64; 5]) -> Vec<u8> {
        let mut out = vec![0; 208];
        put(&mut out, 0, 1u16.to_le_bytes());
        out[2] = 1; // u8
        out[3] = 1; // one channel
        out[7] = 3; // edge 8
        let samples = self.samples();
        out[16] = *samples.iter().min().expect("not empty");
        out[20] = *samples.iter().max().expect("not empty");
        for a in 0..3 {
            put(&mut out, 56 + 4 * a, self.size[a].to_le_bytes());
            put(&mut out, 72 + 8 * (5 * a), 1f64.to_le_bytes());
        }
        for (n, count) in counts.iter().enumerate() {
            put(&mut out, 168 + 8 * n, count.to_le_bytes());
        }
        out
    }

    /// Writes the volume as the next commit; `change` sees every piece before it is written.
    pub(crate) fn commit(&self, image: &mut Image, change: &dyn Fn(Piece<'_>)) {
        let bricks = self.bricks();
        let (mut children, mut refs) = (Vec::new(), Vec::new());
        let mut positions: Vec<[u32; 3]> = (0..bricks.iter().product())
            .map(|n| {
                let [x, y, _] = bricks;
                [n % x, n / x % y, n / x / y]
            })
            .collect();
        positions.sort_by_key(|&p| morton(p));
        let (mut stored, mut count) = (0, 0);
        for &brick in &positions {
            let samples = self.brick(brick);
            let ends = samples
                .iter()
                .fold([255, 0], |r: [u8; 2], &v| [r[0].min(v), r[1].max(v)]);
            match ends {
                [0, 0] => {}
                [low, high] if low == high => children.push((brick, Slot::Tile(low))),
                range => {
                    let mut record = Record::new(kind::BRICK, samples);
                    record.key = morton(brick);
                    record.decoded = 512;
                    change(Piece::Brick(brick, &mut record));
                    let reference = image.record(&record);
                    stored += u64::from(reference.length);
                    count += 1;
                    refs.push(reference);
                    children.push((brick, Slot::Child(reference, range)));
                }
            }
        }
        let levels = if bricks.iter().any(|&b| b > 8) { 2 } else { 1 };
        let (mut pages, mut root) = (0, Ref::default());
        for level in 1..=levels {
            let mut above: Vec<([u32; 3], Slot)> = Vec::new();
            let edge = 8u32.pow(u32::from(level));
            let mut origins: Vec<[u32; 3]> = children
                .iter()
                .map(|(b, _)| b.map(|v| v / edge * edge))
                .collect();
            origins.dedup();
            for origin in origins {
                let inner: Vec<_> = children
                    .iter()
                    .filter(|(b, _)| b.map(|v| v / edge * edge) == origin)
                    .map(|(b, slot)| (morton(b.map(|v| v / (edge / 8) % 8)) as usize, *slot))
                    .collect();
                let mut record = Record::new(kind::PAGE, page_at(level, origin, bricks, &inner));
                record.level = level;
                record.key = morton(origin);
                // The range of the whole page is the first of the last 73.
                let whole = record.payload.len() - 584;
                let range = [record.payload[whole], record.payload[whole + 4]];
                change(Piece::Page(level, &mut record, &refs));
                root = image.record(&record);
                pages += 1;
                above.push((origin, Slot::Child(root, range)));
            }
            refs = above
                .iter()
                .filter_map(|(_, s)| match s {
                    Slot::Child(r, _) => Some(*r),
                    Slot::Tile(_) => None,
                })
                .collect();
            children = above;
        }
        let mut history = Record::new(kind::HISTORY, vec![0; 12]);
        put(&mut history.payload, 0, 1u32.to_le_bytes());
        put(&mut history.payload, 4, 5u64.to_le_bytes());
        history.payload.extend(b"hands");
        change(Piece::History(&mut history));
        let history = image.record(&history);
        let counts = [count, 1, 1, pages, stored];
        let mut attributes = Record::new(kind::ATTRIBUTES, self.attributes(counts));
        change(Piece::Attributes(&mut attributes));
        let attributes = image.record(&attributes);
        let mut entry = Entry {
            attributes,
            history,
            root,
            level: levels,
            name: b"handmade".to_vec(),
        };
        change(Piece::Entry(&mut entry));
        let mut record = Record::new(kind::CATALOG, catalog(&[entry]));
        change(Piece::Catalog(&mut record));
        let reference = image.record(&record);
        image.commit(reference);
    }

    /// A file of one commit.
    pub(crate) fn file(&self, change: &dyn Fn(Piece<'_>)) -> Vec<u8> {
        let mut image = Image::new(*b"made by hand 016");
        self.commit(&mut image, change);
        image.bytes
    }
}

/// A file whose newest generation has other samples than the ones before.
pub(crate) fn generations(count: u32) -> (Vec<u8>, Vec<u8>) {
    let mut image = Image::new(*b"generations of h");
    let plan = |seed| Plan {
        size: [12, 12, 9],
        seed,
    };
    for seed in 1..=count {
        plan(seed).commit(&mut image, &|_| {});
    }
    (image.bytes, plan(count).samples())
}
