//! Damaged bytes: an error or exactly the original samples. Never others, never those of an older
//! generation, never a panic.
//!
//! The short form tries a sample of all cases; `BRICKMARCH_DAMAGE=all` every byte of every file set
//! to every other value, `BRICKMARCH_DAMAGE=<number>` so many.

use super::image::{self, LOG};
use super::{View, golden, handmade};
use crate::support::report::figure;
use crate::support::rng::Rng;
use brickmarch::store::{
    MemoryStorage, Storage, Volume, VolumeInfo, VolumeSpec, VolumeWriter, verify_in,
};
use brickmarch::{Box3, Budget, ErrorKind, Field};
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

const THREADS: usize = 2;
const SAMPLED: u64 = 200_000;

/// A sound file and what it must give.
struct Sound {
    name: String,
    bytes: Arc<Vec<u8>>,
    names: Vec<String>,
    /// Each volume and level, the first volume first.
    expected: Vec<Expected>,
    /// Bytes that reading needs: those that the newest root reaches.
    reached: Vec<bool>,
    places: Vec<usize>,
}

/// What a volume or level must give.
struct Expected {
    view: View,
    samples: Vec<u8>,
    spec: VolumeSpec,
    info: VolumeInfo,
    levels: u8,
}

impl Sound {
    fn new(name: String, bytes: Vec<u8>) -> Self {
        let budget = Budget::mib(16);
        let storage: Arc<dyn Storage> = Arc::new(MemoryStorage::new(bytes.clone()));
        let expect = |view: View| {
            let volume = view.open(&storage, &budget).expect("sound");
            Expected {
                samples: super::read_all(&volume).expect("sound"),
                spec: volume.spec().clone(),
                info: volume.info().expect("sound"),
                levels: volume.levels(),
                view,
            }
        };
        let views = super::views(&bytes, &budget).expect("sound");
        let reached = image::reached(&bytes);
        Self {
            name,
            names: super::open(bytes.clone(), &budget)
                .expect("sound")
                .names()
                .to_vec(),
            expected: views.into_iter().map(expect).collect(),
            places: (0..bytes.len()).filter(|&at| reached[at]).collect(),
            reached,
            bytes: Arc::new(bytes),
        }
    }
}

/// Every golden file, and files with older generations.
fn sound() -> Vec<Sound> {
    let golden = golden::files();
    let old = [2, 3].map(|n| {
        let (bytes, samples) = handmade::generations(n);
        let sound = Sound::new(format!("{n}_generations"), bytes);
        assert!(
            sound.expected[0].samples == samples,
            "the newest generation"
        );
        sound
    });
    let golden = golden.into_iter().map(|(name, b)| Sound::new(name, b));
    golden.chain(old).collect()
}

/// One byte of shared bytes looks different. `state` holds offset and value.
struct OneByte {
    base: Arc<Vec<u8>>,
    state: AtomicU64,
}

impl Storage for OneByte {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let start = usize::try_from(offset).map_err(|_| io::ErrorKind::UnexpectedEof)?;
        let end = start.checked_add(buffer.len());
        let source = end.and_then(|end| self.base.get(start..end));
        buffer.copy_from_slice(source.ok_or(io::ErrorKind::UnexpectedEof)?);
        let state = self.state.load(Relaxed);
        if let Some(byte) = ((state >> 8) as usize)
            .checked_sub(start)
            .and_then(|at| buffer.get_mut(at))
        {
            *byte = state as u8;
        }
        Ok(())
    }

    fn len(&self) -> io::Result<u64> {
        Ok(self.base.len() as u64)
    }

    fn write_at(&self, _: &[u8], _: u64) -> io::Result<()> {
        unreachable!("readers do not write")
    }

    fn set_len(&self, _: u64) -> io::Result<()> {
        unreachable!("readers do not write")
    }

    fn sync(&self) -> io::Result<()> {
        unreachable!("readers do not write")
    }

    fn lock(&self) -> io::Result<bool> {
        unreachable!("readers take no locks")
    }
}

