//! Codec 6: round trips, equal bytes on all processors, streams that must be refused.

use super::*;

fn bytes_of(values: impl Iterator<Item = f32>) -> Vec<u8> {
    values.flat_map(f32::to_le_bytes).collect()
}

fn points(edge: usize) -> impl Iterator<Item = [f32; 3]> {
    (0..edge.pow(3)).map(move |n| [n % edge, n / edge % edge, n / edge / edge].map(|v| v as f32))
}

/// Bricks by what they are: bands with both, one and no clip value, special values, noise.
fn bricks(edge: usize) -> Vec<(&'static str, Vec<u8>)> {
    let distance = move |[x, y, z]: [f32; 3]| {
        let c = edge as f32 * 0.3;
        ((x - c).powi(2) + (y - 1.5 * c).powi(2) + (z - 2.0).powi(2)).sqrt() - 0.4 * edge as f32
    };
    let mut state = 7u32;
    let mut noise = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state ^ state >> 15
    };
    let band = |low: f32, high: f32| bytes_of(points(edge).map(|p| distance(p).clamp(low, high)));
    let specials = [
        f32::NAN,
        -f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        -0.0,
        0.0,
        1e-42,
        f32::MAX,
        f32::MIN,
    ];
    let mut all = vec![
        ("band", band(-2.0, 2.0)),
        ("clipped above", band(-1e9, 1.0)),
        ("clipped below", band(-1.0, 1e9)),
        ("dense", band(-1e9, 1e9)),
        (
            "planes along x",
            bytes_of(points(edge).map(|p| (p[0] - 4.0).clamp(-2.0, 2.0))),
        ),
        (
            "planes along y",
            bytes_of(points(edge).map(|p| (p[1] - 4.3).clamp(-2.0, 2.0))),
        ),
        (
            "planes along z",
            bytes_of(points(edge).map(|p| (p[2] - 4.1).clamp(-2.0, 2.0))),
        ),
        ("zero", vec![0; edge.pow(3) * 4]),
        (
            "two values",
            bytes_of(points(edge).map(|p| f32::from(u8::from(p[0] * p[1] > p[2])))),
        ),
        (
            "one sample",
            bytes_of(points(edge).map(|p| f32::from(u8::from(p == [3.0; 3])))),
        ),
    ];
    let n = edge.pow(3);
    all.push((
        "specials",
        bytes_of((0..n).map(|_| specials[noise() as usize % specials.len()])),
    ));
    all.push((
        "few specials in a band",
        bytes_of(points(edge).map(|p| match noise() % 40 {
            0 => specials[noise() as usize % specials.len()],
            _ => distance(p).clamp(-2.0, 2.0),
        })),
    ));
    all.push((
        "NaN beyond the band",
        bytes_of(points(edge).map(|p| match distance(p) {
            d if d.abs() < 2.0 => d,
            d => f32::NAN.copysign(d),
        })),
    ));
    all.push((
        "any bits",
        (0..n).flat_map(|_| noise().to_le_bytes()).collect(),
    ));
    // Words of every number of bits.
    let wide = |i: usize| f32::from_bits(0x3f80_0000 ^ (noise() >> (i * 32 / n)));
    all.push(("all widths", bytes_of((0..n).map(wide))));
    all
}

fn encoded(level: Level, edge: u32, raw: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    RowsEncoder::default().encode_at(level, edge, raw, &mut out);
    out
}

#[test]
fn rows_round_trip_on_all_levels() {
    for edge in [8u32, 16, 32, 64] {
        for (name, raw) in bricks(edge as usize) {
            let stored = encoded(Level::Portable, edge, &raw);
            assert_eq!(same_everywhere(&stored, edge, name), None, "{name} {edge}");
            let mut plain = RowsEncoder::default();
            plain.encode_all::<Portable>(edge, &raw);
            let parts = [&plain.codes[..], &plain.masks, &plain.widths, &plain.words];
            assert!(stored[HEADER..] == parts.concat(), "{name} {edge}");
            for &level in Level::available() {
                assert!(
                    encoded(level, edge, &raw) == stored,
                    "{name} {edge} {level:?}"
                );
                let mut back = vec![0xaa; raw.len()];
                vector::decode(level, &stored, edge, &mut back)
                    .unwrap_or_else(|e| panic!("{name} {edge} {level:?}: {e}"));
                assert!(back == raw, "{name} {edge} {level:?}");
            }
        }
    }
}

