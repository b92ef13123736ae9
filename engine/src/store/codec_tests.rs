//! Round trips, choices and damage of all codecs.

use super::*;

/// Deterministic bricks: smooth, noisy, with few values, and with extreme bit patterns.
fn bricks(sample: SampleType, edge: u32) -> Vec<Vec<u8>> {
    let n = (edge * edge * edge) as usize;
    let mut state = 88_172_645_463_325_252u64;
    let mut noise = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let position = |i: usize| {
        let e = edge as usize;
        [i % e, i / e % e, i / e / e].map(|v| v as f64 * 0.05)
    };
    let mut all: Vec<Vec<f64>> = vec![
        (0..n)
            .map(|i| position(i).iter().map(|v| v.sin() * v.cos()).sum::<f64>() * 100.0)
            .collect(),
        (0..n).map(|_| (noise() % 7) as f64).collect(),
        (0..n).map(|i| f64::from(u8::from(i == n / 2))).collect(),
        vec![0.0; n],
    ];
    all.push((0..n).map(|_| noise() as i32 as f64).collect());
    let to_bytes = |values: &Vec<f64>| {
        let mut raw = vec![0; n * sample.bytes()];
        for (value, bytes) in values.iter().zip(raw.chunks_mut(sample.bytes())) {
            sample.put(*value, bytes);
        }
        raw
    };
    let mut raws: Vec<Vec<u8>> = all.iter().map(to_bytes).collect();
    if sample == SampleType::F32 {
        let odd = [
            f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            -0.0,
            1e-42,
            f32::MAX,
            f32::MIN,
        ];
        raws.push(
            (0..n)
                .flat_map(|_| odd[noise() as usize % odd.len()].to_le_bytes())
                .collect(),
        );
        raws.push(
            (0..n)
                .flat_map(|_| (noise() as u32).to_le_bytes())
                .collect(),
        );
    }
    if sample == SampleType::Bit {
        for raw in &mut raws {
            let mut packed = vec![0; n / 8];
            pack_bits(raw, &mut packed);
            *raw = packed;
        }
    }
    raws
}

fn codecs(sample: SampleType) -> Vec<u8> {
    let last = match sample {
        SampleType::Bit => 1,
        SampleType::F32 => CODEC_ROWS,
        _ => 4,
    };
    let fitted = [CODEC_FITTED, CODEC_CODED].into_iter();
    (0..=last)
        .chain(fitted.filter(|_| fitted::is_for(sample)))
        .collect()
}

const ALL: Choice = Choice {
    rows: true,
    fitted: true,
    binary: true,
    smallest: true,
};

#[test]
fn codec_packs_bits_of_any_bytes_but_zero() {
    let raw: Vec<u8> = (0..4096u32)
        .map(|n| ((n * n) >> 5) as u8 & (n >> 3) as u8)
        .collect();
    let mut packed = vec![0; raw.len() / 8];
    pack_bits(&raw, &mut packed);
    for (i, &byte) in raw.iter().enumerate() {
        assert_eq!(bit_at(&packed, i), u8::from(byte != 0), "{i}");
    }
}

#[test]
fn codec_round_trip() {
    let mut encoder = Encoder::default();
    let (mut scratch, mut stored) = (Vec::new(), Vec::new());
    for sample in SampleType::ALL {
        for edge in [8, 16, 32] {
            for brick in bricks(sample, edge) {
                stored.clear();
                let codec = encoder.encode(sample, edge, &brick, ALL, &mut stored);
                assert!(stored.len() <= brick.len());
                let mut back = vec![0xaa; brick.len()];
                decode(codec, &stored, sample, edge, &mut back, &mut scratch).expect("decodes");
                assert!(back == brick, "{sample:?} {edge} codec {codec}");
                for codec in codecs(sample) {
                    stored.clear();
                    encoder.encode_as(codec, sample, edge, &brick, &mut stored);
                    back.fill(0xaa);
                    let result = decode(codec, &stored, sample, edge, &mut back, &mut scratch);
                    let kept = stored.len() <= brick.len();
                    assert_eq!(result.is_ok(), kept, "{sample:?} {edge} codec {codec}");
                    assert!(!kept || back == brick, "{sample:?} {edge} codec {codec}");
                }
            }
        }
    }
}

#[test]
fn codec_rows_and_fits_only_where_the_file_allows_them() {
    let mut encoder = Encoder::default();
    let mut chosen = Vec::new();
    for brick in bricks(SampleType::F32, 16) {
        let mut encode =
            |choice| encoder.encode(SampleType::F32, 16, &brick, choice, &mut Vec::new());
        assert_ne!(encode(Choice::default()), CODEC_ROWS);
        chosen.push(encode(ALL));
    }
    assert_eq!(chosen[0], CODEC_ROWS, "smooth: {chosen:?}");
    for sample in [SampleType::U8, SampleType::I16] {
        let brick = &bricks(sample, 16)[0];
        let mut encode = |choice| encoder.encode(sample, 16, brick, choice, &mut Vec::new());
        assert!(encode(Choice::default()) < CODEC_ROWS);
        assert_eq!(encode(ALL), CODEC_CODED);
    }
}

