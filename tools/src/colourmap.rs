//! Colour maps for slices.

use crate::args::MapName;

/// Nine evenly spaced colours of each map; between them it is linear.
const VIRIDIS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [72, 40, 120],
    [62, 74, 137],
    [49, 104, 142],
    [38, 130, 142],
    [31, 158, 137],
    [53, 183, 121],
    [109, 205, 89],
    [253, 231, 37],
];
const INFERNO: [[u8; 3]; 9] = [
    [0, 0, 4],
    [32, 12, 74],
    [87, 16, 110],
    [136, 34, 106],
    [188, 55, 84],
    [227, 89, 51],
    [249, 140, 10],
    [249, 201, 50],
    [252, 255, 164],
];
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
    let table = match map {
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
        assert_eq!(colour(MapName::Viridis, 1.0), VIRIDIS[8]);
        assert_eq!(colour(MapName::Inferno, 2.0), INFERNO[8]);
        assert_eq!(colour(MapName::Grey, 0.5), [128; 3]);
        assert_ne!(label(1), label(2));
    }
}
