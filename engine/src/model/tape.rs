//! The operations that one value needs, in order: evaluated over rows of points, over boxes, and
//! pruned to what is active in a box.
//!
//! Pruning follows Keeter, "Massively Parallel Rendering of Complex Closed-Form Implicit Surfaces"
//! (2020): the ranges over a box say which operand of a minimum or maximum always wins there; the
//! other one, and all that only it needs, is dropped. A pruned tape gives the same bits.

use super::graph::{Binary, Graph, Id, Op, Unary};
use super::interval::{self, Interval};
use super::number;
use super::oracle::Oracle;
use super::slope::{self, Slope};
use crate::error::Result;
use std::sync::Arc;

/// Points that are evaluated at one time: registers of this many values stay in the first cache.
pub(super) const BATCH: usize = 256;

/// Stands for a register that a constant does not need.
const NO_REGISTER: u32 = u32::MAX;

/// Operations in order; the last one is the value.
#[derive(Clone, Debug)]
pub(super) struct Tape {
    pub(super) ops: Vec<Op>,
    /// Where the values of an operation go.
    registers: Vec<u32>,
    register_count: usize,
    oracles: Arc<[Arc<dyn Oracle>]>,
}

/// Memory that evaluation needs, kept from call to call.
#[derive(Debug, Default)]
pub(super) struct Room {
    rows: Vec<Vec<f64>>,
    pub(super) planes: super::planes::Planes,
    intervals: Vec<Interval>,
    slopes: Vec<Slope>,
    single: Vec<f64>,
}

impl Tape {
    /// The part of `graph` that `root` needs.
    pub(super) fn new(graph: &Graph, root: Id) -> Tape {
        let ops = &graph.ops[..=root as usize];
        Tape::collect(ops, root, graph.oracles.clone().into(), |_, op| Ok(op))
    }

    /// Keeps what `root` needs after `change` had its word: another operation, or the operand that
    /// takes the place of one.
    fn collect(
        ops: &[Op],
        root: Id,
        oracles: Arc<[Arc<dyn Oracle>]>,
        change: impl Fn(usize, Op) -> Result<Op, Id>,
    ) -> Tape {
        const UNUSED: u32 = u32::MAX;
        let mut new = vec![UNUSED; ops.len()];
        // From the back: what is needed, and as what.
        let mut kept: Vec<Option<Result<Op, Id>>> = vec![None; ops.len()];
        let mut needed = vec![false; ops.len()];
        needed[root as usize] = true;
        for at in (0..ops.len()).rev() {
            if !needed[at] {
                continue;
            }
            let changed = change(at, ops[at]);
            match changed {
                Ok(op) => op.operands(|id| needed[id as usize] = true),
                Err(id) => needed[id as usize] = true,
            }
            kept[at] = Some(changed);
        }
        let mut out = Vec::new();
        for (at, changed) in kept.into_iter().enumerate() {
            match changed {
                None => {}
                Some(Ok(op)) => {
                    out.push(op.renamed(|id| new[id as usize]));
                    new[at] = out.len() as u32 - 1;
                }
                Some(Err(id)) => new[at] = new[id as usize],
            }
        }
        // The value must be last; an operand that took its place stands there already, since
        // nothing after it is needed.
        debug_assert_eq!(new[root as usize] as usize, out.len() - 1);
        let (registers, register_count) = allocate(&out);
        Tape {
            ops: out,
            registers,
            register_count,
            oracles,
        }
    }

    /// Number of operations, constants included.
    pub(super) fn len(&self) -> usize {
        self.ops.len()
    }

    /// The range over a box. `room` keeps the ranges of all operations, for [`prune`](Self::prune).
    pub(super) fn range(&self, cube: [Interval; 3], room: &mut Room) -> Result<Interval> {
        let all = &mut room.intervals;
        all.clear();
        all.reserve(self.ops.len());
        for &op in &self.ops {
            let value = match op {
                Op::Const(bits) => Interval::point(f64::from_bits(bits)),
                Op::Axis(a) => cube[a as usize],
                Op::Unary(f, a) => interval::unary(f, all[a as usize]),
                Op::Binary(f, a, b) => interval::binary(f, all[a as usize], all[b as usize]),
                Op::Oracle(n, p) => self.oracles[n as usize].range(p.map(|id| all[id as usize]))?,
            };
            all.push(value);
        }
        Ok(all.last().copied().unwrap_or(Interval::ANY))
    }

