//! A node page payload, the first four bytes choose the rules.
#![no_main]
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Some((how, payload)) = data.split_first_chunk() {
        brickmarch::store::fuzzing::page(*how, payload);
    }
});
