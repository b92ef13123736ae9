//! Any bytes as a volume file.
#![no_main]
use libfuzzer_sys::fuzz_target;

#[path = "../read.rs"]
mod read;

fuzz_target!(|data: &[u8]| read::everything(data.to_vec()));
