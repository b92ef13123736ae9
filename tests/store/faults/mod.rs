//! Calls that fail: each call of a run of 300 in each way, syncs that lose data, full disks; of writers
//! of new files, of writers of files that exist, of readers. The outcome is an error or the right
//! samples, on the disk as well, never damage.

mod edit;
mod reader;
mod writer;

use super::disk::{Disk, Fault, Plan};
use crate::support::report::figure;
use crate::support::rng::Rng;
use brickmarch::store::{Storage, Volume, VolumeInfo, VolumeSpec, VolumeWriter};
use brickmarch::{Box3, Budget, ErrorKind, Grid, Result, SampleType};
use std::path::Path;
use std::sync::Arc;

/// 6 x 6 x 8 bricks of edge 8.
const DOMAIN: Box3 = Box3::from_size([48, 48, 64]);
const NAME: &str = "faulty.bvol";

fn spec() -> VolumeSpec {
    VolumeSpec {
        brick_edge: 8,
        history: "made to fail".into(),
        ..VolumeSpec::new(Grid::new(DOMAIN), SampleType::U8)
    }
}

/// Bricks, no two alike, and the samples that they make.
struct Content {
    bricks: Vec<([u32; 3], Vec<u8>)>,
    samples: Vec<u8>,
}

fn content() -> Content {
    let mut rng = Rng::new(300);
    let mut samples = vec![0; DOMAIN.count() as usize];
    let mut bricks = Vec::new();
    for n in 0..6 * 6 * 8u32 {
        let brick = [n % 6, n / 6 % 6, n / 36];
        let base = rng.next() as u8;
        let mut raw = vec![0; 512];
        for (at, value) in raw.iter_mut().enumerate() {
            let p = [at % 8, at / 8 % 8, at / 64];
            *value = base.wrapping_add((p[0] * (n as usize % 7) + p[2]) as u8);
            let whole: [usize; 3] = std::array::from_fn(|a| brick[a] as usize * 8 + p[a]);
            samples[whole[0] + 48 * (whole[1] + 48 * whole[2])] = *value;
        }
        bricks.push((brick, raw));
    }
    Content { bricks, samples }
}

fn write(storage: Arc<dyn Storage>, content: &Content) -> Result<VolumeInfo> {
    let writer = VolumeWriter::create_in(storage, Path::new(NAME), &spec(), &Budget::mib(16))?;
    for (brick, raw) in &content.bricks {
        writer.put_brick(*brick, raw)?;
    }
    writer.finish()
}

fn read(storage: Arc<dyn Storage>, budget: &Budget) -> Result<Vec<u8>> {
    let volume = Volume::open_in(storage, Path::new(NAME), budget)?;
    let mut out = vec![0; DOMAIN.count() as usize];
    volume.read_raw(DOMAIN, &mut out).map(|()| out)
}

/// One line that names the file.
#[track_caller]
fn assert_clear(error: &brickmarch::Error, what: &str) {
    let text = error.to_string();
    assert!(
        text.contains(NAME) && !text.contains('\n'),
        "{what}: {text}"
    );
}
