//! Distances between two patches of surface, sampled.

use crate::mesh::boxes::{Boxes, NOTHING, bounds_of, union};

type Point = [f64; 3];

/// Triangles in which the nearest point is looked for.
pub(super) struct Near<'a> {
    positions: &'a [[f32; 3]],
    triangles: &'a [[u32; 3]],
    boxes: Boxes,
}

/// Answers of the last search, which the next one begins with, and its buffer.
#[derive(Default)]
pub(super) struct Search {
    last: u32,
    stack: Vec<(u32, u32, f32)>,
}

impl<'a> Near<'a> {
    /// `triangles` over `positions`, which are finite; at least one.
    pub(super) fn new(positions: &'a [[f32; 3]], triangles: &'a [[u32; 3]]) -> Self {
        let corners = |n: u32| triangles[n as usize].map(|v| positions[v as usize]);
        let numbers = 0..triangles.len() as u32;
        let whole = numbers
            .clone()
            .map(|n| bounds_of(&corners(n)))
            .fold(NOTHING, union);
        Self {
            positions,
            triangles,
            boxes: Boxes::new(numbers, corners, whole),
        }
    }

    /// Square of the distance from `p`, and the triangle that has it. Below `enough` any will do.
    pub(super) fn nearest(&self, p: [f32; 3], enough: f64, search: &mut Search) -> (f64, u32) {
        let wide = p.map(f64::from);
        let square = |n: u32| {
            let corners = self.triangles[n as usize].map(|v| self.positions[v as usize]);
            square_to(wide, corners.map(|q| q.map(f64::from)))
        };
        let mut best = (square(search.last), search.last);
        self.boxes.visit_near(p, &mut search.stack, |group| {
            if let Some(group) = group {
                for &n in group {
                    let d = square(n);
                    if d < best.0 {
                        best = (d, n);
                    }
                }
            }
            // Nothing is nearer than that.
            if best.0 <= enough { -1.0 } else { best.0 }
        });
        search.last = best.1;
        best
    }
}

/// Points that are too far away, of which more need not be known.
const FAR: usize = 10_000;

/// The greatest sampled distance between `before` and `after`, whose vertices are some of those of
/// `before`: from every vertex of `before` to `after`, and from points on the triangles of `after`,
/// no farther than `spacing` from each other, to `before`. And points that are farther than
/// `most`, one of each triangle of `after`.
pub(super) fn distance(
    positions: &[[f32; 3]],
    [before, after]: [&[[u32; 3]]; 2],
    spacing: f64,
    most: f64,
) -> (f64, Vec<[f32; 3]>) {
    let (mut worst, mut far) = (0.0f64, Vec::new());
    if before.is_empty() || after.is_empty() || before.len() == after.len() {
        return (worst, far);
    }
    let limit = most * most;
    let mut measure = |near: &Near<'_>, search: &mut Search, p: [f32; 3]| {
        // What is nearer than another point changes nothing.
        let (square, _) = near.nearest(p, worst.min(limit), search);
        worst = worst.max(square);
        square
    };
    // Vertices that stay are at no distance.
    let mut there = vec![true; positions.len()];
    let mut set = |list: &[[u32; 3]], to: bool| {
        list.as_flattened()
            .iter()
            .for_each(|&v| there[v as usize] = to);
    };
    set(before, false);
    set(after, true);
    let (near, mut search) = (Near::new(positions, after), Search::default());
    for &v in before.as_flattened() {
        if !std::mem::replace(&mut there[v as usize], true) {
            let p = positions[v as usize];
            if measure(&near, &mut search, p) > limit && far.len() < FAR {
                far.push(p);
            }
        }
    }
    let (near, mut search) = (Near::new(positions, before), Search::default());
    for t in after {
        let mut farthest = (limit, None);
        for_points(t.map(|v| positions[v as usize]), spacing, |p| {
            let square = measure(&near, &mut search, p);
            if square > farthest.0 {
                farthest = (square, Some(p));
            }
        });
        if far.len() < FAR {
            far.extend(farthest.1);
        }
    }
    (worst.sqrt(), far)
}

/// Calls `each` for points on a triangle: rows along its longest side, at most `spacing` apart, of
/// points at most `spacing` apart; up to 64 rows of 256.
fn for_points(corners: [[f32; 3]; 3], spacing: f64, mut each: impl FnMut([f32; 3])) {
    let p = corners.map(|p| p.map(f64::from));
    let square = |i: usize| {
        let side = sub(p[(i + 1) % 3], p[i]);
        dot(side, side)
    };
    let first = (0..3)
        .max_by(|&i, &j| square(i).total_cmp(&square(j)))
        .expect("three sides");
    let [a, b, c] = [0, 1, 2].map(|i| p[(first + i) % 3]);
    let (along, up) = (sub(b, a), sub(c, a));
    let length = dot(along, along).sqrt();
    let foot = dot(up, along) / (length * length).max(f64::MIN_POSITIVE);
    let height = (dot(up, up) - foot * foot * length * length)
        .max(0.0)
        .sqrt();
    let rows = (height / spacing).ceil().clamp(1.0, 64.0);
    for row in 0..rows as i32 {
        let v = (f64::from(row) + 0.5) / rows;
        let columns = ((1.0 - v) * length / spacing).ceil().clamp(1.0, 256.0);
        for column in 0..columns as i32 {
            let u = (1.0 - v) * (f64::from(column) + 0.5) / columns;
            let at = |i: usize| a[i] + u * along[i] + v * up[i];
            each([at(0) as f32, at(1) as f32, at(2) as f32]);
        }
    }
}