    /// The tape for the box whose [`range`](Self::range) was asked last, or nothing where it would
    /// be the same.
    pub(super) fn prune(&self, room: &Room) -> Option<Tape> {
        let ranges = &room.intervals;
        let change = |at: usize, op: Op| -> Result<Op, Id> {
            if let (Some(value), false) = (ranges[at].single(), matches!(op, Op::Const(_))) {
                return Ok(Op::Const((value + 0.0).to_bits()));
            }
            let Op::Binary(f, a, b) = op else {
                return Ok(op);
            };
            let (ra, rb) = (ranges[a as usize], ranges[b as usize]);
            if ra.nan || rb.nan {
                return Ok(op);
            }
            match f {
                Binary::Min if ra.hi < rb.lo => Err(a),
                Binary::Min if rb.hi < ra.lo => Err(b),
                Binary::Max if ra.lo > rb.hi => Err(a),
                Binary::Max if rb.lo > ra.hi => Err(b),
                Binary::Add if ra == Interval::ZERO => Err(b),
                Binary::Add | Binary::Sub if rb == Interval::ZERO => Err(a),
                _ => Ok(op),
            }
        };
        if (0..self.ops.len()).all(|at| change(at, self.ops[at]) == Ok(self.ops[at])) {
            return None;
        }
        let root = self.ops.len() as Id - 1;
        Some(Tape::collect(&self.ops, root, self.oracles.clone(), change))
    }

    /// Ranges of the value and its derivatives over a box.
    pub(super) fn slopes(&self, cube: [Interval; 3], room: &mut Room) -> Result<Slope> {
        self.range(cube, room)?;
        self.slopes_of_known(cube, room)
    }

    /// The same for the box whose [`range`](Self::range) was asked last.
    fn slopes_of_known(&self, cube: [Interval; 3], room: &mut Room) -> Result<Slope> {
        let values = &room.intervals;
        let all = &mut room.slopes;
        all.clear();
        all.reserve(self.ops.len());
        for (&op, &value) in self.ops.iter().zip(values) {
            let next = match op {
                Op::Const(bits) => Slope::constant(f64::from_bits(bits)),
                Op::Axis(a) => Slope::axis(a as usize, cube[a as usize]),
                Op::Unary(f, a) => slope::unary(f, &all[a as usize], value),
                Op::Binary(f, a, b) => slope::binary(f, &all[a as usize], &all[b as usize], value),
                Op::Oracle(n, p) => {
                    let parts = p.map(|id| &all[id as usize]);
                    let (oracle, inner) = (&self.oracles[n as usize], parts.map(|s| s.value));
                    let outer = oracle.slopes(inner)?;
                    let mut found = Slope::chain(value, [0, 1, 2].map(|i| (parts[i], outer[i])));
                    found.noise += oracle.rounding(inner)?;
                    found
                }
            };
            all.push(next);
        }
        Ok(all.last().copied().unwrap_or(Slope {
            value: Interval::ANY,
            d: [Interval::REAL; 3],
            noise: f64::INFINITY,
        }))
    }

    /// A tighter range over the box whose [`range`](Self::range) was asked last: the value in the
    /// middle and what the derivatives add to it, together with that range.
    pub(super) fn tight_range(&self, cube: [Interval; 3], room: &mut Room) -> Result<Interval> {
        let slopes = self.slopes_of_known(cube, room)?;
        let known = slopes.value;
        if known.nan || !slopes.noise.is_finite() {
            return Ok(known);
        }
        let middle = cube.map(Interval::middle);
        let mut sum = Interval::point(self.value(middle, room)?);
        for a in 0..3 {
            let way = cube[a].sub(Interval::point(middle[a]));
            sum = sum.add(slopes.d[a].mul(way));
        }
        // Unlike the plain range this one is not formed as the values are: room for the rounding of
        // the value in the middle and of the others, and as much again for that of the slopes.
        let room_ = 4.0 * slopes.noise + 1e-12 * sum.magnitude().min(known.magnitude());
        if sum.nan || !room_.is_finite() {
            return Ok(known);
        }
        let tight = Interval::new(sum.lo - room_, sum.hi + room_);
        let out = known.common(tight);
        Ok(if out.is_none() { known } else { out })
    }

