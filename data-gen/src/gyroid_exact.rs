//! Area and volume of the gyroid in the box `[0, n - 1]^3`, to about twelve digits.
//!
//! In radians the box has the side `16 pi - e` with `e = 16 pi / n`: eight whole periods less a
//! sliver. Everything is periodic, so inclusion and exclusion give, for any measure M,
//!
//! `M(box) = M(P, P, P) - 3 M(P, P, e) + 3 M(P, e, e) - M(e, e, e)`
//!
//! where P is eight whole periods, e is the stretch `-e..0`, and the threefold rotation of the
//! axes makes the three slabs equal and the three bars equal. What is left is smooth:
//!
//! - Along one axis `f = A sin(u) + B` with A and B of the two others. So the length that is inside
//!   and the two roots are closed forms.
//! - `f(pi - x, y + pi, z) = -f(x, y, z)`: in every slice z (and by rotation x, y) just half of
//!   a period square is inside, so volumes of cube and slab are halves, exactly.
//! - In a slab `|z| <= pi / 4` every line along y meets the surface exactly twice per
//!   period: `A^2 - B^2 = 1 + cos^2 z - cos^2 x (1 + sin^2 z) >= cos 2z`. So the area of the slab is
//!   an integral of a smooth periodic function over the xz plane. The same holds along x in the bar.
//! - In the corner `-e..0` cubed all three terms of f are negative: nothing is inside.
//! - The area of a whole period cube is three times the integral of `|n_x| dA` weighted by
//!   `|n_x|`, which over the yz plane is `|f_x| / |grad f|` per root: bounded, and zero with a
//!   square root at folds, whose place is a closed form too.

use crate::exact::Exact;
use crate::fields::GYROID_PERIODS;
use crate::quadrature::{Rule, integrate_period};
use std::f64::consts::{FRAC_PI_4, PI, TAU};

/// Bound of the relative error; the tests find two refinements of each rule nearer than this.
const RELATIVE_ERROR: f64 = 1e-11;

/// Smallest lattice: below, the slab comes near `pi / 4`, where its integrand has a pole.
const N_MIN: u32 = 96;

/// Answers for the solid `f >= 0`; `None` unless the lattice is a cube of at least [`N_MIN`] points
/// a side.
pub(crate) fn positive_part(size: [u32; 3]) -> Option<Exact> {
    let n = size[0];
    if size != [n; 3] || n < N_MIN {
        return None;
    }
    let periods = f64::from(GYROID_PERIODS);
    let sliver = TAU * periods / f64::from(n);
    let whole = TAU * periods;
    // One voxel is one sliver.
    let voxel = sliver;
    let rule = Rule::gauss(24);
    let period = period_area(&Rule::double_exponential(5), &Rule::double_exponential(4));
    let volume = 0.5 * whole.powi(3) - 1.5 * whole * whole * sliver
        + 3.0 * periods * bar_volume(&rule, sliver);
    let area = periods.powi(3) * period - 3.0 * periods * periods * slab_area(&rule, 256, sliver)
        + 3.0 * periods * bar_area(&rule, sliver);
    let faces = [0.0, -sliver].map(|x| face_area(&rule, x, whole, sliver));
    let cap_area = 3.0 * (faces[0] + faces[1]);
    Some(Exact {
        area: area / (voxel * voxel),
        cap_area: cap_area / (voxel * voxel),
        volume: volume / (voxel * voxel * voxel),
        relative_error: RELATIVE_ERROR,
        components: None,
        genus: None,
        euler: None,
    })
}

/// Answers for the solid `f < 0`: the rest of the box.
pub(crate) fn negative_part(size: [u32; 3]) -> Option<Exact> {
    let positive = positive_part(size)?;
    let side = f64::from(size[0] - 1);
    Some(Exact {
        volume: side.powi(3) - positive.volume,
        cap_area: 6.0 * side * side - positive.cap_area,
        ..positive
    })
}

/// `f` along one axis t while the next two are `u` and `v`:
/// `sin t cos u + sin u cos v + sin v cos t = a sin(t + phase) + b`.
struct Line {
    /// `sin v`, `cos u`: a times sine and cosine of the phase.
    sin_v: f64,
    cos_u: f64,
    a: f64,
    b: f64,
}

impl Line {
    fn new(u: f64, v: f64) -> Self {
        let (sin_v, cos_u) = (v.sin(), u.cos());
        Self {
            sin_v,
            cos_u,
            a: sin_v.hypot(cos_u),
            b: u.sin() * v.cos(),
        }
    }

    /// Length of one period that has `f >= 0`.
    fn inside(&self) -> f64 {
        PI + 2.0 * (self.b / self.a).clamp(-1.0, 1.0).asin()
    }

