//! How fast each scene fills rows, and how long a range takes: one thread.
//!
//! `cargo run --release -p brickmarch-data-gen --example fill_speed -- [N]`
#![expect(clippy::print_stdout, reason = "an example prints what it found")]

use brickmarch_data_gen::{Scene, SceneError, SceneName};
use std::time::Instant;

fn main() -> Result<(), SceneError> {
    let n = std::env::args().nth(1).and_then(|n| n.parse().ok());
    let n = n.unwrap_or(512u32);
    println!("scene              whole rows     rows of 32     ns per range of 16^3");
    for name in SceneName::ALL {
        let scene = Scene::new(name, n)?;
        let whole = fill(&scene, n);
        let short = fill(&scene, 32.min(n));
        println!(
            "{name:<18} {whole:.2} G/s       {short:.2} G/s       {:.0}",
            ranges(&scene)
        );
    }
    Ok(())
}

/// Billions of samples per second when rows are filled in parts of `length`.
fn fill(scene: &Scene, length: u32) -> f64 {
    let n = scene.n();
    let mut row = vec![0f32; length as usize];
    let slices = n.min(64);
    let mut sum = 0.0;
    let start = Instant::now();
    for k in 0..slices {
        for j in 0..n {
            for i in (0..=n - length).step_by(length as usize) {
                scene.fill_row(j, k * (n / slices), i, &mut row);
                sum += row[0];
            }
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    std::hint::black_box(sum);
    let samples = u64::from(slices) * u64::from(n) * u64::from(n / length * length);
    samples as f64 / seconds * 1e-9
}

/// Nanoseconds per range of a block of 16^3.
fn ranges(scene: &Scene) -> f64 {
    let n = scene.n() as i32;
    let start = Instant::now();
    let mut count = 0u32;
    let mut sum = 0.0;
    for k in (0..n).step_by(16) {
        for j in (0..n).step_by(16) {
            for i in (0..n).step_by(16) {
                let (lo, hi) = scene.range([i, j, k], [i + 16, j + 16, k + 16]);
                sum += lo + hi;
                count += 1;
            }
        }
    }
    std::hint::black_box(sum);
    start.elapsed().as_secs_f64() * 1e9 / f64::from(count)
}
