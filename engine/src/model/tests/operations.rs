//! Every operation on ranges, with the ends that are rarely met: infinities, zeros of both signs,
//! turning points of sines, values that are no numbers.

use super::{Random, samples_wanted};
use crate::model::graph::{Binary, Unary};
use crate::model::interval::{self, Interval};
use crate::model::number;
use std::f64::consts::PI;

const UNARY: [Unary; 13] = [
    Unary::Neg,
    Unary::Abs,
    Unary::Sqrt,
    Unary::Square,
    Unary::Sin,
    Unary::Cos,
    Unary::Exp,
    Unary::Ln,
    Unary::Floor,
    Unary::Atan,
    Unary::Power(3),
    Unary::Power(4),
    Unary::Power(7),
];

const BINARY: [Binary; 10] = [
    Binary::Add,
    Binary::Sub,
    Binary::Mul,
    Binary::Div,
    Binary::Min,
    Binary::Max,
    Binary::Hypot,
    Binary::Less,
    Binary::Pow,
    Binary::Atan2,
];

const ENDS: [f64; 16] = [
    f64::NEG_INFINITY,
    f64::MIN,
    -1.0,
    -1e-300,
    -0.0,
    0.0,
    1e-300,
    0.5,
    1.0,
    2.0,
    0.5 * PI,
    PI,
    1.5 * PI,
    1e6,
    f64::MAX,
    f64::INFINITY,
];

fn end(random: &mut Random) -> f64 {
    match random.next() % 3 {
        0 => ENDS[random.next() as usize % ENDS.len()],
        1 => random.within(-8.0, 8.0),
        _ => {
            let size = 10f64.powf(random.within(-9.0, 9.0));
            if random.next().is_multiple_of(2) {
                size
            } else {
                -size
            }
        }
    }
}

fn range(random: &mut Random) -> Interval {
    let (a, b) = (end(random), end(random));
    let b = if random.next().is_multiple_of(4) {
        a + 1e-3
    } else {
        b
    };
    Interval {
        lo: a.min(b),
        hi: a.max(b),
        nan: random.next().is_multiple_of(8),
    }
}

/// A value of a range: an end, one between, or none where that may be.
fn value(random: &mut Random, of: Interval) -> f64 {
    match random.next() % 8 {
        0 => of.lo,
        1 => of.hi,
        2 if of.nan => f64::NAN,
        3 if of.contains(0.0) => 0.0,
        4 if of.contains(0.0) => -0.0,
        5 if of.contains(1.0) => 1.0,
        _ => {
            let (low, high) = (of.lo.clamp(-1e300, 1e300), of.hi.clamp(-1e300, 1e300));
            let between = random.within(low, high);
            between.clamp(of.lo, of.hi)
        }
    }
}

#[test]
fn ranges_of_every_operation_hold_every_value() {
    let samples = samples_wanted(20_000);
    let mut random = Random(7);
    for f in UNARY {
        for _ in 0..samples.div_ceil(10) {
            let a = range(&mut random);
            let out = interval::unary(f, a);
            for _ in 0..10 {
                let v = value(&mut random, a);
                let is = number::unary(f, v);
                assert!(
                    out.contains(is),
                    "{f:?} {v:e} is {is:e}; {a:?} gave {out:?}"
                );
            }
        }
    }
    for f in BINARY {
        for _ in 0..samples.div_ceil(10) {
            let (a, b) = (range(&mut random), range(&mut random));
            let out = interval::binary(f, a, b);
            for _ in 0..10 {
                let (v, w) = (value(&mut random, a), value(&mut random, b));
                let is = number::binary(f, v, w);
                assert!(
                    out.contains(is),
                    "{f:?} {v:e} {w:e} is {is:e}; {a:?} {b:?} gave {out:?}"
                );
            }
        }
    }
}
