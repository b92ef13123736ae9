//! Files made to harm: every checksum holds, the content lies. Each gives an error of the right kind
//! that names the file and what is wrong, quickly and within 64 MiB; never a panic.
//!
//! `None` as kind: reading cannot notice it and gives what the file says; `verify` does notice.

use super::handmade::{Entry, Piece, Plan, Slot, catalog, morton, page};
use super::image::{self, Image, LOG, Record, Ref, kind, put, reseal, u64_at};
use crate::support::program::brickmarch;
use crate::support::report::figure;
use crate::support::scratch::Scratch;
use brickmarch::store::{MemoryStorage, Volume, verify_in};
use brickmarch::{Box3, Budget, Error, ErrorKind, Field};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// What must come of a file.
struct Case {
    name: &'static str,
    kind: Option<ErrorKind>,
    word: &'static str,
    build: fn() -> Vec<u8>,
}

/// Everything that a reader is asked; huge domains at both ends.
fn read(bytes: &[u8], budget: &Budget) -> Result<(), Error> {
    let storage = Arc::new(MemoryStorage::new(bytes.to_vec()));
    let volume = Volume::open_in(storage, Path::new("hostile.bvol"), budget)?;
    let domain = volume.spec().grid.domain;
    let size = domain.size().map(|n| n.min(96) as i32);
    let low = Box3::new(domain.min, std::array::from_fn(|a| domain.min[a] + size[a]));
    let high = Box3::new(std::array::from_fn(|a| domain.max[a] - size[a]), domain.max);
    for region in [low, high] {
        let mut raw = vec![0; region.count() as usize * volume.spec().sample.bytes()];
        volume.read_raw(region, &mut raw)?;
        volume.range(region)?;
    }
    volume.range(domain)?;
    volume.info().map(|_| ())
}

#[track_caller]
fn check(name: &str) {
    let case = CASES.iter().find(|c| c.name == name).expect("a case");
    let bytes = (case.build)();
    let budget = Budget::mib(64).with_threads(1);
    let begin = Instant::now();
    let result = read(&bytes, &budget);
    let storage = Arc::new(MemoryStorage::new(bytes));
    let report = verify_in(storage, Path::new("hostile.bvol"), &budget);
    let took = begin.elapsed();
    let message = match (case.kind, result) {
        (Some(kind), Err(error)) => {
            assert_eq!(error.kind(), kind, "{error}");
            let text = error.to_string();
            assert!(text.contains("hostile.bvol"), "names no file: {text}");
            text
        }
        (Some(_), Ok(())) => panic!("was read as if nothing were wrong"),
        (None, Ok(())) => {
            let report = report.as_ref().expect("verify reads it");
            let all: Vec<&str> = report.problems.iter().map(|p| p.message.as_str()).collect();
            all.join("; ")
        }
        (None, Err(error)) => panic!("only verify was expected to notice: {error}"),
    };
    assert!(
        message.contains(case.word),
        "{:?} is not in: {message}",
        case.word
    );
    assert!(!message.contains('\n'), "{message}");
    if let Ok(report) = report {
        assert!(!report.is_intact(), "verify found nothing: {report:?}");
    }
    assert!(took < Duration::from_secs(1), "{took:?}");
    assert!(budget.peak_bytes() <= 64 << 20 && budget.used_bytes() == 0);
}

/// The program on every file: an error in one line or a report, no signal, little memory.
#[test]
fn the_program_survives_every_hostile_file() {
    let scratch = Scratch::new("hostile");
    // The first run may build the program.
    brickmarch(["--version"]).success();
    let mut peak = 0;
    for case in CASES {
        let path = scratch.write("hostile.bvol", (case.build)());
        let begin = Instant::now();
        let run = brickmarch([
            "verify".as_ref(),
            path.as_os_str(),
            "--mem".as_ref(),
            "24MiB".as_ref(),
        ]);
        assert!(
            matches!(run.code, Some(code) if code != 0 && code != 101),
            "{}: {run:#?}",
            case.name
        );
        assert!(begin.elapsed() < Duration::from_secs(20), "{}", case.name);
        assert!(run.peak_bytes <= 64 << 20, "{}: {run:#?}", case.name);
        peak = peak.max(run.peak_bytes);
    }
    figure(&format!(
        "{} hostile files: each refused, at most {} MiB resident",
        CASES.len(),
        peak >> 20
    ));
}

