//! Do two triangles go through each other? Decided exactly.
//!
//! Two triangles meet when there is a point inside of both; points on an edge are not inside. So
//! neighbours along an edge meet only where one is folded onto the other, and what merely touches
//! does not meet. Two triangles of different planes meet when each has corners on both sides of the
//! other's plane and the pieces that they cut out of the common line overlap, which two more signs
//! decide (Guigue and Devillers 2003, "Fast and robust triangle-triangle overlap test using
//! orientation predicates").

use robust::{Coord, Coord3D, orient2d, orient3d};

/// How two triangles lie to each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Meeting {
    /// No point is inside of both.
    Apart,
    /// They go through each other along a line.
    Crossing,
    /// They lie in a plane and have an area in common.
    Overlapping,
}

type Point = [f32; 3];

/// On which side of the plane of `t` the point `p` is.
fn side(t: &[Point; 3], p: Point) -> i32 {
    let at = |p: Point| {
        let [x, y, z] = p.map(f64::from);
        Coord3D { x, y, z }
    };
    sign(orient3d(at(t[0]), at(t[1]), at(t[2]), at(p)))
}

fn sign(v: f64) -> i32 {
    i32::from(v > 0.0) - i32::from(v < 0.0)
}

#[inline]
fn same(p: Point, q: Point) -> bool {
    p[0] == q[0] && p[1] == q[1] && p[2] == q[2]
}

/// On which side of the plane of `t` each corner of `s` is. A product in double precision decides
/// nearly always; Shewchuk's bound says when it does.
#[inline]
fn sides(t: &[Point; 3], s: &[Point; 3]) -> [i32; 3] {
    const BOUND: f64 = 1e-15;
    let from = |p: Point, i: usize| f64::from(p[i]) - f64::from(t[0][i]);
    let (mut normal, mut size) = ([0.0; 3], [0.0; 3]);
    for i in 0..3 {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let (left, right) = (from(t[1], j) * from(t[2], k), from(t[1], k) * from(t[2], j));
        normal[i] = left - right;
        size[i] = left.abs() + right.abs();
    }
    let mut sides = [0; 3];
    for (side_of, &p) in sides.iter_mut().zip(s) {
        // A corner in common is in the plane.
        if same(p, t[0]) || same(p, t[1]) || same(p, t[2]) {
            continue;
        }
        let (mut height, mut most) = (0.0, 0.0);
        for i in 0..3 {
            let up = from(p, i);
            height += normal[i] * up;
            most += size[i] * up.abs();
        }
        *side_of = if height.abs() > BOUND * most || is_exact(t, p) {
            -sign(height)
        } else {
            side(t, p)
        };
    }
    sides
}

/// Whether nothing is rounded in the volume over these points, as on the lattices of masks: all
/// differences are whole multiples of 2^-10 with 16 bits, so sums of three products have 50.
#[cold]
fn is_exact(t: &[Point; 3], p: Point) -> bool {
    [t[1], t[2], p].iter().all(|q| {
        (0..3).all(|i| {
            let steps = (f64::from(q[i]) - f64::from(t[0][i])) * 1024.0;
            steps.abs() < 65536.0 && steps == steps.trunc()
        })
    })
}

/// How `s` and `t` meet. Triangles without an area meet nothing; corners are finite.
#[inline]
pub(super) fn meet(s: &[Point; 3], t: &[Point; 3]) -> Meeting {
    let of_s = sides(t, s);
    if of_s == [0; 3] {
        return match overlap(s, t) {
            true => Meeting::Overlapping,
            false => Meeting::Apart,
        };
    }
    if !on_both_sides(of_s) {
        return Meeting::Apart;
    }
    let of_t = sides(s, t);
    if !on_both_sides(of_t) {
        return Meeting::Apart;
    }
    cross(s, t, of_s, of_t)
}

/// How triangles meet that have corners on both sides of each other's plane.
fn cross(s: &[Point; 3], t: &[Point; 3], of_s: [i32; 3], of_t: [i32; 3]) -> Meeting {
    let (mut s, s_above) = alone_first(s, of_s);
    let (mut t, t_above) = alone_first(t, of_t);
    // Turned so that each first corner is above the plane of the other triangle.
    if !s_above {
        t.swap(1, 2);
    }
    if !t_above {
        s.swap(1, 2);
    }
    let apart = side(&[s[0], s[1], t[0]], t[1]) >= 0 || side(&[s[0], s[2], t[2]], t[0]) >= 0;
    match apart {
        true => Meeting::Apart,
        false => Meeting::Crossing,
    }
}