/// What came of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Right,
    Refused(ErrorKind),
    /// Other samples, ranges or texts, without an error.
    Silent,
    Panic,
}

/// Opens and reads everything.
fn outcome(
    storage: Arc<dyn Storage>,
    sound: &Sound,
    budget: &Budget,
    out: &mut Vec<u8>,
) -> Outcome {
    let read = || -> brickmarch::Result<bool> {
        let first = Volume::open_in(storage.clone(), Path::new("damaged"), budget)?;
        if first.names() != sound.names || !is_right(&first, &sound.expected[0], out)? {
            return Ok(false);
        }
        for expected in &sound.expected[1..] {
            if !is_right(&expected.view.open(&storage, budget)?, expected, out)? {
                return Ok(false);
            }
        }
        Ok(true)
    };
    match catch_unwind(AssertUnwindSafe(read)) {
        Ok(Ok(true)) => Outcome::Right,
        Ok(Ok(false)) => Outcome::Silent,
        Ok(Err(error)) => Outcome::Refused(error.kind()),
        Err(_) => Outcome::Panic,
    }
}

/// Whether a volume gives all that it must; what is wrong may be an error instead.
fn is_right(volume: &Volume, expected: &Expected, out: &mut Vec<u8>) -> brickmarch::Result<bool> {
    if volume.spec().grid.domain != expected.info.domain
        || volume.spec().sample != expected.info.sample
    {
        return Ok(false);
    }
    let domain = expected.info.domain;
    out.clear();
    out.resize(expected.samples.len(), 0x5a);
    volume.read_raw(domain, out)?;
    let range = volume.range(domain)?;
    let info = volume.info()?;
    let info = VolumeInfo {
        bytes_file: expected.info.bytes_file,
        compression: expected.info.compression,
        // Only the superblock says it, and nothing depends on it.
        sealed: info.sealed || expected.info.sealed,
        ..info
    };
    Ok(*out == expected.samples
        && range.union(info.range) == info.range
        && info == expected.info
        && same_spec(volume.spec(), &expected.spec)
        && volume.levels() == expected.levels)
}

/// NaN as background equals itself.
fn same_spec(one: &VolumeSpec, other: &VolumeSpec) -> bool {
    let bits = |spec: &VolumeSpec| spec.background.to_bits();
    let background = 0.0;
    bits(one) == bits(other)
        && VolumeSpec {
            background,
            ..one.clone()
        } == VolumeSpec {
            background,
            ..other.clone()
        }
}

/// Counts over many cases.
#[derive(Debug, Default)]
struct Tally {
    cases: AtomicU64,
    right: AtomicU64,
}

impl Tally {
    /// Notes an outcome; `allowed` says whether the damage may go without an error.
    fn add(&self, outcome: Outcome, allowed: bool, case: impl FnOnce() -> String) {
        self.cases.fetch_add(1, Relaxed);
        match outcome {
            Outcome::Right => {
                self.right.fetch_add(1, Relaxed);
                assert!(allowed, "{} was not noticed", case());
            }
            Outcome::Refused(kind) => {
                let known = matches!(
                    kind,
                    ErrorKind::Damaged
                        | ErrorKind::DamagedRoot
                        | ErrorKind::Truncated
                        | ErrorKind::NotAVolume
                );
                assert!(known, "{}: {kind:?}", case());
            }
            bad => panic!("{}: {bad:?}", case()),
        }
    }

    fn report(&self, what: &str, since: std::time::Instant) -> u64 {
        let (cases, right) = (self.cases.load(Relaxed), self.right.load(Relaxed));
        let seconds = since.elapsed().as_secs_f64();
        figure(&format!(
            "{what}: {cases} cases ({:.0} a second), {right} read as if nothing had happened, the others refused; 0 silent, 0 older, 0 panics",
            cases as f64 / seconds
        ));
        cases
    }
}

