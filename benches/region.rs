//! Random 64^3 boxes of volume files: a fresh open each, and a volume kept open.
//!
//! `BRICKMARCH_REGION=a.bvol,b.bvol cargo bench -p brickmarch-benches -- region`

use brickmarch::store::Volume;
use brickmarch::{Box3, Budget, Field, Samples};
use std::path::Path;
use std::time::Instant;

const SIDE: usize = 64;
const QUERIES: usize = 400;

pub(crate) fn run() {
    let Ok(files) = std::env::var("BRICKMARCH_REGION") else {
        println!("region: name volume files in BRICKMARCH_REGION");
        return;
    };
    for file in files.split(',') {
        report(Path::new(file));
    }
}

/// Microseconds at a share of the sorted times.
fn at(times: &mut [f64], share: f64) -> f64 {
    times.sort_by(f64::total_cmp);
    times[((times.len() - 1) as f64 * share) as usize] * 1e6
}

fn report(path: &Path) {
    let budget = Budget::mib(64).with_threads(1);
    let volume = Volume::open(path, &budget).expect("opens");
    let domain = volume.grid().domain;
    let mut seed = 1u64;
    let mut below = |n: u32| {
        seed = seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((u128::from(seed) * u128::from(n)) >> 64) as i32
    };
    let boxes: Vec<Box3> = (0..QUERIES)
        .map(|_| {
            let min = [0, 1, 2].map(|a| domain.min[a] + below(domain.size()[a] - SIDE as u32));
            Box3::new(min, min.map(|v| v + SIDE as i32))
        })
        .collect();
    let mut values = vec![0f32; SIDE.pow(3)];
    // Seconds from `start` until the samples are there, and their sum.
    let mut read = |volume: &Volume, region: Box3, start: Instant| {
        let mut block = Samples {
            values: &mut values,
            row: SIDE,
            slice: SIDE * SIDE,
        };
        volume.read(region, &mut block).expect("reads");
        let took = start.elapsed().as_secs_f64();
        (took, values.iter().map(|&v| f64::from(v)).sum::<f64>())
    };
    // Warms the pages of the file, and gives the sums that every other way must find again.
    let sums: Vec<f64> = boxes
        .iter()
        .map(|&b| read(&volume, b, Instant::now()).1)
        .collect();
    drop(volume);
    let (mut fresh, mut decoded) = (Vec::new(), 0);
    for (&region, &sum) in boxes.iter().zip(&sums) {
        let start = Instant::now();
        let volume = Volume::open(path, &budget).expect("opens");
        let (took, found) = read(&volume, region, start);
        fresh.push(took);
        assert_eq!(found, sum, "{region}");
        decoded += volume.blocks_decoded();
    }
    let (mut missing, mut cached) = (Vec::new(), Vec::new());
    let volume = Volume::open(path, &budget).expect("opens");
    for (&region, &sum) in boxes.iter().zip(&sums) {
        for times in [&mut missing, &mut cached] {
            let (took, found) = read(&volume, region, Instant::now());
            times.push(took);
            assert_eq!(found, sum, "{region}");
        }
    }
    println!(
        "{}: {QUERIES} boxes of {SIDE}^3, {:.1} bricks each; us, median (99th percentile): \
         fresh open {:.0} ({:.0}), kept open {:.0} ({:.0}), in the cache {:.0} ({:.0})",
        path.display(),
        decoded as f64 / QUERIES as f64,
        at(&mut fresh, 0.5),
        at(&mut fresh, 0.99),
        at(&mut missing, 0.5),
        at(&mut missing, 0.99),
        at(&mut cached, 0.5),
        at(&mut cached, 0.99),
    );
}
