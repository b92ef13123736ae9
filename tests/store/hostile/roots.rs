//! Hostile headers, superblocks, footers and catalogs.

use super::super::handmade::{Piece, Plan};
use super::super::image::{self, LOG, Ref, kind, put};
use super::spoil::*;
use super::{CUT, Case, DAMAGED, NEWER, OTHER, ROOT, check, hostile};

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
}
