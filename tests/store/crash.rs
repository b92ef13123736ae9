//! The crash model through the real writer and reader: after a loss of power at any call, with any
//! subset of what was not synced, the volume holds the last acknowledged commit or the one in flight,
//! whole; and again when the power fails while the next writer goes on.

use super::broken::{Broken, Mistake};
use super::disk::{Disk, Op};
use super::states::{Accident, Choice, Platter, Point, points};
use super::tale::{self, BYTES, States};
use crate::support::report::figure;
use crate::support::rng::Rng;
use brickmarch::Budget;
use brickmarch::store::{Storage, VolumeWriter};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

/// How the storage of a reader or writer is seen.
type View<'a> = &'a (dyn Fn(Arc<dyn Storage>) -> Arc<dyn Storage> + Sync);

/// A recorded run.
struct Run {
    points: Vec<Point>,
    states: States,
    /// Samples of the import that the first two commits are.
    source: Option<Vec<u8>>,
}

/// One worker: its buffers, and what it has seen.
struct Worker<'a> {
    platter: Arc<Platter>,
    storage: Arc<dyn Storage>,
    budget: Budget,
    out: Vec<u8>,
    choice: Choice,
    rng: Rng,
    view: View<'a>,
    tried: u64,
    second: u64,
    in_flight: u64,
}

impl<'a> Worker<'a> {
    fn new(seed: u64, view: View<'a>) -> Self {
        let platter = Arc::new(Platter::default());
        Self {
            storage: view(platter.clone()),
            platter,
            budget: Budget::mib(8),
            out: vec![0; BYTES],
            choice: Choice {
                versions: Vec::new(),
                length: 0,
                accident: Accident::None,
            },
            rng: Rng::new(seed),
            view,
            tried: 0,
            second: 0,
            in_flight: 0,
        }
    }

    /// Looks at the state that `self.choice` describes. The platter holds the point.
    fn look(&mut self, point: &Point, states: &States) -> Result<usize, String> {
        point.apply(&self.choice, &self.platter);
        let seen = tale::judge(
            self.storage.clone(),
            &self.budget,
            states,
            point.acked,
            point.begun,
            &mut self.out,
        );
        self.tried += 1;
        if let Ok(n) = seen {
            self.in_flight += u64::from(n > point.acked);
        }
        let result = seen.map_err(|what| {
            format!(
                "{what}; {} acknowledged, {} begun; after call {} of the run, state {:?}",
                point.acked, point.begun, point.calls, self.choice
            )
        });
        point.restore(&self.choice, &self.platter);
        result
    }

    /// All subsets where there are few, else `count` random states.
    fn point(&mut self, point: &Point, states: &States, count: usize) -> Result<(), String> {
        point.lay(&self.platter);
        if let Some(all) = point.subsets(count / 2) {
            for n in 0..all {
                point.subset(n, &mut self.choice);
                self.look(point, states)?;
            }
        }
        for _ in 0..count {
            point.random(&mut self.rng, &mut self.choice);
            self.look(point, states)?;
        }
        Ok(())
    }

    /// Both superblocks of a disk at rest turn to noise, one at a time: what was acknowledged is
    /// found again by walking the log.
    fn at_rest(&mut self, point: &Point, states: &States) -> Result<(), String> {
        if !point.is_at_rest() || point.acked == 0 || point.has_tail() {
            return Ok(());
        }
        point.lay(&self.platter);
        for at in [4096, 8192] {
            self.platter.spoil(at, &mut self.rng);
            let seen = tale::judge(
                self.storage.clone(),
                &self.budget,
                states,
                point.acked,
                point.begun,
                &mut self.out,
            );
            point.lay(&self.platter);
            self.tried += 1;
            seen.map_err(|e| format!("{e}; the superblock at {at} turned to noise at rest"))?;
        }
        Ok(())
    }

