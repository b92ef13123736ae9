//! The bricks of the middle 512^3 of a volume file, handed out one after another as singles, beside the
//! decoding of the same bricks alone: each is looked up in the octree, read, checked and decoded to the
//! bytes of its samples, and nothing is copied.
//!
//! `BRICKMARCH_STREAM=a.bvol,b.bvol cargo bench -p brickmarch-benches -- stream`

use brickmarch::query::{BrickSamples, Bricks, bricks_of};
use brickmarch::store::Volume;
use brickmarch::{Box3, Budget, Field, Samples};
use std::path::Path;
use std::time::Instant;

const SIDE: i32 = 512;
const MIB: u64 = 64;
const RUNS: usize = 7;

pub(crate) fn run() {
    let Ok(files) = std::env::var("BRICKMARCH_STREAM") else {
        println!("stream: name volume files in BRICKMARCH_STREAM");
        return;
    };
    for file in files.split(',') {
        report(Path::new(file));
    }
}

/// What came of one way through the region.
struct Run {
    seconds: f64,
    peak_mib: f64,
    decoded: u64,
    /// Sum of the bits of the first sample of every brick: the same for every way.
    mark: u64,
}

fn timed(path: &Path, threads: usize, way: impl Fn(&Volume, Box3, &Budget) -> u64) -> Run {
    let budget = Budget::mib(MIB).with_threads(threads);
    let volume = Volume::open(path, &budget).expect("opens");
    let region = middle(&volume);
    let start = Instant::now();
    let mark = way(&volume, region, &budget);
    Run {
        seconds: start.elapsed().as_secs_f64(),
        peak_mib: budget.peak_bytes() as f64 / f64::from(1 << 20),
        decoded: volume.blocks_decoded(),
        mark,
    }
}

fn middle(volume: &Volume) -> Box3 {
    let domain = volume.grid().domain;
    // On the borders of bricks.
    let low =
        [0, 1, 2].map(|a| domain.min[a] + ((domain.size()[a] as i32 - SIDE) / 2).max(0) / 64 * 64);
    Box3::new(low, low.map(|v| v + SIDE)).intersect(&domain)
}

/// Lowest corners of the bricks, in Morton order.
fn corners(volume: &Volume, region: Box3) -> Vec<[i32; 3]> {
    let edge = volume.block_edge() as i32;
    let size = region.size().map(|n| n.div_ceil(edge as u32));
    let mut places: Vec<[u32; 3]> = (0..size[0] * size[1] * size[2])
        .map(|n| [n % size[0], n / size[0] % size[1], n / size[0] / size[1]])
        .collect();
    places.sort_by_key(|&p| brickmarch::lattice::morton_encode(p));
    let point = |p: [u32; 3]| std::array::from_fn(|a| region.min[a] + p[a] as i32 * edge);
    places.into_iter().map(point).collect()
}

fn decoding_alone(volume: &Volume, region: Box3, threads: usize) -> u64 {
    let corners = corners(volume, region);
    let next = std::sync::atomic::AtomicUsize::new(0);
    let work = || {
        let mut mark = 0u64;
        loop {
            let n = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            let Some(&corner) = corners.get(n) else {
                return mark;
            };
            let pin = volume.pin(corner).expect("reads");
            mark = mark.wrapping_add(pin.get(corner).to_bits().into());
        }
    };
    std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(work)).collect();
        let own = work();
        others.into_iter().fold(own, |sum, other| {
            sum.wrapping_add(other.join().expect("no panic"))
        })
    })
}

fn mark_of(samples: &BrickSamples) -> u64 {
    match samples {
        BrickSamples::Constant(value) => value.to_bits().into(),
        BrickSamples::Dense(values) => values[0].to_bits().into(),
    }
}

fn streamed(volume: &Volume, region: Box3, budget: &Budget) -> u64 {
    let mut mark = 0u64;
    bricks_of(volume, region, budget, |brick| {
        mark = mark.wrapping_add(mark_of(&brick.samples));
        Ok(())
    })
    .expect("streams");
    mark
}

fn iterated(volume: &Volume, region: Box3, budget: &Budget) -> u64 {
    Bricks::new(volume, region, budget)
        .expect("inside")
        .map(|brick| mark_of(&brick.expect("reads").samples))
        .fold(0, u64::wrapping_add)
}

/// Every sample of the stream is that of the volume.
fn check(path: &Path) {
    let budget = Budget::mib(MIB);
    let volume = Volume::open(path, &budget).expect("opens");
    let other = Volume::open(path, &Budget::mib(MIB)).expect("opens");
    let (mut expected, mut count) = (Vec::new(), 0);
    let region = middle(&volume);
    bricks_of(&volume, region, &budget, |brick| {
        expected.resize(brick.region.count() as usize, 0.0);
        let mut out = Samples::dense(&mut expected, brick.region);
        other.read(brick.region, &mut out)?;
        let same = |(a, b): (f32, f32)| a.to_bits() == b.to_bits();
        assert!(match &brick.samples {
            BrickSamples::Constant(value) => expected.iter().all(|&v| same((v, *value))),
            BrickSamples::Dense(values) => values
                .iter()
                .copied()
                .zip(expected.iter().copied())
                .all(same),
        });
        count += brick.region.count();
        Ok(())
    })
    .expect("streams");
    assert_eq!(count, region.count());
}

fn report(path: &Path) {
    check(path);
    for threads in [1, 2] {
        let alone = |v: &Volume, r: Box3, _: &Budget| decoding_alone(v, r, threads);
        let ways: [(&str, &dyn Fn() -> Run); 3] = [
            ("decoding alone", &|| timed(path, threads, alone)),
            ("bricks_of", &|| timed(path, threads, streamed)),
            ("Bricks", &|| timed(path, threads, iterated)),
        ];
        // In turn, so that a machine that slows down does so for all.
        let mut seconds = [const { Vec::new() }; 3];
        let mut last = [const { None }; 3];
        for _ in 0..RUNS {
            for (n, (_, way)) in ways.iter().enumerate() {
                let run = way();
                seconds[n].push(run.seconds);
                last[n] = Some(run);
            }
        }
        let [alone, ..] = &seconds;
        let shares = |other: &[f64]| {
            let mut shares: Vec<f64> = alone.iter().zip(other).map(|(a, b)| a / b).collect();
            shares.sort_by(f64::total_cmp);
            shares[RUNS / 2]
        };
        let marks = last.each_ref().map(|r| r.as_ref().expect("ran").mark);
        assert!(marks.iter().all(|&m| m == marks[0]), "{marks:?}");
        for ((name, _), (seconds, run)) in ways.iter().zip(seconds.iter().zip(&last)) {
            let run = run.as_ref().expect("ran");
            let mut sorted = seconds.clone();
            sorted.sort_by(f64::total_cmp);
            let edge = SIDE as f64;
            println!(
                "{}: {threads} threads, {name}: {:.3} s, {:.0} M samples/s, {:.0} % of decoding alone (median of {RUNS}, \
                 pair by pair); {} bricks decoded, {:.1} MiB under permit at most",
                path.display(),
                sorted[RUNS / 2],
                edge * edge * edge / sorted[RUNS / 2] / 1e6,
                100.0 * shares(seconds),
                run.decoded,
                run.peak_mib,
            );
        }
    }
}
