//! Raw samples of a fuzzed layout.
#![no_main]
use brickmarch::SampleType;
use brickmarch_formats::{OpenOptions, RawLayout};
use libfuzzer_sys::fuzz_target;

#[path = "../file.rs"]
mod file;

fuzz_target!(|data: &[u8]| {
    let Some((head, rest)) = data.split_first_chunk::<36>() else {
        return;
    };
    let word = |n: usize| u32::from_le_bytes([head[n], head[n + 1], head[n + 2], head[n + 3]]);
    let raw = RawLayout {
        // Mostly small dimensions, so that some layouts fit the file.
        dims: [4, 8, 12].map(|n| {
            if head[1] & 1 == 0 {
                word(n) % 9
            } else {
                word(n)
            }
        }),
        sample: SampleType::ALL[usize::from(head[0]) % SampleType::ALL.len()],
        big_endian: head[1] & 2 != 0,
        spacing: [16, 20, 24].map(|n| f64::from(f32::from_bits(word(n)))),
        offset: u64::from(word(28)) << (head[1] >> 2 & 31),
    };
    let options = OpenOptions {
        raw: Some(raw),
        volume: None,
    };
    file::import(
        if head[1] & 128 == 0 { "raw" } else { "raw.gz" },
        rest,
        &options,
    );
});