    /// The power fails at `point`; a writer goes on for two commits, and the power fails again.
    fn again(&mut self, point: &Point, run: &Run, count: usize) -> Result<(), String> {
        let states = &run.states;
        point.lay(&self.platter);
        point.random(&mut self.rng, &mut self.choice);
        point.apply(&self.choice, &self.platter);
        let judged = tale::judge(
            self.storage.clone(),
            &self.budget,
            states,
            point.acked,
            point.begun,
            &mut self.out,
        );
        let image = self.platter.image();
        let seen = judged?;
        let source = run.source.as_deref().filter(|_| seen < 2);
        if seen == 0 && source.is_none() {
            return Ok(());
        }
        let mut next = states[..=seen].to_vec();
        let disk = Arc::new(Disk::new(image.clone()));
        let first = self.choice.clone();
        let at = |e: String| {
            format!(
                "{e}; second crash, after a first one behind call {} with {first:?}",
                point.calls
            )
        };
        let storage = (self.view)(disk.clone());
        let result = match source {
            Some(source) => {
                next = states[..=2].to_vec();
                tale::import(storage, &disk, source, &next, &self.budget)
            }
            None => go_on(storage, &disk, &mut next, &self.budget, &mut self.rng),
        };
        result.map_err(|e| at(format!("the next writer fails: {e}")))?;
        for point in &points(&image, &disk.take_ops(), seen) {
            let before = self.tried;
            self.point(point, &next, count).map_err(at)?;
            self.second += self.tried - before;
        }
        Ok(())
    }
}

fn go_on(
    storage: Arc<dyn Storage>,
    disk: &Disk,
    states: &mut States,
    budget: &Budget,
    rng: &mut Rng,
) -> brickmarch::Result<()> {
    let writer = tale::reopen(storage, budget)?;
    tale::step(&writer, disk, states, 1 + rng.below(2) as usize, rng)?;
    if rng.chance(2) {
        tale::step(&writer, disk, states, 1, rng)?;
    }
    Ok(())
}

/// What a recorded run does.
#[derive(Clone, Copy, Default)]
struct Script {
    commits: usize,
    /// Bricks that each commit changes; 0: one to three.
    bricks: usize,
    /// It begins as an import in two commits.
    is_import: bool,
    /// Now and then a writer is dropped, or killed in the middle of a commit, and another goes on.
    reopens: bool,
}

/// A storage that is cut off after some calls, as by a kill: what was written stays with the kernel.
struct CutOff {
    inner: Arc<dyn Storage>,
    left: AtomicU64,
}

impl CutOff {
    fn call(&self) -> io::Result<()> {
        let left = self.left.load(Ordering::Relaxed);
        self.left.store(left.saturating_sub(1), Ordering::Relaxed);
        match left {
            0 => Err(io::Error::other("killed")),
            _ => Ok(()),
        }
    }
}

impl Storage for CutOff {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        self.call()?;
        self.inner.read_at(buffer, offset)
    }
    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<()> {
        self.call()?;
        self.inner.write_at(bytes, offset)
    }
    fn len(&self) -> io::Result<u64> {
        self.call()?;
        self.inner.len()
    }
    fn set_len(&self, length: u64) -> io::Result<()> {
        self.call()?;
        self.inner.set_len(length)
    }
    fn sync(&self) -> io::Result<()> {
        self.call()?;
        self.inner.sync()
    }
    fn lock(&self) -> io::Result<bool> {
        self.inner.lock()
    }
}

/// A writer is killed somewhere in its commit, and the next one acknowledges what it finds.
fn kill_one(
    storage: &Arc<dyn Storage>,
    disk: &Disk,
    states: &mut States,
    budget: &Budget,
    rng: &mut Rng,
    reopened: View<'_>,
) -> brickmarch::Result<VolumeWriter> {
    let before = states.len() - 1;
    let cut = Arc::new(CutOff {
        inner: storage.clone(),
        left: AtomicU64::new(u64::MAX),
    });
    let writer = tale::reopen(cut.clone(), budget)?;
    cut.left.store(rng.below(24), Ordering::Relaxed);
    // Most often in the middle of it; else it is done.
    let _ = tale::step(&writer, disk, states, 1 + rng.below(2) as usize, rng);
    drop(writer);
    let mut seen = vec![0; BYTES];
    tale::read(storage.clone(), budget, &mut seen)?;
    let seen = if seen == states[before + 1] {
        before + 1
    } else {
        before
    };
    let state = states[seen].clone();
    states.push(state);
    let n = states.len() - 1;
    disk.mark(Op::Begun(n));
    let writer = tale::reopen(reopened(storage.clone()), budget)?;
    writer.commit()?;
    disk.mark(Op::Acked(n));
    Ok(writer)
}