#[test]
fn the_handmade_files_are_sound_before_they_are_spoiled() {
    for plan in [Plan::SMALL, Plan::LONG] {
        let bytes = plan.file(&|_| {});
        let mut sealed = bytes.clone();
        reseal(&mut sealed);
        assert!(sealed == bytes, "sealing a sound file changes nothing");
        let volume = super::open(bytes.clone(), &Budget::mib(16)).expect("sound");
        assert!(super::read_all(&volume).expect("sound") == plan.samples());
        assert_eq!(volume.spec().history, "hands");
        let storage = Arc::new(MemoryStorage::new(bytes));
        let report = verify_in(storage, Path::new("sound.bvol"), &Budget::mib(16));
        let report = report.expect("sound");
        assert!(report.is_intact() && report.notes.is_empty(), "{report:?}");
    }
}

/// What is wrong about a history costs no samples; it must not cost memory either.
#[test]
fn a_history_that_lies_is_left_out() {
    for (at, value) in [(4, u64::MAX), (4, 6), (4, 1 << 40), (0, 9)] {
        let bytes = Plan::SMALL.file(&|piece| {
            if let Piece::History(record) = piece {
                record.payload[at..at + 4].copy_from_slice(&value.to_le_bytes()[..4]);
            }
        });
        let budget = Budget::mib(16);
        let volume = super::open(bytes, &budget).expect("samples are sound");
        assert_eq!(volume.spec().history, "");
        super::read_all(&volume).expect("samples are sound");
    }
}

// ---- ways to spoil a file ----------------------------------------------------------------------

/// Patches bytes and makes the checksums right again.
fn patched(plan: Plan, patch: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut bytes = plan.file(&|_| {});
    patch(&mut bytes);
    reseal(&mut bytes);
    bytes
}

/// The file header and its copy.
fn header(at: usize, value: &[u8]) -> Vec<u8> {
    patched(Plan::SMALL, |bytes| {
        for base in [0, LOG + image::HEAD] {
            bytes[base + at..base + at + value.len()].copy_from_slice(value);
        }
    })
}

/// A word of the newest superblock.
fn superblock(at: usize, value: u64) -> Vec<u8> {
    patched(Plan::SMALL, |bytes| {
        put(bytes, 4096 + at, value.to_le_bytes())
    })
}

