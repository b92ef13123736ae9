//! Catalog, attributes and history payloads.
#![no_main]
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| brickmarch::store::fuzzing::catalog(data));
