//! Codecs 7 and 8 against plain arithmetic, at every level of the processor.

use super::*;

fn random(seed: &mut u64) -> u64 {
    *seed ^= *seed << 13;
    *seed ^= *seed >> 7;
    *seed ^= *seed << 17;
    *seed
}

const TYPES: [SampleType; 4] = [
    SampleType::U8,
    SampleType::I8,
    SampleType::U16,
    SampleType::I16,
];

/// Smooth with noise, smooth, few values, everything, one value.
fn bricks(sample: SampleType, edge: u32) -> Vec<Vec<u8>> {
    let mut seed = 11 + u64::from(edge);
    let e = edge as usize;
    let range = if sample.bytes() == 1 { 200.0 } else { 50_000.0 };
    let mut all = Vec::new();
    for kind in 0..6 {
        let mut raw = Vec::new();
        for n in 0..e * e * e {
            let [i, j, k] = [n % e, n / e % e, n / e / e].map(|v| v as f64);
            let smooth = ((i * 0.11).sin() + (j * 0.07 + k * 0.13).cos()) * 0.25 + 0.5;
            let noise = random(&mut seed);
            let value = match kind {
                0 => smooth * range + (noise % 16) as f64,
                1 => smooth * range,
                2 => (noise % 3) as f64 * 7.0,
                3 => noise as i32 as f64,
                4 => f64::from(u8::from(n == 5)) * range,
                _ => range - 3.0,
            };
            let bytes = (value as i64).to_le_bytes();
            raw.extend(&bytes[..sample.bytes()]);
        }
        all.push(raw);
    }
    all
}

fn value(sample: SampleType, raw: &[u8], at: usize) -> i64 {
    let w = sample.bytes();
    match (sample, &raw[at * w..][..w]) {
        (SampleType::U8, b) => b[0].into(),
        (SampleType::I8, b) => (b[0] as i8).into(),
        (SampleType::U16, b) => u16::from_le_bytes([b[0], b[1]]).into(),
        (_, b) => i16::from_le_bytes([b[0], b[1]]).into(),
    }
}

/// The residuals by the words of the document.
fn plain(fit: Fit, sample: SampleType, edge: usize, raw: &[u8]) -> Vec<u16> {
    let f = |i: usize, j: usize, k: usize| value(sample, raw, i + edge * (j + edge * k));
    let modulus = 1i64 << (8 * sample.bytes());
    let mut out = Vec::new();
    for n in 0..edge * edge * edge {
        let (i, j, k) = (n % edge, n / edge % edge, n / edge / edge);
        let guess = if j == 0 && k == 0 {
            if i == 0 { 0 } else { f(i - 1, 0, 0) }
        } else {
            let taps = if k == 0 {
                [f(i, j - 1, 0); 4]
            } else {
                let b = f(i, j, k - 1);
                let low = |b: i64, v: &dyn Fn() -> i64| if j == 0 { b } else { v() };
                [
                    low(b, &|| f(i, j - 1, k)),
                    b,
                    low(b, &|| f(i, j - 1, k - 1)),
                    if j + 1 == edge { b } else { f(i, j + 1, k - 1) },
                ]
            };
            let sum: i64 = taps
                .iter()
                .zip(fit.weights)
                .map(|(t, w)| t * i64::from(w))
                .sum();
            (sum + i64::from(fit.offset) + 32).div_euclid(64)
        };
        let d = (f(i, j, k) - guess).rem_euclid(modulus);
        let d = if d >= modulus / 2 { d - modulus } else { d };
        out.push(if d < 0 { -2 * d - 1 } else { 2 * d } as u16);
    }
    out
}

