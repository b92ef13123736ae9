//! Meshes a formula without sampling the empty space: `mesh_formula gyroid.ply [N]`.
#![allow(clippy::print_stdout, reason = "a program")]
use brickmarch::field::FromFn;
use brickmarch::iso::{Extract, extract};
use brickmarch::{Box3, Budget, Grid, Kind, Range, Result};
use brickmarch_formats::create_mesh_sink;
use std::path::Path;

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().collect();
    let out = args.get(1).map_or("gyroid.ply", String::as_str);
    let n = args.get(2).and_then(|n| n.parse().ok()).unwrap_or(256);
    // Four periods; the value changes by at most `slope` for a step along an axis.
    let k = std::f32::consts::TAU * 4.0 / n as f32;
    let slope = 2.0 * k;
    let gyroid = move |p: [i32; 3]| {
        let [x, y, z] = p.map(|v| v as f32 * k);
        x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()
    };
    let range = move |b: Box3| {
        let middle = [0, 1, 2].map(|a| (b.min[a] + b.max[a]) / 2);
        let reach: u32 = b.size().iter().map(|s| s / 2 + 1).sum();
        let (value, far) = (gyroid(middle), slope * reach as f32 + 1e-4);
        Range {
            min: value - far,
            max: value + far,
            ..Range::of(value)
        }
    };
    let grid = Grid::new(Box3::from_size([n; 3]));
    let field = FromFn::new(grid, Kind::Distance, gyroid, range);
    let mut sink = create_mesh_sink(Path::new(out), true)?;
    let stats = extract(&field, &Extract::default(), &Budget::mib(64), &mut *sink)?;
    println!(
        "{out}: {} triangles, {} vertices",
        stats.triangles, stats.vertices
    );
    Ok(())
}