/// Records a run; `storage` is what its writers see, `reopened` what the one after a kill sees.
fn record(
    seed: u64,
    script: Script,
    storage: &dyn Fn(Arc<Disk>) -> Arc<dyn Storage>,
    reopened: View<'_>,
) -> brickmarch::Result<Run> {
    let disk = Arc::new(Disk::new(Vec::new()));
    let budget = Budget::mib(8);
    let mut rng = Rng::new(seed);
    let mut states = vec![Vec::new()];
    let view = storage(disk.clone());
    let mut source = None;
    let mut writer;
    if script.is_import {
        let samples = tale::source(&mut rng);
        states.extend([tale::first_slab(&samples), samples.clone()]);
        let cut = Arc::new(CutOff {
            inner: view.clone(),
            left: AtomicU64::new(if script.reopens {
                rng.below(90)
            } else {
                u64::MAX
            }),
        });
        if tale::import(cut, &disk, &samples, &states, &budget).is_err() {
            tale::import(view.clone(), &disk, &samples, &states, &budget)?;
        }
        source = Some(samples);
        writer = tale::reopen(view.clone(), &budget)?;
    } else {
        writer = tale::start(view.clone(), &budget)?;
        tale::step(&writer, &disk, &mut states, 8, &mut rng)?;
    }
    while states.len() <= script.commits {
        if script.reopens && rng.chance(2) {
            drop(writer);
            writer = if rng.chance(2) {
                kill_one(&view, &disk, &mut states, &budget, &mut rng, reopened)?
            } else {
                tale::reopen(view.clone(), &budget)?
            };
        }
        let some = match script.bricks {
            0 => 1 + rng.below(3) as usize,
            bricks => bricks,
        };
        tale::step(&writer, &disk, &mut states, some, &mut rng)?;
    }
    Ok(Run {
        points: points(&[], &disk.take_ops(), 0),
        states,
        source,
    })
}

fn rounds(short: u64) -> u64 {
    std::env::var("BRICKMARCH_CRASH_STATES")
        .ok()
        .and_then(|v| v.parse().ok())
        .unwrap_or(short)
}

/// Tries about `wanted` states on `threads` threads: `(all, after a second crash, in flight)`.
fn campaign(seed: u64, wanted: u64, threads: u64) -> Result<[u64; 3], String> {
    let same: View<'_> = &|s| s;
    let (tried, second, flight) = (AtomicU64::new(0), AtomicU64::new(0), AtomicU64::new(0));
    let failure = std::sync::Mutex::new(None);
    std::thread::scope(|scope| {
        for thread in 0..threads {
            let (tried, second, flight, failure) = (&tried, &second, &flight, &failure);
            scope.spawn(move || {
                let mut round = thread;
                while tried.load(Ordering::Relaxed) < wanted
                    && failure.lock().expect("no panic").is_none()
                {
                    let seed = seed.wrapping_add(round.wrapping_mul(0x9e37_79b9));
                    let mut worker = Worker::new(seed, same);
                    if let Err(e) = one_round(&mut worker, seed) {
                        *failure.lock().expect("no panic") = Some(format!("seed {seed:#x}: {e}"));
                    }
                    tried.fetch_add(worker.tried, Ordering::Relaxed);
                    second.fetch_add(worker.second, Ordering::Relaxed);
                    flight.fetch_add(worker.in_flight, Ordering::Relaxed);
                    round += threads;
                }
            });
        }
    });
    match failure.into_inner().expect("no panic") {
        Some(e) => Err(e),
        None => Ok([tried, second, flight].map(AtomicU64::into_inner)),
    }
}

fn one_round(worker: &mut Worker<'_>, seed: u64) -> Result<(), String> {
    let script = Script {
        commits: 4,
        bricks: 0,
        is_import: seed.is_multiple_of(3),
        reopens: true,
    };
    let run = record(seed, script, &|disk| disk, &|s| s).map_err(|e| e.to_string())?;
    for point in &run.points {
        worker.point(point, &run.states, 128)?;
        worker.at_rest(point, &run.states)?;
        worker.again(point, &run, 24)?;
    }
    Ok(())
}

/// `BRICKMARCH_CRASH_STATES` sets the number of states, `BRICKMARCH_SEED` the seed.
#[test]
fn no_crash_loses_or_mixes_a_commit() {
    let seed = std::env::var("BRICKMARCH_SEED").ok();
    let seed = seed.and_then(|s| s.parse().ok()).unwrap_or(0x5eed);
    let wanted = rounds(if cfg!(debug_assertions) {
        20_000
    } else {
        1_000_000
    });
    let begin = Instant::now();
    let [all, second, flight] =
        campaign(seed, wanted, 2).unwrap_or_else(|e| panic!("crash model, {e}"));
    let seconds = begin.elapsed().as_secs_f64();
    figure(&format!(
        "crash model: {all} states ({second} after a second crash, {flight} showed the commit in flight) in {seconds:.1} s, {:.0} a second",
        all as f64 / seconds
    ));
    assert!(all >= wanted && second > all / 10 && flight > 0 && flight < all);
}

