//! Hostile bricks.

use super::super::handmade::{Plan, morton};
use super::super::image::{self, kind, put};
use super::spoil::*;
use super::{Case, DAMAGED, ROOT, check, hostile};

hostile! {
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
    brick_of_an_unknown_codec: DAMAGED, "unknown codec", brick(|r| r.codec = 10);
    brick_of_codec_255: DAMAGED, "unknown codec", brick(|r| r.codec = 255);
    brick_of_a_codec_of_floats: DAMAGED, "does not fit", brick(|r| r.codec = 5);
    brick_of_another_codec_of_floats: DAMAGED, "does not fit", brick(|r| r.codec = 6);
    brick_fitted_without_its_prediction: DAMAGED, "prediction is cut off", stored(7, &[0; 5]);
    brick_fitted_without_its_widths: DAMAGED, "widths are cut off", stored(7, &[&[0; 8][..], &[16, 0, 1]].concat());
    brick_fitted_of_bad_widths: DAMAGED, "malformed", stored(7, &[&[0; 8][..], &[3, 0, 1, 2, 3]].concat());
    brick_fitted_of_wide_words: DAMAGED, "none of those allowed", stored(7, &[&[0; 8][..], &[16, 0], &[0x99; 16]].concat());
    brick_fitted_without_words: DAMAGED, "residuals are cut off", stored(7, &[&[0; 8][..], &[16, 0], &[0x11; 16]].concat());
    brick_fitted_of_more_words: DAMAGED, "left over", stored(7, &[&[0; 8][..], &[16, 0], &[0; 17]].concat());
    brick_coded_of_another_plane: DAMAGED, "plane is malformed", stored(8, &[&[0; 8][..], &[3]].concat());
    brick_coded_table_of_too_much: DAMAGED, "plane is malformed", stored(8, &[&[0; 8][..], &[2, 1, 0x88, 0, 1], &[0; 20]].concat());
    brick_coded_table_without_end: DAMAGED, "plane is malformed", stored(8, &[&[0; 8][..], &[2, 255, 0, 255]].concat());
    brick_coded_of_4g_words: DAMAGED, "plane is malformed", stored(8, &[&[0; 8][..], &[2, 1, 0x84, 0, 0x84, 0], &[255; 20]].concat());
    brick_coded_of_too_few_words: DAMAGED, "plane is malformed", stored(8, &[&[0; 8][..], &[2, 1, 0x84, 0, 0x84, 0], &[0; 20]].concat());
    brick_coded_of_two_planes: DAMAGED, "left over", stored(8, &[&[0; 8][..], &[1, 7, 1, 7]].concat());
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
