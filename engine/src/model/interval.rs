//! Ranges of operations over ranges of operands (Moore 1966).
//!
//! Sums, products, roots and so on are rounded to nearest, as values are. Rounding is monotonic,
//! so the rounded value lies between the rounded ends, and nothing has to be widened. Only what
//! comes from polynomials or the system's library (sine, exponential, ...) is.

use super::graph::{Binary, Unary};
use super::number;

/// Smallest and largest value, and whether the value may be no number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Interval {
    pub(super) lo: f64,
    pub(super) hi: f64,
    pub(super) nan: bool,
}

impl Interval {
    /// Every number, and none.
    pub(super) const ANY: Interval = Interval {
        lo: f64::NEG_INFINITY,
        hi: f64::INFINITY,
        nan: true,
    };

    /// Every number.
    pub(super) const REAL: Interval = Interval {
        nan: false,
        ..Interval::ANY
    };

    /// Never a number.
    const NONE: Interval = Interval {
        lo: f64::INFINITY,
        hi: f64::NEG_INFINITY,
        nan: true,
    };

    pub(super) const ZERO: Interval = Interval {
        lo: 0.0,
        hi: 0.0,
        nan: false,
    };

    pub(super) fn new(lo: f64, hi: f64) -> Interval {
        Interval { lo, hi, nan: false }.mended()
    }

    pub(super) fn point(value: f64) -> Interval {
        Interval::new(value, value)
    }

    /// Ends that are no numbers say nothing.
    #[inline]
    fn mended(self) -> Interval {
        if self.lo.is_nan() || self.hi.is_nan() {
            return Interval::ANY;
        }
        self
    }

    pub(super) fn is_none(self) -> bool {
        self.lo > self.hi
    }

    /// The one value that this is.
    pub(super) fn single(self) -> Option<f64> {
        (self.lo == self.hi && !self.nan).then_some(self.lo)
    }

    pub(super) fn contains(self, value: f64) -> bool {
        if value.is_nan() {
            self.nan
        } else {
            self.lo <= value && value <= self.hi
        }
    }

    pub(super) fn hull(self, other: Interval) -> Interval {
        Interval {
            lo: self.lo.min(other.lo),
            hi: self.hi.max(other.hi),
            nan: self.nan || other.nan,
        }
    }

    /// The common part of two ranges of one value.
    pub(super) fn common(self, other: Interval) -> Interval {
        Interval {
            lo: self.lo.max(other.lo),
            hi: self.hi.min(other.hi),
            nan: self.nan && other.nan,
        }
    }

    pub(super) fn middle(self) -> f64 {
        0.5 * self.lo + 0.5 * self.hi
    }

    /// Largest distance from zero.
    pub(super) fn magnitude(self) -> f64 {
        self.lo.abs().max(self.hi.abs())
    }

    fn with_nan(mut self, nan: bool) -> Interval {
        self.nan |= nan;
        self
    }

    /// Room for the error of functions that are not rounded to nearest.
    pub(super) fn widened(self) -> Interval {
        let step = 4e-15 * self.magnitude() + 1e-300;
        if !step.is_finite() {
            return Interval {
                lo: if self.lo.is_finite() {
                    f64::MIN
                } else {
                    self.lo
                },
                hi: if self.hi.is_finite() {
                    f64::MAX
                } else {
                    self.hi
                },
                nan: self.nan,
            };
        }
        Interval {
            lo: self.lo - step,
            hi: self.hi + step,
            nan: self.nan,
        }
    }

    pub(super) fn add(self, o: Interval) -> Interval {
        if self.is_none() || o.is_none() {
            return Interval::NONE;
        }
        let nan = (self.hi == f64::INFINITY && o.lo == f64::NEG_INFINITY)
            || (self.lo == f64::NEG_INFINITY && o.hi == f64::INFINITY);
        Interval {
            lo: self.lo + o.lo,
            hi: self.hi + o.hi,
            nan: nan || self.nan || o.nan,
        }
        .mended()
    }

    pub(super) fn neg(self) -> Interval {
        Interval {
            lo: -self.hi,
            hi: -self.lo,
            nan: self.nan,
        }
    }

    pub(super) fn sub(self, o: Interval) -> Interval {
        self.add(o.neg())
    }

