//! Ranges of boxes hold every sample in them, in double precision, and tapes that were pruned for a
//! box give the same bits in it.

use super::{Random, model, nodes, samples_wanted};
use crate::model::interval::Interval;
use crate::model::tape::{Room, Tape};

/// Samples of one box: its corners, and points inside.
const INSIDE: usize = 92;

#[test]
fn ranges_hold_every_sample_of_every_node() {
    let samples = samples_wanted(10_000);
    let mut problems = Vec::new();
    for (name, shape) in nodes() {
        let tape = &model(&shape, 64.0).tape;
        let mut random = Random(1);
        let boxes = samples.div_ceil(INSIDE + 8);
        let found = (0..boxes).find_map(|_| problem(tape, &mut random));
        problems.extend(found.map(|what| format!("{name}: {what}")));
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

/// A box: most of any size and place; some with ends at round numbers, where values have creases,
/// or without extent along an axis.
fn random_box(random: &mut Random) -> [[f64; 2]; 3] {
    let size = 10f64.powf(random.within(-4.0, 0.3));
    [0; 3].map(|_| {
        let low = random.within(-1.5, 1.5);
        let high = low + size * random.within(0.1, 1.0);
        match random.next() % 16 {
            0 => [low, low],
            1 => [low, high].map(|v| (4.0 * v).round() / 4.0),
            2 => [0.0, high.abs()],
            3 => [-low.abs(), 0.0],
            _ => [low, high],
        }
    })
}

/// The first sample of a random box that breaks a promise.
fn problem(tape: &Tape, random: &mut Random) -> Option<String> {
    let ends = random_box(random);
    let cube = ends.map(|[low, high]| Interval::new(low, high));
    let mut points = [const { Vec::new() }; 3];
    for n in 0..INSIDE + 8 {
        for (axis, [low, high]) in ends.into_iter().enumerate() {
            let t = match n {
                0..8 => (n >> axis & 1) as f64,
                _ => random.within(0.0, 1.0),
            };
            points[axis].push((low + t * (high - low)).clamp(low, high));
        }
    }
    let room = &mut Room::default();
    let known = tape.range(cube, room).expect("no data fails");
    let pruned = tape.prune(room);
    let tight = tape.tight_range(cube, room).expect("no data fails");
    let [x, y, z] = &points;
    let mut values = vec![0.0; x.len()];
    tape.values([x, y, z], &mut values, room)
        .expect("no data fails");
    for (n, &value) in values.iter().enumerate() {
        for (what, range) in [("range", known), ("tight range", tight)] {
            if !range.contains(value) {
                let at = [x[n], y[n], z[n]];
                return Some(format!("{value:e} at {at:?}: {what} {range:?} of {ends:?}"));
            }
        }
    }
    let mut again = vec![0.0; x.len()];
    let pruned = pruned.as_ref()?;
    pruned
        .values([x, y, z], &mut again, room)
        .expect("no data fails");
    let differs = |(a, b): (&f64, &f64)| {
        (a + 0.0).to_bits() != (b + 0.0).to_bits() && !(a.is_nan() && b.is_nan())
    };
    let n = values.iter().zip(&again).position(differs)?;
    let (whole, less) = (values[n], again[n]);
    Some(format!(
        "{whole:e}, pruned {less:e} at {:?}: {ends:?}",
        [x[n], y[n], z[n]]
    ))
}
