//! A model as a graph of scalar operations on x, y and z.
//!
//! Every shape, transform, boolean and blend becomes operations of this one small set, so that
//! values, ranges, gradients and pruning are written once for each operation and hold for all of
//! them. Equal operations are stored once; constants are folded.

use super::number;
use super::oracle::Oracle;
use crate::error::{Error, ErrorKind, Result};
use std::collections::HashMap;
use std::sync::Arc;

/// An operation of the graph by its number. Operands come before what uses them.
pub(super) type Id = u32;

/// Most operations of one model: a limit for scene files that multiply themselves.
pub(super) const MAX_OPERATIONS: usize = 1 << 20;

/// Operations on one value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Unary {
    Neg,
    Abs,
    Sqrt,
    Square,
    Sin,
    Cos,
    Exp,
    Ln,
    Floor,
    Atan,
    /// A whole power from 3 on.
    Power(u16),
}

/// Operations on two values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Binary {
    Add,
    Sub,
    Mul,
    Div,
    /// A value that is not a number takes no part.
    Min,
    /// The same.
    Max,
    /// `sqrt(a^2 + b^2)`.
    Hypot,
    /// 1 where `a < b`, else 0.
    Less,
    Pow,
    /// Angle of the point (b, a), as `atan2(a, b)`.
    Atan2,
}

/// One operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Op {
    /// Bits of an f64.
    Const(u64),
    Axis(u8),
    Unary(Unary, Id),
    Binary(Binary, Id, Id),
    /// A function of a point that is not a formula: number of the oracle and the coordinates.
    Oracle(u32, [Id; 3]),
}

impl Op {
    /// Calls `each` with the operands.
    #[inline]
    pub(super) fn operands(self, mut each: impl FnMut(Id)) {
        match self {
            Op::Const(_) | Op::Axis(_) => {}
            Op::Unary(_, a) => each(a),
            Op::Binary(_, a, b) => {
                each(a);
                each(b);
            }
            Op::Oracle(_, p) => p.into_iter().for_each(each),
        }
    }

    /// The same operation on other operands.
    #[inline]
    pub(super) fn renamed(self, name: impl Fn(Id) -> Id) -> Op {
        match self {
            Op::Const(_) | Op::Axis(_) => self,
            Op::Unary(f, a) => Op::Unary(f, name(a)),
            Op::Binary(f, a, b) => Op::Binary(f, name(a), name(b)),
            Op::Oracle(n, [a, b, c]) => Op::Oracle(n, [name(a), name(b), name(c)]),
        }
    }
}

/// Operations in order of their making.
#[derive(Debug, Default)]
pub(super) struct Graph {
    pub(super) ops: Vec<Op>,
    pub(super) oracles: Vec<Arc<dyn Oracle>>,
    known: HashMap<Op, Id>,
}

impl Graph {
    /// # Errors
    /// When the graph is beyond [`MAX_OPERATIONS`].
    pub(super) fn check_size(&self) -> Result<()> {
        if self.ops.len() <= MAX_OPERATIONS {
            return Ok(());
        }
        Err(Error::new(
            ErrorKind::LimitExceeded,
            format!(
                "the model needs more than {MAX_OPERATIONS} operations: use fewer parts, or 'repeat' for copies"
            ),
        ))
    }

    fn push(&mut self, op: Op) -> Id {
        if let Some(&id) = self.known.get(&op) {
            return id;
        }
        let id = self.ops.len() as Id;
        self.ops.push(op);
        self.known.insert(op, id);
        id
    }

    /// The value of a constant operation.
    pub(super) fn value(&self, id: Id) -> Option<f64> {
        match self.ops[id as usize] {
            Op::Const(bits) => Some(f64::from_bits(bits)),
            _ => None,
        }
    }

    pub(super) fn constant(&mut self, value: f64) -> Id {
        self.push(Op::Const(value.to_bits()))
    }

    pub(super) fn axes(&mut self) -> [Id; 3] {
        [0, 1, 2].map(|a| self.push(Op::Axis(a)))
    }

    pub(super) fn oracle(&mut self, oracle: Arc<dyn Oracle>, point: [Id; 3]) -> Id {
        let number = match self.oracles.iter().position(|o| Arc::ptr_eq(o, &oracle)) {
            Some(n) => n,
            None => {
                self.oracles.push(oracle);
                self.oracles.len() - 1
            }
        };
        self.push(Op::Oracle(number as u32, point))
    }

    pub(super) fn unary(&mut self, f: Unary, a: Id) -> Id {
        match (f, self.value(a), self.ops[a as usize]) {
            (_, Some(v), _) => self.constant(number::unary(f, v)),
            (Unary::Neg, _, Op::Unary(Unary::Neg, b)) => b,
            (Unary::Square | Unary::Abs, _, Op::Unary(Unary::Neg | Unary::Abs, b)) => {
                self.unary(f, b)
            }
            _ => self.push(Op::Unary(f, a)),
        }
    }

