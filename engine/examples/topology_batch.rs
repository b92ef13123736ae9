//! Grids for an independent judge of topology, and their meshes.
//!
//! ```text
//! topology_batch grids KIND COUNT SEED BATCH    writes random grids
//! topology_batch mesh BATCH MESHES              meshes them, open at the border, in index space
//! topology_batch smooth BATCH MESHES            the same in three passes of relaxation
//! ```
//!
//! Kinds: `cell` (one cell), `r5` `r9` `r33` (white noise, by samples per axis), `k5` (magnitudes
//! log-uniform over six decades), `s33` (smooth), `u17` (bytes, isovalue on a value), `i9` (values
//! 0 to 3, isovalue on a value).
//!
//! BATCH: `i32` count; per grid `i32` sizes along x, y, z, `f32` isovalue, `f32` samples, x fastest.
//! MESHES: per grid `i32` vertices, `i32` triangles, `f64` positions, `i32` triangles. Little-endian.
//! Samples less the isovalue are integers of less than 24 bits, so that a judge can be exact.

use brickmarch::field::Dense;
use brickmarch::iso::{Boundary, Extract, extract};
use brickmarch::mesh::Collect;
use brickmarch::{Box3, Budget, Grid, Inside};
use std::error::Error;
use std::fs;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    match args[..] {
        ["grids", kind, count, seed, batch] => grids(kind, count.parse()?, seed.parse()?, batch),
        ["mesh", batch, meshes] => mesh(batch, meshes, 0),
        ["smooth", batch, meshes] => mesh(batch, meshes, 3),
        _ => Err(
            "usage: topology_batch grids KIND COUNT SEED BATCH | mesh BATCH MESHES | smooth BATCH MESHES".into(),
        ),
    }
}

/// SplitMix64.
struct Rng(u64);

impl Rng {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// Uniform in 0 to 1.
    fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// A whole number, never 0.
fn odd(v: f64) -> f32 {
    let v = v.round();
    if v == 0.0 { 1.0 } else { v as f32 }
}

fn grids(kind: &str, count: usize, seed: u64, batch: &str) -> Result<()> {
    let mut rng = Rng(seed);
    let mut out = (count as i32).to_le_bytes().to_vec();
    for number in 0..count {
        let (n, iso, values): (usize, f32, Vec<f32>) = match kind {
            "cell" => (2, 0.0, white(2, &mut rng)),
            "r5" => (5, 0.0, white(5, &mut rng)),
            "r9" => (9, 0.0, white(9, &mut rng)),
            "r33" => (33, 0.0, white(33, &mut rng)),
            "k5" => {
                let value = |rng: &mut Rng| {
                    let size = (rng.unit() * 20.0).exp2();
                    odd(if rng.next() & 1 == 0 { size } else { -size })
                };
                (5, 0.0, (0..125).map(|_| value(&mut rng)).collect())
            }
            "s33" => {
                let values = smooth(33, 2 + number % 3, &mut rng);
                (33, 0.0, values.iter().map(|v| odd(v * 1e5)).collect())
            }
            "u17" => {
                let values = if number % 2 == 0 {
                    (0..17 * 17 * 17).map(|_| rng.unit()).collect()
                } else {
                    smooth(17, 1, &mut rng)
                };
                let bytes = values.iter().map(|v| (v * 256.0).clamp(0.0, 255.0).floor());
                let bytes: Vec<f32> = bytes.map(|v| v as f32).collect();
                (17, bytes[number % bytes.len()].clamp(1.0, 255.0), bytes)
            }
            "i9" => {
                let values = (0..9 * 9 * 9).map(|_| (rng.next() % 4) as f32).collect();
                (9, (1 + number % 3) as f32, values)
            }
            _ => return Err(format!("no kind of grid is called {kind}").into()),
        };
        for _ in 0..3 {
            out.extend((n as i32).to_le_bytes());
        }
        out.extend(iso.to_le_bytes());
        out.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    }
    Ok(fs::write(batch, out)?)
}

fn white(n: usize, rng: &mut Rng) -> Vec<f32> {
    let value = |rng: &mut Rng| odd((rng.unit() * 2.0 - 1.0) * f64::from(1 << 20));
    (0..n * n * n).map(|_| value(rng)).collect()
}

/// White noise after `passes` of a 3x3x3 mean, periodic.
fn smooth(n: usize, passes: usize, rng: &mut Rng) -> Vec<f64> {
    let mut values: Vec<f64> = (0..n * n * n).map(|_| rng.unit() * 2.0 - 1.0).collect();
    for step in [1, n, n * n].repeat(passes) {
        let old = values.clone();
        for (at, value) in values.iter_mut().enumerate() {
            let i = at / step % n;
            let low = if i == 0 {
                at + (n - 1) * step
            } else {
                at - step
            };
            let high = if i == n - 1 {
                at - (n - 1) * step
            } else {
                at + step
            };
            *value = (old[low] + old[at] + old[high]) / 3.0;
        }
    }
    values
}

/// Takes little-endian numbers off a slice.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N]> {
        let (head, rest) = self.0.split_first_chunk().ok_or("the batch ends early")?;
        self.0 = rest;
        Ok(*head)
    }
}

fn mesh(batch: &str, meshes: &str, relax: u8) -> Result<()> {
    let bytes = fs::read(batch)?;
    let mut reader = Reader(&bytes);
    let mut out = Vec::new();
    let budget = Budget::mib(64).with_threads(1);
    for _ in 0..i32::from_le_bytes(reader.take()?) {
        let mut size = [0i32; 3];
        for n in &mut size {
            *n = i32::from_le_bytes(reader.take()?);
        }
        let iso = f32::from_le_bytes(reader.take()?);
        let domain = Box3::from_size(size);
        let mut values = Vec::new();
        for _ in 0..domain.count() {
            values.push(f32::from_le_bytes(reader.take()?));
        }
        let mut field = Dense::new(Grid::new(domain), values)?;
        field.block_edge = 8;
        let options = Extract {
            iso,
            inside: Some(Inside::Above),
            boundary: Boundary::Cut,
            relax,
            index_space: true,
            allow_empty: true,
            ..Extract::default()
        };
        let mut sink = Collect::default();
        extract(&field, &options, &budget, &mut sink)?;
        let mesh = sink.into_mesh();
        out.extend((mesh.positions.len() as i32).to_le_bytes());
        out.extend((mesh.triangles.len() as i32).to_le_bytes());
        let positions = mesh.positions.iter().flatten();
        out.extend(positions.flat_map(|v| f64::from(*v).to_le_bytes()));
        let corners = mesh.triangles.iter().flatten();
        out.extend(corners.flat_map(|v| v.to_le_bytes()));
    }
    Ok(fs::write(meshes, out)?)
}
