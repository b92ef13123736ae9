//! Normals are those of the field: near the ones that a formula gives, nearer than those of triangles.

use crate::support::report::figure;
use brickmarch::field::FromFn;
use brickmarch::iso::{Boundary, Extract, extract};
use brickmarch::mesh::Collect;
use brickmarch::{Box3, Budget, Grid, Inside, Kind, Mesh, Range};

type Formula = fn([f64; 3]) -> (f64, [f64; 3]);

/// Distance to a sphere around the middle of a cube of side 1.
fn sphere(p: [f64; 3]) -> (f64, [f64; 3]) {
    let d = p.map(|v| v - 0.5);
    let length = d.iter().map(|v| v * v).sum::<f64>().sqrt();
    (length - 0.4, d.map(|v| v / length))
}

/// Eight periods in a cube of side 1.
fn gyroid(p: [f64; 3]) -> (f64, [f64; 3]) {
    let at = p.map(|v| v * 8.0 * std::f64::consts::TAU);
    let (s, c) = (at.map(f64::sin), at.map(f64::cos));
    let value = s[0] * c[1] + s[1] * c[2] + s[2] * c[0];
    let gradient = std::array::from_fn(|a| {
        let (next, last) = ((a + 1) % 3, (a + 2) % 3);
        c[a] * c[next] - s[last] * s[a]
    });
    (value, gradient)
}

fn mesh(n: i32, formula: Formula) -> Mesh {
    let value = move |p: [i32; 3]| formula(p.map(|v| f64::from(v) / f64::from(n))).0 as f32;
    let grid = Grid::new(Box3::from_size([n; 3]));
    let field = FromFn::new(grid, Kind::Density, value, |_| Range::UNKNOWN);
    let options = Extract {
        iso: 0.0,
        inside: Some(Inside::Below),
        boundary: Boundary::Cut,
        normals: true,
        index_space: true,
        ..Extract::default()
    };
    let mut sink = Collect::default();
    extract(&field, &options, &Budget::mib(64), &mut sink).expect("there is a surface");
    sink.into_mesh()
}

/// Normals by the area of the triangles around each vertex.
fn of_triangles(mesh: &Mesh) -> Vec<[f64; 3]> {
    let mut out = vec![[0.0; 3]; mesh.positions.len()];
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize].map(f64::from));
        for k in 0..3 {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            let area = (b[i] - a[i]) * (c[j] - a[j]) - (b[j] - a[j]) * (c[i] - a[i]);
            t.iter().for_each(|&v| out[v as usize][k] += area);
        }
    }
    out
}

/// Degrees between two directions, by their sine and cosine.
fn angle(a: [f64; 3], b: [f64; 3]) -> f64 {
    let cross: [f64; 3] = std::array::from_fn(|k| {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        a[i] * b[j] - a[j] * b[i]
    });
    let length = cross.iter().map(|v| v * v).sum::<f64>().sqrt();
    let dot: f64 = (0..3).map(|k| a[k] * b[k]).sum();
    length.atan2(dot).to_degrees()
}

#[test]
fn normals_are_within_a_degree_and_better_than_those_of_triangles() {
    let n = if cfg!(debug_assertions) { 64 } else { 256 };
    for (name, formula, bound) in [
        ("sphere", sphere as Formula, 0.02),
        ("gyroid", gyroid as Formula, 1.0),
    ] {
        let mesh = mesh(n, formula);
        let faceted = of_triangles(&mesh);
        let (mut sum, mut worst, mut sum_faceted, mut count) = (0.0f64, 0.0f64, 0.0, 0.0);
        for ((p, normal), other) in mesh.positions.iter().zip(&mesh.normals).zip(faceted) {
            let truth = formula(p.map(|v| f64::from(v) / f64::from(n))).1;
            let off = angle(normal.map(f64::from), truth);
            sum += off;
            worst = worst.max(off);
            sum_faceted += angle(other, truth);
            count += 1.0;
        }
        let (mean, mean_faceted) = (sum / count, sum_faceted / count);
        figure(&format!(
            "normals of the {name} {n}: off by {mean:.4} degrees on average, {worst:.3} at worst; \
             of triangles {mean_faceted:.4}"
        ));
        let coarse = (256.0 / f64::from(n)).powi(2);
        assert!(mean < bound * coarse, "{name}: {mean} degrees");
        assert!(mean < mean_faceted, "{name}: {mean} {mean_faceted}");
    }
}
