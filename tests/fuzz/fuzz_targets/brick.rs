//! A stored brick; the first two bytes choose sample type and codec.
#![no_main]
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Some((how, stored)) = data.split_first_chunk() {
        brickmarch::store::fuzzing::brick(*how, stored);
    }
});