    pub(super) fn mul(self, o: Interval) -> Interval {
        if self.is_none() || o.is_none() {
            return Interval::NONE;
        }
        let products = [
            self.lo * o.lo,
            self.lo * o.hi,
            self.hi * o.lo,
            self.hi * o.hi,
        ];
        if products.iter().any(|p| p.is_nan()) {
            return Interval::ANY;
        }
        let has_zero = |i: Interval| i.lo <= 0.0 && i.hi >= 0.0;
        let endless = |i: Interval| i.lo == f64::NEG_INFINITY || i.hi == f64::INFINITY;
        let nan = (has_zero(self) && endless(o)) || (has_zero(o) && endless(self));
        Interval {
            lo: products.into_iter().fold(f64::INFINITY, f64::min),
            hi: products.into_iter().fold(f64::NEG_INFINITY, f64::max),
            nan: nan || self.nan || o.nan,
        }
    }

    pub(super) fn div(self, o: Interval) -> Interval {
        if self.is_none() || o.is_none() {
            return Interval::NONE;
        }
        if o.lo <= 0.0 && o.hi >= 0.0 {
            let nan = self.nan || o.nan || self.contains(0.0) || self.magnitude() == f64::INFINITY;
            return Interval::REAL.with_nan(nan);
        }
        let quotients = [
            self.lo / o.lo,
            self.lo / o.hi,
            self.hi / o.lo,
            self.hi / o.hi,
        ];
        if quotients.iter().any(|q| q.is_nan()) {
            return Interval::ANY;
        }
        let nan = self.magnitude() == f64::INFINITY && o.magnitude() == f64::INFINITY;
        Interval {
            lo: quotients.into_iter().fold(f64::INFINITY, f64::min),
            hi: quotients.into_iter().fold(f64::NEG_INFINITY, f64::max),
            nan: nan || self.nan || o.nan,
        }
    }

    pub(super) fn abs(self) -> Interval {
        if self.is_none() || self.lo >= 0.0 {
            self
        } else if self.hi <= 0.0 {
            self.neg()
        } else {
            Interval {
                lo: 0.0,
                hi: self.magnitude(),
                nan: self.nan,
            }
        }
    }

    fn map(self, f: impl Fn(f64) -> f64) -> Interval {
        if self.is_none() {
            return Interval::NONE;
        }
        Interval {
            lo: f(self.lo),
            hi: f(self.hi),
            nan: self.nan,
        }
        .mended()
    }

    pub(super) fn square(self) -> Interval {
        self.abs().map(|a| a * a)
    }

    pub(super) fn power(self, n: u16) -> Interval {
        if n.is_multiple_of(2) {
            self.abs().map(|a| number::power(a, n))
        } else {
            self.map(|a| number::power(a, n))
        }
    }

    pub(super) fn sqrt(self) -> Interval {
        if self.hi < 0.0 || self.is_none() {
            return Interval::NONE;
        }
        let nan = self.nan || self.lo < 0.0;
        self.common(Interval::new(0.0, f64::INFINITY))
            .map(f64::sqrt)
            .with_nan(nan)
    }

    /// Sine for `shift` 0, cosine for `shift` 1 (in quarter turns).
    pub(super) fn sine(self, shift: f64) -> Interval {
        if self.is_none() {
            return Interval::NONE;
        }
        let nan = self.nan || self.magnitude() == f64::INFINITY;
        let all = Interval::new(-1.0 - 1e-14, 1.0 + 1e-14).with_nan(nan);
        if self.magnitude() > number::SINE_LIMIT || self.hi - self.lo > 7.0 {
            return all;
        }
        let f = if shift == 0.0 {
            number::sin
        } else {
            number::cos
        };
        // In quarter turns the largest values are at 1, 5, 9, ..., the smallest at 3, 7, 11, ...
        let [from, to] = [self.lo, self.hi].map(|v| v / std::f64::consts::FRAC_PI_2 + shift);
        let passes =
            |at: f64| ((to - at + 1e-9) / 4.0).floor() >= ((from - at - 1e-9) / 4.0).ceil();
        let (a, b) = (f(self.lo), f(self.hi));
        Interval {
            lo: if passes(3.0) { -1.0 } else { a.min(b) } - 1e-14,
            hi: if passes(1.0) { 1.0 } else { a.max(b) } + 1e-14,
            nan,
        }
    }