/// A word of the last footer, with both superblocks lost or not.
fn footer(at: usize, value: u64, lost: bool) -> Vec<u8> {
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
fn record(plan: Plan, kind: u8, n: usize, at: usize, value: &[u8]) -> Vec<u8> {
    patched(plan, |bytes| {
        let record = image::of_kind(bytes, kind)[n];
        bytes[record.at + at..record.at + at + value.len()].copy_from_slice(value);
    })
}

/// The payload of the root page of the small file.
fn root_page(at: usize, value: &[u8]) -> Vec<u8> {
    record(Plan::SMALL, kind::PAGE, 0, image::HEAD + at, value)
}

/// Offset of the first range of a child in the payload of the small root page.
fn ranges_at() -> usize {
    let bytes = Plan::SMALL.file(&|_| {});
    let page = image::of_kind(&bytes, kind::PAGE)[0];
    let payload = &bytes[page.payload()..];
    let ones = |mask: &[u8]| mask.iter().map(|b| b.count_ones() as usize).sum::<usize>();
    216 + 16 * ones(&payload[24..88]) + 4 * ones(&payload[88..152])
}

/// The attributes.
fn attributes(at: usize, value: &[u8]) -> Vec<u8> {
    record(Plan::SMALL, kind::ATTRIBUTES, 0, image::HEAD + at, value)
}

/// The catalog.
fn in_catalog(at: usize, value: &[u8]) -> Vec<u8> {
    record(Plan::SMALL, kind::CATALOG, 0, image::HEAD + at, value)
}

fn with(change: impl Fn(Piece<'_>)) -> Vec<u8> {
    Plan::SMALL.file(&change)
}

/// Another record in the place of the second brick of the small file.
fn brick(change: impl Fn(&mut Record)) -> Vec<u8> {
    with(|piece| {
        if let Piece::Brick([0, 1, 0], record) = piece {
            change(record);
        }
    })
}

fn stored(codec: u8, payload: &[u8]) -> Vec<u8> {
    brick(|record| {
        record.codec = codec;
        record.payload = payload.to_vec();
    })
}

/// A root page with other slots.
fn slots(make: impl Fn(&[Ref]) -> Vec<(usize, Slot)>) -> Vec<u8> {
    with(|piece| {
        if let Piece::Page(1, record, refs) = piece {
            record.payload = page(1, [3, 2, 2], &make(refs));
        }
    })
}

/// LZ4: one literal, a match of offset 1, five literals; `length` bytes in all.
fn lz4_run(length: usize) -> Vec<u8> {
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
fn empty_of(size: [u32; 3], edge_log2: u8) -> Vec<u8> {
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

fn catalog_of(count: usize) -> Vec<u8> {
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
fn false_starts() -> Vec<u8> {
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

const ROOT: Option<ErrorKind> = Some(ErrorKind::DamagedRoot);
const DAMAGED: Option<ErrorKind> = Some(ErrorKind::Damaged);
const NEWER: Option<ErrorKind> = Some(ErrorKind::Newer);
const CUT: Option<ErrorKind> = Some(ErrorKind::Truncated);
const OTHER: Option<ErrorKind> = Some(ErrorKind::NotAVolume);

const NAN: [u8; 8] = f64::NAN.to_le_bytes();
const INFINITY: [u8; 8] = f64::INFINITY.to_le_bytes();

macro_rules! hostile {
    ($($name:ident: $kind:expr, $word:literal, $build:expr;)*) => {
        const CASES: &[Case] = &[
            $(Case { name: stringify!($name), kind: $kind, word: $word, build: || $build }),*
        ];
        $(#[test] fn $name() { check(stringify!($name)); })*
    };
}

hostile! {
    // The file and its header.
    nothing_at_all: OTHER, "first bytes", Vec::new();
    only_the_magic: CUT, "12288", b"\x89SVOL\x0d\x0a\x1a".to_vec();
    only_the_header: CUT, "no whole commit", Plan::SMALL.file(&|_| {})[..4096].to_vec();
    only_header_and_superblocks: CUT, "ends at", Plan::SMALL.file(&|_| {})[..LOG].to_vec();
    header_with_another_magic: OTHER, "first bytes", header(0, b"\x89HDF\r\n\x1a\n");
    header_after_text_transfer: OTHER, "first bytes", header(5, b"\n\x1a\0");
    header_of_the_next_major_version: NEWER, "version 2", header(8, &[2, 0]);
    header_of_major_version_0: NEWER, "version 0", header(8, &[0, 0]);
    header_of_major_version_65535: NEWER, "version 65535", header(8, &[255, 255]);
    header_with_an_unknown_feature: NEWER, "zstd bricks", header(16, &[1]);
    header_with_the_last_feature: NEWER, "feature bit 63", header(23, &[128]);
    header_with_every_feature: NEWER, "feature bit 0", header(16, &[255; 8]);
    header_of_another_length: DAMAGED, "impossible length", header(12, &8192u32.to_le_bytes());
    header_of_length_0: DAMAGED, "impossible length", header(12, &[0; 4]);
    header_newer_than_its_copy: NEWER, "more than one channel", patched(Plan::SMALL, |b| b[16] = 4);
    header_copy_is_another: None, "copy of the file header", patched(Plan::SMALL, |b| b[LOG + 40 + 32] = 1);

    // Superblocks.
    superblock_generation_0_only: ROOT, "no whole commit", {
        let mut bytes = Plan::SMALL.file(&|_| {});
        bytes[4096..8192].fill(0);
        bytes[LOG + 5000] ^= 1;
        bytes
    };
    superblock_of_the_last_generation: ROOT, "generation", superblock(8, u64::MAX);
    superblock_of_the_last_generation_alone: ROOT, "generation", {
        let mut bytes = superblock(8, u64::MAX);
        bytes[8192..LOG].fill(0);
        bytes
    };
    superblock_of_a_later_generation: ROOT, "generation 1", superblock(8, 3);
    superblock_ends_beyond_the_file: CUT, "ends at", superblock(16, 1 << 20);
    superblock_ends_at_the_end_of_numbers: CUT, "ends at", superblock(16, u64::MAX - 4095);
    superblock_ends_before_its_records: ROOT, "outside of the log", superblock(16, 16384);
    superblock_without_catalog: ROOT, "catalog", superblock(24, 0);
    superblock_catalog_beyond_the_log: ROOT, "outside of the log", superblock(24, 1 << 40);
    superblock_catalog_offset_overflows: ROOT, "outside of the log", superblock(24, u64::MAX - 7);
    superblock_catalog_in_the_header: ROOT, "outside of the log", superblock(24, 8);
    superblock_catalog_of_4_gib: ROOT, "4294967295", patched(Plan::SMALL, |b| put(b, 4096 + 32, [255; 4]));
    superblock_catalog_is_a_brick: ROOT, "of kind 2", patched(Plan::SMALL, |b| {
        let brick = image::of_kind(b, kind::BRICK)[0];
        put(b, 4096 + 24, (brick.at as u64).to_le_bytes());
        put(b, 4096 + 32, (brick.length as u32).to_le_bytes());
    });
    superblock_footer_elsewhere: None, "last footer", superblock(40, 99);
    superblock_counts_wrongly: None, "live", superblock(48, u64::MAX);
    superblock_counts_overflow: None, "dead", superblock(56, u64::MAX);
    superblock_index_span_elsewhere: None, "index span", patched(Plan::SMALL, |b| {
        put(b, 4096 + 72, 1u64.to_le_bytes());
        put(b, 4096 + 80, 1u64.to_le_bytes());
    });
    superblock_index_span_overflows: None, "index span", patched(Plan::SMALL, |b| {
        put(b, 4096 + 72, u64::MAX.to_le_bytes());
        put(b, 4096 + 80, u64::MAX.to_le_bytes());
    });

    // Footers: what recovery believes.
    footer_chain_broken: None, "footer", footer(64, 0, false);
    footer_chain_broken_and_superblocks_lost: ROOT, "no whole commit", footer(64, 0, true);
    footer_of_another_generation: ROOT, "no whole commit", footer(0, 2, true);
    footer_starts_elsewhere: ROOT, "no whole commit", footer(24, 16384, true);
    footer_with_a_commit_before_the_first: ROOT, "no whole commit", footer(32, 12288, true);
    footer_counts_records_wrongly: ROOT, "no whole commit", footer(40, u64::MAX, true);
    footer_catalog_beyond_the_log: ROOT, "outside of the log", footer(8, 1 << 50, true);
    log_of_false_starts: None, "no whole record", false_starts();

    // Catalog.
    catalog_of_a_later_version: ROOT, "version", in_catalog(0, &[2]);
    catalog_without_volumes: ROOT, "names no volume", catalog_of(0);
    catalog_of_two_volumes_without_attributes: ROOT, "attributes of volume 0", catalog_of(2);
    catalog_of_4096_volumes_without_attributes: ROOT, "attributes of volume 0", catalog_of(4096);
    catalog_of_5000_volumes: ROOT, "5000 volumes", catalog_of(5000);
    catalog_counts_more_than_it_has: ROOT, "2 volumes", in_catalog(2, &[2]);
    catalog_counts_65535: ROOT, "65535 volumes", in_catalog(2, &[255, 255]);
    catalog_with_a_name_too_long: ROOT, "name", with(|piece| {
        if let Piece::Entry(entry) = piece { entry.name = vec![b'x'; 256]; }
    });
    catalog_with_a_name_beyond_its_end: ROOT, "name", in_catalog(8 + 54, &[255, 0]);
    catalog_with_a_name_not_utf8: ROOT, "UTF-8", with(|piece| {
        if let Piece::Entry(entry) = piece { entry.name = vec![b'a', 0xff, 0xfe]; }
    });
    catalog_with_bytes_left_over: ROOT, "left over", with(|piece| {
        if let Piece::Catalog(record) = piece { record.payload.extend([0; 8]); }
    });
    catalog_empty: ROOT, "version", with(|piece| {
        if let Piece::Catalog(record) = piece { record.payload.clear(); }
    });
    catalog_of_a_mebibyte_and_more: ROOT, "outside of the log", with(|piece| {
        if let Piece::Catalog(record) = piece { record.payload.resize(4 << 20, 0); }
    });
    catalog_root_level_too_high: ROOT, "level 7", in_catalog(8 + 48, &[7]);
    catalog_root_level_0: ROOT, "level 0", in_catalog(8 + 48, &[0]);
    catalog_root_level_255: ROOT, "level 255", in_catalog(8 + 48, &[255]);
    catalog_level_without_root: ROOT, "level 1", with(|piece| {
        if let Piece::Entry(entry) = piece { entry.root = Ref::default(); }
    });
    catalog_root_is_the_attributes: ROOT, "", with(|piece| {
        if let Piece::Entry(entry) = piece { entry.root = entry.attributes; }
    });
    catalog_root_of_4_gib: ROOT, "4294967295", in_catalog(8 + 40, &[255; 4]);
    catalog_root_at_the_catalog: ROOT, "", patched(Plan::SMALL, |b| {
        let catalog = image::of_kind(b, kind::CATALOG)[0];
        put(b, catalog.payload() + 8 + 32, (catalog.at as u64).to_le_bytes());
    });
    history_is_the_attributes: ROOT, "history", with(|piece| {
        if let Piece::Entry(entry) = piece { entry.history = entry.attributes; }
    });
    history_beyond_the_log: ROOT, "outside of the log", in_catalog(8 + 16, &(1u64 << 60).to_le_bytes());
    history_of_more_than_a_mebibyte: ROOT, "outside of the log", with(|piece| {
        if let Piece::History(record) = piece { record.payload.resize((1 << 20) + 8, 0); }
    });

    // Attributes.
    attributes_of_a_later_version: ROOT, "version", attributes(0, &[2]);
    attributes_too_short: ROOT, "length", with(|piece| {
        if let Piece::Attributes(record) = piece { record.payload.truncate(200); }
    });
    attributes_too_long: ROOT, "length", with(|piece| {
        if let Piece::Attributes(record) = piece { record.payload.push(0); }
    });
    attributes_of_more_than_a_mebibyte: ROOT, "outside of the log", with(|piece| {
        if let Piece::Attributes(record) = piece { record.payload.resize((1 << 20) + 1, 0); }
    });
    attributes_missing: ROOT, "attributes", in_catalog(8, &[0; 16]);
    sample_type_unknown: ROOT, "sample type number 8", attributes(2, &[8]);
    sample_type_wider_than_the_bricks: ROOT, "inner node", patched(Plan::SMALL, |b| {
        let record = image::of_kind(b, kind::ATTRIBUTES)[0];
        b[record.payload() + 2] = 3;
    });
    channels_3: ROOT, "channels", attributes(3, &[3]);
    channels_0: ROOT, "channels", attributes(3, &[0]);
    kind_unknown: ROOT, "kind number 5", attributes(4, &[5]);
    unit_unknown: ROOT, "unit number 5", attributes(5, &[5]);
    position_unknown: ROOT, "position", attributes(6, &[1]);
    brick_edge_1: ROOT, "brick edge 1", attributes(7, &[0]);
    brick_edge_4: ROOT, "brick edge 4", attributes(7, &[2]);
    brick_edge_128: ROOT, "brick edge", attributes(7, &[7]);
    brick_edge_2_to_the_255: ROOT, "brick edge", attributes(7, &[255]);
    background_no_sample: ROOT, "background", attributes(8, &256u32.to_le_bytes());
    minimum_no_sample: ROOT, "minimum", attributes(16, &[255; 4]);
    minimum_above_maximum: ROOT, "range", patched(Plan::SMALL, |b| {
        let at = image::of_kind(b, kind::ATTRIBUTES)[0].payload();
        (b[at + 16], b[at + 20]) = (200, 100);
    });
    range_not_of_the_samples: ROOT, "range", attributes(20, &[254, 0, 0, 0]);
    nan_mark_of_bytes: ROOT, "range", attributes(24, &[1]);
    nan_mark_2: ROOT, "NaN", attributes(24, &[2]);
    dimension_0: ROOT, "no samples", attributes(56, &[0; 4]);
    dimension_beyond_the_limit: ROOT, "134217728", empty_of([(1 << 27) + 1, 1, 1], 6);
    dimension_of_32_bits: ROOT, "coordinates", empty_of([u32::MAX; 3], 6);
    dimensions_with_too_many_bricks: ROOT, "bricks", empty_of([1 << 27, 8, 8], 3);
    origin_beyond_the_coordinates: ROOT, "coordinates", attributes(32, &(1i64 << 31).to_le_bytes());
    origin_at_the_end_of_numbers: ROOT, "coordinates", attributes(40, &i64::MAX.to_le_bytes());
    domain_ends_beyond_the_coordinates: ROOT, "coordinates", attributes(48, &i64::from(i32::MAX - 3).to_le_bytes());
    matrix_nan: ROOT, "not finite", attributes(72, &NAN);
    matrix_infinite: ROOT, "not finite", attributes(96, &INFINITY);
    matrix_flat: ROOT, "flattens", attributes(72, &[0; 96]);
    matrix_determinant_overflows: ROOT, "determinant", patched(Plan::SMALL, |b| {
        let at = image::of_kind(b, kind::ATTRIBUTES)[0].payload() + 72;
        for a in 0..3 { put(b, at + 40 * a, 1e200f64.to_le_bytes()); }
    });
    matrix_determinant_underflows: ROOT, "determinant", patched(Plan::SMALL, |b| {
        let at = image::of_kind(b, kind::ATTRIBUTES)[0].payload() + 72;
        for a in 0..3 { put(b, at + 40 * a, 1e-200f64.to_le_bytes()); }
    });
    counts_of_bricks_lie: None, "count", attributes(168, &[255; 8]);
    counts_of_tiles_lie: None, "count", attributes(176, &[255; 16]);

    // Node pages.
    page_of_another_level: ROOT, "level 2", root_page(0, &[2]);
    page_of_level_0: ROOT, "level 0", root_page(0, &[0]);
    page_of_another_place: ROOT, "[8, 0, 0]", root_page(8, &[8]);
    page_record_of_another_level: ROOT, "another place", record(Plan::SMALL, kind::PAGE, 0, 34, &[2]);
    page_record_of_another_key: ROOT, "another place", record(Plan::SMALL, kind::PAGE, 0, 24, &[1]);
    page_record_of_another_volume: ROOT, "belongs to volume 1", record(Plan::SMALL, kind::PAGE, 0, 32, &[1]);
    page_too_short: ROOT, "page of 100 bytes", with(|piece| {
        if let Piece::Page(1, record, _) = piece { record.payload.truncate(100); }
    });
    page_with_a_byte_too_many: ROOT, "children", with(|piece| {
        if let Piece::Page(1, record, _) = piece { record.payload.push(0); }
    });
    page_longer_than_any: ROOT, "13088", with(|piece| {
        if let Piece::Page(1, record, _) = piece { record.payload.resize(13096, 0); }
    });
    page_of_all_children: ROOT, "children", root_page(24, &[255; 64]);
    page_slot_in_both_masks: ROOT, "both", with(|piece| {
        if let Piece::Page(1, record, _) = piece {
            // Slot 2 is a child; make it a tile too.
            record.payload[88] |= 4;
            record.payload.extend([0; 4]);
        }
    });
    page_child_outside_of_the_domain: ROOT, "outside of the domain", slots(|refs| {
        vec![(511, Slot::Child(refs[0], [0, 255]))]
    });
    page_tile_outside_of_the_domain: ROOT, "outside of the domain", slots(|_| vec![(300, Slot::Tile(1))]);
    page_nan_in_bytes: ROOT, "range", root_page(152, &[4]);
    page_nan_in_an_absent_slot: ROOT, "absent", root_page(152, &[2]);
    page_nan_in_a_tile_of_bytes: ROOT, "NaN", root_page(152, &[1]);
    page_tile_no_sample: ROOT, "no sample", root_page(ranges_at() - 4, &300u32.to_le_bytes());
    page_range_no_sample: ROOT, "sample type", root_page(ranges_at(), &[255; 4]);
    page_range_upside_down: ROOT, "empty", root_page(ranges_at(), &[255, 0, 0, 0, 0, 0, 0, 0]);
    page_inner_range_too_narrow: ROOT, "inner node 0", with(|piece| {
        if let Piece::Page(1, record, _) = piece {
            let whole = record.payload.len() - 584;
            record.payload[whole + 4] -= 1;
        }
    });
    page_child_range_is_not_of_its_samples: None, "range stored", slots(|refs| {
        let all = Plan::SMALL.file(&|_| {});
        let page = image::of_kind(&all, kind::PAGE)[0];
        let payload = &all[page.payload()..][..page.length];
        let mask = u64_at(payload, 24);
        let mut n = 0;
        let mut out = vec![(0, Slot::Tile(9))];
        for slot in 1..64 {
            if mask >> slot & 1 != 0 {
                // As wide as the whole range, which stays true.
                let whole = payload.len() - 584;
                out.push((slot, Slot::Child(refs[n], [payload[whole], payload[whole + 4]])));
                n += 1;
            }
        }
        out
    });
    page_child_is_itself: ROOT, "a child at offset", patched(Plan::SMALL, |b| {
        let page = image::of_kind(b, kind::PAGE)[0];
        put(b, page.payload() + 216, (page.at as u64).to_le_bytes());
    });
    page_child_after_its_parent: ROOT, "a child at offset", patched(Plan::SMALL, |b| {
        let [page, later] = [kind::PAGE, kind::ATTRIBUTES].map(|k| image::of_kind(b, k)[0]);
        put(b, page.payload() + 216, (later.at as u64).to_le_bytes());
    });
    page_child_overlaps_its_parent: ROOT, "a child at offset", patched(Plan::SMALL, |b| {
        let page = image::of_kind(b, kind::PAGE)[0];
        put(b, page.payload() + 216, (page.at as u64 - 16).to_le_bytes());
    });
    page_child_before_the_log: ROOT, "a child at offset 4096", root_page(216, &4096u64.to_le_bytes());
    page_child_offset_overflows: ROOT, "a child at offset", root_page(216, &(u64::MAX - 7).to_le_bytes());
    page_child_off_the_grid: ROOT, "a child at offset", root_page(216, &16389u64.to_le_bytes());
    page_child_of_4_gib: ROOT, "4294967295", root_page(224, &[255; 4]);
    page_child_longer_than_a_brick: ROOT, "513", root_page(224, &513u32.to_le_bytes());
    page_cycle_through_two_levels: DAMAGED, "a child at offset", patched(Plan::LONG, |b| {
        let pages = image::of_kind(b, kind::PAGE);
        let root = pages.last().expect("a root").at as u64;
        put(b, pages[0].payload() + 216, root.to_le_bytes());
    });
    page_shared_by_two_slots: DAMAGED, "another place", Plan::LONG.file(&|piece| {
        if let Piece::Page(2, record, refs) = piece {
            let range = [record.payload[record.payload.len() - 584], record.payload[record.payload.len() - 580]];
            let twice = [0, 1].map(|slot| (slot, Slot::Child(refs[0], range)));
            record.payload = page(2, [10, 1, 1], &twice);
        }
    });
    brick_shared_by_two_slots: DAMAGED, "another place", patched(Plan::SMALL, |b| {
        let payload = image::of_kind(b, kind::PAGE)[0].payload();
        b.copy_within(payload + 216..payload + 232, payload + 232);
    });
    page_where_a_brick_belongs: DAMAGED, "its place has 552", patched(Plan::LONG, |b| {
        // The second leaf page takes the first one as its brick.
        let pages = image::of_kind(b, kind::PAGE);
        let at = pages[1].payload() + 216;
        put(b, at, (pages[0].at as u64).to_le_bytes());
        put(b, at + 8, 512u32.to_le_bytes());
    });

    // Bricks.
    brick_record_of_another_key: DAMAGED, "another place", brick(|r| r.key = morton([2, 1, 1]));
    brick_record_of_a_level: DAMAGED, "another place", brick(|r| r.level = 1);
    brick_record_of_another_volume: DAMAGED, "belongs to volume 1", brick(|r| r.volume = 1);
    brick_record_of_another_kind: DAMAGED, "of kind 7", brick(|r| r.kind = kind::HISTORY);
    brick_record_of_an_unknown_kind: DAMAGED, "of kind 99", brick(|r| r.kind = 99);
    brick_record_of_the_future: DAMAGED, "generation 9", record(Plan::SMALL, kind::BRICK, 1, 16, &[9]);
    brick_record_reserved_byte: DAMAGED, "reserved byte", record(Plan::SMALL, kind::BRICK, 1, 35, &[1]);
    brick_record_without_magic: DAMAGED, "no record", {
        let mut bytes = Plan::SMALL.file(&|_| {});
        let at = image::of_kind(&bytes, kind::BRICK)[1].at;
        bytes[at] = b'X';
        bytes
    };
    brick_record_stale: DAMAGED, "another record", {
        // A sound record of another content in the place of the one that the page knows.
        let mut bytes = Plan::SMALL.file(&|_| {});
        let at = image::of_kind(&bytes, kind::BRICK)[1];
        let seed = image::crc32c(0, &image::get::<16>(&bytes, 40));
        bytes[at.payload()] ^= 1;
        let crc = image::crc32c(seed, &bytes[at.at..at.at + 36]);
        let crc = image::crc32c(crc, &bytes[at.payload()..at.end()]);
        put(&mut bytes, at.at + 36, crc.to_le_bytes());
        bytes
    };
    brick_decoded_length_lies: DAMAGED, "size", brick(|r| r.decoded = 1 << 30);
    brick_decoded_length_1: DAMAGED, "size", brick(|r| r.decoded = 1);
    brick_of_an_unknown_codec: DAMAGED, "unknown codec", brick(|r| r.codec = 7);
    brick_of_codec_255: DAMAGED, "unknown codec", brick(|r| r.codec = 255);
    brick_of_a_codec_of_floats: DAMAGED, "does not fit", brick(|r| r.codec = 5);
    brick_of_another_codec_of_floats: DAMAGED, "does not fit", brick(|r| r.codec = 6);
    brick_as_it_is_too_short: DAMAGED, "differs", stored(0, &[7; 511]);
    brick_empty: DAMAGED, "differs", stored(0, &[]);
    brick_longer_than_decoded: ROOT, "520", stored(1, &[7; 520]);
    brick_lz4_bomb: DAMAGED, "malformed", stored(1, &lz4_run(1 << 16));
    brick_lz4_too_short: DAMAGED, "too short", stored(1, &lz4_run(400));
    brick_lz4_reaches_before_its_start: DAMAGED, "malformed", stored(1, &[0x1f, 7, 9, 0, 200, 0x50, 1, 2, 3, 4, 5]);
    brick_lz4_offset_0: DAMAGED, "malformed", stored(1, &[0x1f, 7, 0, 0, 255, 235, 0x50, 1, 2, 3, 4, 5]);
    brick_lz4_length_without_end: DAMAGED, "malformed", stored(1, &[255; 500]);
    brick_planes_cut_off: DAMAGED, "cut off", stored(3, &[0, 2]);
    brick_plane_longer_than_the_rest: DAMAGED, "cut off", stored(3, &[255, 255, 255, 255, 1, 2, 3]);
    brick_planes_left_over: DAMAGED, "left over", {
        let run = lz4_run(512);
        stored(3, &[&(run.len() as u32).to_le_bytes()[..], &run, &[0]].concat())
    };
    brick_plane_bomb: DAMAGED, "malformed", {
        let run = lz4_run(1 << 16);
        stored(4, &[&(run.len() as u32).to_le_bytes()[..], &run].concat())
    };
}

#[test]
fn there_are_enough_hostile_files() {
    assert!(CASES.len() >= 60, "{}", CASES.len());
    let mut files: Vec<Vec<u8>> = CASES.iter().map(|c| (c.build)()).collect();
    files.sort();
    files.dedup();
    assert!(files.len() >= CASES.len() - 2, "cases repeat each other");
    assert_eq!(Image::new([0; 16]).bytes.len(), LOG + 4136);
}

/// What the superblocks and the footer say of live and dead bytes and of the generation is a count that a
/// commit adds to.
#[test]
fn fuzz_open_and_read_all_counts_that_overflow_in_a_commit() {
    use brickmarch::store::{VolumeSpec, VolumeWriter};
    use brickmarch::{Grid, SampleType};
    let budget = Budget::mib(16);
    let spec = VolumeSpec {
        brick_edge: 8,
        ..VolumeSpec::new(Grid::new(Box3::from_size([20, 9, 8])), SampleType::U16)
    };
    let name = Path::new("counts.bvol");
    let storage = Arc::new(MemoryStorage::default());
    let writer = VolumeWriter::create_in(storage.clone(), name, &spec, &budget).expect("made");
    writer.put_brick([0, 1, 0], &[7; 1024]).expect("put");
    writer.finish().expect("finished");
    let whole = storage.to_vec();
    let footer = image::of_kind(&whole, image::kind::FOOTER)[0].payload();
    for (in_superblock, in_footer, value) in [
        (48, 48, u64::MAX),
        (48, 48, u64::MAX - 100),
        (56, 56, u64::MAX),
        (56, 56, u64::MAX - 100),
    ] {
        let mut bytes = whole.clone();
        for slot in [1, 2].map(image::superblock_of) {
            image::put(&mut bytes, slot + in_superblock, value.to_le_bytes());
        }
        image::put(&mut bytes, footer + in_footer, value.to_le_bytes());
        image::reseal(&mut bytes);
        let storage = Arc::new(MemoryStorage::new(bytes));
        let writer = VolumeWriter::open_in(storage.clone(), name, &budget).expect("opens");
        writer.put_constant([0; 3], 0, 3.0).expect("put");
        writer.commit().expect("committed");
        drop(writer);
        let volume = Volume::open_in(storage, name, &budget).expect("opens");
        assert_eq!(
            volume.range(Box3::from_size([8, 8, 8])).expect("known").max,
            3.0
        );
    }
}