    /// The value at one point.
    fn value(&self, point: [f64; 3], room: &mut Room) -> Result<f64> {
        let all = &mut room.single;
        all.clear();
        for &op in &self.ops {
            let value = match op {
                Op::Const(bits) => f64::from_bits(bits),
                Op::Axis(a) => point[a as usize],
                Op::Unary(f, a) => number::unary(f, all[a as usize]),
                Op::Binary(f, a, b) => number::binary(f, all[a as usize], all[b as usize]),
                Op::Oracle(n, p) => {
                    let [x, y, z] = p.map(|id| [all[id as usize]]);
                    let mut out = [0.0];
                    self.oracles[n as usize].values([&x, &y, &z], &mut out)?;
                    out[0]
                }
            };
            all.push(value);
        }
        Ok(all.last().copied().unwrap_or(f64::NAN))
    }

    /// Values at points given by their coordinates.
    pub(super) fn values(
        &self,
        point: [&[f64]; 3],
        out: &mut [f64],
        room: &mut Room,
    ) -> Result<()> {
        for (n, out) in out.chunks_mut(BATCH).enumerate() {
            let part = n * BATCH..n * BATCH + out.len();
            self.batch(point.map(|p| &p[part.clone()]), out, &mut room.rows)?;
        }
        Ok(())
    }

    fn batch(&self, point: [&[f64]; 3], out: &mut [f64], rows: &mut Vec<Vec<f64>>) -> Result<()> {
        let n = out.len();
        if rows.len() < self.register_count {
            rows.resize_with(self.register_count, || vec![0.0; BATCH]);
        }
        let Some((&last, before)) = self.ops.split_last() else {
            return Ok(());
        };
        for (at, &op) in before.iter().enumerate() {
            let register = self.registers[at];
            if register == NO_REGISTER {
                continue;
            }
            // Taken out, so that the others can be read meanwhile; never one of the operands.
            let mut row = std::mem::take(&mut rows[register as usize]);
            let done = self.apply(op, |id| self.operand(id, point, rows, n), &mut row[..n]);
            rows[register as usize] = row;
            done?;
        }
        if let Op::Axis(a) = last {
            out.copy_from_slice(&point[a as usize][..n]);
        }
        self.apply(last, |id| self.operand(id, point, rows, n), out)
    }

    fn operand<'a>(
        &self,
        id: Id,
        point: [&'a [f64]; 3],
        rows: &'a [Vec<f64>],
        n: usize,
    ) -> Operand<'a> {
        match self.ops[id as usize] {
            Op::Const(bits) => Operand::Value(f64::from_bits(bits)),
            Op::Axis(a) => Operand::Row(&point[a as usize][..n]),
            _ => Operand::Row(&rows[self.registers[id as usize] as usize][..n]),
        }
    }

    /// One operation over a row of points.
    pub(super) fn apply<'a>(
        &self,
        op: Op,
        operand: impl Fn(Id) -> Operand<'a>,
        out: &mut [f64],
    ) -> Result<()> {
        match op {
            Op::Const(bits) => out.fill(f64::from_bits(bits)),
            // Asked only where the value of a tape is a coordinate.
            Op::Axis(_) => {}
            Op::Unary(f, a) => unary_row(f, operand(a), out),
            Op::Binary(f, a, b) => binary_row(f, operand(a), operand(b), out),
            Op::Oracle(number, p) => {
                let mut spread = [const { Vec::new() }; 3];
                for (copy, id) in spread.iter_mut().zip(p) {
                    *copy = match operand(id) {
                        Operand::Row(row) => row.to_vec(),
                        Operand::Value(v) => vec![v; out.len()],
                    };
                }
                let [x, y, z] = &spread;
                self.oracles[number as usize].values([x, y, z], out)?;
            }
        }
        Ok(())
    }
}

