//! Sequences of operations on a volume file against plain arrays: `tests/store/operations.rs`.
#![no_main]
use libfuzzer_sys::fuzz_target;

#[path = "../../store/operations.rs"]
mod operations;

fuzz_target!(|data: &[u8]| operations::run(data));