#[test]
fn bricks_come_back_at_every_level_and_residuals_are_those_of_the_document() {
    let mut encoder = FittedEncoder::default();
    for sample in TYPES {
        for edge in [8, 16, 32, 64] {
            for (kind, raw) in bricks(sample, edge).iter().enumerate() {
                let at = format!("{sample:?} {edge} kind {kind}");
                let mut stored: Vec<[Vec<u8>; 2]> = Vec::new();
                for &level in Level::available() {
                    encoder.predict_at(level, sample, edge, raw);
                    let mut forms = [Vec::new(), Vec::new()];
                    encoder.pack(&mut forms[0]);
                    encoder.code(sample, &mut forms[1]);
                    stored.push(forms);
                }
                assert!(stored.iter().all(|s| *s == stored[0]), "{at}");
                let fit = encoder.fit.expect("predicted");
                let words: Vec<u16> = encoder
                    .residuals
                    .iter()
                    .map(|w| u16::from_le_bytes(*w))
                    .collect();
                assert!(words == plain(fit, sample, edge as usize, raw), "{at}");
                for (form, stored) in stored[0].iter().enumerate() {
                    for &level in Level::available() {
                        let mut scratch = vec![[7; 2]; encoder.residuals.len()];
                        let mut back = vec![0xaa; raw.len()];
                        let kind = (sample, edge);
                        decode_at(level, form == 0, stored, kind, &mut back, &mut scratch)
                            .expect(&at);
                        assert!(back == *raw, "{at} {level:?} form {form}");
                    }
                }
                if kind == 0 && edge == 16 && sample.bytes() == 1 {
                    let [packed, coded] = stored[0].each_ref().map(Vec::len);
                    assert!(
                        coded < packed && packed < raw.len(),
                        "{at}: {coded} {packed}"
                    );
                }
            }
        }
    }
}

#[test]
fn noise_is_predicted_by_a_mean_and_slopes_by_an_extrapolation() {
    let mut seed = 3;
    let noise: Vec<u8> = (0..4096)
        .map(|_| 100 + (random(&mut seed) % 32) as u8)
        .collect();
    let slope: Vec<u8> = (0..4096u32)
        .map(|n| (n % 16 + 3 * (n / 16 % 16) + 9 * (n / 256)) as u8)
        .collect();
    let mut encoder = FittedEncoder::default();
    encoder.predict(SampleType::U8, 16, &noise);
    let mean = encoder.fit.expect("predicted");
    assert!(mean.weights.iter().all(|w| w.abs() < 12), "{mean:?}");
    encoder.predict(SampleType::U8, 16, &slope);
    let inner = |n: usize| (1..15).contains(&(n / 16 % 16)) && n >= 256;
    // Weights have steps of 1/64: a miss of one or two.
    let most = (0..4096)
        .filter(|&n| inner(n))
        .map(|n| u16::from_le_bytes(encoder.residuals[n]))
        .max();
    assert!(most <= Some(4), "{most:?}");
}

#[test]
fn changed_streams_are_refused_or_decode_to_something() {
    let mut encoder = FittedEncoder::default();
    let mut seed = 9;
    for sample in TYPES {
        for raw in bricks(sample, 8) {
            for form in 0..2 {
                let mut stored = Vec::new();
                encoder.predict(sample, 8, &raw);
                match form {
                    0 => encoder.pack(&mut stored),
                    _ => encoder.code(sample, &mut stored),
                }
                let mut scratch = vec![[0; 2]; 512];
                let mut out = vec![0; raw.len()];
                for cut in 0..stored.len() {
                    let result =
                        decode(form == 0, &stored[..cut], sample, 8, &mut out, &mut scratch);
                    assert!(result.is_err(), "cut at {cut}");
                }
                for _ in 0..500 {
                    let mut bad = stored.clone();
                    let at = random(&mut seed) as usize % bad.len();
                    bad[at] ^= 1 << (random(&mut seed) % 8);
                    let _ = decode(form == 0, &bad, sample, 8, &mut out, &mut scratch);
                }
                stored.push(0);
                assert!(decode(form == 0, &stored, sample, 8, &mut out, &mut scratch).is_err());
            }
        }
    }
}
