//! Volume files as a whole: what goes in comes out, meshes are those of the dense array, damage
//! is never mistaken for data.

mod damage;
mod import;
mod mesh;

use crate::support::scratch::Scratch;
use brickmarch::store::{Volume, VolumeSpec, VolumeWriter};
use brickmarch::{Box3, Budget, SampleType};
use std::path::{Path, PathBuf};

/// Samples of a dense array as raw bytes of their type.
fn raw_of(sample: SampleType, values: &[f32]) -> Vec<u8> {
    let width = sample.bytes();
    let mut raw = vec![0; values.len() * width];
    for (value, raw) in values.iter().zip(raw.chunks_exact_mut(width)) {
        match sample {
            // Not through a double: a NaN keeps its bits.
            SampleType::F32 => raw.copy_from_slice(&value.to_le_bytes()),
            _ => sample.put(f64::from(*value), raw),
        }
    }
    raw
}

/// The values that the sample type makes of them.
fn stored(sample: SampleType, values: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0; values.len()];
    sample.to_f32(&raw_of(sample, values), &mut out);
    out
}

/// Raw samples of a whole domain.
pub(crate) struct Dense<'a> {
    pub(crate) spec: &'a VolumeSpec,
    pub(crate) raw: &'a [u8],
}

impl Dense<'_> {
    /// Puts every brick.
    pub(crate) fn put_all(&self, writer: &VolumeWriter) {
        self.put_all_in(writer, 0);
    }

    /// All bricks as volume `number`.
    pub(crate) fn put_all_in(&self, writer: &VolumeWriter, number: usize) {
        let spec = self.spec;
        let domain = spec.grid.domain;
        let width = spec.sample.bytes();
        let edge = spec.brick_edge as usize;
        let [bx, by, bz] = spec.bricks();
        for brick in (0..bx * by * bz).map(|n| [n % bx, n / bx % by, n / bx / by]) {
            // Beyond the domain anything may stand; it must not show.
            let mut bytes = vec![0xa5; edge.pow(3) * width];
            for (n, out) in bytes.chunks_exact_mut(width).enumerate() {
                let at = [n % edge, n / edge % edge, n / edge / edge];
                let p: [i32; 3] = std::array::from_fn(|a| {
                    domain.min[a] + (brick[a] as usize * edge + at[a]) as i32
                });
                if domain.contains(p) {
                    out.copy_from_slice(&self.raw[domain.offset_of(p) * width..][..width]);
                }
            }
            if spec.sample == SampleType::Bit {
                bytes.iter_mut().for_each(|b| *b = u8::from(*b == 1));
            }
            writer
                .put_brick_in(number, brick, &bytes)
                .expect("the brick is new");
        }
    }
}

/// Writes a dense array brick by brick.
pub(crate) fn write(path: &Path, spec: &VolumeSpec, values: &[f32]) {
    let writer = VolumeWriter::create(path, spec, &Budget::mib(64)).expect("a new file");
    let raw = &raw_of(spec.sample, values);
    Dense { spec, raw }.put_all(&writer);
    writer.finish().expect("it can be committed");
}

/// A volume file in scratch space.
fn file(scratch: &Scratch, name: &str, spec: &VolumeSpec, values: &[f32]) -> PathBuf {
    let path = scratch.path(name);
    write(&path, spec, values);
    path
}

pub(crate) fn read_all(volume: &Volume, region: Box3) -> brickmarch::Result<Vec<u8>> {
    let mut out = vec![0; region.count() as usize * volume.spec().sample.bytes()];
    volume.read_raw(region, &mut out).map(|()| out)
}
