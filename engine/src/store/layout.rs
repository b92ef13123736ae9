//! Every offset, length, magic number and limit of the file, built from each other. The only place;
//! `docs/format.md` says the same in words. All integers are little-endian.

use crate::sample::SampleType;

/// `offset..offset + length` constants that follow one another.
macro_rules! fields {
    ($($(#[$doc:meta])* $name:ident : $length:expr => $next:ident),* $(,)?) => {
        fields!(@step 0; $($(#[$doc])* $name : $length => $next),*);
    };
    (@step $at:expr; $(#[$doc:meta])* $name:ident : $length:expr => $next:ident $(, $($rest:tt)*)?) => {
        $(#[$doc])*
        pub(crate) const $name: usize = $at;
        const $next: usize = $name + $length;
        $(fields!(@step $next; $($rest)*);)?
    };
    (@step $at:expr;) => {};
}

// ---- the file ----------------------------------------------------------------------------------

/// Header, each superblock, and every commit start on a border of this many bytes.
pub(crate) const SECTOR: usize = 4096;
/// Offsets of the two superblocks: A holds odd generations, B even ones.
pub(crate) const SUPERBLOCK_AT: [u64; 2] = [SECTOR as u64, 2 * SECTOR as u64];
/// Offset of the first record.
pub(crate) const LOG_START: u64 = 3 * SECTOR as u64;
/// Records start on borders of this many bytes.
pub(crate) const RECORD_ALIGN: usize = 8;

/// Offset of the superblock that holds `generation`.
pub(crate) const fn superblock_at(generation: u64) -> u64 {
    SUPERBLOCK_AT[generation.is_multiple_of(2) as usize]
}

/// `n` rounded up to a multiple of the power of two `align`; `None` beyond 64 bits.
pub(crate) const fn align_up(n: u64, align: u64) -> Option<u64> {
    match n.checked_add(align - 1) {
        Some(sum) => Some(sum & !(align - 1)),
        None => None,
    }
}

// ---- file header -------------------------------------------------------------------------------

/// First bytes of the file; the line ends in it show a transfer in text mode.
pub(crate) const MAGIC: [u8; 8] = [0x89, b'S', b'V', b'O', b'L', 0x0d, 0x0a, 0x1a];
/// Readers refuse a larger one.
pub(crate) const MAJOR: u16 = 1;
/// Grows with additions that old readers may ignore.
pub(crate) const MINOR: u16 = 0;

fields! {
    HEADER_MAGIC: MAGIC.len() => H1,
    HEADER_MAJOR: 2 => H2,
    HEADER_MINOR: 2 => H3,
    /// Always [`SECTOR`].
    HEADER_LENGTH: 4 => H4,
    HEADER_INCOMPAT: 8 => H5,
    HEADER_RO_COMPAT: 8 => H6,
    HEADER_COMPAT: 8 => H7,
    HEADER_FILE_ID: FILE_ID_BYTES => HEADER_END,
}
/// Bytes of the file id.
pub(crate) const FILE_ID_BYTES: usize = 16;
/// CRC32C (no seed) of all bytes of the header before it; the bytes between are zero.
pub(crate) const HEADER_CRC: usize = SECTOR - 4;
const _: () = assert!(HEADER_END <= HEADER_CRC);

/// Bits of the `ro_compat` word that this version understands (none yet).
pub(crate) const KNOWN_RO_COMPAT: u64 = 0;

/// `incompat`: f32 bricks may have codec 6.
pub(crate) const INCOMPAT_ROWS: u64 = 1 << 3;

/// `incompat`: bricks of u8, i8, u16 and i16 may have codecs 7 and 8.
pub(crate) const INCOMPAT_FITTED: u64 = 1 << 4;

/// `incompat`: bricks of all types but f32 may have codec 9.
pub(crate) const INCOMPAT_BINARY: u64 = 1 << 5;

/// Bits of the `incompat` word that this version understands.
pub(crate) const KNOWN_INCOMPAT: u64 = INCOMPAT_ROWS | INCOMPAT_FITTED | INCOMPAT_BINARY;

/// Names of feature bits that are planned, so that an old reader can name what it lacks.
pub(crate) fn incompat_name(bit: u32) -> &'static str {
    match bit {
        0 => "zstd bricks",
        1 => "chunks of several bricks",
        2 => "more than one channel",
        3 => "f32 bricks of predicted rows",
        4 => "bricks of small integers with a fitted prediction",
        5 => "bricks of two values as predicted bits",
        _ => "unnamed",
    }
}

// ---- superblock --------------------------------------------------------------------------------

/// First bytes of a superblock.
pub(crate) const SUPERBLOCK_MAGIC: [u8; 8] = *b"SVOLROOT";

fields! {
    SUPER_MAGIC: SUPERBLOCK_MAGIC.len() => S1,
    SUPER_GENERATION: 8 => S2,
    /// First byte after the last commit, a multiple of [`SECTOR`].
    SUPER_LOG_END: 8 => S3,
    SUPER_CATALOG: REF_BYTES => S4,
    /// Offset of the footer of the last commit; 0 in generation 0.
    SUPER_FOOTER: 8 => S5,
    SUPER_LIVE: 8 => S6,
    SUPER_GARBAGE: 8 => S7,
    /// Random per open while a writer works, 0 in a finished file.
    SUPER_WRITER: 8 => S8,
    /// Offset and length of the pages of a sealed file; 0 when they do not lie together.
    SUPER_INDEX: 16 => S10,
    /// Bit 0: sealed.
    SUPER_FLAGS: 4 => SUPER_END,
}
/// CRC32C, seeded from the file id, of all bytes of the superblock before it.
pub(crate) const SUPER_CRC: usize = SECTOR - 4;
const _: () = assert!(SUPER_END <= SUPER_CRC);

// ---- record ------------------------------------------------------------------------------------

/// First bytes of a record.
pub(crate) const RECORD_MAGIC: u32 = u32::from_le_bytes(*b"SVrc");

fields! {
    RECORD_MAGIC_AT: 4 => R1,
    RECORD_KIND: 1 => R2,
    RECORD_CODEC: 1 => R3,
    RECORD_FLAGS: 2 => R4,
    /// Bytes of the payload as stored, without the padding to [`RECORD_ALIGN`].
    RECORD_PAYLOAD: 4 => R5,
    /// Bytes of the payload when decoded; must equal what the catalog says.
    RECORD_DECODED: 4 => R6,
    RECORD_GENERATION: 8 => R7,
    /// Morton code of the smallest brick.
    RECORD_KEY: 8 => R8,
    RECORD_VOLUME: 2 => R9,
    RECORD_LEVEL: 1 => R10,
    RECORD_RESERVED: 1 => RECORD_CRC_AT_,
}
/// CRC32C, seeded from the file id, of the header before it and the padded payload after it.
pub(crate) const RECORD_CRC: usize = RECORD_CRC_AT_;
/// Length of the record header.
pub(crate) const RECORD_HEADER: usize = RECORD_CRC + 4;
const _: () = assert!(RECORD_HEADER == 40);

/// A reader that does not know the kind of the record may skip it.
pub(crate) const FLAG_SKIPPABLE: u16 = 1;

/// Bytes that a record with `payload` bytes takes in the file.
pub(crate) const fn record_bytes(payload: u32) -> u64 {
    (RECORD_HEADER as u64 + payload as u64).next_multiple_of(RECORD_ALIGN as u64)
}

// ---- reference ---------------------------------------------------------------------------------

fields! {
    REF_OFFSET: 8 => F1,
    /// Payload length of the target.
    REF_LENGTH: 4 => F2,
    /// CRC of the target; must equal the one in its header.
    REF_CRC: 4 => REF_END,
}
/// Length of a reference. All zero: no target.
pub(crate) const REF_BYTES: usize = REF_END;

// ---- footer ------------------------------------------------------------------------------------

fields! {
    FOOTER_GENERATION: 8 => T1,
    FOOTER_CATALOG: REF_BYTES => T2,
    /// Offset of the first record of the commit.
    FOOTER_START: 8 => T3,
    /// Offset of the footer of the commit before; 0 for the first.
    FOOTER_PREVIOUS: 8 => T4,
    /// Records of the commit before the footer.
    FOOTER_RECORDS: 8 => T5,
    FOOTER_LIVE: 8 => T6,
    FOOTER_GARBAGE: 8 => T7,
    /// CRC32C, seeded from the file id, of the headers of all records of the commit before the
    /// footer, in file order.
    FOOTER_CHAIN: 4 => T8,
    FOOTER_RESERVED: 4 => FOOTER_END,
}
/// Payload length of a footer.
pub(crate) const FOOTER_BYTES: usize = FOOTER_END;

// ---- node page ---------------------------------------------------------------------------------

/// Octree levels in one page.
pub(crate) const PAGE_LEVELS: u32 = 3;
/// Slots per axis of a page.
pub(crate) const PAGE_EDGE: u32 = 1 << PAGE_LEVELS;
/// Slots of a page.
pub(crate) const PAGE_SLOTS: usize = (PAGE_EDGE * PAGE_EDGE * PAGE_EDGE) as usize;
/// Inner octree nodes of a page: 1 + 8 + 64.
pub(crate) const PAGE_INNER: usize = 1 + 8 + 64;
/// Bytes of a mask with one bit per slot, bit `s % 8` of byte `s / 8`.
pub(crate) const MASK_BYTES: usize = PAGE_SLOTS / 8;
/// Bytes of a value: the native little-endian bytes of the sample, then zeros.
pub(crate) const VALUE_BYTES: usize = 4;
/// Most levels of pages: 21 bits of brick coordinate per axis, three per page.
pub(crate) const MAX_PAGE_LEVEL: u8 = 7;
/// Brick coordinates are below this.
pub(crate) const MAX_BRICKS: u32 = 1 << (PAGE_LEVELS * MAX_PAGE_LEVEL as u32);

fields! {
    PAGE_LEVEL: 1 => P1,
    PAGE_RESERVED: 7 => P2,
    /// Smallest brick coordinate, three u32, then a reserved u32.
    PAGE_ORIGIN: 16 => P3,
    PAGE_CHILD_MASK: MASK_BYTES => P4,
    PAGE_TILE_MASK: MASK_BYTES => P5,
    PAGE_NAN_MASK: MASK_BYTES => PAGE_MASKS_END,
}
/// Refs of children, values of tiles, (min, max) of children, (min, max) of inner nodes.
pub(crate) const PAGE_BODY: usize = PAGE_MASKS_END;

/// Payload length of a page with so many children and tiles.
pub(crate) const fn page_bytes(children: usize, tiles: usize) -> usize {
    PAGE_BODY
        + children * (REF_BYTES + 2 * VALUE_BYTES)
        + tiles * VALUE_BYTES
        + PAGE_INNER * 2 * VALUE_BYTES
}
/// Payload length of a full page: the most that a reader accepts.
pub(crate) const PAGE_BYTES_MAX: usize = page_bytes(PAGE_SLOTS, 0);

// ---- catalog -----------------------------------------------------------------------------------

fields! {
    CATALOG_VERSION: 2 => C1,
    CATALOG_COUNT: 2 => C2,
    CATALOG_RESERVED: 4 => CATALOG_HEAD_END,
}
/// Bytes before the first entry.
pub(crate) const CATALOG_HEAD: usize = CATALOG_HEAD_END;

fields! {
    ENTRY_ATTRIBUTES: REF_BYTES => E1,
    /// Zero when there is none.
    ENTRY_HISTORY: REF_BYTES => E2,
    /// Zero when every brick is background.
    ENTRY_ROOT: REF_BYTES => E3,
    ENTRY_ROOT_LEVEL: 1 => E4,
    /// Level of detail: 0 for a volume of its own.
    ENTRY_LOD: 1 => E5_,
    /// Number of the volume that this is a level of detail of.
    ENTRY_PARENT: 2 => E5__,
    ENTRY_RESERVED: 2 => E5,
    /// Bytes of the name that follows, padded with zeros to [`RECORD_ALIGN`].
    ENTRY_NAME: 2 => ENTRY_END,
}
/// Bytes of an entry without its name.
pub(crate) const ENTRY_BYTES: usize = ENTRY_END;
/// Version of the catalog and attribute layouts.
pub(crate) const CATALOG_VERSION_NOW: u16 = 1;
/// Most volumes in a file.
pub(crate) const MAX_VOLUMES: u16 = 4096;
/// Longest name in bytes.
pub(crate) const MAX_NAME: usize = 255;
/// Longest history text in bytes: its record also holds a version and a length.
pub(crate) const MAX_HISTORY: usize = ATTR_BYTES_MAX - 16;
/// Longest catalog payload.
pub(crate) const CATALOG_BYTES_MAX: usize =
    CATALOG_HEAD + MAX_VOLUMES as usize * (ENTRY_BYTES + MAX_NAME.next_multiple_of(RECORD_ALIGN));

// ---- attributes --------------------------------------------------------------------------------

fields! {
    ATTR_VERSION: 2 => A1,
    ATTR_SAMPLE: 1 => A2,
    ATTR_CHANNELS: 1 => A3,
    ATTR_KIND: 1 => A4,
    ATTR_UNITS: 1 => A5,
    /// 0: samples sit at lattice points.
    ATTR_POSITION: 1 => A6,
    ATTR_EDGE_LOG2: 1 => A7,
    ATTR_BACKGROUND: VALUE_BYTES => A8,
    /// Width of the narrow band of a distance in world units as f32; 0 when not known.
    ATTR_BAND: 4 => A9,
    /// Smallest and largest sample (NaN aside), as values.
    ATTR_MIN: VALUE_BYTES => A10,
    ATTR_MAX: VALUE_BYTES => A11,
    ATTR_HAS_NAN: 4 => A12,
    /// Slabs of bricks that a running import has committed; 0 in a whole volume.
    ATTR_SLABS: 4 => A13,
    /// Smallest lattice point, three i64.
    ATTR_ORIGIN: 24 => A14,
    /// Samples per axis, three u32.
    ATTR_SIZE: 12 => A15_,
    /// CRC32C, not seeded, of the source bytes of those slabs; 0 in a whole volume.
    ATTR_SOURCE_CRC: 4 => A15,
    /// Index to world, three rows of four f64.
    ATTR_MATRIX: 96 => A16,
    ATTR_BRICKS: 8 => A17,
    /// Tiles over all levels.
    ATTR_TILES: 8 => A18,
    /// Bricks of the domain that tiles cover.
    ATTR_TILE_BRICKS: 8 => A19,
    ATTR_PAGES: 8 => A20,
    /// Bytes of brick payloads as stored.
    ATTR_STORED: 8 => ATTR_END,
}
/// Payload length of an attributes record.
pub(crate) const ATTR_BYTES: usize = ATTR_END;
/// Longest payload of an attributes or history record.
pub(crate) const ATTR_BYTES_MAX: usize = 1 << 20;
/// Most samples per axis.
pub(crate) const MAX_DIM: u32 = 1 << 27;

// ---- bricks ------------------------------------------------------------------------------------

/// Bytes of a decoded brick: `edge^3` samples, bits packed eight to a byte.
pub(crate) const fn brick_bytes(sample: SampleType, edge: u32) -> usize {
    let samples = (edge * edge * edge) as usize;
    match sample {
        SampleType::Bit => samples / 8,
        _ => samples * sample.bytes(),
    }
}

/// Whether bricks may have this edge.
pub(crate) const fn is_brick_edge(edge: u32) -> bool {
    matches!(edge, 8 | 16 | 32 | 64)
}

// ---- bytes -------------------------------------------------------------------------------------

macro_rules! integers {
    ($($get:ident $put:ident $type:ty),*) => {$(
        /// Reads the integer at `at`; the caller has checked the length.
        #[inline]
        pub(crate) fn $get(bytes: &[u8], at: usize) -> $type {
            let mut raw = [0; size_of::<$type>()];
            raw.copy_from_slice(&bytes[at..at + size_of::<$type>()]);
            <$type>::from_le_bytes(raw)
        }
        /// Writes the integer at `at`.
        #[inline]
        pub(crate) fn $put(bytes: &mut [u8], at: usize, value: $type) {
            bytes[at..at + size_of::<$type>()].copy_from_slice(&value.to_le_bytes());
        }
    )*};
}
integers!(get_u16 put_u16 u16, get_u32 put_u32 u32, get_u64 put_u64 u64, get_i64 put_i64 i64, get_f64 put_f64 f64);

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers of docs/format.md; a change here is a change of the format.
    #[test]
    fn layout_is_the_documented_one() {
        assert_eq!((SUPERBLOCK_AT, LOG_START), ([4096, 8192], 12288));
        assert_eq!((superblock_at(1), superblock_at(2)), (4096, 8192));
        assert_eq!((HEADER_FILE_ID, HEADER_END, HEADER_CRC), (40, 56, 4092));
        assert_eq!((SUPER_CATALOG, SUPER_INDEX, SUPER_END), (24, 72, 92));
        assert_eq!((RECORD_KEY, RECORD_LEVEL, RECORD_CRC), (24, 34, 36));
        assert_eq!(REF_BYTES, 16);
        assert_eq!((FOOTER_CHAIN, FOOTER_BYTES), (64, 72));
        assert_eq!((PAGE_ORIGIN, PAGE_CHILD_MASK, PAGE_BODY), (8, 24, 216));
        assert_eq!(PAGE_BYTES_MAX, 13_088);
        assert_eq!((CATALOG_HEAD, ENTRY_ROOT_LEVEL, ENTRY_BYTES), (8, 48, 56));
        assert_eq!((ATTR_ORIGIN, ATTR_MATRIX, ATTR_BYTES), (32, 72, 208));
        assert_eq!(record_bytes(1), 48);
        assert_eq!(align_up(u64::MAX, 8), None);
    }
}
