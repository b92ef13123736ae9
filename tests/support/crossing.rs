//! Pairs of triangles of a mesh that cross each other.

use std::collections::{BTreeSet, HashMap};

type Point = [f64; 3];

/// Pairs that cross properly: an edge of one goes through the inside of the other. Touching does not
/// count, nor what rounding might have done.
pub(crate) fn crossing_pairs(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> usize {
    // Triangles by the unit cubes that their boxes meet.
    let mut cubes: HashMap<[i32; 3], Vec<usize>> = HashMap::new();
    for (number, t) in triangles.iter().enumerate() {
        let span = |axis: usize| {
            let at = t.map(|v| positions[v as usize][axis]);
            let low = at.iter().copied().fold(f32::INFINITY, f32::min);
            let high = at.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            low.floor() as i32..=high.floor() as i32
        };
        for z in span(2) {
            for y in span(1) {
                for x in span(0) {
                    cubes.entry([x, y, z]).or_default().push(number);
                }
            }
        }
    }
    let place = |v: u32| positions[v as usize].map(f64::from);
    let mut found = BTreeSet::new();
    for inside in cubes.values() {
        for (i, &a) in inside.iter().enumerate() {
            for &b in &inside[..i] {
                let (s, t) = (triangles[a], triangles[b]);
                if pierces(s, t, &place) || pierces(t, s, &place) {
                    found.insert((a.min(b), a.max(b)));
                }
            }
        }
    }
    found.len()
}

/// Whether an edge of `s` that does not touch `t` goes through it.
fn pierces(s: [u32; 3], t: [u32; 3], place: &impl Fn(u32) -> Point) -> bool {
    let corners = t.map(place);
    (0..3).any(|k| {
        let (a, b) = (s[k], s[(k + 1) % 3]);
        !t.contains(&a) && !t.contains(&b) && goes_through(place(a), place(b), corners)
    })
}

fn goes_through(a: Point, b: Point, [p, q, r]: [Point; 3]) -> bool {
    if side(p, q, r, a) * side(p, q, r, b) >= 0 {
        return false;
    }
    let around = [side(a, b, p, q), side(a, b, q, r), side(a, b, r, p)];
    around[0] != 0 && around.iter().all(|&s| s == around[0])
}

/// The sign of the volume of a tetrahedron; 0 when rounding might have made it.
fn side(a: Point, b: Point, c: Point, d: Point) -> i32 {
    let from = |p: Point| -> Point { std::array::from_fn(|k| p[k] - d[k]) };
    let (a, b, c) = (from(a), from(b), from(c));
    let (mut volume, mut size) = (0.0, 0.0);
    for k in 0..3 {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        let (left, right) = (b[i] * c[j], b[j] * c[i]);
        volume += a[k] * (left - right);
        size += a[k].abs() * (left.abs() + right.abs());
    }
    if volume.abs() <= 1e-15 * size {
        0
    } else if volume > 0.0 {
        1
    } else {
        -1
    }
}

#[cfg(test)]
mod tests {
    use super::crossing_pairs;

    #[test]
    fn what_crosses_is_counted_and_what_touches_is_not() {
        let flat = [[0.0, 0.0, 0.5], [3.0, 0.0, 0.5], [0.0, 3.0, 0.5]];
        let count = |other: [[f32; 3]; 3]| {
            let positions: Vec<_> = flat.into_iter().chain(other).collect();
            crossing_pairs(&positions, &[[0, 1, 2], [3, 4, 5]])
        };
        // Through the middle, from either side; beside it; standing on it; in its plane.
        assert_eq!(
            count([[1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [9.0, 9.0, 0.0]]),
            1
        );
        assert_eq!(
            count([[1.0, 1.0, 1.0], [9.0, 9.0, 0.0], [1.0, 1.0, 0.0]]),
            1
        );
        assert_eq!(
            count([[2.0, 2.0, 0.0], [2.0, 2.0, 1.0], [9.0, 9.0, 0.0]]),
            0
        );
        assert_eq!(
            count([[1.0, 1.0, 0.5], [1.0, 1.0, 1.0], [1.0, 0.5, 1.0]]),
            0
        );
        assert_eq!(
            count([[1.0, 1.0, 0.5], [2.0, 2.0, 0.5], [1.0, 2.0, 0.5]]),
            0
        );
        // With a corner in common.
        let positions = [flat[0], flat[1], flat[2], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]];
        assert_eq!(crossing_pairs(&positions, &[[0, 1, 2], [0, 3, 4]]), 1);
        assert_eq!(crossing_pairs(&positions, &[[0, 1, 2], [0, 1, 4]]), 0);
    }
}