#[test]
fn rows_do_not_depend_on_what_came_before() {
    let mut encoder = RowsEncoder::default();
    for (name, raw) in bricks(16) {
        let mut out = vec![1, 2, 3];
        encoder.encode(16, &raw, &mut out);
        assert!(out[3..] == encoded(Level::detect(), 16, &raw), "{name}");
    }
}

#[test]
fn rows_of_a_band_are_small() {
    let (_, band) = &bricks(16)[0];
    let stored = encoded(Level::detect(), 16, band);
    assert!(stored.len() * 4 < band.len(), "{}", stored.len());
}

/// Whatever is in a stream, every level says the same of it: the same samples or the same error.
fn same_everywhere(stored: &[u8], edge: u32, what: &str) -> Option<&'static str> {
    let decoded = |level| {
        let mut out = vec![0; (edge * edge * edge * 4) as usize];
        let result = vector::decode(level, stored, edge, &mut out);
        result.map(|()| out)
    };
    let mut out = vec![0; (edge * edge * edge * 4) as usize];
    let plain = decode_all::<Portable>(stored, edge, &mut out);
    let want = plain.map(|()| out);
    for &level in Level::available() {
        assert!(decoded(level) == want, "{what} {level:?}");
    }
    want.err()
}

#[test]
fn rows_every_truncation_and_extra_bytes() {
    for (name, raw) in bricks(8) {
        let stored = encoded(Level::detect(), 8, &raw);
        for end in 0..stored.len() {
            let error = same_everywhere(&stored[..end], 8, name);
            assert!(error.is_some(), "{name} cut to {end} of {}", stored.len());
        }
        let mut longer = stored.clone();
        longer.push(0);
        assert_eq!(
            same_everywhere(&longer, 8, name),
            Some("bytes are left over")
        );
    }
}

#[test]
fn rows_every_bit_flip() {
    for (name, raw) in bricks(8).iter().take(4) {
        let stored = encoded(Level::detect(), 8, raw);
        for bit in 0..stored.len() * 8 {
            let mut bad = stored.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            same_everywhere(&bad, 8, name);
        }
    }
}

/// A stream of edge 8 from its parts.
fn stream(masks: &[u8], widths: &[u8], words: &[u8]) -> Vec<u8> {
    let mut out = vec![0; HEADER];
    put_u32(&mut out, 0, 1f32.to_bits());
    put_u32(&mut out, 4, 2f32.to_bits());
    put_u32(&mut out, 8, masks.len() as u32);
    put_u32(&mut out, 12, widths.len() as u32);
    [&out[..], masks, widths, words].concat()
}

/// Codes of 64 groups: the first as given, the others like those before along y (along z in the
/// first row of a slice).
fn codes(first: u8) -> [u8; 16] {
    let mut codes = [0; 16];
    codes[0] = first;
    for k in 1..8 {
        codes[2 * k] = LIKE_Z;
    }
    codes
}

#[test]
fn rows_hostile_masks() {
    let refused = |first: u8, mask: &[u8]| {
        let masks = [&codes(first)[..], mask].concat();
        same_everywhere(&stream(&masks, &[], &[]), 8, "mask").expect("refused")
    };
    let interval = |from: u16, to: u16, rest: u16| (from | to << 5 | rest << 10).to_le_bytes();
    assert_eq!(refused(2, &interval(5, 4, 0)), "a mask is no interval");
    assert_eq!(refused(2, &interval(0, 9, 0)), "a mask is no interval");
    assert_eq!(refused(2, &interval(31, 31, 0)), "a mask is no interval");
    assert_eq!(refused(2, &interval(8, 8, 4)), "a mask is no interval");
    assert_eq!(refused(2, &interval(8, 8, 32)), "a mask is no interval");
    assert_eq!(refused(2, &[0]), "a mask is cut off");
    assert_eq!(refused(3, &[0; 3]), "a mask is cut off");
    assert_eq!(refused(3, &[1, 0, 1, 0]), "masks contradict each other");
    assert_eq!(refused(3, &[0, 1, 0, 0]), "masks contradict each other");
    assert_eq!(refused(3, &[0, 0, 0, 1]), "masks contradict each other");
    assert_eq!(
        refused(2, &[interval(8, 8, 1), [0; 2]].concat()),
        "bytes are left over"
    );
    // All like their neighbours: the low clip value everywhere; high, once it is said.
    for (first, mask, value) in [(0, &[][..], 1f32), (2, &interval(8, 8, 1), 2.0)] {
        let masks = [&codes(first)[..], mask].concat();
        let mut out = vec![0; 2048];
        decode(&stream(&masks, &[], &[]), 8, &mut out).expect("decodes");
        assert!(out == bytes_of((0..512).map(|_| value)), "{value}");
    }
}

