//! Which moves are refused: those that leave a triangle turned over, narrower than the narrowest
//! around the vertex was, or through another triangle.
//!
//! A refused vertex goes back to its start, which may in turn spoil a triangle with vertices that
//! stay moved. So it is asked a fixed number of times, and what depends on what stays local.

use super::net::{Net, kind};
use super::surface::{FINE, Metric, Place, cross, dot, step, sum};

/// How often it is asked.
pub(super) const ROUNDS: u8 = 4;

/// In how many rounds, the first ones, triangles that cross are looked for.
const CROSSING_ROUNDS: u8 = 3;

/// How many cells farther a triangle can lie that crosses one at a vertex, than the triangles at
/// that vertex: both reach a cell, and their vertices moved up to half a cell each.
const CROSSING_RINGS: u8 = 2;

/// Cells around a tile that decide what is refused in it; `close` where sheets may be close.
pub(super) fn rings(close: bool) -> u8 {
    if close {
        ROUNDS + CROSSING_ROUNDS * CROSSING_RINGS
    } else {
        ROUNDS
    }
}

/// The same for what the rounds after this one decide.
fn rings_after(round: u8, close: bool) -> u8 {
    let crossing = CROSSING_ROUNDS.saturating_sub(round + 1) * CROSSING_RINGS;
    ROUNDS - round - 1 + if close { crossing } else { 0 }
}

/// Square of the sine of 20 degrees: an angle beyond is good enough, even where it was better.
const ENOUGH: f32 = 0.116_977_8;

/// Square of the sine of the least angle of a triangle, and its normal, not of unit length.
#[inline(always)]
fn least_angle(metric: &Metric, [a, b, c]: [Place; 3]) -> (f32, [f32; 3]) {
    let (u, v) = (metric.world(step(a, b)), metric.world(step(a, c)));
    let w = [v[0] - u[0], v[1] - u[1], v[2] - u[2]];
    let normal = cross(u, v);
    let (x, y, z) = (dot(u, u), dot(v, v), dot(w, w));
    // The least angle lies between the two longest sides.
    let longest = x.max(y).max(z);
    let shortest = x.min(y).min(z);
    let middle = x + y + z - longest - shortest;
    (dot(normal, normal) / (longest * middle), normal)
}

/// Whether the angle between two directions is not less than a right one.
fn against(a: [f32; 3], b: [f32; 3]) -> bool {
    let along = dot(a, b);
    along.is_nan() || along <= 0.0
}

/// Buffers of [`settle`].
#[derive(Debug, Default)]
pub(super) struct Settling {
    /// Per vertex the least angle around it at the start.
    narrowest: Vec<f32>,
    refused: Vec<bool>,
    /// Vertices whose triangles have yet to be compared with others: all that moved, then those
    /// that were refused in the round before.
    fresh: Vec<bool>,
    bins: Vec<(u32, u32)>,
}

/// Refuses moves of the vertices of a tile.
#[inline(always)]
pub(super) fn settle(
    net: &mut Net,
    metric: &Metric,
    triangles: &[[u32; 3]],
    close: bool,
    s: &mut Settling,
) {
    let count = net.start.len();
    s.narrowest.clear();
    s.narrowest.resize(count, f32::INFINITY);
    for t in triangles {
        let (angle, _) = least_angle(metric, t.map(|v| net.start[v as usize]));
        for &v in t {
            let narrowest = &mut s.narrowest[v as usize];
            *narrowest = narrowest.min(angle);
        }
    }
    s.fresh.clear();
    let moved = net.now.iter().zip(&net.start).map(|(a, b)| a != b);
    s.fresh.extend(moved);
    for round in 0..ROUNDS {
        s.refused.clear();
        s.refused.resize(count, false);
        let mut any = false;
        let rings = rings_after(round, close) + 1;
        for t in triangles {
            let t = t.map(|v| v as usize);
            if t.iter().any(|&v| net.rings[v] > rings)
                || t.iter().all(|&v| net.now[v] == net.start[v])
            {
                continue;
            }
            let (angle, normal) = least_angle(metric, t.map(|v| net.now[v]));
            let out = outward(net, t);
            let turned = against(normal, out) && {
                // Where the surface bends within a cell, normals tell little: against the start too.
                let (_, before) = least_angle(metric, t.map(|v| net.start[v]));
                against(normal, before)
            };
            for v in t {
                if turned || (angle < ENOUGH && angle < s.narrowest[v]) {
                    s.refused[v] = true;
                    any = true;
                }
            }
        }
        if close && round < CROSSING_ROUNDS {
            any |= refuse_crossing(net, triangles, rings + CROSSING_RINGS, s);
        }
        if !any {
            break;
        }
        for v in 0..count {
            if s.refused[v] {
                net.refuse(v);
            }
        }
        std::mem::swap(&mut s.fresh, &mut s.refused);
    }
}