    pub(super) fn min(self, o: Interval) -> Interval {
        let mut hi = self.hi.min(o.hi);
        if self.nan {
            hi = hi.max(o.hi);
        }
        if o.nan {
            hi = hi.max(self.hi);
        }
        Interval {
            lo: self.lo.min(o.lo),
            hi,
            nan: self.nan && o.nan,
        }
    }

    pub(super) fn max(self, o: Interval) -> Interval {
        self.neg().min(o.neg()).neg()
    }

    pub(super) fn hypot(self, o: Interval) -> Interval {
        self.square().add(o.square()).sqrt()
    }

    /// Of `self < o`.
    pub(super) fn less(self, o: Interval) -> Interval {
        let always = self.hi < o.lo && !self.nan && !o.nan;
        let never = self.lo >= o.hi || self.is_none() || o.is_none();
        match (always, never) {
            (true, _) => Interval::point(1.0),
            (_, true) => Interval::ZERO,
            _ => Interval::new(0.0, 1.0),
        }
    }

    fn exp(self) -> Interval {
        let out = self.map(f64::exp).widened();
        Interval {
            lo: out.lo.max(0.0),
            ..out
        }
    }

    pub(super) fn ln(self) -> Interval {
        if self.hi < 0.0 || self.is_none() {
            return Interval::NONE;
        }
        let nan = self.nan || self.lo < 0.0;
        self.common(Interval::new(0.0, f64::INFINITY))
            .map(f64::ln)
            .with_nan(nan)
            .widened()
    }

    pub(super) fn pow(self, o: Interval) -> Interval {
        if self.is_none() || o.is_none() {
            return Interval::ANY;
        }
        if self.lo < 0.0 || self.nan || o.nan {
            return Interval::ANY;
        }
        // For a base from 0 on, extremes are at corners, or at base 1 or exponent 0, where it is 1.
        let base = [self.lo, self.hi];
        let mut out = Interval::NONE;
        for a in base {
            for b in [o.lo, o.hi] {
                let v = number::pow(a, b);
                if v.is_nan() {
                    return Interval::ANY;
                }
                out = out.hull(Interval::point(v));
            }
        }
        if (self.lo <= 1.0 && self.hi >= 1.0) || (o.lo <= 0.0 && o.hi >= 0.0) {
            out = out.hull(Interval::point(1.0));
        }
        out.nan = false;
        let out = out.widened();
        // Room for rounding must not make it negative: a power of it would then be unknown.
        Interval {
            lo: out.lo.max(0.0),
            ..out
        }
    }

    pub(super) fn atan2(self, o: Interval) -> Interval {
        let nan = self.nan || o.nan;
        let all = Interval::new(-std::f64::consts::PI, std::f64::consts::PI);
        if self.is_none() || o.is_none() {
            return Interval::NONE;
        }
        // The jump is at a = 0, b <= 0.
        if o.lo <= 0.0 && self.lo <= 0.0 && self.hi >= 0.0 {
            return all.with_nan(nan).widened();
        }
        let mut out = Interval::NONE;
        for a in [self.lo, self.hi] {
            for b in [o.lo, o.hi] {
                out = out.hull(Interval::point(number::atan2(a, b)));
            }
        }
        out.nan = nan;
        out.widened()
    }
}

pub(super) fn unary(f: Unary, a: Interval) -> Interval {
    match f {
        Unary::Neg => a.neg(),
        Unary::Abs => a.abs(),
        Unary::Sqrt => a.sqrt(),
        Unary::Square => a.square(),
        Unary::Sin => a.sine(0.0),
        Unary::Cos => a.sine(1.0),
        Unary::Exp => a.exp(),
        Unary::Ln => a.ln(),
        Unary::Floor => a.map(f64::floor),
        Unary::Atan => a.map(f64::atan).widened(),
        Unary::Power(n) => a.power(n),
    }
}

pub(super) fn binary(f: Binary, a: Interval, b: Interval) -> Interval {
    match f {
        Binary::Add => a.add(b),
        Binary::Sub => a.sub(b),
        Binary::Mul => a.mul(b),
        Binary::Div => a.div(b),
        Binary::Min => a.min(b),
        Binary::Max => a.max(b),
        Binary::Hypot => a.hypot(b),
        Binary::Less => a.less(b),
        Binary::Pow => a.pow(b),
        Binary::Atan2 => a.atan2(b),
    }
}
