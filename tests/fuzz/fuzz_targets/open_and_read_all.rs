//! A volume file whose checksums are made right, so that mutations reach what stands behind them.
#![no_main]
use libfuzzer_sys::fuzz_target;

#[path = "../../store/image.rs"]
#[allow(dead_code)]
mod image;
#[path = "../read.rs"]
mod read;

fuzz_target!(|data: &[u8]| {
    let mut bytes = data.to_vec();
    image::reseal(&mut bytes);
    read::everything(bytes);
});
