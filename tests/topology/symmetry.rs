//! Turning and mirroring a cell turns and mirrors its surface; changing the sides changes nothing.

use super::{border_loops, mesh, verdict};
use crate::support::rng::Rng;
use brickmarch::Inside;
use brickmarch::iso::Boundary;

/// Where each corner goes under the 48 symmetries of the cube.
fn symmetries() -> Vec<[usize; 8]> {
    let mut out = Vec::new();
    for order in [
        [0, 1, 2],
        [0, 2, 1],
        [1, 0, 2],
        [1, 2, 0],
        [2, 0, 1],
        [2, 1, 0],
    ] {
        for flips in 0..8 {
            out.push(std::array::from_fn(|c| {
                (0..3).fold(0, |to, a| to | (c >> order[a] & 1) << a) ^ flips
            }));
        }
    }
    out
}

/// Components, Euler characteristic, border loops, triangles, vertices.
fn signature(values: &[f32; 8], inside: Inside) -> [i64; 5] {
    let found = mesh([2; 3], values, 0.0, inside, Boundary::Cut);
    let v = verdict(&found);
    assert!(v.is_manifold(), "{values:?}: {v:?}");
    [
        v.components as i64,
        v.euler,
        border_loops(&found) as i64,
        v.triangles as i64,
        v.vertices as i64,
    ]
}

#[test]
fn symmetric_cells_have_symmetric_surfaces() {
    let mut rng = Rng::new(22);
    let symmetries = symmetries();
    let cells = if cfg!(debug_assertions) { 100 } else { 1000 };
    let mut tunnels = 0;
    for round in 0..cells {
        // Signs of a case that can hold a tunnel, sizes uneven so that it often does.
        let mask = [
            0b1000_0001u32,
            0b0110_1001,
            0b1011_1101,
            0b1001_0110,
            0b1100_0011,
        ][round % 5];
        let values: [f32; 8] = std::array::from_fn(|c| {
            let bits = rng.below(20);
            // Odd bits, so that no saddle is at the isovalue: ties are not symmetric.
            let size = (1u64 << bits) as f32 * (2.0 + rng.signed());
            if mask >> c & 1 == 1 { size } else { -size }
        });
        let first = signature(&values, Inside::Above);
        tunnels += i32::from(first[1] < first[0]);
        let negative = values.map(|v| -v);
        assert_eq!(signature(&negative, Inside::Below), first, "{values:?}");
        for map in &symmetries {
            let mut turned = [0.0; 8];
            (0..8).for_each(|c| turned[map[c]] = values[c]);
            assert_eq!(
                signature(&turned, Inside::Above),
                first,
                "{values:?} by {map:?}"
            );
        }
    }
    assert!(tunnels * 20 > cells as i32, "only {tunnels} tunnels met");
}
