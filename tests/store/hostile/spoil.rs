//! Ways to spoil a sound file so that every checksum holds.

use super::super::handmade::{Entry, Piece, Plan, Slot, catalog, page};
use super::super::image::{self, LOG, Record, Ref, kind, put, reseal, u64_at};

/// Patches bytes and makes the checksums right again.
pub(super) fn patched(plan: Plan, patch: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut bytes = plan.file(&|_| {});
    patch(&mut bytes);
    reseal(&mut bytes);
    bytes
}

/// The file header and its copy.
pub(super) fn header(at: usize, value: &[u8]) -> Vec<u8> {
    patched(Plan::SMALL, |bytes| {
        for base in [0, LOG + image::HEAD] {
            bytes[base + at..base + at + value.len()].copy_from_slice(value);
        }
    })
}

/// A word of the newest superblock.
pub(super) fn superblock(at: usize, value: u64) -> Vec<u8> {
    patched(Plan::SMALL, |bytes| {
        put(bytes, 4096 + at, value.to_le_bytes())
    })
}

/// A word of the last footer, with both superblocks lost or not.
pub(super) fn footer(at: usize, value: u64, lost: bool) -> Vec<u8> {
    let mut bytes = Plan::SMALL.file(&|_| {});
    let footer = *image::of_kind(&bytes, kind::FOOTER).last().expect("one");
    let payload = footer.payload();
    let chain = u64_at(&bytes, payload + 64);
    put(&mut bytes, payload + at, value.to_le_bytes());
    if at != 64 {
        put(&mut bytes, payload + 64, chain.to_le_bytes());
    }
    if lost {
        bytes[4096..LOG].fill(0);
    }
    // Not reseal, which would mend the chain.
    let seed = image::crc32c(0, &image::get::<16>(&bytes, 40));
    let crc = image::crc32c(seed, &bytes[footer.at..footer.at + 36]);
    let crc = image::crc32c(crc, &bytes[payload..footer.end()]);
    put(&mut bytes, footer.at + 36, crc.to_le_bytes());
    bytes
}

/// The `n`th record of a kind: bytes from its header on.
pub(super) fn record(plan: Plan, kind: u8, n: usize, at: usize, value: &[u8]) -> Vec<u8> {
    patched(plan, |bytes| {
        let record = image::of_kind(bytes, kind)[n];
        bytes[record.at + at..record.at + at + value.len()].copy_from_slice(value);
    })
}

/// The payload of the root page of the small file.
pub(super) fn root_page(at: usize, value: &[u8]) -> Vec<u8> {
    record(Plan::SMALL, kind::PAGE, 0, image::HEAD + at, value)
}

/// Offset of the first range of a child in the payload of the small root page.
pub(super) fn ranges_at() -> usize {
    let bytes = Plan::SMALL.file(&|_| {});
    let page = image::of_kind(&bytes, kind::PAGE)[0];
    let payload = &bytes[page.payload()..];
    let ones = |mask: &[u8]| mask.iter().map(|b| b.count_ones() as usize).sum::<usize>();
    216 + 16 * ones(&payload[24..88]) + 4 * ones(&payload[88..152])
}

/// The attributes.
pub(super) fn attributes(at: usize, value: &[u8]) -> Vec<u8> {
    record(Plan::SMALL, kind::ATTRIBUTES, 0, image::HEAD + at, value)
}

/// The catalog.
pub(super) fn in_catalog(at: usize, value: &[u8]) -> Vec<u8> {
    record(Plan::SMALL, kind::CATALOG, 0, image::HEAD + at, value)
}

pub(super) fn with(change: impl Fn(Piece<'_>)) -> Vec<u8> {
    Plan::SMALL.file(&change)
}

/// Another record in the place of the second brick of the small file.
pub(super) fn brick(change: impl Fn(&mut Record)) -> Vec<u8> {
    with(|piece| {
        if let Piece::Brick([0, 1, 0], record) = piece {
            change(record);
        }
    })
}

pub(super) fn stored(codec: u8, payload: &[u8]) -> Vec<u8> {
    brick(|record| {
        record.codec = codec;
        record.payload = payload.to_vec();
    })
}

/// A root page with other slots.
pub(super) fn slots(make: impl Fn(&[Ref]) -> Vec<(usize, Slot)>) -> Vec<u8> {
    with(|piece| {
        if let Piece::Page(1, record, refs) = piece {
            record.payload = page(1, [3, 2, 2], &make(refs));
        }
    })
}

/// LZ4: one literal, a match of offset 1, five literals; `length` bytes in all.
pub(super) fn lz4_run(length: usize) -> Vec<u8> {
    let mut out = vec![0x1f, 7, 1, 0];
    let mut rest = length - 25;
    while rest >= 255 {
        out.push(255);
        rest -= 255;
    }
    out.push(rest as u8);
    // The last five bytes are literals.
    out.extend([0x50, 1, 2, 3, 4, 5]);
    out
}

/// A volume by its size alone: all background, so that the file is small.
pub(super) fn empty_of(size: [u32; 3], edge_log2: u8) -> Vec<u8> {
    with(|piece| match piece {
        Piece::Attributes(record) => {
            for a in 0..3 {
                put(&mut record.payload, 56 + 4 * a, size[a].to_le_bytes());
            }
            record.payload[7] = edge_log2;
            record.payload[16] = 0;
            record.payload[20] = 0;
        }
        Piece::Entry(entry) => {
            entry.root = Ref::default();
            entry.level = 0;
        }
        _ => {}
    })
}

pub(super) fn catalog_of(count: usize) -> Vec<u8> {
    with(|piece| {
        if let Piece::Catalog(record) = piece {
            let mut entries = vec![Entry::default(); count];
            for (n, entry) in entries.iter_mut().enumerate() {
                entry.name = format!("volume {n}").into_bytes();
            }
            record.payload = catalog(&entries);
        }
    })
}

/// Starts of records that lie about their length, one every 16 bytes, under a whole commit.
pub(super) fn false_starts() -> Vec<u8> {
    let mut bytes = Plan::SMALL.file(&|_| {});
    let end = bytes.len() + (4 << 20);
    while bytes.len() < end {
        bytes.extend(*b"SVrc\x02\0\0\0");
        bytes.extend(0x000f_ff00u32.to_le_bytes());
        bytes.extend([0; 4]);
    }
    put(&mut bytes, 4096 + 16, (end as u64).to_le_bytes());
    let seed = image::crc32c(0, &image::get::<16>(&bytes, 40));
    let crc = image::crc32c(seed, &bytes[4096..8188]);
    put(&mut bytes, 8188, crc.to_le_bytes());
    bytes
}
