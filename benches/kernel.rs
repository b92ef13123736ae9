//! Extraction from a dense array in memory without ranges, so that every block is looked at; triangles
//! counted and thrown away, vertices compared with the crossed edges.

use brickmarch::field::Dense;
use brickmarch::iso::{Boundary, Extract, extract};
use brickmarch::mesh::Count;
use brickmarch::{Box3, Budget, Field, Grid, Range, Result, Samples};
use std::time::Instant;

/// A dense array that does not scan itself for ranges: every block is looked at.
pub(crate) struct Unranged(pub(crate) Dense);

impl Field for Unranged {
    fn grid(&self) -> &Grid {
        self.0.grid()
    }

    fn block_edge(&self) -> u32 {
        self.0.block_edge
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()> {
        self.0.read(region, out)
    }

    fn range(&self, _region: Box3) -> Result<Range> {
        Ok(Range::UNKNOWN)
    }
}

fn fill(n: i32, edge: u32, value: impl Fn([f32; 3]) -> f32) -> Unranged {
    let domain = Box3::from_size([n; 3]);
    let mut values = Vec::with_capacity(domain.count() as usize);
    for k in 0..n {
        for j in 0..n {
            values.extend((0..n).map(|i| value([i as f32, j as f32, k as f32])));
        }
    }
    let mut field = Dense::new(Grid::new(domain), values).expect("right count");
    field.block_edge = edge;
    Unranged(field)
}

pub(crate) fn run() {
    let n = 256;
    let middle = n as f32 / 2.0;
    let sphere =
        |p: [f32; 3]| p.iter().map(|v| (v - middle).powi(2)).sum::<f32>().sqrt() - 0.4 * n as f32;
    for edge in [16, 32] {
        report(&format!("sphere {n} edge {edge}"), &fill(n, edge, sphere));
        report(&format!("gyroid {n} edge {edge}"), &gyroid(n, edge));
    }
}

/// Eight periods.
pub(crate) fn gyroid(n: i32, edge: u32) -> Unranged {
    let k = std::f32::consts::TAU * 8.0 / n as f32;
    fill(n, edge, |p: [f32; 3]| {
        let [x, y, z] = p.map(|v| v * k);
        x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()
    })
}

/// Edges of the lattice whose ends lie on different sides: a vertex of the mesh each.
fn crossed(field: &Unranged) -> u64 {
    let domain = field.grid().domain;
    let mut values = vec![0.0; domain.count() as usize];
    field
        .read(domain, &mut Samples::dense(&mut values, domain))
        .expect("in memory");
    let n = domain.size().map(|n| n as usize);
    let mut count = 0;
    for (at, &value) in values.iter().enumerate() {
        let p = [at % n[0], at / n[0] % n[1], at / n[0] / n[1]];
        let step = [1, n[0], n[0] * n[1]];
        for axis in (0..3).filter(|&a| p[a] + 1 < n[a]) {
            count += u64::from((value >= 0.0) != (values[at + step[axis]] >= 0.0));
        }
    }
    count
}

fn report(name: &str, field: &Unranged) {
    let crossed = crossed(field);
    let options = Extract {
        iso: 0.0,
        boundary: Boundary::Cut,
        ..Extract::default()
    };
    for threads in [1, 2] {
        let mut best = f64::INFINITY;
        let mut triangles = 0;
        for _ in 0..5 {
            let mut sink = Count::default();
            let budget = Budget::mib(256).with_threads(threads);
            let start = Instant::now();
            let stats = extract(field, &options, &budget, &mut sink).expect("meshes");
            best = best.min(start.elapsed().as_secs_f64());
            assert_eq!(stats.vertices - stats.interior_vertices, crossed, "{name}");
            triangles = stats.triangles;
        }
        println!(
            "{name}: {threads} threads, {triangles} triangles, {:.1} M/s",
            triangles as f64 / best / 1e6
        );
    }
}
