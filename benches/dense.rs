//! A whole volume file into memory, slab by slab of 64 planes, each thread a part of the planes.
//!
//! `BRICKMARCH_DENSE=a.bvol,b.bvol=b.raw cargo bench -p brickmarch-benches -- dense`: one JSON line for each file;
//! where a raw file is named, every byte is compared with it first.

use brickmarch::store::Volume;
use brickmarch::{Box3, Budget, Field};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::time::{Duration, Instant};

const PLANES: u32 = 64;
const THREADS: usize = 2;

pub(crate) fn run() {
    let Ok(files) = std::env::var("BRICKMARCH_DENSE") else {
        println!("dense: name volume files in BRICKMARCH_DENSE");
        return;
    };
    for file in files.split(',') {
        let (volume, raw) = file.split_once('=').unwrap_or((file, ""));
        report(Path::new(volume), raw);
    }
}

fn report(path: &Path, raw: &str) {
    let mut expected = (!raw.is_empty()).then(|| File::open(raw).expect("opens"));
    let mut other = Vec::new();
    slabs(path, |slab| {
        if let Some(file) = &mut expected {
            other.resize(slab.len(), 0);
            file.read_exact(&mut other).expect("as long as the volume");
            assert!(slab == other, "other bytes than {raw}");
        }
    });
    let before = cpu_seconds();
    let (took, bytes) = slabs(path, |_| {});
    println!(
        "{{\"volume\": {:?}, \"wall\": {:.4}, \"cpu\": {:.2}, \"bytes\": {bytes}, \"gb_per_s\": {:.3}, \"mib\": {:.0}}}",
        path.display().to_string(),
        took.as_secs_f64(),
        cpu_seconds() - before,
        bytes as f64 / took.as_secs_f64() / 1e9,
        peak_mib(),
    );
}

/// Time to read all slabs, without what `see` does, and bytes read.
fn slabs(path: &Path, mut see: impl FnMut(&[u8])) -> (Duration, u64) {
    let budget = Budget::mib(64).with_threads(THREADS);
    let volume = Volume::open(path, &budget).expect("opens");
    let domain = volume.grid().domain;
    let plane =
        domain.size()[0] as usize * domain.size()[1] as usize * volume.spec().sample.bytes();
    let mut slab = vec![0u8; plane * PLANES as usize];
    let (mut took, mut bytes) = (Duration::ZERO, 0);
    let mut low = domain.min[2];
    while low < domain.max[2] {
        let high = (low + PLANES as i32).min(domain.max[2]);
        let len = (high - low) as usize;
        let start = Instant::now();
        std::thread::scope(|scope| {
            let part = len.div_ceil(THREADS);
            for (n, out) in slab[..len * plane].chunks_mut(part * plane).enumerate() {
                let (mut min, mut max) = (domain.min, domain.max);
                min[2] = low + (n * part) as i32;
                max[2] = min[2] + (out.len() / plane) as i32;
                let volume = &volume;
                scope.spawn(move || volume.read_raw(Box3::new(min, max), out).expect("reads"));
            }
        });
        took += start.elapsed();
        bytes += (len * plane) as u64;
        see(&slab[..len * plane]);
        low = high;
    }
    (took, bytes)
}

/// User and system seconds of this process.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").expect("Linux");
    let fields: Vec<&str> = stat
        .rsplit(')')
        .next()
        .expect("fields")
        .split(' ')
        .collect();
    let ticks = |n: usize| fields[n].parse::<f64>().expect("ticks");
    (ticks(12) + ticks(13)) / 100.0
}

fn peak_mib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status
        .lines()
        .find(|l| l.starts_with("VmHWM"))
        .expect("a peak");
    line.split_whitespace()
        .nth(1)
        .expect("kB")
        .parse::<f64>()
        .expect("number")
        / 1024.0
}