    pub(super) fn binary(&mut self, f: Binary, a: Id, b: Id) -> Id {
        let (va, vb) = (self.value(a), self.value(b));
        if let (Some(va), Some(vb)) = (va, vb) {
            return self.constant(number::binary(f, va, vb));
        }
        match (f, va, vb) {
            (Binary::Add, Some(0.0), _) => return b,
            (Binary::Add | Binary::Sub, _, Some(0.0)) => return a,
            (Binary::Sub, Some(0.0), _) => return self.unary(Unary::Neg, b),
            (Binary::Mul, Some(1.0), _) => return b,
            (Binary::Mul | Binary::Div, _, Some(1.0)) => return a,
            (Binary::Min | Binary::Max, ..) if a == b => return a,
            (Binary::Mul, ..) if a == b => return self.unary(Unary::Square, a),
            _ => {}
        }
        let commutes = matches!(f, Binary::Add | Binary::Mul | Binary::Hypot);
        let (a, b) = if commutes && a > b { (b, a) } else { (a, b) };
        self.push(Op::Binary(f, a, b))
    }

    pub(super) fn add(&mut self, a: Id, b: Id) -> Id {
        self.binary(Binary::Add, a, b)
    }

    pub(super) fn sub(&mut self, a: Id, b: Id) -> Id {
        self.binary(Binary::Sub, a, b)
    }

    pub(super) fn mul(&mut self, a: Id, b: Id) -> Id {
        self.binary(Binary::Mul, a, b)
    }

    pub(super) fn div(&mut self, a: Id, b: Id) -> Id {
        self.binary(Binary::Div, a, b)
    }

    pub(super) fn min(&mut self, a: Id, b: Id) -> Id {
        self.binary(Binary::Min, a, b)
    }

    pub(super) fn max(&mut self, a: Id, b: Id) -> Id {
        self.binary(Binary::Max, a, b)
    }

    pub(super) fn hypot(&mut self, a: Id, b: Id) -> Id {
        self.binary(Binary::Hypot, a, b)
    }

    pub(super) fn neg(&mut self, a: Id) -> Id {
        self.unary(Unary::Neg, a)
    }

    pub(super) fn abs(&mut self, a: Id) -> Id {
        self.unary(Unary::Abs, a)
    }

    pub(super) fn sqrt(&mut self, a: Id) -> Id {
        self.unary(Unary::Sqrt, a)
    }

    pub(super) fn square(&mut self, a: Id) -> Id {
        self.unary(Unary::Square, a)
    }

    pub(super) fn add_value(&mut self, a: Id, value: f64) -> Id {
        let c = self.constant(value);
        self.add(a, c)
    }

    pub(super) fn sub_value(&mut self, a: Id, value: f64) -> Id {
        let c = self.constant(value);
        self.sub(a, c)
    }

    pub(super) fn scale(&mut self, a: Id, factor: f64) -> Id {
        let c = self.constant(factor);
        self.mul(a, c)
    }

    pub(super) fn max_value(&mut self, a: Id, value: f64) -> Id {
        let c = self.constant(value);
        self.max(a, c)
    }

    pub(super) fn min_value(&mut self, a: Id, value: f64) -> Id {
        let c = self.constant(value);
        self.min(a, c)
    }

    /// A whole power, positive or negative.
    pub(super) fn power(&mut self, a: Id, exponent: i32) -> Id {
        match exponent {
            0 => self.constant(1.0),
            1 => a,
            2 => self.square(a),
            3.. => self.unary(Unary::Power(exponent.min(i32::from(u16::MAX)) as u16), a),
            _ => {
                let one = self.constant(1.0);
                let below = self.power(a, exponent.saturating_neg());
                self.div(one, below)
            }
        }
    }

    /// `sum of weights[i] * terms[i]`.
    pub(super) fn linear(&mut self, terms: [Id; 3], weights: [f64; 3]) -> Id {
        let mut sum = self.constant(0.0);
        for (term, weight) in terms.into_iter().zip(weights) {
            if weight != 0.0 {
                let part = self.scale(term, weight);
                sum = self.add(sum, part);
            }
        }
        sum
    }

    /// `a + t (b - a)`.
    pub(super) fn mix(&mut self, a: Id, b: Id, t: Id) -> Id {
        if a == b {
            return a;
        }
        let d = self.sub(b, a);
        let part = self.mul(t, d);
        self.add(a, part)
    }

    /// Length of a vector.
    pub(super) fn length(&mut self, v: &[Id]) -> Id {
        let squares: Vec<Id> = v.iter().map(|&a| self.square(a)).collect();
        if let [a, b] = *v {
            return self.hypot(a, b);
        }
        let sum = squares.into_iter().reduce(|a, b| self.add(a, b));
        let sum = sum.unwrap_or_else(|| self.constant(0.0));
        self.sqrt(sum)
    }
}
