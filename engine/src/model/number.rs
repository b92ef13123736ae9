//! The operations on single numbers: the one definition that rows, ranges and gradients follow.

use super::graph::{Binary, Unary};

/// `a`, unless `b` is smaller or `a` is not a number.
#[inline(always)]
pub(super) fn min(a: f64, b: f64) -> f64 {
    if b < a || a.is_nan() { b } else { a }
}

/// `a`, unless `b` is larger or `a` is not a number.
#[inline(always)]
pub(super) fn max(a: f64, b: f64) -> f64 {
    if b > a || a.is_nan() { b } else { a }
}

/// Repeated squaring, the same multiplications for every caller.
#[inline(always)]
pub(super) fn power(a: f64, exponent: u16) -> f64 {
    let (mut base, mut left, mut out) = (a, exponent, 1.0);
    while left > 0 {
        if left & 1 == 1 {
            out *= base;
        }
        base *= base;
        left >>= 1;
    }
    out
}

/// A divisor of -0 counts as 0, so that a constant zero and a computed one divide alike.
#[inline(always)]
pub(super) fn div(a: f64, b: f64) -> f64 {
    a / (b + 0.0)
}

#[inline(always)]
pub(super) fn hypot(a: f64, b: f64) -> f64 {
    (a * a + b * b).sqrt()
}

#[inline(always)]
pub(super) fn less(a: f64, b: f64) -> f64 {
    if a < b { 1.0 } else { 0.0 }
}

#[inline(always)]
pub(super) fn pow(a: f64, b: f64) -> f64 {
    (a + 0.0).powf(b)
}

#[inline(always)]
pub(super) fn atan2(a: f64, b: f64) -> f64 {
    (a + 0.0).atan2(b + 0.0)
}

/// Beyond this the reduction of sines loses digits, and ranges no longer rely on it.
pub(super) const SINE_LIMIT: f64 = 1e6;

#[inline(always)]
pub(super) fn sin(x: f64) -> f64 {
    quadrant(x, 0)
}

#[inline(always)]
pub(super) fn cos(x: f64) -> f64 {
    quadrant(x, 1)
}

/// Sine of `x + quarters * pi / 2`: reduction by pi/2 in three parts (Cody and Waite 1980), then
/// Taylor polynomials on -pi/4..pi/4. Without branches, so that loops over it vectorize; the same
/// bits on every machine. Absolute error below 1e-15 up to [`SINE_LIMIT`].
#[inline(always)]
fn quadrant(x: f64, quarters: u64) -> f64 {
    // Adding it rounds to the nearest integer, which then stands in the low bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    const PART_1: f64 = f64::from_bits(0x3ff9_21fb_5440_0000);
    const PART_2: f64 = f64::from_bits(0x3dd0_b461_1a60_0000);
    const PART_3: f64 = f64::from_bits(0x3ba3_198a_2e03_7073);
    let shifted = x * std::f64::consts::FRAC_2_PI + ROUND;
    let n = shifted - ROUND;
    let turn = shifted.to_bits().wrapping_add(quarters);
    let r = ((x - n * PART_1) - n * PART_2) - n * PART_3;
    let r = if r > 1.0 { 1.0 } else { r };
    let r = if r < -1.0 { -1.0 } else { r };
    let r2 = r * r;
    let sine = {
        let mut p = -1.0 / 1_307_674_368_000.0;
        for c in [
            1.0 / 6_227_020_800.0,
            -1.0 / 39_916_800.0,
            1.0 / 362_880.0,
            -1.0 / 5_040.0,
            1.0 / 120.0,
            -1.0 / 6.0,
        ] {
            p = p * r2 + c;
        }
        r + r * (r2 * p)
    };
    let cosine = {
        let mut p = 1.0 / 20_922_789_888_000.0;
        for c in [
            -1.0 / 87_178_291_200.0,
            1.0 / 479_001_600.0,
            -1.0 / 3_628_800.0,
            1.0 / 40_320.0,
            -1.0 / 720.0,
            1.0 / 24.0,
            -0.5,
        ] {
            p = p * r2 + c;
        }
        1.0 + r2 * p
    };
    let odd = (turn & 1).wrapping_neg();
    let bits = (sine.to_bits() & !odd) | (cosine.to_bits() & odd);
    f64::from_bits(bits ^ ((turn & 2) << 62))
}

#[inline(always)]
pub(super) fn unary(f: Unary, a: f64) -> f64 {
    match f {
        Unary::Neg => -a,
        Unary::Abs => a.abs(),
        Unary::Sqrt => a.sqrt(),
        Unary::Square => a * a,
        Unary::Sin => sin(a),
        Unary::Cos => cos(a),
        Unary::Exp => a.exp(),
        Unary::Ln => a.ln(),
        Unary::Floor => a.floor(),
        Unary::Atan => a.atan(),
        Unary::Power(n) => power(a, n),
    }
}

#[inline(always)]
pub(super) fn binary(f: Binary, a: f64, b: f64) -> f64 {
    match f {
        Binary::Add => a + b,
        Binary::Sub => a - b,
        Binary::Mul => a * b,
        Binary::Div => div(a, b),
        Binary::Min => min(a, b),
        Binary::Max => max(a, b),
        Binary::Hypot => hypot(a, b),
        Binary::Less => less(a, b),
        Binary::Pow => pow(a, b),
        Binary::Atan2 => atan2(a, b),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sines_are_those_of_the_system() {
        let mut worst = 0.0f64;
        for i in -400_000..400_000 {
            let x = f64::from(i) * 0.0137;
            worst = worst.max((sin(x) - x.sin()).abs());
            worst = worst.max((cos(x) - x.cos()).abs());
        }
        assert!(worst < 1e-15, "{worst:e}");
        for x in [999_999.0, -876_543.21] {
            assert!((sin(x) - x.sin()).abs() < 1e-14);
        }
        for x in [1e9, -1e18, 1e300] {
            assert!(sin(x).abs() <= 1.0 && cos(x).abs() <= 1.0);
        }
        assert!(sin(f64::INFINITY).is_nan() && cos(f64::NAN).is_nan());
    }
}
