//! Which moves are refused: those that leave a triangle turned over, narrower than the narrowest
//! around the vertex was, or through another triangle.
//!
//! A refused vertex goes back to its start, which may in turn spoil a triangle with vertices that
//! stay moved. So it is asked a fixed number of times, and what depends on what stays local. What
//! still crosses then goes back together with all that could cross in turn (`tangle.rs`).

use super::net::{Net, kind};
use super::surface::{Metric, Place, cross, dot, step, sum};
use super::tangle::{self, Tangles};

/// How often it is asked.
const ROUNDS: u8 = 2;

/// Cells farther from a vertex than its triangles that those can lie which cross them: vertices
/// move less than half a cell, so two triangles that meet began in cells beside each other.
pub(super) const CROSSING_RINGS: u8 = 1;

/// Cells around a tile that decide what is refused in it; `close` where sheets may be close.
pub(super) fn rings(close: bool) -> u8 {
    if close {
        ROUNDS * (1 + CROSSING_RINGS) + tangle::RINGS
    } else {
        ROUNDS
    }
}

/// The same for what is asked after this round.
fn rings_after(round: u8, close: bool) -> u8 {
    let left = ROUNDS - round - 1;
    if close {
        left * (1 + CROSSING_RINGS) + tangle::RINGS
    } else {
        left
    }
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
    tangles: Tangles,
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
        if close {
            let rings = rings + CROSSING_RINGS;
            s.tangles
                .each_crossing(net, triangles, rings, &s.fresh, |pair| {
                    any = true;
                    for v in pair.into_iter().flatten() {
                        s.refused[v as usize] = true;
                    }
                });
        }
        if !any {
            return;
        }
        for v in 0..count {
            if s.refused[v] {
                net.refuse(v);
            }
        }
        std::mem::swap(&mut s.fresh, &mut s.refused);
    }
    if close {
        s.tangles.undo(net, triangles, &s.fresh);
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

#[cfg(test)]
mod tests {
    use super::super::surface::FINE;
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