#[test]
fn rows_hostile_widths_and_lengths() {
    // One active sample, the last of the brick, whose prediction is the clip value beside it.
    let mut all_low = codes(0);
    all_low[15] |= INTERVAL << 6;
    let masks = [&all_low[..], &(7u16 | 8 << 5).to_le_bytes()].concat();
    for width in 0..=255u8 {
        let words = vec![0; usize::from(width).div_ceil(8)];
        let error = same_everywhere(&stream(&masks, &[width], &words), 8, "width");
        match width {
            0..=26 | 28 | 32 => assert_eq!(error, None, "{width}"),
            _ => assert_eq!(error, Some("a width is none of those allowed"), "{width}"),
        }
    }
    let said =
        |widths: &[u8], words: &[u8]| same_everywhere(&stream(&masks, widths, words), 8, "lengths");
    assert_eq!(said(&[9], &[0]), Some("the residuals are cut off"));
    assert_eq!(said(&[8], &[0, 0]), Some("bytes are left over"));
    assert_eq!(said(&[8, 8], &[0]), Some("bytes are left over"));
    assert_eq!(said(&[], &[0]), Some("a width is cut off"));
    for at in [8, 12] {
        for length in [2, 15, u32::MAX, i32::MAX as u32] {
            let mut bad = stream(&masks, &[8], &[0]);
            put_u32(&mut bad, at, length);
            assert!(
                same_everywhere(&bad, 8, "lengths").is_some(),
                "{at} {length}"
            );
        }
    }
}

/// Worked by hand, so that the order of the operations stays what the document says.
#[test]
fn rows_predict_as_documented() {
    let none = || Near::<Portable>::new([0.25f32.to_bits(); LANES]);
    let guess = |near: &Near<Portable>| {
        // A key of `Lanes` is its own inverse.
        f32::from_bits(Portable::key(near.predict(0xffff))[5])
    };
    let [f, g, h] = [[1.0; LANES], [3.0; LANES], [6.0; LANES]];
    let (on, off) = (0xffff, 0);
    let mut near = none();
    assert_eq!(guess(&near), 0.25);
    near.b[0] = f;
    assert_eq!(guess(&near), 1.0);
    near.a[0] = g;
    assert_eq!(guess(&near), 3.0);
    near.b[1] = h;
    // 2 * 1 - 6
    assert_eq!(guess(&near), -4.0);
    near.a[1] = h;
    // 2 * 3 - 6
    assert_eq!(guess(&near), 0.0);
    near.c[0] = [5.5; LANES];
    // 3 + 1 - 5.5
    assert_eq!(guess(&near), -1.5);
    (near.masks_a, near.masks_b, near.masks_c) = ([on, on, off], [on, on, off], [on, off]);
    assert_eq!(near.good(), 0);
    near.b[2] = [2.0; LANES];
    near.masks_b[2] = on;
    // 3 (1 - 6) + 2
    assert_eq!((guess(&near), near.good()), (-13.0, 0xffff));
    near.a[2] = [8.0; LANES];
    (near.masks_a[2], near.masks_b[2]) = (on, off);
    // 3 (3 - 6) + 8
    assert_eq!((guess(&near), near.good()), (-1.0, 0xffff));
    near.d[0] = [7.0; LANES];
    (near.masks_a[2], near.masks_d[0]) = (off, on);
    // 2 * 1 - 6 + (3 - (2 * 5.5 - 7))
    assert_eq!((guess(&near), near.good()), (-5.0, 0xffff));
    near.c[1] = [9.0; LANES];
    (near.masks_d[0], near.masks_c[1]) = (off, on);
    // 2 * 3 - 6 + (1 - (2 * 5.5 - 9))
    assert_eq!((guess(&near), near.good()), (-1.0, 0xffff));
    near.d[1] = [4.0; LANES];
    // 0 + (2 * -1 - (6 - (2 * 7 - 4)))
    assert_eq!(guess(&near), 2.0);
    // inf - inf is a NaN; so are the weaker ones, until 2 * 3 - 6.
    (near.b[0], near.c[0]) = ([f32::INFINITY; LANES], [f32::INFINITY; LANES]);
    (near.a[2], near.b[2]) = ([f32::NAN; LANES], [f32::NAN; LANES]);
    assert_eq!(guess(&near), 0.0);
    near.last = [f32::NAN.to_bits(); LANES];
    near.a = [[f32::NAN; LANES]; 3];
    near.b = near.a;
    assert_eq!(guess(&near).to_bits(), 0);
}
