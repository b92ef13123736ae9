//! Any bytes as a nifti file.
#![no_main]
use libfuzzer_sys::fuzz_target;

#[path = "../file.rs"]
mod file;

fuzz_target!(|data: &[u8]| file::import("nii", data, &Default::default()));
