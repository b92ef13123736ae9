//! Volume files made by hand: an encoder of its own that knows `docs/format.md` and nothing of the
//! engine, and a repair of all checksums after a patch, so that hostile bytes get past them.

/// First byte of the log.
pub(crate) const LOG: usize = 12288;
pub(crate) const HEAD: usize = 40;
const SECTOR: usize = 4096;

const TABLE: [u32; 256] = table();

const fn table() -> [u32; 256] {
    let mut table = [0; 256];
    let mut n = 0;
    while n < 256 {
        let mut crc = n as u32;
        let mut bit = 0;
        while bit < 8 {
            crc = crc >> 1 ^ if crc & 1 != 0 { 0x82f6_3b78 } else { 0 };
            bit += 1;
        }
        table[n] = crc;
        n += 1;
    }
    table
}

/// CRC32C of `bytes` going on from the running value `crc`.
pub(crate) fn crc32c(crc: u32, bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!crc, |crc, byte| {
        crc >> 8 ^ TABLE[usize::from(crc as u8 ^ byte)]
    })
}

pub(crate) fn get<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    bytes[at..at + N].try_into().expect("N bytes")
}

pub(crate) fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes(get(bytes, at))
}

pub(crate) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(get(bytes, at))
}

pub(crate) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(get(bytes, at))
}

pub(crate) fn put<const N: usize>(bytes: &mut [u8], at: usize, value: [u8; N]) {
    bytes[at..at + N].copy_from_slice(&value);
}

/// Section 5 of the format.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Ref {
    pub(crate) offset: u64,
    pub(crate) length: u32,
    pub(crate) crc: u32,
}

impl Ref {
    pub(crate) fn to_bytes(self) -> [u8; 16] {
        let mut out = [0; 16];
        put(&mut out, 0, self.offset.to_le_bytes());
        put(&mut out, 8, self.length.to_le_bytes());
        put(&mut out, 12, self.crc.to_le_bytes());
        out
    }
}

/// Kinds of records.
pub(crate) mod kind {
    pub(crate) const HEADER: u8 = 1;
    pub(crate) const BRICK: u8 = 2;
    pub(crate) const PAGE: u8 = 3;
    pub(crate) const CATALOG: u8 = 4;
    pub(crate) const ATTRIBUTES: u8 = 5;
    pub(crate) const FOOTER: u8 = 6;
    pub(crate) const HISTORY: u8 = 7;
}

/// A record to be written; `decoded` 0 stands for the length of the payload.
#[derive(Clone, Debug, Default)]
pub(crate) struct Record {
    pub(crate) kind: u8,
    pub(crate) codec: u8,
    pub(crate) decoded: u32,
    pub(crate) key: u64,
    pub(crate) volume: u16,
    pub(crate) level: u8,
    pub(crate) payload: Vec<u8>,
}

impl Record {
    pub(crate) fn new(kind: u8, payload: Vec<u8>) -> Self {
        Self {
            kind,
            payload,
            ..Self::default()
        }
    }
}

/// A file while it is made: records, then commits.
#[derive(Clone, Debug)]
pub(crate) struct Image {
    pub(crate) bytes: Vec<u8>,
    seed: u32,
    generation: u64,
    start: usize,
    previous: u64,
    records: u64,
    chain: u32,
    superblock: Option<usize>,
}

impl Image {
    pub(crate) fn new(id: [u8; 16]) -> Self {
        let mut bytes = vec![0; LOG];
        put(&mut bytes, 0, *b"\x89SVOL\x0d\x0a\x1a");
        put(&mut bytes, 8, 1u16.to_le_bytes());
        put(&mut bytes, 12, 4096u32.to_le_bytes());
        put(&mut bytes, 40, id);
        let crc = crc32c(0, &bytes[..4092]);
        put(&mut bytes, 4092, crc.to_le_bytes());
        let seed = crc32c(0, &id);
        let mut image = Self {
            bytes,
            seed,
            generation: 1,
            start: LOG,
            previous: 0,
            records: 0,
            chain: seed,
            superblock: None,
        };
        image.superblock(0, LOG as u64, Ref::default(), [0; 3]);
        let header = image.bytes[..SECTOR].to_vec();
        image.record(&Record::new(kind::HEADER, header));
        image
    }

