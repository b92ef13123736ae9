//! Signs of small polynomials, exactly.
//!
//! Sums and products of doubles are kept as unevaluated sums of doubles that do not overlap
//! (Shewchuk 1997). The numbers that come in are differences of single precision samples: multiples
//! of 2^-149 below 2^130, so products of four of them neither overflow nor underflow.

/// -1, 0 or 1.
pub(super) fn sign(v: f64) -> i32 {
    i32::from(v > 0.0) - i32::from(v < 0.0)
}

/// The sign of `a b - c d`.
#[inline]
pub(super) fn determinant_sign(a: f64, b: f64, c: f64, d: f64) -> i32 {
    let (p, q) = (a * b, c * d);
    // Rounding keeps the order; only what it has made equal needs a second look. The order itself
    // is a coin toss for a branch.
    if p == q {
        return sign(tail(a, b, p) - tail(c, d, q));
    }
    i32::from(p > q) - i32::from(p < q)
}

/// What `product`, the rounded product of `a` and `b`, leaves out (Dekker 1971).
fn tail(a: f64, b: f64, product: f64) -> f64 {
    let split = |v: f64| {
        let c = v * f64::from((1 << 27) + 1);
        let high = c - (c - v);
        (high, v - high)
    };
    let ((ah, al), (bh, bl)) = (split(a), split(b));
    al * bl - (((product - ah * bh) - al * bh) - ah * bl)
}

/// The rounded sum and what it leaves out (Knuth).
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let part = sum - a;
    (sum, (a - (sum - part)) + (b - part))
}

/// An exact sum of doubles: parts that do not overlap, smallest first.
#[derive(Clone, Debug, Default)]
pub(super) struct Sum(Vec<f64>);

impl Sum {
    pub(super) fn of(values: &[f64]) -> Self {
        let mut sum = Self::default();
        values.iter().for_each(|&v| sum.add(v));
        sum
    }

    /// The sum of products.
    pub(super) fn of_products(pairs: &[(f64, f64)]) -> Self {
        let mut sum = Self::default();
        pairs.iter().for_each(|&(a, b)| sum.add_product(a, b));
        sum
    }

    fn add(&mut self, value: f64) {
        let (mut carry, mut kept) = (value, 0);
        for i in 0..self.0.len() {
            let (sum, rest) = two_sum(carry, self.0[i]);
            carry = sum;
            if rest != 0.0 {
                self.0[kept] = rest;
                kept += 1;
            }
        }
        self.0.truncate(kept);
        if carry != 0.0 {
            self.0.push(carry);
        }
    }

    fn add_product(&mut self, a: f64, b: f64) {
        let product = a * b;
        self.add(tail(a, b, product));
        self.add(product);
    }

    pub(super) fn plus(mut self, other: &Sum) -> Self {
        other.0.iter().for_each(|&v| self.add(v));
        self
    }

    pub(super) fn times(&self, other: &Sum) -> Self {
        let mut out = Self::default();
        for &a in &self.0 {
            for &b in &other.0 {
                out.add_product(a, b);
            }
        }
        out
    }

    /// Times a power of two, which may be negative.
    pub(super) fn scaled(mut self, by: f64) -> Self {
        self.0.iter_mut().for_each(|v| *v *= by);
        self
    }

    pub(super) fn sign(&self) -> i32 {
        self.0.last().map_or(0, |&v| sign(v))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// SplitMix64.
    fn numbers() -> impl FnMut() -> u64 {
        let mut state = 5u64;
        move || {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let z = (state ^ state >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z ^ z >> 29
        }
    }

    #[test]
    fn determinants_agree_with_whole_numbers() {
        let mut next = numbers();
        for round in 0..20_000 {
            // Up to 50 bits; every second time a tie or one off a tie.
            let mut v = [0i64; 4].map(|_| (next() >> (14 + next() % 40)) as i64 - (1 << 20));
            if round % 2 == 0 {
                v[3] = v[1];
                v[2] = v[0] + (next() % 3) as i64 - 1;
            }
            let [a, b, c, d] = v.map(|v| v as f64);
            let exact = i128::from(v[0]) * i128::from(v[1]) - i128::from(v[2]) * i128::from(v[3]);
            assert_eq!(determinant_sign(a, b, c, d), exact.signum() as i32, "{v:?}");
        }
    }

    #[test]
    fn products_of_sums_agree_with_whole_numbers() {
        let mut next = numbers();
        for _ in 0..5_000 {
            let v = [0i64; 8].map(|_| (next() >> 34) as i64 - (1 << 29));
            let f = v.map(|v| v as f64);
            let pair = |i: usize| i128::from(v[i]) * i128::from(v[i + 1]);
            // (v0 v1 + v2 v3)(v4 v5 - v6 v7) less its rounded value, an unbiased tiny number.
            let exact = (pair(0) + pair(2)) * (pair(4) - pair(6));
            let near = exact as f64;
            let left = Sum::of_products(&[(f[0], f[1]), (f[2], f[3])]);
            let right = Sum::of_products(&[(f[4], f[5]), (-f[6], f[7])]);
            let rest = left.times(&right).plus(&Sum::of(&[-near]));
            assert_eq!(rest.sign(), (exact - near as i128).signum() as i32);
        }
    }

    #[test]
    fn extremes_neither_overflow_nor_vanish() {
        let (huge, tiny) = (2.0 * f64::from(f32::MAX), f64::from(f32::from_bits(1)));
        for v in [huge, tiny] {
            let square = Sum::of_products(&[(v, v)]);
            let fourth = square.times(&square);
            assert_eq!(fourth.sign(), 1);
            let none = fourth.clone().plus(&fourth.scaled(-1.0));
            assert_eq!(none.sign(), 0);
        }
        let whole = Sum::of(&[huge, tiny, -huge]);
        assert_eq!(whole.sign(), 1);
        assert_eq!(determinant_sign(tiny, tiny, tiny, -tiny), 1);
    }
}
