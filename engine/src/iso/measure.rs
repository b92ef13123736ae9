//! Speed of the kernel alone, for `docs/why.md`: blocks that the surface crosses, with their samples in
//! memory, scanned and emitted on one thread, by every level of instructions. Run by
//! `cargo test --release -p brickmarch --lib measure_kernel -- --ignored --nocapture`.

use super::block::{Block, BlockOutput, BlockSamples, Style};
use super::dispatch::Level;
use super::place::Placement;
use crate::mesh::Piece;
use crate::sample::Inside;
use crate::{Affine, Box3};
use std::f32::consts::TAU;
use std::time::Instant;

/// Lattice of the whole field.
const N: i32 = 1024;

fn gyroid(p: [i32; 3]) -> f32 {
    let [x, y, z] = p.map(|v| v as f32 * TAU * 8.0 / N as f32);
    x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()
}

fn sphere(p: [i32; 3]) -> f32 {
    let middle = N as f32 / 2.0;
    p.map(|v| (v as f32 - middle).powi(2))
        .iter()
        .sum::<f32>()
        .sqrt()
        - 0.4 * N as f32
}

/// Every 16th of the blocks in a cube of 256^3 samples that the surface crosses.
fn blocks(edge: i32, value: fn([i32; 3]) -> f32, style: &Style) -> Vec<BlockSamples> {
    let points = edge as usize + 1;
    let mut all = Vec::new();
    let mut block = Block::default();
    let per_side = 256 / edge;
    for n in (0..per_side.pow(3)).step_by(if edge == 16 { 7 } else { 1 }) {
        let origin = [
            n % per_side,
            n / per_side % per_side,
            n / per_side / per_side,
        ]
        .map(|v: i32| v * edge + 64);
        let mut samples = BlockSamples {
            origin,
            size: [points; 3],
            values: Vec::with_capacity(points.pow(3)),
            first: 0,
            step: [1, points, points * points],
        };
        for i in 0..points.pow(3) {
            let at = [i % points, i / points % points, i / points / points];
            samples
                .values
                .push(value(std::array::from_fn(|a| origin[a] + at[a] as i32)));
        }
        if block.scan(&samples, style) {
            all.push(samples);
        }
    }
    all
}

#[test]
#[ignore = "a measurement"]
#[expect(clippy::print_stderr, reason = "a measurement")]
fn measure_kernel() {
    for (name, value) in [
        ("gyroid", gyroid as fn([i32; 3]) -> f32),
        ("sphere", sphere),
    ] {
        for edge in [16, 32] {
            for &level in Level::available() {
                let style = Style {
                    iso: 0.0,
                    inside: Inside::Below,
                    placement: Placement::new(Affine::IDENTITY, Box3::from_size([N; 3]))
                        .expect("plain"),
                    normals: false,
                    keys: false,
                    relax: 0,
                    level,
                };
                let mut blocks = blocks(edge, value, &style);
                // As many as a cache of the second level holds, as after they were gathered.
                let every = (blocks.len() * (edge as usize).pow(3) * 4 / (400 << 10)).max(1);
                let mut n = 0;
                blocks.retain(|_| {
                    n += 1;
                    n % every == 0
                });
                let (mut block, mut piece, mut out): (Block, Piece, BlockOutput) =
                    Default::default();
                let mut triangles = 0;
                let (mut best, mut best_scan) = (f64::INFINITY, f64::INFINITY);
                for _ in 0..400 {
                    triangles = 0;
                    let start = Instant::now();
                    for samples in &blocks {
                        assert!(block.scan(samples, &style));
                    }
                    best_scan = best_scan.min(start.elapsed().as_secs_f64());
                    let start = Instant::now();
                    for samples in &blocks {
                        assert!(block.scan(samples, &style));
                        piece.positions.clear();
                        piece.own.clear();
                        piece.triangles.clear();
                        block.emit(samples, &style, [true; 3], &mut piece, &mut out);
                        triangles += piece.triangles.len();
                    }
                    best = best.min(start.elapsed().as_secs_f64());
                }
                let us = |seconds: f64| seconds * 1e6 / blocks.len() as f64;
                eprintln!(
                    "{name} edge {edge} {level:?}: {} blocks, {} triangles each, scan {:.2} us, all {:.2} us a block, \
                     {:.1} M triangles/s",
                    blocks.len(),
                    triangles / blocks.len(),
                    us(best_scan),
                    us(best),
                    triangles as f64 / best / 1e6
                );
            }
        }
    }
}
