//! Small closed meshes for the tests of this module.

use super::Mesh;
use std::f64::consts::TAU;

/// A tetrahedron with corners at the origin and one along each axis; volume 1/6.
pub(super) fn tetrahedron() -> Mesh {
    Mesh {
        positions: vec![
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
        ],
        triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        ..Mesh::default()
    }
}

/// A cube from `low` with the given edge; 8 vertices, 12 triangles.
pub(super) fn cube(low: [f32; 3], edge: f32) -> Mesh {
    let corner = |i: usize| [0, 1, 2].map(|axis| low[axis] + edge * (i >> axis & 1) as f32);
    let mut triangles = Vec::new();
    for axis in 0..3 {
        let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
        for (base, near) in [(0, true), (1 << axis, false)] {
            let (b, d) = if near { (v, u) } else { (u, v) };
            triangles.push([base, base + b, base + b + d]);
            triangles.push([base, base + b + d, base + d]);
        }
    }
    Mesh {
        positions: (0..8).map(corner).collect(),
        triangles,
        ..Mesh::default()
    }
}

/// A torus around the third axis, `around` by `across` squares.
pub(super) fn torus(large: f64, small: f64, around: u32, across: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for i in 0..around {
        let (sin_u, cos_u) = (TAU * f64::from(i) / f64::from(around)).sin_cos();
        for j in 0..across {
            let (sin_v, cos_v) = (TAU * f64::from(j) / f64::from(across)).sin_cos();
            let radius = large + small * cos_v;
            mesh.positions
                .push([radius * cos_u, radius * sin_u, small * sin_v].map(|x| x as f32));
        }
    }
    let at = |i: u32, j: u32| i % around * across + j % across;
    for i in 0..around {
        for j in 0..across {
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

/// Both meshes as one, without a common vertex.
pub(super) fn both(mut first: Mesh, second: &Mesh) -> Mesh {
    let base = first.positions.len() as u32;
    first.positions.extend(&second.positions);
    let shifted = second.triangles.iter().map(|t| t.map(|v| v + base));
    first.triangles.extend(shifted);
    first
}

/// `mesh` with vertex `from` replaced by `to` in every triangle; `from` stays, unused.
pub(super) fn pinch(mut mesh: Mesh, from: u32, to: u32) -> Mesh {
    for corner in mesh.triangles.iter_mut().flatten() {
        if *corner == from {
            *corner = to;
        }
    }
    mesh
}
