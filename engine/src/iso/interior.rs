//! The interior of a cell: whether two sheets of the surface are joined by a tunnel.
//!
//! On a slice of the cell at `u` along an axis the interpolant is bilinear; let `Q(u)` be the
//! determinant of its four corners, diagonal less other diagonal. Where `Q` is zero the level set
//! of the slice is two straight lines. `Q` is a quadratic with the same discriminant on all axes,
//! Cayley's hyperdeterminant `D` of the eight corners.
//!
//! - `D < 0`: the surface is the graph of a function that is monotone along each axis after a
//!   change of coordinates by axis, and a box cuts it in disks.
//! - `D > 0`: with `p = (u - u1) / (u2 - u)` along each axis, `u1 < u2` the roots of `Q`, the
//!   surface is `p q r = c`. If on some axis a root lies outside the cell, the part inside the cell
//!   is again disks. If all six are inside, they bound a box in the cell: the interpolant is zero
//!   at six of its corners and on the six edges between them, the *waist*. At the other two
//!   corners it has one sign (`c < 0`): then the waist goes around a tunnel; or two signs, then
//!   the waist bounds a disk in the box.
//!
//! In the box `Q` has the sign of the product of the two corners or its opposite, by which of the
//! four diagonals of the box they end; the product of the three signs of `Q` tells the cases apart
//! and the signs tell the diagonal. At most one tunnel, therefore.
//!
//! Ties are above: every sign is that for a level an infinitely small step below the isovalue. The
//! derivative by the step decides where the value itself is zero.

use super::ambiguity::{joined_faces, offsets};
use super::cube::OTHER;
use super::exact::{Sum, determinant_sign, sign};
use super::table::TABLE;
use crate::sample::Inside;

/// A tunnel through a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tunnel {
    /// The corner, of the two ends of the diagonal that the waist goes around, with the fewest bits:
    /// 0, 1, 2 or 4.
    pub(super) apex: usize,
    /// Whether the box of the waist is above the isovalue.
    pub(super) above: bool,
}

/// The number in the table of a cell whose mask does not tell the case.
#[inline(never)]
pub(super) fn decide(values: &[f32; 8], mask: u8, iso: f32, inside: Inside) -> u16 {
    let table = &*TABLE;
    let faces = table.ambiguous[usize::from(mask)];
    let offsets = offsets(values, iso, inside);
    let number = table.number(mask, joined_faces(&offsets, faces, inside));
    if !table.may_hold_tunnel(number) {
        return number;
    }
    find(&offsets)
        .and_then(|tunnel| {
            let inside = tunnel.above == (inside == Inside::Above);
            table.tunnel_number(number, tunnel.apex, inside)
        })
        .unwrap_or(number)
}

/// Corners of the two slices at the ends of an axis: each diagonal first to last, then the other.
struct Slices {
    low: [f64; 4],
    high: [f64; 4],
}

impl Slices {
    fn new(offsets: &[f64; 8], axis: usize) -> Self {
        let [b, c] = OTHER[axis];
        let ring = [0, 1 << b | 1 << c, 1 << b, 1 << c];
        Self {
            low: ring.map(|corner| offsets[corner]),
            high: ring.map(|corner| offsets[corner | 1 << axis]),
        }
    }

    // Q(u) = Q0 (1-u)^2 + R u (1-u) + Q1 u^2, and what a step of the level does to the three.

    fn end_sign(slice: &[f64; 4]) -> i32 {
        let [a, c, b, d] = *slice;
        match determinant_sign(a, c, b, d) {
            0 => Sum::of(&[a, c, -b, -d]).sign(),
            sign => sign,
        }
    }

    fn mixed(&self) -> [(f64, f64); 4] {
        let [a, c, b, d] = self.low;
        let [e, g, f, h] = self.high;
        [(a, g), (e, c), (-b, h), (-f, d)]
    }

    fn mixed_sign(&self) -> i32 {
        let pairs = self.mixed();
        let (value, size) = approximate(&pairs);
        if value.abs() > 8.0 * f64::EPSILON * size {
            return sign(value);
        }
        match Sum::of_products(&pairs).sign() {
            0 => {
                let [a, c, b, d] = self.low;
                let [e, g, f, h] = self.high;
                Sum::of(&[a, c, -b, -d, e, g, -f, -h]).sign()
            }
            sign => sign,
        }
    }

    fn ends(&self) -> [[(f64, f64); 2]; 2] {
        [self.low, self.high].map(|[a, c, b, d]| [(a, c), (-b, d)])
    }

