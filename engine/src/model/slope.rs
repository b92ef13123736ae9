//! Ranges of values with ranges of their derivatives: dual numbers (Clifford 1873) over ranges.
//!
//! Over a box they bound how fast a value changes, which gives a second, often much tighter range
//! (the mean value form, Moore 1966). Over a single point they are the gradient. Where a value has
//! no derivative (the crease of a minimum), the range holds those of both sides.

use super::graph::{Binary, Unary};
use super::interval::Interval;

/// A range of values and ranges of the derivatives along x, y, z.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slope {
    pub(super) value: Interval,
    pub(super) d: [Interval; 3],
    /// How far rounding may have moved a value from the exact one, to first order: what the operands
    /// have, times how fast the operation changes, and its own.
    pub(super) noise: f64,
}

/// Rounding of one operation, as a part of its result: that of the functions of the system's library,
/// which are not rounded to nearest.
const ROUNDING: f64 = 4e-15;

/// What is constant stays so, whatever it is multiplied by.
fn times(a: Interval, b: Interval) -> Interval {
    if a == Interval::ZERO || b == Interval::ZERO {
        return Interval::ZERO;
    }
    let out = a.mul(b);
    if out.nan { Interval::REAL } else { out }
}

fn plus(a: Interval, b: Interval) -> Interval {
    let out = a.add(b);
    if out.nan { Interval::REAL } else { out }
}

/// A quotient that is known to lie in -1..1.
fn unit(a: Interval, b: Interval) -> Interval {
    let all = Interval::new(-1.0, 1.0);
    let out = a.div(b);
    if out.nan || out.is_none() {
        return all;
    }
    Interval::new(out.lo.max(-1.0), out.hi.min(1.0))
}

impl Slope {
    pub(super) fn constant(value: f64) -> Slope {
        Slope {
            value: Interval::point(value),
            d: [Interval::ZERO; 3],
            noise: 0.0,
        }
    }

    pub(super) fn axis(axis: usize, value: Interval) -> Slope {
        let mut d = [Interval::ZERO; 3];
        d[axis] = Interval::point(1.0);
        Slope {
            value,
            d,
            noise: 0.0,
        }
    }

    /// A function of three values: its range, and its derivatives by each.
    pub(super) fn chain(value: Interval, parts: [(&Slope, Interval); 3]) -> Slope {
        let d = std::array::from_fn(|axis| {
            parts.iter().fold(Interval::ZERO, |sum, (inner, outer)| {
                plus(sum, times(*outer, inner.d[axis]))
            })
        });
        let passed = parts
            .iter()
            .map(|(inner, outer)| inner.noise_through(*outer));
        let noise = passed.sum::<f64>() + ROUNDING * value.magnitude();
        Slope { value, d, noise }
    }

    /// What its noise becomes in a function that changes as fast as `outer` says.
    fn noise_through(&self, outer: Interval) -> f64 {
        match self.noise {
            0.0 => 0.0,
            noise => noise * outer.magnitude(),
        }
    }

    fn with(&self, value: Interval, outer: Interval) -> Slope {
        Slope {
            value,
            d: self.d.map(|d| times(outer, d)),
            noise: self.noise_through(outer) + ROUNDING * value.magnitude(),
        }
    }

    fn pair(value: Interval, a: (&Slope, Interval), b: (&Slope, Interval)) -> Slope {
        let d = [0, 1, 2].map(|i| plus(times(a.1, a.0.d[i]), times(b.1, b.0.d[i])));
        let passed = a.0.noise_through(a.1) + b.0.noise_through(b.1);
        let noise = passed + ROUNDING * value.magnitude();
        Slope { value, d, noise }
    }
}

/// `value` is the range of the result, for whoever has it already.
pub(super) fn unary(f: Unary, a: &Slope, value: Interval) -> Slope {
    let one = Interval::point(1.0);
    let v = a.value;
    let outer = match f {
        Unary::Neg => one.neg(),
        Unary::Abs => sign(v),
        Unary::Sqrt => Interval::point(0.5).div(value),
        Unary::Square => v.add(v),
        Unary::Sin => v.sine(1.0),
        Unary::Cos => v.sine(0.0).neg(),
        Unary::Exp => value,
        Unary::Ln => one.div(v),
        Unary::Floor => {
            if v.lo.floor() == v.hi.floor() && !v.is_none() {
                Interval::ZERO
            } else {
                Interval::REAL
            }
        }
        Unary::Atan => one.div(one.add(v.square())),
        Unary::Power(n) => v.power(n - 1).mul(Interval::point(f64::from(n))),
    };
    a.with(value, outer)
}

fn sign(v: Interval) -> Interval {
    if v.lo > 0.0 {
        Interval::point(1.0)
    } else if v.hi < 0.0 {
        Interval::point(-1.0)
    } else {
        Interval::new(-1.0, 1.0)
    }
}

/// `value` is the range of the result, for whoever has it already.
pub(super) fn binary(f: Binary, a: &Slope, b: &Slope, value: Interval) -> Slope {
    let (va, vb) = (a.value, b.value);
    let one = Interval::point(1.0);
    match f {
        Binary::Add => Slope::pair(value, (a, one), (b, one)),
        Binary::Sub => Slope::pair(value, (a, one), (b, one.neg())),
        Binary::Mul => Slope::pair(value, (a, vb), (b, va)),
        Binary::Div => {
            let inverse = one.div(vb);
            let by_b = times(value, inverse).neg();
            Slope::pair(value, (a, inverse), (b, by_b))
        }
        Binary::Min => choice(value, a, b, va.hi < vb.lo, vb.hi < va.lo),
        Binary::Max => choice(value, a, b, va.lo > vb.hi, vb.lo > va.hi),
        Binary::Hypot => Slope::pair(value, (a, unit(va, value)), (b, unit(vb, value))),
        Binary::Less => {
            let flat = if value.single().is_some() {
                Interval::ZERO
            } else {
                Interval::REAL
            };
            Slope::pair(value, (a, flat), (b, flat))
        }
        Binary::Pow => {
            let by_a = times(vb, va.pow(vb.sub(one)));
            let by_b = times(value, va.ln());
            Slope::pair(value, (a, by_a), (b, by_b))
        }
        Binary::Atan2 => {
            if vb.lo <= 0.0 && va.lo <= 0.0 && va.hi >= 0.0 {
                // It jumps there.
                return Slope::pair(value, (a, Interval::REAL), (b, Interval::REAL));
            }
            let square = va.square().add(vb.square());
            Slope::pair(value, (a, vb.div(square)), (b, va.div(square).neg()))
        }
    }
}

fn choice(value: Interval, a: &Slope, b: &Slope, first: bool, second: bool) -> Slope {
    let clear = !a.value.nan && !b.value.nan;
    let d = match (first && clear, second && clear) {
        (true, _) => a.d,
        (_, true) => b.d,
        _ => [0, 1, 2].map(|i| a.d[i].hull(b.d[i])),
    };
    Slope {
        value,
        d,
        noise: a.noise.max(b.noise),
    }
}