/// Looks for a state that shows the mistake; says how it showed.
fn caught(mistake: Mistake, seed: u64) -> Option<(u64, String)> {
    let script = Script {
        commits: 4,
        bricks: if mistake == Mistake::ReusedSpace {
            8
        } else {
            0
        },
        ..Script::default()
    };
    let writer = std::sync::OnceLock::new();
    let make = |disk: Arc<Disk>| -> Arc<dyn Storage> {
        let broken: &Arc<Broken> = writer.get_or_init(|| Arc::new(Broken::writer(disk, mistake)));
        broken.clone()
    };
    let recorded = record(seed, script, &make, &|s| s);
    let run = match recorded {
        Ok(run) => run,
        Err(e) => return Some((0, format!("the writer itself: {e}"))),
    };
    let map = writer
        .get()
        .map(|w: &Arc<Broken>| w.map())
        .unwrap_or_default();
    let view: View<'_> =
        &|storage| Arc::new(Broken::reader(storage, mistake, map.clone())) as Arc<dyn Storage>;
    let mut worker = Worker::new(seed, view);
    for _ in 0..4 {
        for point in &run.points {
            let mut result = worker.point(point, &run.states, 1000);
            if mistake == Mistake::NoRollForward {
                result = result.and_then(|()| worker.at_rest(point, &run.states));
            }
            if let Err(e) = result {
                return Some((worker.tried, e));
            }
        }
    }
    None
}

#[test]
fn every_mistake_in_the_protocol_is_caught() {
    let mut missed = Vec::new();
    for mistake in Mistake::ALL {
        match caught(mistake, 0xbad) {
            Some((tried, how)) => {
                let how = how.split("; ").next().unwrap_or_default();
                figure(&format!(
                    "crash model, {mistake:?}: caught at state {tried}: {how}"
                ));
            }
            None => missed.push(mistake),
        }
    }
    assert!(missed.is_empty(), "not caught: {missed:?}");
}

/// The storage of the mistakes without a mistake that shows: what it adds is not what is caught.
#[test]
fn the_model_finds_nothing_where_nothing_is_wrong() {
    let script = Script {
        commits: 4,
        ..Script::default()
    };
    let run = record(0xbad, script, &|disk| disk, &|s| s).expect("nothing fails");
    let mut worker = Worker::new(1, &|s| s);
    for point in &run.points {
        worker
            .point(point, &run.states, 200)
            .and_then(|()| worker.at_rest(point, &run.states))
            .unwrap_or_else(|e| panic!("{e}"));
    }
    assert!(matches!(run.points.last(), Some(p) if p.acked == 4));
}

/// The first sync does nothing: that of a writer which opens what a killed one left.
struct OpensUnsynced(Arc<dyn Storage>, AtomicBool);

impl Storage for OpensUnsynced {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        self.0.read_at(buffer, offset)
    }
    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<()> {
        self.0.write_at(bytes, offset)
    }
    fn len(&self) -> io::Result<u64> {
        self.0.len()
    }
    fn set_len(&self, length: u64) -> io::Result<()> {
        self.0.set_len(length)
    }
    fn sync(&self) -> io::Result<()> {
        match self.1.swap(true, Ordering::Relaxed) {
            true => self.0.sync(),
            false => Ok(()),
        }
    }
    fn lock(&self) -> io::Result<bool> {
        self.0.lock()
    }
}

/// A process that is killed leaves what only the kernel has; a writer that takes it for committed
/// without a sync loses it with the power.
#[test]
fn a_writer_that_opens_without_a_sync_is_caught() {
    let how = (0..200).find_map(|seed| {
        let script = Script {
            commits: 4,
            reopens: true,
            ..Script::default()
        };
        let unsynced: View<'_> = &|s| Arc::new(OpensUnsynced(s, AtomicBool::new(false)));
        let run = record(seed, script, &|disk| disk, unsynced).expect("nothing fails");
        let mut worker = Worker::new(seed, &|s| s);
        let mut points = run.points.iter();
        points.find_map(|point| worker.point(point, &run.states, 50).err())
    });
    let how = how.expect("a mistake that is not caught");
    let how = how.split("; ").next().unwrap_or_default();
    figure(&format!("crash model, OpensUnsynced: caught: {how}"));
}