#[inline]
fn on_both_sides(signs: [i32; 3]) -> bool {
    signs.contains(&1) && signs.contains(&-1)
}

/// The triangle turned so that its first corner is alone on its side, and whether that is above.
fn alone_first(t: &[Point; 3], signs: [i32; 3]) -> ([Point; 3], bool) {
    let alone = |i: &usize| {
        let [a, b, c] = [0, 1, 2].map(|k| signs[(i + k) % 3]);
        a != 0 && a != b && a != c
    };
    let i = (0..3).find(alone).expect("corners on both sides");
    let turned = [0, 1, 2].map(|k| t[(i + k) % 3]);
    (turned, signs[i] > 0)
}

/// Whether two triangles of one plane have an area in common.
fn overlap(s: &[Point; 3], t: &[Point; 3]) -> bool {
    // Seen along an axis in which both keep an area, if there is one.
    (0..3).any(|axis| {
        let flat = |p: &Point| Coord {
            x: f64::from(p[(axis + 1) % 3]),
            y: f64::from(p[(axis + 2) % 3]),
        };
        let turn = |a, b, c| sign(orient2d(a, b, c));
        let (s, t) = (s.each_ref().map(flat), t.each_ref().map(flat));
        let (of_s, of_t) = (turn(s[0], s[1], s[2]), turn(t[0], t[1], t[2]));
        if of_s == 0 || of_t == 0 {
            return false;
        }
        // Convex sets without a common inside lie on different sides of an edge.
        let parted = |a: &[Coord<f64>; 3], way: i32, b: &[Coord<f64>; 3]| {
            (0..3).any(|k| {
                let (from, to) = (a[k], a[(k + 1) % 3]);
                b.iter().all(|&p| way * turn(from, to, p) <= 0)
            })
        };
        !parted(&s, of_s, &t) && !parted(&t, of_t, &s)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    type Whole = [i128; 3];

    fn sub(a: Whole, b: Whole) -> Whole {
        [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
    }

    fn cross(a: Whole, b: Whole) -> Whole {
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    }

    fn dot(a: Whole, b: Whole) -> i128 {
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    }

    /// A corner of a polygon: a point over a common denominator.
    type Corner = (Whole, i128);

    /// The part of a convex polygon where `n . (x - o) >= 0`, in whole numbers.
    fn clip(polygon: &[Corner], o: Whole, n: Whole) -> Vec<Corner> {
        // Values times the positive denominator of the corner.
        let value = |(p, d): &Corner| dot(n, *p) - dot(n, o) * d;
        let mut out = Vec::new();
        for (k, a) in polygon.iter().enumerate() {
            let b = &polygon[(k + 1) % polygon.len()];
            let (fa, fb) = (value(a), value(b));
            if fa >= 0 {
                out.push(*a);
            }
            if (fa > 0 && fb < 0) || (fa < 0 && fb > 0) {
                // The values over their denominators are fa/da and fb/db.
                let (wa, wb) = (fb * a.1, fa * b.1);
                // A product that does not fit would be a wrong oracle.
                let times = |v: [i128; 3]| {
                    let two = v[0].checked_mul(v[1]).expect("fits");
                    two.checked_mul(v[2]).expect("fits")
                };
                let point = [0, 1, 2].map(|i| times([wa, a.0[i], b.1]) - times([wb, b.0[i], a.1]));
                let under = times([wa - wb, a.1, b.1]);
                let by = point
                    .iter()
                    .fold(under, |g, &v| gcd(g.abs(), v.abs()))
                    .max(1);
                let by = if under < 0 { -by } else { by };
                out.push((point.map(|v| v / by), under / by));
            }
        }
        out.dedup();
        if out.len() > 1 && out.first() == out.last() {
            out.pop();
        }
        out
    }

    fn gcd(a: i128, b: i128) -> i128 {
        if b == 0 { a } else { gcd(b, a % b) }
    }

    /// Cuts `s` by the prism over `t`, and by its plane from both sides, with whole numbers.
    fn oracle(s: [Whole; 3], t: [Whole; 3]) -> Meeting {
        let normal = |t: [Whole; 3]| cross(sub(t[1], t[0]), sub(t[2], t[0]));
        let (ns, nt) = (normal(s), normal(t));
        if ns == [0; 3] || nt == [0; 3] {
            return Meeting::Apart;
        }
        let mut part: Vec<Corner> = s.map(|p| (p, 1)).to_vec();
        let walls = [0, 1, 2].map(|k| (t[k], cross(nt, sub(t[(k + 1) % 3], t[k]))));
        for (o, n) in walls {
            part = clip(&part, o, n);
        }
        // What lies in a wall is not inside.
        let off = |(o, n): (Whole, Whole)| part.iter().any(|(p, d)| dot(n, *p) > dot(n, o) * d);
        if !walls.into_iter().all(off) {
            return Meeting::Apart;
        }
        // Twice the area vector of a polygon, times denominators, is zero just where it has none.
        let has_area = part.len() > 2 && {
            let (o, d) = part[0];
            (1..part.len() - 1).any(|k| {
                let from = |(p, e): Corner| [0, 1, 2].map(|i| p[i] * d - o[i] * e);
                cross(from(part[k]), from(part[k + 1])) != [0; 3]
            })
        };
        if cross(ns, nt) == [0; 3] {
            let one_plane = dot(nt, sub(s[0], t[0])) == 0;
            return match one_plane && has_area {
                true => Meeting::Overlapping,
                false => Meeting::Apart,
            };
        }
        // Inside of the prism there must be a part of s on both sides of the plane of t. Its cut
        // with the plane is then inside of t, and inside of s as long as it is not on its border.
        let height = |(p, d): &Corner| dot(nt, *p) - dot(nt, t[0]) * d;
        let above = part.iter().any(|c| height(c) > 0);
        let below = part.iter().any(|c| height(c) < 0);
        match has_area && above && below {
            true => Meeting::Crossing,
            false => Meeting::Apart,
        }
    }

    struct Dice(u64);

    impl Dice {
        fn roll(&mut self, n: u64) -> u64 {
            self.0 = self.0.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
            (self.0 >> 33) % n
        }
    }

    #[test]
    fn whole_numbers_agree_on_small_lattices() {
        let mut dice = Dice(7);
        let mut seen = [0; 3];
        // Small lattices are full of common corners, common planes and corners on edges.
        for (size, rounds) in [(2, 60_000), (3, 60_000), (4, 40_000), (9, 40_000)] {
            for _ in 0..rounds {
                let flat = dice.roll(4) == 0;
                let mut corner = || -> Whole {
                    let p = [0; 3].map(|_| i128::from(dice.roll(size)));
                    // A slanted plane of lattice points, for triangles in one plane.
                    if flat { [p[0], p[1], p[0] + p[1]] } else { p }
                };
                let s = [(); 3].map(|()| corner());
                let t = [(); 3].map(|()| corner());
                let single = |t: [Whole; 3]| t.map(|p| p.map(|v| v as f32));
                let want = oracle(s, t);
                assert_eq!(meet(&single(s), &single(t)), want, "{s:?} {t:?}");
                assert_eq!(meet(&single(t), &single(s)), want, "{t:?} {s:?}");
                seen[want as usize] += 1;
            }
        }
        assert!(seen.iter().all(|&n| n > 3000), "{seen:?}");
    }

    #[test]
    fn a_hair_decides() {
        let t = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let needle = |z: f32| [[0.25, 0.25, z], [0.25, 0.25, 2.0], [0.25, 5.0, 2.0]];
        assert_eq!(meet(&t, &needle(0.0)), Meeting::Apart);
        assert_eq!(meet(&t, &needle(-f32::from_bits(1))), Meeting::Crossing);
        assert_eq!(meet(&t, &needle(f32::from_bits(1))), Meeting::Apart);
        // Far away, where single precision is coarse.
        let far = 16_777_216.0;
        let away = |t: [Point; 3]| t.map(|p| [p[0] * 8.0 + far, p[1] * 8.0 + far, p[2]]);
        assert_eq!(meet(&away(t), &away(needle(-1e-30))), Meeting::Crossing);
    }
}