/// Runs `job` for 0..n on a few threads.
fn spread(n: usize, job: impl Fn(usize) + Sync) {
    let next = AtomicU64::new(0);
    std::thread::scope(|scope| {
        for _ in 0..THREADS {
            scope.spawn(|| {
                loop {
                    let i = next.fetch_add(1, Relaxed) as usize;
                    if i >= n {
                        break;
                    }
                    job(i);
                }
            });
        }
    });
}

/// Which (offset, value) to try in a file of `length` bytes.
fn cases(
    sound: &Sound,
    budget: Option<u64>,
    seed: u64,
) -> Box<dyn Iterator<Item = (usize, u8)> + '_> {
    let bytes = &sound.bytes;
    let Some(count) = budget else {
        let all = (0..bytes.len()).flat_map(|at| (1..=255u8).map(move |x| (at, x)));
        return Box::new(all.map(|(at, x)| (at, bytes[at] ^ x)));
    };
    let mut rng = Rng::new(seed);
    Box::new((0..count).map(move |n| {
        // Every other one among the bytes that reading needs.
        let at = if n % 2 == 0 {
            rng.below(bytes.len() as u64) as usize
        } else {
            rng.pick(&sound.places)
        };
        (at, bytes[at] ^ (1 + rng.below(255)) as u8)
    }))
}

/// Bytes whose damage reading repairs or does not need (docs/format.md, section 10): the file header
/// and superblocks, which the log replaces, and what only recovery and verify read: header copy,
/// footers, gaps, what the newest root does not reach.
fn may_go_unnoticed(sound: &Sound, at: usize) -> bool {
    at < LOG || !sound.reached[at]
}

#[test]
#[cfg_attr(debug_assertions, ignore = "release only: many cases")]
fn every_damaged_byte_is_refused_or_harmless() {
    let begin = std::time::Instant::now();
    let all = sound();
    let count = match std::env::var("BRICKMARCH_DAMAGE").as_deref() {
        Ok("all") => None,
        Ok(number) => Some(
            number
                .parse()
                .expect("BRICKMARCH_DAMAGE is `all` or a number"),
        ),
        Err(_) => Some(SAMPLED),
    };
    let tally = Tally::default();
    let budget = Budget::mib(16).with_threads(1);
    spread(all.len(), |n| {
        let sound = &all[n];
        let storage = Arc::new(OneByte {
            base: sound.bytes.clone(),
            state: AtomicU64::new(u64::MAX),
        });
        let mut out = Vec::new();
        let count = count.map(|c: u64| c.div_ceil(all.len() as u64));
        for (at, value) in cases(sound, count, n as u64) {
            storage
                .state
                .store((at as u64) << 8 | u64::from(value), Relaxed);
            let outcome = outcome(storage.clone(), sound, &budget, &mut out);
            tally.add(outcome, may_go_unnoticed(sound, at), || {
                format!("{}: byte {at} set to {value}", sound.name)
            });
        }
        if count.is_none() {
            figure(&format!(
                "{}: each of {} bytes set to every other value",
                sound.name,
                sound.bytes.len()
            ));
        }
    });
    assert!(budget.peak_bytes() <= 16 << 20 && budget.used_bytes() == 0);
    tally.report("damaged bytes", begin);
}

