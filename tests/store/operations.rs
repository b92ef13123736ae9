//! Sequences of operations on a volume file against plain arrays: puts, commits, writers that come and
//! go, further volumes, levels of detail, compaction, readers of older states, unfinished tails.
//!
//! The same text drives `tests/fuzz` (target `operations`) and a property test here: eight bytes are
//! one operation.

use brickmarch::store::{MemoryStorage, Volume, VolumeSpec, VolumeWriter, compact_in, verify_in};
use brickmarch::{Box3, Budget, Field, Grid, Kind, Range, SampleType};
use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;

const EDGE: usize = 8;
const NAME: &str = "operated";
/// Operations looked at: each commit is checked whole, so that long sequences only cost time.
const MOST: usize = 48;

/// A volume as it must be.
#[derive(Clone)]
struct Model {
    spec: VolumeSpec,
    raw: Vec<u8>,
}

impl Model {
    fn new(spec: VolumeSpec) -> Self {
        let width = spec.sample.bytes();
        let mut value = [0; 4];
        spec.sample.put(spec.background, &mut value);
        let count = spec.grid.domain.count() as usize;
        let raw = value[..width].repeat(count);
        Self { spec, raw }
    }

    /// Sets the part of a brick that lies in the domain.
    fn set(&mut self, brick: [u32; 3], raw: impl Fn(usize) -> [u8; 4]) {
        let domain = self.spec.grid.domain;
        let width = self.spec.sample.bytes();
        for n in 0..EDGE.pow(3) {
            let at = [n % EDGE, n / EDGE % EDGE, n / EDGE / EDGE];
            let p: [i64; 3] = std::array::from_fn(|a| {
                i64::from(domain.min[a]) + (brick[a] as usize * EDGE + at[a]) as i64
            });
            if (0..3).all(|a| p[a] < i64::from(domain.max[a])) {
                let at = domain.offset_of(p.map(|v| v as i32)) * width;
                self.raw[at..at + width].copy_from_slice(&raw(n)[..width]);
            }
        }
    }

    /// The next coarser level, as section 7 of the format says.
    fn coarser(&self) -> Model {
        let (sample, width) = (self.spec.sample, self.spec.sample.bytes());
        let fine = self.spec.grid.domain;
        let mut coarse = Model::new(self.spec.coarser());
        let size = coarse.spec.grid.domain.size();
        let mut at = 0;
        for k in 0..size[2] {
            for j in 0..size[1] {
                for i in 0..size[0] {
                    let p: [i32; 3] =
                        std::array::from_fn(|a| fine.min[a] + 2 * [i, j, k][a] as i32);
                    // Not beyond 32 bits: the domain may end there.
                    let end = std::array::from_fn(|a| p[a].saturating_add(2).min(fine.max[a]));
                    let value = self.reduced(Box3::new(p, end));
                    coarse.raw[at..at + width].copy_from_slice(&value[..width]);
                    at += width;
                }
            }
        }
        debug_assert_eq!(sample, coarse.spec.sample);
        coarse
    }

    fn reduced(&self, cell: Box3) -> [u8; 4] {
        let (sample, width) = (self.spec.sample, self.spec.sample.bytes());
        let mut values = Vec::new();
        for k in cell.min[2]..cell.max[2] {
            for j in cell.min[1]..cell.max[1] {
                for i in cell.min[0]..cell.max[0] {
                    let at = self.spec.grid.domain.offset_of([i, j, k]) * width;
                    values.push(sample.get(&self.raw[at..]));
                }
            }
        }
        let mut out = [0; 4];
        if sample == SampleType::Bit || self.spec.kind != Kind::Density {
            let count = |v: &f64| values.iter().filter(|w| *w == v).count();
            let most = values.iter().map(count).max().expect("a sample");
            let best = values.iter().filter(|v| count(v) == most);
            sample.put(best.copied().fold(f64::INFINITY, f64::min), &mut out);
            return out;
        }
        let mut sum = values[0];
        for value in &values[1..] {
            sum += value;
        }
        let mean = sum / values.len() as f64;
        match sample {
            SampleType::F32 if mean.is_nan() => 0x7fc0_0000u32.to_le_bytes(),
            SampleType::F32 => (mean as f32).to_le_bytes(),
            _ => {
                sample.put(mean.round_ties_even(), &mut out);
                out
            }
        }
    }

