//! Formulas as text: `x^2 + y^2 - (0.5 + 0.1*sin(6*z))^2`.
//!
//! Numbers, `x y z`, `pi`, named parameters, `+ - * / ^`, parentheses and the functions in
//! [`FUNCTIONS`]. `^` binds tighter than a sign before it and to the right; a whole exponent is
//! repeated multiplication.

use super::graph::{Binary, Graph, Id, Unary};
use crate::error::{Error, Result};

/// Names of the functions and how many arguments they take (`min` and `max`: two or more).
pub const FUNCTIONS: [(&str, usize); 22] = [
    ("sqrt", 1),
    ("abs", 1),
    ("sin", 1),
    ("cos", 1),
    ("tan", 1),
    ("asin", 1),
    ("acos", 1),
    ("atan", 1),
    ("sinh", 1),
    ("cosh", 1),
    ("tanh", 1),
    ("exp", 1),
    ("ln", 1),
    ("floor", 1),
    ("fract", 1),
    ("square", 1),
    ("min", 2),
    ("max", 2),
    ("hypot", 2),
    ("atan2", 2),
    ("pow", 2),
    ("mod", 2),
];

/// Deepest nesting, and most characters.
const MAX_DEPTH: usize = 200;
const MAX_LENGTH: usize = 1 << 16;

/// A parsed formula.
#[derive(Clone, Debug, PartialEq)]
pub struct Expression {
    nodes: Vec<Node>,
}

/// Operands come before what uses them; the last node is the value.
#[derive(Clone, Debug, PartialEq)]
enum Node {
    Number(f64),
    Axis(usize),
    Binary(char, usize, usize),
    Neg(usize),
    Call(&'static str, Vec<usize>),
}

impl Expression {
    /// Parses `text`; `parameter` gives the values of names.
    ///
    /// ```
    /// use brickmarch::model::Expression;
    /// let half = Expression::parse("1/2 + a", &|name| (name == "a").then_some(0.25)).unwrap();
    /// assert_eq!(half.constant(), Some(0.75));
    /// assert!(Expression::parse("1 +* 2", &|_| None).is_err());
    /// ```
    ///
    /// # Errors
    /// Says at which character what was expected.
    pub fn parse(text: &str, parameter: &dyn Fn(&str) -> Option<f64>) -> Result<Expression> {
        if text.len() > MAX_LENGTH {
            return Err(Error::bad_input(format!(
                "formula of {} characters: give at most {MAX_LENGTH}",
                text.len()
            )));
        }
        let mut parser = Parser {
            text,
            at: 0,
            depth: 0,
            nodes: Vec::new(),
            parameter,
        };
        parser.sum()?;
        parser.skip_blanks();
        if parser.at < text.len() {
            return Err(parser.error("an operator or the end"));
        }
        Ok(Expression {
            nodes: parser.nodes,
        })
    }

    /// Its value, if it does not depend on x, y, z.
    pub fn constant(&self) -> Option<f64> {
        if self.nodes.iter().any(|n| matches!(n, Node::Axis(_))) {
            return None;
        }
        let mut graph = Graph::default();
        let point = graph.axes();
        let id = self.build(&mut graph, point).ok()?;
        graph.value(id)
    }

    pub(super) fn build(&self, g: &mut Graph, point: [Id; 3]) -> Result<Id> {
        let mut ids: Vec<Id> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            let id = match node {
                Node::Number(v) => g.constant(*v),
                Node::Axis(a) => point[*a],
                Node::Neg(a) => g.neg(ids[*a]),
                Node::Binary(op, a, b) => operator(g, *op, ids[*a], ids[*b]),
                Node::Call(name, args) => {
                    let args: Vec<Id> = args.iter().map(|&a| ids[a]).collect();
                    call(g, name, &args)
                }
            };
            ids.push(id);
        }
        g.check_size()?;
        ids.last()
            .copied()
            .ok_or_else(|| Error::bad_input("the formula is empty"))
    }
}

fn operator(g: &mut Graph, op: char, a: Id, b: Id) -> Id {
    match op {
        '+' => g.add(a, b),
        '-' => g.sub(a, b),
        '*' => g.mul(a, b),
        '/' => g.div(a, b),
        _ => power(g, a, b),
    }
}

