//! Any bytes as a mesh file.
#![no_main]
use libfuzzer_sys::fuzz_target;

#[path = "../file.rs"]
mod file;

fuzz_target!(|data: &[u8]| file::mesh("obj", data));
