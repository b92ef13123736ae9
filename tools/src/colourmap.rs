//! Colour maps for slices.

use crate::args::MapName;

/// Every fifteenth of the 256 colours of viridis and inferno, by Nathaniel Smith, Stefan van der Walt and Eric
/// Firing (2015, bids.github.io/colormap, CC0); between them it is linear, at most 5 of 255 from theirs.
const VIRIDIS: [[u8; 3]; 18] = [
    [68, 1, 84],
    [72, 23, 105],
    [71, 42, 122],
    [67, 61, 132],
    [61, 78, 138],
    [53, 94, 141],
    [46, 109, 142],
    [41, 123, 142],
    [35, 137, 142],
    [31, 151, 139],
    [33, 165, 133],
    [46, 179, 124],
    [70, 192, 111],
    [101, 203, 94],
    [137, 213, 72],
    [176, 221, 47],
    [216, 226, 25],
    [253, 231, 37],
];
const INFERNO: [[u8; 3]; 18] = [
    [0, 0, 4],
    [10, 7, 34],
    [30, 12, 69],
    [56, 9, 98],
    [81, 14, 108],
    [105, 22, 110],
    [128, 31, 108],
    [152, 39, 102],
    [176, 49, 91],
    [198, 61, 77],
    [217, 77, 61],
    [233, 97, 43],
    [244, 121, 24],
    [250, 148, 7],
    [252, 176, 20],
    [248, 205, 55],
    [242, 234, 105],
    [252, 255, 164],
];
/// Nine evenly spaced colours.
const DIVERGING: [[u8; 3]; 9] = [
    [33, 74, 135],
    [67, 121, 184],
    [128, 175, 215],
    [196, 219, 236],
    [245, 245, 243],
    [247, 210, 190],
    [233, 150, 122],
    [200, 80, 74],
    [140, 20, 40],
];

/// Colour of a place from 0 to 1 in `map`.
pub(crate) fn colour(map: MapName, place: f32) -> [u8; 3] {
    let table: &[[u8; 3]] = match map {
        MapName::Viridis => &VIRIDIS,
        MapName::Inferno => &INFERNO,
        MapName::Diverging => &DIVERGING,
        MapName::Grey | MapName::Labels => return [grey(place); 3],
    };
    let at = place.clamp(0.0, 1.0) * (table.len() - 1) as f32;
    let low = (at as usize).min(table.len() - 2);
    let t = at - low as f32;
    std::array::from_fn(|c| {
        let (a, b) = (f32::from(table[low][c]), f32::from(table[low + 1][c]));
        (a + (b - a) * t + 0.5) as u8
    })
}

/// Grey level of a place from 0 to 1.
pub(crate) fn grey(place: f32) -> u8 {
    (place.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// A colour of its own for each segment; 0 is black.
pub(crate) fn label(id: u32) -> [u8; 3] {
    if id == 0 {
        return [0; 3];
    }
    // Steps of the golden angle around the colour circle, three levels of lightness.
    let hue =
        (u64::from(id).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f32 / (1u32 << 24) as f32;
    let light = [0.95, 0.75, 0.6][(id % 3) as usize];
    let channel = |shift: f32| {
        let t = (hue + shift).fract() * 6.0;
        let v = ((t - 3.0).abs() - 1.0).clamp(0.0, 1.0);
        ((0.2 + 0.8 * v) * light * 255.0) as u8
    };
    [channel(0.0), channel(2.0 / 3.0), channel(1.0 / 3.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_start_and_end_as_their_tables_do() {
        assert_eq!(colour(MapName::Viridis, 0.0), VIRIDIS[0]);
        assert_eq!(colour(MapName::Viridis, 1.0), VIRIDIS[17]);
        assert_eq!(colour(MapName::Inferno, 2.0), INFERNO[17]);
        assert_eq!(colour(MapName::Grey, 0.5), [128; 3]);
        assert_ne!(label(1), label(2));
        // Colour 128 of the 256 that were published, between two colours of the tables.
        for (map, published) in [
            (MapName::Viridis, [33, 145, 140]),
            (MapName::Inferno, [188, 55, 84]),
        ] {
            let found = colour(map, 128.0 / 255.0).map(i32::from);
            let off = (0..3).map(|c| i32::abs_diff(found[c], published[c])).max();
            assert!(off <= Some(5), "{map:?} {found:?}");
        }
    }

    /// Equal steps look equally large when the lightness (CIE 1976) rises evenly.
    #[test]
    fn viridis_is_even_to_the_eye() {
        let lightness = |c: [u8; 3]| {
            let linear = c.map(|v| {
                let v = f64::from(v) / 255.0;
                if v <= 0.04045 {
                    v / 12.92
                } else {
                    ((v + 0.055) / 1.055).powf(2.4)
                }
            });
            let y = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
            if y > 0.008856 {
                116.0 * y.cbrt() - 16.0
            } else {
                903.3 * y
            }
        };
        let at = |n: u32| lightness(colour(MapName::Viridis, n as f32 / 32.0));
        let mean = (at(32) - at(0)) / 32.0;
        for n in 0..32 {
            let step = at(n + 1) - at(n);
            assert!((0.5..1.6).contains(&(step / mean)), "{n}: {step} of {mean}");
        }
    }
}
