//! A model as text that other programs read: one operation a line.

use super::field::Model;
use super::graph::{Binary, Id, Op, Unary};
use super::shape::Convention;
use crate::error::{Error, Result};
use std::fmt::Write;

impl Model {
    /// The operations one a line, `NAME OPERATION OPERANDS...`, the last one the value, below 0 inside: the text form
    /// that [fidget](https://docs.rs/fidget) reads.
    ///
    /// Powers and hypotenuses are written by products and roots, so rounding may differ from that of the model.
    ///
    /// # Errors
    /// When a part is no formula: an outline, a table of heights, a scan.
    pub fn listing(&self) -> Result<String> {
        let mut lines = Lines {
            text: String::new(),
            count: 0,
        };
        let mut names: Vec<u32> = Vec::new();
        for &op in &self.tape.ops {
            let name = lines.operation(op, |id: Id| names[id as usize])?;
            names.push(name);
        }
        if let (Convention::Density { iso }, Some(&last)) = (self.convention(), names.last()) {
            let iso = lines.constant(iso);
            lines.line("sub", &[iso, last]);
        }
        Ok(lines.text)
    }
}

struct Lines {
    text: String,
    count: u32,
}

impl Lines {
    /// Adds a line and returns its name.
    fn line(&mut self, operation: &str, operands: &[u32]) -> u32 {
        // A string never fails.
        let _ = write!(self.text, "_{} {operation}", self.count);
        for operand in operands {
            let _ = write!(self.text, " _{operand}");
        }
        self.text.push('\n');
        self.count += 1;
        self.count - 1
    }

    fn constant(&mut self, value: f64) -> u32 {
        self.line(&format!("const {value:e}"), &[])
    }

    /// The same products as [`number::power`](super::number::power).
    fn power(&mut self, a: u32, exponent: u16) -> u32 {
        let (mut base, mut left, mut out) = (a, exponent, None);
        loop {
            if left & 1 == 1 {
                out = Some(out.map_or(base, |out| self.line("mul", &[out, base])));
            }
            left >>= 1;
            match out {
                Some(out) if left == 0 => return out,
                _ => base = self.line("square", &[base]),
            }
        }
    }

    fn operation(&mut self, op: Op, name: impl Fn(Id) -> u32) -> Result<u32> {
        Ok(match op {
            Op::Const(bits) => self.constant(f64::from_bits(bits)),
            Op::Axis(a) => self.line(["var-x", "var-y", "var-z"][a as usize], &[]),
            Op::Unary(Unary::Power(n), a) => self.power(name(a), n),
            Op::Unary(f, a) => self.line(unary_name(f), &[name(a)]),
            Op::Binary(f, a, b) => self.binary(f, name(a), name(b)),
            Op::Oracle(..) => {
                return Err(Error::bad_input(
                    "a listing holds formulas only: leave out outlines, tables of heights and scans",
                ));
            }
        })
    }

    fn binary(&mut self, f: Binary, a: u32, b: u32) -> u32 {
        let name = match f {
            Binary::Add => "add",
            Binary::Sub => "sub",
            Binary::Mul => "mul",
            Binary::Div => "div",
            Binary::Min => "min",
            Binary::Max => "max",
            Binary::Atan2 => "atan2",
            Binary::Hypot => {
                let squares = [a, b].map(|v| self.line("square", &[v]));
                let sum = self.line("add", &squares);
                return self.line("sqrt", &[sum]);
            }
            Binary::Less => {
                // 1 for larger, 0 for equal, -1 for less.
                let order = self.line("compare", &[b, a]);
                let zero = self.constant(0.0);
                return self.line("max", &[order, zero]);
            }
            Binary::Pow => {
                let log = self.line("ln", &[a]);
                let log = self.line("mul", &[log, b]);
                return self.line("exp", &[log]);
            }
        };
        self.line(name, &[a, b])
    }
}

fn unary_name(f: Unary) -> &'static str {
    match f {
        Unary::Neg => "neg",
        Unary::Abs => "abs",
        Unary::Sqrt => "sqrt",
        Unary::Square | Unary::Power(_) => "square",
        Unary::Sin => "sin",
        Unary::Cos => "cos",
        Unary::Exp => "exp",
        Unary::Ln => "ln",
        Unary::Floor => "floor",
        Unary::Atan => "atan",
    }
}