    /// Appends a record.
    pub(crate) fn record(&mut self, record: &Record) -> Ref {
        let offset = self.bytes.len();
        let length = record.payload.len() as u32;
        let decoded = if record.decoded == 0 {
            length
        } else {
            record.decoded
        };
        let mut head = [0; HEAD];
        put(&mut head, 0, *b"SVrc");
        head[4] = record.kind;
        head[5] = record.codec;
        let flags = u16::from(record.kind == kind::HISTORY);
        put(&mut head, 6, flags.to_le_bytes());
        put(&mut head, 8, length.to_le_bytes());
        put(&mut head, 12, decoded.to_le_bytes());
        put(&mut head, 16, self.generation.to_le_bytes());
        put(&mut head, 24, record.key.to_le_bytes());
        put(&mut head, 32, record.volume.to_le_bytes());
        head[34] = record.level;
        let mut payload = record.payload.clone();
        payload.resize(payload.len().next_multiple_of(8), 0);
        let crc = crc32c(crc32c(self.seed, &head[..36]), &payload);
        put(&mut head, 36, crc.to_le_bytes());
        self.bytes.extend_from_slice(&head);
        self.bytes.extend_from_slice(&payload);
        self.chain = crc32c(self.chain, &head);
        self.records += 1;
        Ref {
            offset: offset as u64,
            length,
            crc,
        }
    }

    /// Ends the commit with a footer and publishes it.
    pub(crate) fn commit(&mut self, catalog: Ref) {
        let live = (self.bytes.len() - LOG) as u64;
        let mut payload = vec![0; 72];
        put(&mut payload, 0, self.generation.to_le_bytes());
        put(&mut payload, 8, catalog.to_bytes());
        put(&mut payload, 24, (self.start as u64).to_le_bytes());
        put(&mut payload, 32, self.previous.to_le_bytes());
        put(&mut payload, 40, self.records.to_le_bytes());
        put(&mut payload, 48, live.to_le_bytes());
        put(&mut payload, 64, self.chain.to_le_bytes());
        let footer = self.record(&Record::new(kind::FOOTER, payload));
        let live = (self.bytes.len() - LOG) as u64;
        self.bytes
            .resize(self.bytes.len().next_multiple_of(SECTOR), 0);
        let end = self.bytes.len() as u64;
        self.superblock(self.generation, end, catalog, [footer.offset, live, 0]);
        self.generation += 1;
        self.start = self.bytes.len();
        self.previous = footer.offset;
        self.records = 0;
        self.chain = self.seed;
    }

    fn superblock(&mut self, generation: u64, end: u64, catalog: Ref, rest: [u64; 3]) {
        let at = superblock_of(generation);
        let block = &mut self.bytes[at..at + SECTOR];
        block.fill(0);
        put(block, 0, *b"SVOLROOT");
        put(block, 8, generation.to_le_bytes());
        put(block, 16, end.to_le_bytes());
        put(block, 24, catalog.to_bytes());
        for (n, value) in rest.iter().enumerate() {
            put(block, 40 + 8 * n, value.to_le_bytes());
        }
        let crc = crc32c(self.seed, &block[..4092]);
        put(block, 4092, crc.to_le_bytes());
        self.superblock = Some(at);
    }
}

/// Where the superblock of a generation stands.
pub(crate) fn superblock_of(generation: u64) -> usize {
    if generation % 2 == 1 { 4096 } else { 8192 }
}

/// A record of a file, as its header says.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Found {
    pub(crate) at: usize,
    pub(crate) kind: u8,
    pub(crate) codec: u8,
    pub(crate) level: u8,
    pub(crate) length: usize,
}

impl Found {
    /// Offset of the payload.
    pub(crate) fn payload(&self) -> usize {
        self.at + HEAD
    }

    /// First byte after the padding.
    pub(crate) fn end(&self) -> usize {
        (self.payload() + self.length).next_multiple_of(8)
    }
}

/// The records of the log, in file order, as far as their headers go.
pub(crate) fn records(bytes: &[u8]) -> Vec<Found> {
    let (mut out, mut at) = (Vec::new(), LOG);
    while at + HEAD <= bytes.len() {
        if bytes[at..at + 4] != *b"SVrc" {
            // Zeros up to the next commit.
            at = (at + 1).next_multiple_of(SECTOR);
            continue;
        }
        let found = Found {
            at,
            kind: bytes[at + 4],
            codec: bytes[at + 5],
            level: bytes[at + 34],
            length: u32_at(bytes, at + 8) as usize,
        };
        if found.end() > bytes.len() {
            break;
        }
        at = found.end();
        out.push(found);
    }
    out
}

/// The records of one kind.
pub(crate) fn of_kind(bytes: &[u8], kind: u8) -> Vec<Found> {
    records(bytes)
        .into_iter()
        .filter(|r| r.kind == kind)
        .collect()
}

