//! The frame around every block of bytes in the file: header, checksum, reference; and the two
//! fixed blocks at the start, file header and superblock.

use super::layout::*;
use crate::error::{Error, ErrorKind, Result};

/// What a record holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RecordKind {
    Header = 1,
    Brick = 2,
    Page = 3,
    Catalog = 4,
    Attributes = 5,
    Footer = 6,
    History = 7,
}

impl RecordKind {
    pub(crate) fn name(self) -> &'static str {
        match self {
            RecordKind::Header => "header copy",
            RecordKind::Brick => "brick",
            RecordKind::Page => "node page",
            RecordKind::Catalog => "catalog",
            RecordKind::Attributes => "attributes",
            RecordKind::Footer => "footer",
            RecordKind::History => "history",
        }
    }
}

/// Where a record is and what checksum it must have; all zero: nowhere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Ref {
    pub(crate) offset: u64,
    pub(crate) length: u32,
    pub(crate) crc: u32,
}

impl Ref {
    pub(crate) fn is_none(&self) -> bool {
        *self == Ref::default()
    }

    pub(crate) fn put(&self, bytes: &mut [u8], at: usize) {
        put_u64(bytes, at + REF_OFFSET, self.offset);
        put_u32(bytes, at + REF_LENGTH, self.length);
        put_u32(bytes, at + REF_CRC, self.crc);
    }

    pub(crate) fn get(bytes: &[u8], at: usize) -> Ref {
        Ref {
            offset: get_u64(bytes, at + REF_OFFSET),
            length: get_u32(bytes, at + REF_LENGTH),
            crc: get_u32(bytes, at + REF_CRC),
        }
    }
}

/// The fields of a record header except lengths and checksum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Head {
    pub(crate) kind: u8,
    pub(crate) codec: u8,
    pub(crate) flags: u16,
    pub(crate) decoded: u32,
    pub(crate) generation: u64,
    pub(crate) key: u64,
    /// Number of the volume in the catalog.
    pub(crate) volume: u16,
    pub(crate) level: u8,
}

impl Head {
    pub(crate) fn new(kind: RecordKind, generation: u64, volume: u16) -> Self {
        let flags = if kind == RecordKind::History {
            FLAG_SKIPPABLE
        } else {
            0
        };
        Self {
            kind: kind as u8,
            codec: 0,
            flags,
            decoded: 0,
            generation,
            key: 0,
            volume,
            level: 0,
        }
    }
}

/// Seed of the checksums of a file, so that records of another file never pass.
pub(crate) fn seed_of(file_id: &[u8; FILE_ID_BYTES]) -> u32 {
    crc32c::crc32c(file_id)
}

/// Completes the record that starts at `start` of `buffer` with [`RECORD_HEADER`] spare bytes and
/// goes on with its payload to the end: pads it and fills in the header.
/// Gives a reference whose offset is relative to the buffer.
pub(crate) fn seal(buffer: &mut Vec<u8>, start: usize, head: &Head, seed: u32) -> Ref {
    let payload = buffer.len() - start - RECORD_HEADER;
    buffer.resize(start + record_bytes(payload as u32) as usize, 0);
    let record = &mut buffer[start..];
    put_u32(record, RECORD_MAGIC_AT, RECORD_MAGIC);
    record[RECORD_KIND] = head.kind;
    record[RECORD_CODEC] = head.codec;
    put_u16(record, RECORD_FLAGS, head.flags);
    put_u32(record, RECORD_PAYLOAD, payload as u32);
    put_u32(
        record,
        RECORD_DECODED,
        if head.decoded == 0 {
            payload as u32
        } else {
            head.decoded
        },
    );
    put_u64(record, RECORD_GENERATION, head.generation);
    put_u64(record, RECORD_KEY, head.key);
    put_u16(record, RECORD_VOLUME, head.volume);
    record[RECORD_LEVEL] = head.level;
    record[RECORD_RESERVED] = 0;
    let crc = crc_of(record, seed);
    put_u32(record, RECORD_CRC, crc);
    Ref {
        offset: start as u64,
        length: payload as u32,
        crc,
    }
}

fn crc_of(record: &[u8], seed: u32) -> u32 {
    let head = crc32c::crc32c_append(seed, &record[..RECORD_CRC]);
    crc32c::crc32c_append(head, &record[RECORD_HEADER..])
}