    fn check(&self, volume: &Volume) {
        let domain = self.spec.grid.domain;
        assert_eq!(volume.spec().grid, self.spec.grid);
        let mut out = vec![0; self.raw.len()];
        volume.read_raw(domain, &mut out).expect("reads");
        assert!(out == self.raw, "other samples in {}", self.spec.name);
        let mut values = vec![0.0; domain.count() as usize];
        self.spec.sample.to_f32(&self.raw, &mut values);
        let truth = Range::of_slice(&values);
        let said = volume.range(domain).expect("range");
        assert_eq!(truth.union(said), said, "the range is too narrow");
    }
}

/// A reader of the first volume, and what it opened.
struct Reader {
    volume: Volume,
    model: Model,
    file: Arc<MemoryStorage>,
}

/// The file, its writer, and what must come of it.
struct World {
    budget: Budget,
    storage: Arc<MemoryStorage>,
    writer: Option<VolumeWriter>,
    /// With what was put since the last commit.
    now: Vec<Model>,
    committed: Vec<Model>,
    generation: u64,
    /// What each generation since the last compaction was.
    past: Vec<(u64, Vec<Model>)>,
    readers: Vec<Reader>,
    /// Files that were compacted, and their first volume.
    retired: Vec<(Arc<MemoryStorage>, Model)>,
    /// A new file takes each brick once between commits.
    is_new: bool,
    taken: HashSet<(usize, [u32; 3])>,
}

impl World {
    fn writer(&mut self) -> &mut VolumeWriter {
        self.writer.as_mut().expect("there is always one")
    }

    /// The number of a volume in the file: levels of detail have numbers too.
    fn number(&mut self, volume: usize) -> usize {
        let name = self.now[volume].spec.name.clone();
        let number = self.writer().specs().position(|s| s.name == name);
        number.expect("the writer knows its volumes")
    }

    fn commit(&mut self) {
        let generation = self.writer().commit().expect("memory does not fail");
        self.note(generation);
    }

    /// After a commit.
    fn note(&mut self, generation: u64) {
        assert!(generation >= self.generation);
        let is_newer = generation > self.generation;
        self.generation = generation;
        self.committed.clone_from(&self.now);
        self.taken.clear();
        if is_newer {
            self.past.push((generation, self.committed.clone()));
            self.check();
        }
    }

    fn open(&self, name: &str) -> Volume {
        let storage = self.storage.clone();
        let volume = Volume::open_named_in(storage, Path::new(NAME), name, &self.budget);
        volume.expect("a committed volume")
    }

    fn check(&self) {
        for model in &self.committed {
            let volume = self.open(&model.spec.name);
            assert_eq!(volume.generation(), self.generation);
            assert_eq!(volume.names().len(), self.committed.len());
            model.check(&volume);
            let mut level = model.clone();
            for n in 1..=volume.levels() {
                level = level.coarser();
                level.check(&volume.level(n).expect("a level that fits"));
            }
        }
        let report = verify_in(self.storage.clone(), Path::new(NAME), &self.budget);
        let report = report.expect("verifies");
        assert!(report.is_intact(), "{:?}", report.problems);
    }

    fn reopen(&mut self) {
        self.writer = None;
        let storage = self.storage.clone();
        let writer = VolumeWriter::open_in(storage, Path::new(NAME), &self.budget);
        self.writer = Some(writer.expect("a committed file opens"));
        self.now.clone_from(&self.committed);
        self.is_new = false;
        self.taken.clear();
    }

    fn brick(&mut self, op: &[u8; 8]) {
        let volume = usize::from(op[4]) % self.now.len();
        let brick = [op[1] % 12, op[2] % 4, op[3] % 4].map(u32::from);
        let pattern = [op[5], op[6], op[7], op[4]];
        let (sample, width) = (
            self.now[volume].spec.sample,
            self.now[volume].spec.sample.bytes(),
        );
        let how = op[0] / 16 % 4;
        let raw = |n: usize| -> [u8; 4] {
            let mut bytes = pattern;
            match how {
                1 => bytes[0] = bytes[0].wrapping_add((n % EDGE) as u8),
                2 => bytes = (u32::from_le_bytes(pattern).wrapping_mul(n as u32 | 1)).to_le_bytes(),
                3 => bytes[0] ^= u8::from(n.is_multiple_of(7)),
                _ => {}
            }
            match sample {
                SampleType::Bit => [bytes[0] & 1, 0, 0, 0],
                _ => bytes,
            }
        };
        let whole: Vec<u8> = (0..EDGE.pow(3))
            .flat_map(|n| raw(n)[..width].to_vec())
            .collect();
        let bricks = self.now[volume].spec.bricks();
        let inside = (0..3).all(|a| brick[a] < bricks[a]);
        if inside && self.is_new && !self.taken.insert((volume, brick)) {
            return;
        }
        let number = self.number(volume);
        let done = self.writer().put_brick_in(number, brick, &whole);
        assert_eq!(done.is_ok(), inside);
        if inside {
            self.now[volume].set(brick, raw);
        }
    }