/// Makes every checksum right again: header, records from front to back with the references to them
/// (children stand before parents), chains of the footers, superblocks. Whatever else is wrong stays.
pub(crate) fn reseal(bytes: &mut [u8]) {
    if bytes.len() < LOG {
        return;
    }
    let crc = crc32c(0, &bytes[..4092]);
    put(bytes, 4092, crc.to_le_bytes());
    let seed = crc32c(0, &get::<16>(bytes, 40));
    let (mut crcs, mut chain) = (std::collections::BTreeMap::new(), seed);
    for record in records(bytes) {
        let payload = record.payload();
        for reference in refs_in(bytes, &record) {
            fix(bytes, reference, &crcs);
        }
        match record.kind {
            kind::HEADER if record.length == SECTOR => {
                let crc = crc32c(0, &bytes[payload..payload + 4092]);
                put(bytes, payload + 4092, crc.to_le_bytes());
            }
            kind::FOOTER if record.length == 72 => {
                put(bytes, payload + 64, chain.to_le_bytes());
            }
            _ => {}
        }
        let head = crc32c(seed, &bytes[record.at..record.at + 36]);
        let crc = crc32c(head, &bytes[payload..record.end()]);
        put(bytes, record.at + 36, crc.to_le_bytes());
        crcs.insert(record.at as u64, crc);
        chain = if record.kind == kind::FOOTER {
            seed
        } else {
            crc32c(chain, &bytes[record.at..record.at + HEAD])
        };
    }
    for at in [4096, 8192] {
        if bytes[at..at + 8] == *b"SVOLROOT" {
            fix(bytes, at + 24, &crcs);
            let crc = crc32c(seed, &bytes[at..at + 4092]);
            put(bytes, at + 4092, crc.to_le_bytes());
        }
    }
}

/// Offsets of the references in the payload of a record.
fn refs_in(bytes: &[u8], record: &Found) -> Vec<usize> {
    let (payload, end) = (record.payload(), record.payload() + record.length);
    match record.kind {
        kind::PAGE if record.length >= 216 => {
            let mask = &bytes[payload + 24..payload + 88];
            let children: u32 = mask.iter().map(|b| b.count_ones()).sum();
            let refs = (0..children as usize).map(|n| payload + 216 + 16 * n);
            refs.filter(|at| at + 16 <= end).collect()
        }
        kind::CATALOG => {
            let (mut out, mut at) = (Vec::new(), payload + 8);
            while at + 56 <= end {
                out.extend([at, at + 16, at + 32]);
                at += 56 + usize::from(u16_at(bytes, at + 54)).next_multiple_of(8);
            }
            out
        }
        kind::FOOTER if record.length == 72 => vec![payload + 8],
        _ => Vec::new(),
    }
}

/// Which bytes of a sound file the newest root reaches, where levels of detail count only when they
/// were built from the samples that are there.
pub(crate) fn reached(bytes: &[u8]) -> Vec<bool> {
    let mut reached = vec![false; bytes.len()];
    let all: std::collections::BTreeMap<_, _> =
        records(bytes).into_iter().map(|r| (r.at, r)).collect();
    let newest = if u64_at(bytes, 4096 + 8) > u64_at(bytes, 8192 + 8) {
        4096
    } else {
        8192
    };
    let catalog = all[&(u64_at(bytes, newest + 24) as usize)];
    let mut todo = vec![catalog];
    while let Some(record) = todo.pop() {
        reached[record.at..record.end()].fill(true);
        for (n, at) in refs_in(bytes, &record).into_iter().enumerate() {
            let stale = record.kind == kind::CATALOG && n % 3 == 2 && is_stale(bytes, &record, at);
            let offset = u64_at(bytes, at) as usize;
            if offset != 0 && !stale {
                todo.push(all[&offset]);
            }
        }
    }
    reached
}

/// Whether the catalog entry with its root reference at `root` is a level of other samples.
fn is_stale(bytes: &[u8], catalog: &Found, root: usize) -> bool {
    let entry = root - 32;
    if bytes[entry + 49] == 0 {
        return false;
    }
    let parent = usize::from(u16_at(bytes, entry + 50));
    let parent_root = refs_in(bytes, catalog)[3 * parent + 2];
    let attributes = u64_at(bytes, entry) as usize + HEAD;
    u32_at(bytes, attributes + 68) != u32_at(bytes, parent_root + 12)
}

fn fix(bytes: &mut [u8], at: usize, crcs: &std::collections::BTreeMap<u64, u32>) {
    if let Some(crc) = crcs.get(&u64_at(bytes, at)) {
        put(bytes, at + 12, crc.to_le_bytes());
    }
}
