//! Sine and cosine of rational turns, equal on every machine.
//!
//! Libraries differ in the last bit, and `sin(8 * 2 pi * i / n)` is not zero where it should be.
//! Here the turn is reduced in integers and the rest is a polynomial of plain multiplications and
//! additions, so quarter turns are exact and the symmetries of the circle hold bit for bit.

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_4};

/// `(sin, cos)` of `numerator / denominator` turns, each within 2 units in the last place.
///
/// # Panics
/// When `denominator` is zero.
pub(crate) fn sin_cos_turn(numerator: u64, denominator: u64) -> (f64, f64) {
    let eighths = u128::from(numerator % denominator) * 8;
    let whole = u128::from(denominator);
    let octant = (eighths / whole) as u32;
    let part = eighths % whole;
    let part = if octant % 2 == 1 { whole - part } else { part };
    let (s, c) = if part == whole {
        (FRAC_1_SQRT_2, FRAC_1_SQRT_2)
    } else {
        let angle = FRAC_PI_4 * (part as f64 / whole as f64);
        (sine(angle), cosine(angle))
    };
    match octant {
        0 => (s, c),
        1 => (c, s),
        2 => (c, -s),
        3 => (s, -c),
        4 => (-s, -c),
        5 => (-c, -s),
        6 => (-c, s),
        _ => (-s, c),
    }
}

/// Taylor series of the sine for an angle up to pi / 4; the first omitted term is below 1e-19.
fn sine(x: f64) -> f64 {
    let xx = x * x;
    let mut sum = 0.0;
    for n in (1..=8).rev() {
        let divisor = f64::from(2 * n * (2 * n + 1));
        sum = -xx / divisor * (1.0 + sum);
    }
    x + x * sum
}

/// Taylor series of the cosine for an angle up to pi / 4; the first omitted term is below 1e-18.
fn cosine(x: f64) -> f64 {
    let xx = x * x;
    let mut sum = 0.0;
    for n in (1..=8).rev() {
        let divisor = f64::from((2 * n - 1) * 2 * n);
        sum = -xx / divisor * (1.0 + sum);
    }
    1.0 + sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn agrees_with_the_library() {
        for denominator in [1u64, 7, 64, 1000, 1_048_573] {
            for step in 0..2000u64 {
                let numerator = step * 7919 % (3 * denominator);
                let (s, c) = sin_cos_turn(numerator, denominator);
                let angle = TAU * ((numerator % denominator) as f64 / denominator as f64);
                assert!((s - angle.sin()).abs() < 1e-15, "{numerator}/{denominator}");
                assert!((c - angle.cos()).abs() < 1e-15, "{numerator}/{denominator}");
            }
        }
    }

    #[test]
    fn symmetries_are_exact() {
        for n in [8u64, 12, 97, 1024] {
            for i in 0..4 * n {
                let (s, c) = sin_cos_turn(i, 4 * n);
                let (s_next, c_next) = sin_cos_turn(i + n, 4 * n);
                assert!(s_next == c && c_next == -s);
                let (s_back, c_back) = sin_cos_turn(4 * n - i, 4 * n);
                assert!(s_back == -s && c_back == c);
            }
        }
        assert_eq!(sin_cos_turn(1, 2), (-0.0, -1.0));
        assert_eq!(sin_cos_turn(3, 8).0, FRAC_1_SQRT_2);
    }
}
