//! Processes beside each other on one file: readers while a writer commits, and writers killed at
//! random times. The other processes are this test program, started for one of the ignored tests.

use crate::support::report::{figure, skipped};
use crate::support::rng::Rng;
use crate::support::scratch::Scratch;
use brickmarch::store::{Volume, VolumeSpec, VolumeWriter, verify};
use brickmarch::{Box3, Budget, Grid, SampleType};
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

const EDGE: usize = 8;
/// Bricks per axis.
const SIDE: usize = 4;
const SIZE: usize = EDGE * SIDE;
const DOMAIN: Box3 = Box3::from_size([SIZE as i32; 3]);
/// Names the file to a process that is started.
const FILE: &str = "BRICKMARCH_TEST_FILE";

/// What the file holds: of each brick the generation that wrote it last.
struct Content {
    generation: u64,
    bricks: [u64; SIDE * SIDE * SIDE],
}

impl Content {
    fn new() -> Self {
        Self {
            generation: 0,
            bricks: [0; SIDE * SIDE * SIDE],
        }
    }

    /// Bricks that the next generation changes: all at first, then some.
    fn advance(&mut self) -> Vec<usize> {
        self.generation += 1;
        let mut rng = Rng::new(self.generation);
        let all = self.bricks.len();
        let changed: BTreeSet<usize> = match self.generation {
            1 => (0..all).collect(),
            _ => (0..=rng.below(12))
                .map(|_| rng.below(all as u64) as usize)
                .collect(),
        };
        for &brick in &changed {
            self.bricks[brick] = self.generation;
        }
        changed.into_iter().collect()
    }

    /// Goes on to `generation`, or begins again.
    fn go_to(&mut self, generation: u64) {
        if generation < self.generation {
            *self = Self::new();
        }
        while self.generation < generation {
            self.advance();
        }
    }

    /// All samples.
    fn samples(&self) -> Vec<u8> {
        let mut samples = vec![0; SIZE.pow(3)];
        for (n, &generation) in self.bricks.iter().enumerate() {
            let at = place(n).map(|p| p as usize * EDGE);
            let raw = brick(n, generation);
            for k in 0..EDGE {
                for j in 0..EDGE {
                    let to = at[0] + SIZE * (at[1] + j + SIZE * (at[2] + k));
                    samples[to..to + EDGE].copy_from_slice(&raw[EDGE * (j + EDGE * k)..][..EDGE]);
                }
            }
        }
        samples
    }
}

fn place(brick: usize) -> [u32; 3] {
    [brick % SIDE, brick / SIDE % SIDE, brick / SIDE / SIDE].map(|p| p as u32)
}

fn brick(n: usize, generation: u64) -> Vec<u8> {
    let mut rng = Rng::new(generation.wrapping_mul(977).wrapping_add(n as u64));
    let (base, noise) = (rng.next() as u8, rng.below(3) as u8);
    (0..EDGE.pow(3))
        .map(|at| {
            base.wrapping_add((at % 7) as u8 * noise)
                .wrapping_add(rng.next() as u8 & noise)
        })
        .collect()
}

fn commit_next(writer: &VolumeWriter, content: &mut Content) -> u64 {
    for n in content.advance() {
        let raw = brick(n, content.generation);
        writer.put_brick(place(n), &raw).expect("puts");
    }
    let generation = writer.commit().expect("commits");
    assert_eq!(generation, content.generation);
    generation
}

fn create(path: &Path) {
    let spec = VolumeSpec {
        brick_edge: EDGE as u32,
        ..VolumeSpec::new(Grid::new(DOMAIN), SampleType::U8)
    };
    let writer = VolumeWriter::create(path, &spec, &Budget::mib(8)).expect("starts");
    commit_next(&writer, &mut Content::new());
    writer.finish().expect("finishes");
}