/// The direction in which a triangle should face. On a cap only the vertices of the cap tell: the
/// surface can meet it at any angle.
#[inline(always)]
fn outward(net: &Net, t: [usize; 3]) -> [f32; 3] {
    let on_cap = |v: usize| net.kinds[v] & kind::FLAT != 0;
    let capped = t.iter().any(|&v| on_cap(v));
    let tell = t.iter().filter(|&&v| !capped || on_cap(v));
    tell.fold([0.0; 3], |all, &v| sum(all, net.normals[v]))
}

/// Looks for triangles that cross, where sheets are close.
fn refuse_crossing(net: &Net, triangles: &[[u32; 3]], rings: u8, s: &mut Settling) -> bool {
    s.bins.clear();
    for (number, t) in triangles.iter().enumerate() {
        let t = t.map(|v| v as usize);
        if !t.iter().any(|&v| net.close[v]) || t.iter().any(|&v| net.rings[v] > rings) {
            continue;
        }
        let [low, high] = bounds(net, triangles[number]).map(|p| p.map(|v| v >> FINE));
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    s.bins.push((bin([x, y, z]), number as u32));
                }
            }
        }
    }
    s.bins.sort_unstable();
    let mut any = false;
    for bin in s.bins.chunk_by(|a, b| a.0 == b.0) {
        for (i, &(at, first)) in bin.iter().enumerate() {
            for &(_, second) in &bin[..i] {
                let (p, q) = (triangles[first as usize], triangles[second as usize]);
                let fresh = |t: [u32; 3]| t.iter().any(|&v| s.fresh[v as usize]);
                if !(fresh(p) || fresh(q)) || !meet_first(net, p, q, at) {
                    continue;
                }
                if crossing(net, p, q) || crossing(net, q, p) {
                    any = true;
                    for v in p.into_iter().chain(q) {
                        s.refused[v as usize] = true;
                    }
                }
            }
        }
    }
    any
}

/// Number of a cell of the tile.
#[inline(always)]
fn bin(cell: Place) -> u32 {
    (cell[0] | cell[1] << 7 | cell[2] << 14) as u32
}

/// Lowest and highest coordinates of a triangle.
#[inline(always)]
fn bounds(net: &Net, t: [u32; 3]) -> [Place; 2] {
    let [a, b, c] = t.map(|v| net.now[v as usize]);
    let least = |k: usize| a[k].min(b[k]).min(c[k]);
    let most = |k: usize| a[k].max(b[k]).max(c[k]);
    [[least(0), least(1), least(2)], [most(0), most(1), most(2)]]
}

/// Whether the boxes around two triangles meet and `at` is the first cell where they do, so that a
/// pair is looked at once.
#[inline(always)]
fn meet_first(net: &Net, p: [u32; 3], q: [u32; 3], at: u32) -> bool {
    let ([p_low, p_high], [q_low, q_high]) = (bounds(net, p), bounds(net, q));
    let low = |k: usize| p_low[k].max(q_low[k]);
    let meet = |k: usize| low(k) <= p_high[k].min(q_high[k]);
    meet(0) && meet(1) && meet(2) && bin([low(0) >> FINE, low(1) >> FINE, low(2) >> FINE]) == at
}

