//! Any bytes as a metaimage file.
#![no_main]
use libfuzzer_sys::fuzz_target;

#[path = "../file.rs"]
mod file;

fuzz_target!(|data: &[u8]| file::import("mha", data, &Default::default()));