/// Reads the header at the start of `record`; `None` without the magic.
/// Gives the head, the payload length and the checksum. Nothing is verified yet.
pub(crate) fn parse_head(record: &[u8]) -> Option<(Head, u32, u32)> {
    if record.len() < RECORD_HEADER || get_u32(record, RECORD_MAGIC_AT) != RECORD_MAGIC {
        return None;
    }
    let head = Head {
        kind: record[RECORD_KIND],
        codec: record[RECORD_CODEC],
        flags: get_u16(record, RECORD_FLAGS),
        decoded: get_u32(record, RECORD_DECODED),
        generation: get_u64(record, RECORD_GENERATION),
        key: get_u64(record, RECORD_KEY),
        volume: get_u16(record, RECORD_VOLUME),
        level: record[RECORD_LEVEL],
    };
    Some((
        head,
        get_u32(record, RECORD_PAYLOAD),
        get_u32(record, RECORD_CRC),
    ))
}

/// Checks a whole padded record and gives its head and payload.
///
/// # Errors
/// What disagrees, as a phrase.
pub(crate) fn open(record: &[u8], seed: u32) -> Result<(Head, &[u8]), String> {
    let (head, payload, stored) = parse_head(record).ok_or("no record starts here")?;
    if record.len() as u64 != record_bytes(payload) {
        return Err(format!(
            "the record says {payload} bytes of payload, its place has {}",
            record.len()
        ));
    }
    let found = crc_of(record, seed);
    if found != stored {
        return Err(format!(
            "checksum {found:08x}, the record says {stored:08x}"
        ));
    }
    if record[RECORD_RESERVED] != 0 {
        return Err("a reserved byte of the record is not zero".into());
    }
    Ok((
        head,
        &record[RECORD_HEADER..RECORD_HEADER + payload as usize],
    ))
}

/// The start of a file with this id and these features.
pub(crate) fn header_block(file_id: &[u8; FILE_ID_BYTES], incompat: u64) -> Vec<u8> {
    let mut block = vec![0; SECTOR];
    block[HEADER_MAGIC..HEADER_MAGIC + MAGIC.len()].copy_from_slice(&MAGIC);
    put_u16(&mut block, HEADER_MAJOR, MAJOR);
    put_u16(&mut block, HEADER_MINOR, MINOR);
    put_u32(&mut block, HEADER_LENGTH, SECTOR as u32);
    put_u64(&mut block, HEADER_INCOMPAT, incompat);
    block[HEADER_FILE_ID..HEADER_FILE_ID + FILE_ID_BYTES].copy_from_slice(file_id);
    let crc = crc32c::crc32c(&block[..HEADER_CRC]);
    put_u32(&mut block, HEADER_CRC, crc);
    block
}

/// The file id of a header block, after its checks.
///
/// # Errors
/// `NotAVolume`, `Damaged`, or `Newer` naming the feature bit.
pub(crate) fn parse_header(block: &[u8]) -> Result<[u8; FILE_ID_BYTES]> {
    if block.len() < SECTOR || block[..MAGIC.len()] != MAGIC {
        return Err(Error::new(
            ErrorKind::NotAVolume,
            "not a brickmarch volume: the first bytes differ; make one of it with brickmarch import",
        ));
    }
    if crc32c::crc32c(&block[..HEADER_CRC]) != get_u32(block, HEADER_CRC) {
        return Err(Error::new(
            ErrorKind::Damaged,
            "the file header is damaged (checksum)",
        ));
    }
    let major = get_u16(block, HEADER_MAJOR);
    if major != MAJOR {
        return Err(Error::new(
            ErrorKind::Newer,
            format!("format version {major}; this program reads version {MAJOR}: use a later one"),
        ));
    }
    let unknown = get_u64(block, HEADER_INCOMPAT) & !KNOWN_INCOMPAT;
    if unknown != 0 {
        let bit = unknown.trailing_zeros();
        return Err(Error::new(
            ErrorKind::Newer,
            format!(
                "the file needs feature bit {bit} ({}), which this program does not know: use a later one",
                incompat_name(bit)
            ),
        ));
    }
    if get_u32(block, HEADER_LENGTH) != SECTOR as u32 {
        return Err(Error::new(
            ErrorKind::Damaged,
            "the file header has an impossible length",
        ));
    }
    let mut id = [0; FILE_ID_BYTES];
    id.copy_from_slice(&block[HEADER_FILE_ID..HEADER_FILE_ID + FILE_ID_BYTES]);
    Ok(id)
}