/// Another process of this program. It is killed and waited for when a test drops it, however the test
/// ends.
struct Process {
    child: Child,
    test: &'static str,
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Process {
    /// # Panics
    /// When the process has ended.
    #[track_caller]
    fn assert_runs(&mut self) {
        let status = self.child.try_wait().expect("the child is ours");
        if let Some(status) = status {
            panic!("{} ended too early, {status}: it says why above", self.test);
        }
    }

    /// Ends its standard input, which tells it to stop, and gives what it said.
    fn stop(mut self) -> String {
        drop(self.child.stdin.take());
        let mut text = String::new();
        let mut out = self.child.stdout.take().expect("piped");
        out.read_to_string(&mut text).expect("the child talks");
        let status = self.child.wait().expect("waits");
        assert!(status.success(), "{} fails, {status}:\n{text}", self.test);
        text
    }
}

/// Starts this program for one of the ignored tests of this file.
fn spawn(test: &'static str, file: &Path) -> Process {
    let program = std::env::current_exe().expect("a running program has a path");
    let name = format!("store::beside::{test}");
    let child = Command::new(program)
        .args([
            "--exact",
            &name,
            "--ignored",
            "--nocapture",
            "--test-threads",
            "1",
        ])
        .env(FILE, file)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::inherit())
        .spawn()
        .expect("this program can be started again");
    Process { child, test }
}

fn file_of_child() -> Option<PathBuf> {
    let file = std::env::var_os(FILE).map(PathBuf::from);
    if file.is_none() {
        skipped("a process for the tests of store::beside: only they start it");
    }
    file
}

fn number(name: &str, short: u64) -> u64 {
    std::env::var(name)
        .ok()
        .and_then(|v| v.parse().ok())
        .unwrap_or(short)
}

fn say(line: &str) {
    let mut out = std::io::stdout().lock();
    out.write_all(format!("{line}\n").as_bytes())
        .expect("the parent listens");
    out.flush().expect("the parent listens");
}

/// Compares the generation that the volume shows with what it must hold.
fn check(volume: &Volume, content: &mut Content, out: &mut [u8]) {
    volume.read_raw(DOMAIN, out).expect("reads");
    content.go_to(volume.generation());
    assert!(
        out == content.samples(),
        "generation {} shows other samples",
        volume.generation()
    );
}

/// Four readers until standard input ends: when the parent says so, and when there is no parent.
#[test]
#[ignore = "a process that another test starts"]
fn reader_process() {
    let Some(file) = file_of_child() else { return };
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for thread in 0..4u64 {
            let (file, stop) = (&file, &stop);
            scope.spawn(move || {
                let budget = Budget::mib(8);
                let mut rng = Rng::new(thread);
                let mut out = vec![0; SIZE.pow(3)];
                let mut content = Content::new();
                let mut volume = Volume::open(file, &budget).expect("opens");
                let (mut snapshots, mut generations) = (0u64, 1u64);
                while !stop.load(Ordering::Acquire) {
                    let before = volume.generation();
                    let is_newer = volume.refresh().expect("refreshes");
                    assert_eq!(is_newer, volume.generation() > before);
                    generations += u64::from(is_newer);
                    check(&volume, &mut content, &mut out);
                    snapshots += 1;
                    if rng.chance(16) {
                        // A snapshot stays what it is while the writer goes on.
                        std::thread::sleep(Duration::from_millis(rng.below(20)));
                        check(&volume, &mut content, &mut out);
                        volume = Volume::open(file, &budget).expect("opens");
                        generations += u64::from(volume.generation() > content.generation);
                        check(&volume, &mut content, &mut out);
                        snapshots += 2;
                    }
                }
                say(&format!("READ {snapshots} {generations}"));
            });
        }
        let ended = std::io::stdin().lock().read_to_end(&mut Vec::new());
        stop.store(true, Ordering::Release);
        ended.expect("standard input is a pipe");
    });
}

