//! Whole numbers of any size, as slow as they are plain.

use std::cmp::Ordering;

/// Sign and magnitude, 32 bits a limb, lowest first, no zero limb on top.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Whole {
    negative: bool,
    limbs: Vec<u32>,
}

impl Whole {
    /// `value * 2^power`, which must be whole.
    pub(crate) fn scaled(value: f64, power: i32) -> Self {
        let bits = value.to_bits();
        let field = (bits >> 52 & 0x7ff) as i32;
        let low = bits & ((1 << 52) - 1);
        let mantissa = if field == 0 { low } else { low | 1 << 52 };
        let up = field.max(1) - 1075 + power;
        let mut out = Self {
            negative: value < 0.0,
            limbs: Vec::new(),
        };
        if mantissa != 0 {
            let spare = mantissa.trailing_zeros() as i32;
            let (mantissa, up) = (mantissa >> spare, up + spare);
            assert!(up >= 0, "{value} times 2^{power} is not whole");
            out.limbs = vec![0; up as usize / 32];
            let wide = u128::from(mantissa) << (up % 32);
            out.limbs.extend((0..4).map(|i| (wide >> (32 * i)) as u32));
        }
        out.trimmed()
    }

    pub(crate) fn small(value: i32) -> Self {
        Self::scaled(value.into(), 0)
    }

    fn trimmed(mut self) -> Self {
        while self.limbs.last() == Some(&0) {
            self.limbs.pop();
        }
        self.negative &= !self.limbs.is_empty();
        self
    }

    pub(crate) fn sign(&self) -> i32 {
        match (self.limbs.is_empty(), self.negative) {
            (true, _) => 0,
            (_, true) => -1,
            _ => 1,
        }
    }

    pub(crate) fn times(&self, other: &Self) -> Self {
        let mut limbs = vec![0u32; self.limbs.len() + other.limbs.len()];
        for (i, &a) in self.limbs.iter().enumerate() {
            let mut carry = 0u64;
            for (j, &b) in other.limbs.iter().enumerate() {
                let sum = u64::from(a) * u64::from(b) + u64::from(limbs[i + j]) + carry;
                limbs[i + j] = sum as u32;
                carry = sum >> 32;
            }
            limbs[i + other.limbs.len()] = carry as u32;
        }
        let negative = self.negative != other.negative;
        Self { negative, limbs }.trimmed()
    }

    pub(crate) fn minus(&self, other: &Self) -> Self {
        let mut other = other.clone();
        other.negative = !other.negative;
        self.plus(&other)
    }

    pub(crate) fn plus(&self, other: &Self) -> Self {
        if self.negative == other.negative {
            return Self {
                negative: self.negative,
                limbs: sum(&self.limbs, &other.limbs),
            };
        }
        let (large, small) = match compare(&self.limbs, &other.limbs) {
            Ordering::Less => (other, self),
            _ => (self, other),
        };
        Self {
            negative: large.negative,
            limbs: difference(&large.limbs, &small.limbs),
        }
        .trimmed()
    }
}

fn compare(a: &[u32], b: &[u32]) -> Ordering {
    (a.len().cmp(&b.len())).then_with(|| a.iter().rev().cmp(b.iter().rev()))
}

fn sum(a: &[u32], b: &[u32]) -> Vec<u32> {
    let mut carry = 0;
    let mut out = Vec::new();
    for i in 0..a.len().max(b.len()) {
        let limb = |v: &[u32]| u64::from(v.get(i).copied().unwrap_or(0));
        carry += limb(a) + limb(b);
        out.push(carry as u32);
        carry >>= 32;
    }
    if carry > 0 {
        out.push(carry as u32);
    }
    out
}

/// `a - b`, where `a` is not less.
fn difference(a: &[u32], b: &[u32]) -> Vec<u32> {
    let mut borrow = 0;
    let mut out = Vec::new();
    for (i, &limb) in a.iter().enumerate() {
        let d = i64::from(limb) - i64::from(b.get(i).copied().unwrap_or(0)) - borrow;
        borrow = i64::from(d < 0);
        out.push(d as u32);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::support::rng::Rng;

    #[test]
    fn agrees_with_machine_numbers() {
        let mut rng = Rng::new(1);
        let whole = |v: i128| {
            let high = Whole::scaled((v >> 50) as f64, 50);
            high.plus(&Whole::scaled((v & ((1 << 50) - 1)) as f64, 0))
        };
        for _ in 0..2000 {
            let shift = rng.below(60);
            let [a, b, c] = [0; 3].map(|_| (rng.next() as i64 >> (4 + shift)) as i128);
            let (x, y, z) = (whole(a), whole(b), whole(c));
            assert_eq!(x.plus(&y), whole(a + b));
            assert_eq!(x.minus(&y), whole(a - b));
            if shift > 25 {
                assert_eq!(x.times(&y).minus(&z), whole(a * b - c));
                assert_eq!(x.times(&y).minus(&z).sign(), (a * b - c).signum() as i32);
            }
        }
    }
}