/// Registers by last use: a register is free again after the last operation that reads it.
fn allocate(ops: &[Op]) -> (Vec<u32>, usize) {
    let mut last_use = vec![0usize; ops.len()];
    for (at, op) in ops.iter().enumerate() {
        op.operands(|id| last_use[id as usize] = at);
    }
    let mut registers = vec![NO_REGISTER; ops.len()];
    let mut free = Vec::new();
    let mut count = 0;
    for (at, op) in ops.iter().enumerate() {
        if matches!(op, Op::Const(_) | Op::Axis(_)) {
            continue;
        }
        registers[at] = free.pop().unwrap_or_else(|| {
            count += 1;
            count as u32 - 1
        });
        let mut done = Vec::new();
        op.operands(|id| {
            if last_use[id as usize] == at && !done.contains(&id) {
                done.push(id);
            }
        });
        free.extend(
            done.into_iter()
                .map(|id| registers[id as usize])
                .filter(|&r| r != NO_REGISTER),
        );
    }
    (registers, count)
}

/// Values of an operand: one for each point, or one for all.
pub(super) enum Operand<'a> {
    Row(&'a [f64]),
    Value(f64),
}

#[inline(always)]
fn each(a: Operand<'_>, out: &mut [f64], f: impl Fn(f64) -> f64) {
    match a {
        Operand::Row(a) => out.iter_mut().zip(a).for_each(|(o, &a)| *o = f(a)),
        Operand::Value(a) => out.fill(f(a)),
    }
}

fn unary_row(f: Unary, a: Operand<'_>, out: &mut [f64]) {
    match f {
        Unary::Neg => each(a, out, |a| -a),
        Unary::Abs => each(a, out, f64::abs),
        Unary::Sqrt => each(a, out, f64::sqrt),
        Unary::Square => each(a, out, |a| a * a),
        Unary::Sin => each(a, out, number::sin),
        Unary::Cos => each(a, out, number::cos),
        Unary::Exp => each(a, out, f64::exp),
        Unary::Ln => each(a, out, f64::ln),
        Unary::Floor => each(a, out, f64::floor),
        Unary::Atan => each(a, out, f64::atan),
        Unary::Power(3) => each(a, out, |a| number::power(a, 3)),
        Unary::Power(4) => each(a, out, |a| number::power(a, 4)),
        Unary::Power(5) => each(a, out, |a| number::power(a, 5)),
        Unary::Power(6) => each(a, out, |a| number::power(a, 6)),
        Unary::Power(8) => each(a, out, |a| number::power(a, 8)),
        Unary::Power(n) => each(a, out, |a| number::power(a, n)),
    }
}

#[inline(always)]
fn pairs(a: Operand<'_>, b: Operand<'_>, out: &mut [f64], f: impl Fn(f64, f64) -> f64) {
    match (a, b) {
        (Operand::Row(a), Operand::Row(b)) => {
            let rows = a.iter().zip(b);
            out.iter_mut()
                .zip(rows)
                .for_each(|(o, (&a, &b))| *o = f(a, b));
        }
        (Operand::Row(a), Operand::Value(b)) => {
            out.iter_mut().zip(a).for_each(|(o, &a)| *o = f(a, b));
        }
        (Operand::Value(a), Operand::Row(b)) => {
            out.iter_mut().zip(b).for_each(|(o, &b)| *o = f(a, b));
        }
        (Operand::Value(a), Operand::Value(b)) => out.fill(f(a, b)),
    }
}

fn binary_row(f: Binary, a: Operand<'_>, b: Operand<'_>, out: &mut [f64]) {
    match f {
        Binary::Add => pairs(a, b, out, |a, b| a + b),
        Binary::Sub => pairs(a, b, out, |a, b| a - b),
        Binary::Mul => pairs(a, b, out, |a, b| a * b),
        Binary::Div => pairs(a, b, out, number::div),
        Binary::Min => pairs(a, b, out, number::min),
        Binary::Max => pairs(a, b, out, number::max),
        Binary::Hypot => pairs(a, b, out, number::hypot),
        Binary::Less => pairs(a, b, out, number::less),
        Binary::Pow => pairs(a, b, out, number::pow),
        Binary::Atan2 => pairs(a, b, out, number::atan2),
    }
}