/// A writer that opens a damaged file refuses, or what it commits reads right: its own change and the
/// rest, or an error for what is damaged.
#[test]
#[cfg_attr(debug_assertions, ignore = "release only: many cases")]
fn a_writer_on_a_damaged_file_makes_nothing_worse() {
    let begin = std::time::Instant::now();
    let all = sound();
    let (tally, refused) = (Tally::default(), AtomicU64::new(0));
    let budget = Budget::mib(16).with_threads(1);
    let count = match std::env::var_os("BRICKMARCH_DAMAGE") {
        Some(_) => 100_000,
        None => 1500,
    };
    spread(all.len(), |n| {
        let sound = &all[n];
        let first = &sound.expected[0];
        let mut changed = first.samples.clone();
        let (domain, edge) = (first.info.domain, first.info.brick_edge as i32);
        let width = first.info.sample.bytes();
        let far = std::array::from_fn(|a| domain.min[a] + edge);
        let brick = Box3::new(domain.min, far).intersect(&domain);
        for k in brick.min[2]..brick.max[2] {
            for j in brick.min[1]..brick.max[1] {
                for i in brick.min[0]..brick.max[0] {
                    let at = domain.offset_of([i, j, k]) * width;
                    first.info.sample.put(1.0, &mut changed[at..at + width]);
                }
            }
        }
        let name = Path::new("damaged");
        for (at, value) in cases(sound, Some(count), 900 + n as u64) {
            let mut bytes = sound.bytes.to_vec();
            bytes[at] = value;
            let storage: Arc<dyn Storage> = Arc::new(MemoryStorage::new(bytes));
            let change = || -> brickmarch::Result<bool> {
                let writer = VolumeWriter::open_in(storage.clone(), name, &budget)?;
                writer.put_constant([0; 3], 0, 1.0)?;
                writer.commit().map(|_| true)
            };
            let changes = match catch_unwind(AssertUnwindSafe(change)) {
                Ok(Ok(changes)) => changes,
                Ok(Err(_)) => false,
                Err(_) => panic!("{}: byte {at} set to {value}: panic", sound.name),
            };
            let wanted = |expected: &Expected| -> Vec<u8> {
                let is_changed = changes && expected.view == first.view;
                if is_changed {
                    &changed
                } else {
                    &expected.samples
                }
                .clone()
            };
            let read = || -> brickmarch::Result<bool> {
                for expected in sound.expected.iter().filter(|e| e.view.level == 0) {
                    let volume = expected.view.open(&storage, &budget)?;
                    if super::read_all(&volume)? != wanted(expected) {
                        return Ok(false);
                    }
                }
                Ok(true)
            };
            let outcome = match catch_unwind(AssertUnwindSafe(read)) {
                Ok(Ok(true)) => Outcome::Right,
                Ok(Ok(false)) => Outcome::Silent,
                Ok(Err(error)) => Outcome::Refused(error.kind()),
                Err(_) => Outcome::Panic,
            };
            // A change may go around the damage, or replace what was damaged.
            refused.fetch_add(u64::from(!changes), Relaxed);
            tally.add(outcome, true, || {
                format!("{}: byte {at} set to {value}, then changed", sound.name)
            });
        }
    });
    assert!(budget.used_bytes() == 0);
    figure(&format!(
        "changes of damaged files: {} refused",
        refused.load(Relaxed)
    ));
    tally.report("changes of damaged files", begin);
}

/// What reading does not notice verify does, byte by byte.
#[test]
#[cfg_attr(debug_assertions, ignore = "release only: many cases")]
fn verify_notices_every_byte() {
    let all = sound();
    let budget = Budget::mib(32).with_threads(1);
    spread(all.len(), |n| {
        let sound = &all[n];
        let storage = Arc::new(OneByte {
            base: sound.bytes.clone(),
            state: AtomicU64::new(u64::MAX),
        });
        for at in (0..sound.bytes.len()).filter(|at| n < 2 || at % 7 == n % 7) {
            let value = sound.bytes[at] ^ 1 << (at % 8);
            storage
                .state
                .store((at as u64) << 8 | u64::from(value), Relaxed);
            match verify_in(storage.clone(), Path::new("damaged"), &budget) {
                Ok(report) => assert!(!report.is_intact(), "{}: byte {at}", sound.name),
                Err(error) => panic!("{}: byte {at}: {error}", sound.name),
            }
        }
    });
}

