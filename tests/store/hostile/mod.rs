//! Files made to harm: every checksum holds, the content lies. Each gives an error of the right kind
//! that names the file and what is wrong, quickly and within 64 MiB; never a panic.
//!
//! `None` as kind: reading cannot notice it and gives what the file says; `verify` does notice.

mod bricks;
mod counts;
mod index;
mod roots;
mod spoil;

use super::handmade::{Piece, Plan};
use super::image::{Image, LOG, reseal};
use crate::support::program::brickmarch;
use crate::support::report::figure;
use crate::support::scratch::Scratch;
use brickmarch::store::{MemoryStorage, Volume, verify_in};
use brickmarch::{Box3, Budget, Error, ErrorKind, Field};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

const ROOT: Option<ErrorKind> = Some(ErrorKind::DamagedRoot);
const DAMAGED: Option<ErrorKind> = Some(ErrorKind::Damaged);
const NEWER: Option<ErrorKind> = Some(ErrorKind::Newer);
const CUT: Option<ErrorKind> = Some(ErrorKind::Truncated);
const OTHER: Option<ErrorKind> = Some(ErrorKind::NotAVolume);

/// Cases by name, kind of the error, a word of its message and the file; a test for each.
macro_rules! hostile {
    ($($name:ident: $kind:expr, $word:literal, $build:expr;)*) => {
        pub(super) const CASES: &[Case] = &[
            $(Case { name: stringify!($name), kind: $kind, word: $word, build: || $build }),*
        ];
        $(#[test] fn $name() { check(CASES, stringify!($name)); })*
    };
}
use hostile;

/// What must come of a file.
struct Case {
    name: &'static str,
    kind: Option<ErrorKind>,
    word: &'static str,
    build: fn() -> Vec<u8>,
}

/// Everything that a reader is asked; huge domains at both ends.
fn read(bytes: &[u8], budget: &Budget) -> Result<(), Error> {
    let storage = Arc::new(MemoryStorage::new(bytes.to_vec()));
    let volume = Volume::open_in(storage, Path::new("hostile.bvol"), budget)?;
    let domain = volume.spec().grid.domain;
    let size = domain.size().map(|n| n.min(96) as i32);
    let low = Box3::new(domain.min, std::array::from_fn(|a| domain.min[a] + size[a]));
    let high = Box3::new(std::array::from_fn(|a| domain.max[a] - size[a]), domain.max);
    for region in [low, high] {
        let mut raw = vec![0; region.count() as usize * volume.spec().sample.bytes()];
        volume.read_raw(region, &mut raw)?;
        volume.range(region)?;
    }
    volume.range(domain)?;
    volume.info().map(|_| ())
}

/// All of them.
fn cases() -> impl Iterator<Item = &'static Case> {
    let all = [roots::CASES, index::CASES, bricks::CASES];
    all.into_iter().flatten()
}

#[track_caller]
fn check(cases: &[Case], name: &str) {
    let case = cases.iter().find(|c| c.name == name).expect("a case");
    let bytes = (case.build)();
    let budget = Budget::mib(64).with_threads(1);
    let begin = Instant::now();
    let result = read(&bytes, &budget);
    let storage = Arc::new(MemoryStorage::new(bytes));
    let report = verify_in(storage, Path::new("hostile.bvol"), &budget);
    let took = begin.elapsed();
    let message = match (case.kind, result) {
        (Some(kind), Err(error)) => {
            assert_eq!(error.kind(), kind, "{error}");
            let text = error.to_string();
            assert!(text.contains("hostile.bvol"), "names no file: {text}");
            text
        }
        (Some(_), Ok(())) => panic!("was read as if nothing were wrong"),
        (None, Ok(())) => {
            let report = report.as_ref().expect("verify reads it");
            let all: Vec<&str> = report.problems.iter().map(|p| p.message.as_str()).collect();
            all.join("; ")
        }
        (None, Err(error)) => panic!("only verify was expected to notice: {error}"),
    };
    assert!(
        message.contains(case.word),
        "{:?} is not in: {message}",
        case.word
    );
    assert!(!message.contains('\n'), "{message}");
    if let Ok(report) = report {
        assert!(!report.is_intact(), "verify found nothing: {report:?}");
    }
    assert!(took < Duration::from_secs(1), "{took:?}");
    assert!(budget.peak_bytes() <= 64 << 20 && budget.used_bytes() == 0);
}

/// The program on every file: an error in one line or a report, no signal, little memory.
#[test]
fn the_program_survives_every_hostile_file() {
    let scratch = Scratch::new("hostile");
    // The first run may build the program.
    brickmarch(["--version"]).success();
    let (mut peak, mut longest) = (0, Duration::ZERO);
    for case in cases() {
        let path = scratch.write("hostile.bvol", (case.build)());
        let run = brickmarch([
            "verify".as_ref(),
            path.as_os_str(),
            "--mem".as_ref(),
            "24MiB".as_ref(),
        ]);
        assert!(
            matches!(run.code, Some(code) if code != 0 && code != 101),
            "{}: {run:#?}",
            case.name
        );
        // Time on a processor: how long it waits for one says nothing about the file.
        assert!(run.cpu < Duration::from_secs(1), "{}: {run:#?}", case.name);
        assert!(run.peak_bytes <= 64 << 20, "{}: {run:#?}", case.name);
        peak = peak.max(run.peak_bytes);
        longest = longest.max(run.cpu);
    }
    figure(&format!(
        "{} hostile files: each refused, at most {} MiB resident and {} ms on a processor",
        cases().count(),
        peak >> 20,
        longest.as_millis()
    ));
}

#[test]
fn the_handmade_files_are_sound_before_they_are_spoiled() {
    for plan in [Plan::SMALL, Plan::LONG] {
        let bytes = plan.file(&|_| {});
        let mut sealed = bytes.clone();
        reseal(&mut sealed);
        assert!(sealed == bytes, "sealing a sound file changes nothing");
        let volume = super::open(bytes.clone(), &Budget::mib(16)).expect("sound");
        assert!(super::read_all(&volume).expect("sound") == plan.samples());
        assert_eq!(volume.spec().history, "hands");
        let storage = Arc::new(MemoryStorage::new(bytes));
        let report = verify_in(storage, Path::new("sound.bvol"), &Budget::mib(16));
        let report = report.expect("sound");
        assert!(report.is_intact() && report.notes.is_empty(), "{report:?}");
    }
}

/// What is wrong about a history costs no samples; it must not cost memory either.
#[test]
fn a_history_that_lies_is_left_out() {
    for (at, value) in [(4, u64::MAX), (4, 6), (4, 1 << 40), (0, 9)] {
        let bytes = Plan::SMALL.file(&|piece| {
            if let Piece::History(record) = piece {
                record.payload[at..at + 4].copy_from_slice(&value.to_le_bytes()[..4]);
            }
        });
        let budget = Budget::mib(16);
        let volume = super::open(bytes, &budget).expect("samples are sound");
        assert_eq!(volume.spec().history, "");
        super::read_all(&volume).expect("samples are sound");
    }
}

#[test]
fn there_are_enough_hostile_files() {
    let count = cases().count();
    assert!(count >= 60, "{count}");
    let mut files: Vec<Vec<u8>> = cases().map(|c| (c.build)()).collect();
    files.sort();
    files.dedup();
    assert!(files.len() >= count - 2, "cases repeat each other");
    assert_eq!(Image::new([0; 16]).bytes.len(), LOG + 4136);
}