    /// Sign of the discriminant R^2 - 4 Q0 Q1.
    fn discriminant_sign(&self) -> i32 {
        let [low, high] = self.ends();
        let mixed = self.mixed();
        let ((q0, s0), (q1, s1), (r, s)) =
            (approximate(&low), approximate(&high), approximate(&mixed));
        let value = r * r - 4.0 * q0 * q1;
        if value.abs() > 32.0 * f64::EPSILON * (s * s + 4.0 * s0 * s1) {
            return sign(value);
        }
        let (q0, q1) = (Sum::of_products(&low), Sum::of_products(&high));
        let r = Sum::of_products(&mixed);
        let (m0, m1) = self.traces();
        let m = m0.clone().plus(&m1);
        // By powers of the step: 1, then the first, then the second.
        let zeroth = r.times(&r).plus(&q0.times(&q1).scaled(-4.0));
        let cross = q0.times(&m1).plus(&q1.times(&m0));
        let first = r.times(&m).scaled(2.0).plus(&cross.scaled(-4.0));
        let difference = m0.plus(&m1.scaled(-1.0));
        let second = difference.times(&difference);
        let signs = [zeroth, first, second].map(|sum| sum.sign());
        signs.into_iter().find(|&s| s != 0).unwrap_or(0)
    }

    /// Diagonal less other diagonal, as sums, of both ends.
    fn traces(&self) -> (Sum, Sum) {
        let trace = |[a, c, b, d]: [f64; 4]| Sum::of(&[a, c, -b, -d]);
        (trace(self.low), trace(self.high))
    }

    /// Sign, between the roots, of diagonal less other diagonal of the slice.
    fn trace_sign(&self) -> i32 {
        let [_, high] = self.ends();
        let q1 = Sum::of_products(&high);
        let r = Sum::of_products(&self.mixed());
        let (m0, m1) = self.traces();
        let value = (q1.times(&m0).scaled(2.0)).plus(&r.times(&m1).scaled(-1.0));
        let step = m1.times(&m0.plus(&m1.clone().scaled(-1.0)));
        let sign = match value.sign() {
            0 => step.sign(),
            sign => sign,
        };
        sign * Self::end_sign(&self.high)
    }

    /// The roots of Q, both known to lie inside the cell.
    fn roots(&self) -> [f64; 2] {
        let [low, high] = self.ends();
        let (q0, q1) = (approximate(&low).0.abs(), approximate(&high).0.abs());
        let r = approximate(&self.mixed()).0.abs();
        let q = 0.5 * (r + (r * r - 4.0 * q0 * q1).max(0.0).sqrt());
        [q0 / (q0 + q), q / (q + q1)].map(|u| if u.is_finite() { u } else { 0.5 })
    }
}

/// A sum of products, rounded, and the sum of their sizes.
fn approximate(pairs: &[(f64, f64)]) -> (f64, f64) {
    pairs.iter().fold((0.0, 0.0), |(sum, size), (a, b)| {
        (sum + a * b, size + (a * b).abs())
    })
}

/// The tunnel through the cell with these corners less the isovalue, if there is one.
pub(super) fn find(offsets: &[f64; 8]) -> Option<Tunnel> {
    let mut around = 0;
    let mut flipped = None;
    for axis in 0..3 {
        let slices = Slices::new(offsets, axis);
        let end = Slices::end_sign(&slices.low);
        if end == 0 || Slices::end_sign(&slices.high) != end || slices.mixed_sign() != -end {
            return None;
        }
        if end < 0 {
            around += 1;
            flipped = Some(axis);
        }
    }
    let slices = Slices::new(offsets, 0);
    if around % 2 == 0 || slices.discriminant_sign() <= 0 {
        return None;
    }
    let apex = if around == 3 { 0 } else { 1 << flipped? };
    let end = Slices::end_sign(&slices.low);
    Some(Tunnel {
        apex,
        above: slices.trace_sign() * -end > 0,
    })
}

