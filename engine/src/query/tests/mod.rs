//! Each question against what the samples themselves say, on a dense copy.

mod points;
mod rays;
mod regions;

use super::*;
use crate::field::{Dense, Field, FromFn, Samples};
use crate::store::{Volume, VolumeSpec, write_field};
use crate::{Affine, Box3, Budget, ErrorKind, Grid, Inside, Kind, Range, SampleType};
use std::collections::BTreeSet;

const DOMAIN: Box3 = Box3::new([-5, 3, 100], [38, 37, 131]);

/// Numbers from 0 to 1.
struct Rng(u64);

impl Rng {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A point in and a little around a box; every fourth coordinate on the lattice.
    fn point(&mut self, domain: Box3) -> [f64; 3] {
        std::array::from_fn(|a| {
            let size = f64::from(domain.size()[a]) + 2.0;
            let v = f64::from(domain.min[a]) - 1.5 + self.next() * size;
            if self.next() < 0.25 { v.round() } else { v }
        })
    }
}

/// Blobs on a constant ground, so that there are tiles; rounded to whole numbers for whole types.
fn value(sample: SampleType, p: [i32; 3]) -> f32 {
    let [x, y, z] = p.map(|v| v as f32);
    let f = (x * 0.31).sin() + (y * 0.23).cos() * (z * 0.37).sin();
    let v = if f < 0.4 { 0.0 } else { f };
    match sample {
        SampleType::Bit => f32::from(u8::from(v > 0.0)),
        SampleType::F32 if p == [7, 9, 111] => f32::NAN,
        SampleType::F32 if p == [20, 20, 120] => f32::INFINITY,
        SampleType::F32 => v,
        SampleType::U8 | SampleType::U16 | SampleType::U32 => (v * 60.0).round(),
        _ => (v * 50.0 - 20.0).round(),
    }
}

fn grid() -> Grid {
    Grid {
        index_to_world: Affine::from_spacing([0.5, 2.0, 1.0], [10.0, 0.0, -3.0]),
        ..Grid::new(DOMAIN)
    }
}

/// A file of this type, and what is in it.
fn volume(sample: SampleType, edge: u32, budget: &Budget) -> (tempfile::TempDir, Volume, Dense) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("v.bvol");
    let field = FromFn::new(
        grid(),
        Kind::Density,
        |p| value(sample, p),
        |_| Range::UNKNOWN,
    );
    let spec = VolumeSpec {
        brick_edge: edge,
        ..VolumeSpec::new(grid(), sample)
    };
    write_field(&field, &spec, &path, &Budget::mib(64)).expect("writes");
    let volume = Volume::open(&path, budget).expect("opens");
    let mut values = vec![0.0; DOMAIN.count() as usize];
    field
        .read(DOMAIN, &mut Samples::dense(&mut values, DOMAIN))
        .expect("reads");
    (folder, volume, Dense::new(grid(), values).expect("counts"))
}

fn at(dense: &Dense, p: [i32; 3]) -> f32 {
    dense.values()[dense.grid().domain.offset_of(p)]
}

/// Trilinear interpolation as the definition says.
fn trilinear_of(dense: &Dense, p: [f64; 3]) -> Option<f32> {
    let domain = dense.grid().domain;
    let inside =
        |a: usize| p[a] >= f64::from(domain.min[a]) && p[a] <= f64::from(domain.max[a] - 1);
    if !(0..3).all(inside) {
        return None;
    }
    let base = p.map(|v| v.floor() as i32);
    let t: [f32; 3] = std::array::from_fn(|a| (p[a] - f64::from(base[a])) as f32);
    // Axis by axis; a neighbour is read only when it counts.
    let line = |j: i32, k: i32| {
        let a = at(dense, [base[0], base[1] + j, base[2] + k]);
        if t[0] == 0.0 {
            return a;
        }
        a + (at(dense, [base[0] + 1, base[1] + j, base[2] + k]) - a) * t[0]
    };
    let face = |k: i32| {
        let a = line(0, k);
        if t[1] == 0.0 {
            a
        } else {
            a + (line(1, k) - a) * t[1]
        }
    };
    let a = face(0);
    Some(if t[2] == 0.0 {
        a
    } else {
        a + (face(1) - a) * t[2]
    })
}

const TYPES: [(SampleType, u32); 6] = [
    (SampleType::F32, 16),
    (SampleType::U8, 8),
    (SampleType::I16, 32),
    (SampleType::U16, 64),
    (SampleType::Bit, 64),
    (SampleType::I32, 16),
];