/// The root of a generation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Superblock {
    pub(crate) generation: u64,
    pub(crate) log_end: u64,
    pub(crate) catalog: Ref,
    pub(crate) footer: u64,
    pub(crate) live: u64,
    pub(crate) garbage: u64,
    pub(crate) writer: u64,
    pub(crate) index: [u64; 2],
    /// One commit, bricks in Morton order, then all pages: made by compaction.
    pub(crate) sealed: bool,
}

impl Superblock {
    pub(crate) fn to_block(self, seed: u32) -> Vec<u8> {
        let mut block = vec![0; SECTOR];
        block[SUPER_MAGIC..SUPER_MAGIC + SUPERBLOCK_MAGIC.len()].copy_from_slice(&SUPERBLOCK_MAGIC);
        put_u64(&mut block, SUPER_GENERATION, self.generation);
        put_u64(&mut block, SUPER_LOG_END, self.log_end);
        self.catalog.put(&mut block, SUPER_CATALOG);
        put_u64(&mut block, SUPER_FOOTER, self.footer);
        put_u64(&mut block, SUPER_LIVE, self.live);
        put_u64(&mut block, SUPER_GARBAGE, self.garbage);
        put_u64(&mut block, SUPER_WRITER, self.writer);
        put_u64(&mut block, SUPER_INDEX, self.index[0]);
        put_u64(&mut block, SUPER_INDEX + 8, self.index[1]);
        put_u32(&mut block, SUPER_FLAGS, u32::from(self.sealed));
        let crc = crc32c::crc32c_append(seed, &block[..SUPER_CRC]);
        put_u32(&mut block, SUPER_CRC, crc);
        block
    }

    /// The superblock in a block read from `offset`; `None` when torn, damaged, of another file or
    /// in the wrong place.
    pub(crate) fn parse(block: &[u8], seed: u32, offset: u64) -> Option<Self> {
        if block.len() != SECTOR
            || block[..SUPERBLOCK_MAGIC.len()] != SUPERBLOCK_MAGIC
            || crc32c::crc32c_append(seed, &block[..SUPER_CRC]) != get_u32(block, SUPER_CRC)
        {
            return None;
        }
        let root = Self {
            generation: get_u64(block, SUPER_GENERATION),
            log_end: get_u64(block, SUPER_LOG_END),
            catalog: Ref::get(block, SUPER_CATALOG),
            footer: get_u64(block, SUPER_FOOTER),
            live: get_u64(block, SUPER_LIVE),
            garbage: get_u64(block, SUPER_GARBAGE),
            writer: get_u64(block, SUPER_WRITER),
            index: [get_u64(block, SUPER_INDEX), get_u64(block, SUPER_INDEX + 8)],
            sealed: get_u32(block, SUPER_FLAGS) & 1 != 0,
        };
        let in_place = superblock_at(root.generation) == offset;
        let ends_well = root.log_end >= LOG_START && root.log_end.is_multiple_of(SECTOR as u64);
        (in_place && ends_well).then_some(root)
    }
}

/// What a footer says about its commit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Footer {
    pub(crate) generation: u64,
    pub(crate) catalog: Ref,
    pub(crate) start: u64,
    pub(crate) previous: u64,
    pub(crate) records: u64,
    pub(crate) live: u64,
    pub(crate) garbage: u64,
    pub(crate) chain: u32,
}

impl Footer {
    pub(crate) fn to_payload(self) -> Vec<u8> {
        let mut bytes = vec![0; FOOTER_BYTES];
        put_u64(&mut bytes, FOOTER_GENERATION, self.generation);
        self.catalog.put(&mut bytes, FOOTER_CATALOG);
        put_u64(&mut bytes, FOOTER_START, self.start);
        put_u64(&mut bytes, FOOTER_PREVIOUS, self.previous);
        put_u64(&mut bytes, FOOTER_RECORDS, self.records);
        put_u64(&mut bytes, FOOTER_LIVE, self.live);
        put_u64(&mut bytes, FOOTER_GARBAGE, self.garbage);
        put_u32(&mut bytes, FOOTER_CHAIN, self.chain);
        bytes
    }