    /// `|df/dt|` at both roots, zero where there is none.
    fn slope(&self) -> f64 {
        ((self.a - self.b) * (self.a + self.b)).max(0.0).sqrt()
    }

    /// Length of the gradient at the two roots.
    fn gradients(&self, u: f64, v: f64) -> [f64; 2] {
        let slope = self.slope();
        [slope, -slope].map(|f_t| {
            // a cos(t + phase) = f_t and a sin(t + phase) = -b; turn back by the phase.
            let aa = self.a * self.a;
            let sin_t = (-self.b * self.cos_u - f_t * self.sin_v) / aa;
            let cos_t = (f_t * self.cos_u - self.b * self.sin_v) / aa;
            let f_u = u.cos() * v.cos() - sin_t * u.sin();
            let f_v = v.cos() * cos_t - u.sin() * v.sin();
            (f_t * f_t + f_u * f_u + f_v * f_v).sqrt()
        })
    }

    /// Area of the surface per area of the uv plane: both roots.
    fn area(&self, u: f64, v: f64) -> f64 {
        let [first, second] = self.gradients(u, v);
        (first + second) / self.slope()
    }

    /// The same, weighted by the square of the normal's component along t.
    fn weighted_area(&self, u: f64, v: f64) -> f64 {
        let [first, second] = self.gradients(u, v);
        self.slope() * (1.0 / first + 1.0 / second)
    }
}

/// Area in one cube of side 2 pi.
fn period_area(outer: &Rule, inner: &Rule) -> f64 {
    let along_v = |u: f64| {
        // Roots exist where sin^2 v > -cos 2u / (1 + sin^2 u).
        let bound = (-(2.0 * u).cos() / (1.0 + u.sin().powi(2))).max(0.0);
        let fold = bound.sqrt().min(1.0).asin();
        inner.integrate(fold, PI - fold, |v| {
            let line = Line::new(u, v);
            if line.slope() > 0.0 {
                line.weighted_area(u, v)
            } else {
                0.0
            }
        })
    };
    // The half v > pi is as large as this one, by f(pi - x, y + pi, z) = -f with the axes renamed.
    let quarters = (0..8).map(|m| f64::from(m) * FRAC_PI_4);
    let half: f64 = quarters
        .map(|u| outer.integrate(u, u + FRAC_PI_4, along_v))
        .sum();
    3.0 * 2.0 * half
}

/// Area over one period square times `-sliver..0`.
fn slab_area(rule: &Rule, count: u32, sliver: f64) -> f64 {
    // Along y the next axes are z and x.
    rule.integrate(-sliver, 0.0, |z| {
        integrate_period(TAU, count, |x| Line::new(z, x).area(z, x))
    })
}

/// Area over one period along x times `-sliver..0` squared.
fn bar_area(rule: &Rule, sliver: f64) -> f64 {
    rule.integrate(-sliver, 0.0, |y| {
        rule.integrate(-sliver, 0.0, |z| Line::new(y, z).area(y, z))
    })
}

/// Inside volume of one period along x times `-sliver..0` squared.
fn bar_volume(rule: &Rule, sliver: f64) -> f64 {
    rule.integrate(-sliver, 0.0, |y| {
        rule.integrate(-sliver, 0.0, |z| Line::new(y, z).inside())
    })
}

