//! Hostile attributes and node pages.

use super::super::handmade::{Piece, Plan, Slot, page};
use super::super::image::{self, kind, put, u64_at};
use super::spoil::*;
use super::{Case, DAMAGED, ROOT, check, hostile};

const NAN: [u8; 8] = f64::NAN.to_le_bytes();
const INFINITY: [u8; 8] = f64::INFINITY.to_le_bytes();

hostile! {
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
}