    pub(crate) fn parse(bytes: &[u8]) -> Option<Self> {
        (bytes.len() == FOOTER_BYTES).then(|| Self {
            generation: get_u64(bytes, FOOTER_GENERATION),
            catalog: Ref::get(bytes, FOOTER_CATALOG),
            start: get_u64(bytes, FOOTER_START),
            previous: get_u64(bytes, FOOTER_PREVIOUS),
            records: get_u64(bytes, FOOTER_RECORDS),
            live: get_u64(bytes, FOOTER_LIVE),
            garbage: get_u64(bytes, FOOTER_GARBAGE),
            chain: get_u32(bytes, FOOTER_CHAIN),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SEED: u32 = 0x1234_5678;

    fn build(head: &Head, payload: &[u8], seed: u32) -> (Vec<u8>, Ref) {
        let mut buffer = Vec::with_capacity(record_bytes(payload.len() as u32) as usize);
        buffer.resize(RECORD_HEADER, 0);
        buffer.extend_from_slice(payload);
        let reference = seal(&mut buffer, 0, head, seed);
        (buffer, reference)
    }

    fn sample_record() -> (Vec<u8>, Ref) {
        let head = Head {
            key: 77,
            level: 1,
            codec: 3,
            ..Head::new(RecordKind::Page, 5, 2)
        };
        build(&head, b"thirteen byte", SEED)
    }

    #[test]
    fn record_round_trip() {
        let (record, reference) = sample_record();
        assert_eq!(record.len() as u64, record_bytes(13));
        let (head, payload) = open(&record, SEED).expect("opens");
        assert_eq!(
            (head.key, head.level, head.generation, payload),
            (77, 1, 5, &b"thirteen byte"[..])
        );
        assert_eq!(reference.length, 13);
    }

    #[test]
    fn record_empty() {
        let (record, _) = build(&Head::new(RecordKind::Brick, 1, 0), b"", SEED);
        assert_eq!(open(&record, SEED).expect("opens").1, b"");
    }

    #[test]
    fn record_every_truncation_and_extra_bytes() {
        let (mut record, _) = sample_record();
        for end in 0..record.len() {
            assert!(open(&record[..end], SEED).is_err(), "{end}");
        }
        record.push(0);
        assert!(open(&record, SEED).is_err());
    }

    #[test]
    fn record_every_bit_flip() {
        let (record, _) = sample_record();
        for bit in 0..record.len() * 8 {
            let mut bad = record.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert!(open(&bad, SEED).is_err(), "bit {bit}");
        }
        assert!(open(&record, SEED + 1).is_err(), "another file");
    }

    #[test]
    fn record_huge_declared_size() {
        let (mut record, _) = sample_record();
        put_u32(&mut record, RECORD_PAYLOAD, u32::MAX);
        assert!(open(&record, SEED).is_err());
    }

    #[test]
    fn header_names_what_it_lacks() {
        let block = header_block(&[7; 16], KNOWN_INCOMPAT);
        assert_eq!(parse_header(&block).expect("own header"), [7; 16]);
        let changed = |at: usize, value: u8| {
            let mut block = block.clone();
            block[at] = value;
            let crc = crc32c::crc32c(&block[..HEADER_CRC]);
            put_u32(&mut block, HEADER_CRC, crc);
            parse_header(&block)
        };
        assert_eq!(
            changed(0, 0).expect_err("magic").kind(),
            ErrorKind::NotAVolume
        );
        assert_eq!(
            changed(HEADER_MAJOR, 9).expect_err("version").kind(),
            ErrorKind::Newer
        );
        let newer = changed(HEADER_INCOMPAT, 1).expect_err("feature");
        assert!(newer.to_string().contains("zstd"), "{newer}");
        assert!(changed(HEADER_COMPAT, 1).is_ok());
        for bit in 64..SECTOR * 8 {
            let mut bad = block.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(
                parse_header(&bad).expect_err("damaged").kind(),
                ErrorKind::Damaged
            );
        }
    }

    #[test]
    fn superblock_round_trip_and_every_bit_flip() {
        let root = Superblock {
            generation: 3,
            log_end: 16384,
            footer: 12400,
            live: 9,
            ..Superblock::default()
        };
        let block = root.to_block(SEED);
        assert_eq!(
            Superblock::parse(&block, SEED, SUPERBLOCK_AT[0]),
            Some(root)
        );
        assert_eq!(
            Superblock::parse(&block, SEED, SUPERBLOCK_AT[1]),
            None,
            "wrong slot"
        );
        assert_eq!(
            Superblock::parse(&block, SEED ^ 1, SUPERBLOCK_AT[0]),
            None,
            "another file"
        );
        for bit in 0..SECTOR * 8 {
            let mut bad = block.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Superblock::parse(&bad, SEED, SUPERBLOCK_AT[0]), None);
        }
    }
}