/// Inside area of the face at `x`, which is 0 or `-sliver`.
fn face_area(rule: &Rule, x: f64, whole: f64, sliver: f64) -> f64 {
    let periods = f64::from(GYROID_PERIODS);
    // Whole along z with y in the sliver: next axes after z are x and y. And the other way round.
    let along_z = rule.integrate(-sliver, 0.0, |y| Line::new(x, y).inside());
    let along_y = rule.integrate(-sliver, 0.0, |z| Line::new(z, x).inside());
    0.5 * whole * whole - periods * (along_z + along_y)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: f64, b: f64, relative: f64) {
        assert!(
            (a / b - 1.0).abs() < relative,
            "{a} and {b} differ by {}",
            a / b - 1.0
        );
    }

    #[test]
    fn period_area_has_converged() {
        let [coarse, fine] = [[4, 5], [5, 6]].map(|[inner, outer]| {
            period_area(
                &Rule::double_exponential(outer),
                &Rule::double_exponential(inner),
            )
        });
        near(coarse, fine, RELATIVE_ERROR);
    }

    #[test]
    fn slivers_have_converged() {
        for n in [N_MIN, 256, 4096] {
            let sliver = TAU * 8.0 / f64::from(n);
            let [coarse, fine] = [Rule::gauss(16), Rule::gauss(24)];
            near(
                slab_area(&coarse, 128, sliver),
                slab_area(&fine, 256, sliver),
                1e-9,
            );
            near(bar_area(&coarse, sliver), bar_area(&fine, sliver), 1e-12);
            near(
                bar_volume(&coarse, sliver),
                bar_volume(&fine, sliver),
                1e-12,
            );
        }
    }

    /// Area of a period cube as the limit of the integral of a smooth bump of f times the gradient:
    /// no roots, no folds, no plane of projection.
    #[test]
    fn period_area_equals_the_coarea_limit() {
        let count = 192u32;
        let widths = [0.2, 0.1, 0.05];
        let step = TAU / f64::from(count);
        let table: Vec<(f64, f64)> = (0..count)
            .map(|m| (step * f64::from(m)).sin_cos())
            .collect();
        let mut sums = [0.0; 3];
        for &(sx, cx) in &table {
            for &(sy, cy) in &table {
                for &(sz, cz) in &table {
                    let f: f64 = sx * cy + sy * cz + sz * cx;
                    let g = [cx * cy - sz * sx, cy * cz - sx * sy, cz * cx - sy * sz];
                    let length = (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]).sqrt();
                    for (sum, width) in sums.iter_mut().zip(widths) {
                        *sum += (-0.5 * (f / width).powi(2)).exp() * length;
                    }
                }
            }
        }
        let area = |m: usize| sums[m] * step.powi(3) / (widths[m] * TAU.sqrt());
        // The error is even in the width: two steps of extrapolation leave its sixth power.
        let [a, b, c] = [area(0), area(1), area(2)];
        let (ab, bc) = ((4.0 * b - a) / 3.0, (4.0 * c - b) / 3.0);
        let limit = (16.0 * bc - ab) / 15.0;
        let exact = period_area(&Rule::double_exponential(4), &Rule::double_exponential(3));
        near(limit, exact, 1e-6);
    }

    /// The whole box by plain sums over lines: roots in the box only, each weighted by its normal.
    #[test]
    fn box_equals_plain_sums_over_lines() {
        let n = 96u32;
        let exact = positive_part([n; 3]).expect("a cube");
        let voxel = TAU * 8.0 / f64::from(n);
        let side = voxel * f64::from(n - 1);
        let count = 700u32;
        let step = side / f64::from(count);
        let (mut area, mut volume) = (0.0, 0.0);
        for m in 0..count * count {
            let at = |m: u32| (f64::from(m) + 0.5) * step;
            let (u, v) = (at(m % count), at(m / count));
            let line = Line::new(u, v);
            let phase = line.sin_v.atan2(line.cos_u);
            let slope = line.slope();
            if slope > 0.0 {
                let [first, second] = line.gradients(u, v);
                let up = (-line.b / line.a).asin() - phase;
                let down = PI - (-line.b / line.a).asin() - phase;
                let roots = |t: f64| {
                    (0..10)
                        .filter(|&p| {
                            let t = t.rem_euclid(TAU) + TAU * f64::from(p);
                            t <= side
                        })
                        .count() as f64
                };
                area += slope * (roots(up) / first + roots(down) / second);
                // Length inside: from each upward root to the next downward root.
                let gap = (down - up).rem_euclid(TAU);
                let first_up = up.rem_euclid(TAU) - TAU;
                for p in 0..10 {
                    let start = first_up + TAU * f64::from(p);
                    volume += ((start + gap).min(side) - start.max(0.0)).max(0.0);
                }
            } else if line.b >= 0.0 {
                volume += side;
            }
        }
        // The box turns into itself when the axes turn, so three directions are three times one.
        let area = 3.0 * area * step * step / (voxel * voxel);
        let volume = volume * step * step / voxel.powi(3);
        near(area, exact.area, 1e-4);
        near(volume, exact.volume, 1e-5);
    }

    #[test]
    fn caps_equal_plain_sums() {
        let n = 100u32;
        let exact = positive_part([n; 3]).expect("a cube");
        let k = TAU * 8.0 / f64::from(n);
        let side = f64::from(n - 1);
        let count = 1500u32;
        let mut inside = 0u64;
        for m in 0..count * count {
            let at = |m: u32| k * (f64::from(m) + 0.5) * side / f64::from(count);
            let (u, v) = (at(m % count), at(m / count));
            for t in [0.0, k * side] {
                let line = Line::new(u, v);
                inside += u64::from(line.sin_v * t.cos() + line.cos_u * t.sin() + line.b >= 0.0);
            }
        }
        let sum = 3.0 * inside as f64 * (side / f64::from(count)).powi(2);
        near(sum, exact.cap_area, 1e-4);
        let other = negative_part([n; 3]).expect("a cube");
        near(exact.volume + other.volume, side.powi(3), 1e-14);
    }

    #[test]
    fn only_what_the_formula_covers() {
        assert!(positive_part([N_MIN - 1; 3]).is_none());
        assert!(positive_part([100, 100, 101]).is_none());
        assert!(positive_part([N_MIN; 3]).is_some());
    }
}