pub(super) fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(super) fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn cross(a: Point, b: Point) -> Point {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Square of the distance of a point from a triangle (Ericson 2004, "Real-time collision detection",
/// 5.1.5).
pub(super) fn square_to(p: Point, [a, b, c]: [Point; 3]) -> f64 {
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let along = |s: f64, u: Point, t: f64, v: Point, from: Point| {
        let off = [0, 1, 2].map(|i| from[i] - s * u[i] - t * v[i]);
        dot(off, off)
    };
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return dot(ap, ap);
    }
    let bp = sub(p, b);
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    if d3 >= 0.0 && d4 <= d3 {
        return dot(bp, bp);
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return along(d1 / (d1 - d3), ab, 0.0, ac, ap);
    }
    let cp = sub(p, c);
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d6 >= 0.0 && d5 <= d6 {
        return dot(cp, cp);
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return along(0.0, ab, d2 / (d2 - d6), ac, ap);
    }
    let va = d3 * d6 - d5 * d4;
    let (x, y) = (d4 - d3, d5 - d6);
    if va <= 0.0 && x >= 0.0 && y >= 0.0 {
        return along(x / (x + y), sub(c, b), 0.0, ac, bp);
    }
    let whole = 1.0 / (va + vb + vc);
    along(vb * whole, ab, vc * whole, ac, ap)
}

/// Mean length of the sides of triangles.
pub(super) fn mean_side(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> f64 {
    let sides: f64 = triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|v| positions[v as usize].map(f64::from));
            [sub(b, a), sub(c, b), sub(a, c)]
                .map(|e| dot(e, e).sqrt())
                .into_iter()
                .sum::<f64>()
        })
        .sum();
    sides / (3 * triangles.len().max(1)) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_meshes::torus;

    #[test]
    fn distances_are_those_of_a_search_through_everything() {
        let mesh = torus(2.0, 0.7, 40, 30);
        let near = Near::new(&mesh.positions, &mesh.triangles);
        let mut search = Search::default();
        for i in 0..500u32 {
            let at = |k: u32| (i.wrapping_mul(k) % 997) as f32 / 997.0 * 6.0 - 3.0;
            let p = [at(7919), at(104_729), at(1_299_709)];
            let wide = p.map(f64::from);
            let all = mesh.triangles.iter().map(|t| {
                let corners = t.map(|v| mesh.positions[v as usize].map(f64::from));
                square_to(wide, corners)
            });
            let least = all.fold(f64::INFINITY, f64::min);
            let (found, n) = near.nearest(p, 0.0, &mut search);
            assert_eq!(found, least, "{p:?}");
            let corners = mesh.triangles[n as usize].map(|v| mesh.positions[v as usize]);
            assert_eq!(square_to(wide, corners.map(|q| q.map(f64::from))), least);
            // The exact one lies on the circle in the middle of the tube, to the tessellation.
            let r = (wide[0].hypot(wide[1]) - 2.0).hypot(wide[2]);
            assert!((least.sqrt() - (r - 0.7).abs()).abs() < 0.03);
        }
    }

    #[test]
    fn a_point_is_nearest_to_a_corner_a_side_or_the_inside() {
        let t = [[0.0; 3], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]];
        for (p, square) in [
            ([1.0, 1.0, 3.0], 9.0),
            ([-3.0, -4.0, 0.0], 25.0),
            ([2.0, -2.0, 0.0], 4.0),
            ([-2.0, 1.0, 1.0], 5.0),
            ([3.0, 3.0, 0.0], 2.0),
            ([6.0, 0.0, 0.0], 4.0),
            ([0.0, 7.0, 4.0], 25.0),
        ] {
            assert!((square_to(p, t) - square).abs() < 1e-12, "{p:?}");
        }
    }

    #[test]
    fn points_cover_a_triangle() {
        let t = [[0.0; 3], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0]];
        let mut points = Vec::new();
        for_points(t, 0.5, |p| points.push(p));
        assert!((18..40).contains(&points.len()), "{}", points.len());
        let inside = |p: &[f32; 3]| p[0] > 0.0 && p[1] > 0.0 && p[0] + p[1] < 3.0 && p[2] == 0.0;
        assert!(points.iter().all(inside));
    }

    #[test]
    fn a_dent_is_measured_and_blamed() {
        // A pyramid on a square; without its tip it is flat.
        let p = [
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [1.0, 1.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.5, 0.5, 0.25],
        ];
        let before = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]];
        let after = [[0, 1, 2], [0, 2, 3]];
        let (d, far) = distance(&p, [&before, &after], 0.05, 0.3);
        assert!((d - 0.25).abs() < 1e-6 && far.is_empty(), "{d}");
        let (_, far) = distance(&p, [&before, &after], 0.05, 0.24);
        assert_eq!(far, [p[4]]);
    }
}
