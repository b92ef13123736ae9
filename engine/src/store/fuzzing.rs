//! Private decoders for the fuzz targets of `tests/fuzz`. No part of the interface: only with the
//! feature `fuzzing`.

use super::catalog::{decode_attributes, decode_catalog, encode_attributes};
use super::codec::{Choice, Encoder, decode};
use super::layout::brick_bytes;
use super::meta;
use super::page::{Page, PageRules};
use crate::sample::SampleType;

fn sample_of(byte: u8) -> SampleType {
    SampleType::ALL[usize::from(byte) % SampleType::ALL.len()]
}

/// Decodes `payload` as a node page; a page that is accepted must encode to the same rules.
///
/// # Panics
/// When decoding and encoding disagree.
pub fn page(how: [u8; 4], payload: &[u8]) {
    let sample = sample_of(how[0]);
    let level = how[1] % 7 + 1;
    let rules = PageRules {
        sample,
        background: 0,
        bricks: [
            8 << (3 * (level - 1)),
            u32::from(how[2]) + 1,
            u32::from(how[3]) + 1,
        ],
        brick_bytes: brick_bytes(sample, 8) as u32,
    };
    let Ok(page) = Page::decode(&rules, level, [0; 3], 1 << 40, payload) else {
        return;
    };
    let again = page.encode(&rules);
    let back = Page::decode(&rules, level, [0; 3], 1 << 40, &again).expect("its own output");
    assert_eq!(page.whole(), back.whole());
    assert!(page.slots().eq(back.slots()));
    assert_eq!(again.len(), payload.len());
}

/// Decodes `stored` as a brick of a codec, and encodes it as a brick and back.
///
/// # Panics
/// When a brick does not come back as it was.
pub fn brick(how: [u8; 2], stored: &[u8]) {
    let sample = sample_of(how[0]);
    let mut out = vec![0; brick_bytes(sample, 8)];
    let mut scratch = Vec::new();
    // Damaged streams give an error or some samples; whatever comes is as long as the brick.
    let _ = decode(how[1], stored, sample, 8, &mut out, &mut scratch);
    assert!(scratch.len() <= 2 * out.len());
    for (byte, value) in out.iter_mut().zip(stored) {
        *byte = *value;
    }
    let (mut packed, mut back) = (Vec::new(), vec![0; out.len()]);
    let choice = Choice {
        rows: true,
        fitted: true,
        binary: true,
        smallest: how[1] & 1 == 0,
    };
    let codec = Encoder::default().encode(sample, 8, &out, choice, &mut packed);
    decode(codec, &packed, sample, 8, &mut back, &mut scratch).expect("its own output");
    assert!(back == out, "the brick changed");
}

/// Decodes `payload` as catalog, as attributes and as history.
///
/// # Panics
/// When attributes that were accepted do not come back.
pub fn catalog(payload: &[u8]) {
    if let Ok(entries) = decode_catalog(payload) {
        assert!(entries.len() <= 4096);
    }
    if let Ok((spec, range, counts)) = decode_attributes(payload) {
        spec.validate().expect("accepted");
        let again = encode_attributes(&spec, range, &counts);
        decode_attributes(&again).expect("its own output");
    }
    let _ = meta::decode(payload);
}