/// An entropy coder saves little over packing where all residuals are about as large, and much where
/// one in a few is larger than the others.
#[test]
fn codec_fast_takes_the_slow_decoder_only_for_bytes_where_it_saves_an_eighth() {
    let fast = Choice {
        smallest: false,
        ..ALL
    };
    let mut encoder = Encoder::default();
    let mut seed = 9u64;
    let mut noise = |floor: u64| {
        seed = seed.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
        let r = seed >> 33;
        let most = if r.is_multiple_of(16) { 127 } else { floor };
        100 + (r >> 4 & most) as u8
    };
    let even: Vec<u8> = (0..4096).map(|_| noise(127)).collect();
    let spiky: Vec<u8> = (0..4096).map(|_| noise(15)).collect();
    let wide = |bytes: &[u8]| bytes.iter().flat_map(|&b| [b, 0]).collect::<Vec<u8>>();
    let mut encode = |sample, brick: &[u8], choice| {
        let mut out = Vec::new();
        (
            encoder.encode(sample, 16, brick, choice, &mut out),
            out.len(),
        )
    };
    let (u8, i16) = (SampleType::U8, SampleType::I16);
    assert_eq!(encode(u8, &even, fast).0, CODEC_FITTED);
    let (codec, coded) = encode(u8, &spiky, fast);
    assert_eq!(codec, CODEC_CODED);
    assert_eq!(encode(i16, &wide(&spiky), fast).0, CODEC_FITTED);
    let packed = {
        let mut out = Vec::new();
        encoder.encode_as(CODEC_FITTED, u8, 16, &spiky, &mut out);
        out.len()
    };
    assert!(coded * 8 <= packed * 7, "{coded} of {packed}");
}

#[test]
fn codec_bytes_do_not_depend_on_what_came_before() {
    let brick = &bricks(SampleType::F32, 32)[0];
    let encode = |encoder: &mut Encoder| {
        let mut out = Vec::new();
        (
            encoder.encode(SampleType::F32, 32, brick, ALL, &mut out),
            out,
        )
    };
    let fresh = encode(&mut Encoder::default());
    let mut used = Encoder::default();
    for other in bricks(SampleType::U32, 64) {
        used.encode(SampleType::U32, 64, &other, ALL, &mut Vec::new());
    }
    assert!(encode(&mut used) == fresh);
}

#[test]
fn codec_empty_and_every_truncation_and_extra_bytes() {
    let mut encoder = Encoder::default();
    let mut scratch = Vec::new();
    for sample in [
        SampleType::Bit,
        SampleType::U8,
        SampleType::I16,
        SampleType::F32,
    ] {
        let brick = &bricks(sample, 8)[0];
        let mut out = vec![0; brick.len()];
        for codec in codecs(sample) {
            let mut stored = Vec::new();
            encoder.encode_as(codec, sample, 8, brick, &mut stored);
            for end in 0..stored.len() {
                let cut = decode(codec, &stored[..end], sample, 8, &mut out, &mut scratch);
                assert!(cut.is_err(), "{sample:?} codec {codec} cut to {end}");
            }
            stored.push(0);
            assert!(decode(codec, &stored, sample, 8, &mut out, &mut scratch).is_err());
        }
        for codec in CODEC_BINARY + 1..=255 {
            assert!(decode(codec, brick, sample, 8, &mut out, &mut scratch).is_err());
        }
    }
    let mut out = vec![0; brick_bytes(SampleType::I16, 8)];
    for codec in [5, CODEC_ROWS] {
        assert!(decode(codec, &[0; 16], SampleType::I16, 8, &mut out, &mut scratch).is_err());
    }
    for codec in [CODEC_FITTED, CODEC_CODED] {
        assert!(decode(codec, &[0; 16], SampleType::I32, 8, &mut out, &mut scratch).is_err());
    }
    let mut out = vec![0; brick_bytes(SampleType::F32, 8)];
    assert!(
        decode(
            CODEC_BINARY,
            &[0; 16],
            SampleType::F32,
            8,
            &mut out,
            &mut scratch
        )
        .is_err()
    );
}

/// Damage gives an error or some value, never a panic; checksums are the record's business.
#[test]
fn codec_every_bit_flip_and_huge_declared_size() {
    let mut encoder = Encoder::default();
    let mut scratch = Vec::new();
    for sample in [SampleType::U8, SampleType::F32] {
        let brick = &bricks(sample, 8)[0];
        let mut out = vec![0; brick.len()];
        for codec in codecs(sample) {
            let mut stored = Vec::new();
            encoder.encode_as(codec, sample, 8, brick, &mut stored);
            for bit in 0..stored.len() * 8 {
                let mut bad = stored.clone();
                bad[bit / 8] ^= 1 << (bit % 8);
                let _any = decode(codec, &bad, sample, 8, &mut out, &mut scratch);
                assert_eq!(out.len(), brick.len());
            }
            if codec >= FIRST_FILTER {
                // Length of the first plane, or of the masks.
                let at = match codec {
                    CODEC_ROWS | CODEC_FITTED | CODEC_CODED => 8,
                    _ => 0,
                };
                stored[at..at + 4].fill(0xff);
                assert!(decode(codec, &stored, sample, 8, &mut out, &mut scratch).is_err());
            }
        }
    }
    assert!(
        scratch.len() <= 8 * 8 * 8 * 4,
        "no allocation beyond the brick"
    );
}

#[test]
fn bits_pack_and_unpack() {
    let raw: Vec<u8> = (0..512u32).map(|i| u8::from(i * i % 5 < 2)).collect();
    let mut packed = vec![0; 64];
    pack_bits(&raw, &mut packed);
    assert!((0..512).all(|i| bit_at(&packed, i) == raw[i]));
}