    fn constant(&mut self, op: &[u8; 8]) {
        let volume = usize::from(op[4]) % self.now.len();
        let brick = [op[1] % 12, op[2] % 4, op[3] % 4].map(u32::from);
        let level = op[0] / 16 % 5;
        let sample = self.now[volume].spec.sample;
        let mut bytes = [op[5], op[6], op[7], op[4]];
        if sample == SampleType::Bit {
            bytes[0] &= 1;
        }
        bytes[sample.bytes()..].fill(0);
        let value = sample.get(&bytes);
        let cube = 1u32 << level;
        let bricks = self.now[volume].spec.bricks();
        let covered: Vec<[u32; 3]> = (0..cube.pow(3))
            .map(|n| [n % cube, n / cube % cube, n / cube / cube])
            .map(|at| std::array::from_fn(|a| brick[a] + at[a]))
            .filter(|b: &[u32; 3]| (0..3).all(|a| b[a] < bricks[a]))
            .collect();
        // A second value for the same brick of a new file is the caller's error and ends the volume.
        if self.is_new && covered.iter().any(|&b| self.taken.contains(&(volume, b))) {
            return;
        }
        let number = self.number(volume);
        let done = self.writer().put_constant_in(number, brick, level, value);
        if done.is_err() {
            return;
        }
        // The value as the type stores it: a NaN may change its bits.
        let mut stored = [0; 4];
        sample.put(value, &mut stored);
        for b in covered {
            self.taken.insert((volume, b));
            self.now[volume].set(b, |_| stored);
        }
    }

    fn add_volume(&mut self, op: &[u8; 8]) {
        if self.now.len() == 4 {
            return;
        }
        let spec = spec_of(op, self.now.len());
        let number = self.writer().add_volume(&spec).expect("a good spec");
        self.now.push(Model::new(spec));
        assert_eq!(self.number(self.now.len() - 1), number);
    }

    fn levels(&mut self, op: &[u8; 8]) {
        let wanted = 1 + op[1] % 3;
        self.writer().build_levels(wanted).expect("builds");
        // A commit for each level, and one before.
        let generation = self.writer().commit().expect("nothing to do");
        let is_newer = generation > self.generation;
        self.generation = generation;
        self.committed.clone_from(&self.now);
        self.taken.clear();
        if is_newer {
            self.past.push((generation, self.committed.clone()));
        }
        let mut spec = self.now[0].spec.clone();
        let mut possible = 0;
        while possible < wanted && spec.bricks() != [1; 3] {
            (spec, possible) = (spec.coarser(), possible + 1);
        }
        let volume = self.open(&self.now[0].spec.name);
        assert!(volume.levels() >= possible, "levels were not built");
        // A level is built, never written: it would no longer be what its samples give.
        let name = self.now[0].spec.name.clone();
        let numbers: Vec<usize> = (0..)
            .zip(self.writer().specs())
            .filter(|(_, s)| s.name == name)
            .map(|(n, _)| n)
            .collect();
        let brick = vec![0; EDGE.pow(3) * self.now[0].spec.sample.bytes()];
        for &level in &numbers[1..] {
            assert!(self.writer().put_brick_in(level, [0; 3], &brick).is_err());
            assert!(
                self.writer()
                    .put_constant_in(level, [0; 3], 0, 0.0)
                    .is_err()
            );
        }
        self.check();
    }

    fn compact(&mut self) {
        self.commit();
        self.writer = None;
        let target = Arc::new(MemoryStorage::default());
        let name = Path::new(NAME);
        let info = compact_in(self.storage.clone(), target.clone(), name, &self.budget);
        let info = info.expect("a sound file");
        assert!(info.sealed && info.bytes_dead == 0, "{info:?}");
        let old = std::mem::replace(&mut self.storage, target);
        self.retired.push((old, self.committed[0].clone()));
        self.generation = info.generation;
        self.past = vec![(info.generation, self.committed.clone())];
        self.check();
        self.reopen();
    }