#[test]
#[cfg_attr(debug_assertions, ignore = "release only: many cases")]
fn every_truncation_and_extension() {
    let begin = std::time::Instant::now();
    let all = sound();
    let (cut, longer) = (Tally::default(), Tally::default());
    let budget = Budget::mib(16).with_threads(1);
    let every = std::env::var_os("BRICKMARCH_DAMAGE").is_some();
    spread(all.len(), |n| {
        let sound = &all[n];
        let length = sound.bytes.len();
        let mut out = Vec::new();
        let storage = Arc::new(MemoryStorage::new(sound.bytes.to_vec()));
        // From the longest to the shortest, so that the bytes need no copy.
        for end in (0..length).rev() {
            storage.set_len(end as u64).expect("memory");
            let outcome = outcome(storage.clone(), sound, &budget, &mut out);
            cut.add(outcome, false, || format!("{} cut to {end}", sound.name));
        }
        let mut rng = Rng::new(n as u64);
        for garbage in [false, true] {
            let storage = Arc::new(MemoryStorage::new(sound.bytes.to_vec()));
            for more in (1..=if every { 8200 } else { 600 }).chain([8192, 65536]) {
                let byte = if garbage { rng.next() as u8 } else { 0 };
                let at = (length + more - 1) as u64;
                storage.write_at(&[byte], at).expect("memory");
                let outcome = outcome(storage.clone(), sound, &budget, &mut out);
                assert_eq!(outcome, Outcome::Right, "{} and {more} bytes", sound.name);
                longer.add(outcome, true, String::new);
            }
        }
        // A stale tail: the start of the file's own log once more, a whole commit of the past.
        let mut bytes = sound.bytes.to_vec();
        bytes.extend_from_slice(&sound.bytes[LOG..]);
        let outcome = outcome(
            Arc::new(MemoryStorage::new(bytes)),
            sound,
            &budget,
            &mut out,
        );
        assert_eq!(outcome, Outcome::Right, "{} and its log again", sound.name);
    });
    cut.report("truncations", begin);
    longer.report("extensions", begin);
}

/// Lost, swapped, doubled and stale sectors, and bursts.
#[test]
#[cfg_attr(debug_assertions, ignore = "release only: many cases")]
fn damaged_sectors_and_bursts() {
    let begin = std::time::Instant::now();
    let all = sound();
    let tally = Tally::default();
    let budget = Budget::mib(16).with_threads(1);
    let rounds: u64 = match std::env::var("BRICKMARCH_DAMAGE").as_deref() {
        Ok("all") => 50_000,
        Ok(number) => number.parse::<u64>().expect("a number") / 40,
        Err(_) => 1500,
    };
    spread(all.len(), |n| {
        let sound = &all[n];
        let base = &sound.bytes;
        let length = base.len();
        let mut out = Vec::new();
        let mut rng = Rng::new(77 + n as u64);
        let mut bytes = base.to_vec();
        let mut run = |bytes: &[u8], what: &dyn Fn() -> String| {
            let storage = Arc::new(MemoryStorage::new(bytes.to_vec()));
            let result = outcome(storage, sound, &budget, &mut out);
            tally.add(result, true, || format!("{}: {}", sound.name, what()));
        };
        for size in [512, 4096] {
            for at in (0..length).step_by(size) {
                bytes[at..at + size].fill(0);
                run(&bytes, &|| format!("{size} zeros at {at}"));
                bytes[at..at + size].fill(0xff);
                run(&bytes, &|| format!("{size} ones at {at}"));
                bytes[at..at + size].copy_from_slice(&base[at..at + size]);
                for other in (0..length).step_by(size) {
                    bytes.copy_within(other..other + size, at);
                    run(&bytes, &|| format!("{size} bytes from {other} at {at} too"));
                    bytes[other..other + size].copy_from_slice(&base[at..at + size]);
                    run(&bytes, &|| {
                        format!("{size} bytes at {at} and {other} swapped")
                    });
                    bytes.copy_from_slice(base);
                }
            }
        }
        for round in 0..rounds {
            let most = 1 + rng.below([4, 64, 1024, 16384][round as usize % 4]);
            let from = rng.below(length as u64) as usize;
            let end = (from + 1 + rng.below(most) as usize).min(length);
            bytes[from..end]
                .iter_mut()
                .for_each(|b| *b = rng.next() as u8);
            run(&bytes, &|| format!("noise at {from}..{end}, round {round}"));
            bytes.copy_from_slice(base);
        }
    });
    tally.report("damaged sectors and bursts", begin);
}