fn power(g: &mut Graph, a: Id, b: Id) -> Id {
    match g.value(b) {
        Some(v) if v == v.trunc() && v.abs() <= 1024.0 => g.power(a, v as i32),
        Some(0.5) => g.sqrt(a),
        _ => g.binary(Binary::Pow, a, b),
    }
}

fn call(g: &mut Graph, name: &str, args: &[Id]) -> Id {
    let a = args[0];
    let half_sum = |g: &mut Graph, sign: f64| {
        let up = g.unary(Unary::Exp, a);
        let down = g.neg(a);
        let down = g.unary(Unary::Exp, down);
        let down = g.scale(down, sign);
        let sum = g.add(up, down);
        g.scale(sum, 0.5)
    };
    let beside = |g: &mut Graph| {
        let square = g.square(a);
        let one = g.constant(1.0);
        let rest = g.sub(one, square);
        g.sqrt(rest)
    };
    match name {
        "sqrt" => g.sqrt(a),
        "abs" => g.abs(a),
        "square" => g.square(a),
        "sin" => g.unary(Unary::Sin, a),
        "cos" => g.unary(Unary::Cos, a),
        "tan" => {
            let (s, c) = (g.unary(Unary::Sin, a), g.unary(Unary::Cos, a));
            g.div(s, c)
        }
        "asin" => {
            let c = beside(g);
            g.binary(Binary::Atan2, a, c)
        }
        "acos" => {
            let s = beside(g);
            g.binary(Binary::Atan2, s, a)
        }
        "atan" => g.unary(Unary::Atan, a),
        "sinh" => half_sum(g, -1.0),
        "cosh" => half_sum(g, 1.0),
        "tanh" => {
            // 1 - 2 / (e^2a + 1) does not overflow to no number.
            let twice = g.scale(a, 2.0);
            let e = g.unary(Unary::Exp, twice);
            let below = g.add_value(e, 1.0);
            let two = g.constant(2.0);
            let part = g.div(two, below);
            let one = g.constant(1.0);
            g.sub(one, part)
        }
        "exp" => g.unary(Unary::Exp, a),
        "ln" => g.unary(Unary::Ln, a),
        "floor" => g.unary(Unary::Floor, a),
        "fract" => {
            let whole = g.unary(Unary::Floor, a);
            g.sub(a, whole)
        }
        "min" => args[1..].iter().fold(a, |m, &b| g.min(m, b)),
        "max" => args[1..].iter().fold(a, |m, &b| g.max(m, b)),
        "hypot" => g.hypot(a, args[1]),
        "atan2" => g.binary(Binary::Atan2, a, args[1]),
        "pow" => power(g, a, args[1]),
        _ => {
            // mod: with the sign of the divisor.
            let n = g.div(a, args[1]);
            let n = g.unary(Unary::Floor, n);
            let whole = g.mul(n, args[1]);
            g.sub(a, whole)
        }
    }
}

struct Parser<'a> {
    text: &'a str,
    at: usize,
    depth: usize,
    nodes: Vec<Node>,
    parameter: &'a dyn Fn(&str) -> Option<f64>,
}

