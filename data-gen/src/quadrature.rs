//! Numerical integration in f64.

use std::f64::consts::PI;

/// A rule on `-1..1`: nodes and weights. Ends are given as the distance to the nearer end, so that
/// integrands with a root there lose no digits.
#[derive(Clone, Debug)]
pub(crate) struct Rule(Vec<(f64, f64)>);

impl Rule {
    /// Gauss-Legendre with `count` nodes: exact for polynomials of degree `2 count - 1`.
    pub(crate) fn gauss(count: usize) -> Self {
        let node = |m: usize| {
            let mut x = (PI * (m as f64 + 0.75) / (count as f64 + 0.5)).cos();
            let mut slope = 1.0;
            for _ in 0..20 {
                let (value, derivative) = legendre(count, x);
                slope = derivative;
                let step = value / derivative;
                x -= step;
                if step.abs() < 1e-16 {
                    break;
                }
            }
            (x, 2.0 / ((1.0 - x * x) * slope * slope))
        };
        Self((0..count).map(node).collect())
    }

    /// Double exponential (Takahasi, Mori 1974) with step `2^-level`: converges for integrands with
    /// any integrable singularity at the ends.
    pub(crate) fn double_exponential(level: i32) -> Self {
        let step = 0.5f64.powi(level);
        let last = (3.2 / step) as i32;
        let node = |m: i32| {
            let t = step * f64::from(m);
            let u = PI / 2.0 * t.sinh();
            let weight = step * PI / 2.0 * t.cosh() / u.cosh().powi(2);
            (u.tanh(), weight)
        };
        Self((-last..=last).map(node).collect())
    }

    /// Integral of `f` over `a..b`.
    pub(crate) fn integrate(&self, a: f64, b: f64, f: impl Fn(f64) -> f64) -> f64 {
        let (middle, half) = (0.5 * (a + b), 0.5 * (b - a));
        let sum: f64 = self.0.iter().map(|&(x, w)| w * f(middle + half * x)).sum();
        half * sum
    }
}

/// Integral over one whole period `0..period`: equal steps converge fastest of all there.
pub(crate) fn integrate_period(period: f64, count: u32, f: impl Fn(f64) -> f64) -> f64 {
    let step = period / f64::from(count);
    step * (0..count).map(|m| f(step * f64::from(m))).sum::<f64>()
}

/// Legendre polynomial of degree `count` and its derivative.
fn legendre(count: usize, x: f64) -> (f64, f64) {
    let (mut before, mut value) = (1.0, x);
    for n in 2..=count {
        let n = n as f64;
        let next = ((2.0 * n - 1.0) * x * value - (n - 1.0) * before) / n;
        before = value;
        value = next;
    }
    (value, count as f64 * (x * value - before) / (x * x - 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_find_known_integrals() {
        let gauss = Rule::gauss(12).integrate(0.0, 2.0, f64::exp);
        assert!((gauss - (2f64.exp() - 1.0)).abs() < 1e-13);
        let root =
            Rule::double_exponential(4).integrate(-1.0, 1.0, |x| (1.0 - x * x).max(0.0).sqrt());
        assert!((root - PI / 2.0).abs() < 1e-13, "{root}");
        let circle = integrate_period(2.0 * PI, 32, |x| x.cos().exp());
        assert!((circle - 7.954_926_521_012_845).abs() < 1e-12);
    }
}