    fn reader(&mut self, op: &[u8; 8]) {
        if self.generation == 0 {
            return;
        }
        let name = self.committed[0].spec.name.clone();
        match op[1] % 4 {
            0 if self.readers.len() < 3 => {
                self.readers.push(Reader {
                    volume: self.open(&name),
                    model: self.committed[0].clone(),
                    file: self.storage.clone(),
                });
            }
            1 => {
                let Some(reader) = self.readers.last_mut() else {
                    return;
                };
                reader.volume.refresh().expect("the file is sound");
                // A file that was compacted into another stays as it was then.
                reader.model = if Arc::ptr_eq(&reader.file, &self.storage) {
                    assert_eq!(reader.volume.generation(), self.generation);
                    self.committed[0].clone()
                } else {
                    let mut retired = self.retired.iter();
                    let last = retired.find(|(file, _)| Arc::ptr_eq(file, &reader.file));
                    last.expect("every file before").1.clone()
                };
                reader.model.check(&reader.volume);
            }
            2 => {
                let at = usize::from(op[2]) % self.past.len();
                let (generation, models) = &self.past[at];
                let volume = self.open(&name).open_generation(*generation);
                models[0].check(&volume.expect("an older generation"));
            }
            _ => {
                // A writer that died in the middle of a commit.
                self.writer = None;
                let end = brickmarch::store::Storage::len(self.storage.as_ref()).expect("memory");
                let junk: Vec<u8> = op
                    .iter()
                    .cycle()
                    .take(usize::from(op[3]))
                    .copied()
                    .collect();
                brickmarch::store::Storage::write_at(self.storage.as_ref(), &junk, end)
                    .expect("memory");
                self.reopen();
            }
        }
    }

    fn step(&mut self, op: &[u8; 8]) {
        match op[0] % 16 {
            0..=5 => self.brick(op),
            6..=8 => self.constant(op),
            9 => self.commit(),
            10 => {
                self.commit();
                self.reopen();
            }
            // Nothing can be opened before the first commit.
            11 if self.generation > 0 => self.reopen(),
            11 => self.commit(),
            12 => self.add_volume(op),
            13 => self.levels(op),
            14 => self.compact(),
            _ => self.reader(op),
        }
        if op[0] >= 128 {
            for reader in &self.readers {
                reader.model.check(&reader.volume);
            }
        }
    }
}

/// A small volume; more than eight bricks along x make a second level of pages.
fn spec_of(op: &[u8; 8], number: usize) -> VolumeSpec {
    let sample = SampleType::ALL[usize::from(op[1]) % SampleType::ALL.len()];
    let size = [op[2] % 80 + 1, op[3] % 20 + 1, op[4] % 20 + 1].map(i32::from);
    let min = [i32::from(op[5]) - 128, i32::MIN, i32::MAX - 40];
    let domain = Box3::new(min, std::array::from_fn(|a| min[a] + size[a]));
    let mut value = [0; 4];
    sample.put(f64::from(op[6] % 2), &mut value);
    let kind = match sample {
        SampleType::F32 => Kind::Density,
        _ if op[7] % 2 == 1 => Kind::Label,
        _ => Kind::Density,
    };
    VolumeSpec {
        kind,
        brick_edge: EDGE as u32,
        background: sample.get(&value),
        name: format!("v{number}"),
        ..VolumeSpec::new(Grid::new(domain), sample)
    }
}

/// Runs the operations that `data` stands for.
///
/// # Panics
/// When the file is not as it must be.
pub(crate) fn run(data: &[u8]) {
    let (ops, _) = data.as_chunks::<8>();
    let Some((first, ops)) = ops.split_first() else {
        return;
    };
    let budget = Budget::mib(16).with_threads(1);
    let storage = Arc::new(MemoryStorage::default());
    let spec = spec_of(first, 0);
    let writer = VolumeWriter::create_in(storage.clone(), Path::new(NAME), &spec, &budget)
        .expect("a good spec");
    let model = Model::new(spec);
    let mut world = World {
        budget: budget.clone(),
        storage,
        writer: Some(writer),
        now: vec![model.clone()],
        committed: vec![model],
        generation: 0,
        past: Vec::new(),
        readers: Vec::new(),
        retired: Vec::new(),
        is_new: true,
        taken: HashSet::new(),
    };
    for op in ops.iter().take(MOST) {
        world.step(op);
    }
    world.commit();
    world.check();
    drop(world);
    assert_eq!(budget.used_bytes(), 0);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    fn cases() -> ProptestConfig {
        let long = std::env::var("BRICKMARCH_ROUNDS").ok();
        let rounds = long.and_then(|n| n.parse().ok()).unwrap_or(1000);
        ProptestConfig {
            failure_persistence: None,
            ..ProptestConfig::with_cases(rounds)
        }
    }

    proptest! {
        #![proptest_config(cases())]
        #[test]
        fn any_operations_read_as_plain_arrays(
            first in any::<[u8; 8]>(),
            ops in proptest::collection::vec(any::<[u8; 8]>(), 0..40),
        ) {
            super::run(&[&[first][..], &ops].concat().concat());
        }
    }
}
