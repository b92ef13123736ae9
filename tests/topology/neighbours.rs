//! Two cells agree on the face between them, and values at the isovalue tear nothing.

use super::{mesh, verdict, welded};
use crate::support::rng::Rng;
use brickmarch::Inside;
use brickmarch::iso::Boundary;

/// All 4096 sign patterns of two neighbouring cells, along each axis, with sizes that make every
/// choice on the face between them, ties among them.
#[test]
fn pairs_of_cells_close_over_every_sign_pattern() {
    let mut rng = Rng::new(20);
    let draws = if cfg!(debug_assertions) { 1 } else { 3 };
    for axis in 0..3 {
        let mut size = [2; 3];
        size[axis] = 3;
        for signs in 0..1u32 << 12 {
            for _ in 0..draws {
                let values: Vec<f32> = (0..12)
                    .map(|i| {
                        let size = rng.pick(&[0.0, 1.0, 1.0, 2.0, 3.0, 50.0, 1e4]);
                        if signs >> i & 1 == 1 {
                            size
                        } else {
                            -size - 0.5
                        }
                    })
                    .collect();
                for inside in [Inside::Above, Inside::Below] {
                    let whole = mesh(size, &values, 0.0, inside, Boundary::Cap);
                    let v = verdict(&whole);
                    assert!(v.is_manifold() && v.is_closed(), "{axis} {values:?}: {v:?}");
                    let w = verdict(&welded(&whole));
                    assert!(w.is_manifold() && w.is_closed(), "{axis} {values:?}: {w:?}");
                }
            }
        }
    }
}

/// Values 0 to 3 with the isovalue on a value, bytes, plateaus, NaN and infinities.
#[test]
fn ties_and_values_that_are_no_numbers_stay_closed_after_welding() {
    let mut rng = Rng::new(21);
    let rounds = if cfg!(debug_assertions) { 20 } else { 200 };
    for round in 0..rounds {
        let n = 9;
        let values: Vec<f32> = (0..n * n * n)
            .map(|_| match round % 4 {
                0 => rng.below(4) as f32,
                1 => rng.below(2) as f32 * 2.0,
                2 => rng.below(256) as f32,
                _ => match rng.below(12) {
                    0 => f32::NAN,
                    1 => f32::INFINITY,
                    2 => f32::NEG_INFINITY,
                    3 => f32::MAX,
                    4 => f32::MIN_POSITIVE,
                    _ => rng.signed() + 1.0,
                },
            })
            .collect();
        for inside in [Inside::Above, Inside::Below] {
            for iso in [1.0, 2.0] {
                let whole = mesh([n; 3], &values, iso, inside, Boundary::Cap);
                for v in [verdict(&whole), verdict(&welded(&whole))] {
                    assert!(
                        v.is_manifold() && v.is_closed(),
                        "round {round} {iso}: {v:?}"
                    );
                }
            }
        }
    }
}
