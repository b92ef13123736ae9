//! Which moves are refused: those that leave a triangle turned over, narrower than the narrowest
//! around the vertex was, or through another triangle.
//!
//! A refused vertex goes back to its start, which may in turn spoil a triangle with vertices that
//! stay moved. So refusals spread, and to stay local they spread no faster than a cell at a time:
//! where triangles are bad, their vertices go back as much later as these are apart. What happens
//! to a vertex up to some time depends on what is no farther away than that.

use super::net::{Net, kind};
use super::surface::{FINE, Metric, Place, cross, dot, step, sum};
use super::tangle::Tangles;

/// How far refusals spread that were made for the shape of a triangle, in cells.
const SHAPE_RINGS: u8 = 4;

/// How far those spread that were made because triangles cross.
const CROSSING_RINGS: u8 = 10;

/// Steps of time in which refusals spread by a cell.
const STEPS: u8 = 2;

/// The time of a vertex that is not refused.
const NEVER: u8 = u8::MAX;

/// Cells around a tile that decide what is refused in it; `close` where sheets may be close.
pub(super) fn rings(close: bool) -> u8 {
    if close { CROSSING_RINGS } else { SHAPE_RINGS }
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
    /// Per vertex when it goes back.
    due: Vec<u8>,
    /// Vertices whose triangles have yet to be looked at: all that moved, then those that went back.
    fresh: Vec<bool>,
    pub(super) tangles: Tangles,
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
    s.due.clear();
    s.due.resize(count, NEVER);
    let last = rings(close) * STEPS;
    for time in 0..=last {
        if time > 0 && !go_back(net, time, s) {
            continue;
        }
        // What is farther away comes too late.
        let rings = (last - time).div_ceil(STEPS);
        if time < SHAPE_RINGS * STEPS {
            refuse_shapes(net, metric, triangles, (time, rings), s);
        }
        if close && time < last {
            let (due, net) = (&mut s.due, &*net);
            s.tangles
                .each_crossing(net, triangles, rings, &s.fresh, |pair| {
                    let all = pair.as_flattened();
                    let then = time + delay(net, all);
                    for &v in all.iter().filter(|_| then <= last) {
                        let due = &mut due[v as usize];
                        *due = then.min(*due);
                    }
                });
        }
    }
}

/// Takes back the moves that are due. False when there are none.
fn go_back(net: &mut Net, time: u8, s: &mut Settling) -> bool {
    let mut any = false;
    for v in 0..s.due.len() {
        s.fresh[v] = s.due[v] == time && net.now[v] != net.start[v];
        if s.fresh[v] {
            net.refuse(v);
            any = true;
        }
    }
    any
}

/// Looks at the shapes of the triangles with fresh vertices.
#[inline(always)]
fn refuse_shapes(
    net: &Net,
    metric: &Metric,
    triangles: &[[u32; 3]],
    (time, rings): (u8, u8),
    s: &mut Settling,
) {
    for &numbers in triangles {
        let [a, b, c] = numbers;
        let t = [a as usize, b as usize, c as usize];
        if !(s.fresh[t[0]] || s.fresh[t[1]] || s.fresh[t[2]])
            || net.rings[t[0]].max(net.rings[t[1]]).max(net.rings[t[2]]) > rings
        {
            continue;
        }
        let now = [net.now[t[0]], net.now[t[1]], net.now[t[2]]];
        let (angle, normal) = least_angle(metric, now);
        let turned = against(normal, outward(net, t)) && {
            // Where the surface bends within a cell, normals tell little: against the start too.
            let start = [net.start[t[0]], net.start[t[1]], net.start[t[2]]];
            let (_, before) = least_angle(metric, start);
            against(normal, before)
        };
        if !turned && angle >= ENOUGH {
            continue;
        }
        let then = time + delay(net, &numbers);
        for v in t {
            if then <= SHAPE_RINGS * STEPS && (turned || angle < s.narrowest[v]) {
                s.due[v] = then.min(s.due[v]);
            }
        }
    }
}

/// How long it takes from one of the vertices to another.
fn delay(net: &Net, all: &[u32]) -> u8 {
    let apart = |k: usize| {
        let at = |&v: &u32| net.start[v as usize][k];
        let low = all.iter().map(at).fold(i32::MAX, i32::min);
        let high = all.iter().map(at).fold(i32::MIN, i32::max);
        high - low
    };
    let apart = apart(0).max(apart(1)).max(apart(2));
    let step = (1 << FINE) / i32::from(STEPS);
    // No triangle is longer than a cell, so this is at most a few.
    (apart + step - 1).div_euclid(step).clamp(1, 100) as u8
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
}
