//! A ray through the blocks of cells of a region, and through the cells of a block.

use super::ray::Ray;
use std::ops::ControlFlow;

/// Calls `visit(box, start, end)` for each of the equal boxes of `edge` that the ray passes between the
/// parameters `start` and `end`, in order; the parts of the ray join without a gap. Boxes are numbered
/// from `origin` on, and are from `low` to `high`, inclusive.
///
/// Where the ray leaves a box is computed from the ray's origin each time, so that nothing adds up
/// (compare Amanatides and Woo 1987).
pub(super) fn pass<B>(
    ray: &Ray,
    [start, end]: [f64; 2],
    origin: [f64; 3],
    edge: f64,
    [low, high]: [[i64; 3]; 2],
    mut visit: impl FnMut([i64; 3], f64, f64) -> ControlFlow<B>,
) -> ControlFlow<B> {
    let place = |a: usize, t: f64| ray.origin[a] + t * ray.direction[a];
    let mut at: [i64; 3] = std::array::from_fn(|a| {
        (((place(a, start) - origin[a]) / edge).floor() as i64).clamp(low[a], high[a])
    });
    // Parameter at which the ray leaves box `n` along an axis.
    let leaves = |a: usize, n: i64| {
        let d = ray.direction[a];
        if d == 0.0 {
            return f64::INFINITY;
        }
        let side = origin[a] + edge * (n + i64::from(d > 0.0)) as f64;
        (side - ray.origin[a]) / d
    };
    let mut exit: [f64; 3] = std::array::from_fn(|a| leaves(a, at[a]));
    let mut t = start;
    loop {
        let axis = if exit[0] <= exit[1] && exit[0] <= exit[2] {
            0
        } else if exit[1] <= exit[2] {
            1
        } else {
            2
        };
        let out = exit[axis].clamp(t, end);
        visit(at, t, out)?;
        t = out;
        at[axis] += if ray.direction[axis] > 0.0 { 1 } else { -1 };
        if exit[axis] >= end || at[axis] < low[axis] || at[axis] > high[axis] {
            return ControlFlow::Continue(());
        }
        exit[axis] = leaves(axis, at[axis]);
    }
}