/// `BRICKMARCH_READER_SECONDS` sets how long.
#[test]
fn eight_readers_in_two_processes_see_whole_commits_of_one_writer() {
    let scratch = Scratch::new("beside");
    let path = scratch.path("v.bvol");
    create(&path);
    let mut children = [(); 2].map(|()| spawn("reader_process", &path));
    let end = Instant::now() + Duration::from_secs(number("BRICKMARCH_READER_SECONDS", 5));
    let writer = VolumeWriter::open(&path, &Budget::mib(8)).expect("opens for changes");
    let mut content = Content::new();
    content.go_to(1);
    while Instant::now() < end {
        commit_next(&writer, &mut content);
        children.iter_mut().for_each(Process::assert_runs);
    }
    let (mut readers, mut snapshots, mut generations) = (0, 0, 0);
    for child in children {
        let text = child.stop();
        for line in text.lines() {
            // The harness of the child may write before on the same line.
            let Some((_, counts)) = line.split_once("READ ") else {
                continue;
            };
            let counts: Vec<u64> = counts
                .split(' ')
                .map(|n| n.parse().expect("a number"))
                .collect();
            readers += 1;
            snapshots += counts[0];
            generations += counts[1];
        }
    }
    let commits = content.generation;
    assert_eq!(readers, 8);
    assert!(generations > 8 && snapshots >= generations && commits > 1);
    let report = verify(&path, &Budget::mib(16)).expect("reads");
    assert!(report.is_intact(), "{report:#?}");
    figure(&format!(
        "one writer of {commits} commits, 8 readers in 2 processes: {snapshots} snapshots of {generations} generations, 0 wrong"
    ));
}

/// Commits one generation after the other, each said once it is acknowledged.
#[test]
#[ignore = "a process that another test starts"]
fn writer_process() {
    let Some(file) = file_of_child() else { return };
    let writer = VolumeWriter::open(&file, &Budget::mib(8)).expect("opens for changes");
    let generation = writer.commit().expect("what is there");
    let mut content = Content::new();
    content.go_to(generation);
    say(&format!("ACK {generation}"));
    loop {
        let generation = commit_next(&writer, &mut content);
        say(&format!("ACK {generation}"));
    }
}

/// `BRICKMARCH_KILLS` sets the number of kills.
#[test]
fn a_killed_writer_keeps_every_acknowledged_commit() {
    let kills = number("BRICKMARCH_KILLS", 25);
    let scratch = Scratch::new("killed");
    let path = scratch.path("v.bvol");
    let budget = Budget::mib(16);
    let mut rng = Rng::new(kills);
    let (mut acknowledged, mut unsaid) = (0, 0);
    let mut out = vec![0; SIZE.pow(3)];
    let mut content = Content::new();
    for kill in 0..kills {
        if kill % 25 == 0 {
            create(&path);
        }
        let before = Volume::open(&path, &budget).expect("opens").generation();
        let mut process = spawn("writer_process", &path);
        let lines = BufReader::new(process.child.stdout.take().expect("piped")).lines();
        let started = AtomicBool::new(false);
        let (started, rng) = (&started, &mut rng);
        // The process moves in: should this thread panic, it ends, and with it what the listener hears.
        let last = std::thread::scope(move |scope| {
            let listener = scope.spawn(move || {
                let mut last = 0;
                for line in lines.map_while(Result::ok) {
                    if let Some((_, n)) = line.split_once("ACK ") {
                        last = n.parse().unwrap_or(last);
                        started.store(true, Ordering::Release);
                    }
                }
                last
            });
            // Some are killed while they start.
            if kill % 8 > 0 {
                while !started.load(Ordering::Acquire) {
                    process.assert_runs();
                    std::thread::sleep(Duration::from_millis(1));
                }
            }
            std::thread::sleep(Duration::from_micros(rng.below(60_000)));
            // It goes on until it is killed.
            process.assert_runs();
            drop(process);
            listener.join().expect("no panic")
        });
        let volume = Volume::open(&path, &budget).expect("opens after a kill");
        let now = volume.generation();
        let known: u64 = before.max(last);
        assert!(
            (known..=known + 1).contains(&now),
            "kill {kill}: generation {now} after {known} was acknowledged"
        );
        check(&volume, &mut content, &mut out);
        let report = verify(&path, &budget).expect("reads");
        assert!(report.is_intact(), "kill {kill}: {report:#?}");
        acknowledged += known - before;
        unsaid += now - known;
    }
    assert!(acknowledged > kills / 2);
    figure(&format!(
        "kill -9 of a writer: {kills} kills, {acknowledged} commits acknowledged, 0 lost, {unsaid} whole though not acknowledged; verify clean each time"
    ));
}
