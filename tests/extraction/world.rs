//! Spacing, direction and handedness: an outward mesh of the right size in world units.

use super::mesh_of;
use crate::support::fields::sphere;
use crate::support::topology::judge;
use brickmarch::field::Dense;
use brickmarch::iso::Extract;
use brickmarch::{Affine, Box3, Budget, Grid, Inside, Units};

#[test]
fn any_affine_gives_an_outward_mesh_of_the_right_size() {
    let domain = Box3::from_size([40; 3]);
    let radius = 14.0;
    let values = sphere(domain, [20.0; 3], radius);
    let (s, c) = 0.7f64.sin_cos();
    let maps = [
        ("plain", Affine::IDENTITY),
        (
            "anisotropic",
            Affine::from_spacing([0.5, 0.5, 3.0], [100.0, -20.0, 7.0]),
        ),
        (
            "mirrored",
            Affine::from_spacing([-0.7, 0.7, 2.0], [5.0, 0.0, 0.0]),
        ),
        (
            "mirrored thrice",
            Affine::from_spacing([-1.0, -1.0, -1.0], [0.0; 3]),
        ),
        (
            "axes exchanged",
            Affine::from_columns(
                [[0.0, 2.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
                [1.0; 3],
            ),
        ),
        (
            "turned",
            Affine::from_columns(
                [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.5]],
                [0.0, 9.0, 0.0],
            ),
        ),
        (
            "sheared",
            Affine::from_columns(
                [[1.0, 0.0, 0.0], [0.3, 1.0, 0.0], [0.0, 0.4, 1.0]],
                [0.0; 3],
            ),
        ),
    ];
    for (name, index_to_world) in maps {
        let grid = Grid {
            domain,
            index_to_world,
            units: Units::Millimetre,
        };
        let field = Dense::new(grid, values.clone()).expect("sizes match");
        for inside in [Inside::Below, Inside::Above] {
            let options = Extract {
                inside: Some(inside),
                normals: true,
                ..Extract::default()
            };
            let (mesh, _) =
                mesh_of(&field, &options, &Budget::mib(64)).expect("there is a surface");
            let verdict = judge(&mesh.positions, &mesh.triangles);
            assert!(
                verdict.is_manifold() && verdict.is_closed(),
                "{name}: {verdict:?}"
            );
            let ball = 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3);
            // The other side of the ball is capped at the outermost samples, MIN_T beyond them.
            let side = 39.0 + 2e-3;
            let want = if inside == Inside::Below {
                ball
            } else {
                f64::powi(side, 3) - ball
            };
            let got = verdict.volume / index_to_world.determinant().abs();
            assert!(
                (got / want - 1.0).abs() < 0.01,
                "{name} {inside:?}: volume {got}, should be {want}"
            );
            assert_normals_point_out(&mesh, name);
        }
    }
}

/// Every normal is a unit vector on the outer side of the triangles around its vertex.
fn assert_normals_point_out(mesh: &brickmarch::Mesh, name: &str) {
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize].map(f64::from));
        let (u, v): ([f64; 3], [f64; 3]) = (
            std::array::from_fn(|i| b[i] - a[i]),
            std::array::from_fn(|i| c[i] - a[i]),
        );
        let face = [
            u[1] * v[2] - u[2] * v[1],
            u[2] * v[0] - u[0] * v[2],
            u[0] * v[1] - u[1] * v[0],
        ];
        let sum: [f64; 3] = std::array::from_fn(|i| {
            t.iter()
                .map(|&v| f64::from(mesh.normals[v as usize][i]))
                .sum()
        });
        let length = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        for &v in t {
            let n = mesh.normals[v as usize].map(f64::from);
            assert!(
                (length(n) - 1.0).abs() < 1e-5,
                "{name}: normal of length {}",
                length(n)
            );
        }
        let along: f64 = (0..3).map(|i| face[i] * sum[i]).sum();
        // Slivers at the clamp may lean; a turned normal would be far below.
        assert!(
            along > -0.3 * length(face) * length(sum),
            "{name}: a normal points in"
        );
    }
}