impl Parser<'_> {
    fn skip_blanks(&mut self) {
        let rest = &self.text[self.at..];
        self.at += rest.len() - rest.trim_start().len();
    }

    fn peek(&mut self) -> Option<char> {
        self.skip_blanks();
        self.text[self.at..].chars().next()
    }

    fn take(&mut self, wanted: char) -> bool {
        let found = self.peek() == Some(wanted);
        if found {
            self.at += wanted.len_utf8();
        }
        found
    }

    fn error(&self, expected: &str) -> Error {
        let before = self.text[..self.at].chars().count();
        let found = match self.text[self.at..].chars().next() {
            Some(c) => format!("'{c}'"),
            None => "the end".to_string(),
        };
        Error::bad_input(format!(
            "formula \"{}\": expected {expected} at character {}, found {found}",
            self.text.chars().take(80).collect::<String>(),
            before + 1
        ))
    }

    fn push(&mut self, node: Node) -> usize {
        self.nodes.push(node);
        self.nodes.len() - 1
    }

    fn deeper<T>(&mut self, inner: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        self.depth += 1;
        if self.depth > MAX_DEPTH {
            return Err(self.error(&format!("at most {MAX_DEPTH} levels of nesting")));
        }
        let out = inner(self);
        self.depth -= 1;
        out
    }

    fn sum(&mut self) -> Result<usize> {
        let mut left = self.product()?;
        loop {
            let op = match self.peek() {
                Some(op @ ('+' | '-')) => op,
                _ => return Ok(left),
            };
            self.at += 1;
            let right = self.product()?;
            left = self.push(Node::Binary(op, left, right));
        }
    }

    fn product(&mut self) -> Result<usize> {
        let mut left = self.signed()?;
        loop {
            let op = match self.peek() {
                Some(op @ ('*' | '/')) => op,
                _ => return Ok(left),
            };
            self.at += 1;
            let right = self.signed()?;
            left = self.push(Node::Binary(op, left, right));
        }
    }

    fn signed(&mut self) -> Result<usize> {
        if self.take('-') {
            let inner = self.deeper(Self::signed)?;
            return Ok(self.push(Node::Neg(inner)));
        }
        if self.take('+') {
            return self.deeper(Self::signed);
        }
        let base = self.atom()?;
        if self.take('^') {
            let exponent = self.deeper(Self::signed)?;
            return Ok(self.push(Node::Binary('^', base, exponent)));
        }
        Ok(base)
    }

    fn atom(&mut self) -> Result<usize> {
        match self.peek() {
            Some('(') => {
                self.at += 1;
                let inner = self.deeper(Self::sum)?;
                if !self.take(')') {
                    return Err(self.error("')'"));
                }
                Ok(inner)
            }
            Some(c) if c.is_ascii_digit() || c == '.' => self.number(),
            Some(c) if c.is_ascii_alphabetic() || c == '_' => self.name(),
            _ => Err(self.error("a number, a name or '('")),
        }
    }

    fn number(&mut self) -> Result<usize> {
        let rest = &self.text[self.at..];
        let bytes = rest.as_bytes();
        let digits = |mut i: usize| {
            while bytes
                .get(i)
                .is_some_and(|b| b.is_ascii_digit() || *b == b'.')
            {
                i += 1;
            }
            i
        };
        let mut end = digits(0);
        if matches!(bytes.get(end), Some(b'e' | b'E')) {
            let sign = usize::from(matches!(bytes.get(end + 1), Some(b'+' | b'-')));
            if bytes.get(end + 1 + sign).is_some_and(u8::is_ascii_digit) {
                end = digits(end + 1 + sign);
            }
        }
        match rest[..end].parse::<f64>() {
            Ok(value) if value.is_finite() => {
                self.at += end;
                Ok(self.push(Node::Number(value)))
            }
            _ => Err(self.error("a number")),
        }
    }

    fn name(&mut self) -> Result<usize> {
        let rest = &self.text[self.at..];
        let end = rest
            .find(|c: char| !(c.is_ascii_alphanumeric() || c == '_'))
            .unwrap_or(rest.len());
        let name = &rest[..end];
        let function = FUNCTIONS.iter().find(|(n, _)| *n == name);
        let start = self.at;
        self.at += end;
        if self.peek() == Some('(') {
            let Some(&(name, wanted)) = function else {
                self.at = start;
                return Err(self.error(&format!("a function; '{name}' is none of {}", all_names())));
            };
            self.at += 1;
            return self.arguments(name, wanted);
        }
        let axis = ["x", "y", "z"].iter().position(|a| *a == name);
        if let Some(axis) = axis {
            return Ok(self.push(Node::Axis(axis)));
        }
        let value = match name {
            "pi" => Some(std::f64::consts::PI),
            _ => (self.parameter)(name),
        };
        match value {
            Some(value) => Ok(self.push(Node::Number(value))),
            None => {
                self.at = start;
                Err(self.error(&format!(
                    "x, y, z, pi, a function or a parameter ('{name}' is not defined)"
                )))
            }
        }
    }

    fn arguments(&mut self, name: &'static str, wanted: usize) -> Result<usize> {
        let mut args = Vec::new();
        loop {
            args.push(self.deeper(Self::sum)?);
            if self.take(',') {
                continue;
            }
            if self.take(')') {
                break;
            }
            return Err(self.error("',' or ')'"));
        }
        let many = matches!(name, "min" | "max") && args.len() > wanted;
        if args.len() != wanted && !many {
            return Err(self.error(&format!(
                "{wanted} argument{} of {name}, not {}, before here",
                if wanted == 1 { "" } else { "s" },
                args.len()
            )));
        }
        Ok(self.push(Node::Call(name, args)))
    }
}

fn all_names() -> String {
    FUNCTIONS.map(|(name, _)| name).join(", ")
}