/// The box that the waist lies on, by axis; of a cell with a tunnel.
pub(super) fn waist_box(offsets: &[f64; 8]) -> [[f64; 2]; 3] {
    [0, 1, 2].map(|axis| Slices::new(offsets, axis).roots())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// SplitMix64.
    struct Rng(u64);

    impl Rng {
        fn below(&mut self, n: u64) -> u64 {
            self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            (z ^ z >> 27) % n
        }

        /// Corners of a cell in which opposite ends of a diagonal stand against the rest.
        fn uneven(&mut self) -> [f64; 8] {
            std::array::from_fn(|c| {
                let bits = 1 + self.below(20);
                let size = (1 + self.below(1 << bits)) as f64;
                if c == 0 || c == 7 { size } else { -size }
            })
        }
    }

    #[test]
    fn a_tunnel_is_found_from_every_side() {
        let mut rng = Rng(1);
        let mut tunnels = 0;
        for _ in 0..3_000 {
            let offsets = rng.uneven();
            let found = find(&offsets);
            tunnels += i32::from(found.is_some());
            let negative = find(&offsets.map(|v| -v));
            assert_eq!(negative.map(|t| t.apex), found.map(|t| t.apex));
            assert_eq!(negative.map(|t| !t.above), found.map(|t| t.above));
            for order in [
                [0, 1, 2],
                [0, 2, 1],
                [1, 0, 2],
                [1, 2, 0],
                [2, 0, 1],
                [2, 1, 0],
            ] {
                for flips in 0..8 {
                    let to =
                        |c: usize| (0..3).fold(0, |to, a| to | (c >> order[a] & 1) << a) ^ flips;
                    let mut turned = [0.0; 8];
                    (0..8).for_each(|c| turned[to(c)] = offsets[c]);
                    let want = found.map(|t| {
                        let apex = to(t.apex);
                        let apex = if [0, 1, 2, 4].contains(&apex) {
                            apex
                        } else {
                            7 ^ apex
                        };
                        Tunnel { apex, ..t }
                    });
                    assert_eq!(find(&turned), want, "{offsets:?}");
                }
            }
        }
        assert!(tunnels > 300, "{tunnels}");
    }

    /// The waist lies on the surface, and the box in the cell.
    #[test]
    fn the_waist_is_on_the_surface() {
        let mut rng = Rng(2);
        for _ in 0..10_000 {
            let offsets = rng.uneven();
            let Some(tunnel) = find(&offsets) else {
                continue;
            };
            let sides = waist_box(&offsets);
            let value = |corner: usize| {
                let at: [f64; 3] = std::array::from_fn(|a| sides[a][corner >> a & 1]);
                (0..8).fold(0.0, |sum, c| {
                    let weight = |a: usize| if c >> a & 1 == 1 { at[a] } else { 1.0 - at[a] };
                    sum + weight(0) * weight(1) * weight(2) * offsets[c]
                })
            };
            let size = offsets.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            for corner in 0..8 {
                if corner == tunnel.apex || corner == 7 ^ tunnel.apex {
                    assert!(value(corner) * if tunnel.above { 1.0 } else { -1.0 } > -1e-12 * size);
                } else {
                    assert!(value(corner).abs() < 1e-9 * size, "{offsets:?} {corner}");
                }
            }
            assert!(sides.iter().all(|[a, b]| 0.0 < *a && a <= b && *b < 1.0));
        }
    }

    /// Ties are those of a level one small step lower.
    #[test]
    fn a_tie_is_a_small_step_above() {
        let mut rng = Rng(3);
        let mut singular = 0;
        for _ in 0..200_000 {
            let offsets: [f64; 8] = std::array::from_fn(|_| rng.below(7) as f64 - 3.0);
            let lifted = offsets.map(|v| v * f64::from(1 << 30) + 1.0);
            assert_eq!(find(&offsets), find(&lifted), "{offsets:?}");
            let mask = |v: &[f64; 8]| (0..8).fold(0u8, |m, c| m | u8::from(v[c] >= 0.0) << c);
            assert_eq!(mask(&offsets), mask(&lifted));
            let faces = super::super::table::ambiguous_faces(mask(&offsets));
            assert_eq!(
                joined_faces(&offsets, faces, Inside::Above),
                joined_faces(&lifted, faces, Inside::Above),
                "{offsets:?}"
            );
            let found = find(&offsets).is_some();
            singular += i32::from(found && Slices::new(&offsets, 0).roots()[0] == 0.5);
        }
        assert!(singular > 0, "a waist of no size was among them");
    }

    /// What the signs say fits the loops that the faces say.
    #[test]
    fn every_tunnel_found_is_in_the_table() {
        let mut rng = Rng(4);
        let mut met = std::collections::BTreeSet::new();
        for round in 0..400_000 {
            let wide = round % 2 == 0;
            let values: [f32; 8] = std::array::from_fn(|_| {
                let bits = if wide { 1 + rng.below(20) } else { 12 };
                let size = 1 + rng.below(1 << bits);
                if rng.below(2) == 0 {
                    size as f32
                } else {
                    -(size as f32)
                }
            });
            let mask = (0..8).fold(0u8, |m, c| m | u8::from(values[c] >= 0.0) << c);
            let faces = TABLE.ambiguous[mask as usize];
            let offsets = offsets(&values, 0.0, Inside::Above);
            let number = TABLE.number(mask, joined_faces(&offsets, faces, Inside::Above));
            if let Some(t) = find(&offsets) {
                let tunnel = TABLE.tunnel_number(number, t.apex, t.above);
                met.insert(tunnel.expect("in the table"));
            }
        }
        assert!(met.len() > 100, "{}", met.len());
    }
}