/// Whether a side of `p` that has no end in `q` goes through `q`. Touching counts.
fn crossing(net: &Net, p: [u32; 3], q: [u32; 3]) -> bool {
    let place = |v: u32| net.now[v as usize];
    let [a, b, c] = q.map(place);
    (0..3).any(|k| {
        let (from, to) = (p[k], p[(k + 1) % 3]);
        if q.contains(&from) || q.contains(&to) {
            return false;
        }
        let (from, to) = (place(from), place(to));
        let (here, there) = (side(a, b, c, from), side(a, b, c, to));
        if here * there > 0 || (here == 0 && there == 0) {
            return false;
        }
        let around = [
            side(from, to, a, b),
            side(from, to, b, c),
            side(from, to, c, a),
        ];
        around.iter().all(|&s| s >= 0) || around.iter().all(|&s| s <= 0)
    })
}

/// The sign of the volume of a tetrahedron, exactly.
#[inline(always)]
fn side(a: Place, b: Place, c: Place, d: Place) -> i32 {
    let from = |p: Place| [0, 1, 2].map(|k| f64::from(p[k] - d[k]));
    let (p, q, r) = (from(a), from(b), from(c));
    let (mut volume, mut size) = (0.0, 0.0);
    for k in 0..3 {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        let (left, right) = (q[i] * r[j], q[j] * r[i]);
        volume += p[k] * (left - right);
        size += p[k].abs() * (left.abs() + right.abs());
    }
    // A few roundings, each at most 2^-53 of the size.
    if volume.abs() > 1e-15 * size {
        return if volume > 0.0 { 1 } else { -1 };
    }
    side_exactly(a, b, c, d)
}

/// Places have 27 bits, so the volume has fewer than 90.
#[cold]
fn side_exactly(a: Place, b: Place, c: Place, d: Place) -> i32 {
    let from = |p: Place| [0, 1, 2].map(|k| i128::from(p[k]) - i128::from(d[k]));
    let (a, b, c) = (from(a), from(b), from(c));
    let volume = a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0]);
    volume.signum() as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::Affine;

    #[test]
    fn the_least_angle_is_that_of_the_triangle() {
        let metric = Metric::new(&Affine::IDENTITY);
        let unit = 1 << FINE;
        for (corners, degrees) in [
            ([[0, 0, 0], [unit, 0, 0], [0, unit, 0]], 45.0f32),
            ([[0, 0, 0], [unit, 0, 0], [0, 0, unit / 8]], 7.125),
            ([[unit, 0, 0], [0, unit, 0], [0, 0, unit]], 60.0),
        ] {
            for turn in 0..3 {
                let mut corners = corners;
                corners.rotate_left(turn);
                let (square, _) = least_angle(&metric, corners);
                assert!((square.sqrt().asin().to_degrees() - degrees).abs() < 1e-3);
            }
        }
        assert!((ENOUGH.sqrt().asin().to_degrees() - 20.0).abs() < 1e-4);
    }

    #[test]
    fn crossing_triangles_are_found() {
        let mut net = Net::default();
        let u = 1 << FINE;
        net.now = vec![
            [0, 0, 0],
            [2 * u, 0, 0],
            [0, 2 * u, 0],
            [u / 2, u / 2, -u],
            [u / 2, u / 2, u],
            [3 * u, 3 * u, u],
            [u / 2, u / 2, u / 9],
        ];
        assert!(crossing(&net, [3, 4, 5], [0, 1, 2]));
        assert!(crossing(&net, [0, 1, 2], [3, 4, 5]));
        assert!(!crossing(&net, [6, 4, 5], [0, 1, 2]));
        // Neighbours do not cross in their common corner or side.
        assert!(!crossing(&net, [0, 4, 5], [0, 1, 2]));
        assert!(!crossing(&net, [0, 1, 4], [0, 1, 2]));
    }

    #[test]
    fn sides_are_exact() {
        // In a plane through large numbers, and one unit beside it.
        let (a, b, c) = ([1 << 26, 3, 1], [5, (1 << 26) + 1, 1], [9, 7, 1]);
        assert_eq!(side(a, b, c, [12_345, 54_321, 1]), 0);
        let above = side(a, b, c, [12_345, 54_321, 2]);
        assert_eq!(above.abs(), 1);
        assert_eq!(side(a, b, c, [12_345, 54_321, 0]), -above);
        assert_eq!(side(b, a, c, [12_345, 54_321, 2]), -above);
    }
}
