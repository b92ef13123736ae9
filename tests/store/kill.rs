//! The real program killed at random times, and on a disk that is really full.

use crate::support::program::{brickmarch, start};
use crate::support::report::{figure, skipped};
use crate::support::rng::Rng;
use crate::support::scratch::{Scratch, bytes};
use brickmarch::Budget;
use brickmarch::store::{Volume, partial_path, verify};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

const EDGE: usize = 160;

fn words(line: &[&str], paths: &[&Path]) -> Vec<String> {
    let mut paths = paths.iter();
    line.iter()
        .map(|w| match *w {
            "@" => paths.next().expect("a path").display().to_string(),
            w => w.to_string(),
        })
        .collect()
}

fn raw_file(scratch: &Scratch) -> PathBuf {
    let mut rng = Rng::new(4);
    // Smooth with some noise: work for every codec.
    let samples: Vec<u8> = (0..EDGE.pow(3))
        .map(|n| (n / 7 + n / EDGE) as u8 ^ (rng.next() & 3) as u8)
        .collect();
    scratch.write("source.raw", samples)
}

fn import(raw: &Path, out: &Path) -> Vec<String> {
    let dims = format!("{EDGE},{EDGE},{EDGE}");
    words(
        &["import", "@", "@", "--dims", &dims, "--type", "u8", "-q"],
        &[raw, out],
    )
}

#[track_caller]
fn assert_intact(path: &Path) {
    let report = verify(path, &Budget::mib(16)).expect("it can be read");
    assert!(report.is_intact(), "{report:#?}");
}

/// `BRICKMARCH_KILLS` sets the number of kills.
#[test]
fn a_killed_import_leaves_a_whole_file_or_none() {
    let scratch = Scratch::new("kill");
    let raw = raw_file(&scratch);
    let whole = scratch.path("whole.bvol");
    let begin = Instant::now();
    brickmarch(import(&raw, &whole)).success();
    let usual = begin.elapsed();
    let want = bytes(&whole);

    let kills = std::env::var("BRICKMARCH_KILLS").ok();
    let kills = kills.and_then(|v| v.parse().ok()).unwrap_or(25u32);
    let mut rng = Rng::new(9);
    let (mut done, mut none) = (0, 0);
    for kill in 0..kills {
        let dir = scratch.path(&format!("kill-{kill}"));
        std::fs::create_dir(&dir).expect("scratch is writable");
        let out = dir.join("out.bvol");
        let mut child = start(import(&raw, &out));
        let wait = usual.as_micros() as u64 * rng.below(1100) / 1000;
        std::thread::sleep(Duration::from_micros(wait));
        child.kill().expect("the child is ours");
        let status = child.wait().expect("waiting for a child works");
        if out.exists() {
            assert!(
                bytes(&out) == want,
                "kill {kill}: a partial file under the final name"
            );
            assert_intact(&out);
            done += 1;
        } else {
            assert!(!status.success(), "kill {kill}: success, and no file");
            none += 1;
        }
        // What is left over does not disturb the next try.
        brickmarch(import(&raw, &out).into_iter().chain(["--overwrite".into()])).success();
        assert!(bytes(&out) == want, "kill {kill}: the next import differs");
        std::fs::remove_dir_all(&dir).expect("scratch is writable");
    }
    figure(&format!(
        "kill -9 of an import: {kills} kills, {none} left nothing under the final name, {done} a whole file; 0 partial, 0 wrong"
    ));
}

/// Writes a source of three commits (each 256 MiB of samples), most of it holes; gives its `--dims`.
fn long_raw(scratch: &Scratch) -> (PathBuf, String) {
    let size = [640u64, 640, 1400];
    let raw = scratch.path("long.raw");
    let mut file = std::fs::File::create(&raw).expect("scratch is writable");
    file.set_len(size.iter().product())
        .expect("a file with holes");
    let mut rng = Rng::new(6);
    for part in 0..40 {
        let noise: Vec<u8> = (0..20_000).map(|_| rng.next() as u8 | 1).collect();
        file.seek(SeekFrom::Start(part * 14_000_000))
            .expect("seeks");
        file.write_all(&noise).expect("scratch is writable");
    }
    (raw, size.map(|n| n.to_string()).join(","))
}

/// `BRICKMARCH_KILLS` sets the number of kills, a tenth of which are of this kind.
#[test]
fn a_killed_import_is_resumed_to_the_same_file() {
    let scratch = Scratch::new("resume");
    let (raw, dims) = long_raw(&scratch);
    let line = |out: &Path| {
        let line = [
            "import", "@", "@", "--dims", &dims, "--type", "u8", "-q", "--resume",
        ];
        words(&line, &[&raw, out])
    };
    let whole = scratch.path("whole.bvol");
    let begin = Instant::now();
    brickmarch(line(&whole)).success();
    let usual = begin.elapsed();
    let want = bytes(&whole);
    let kills = std::env::var("BRICKMARCH_KILLS").ok();
    let kills = kills
        .and_then(|v| v.parse().ok())
        .unwrap_or(25u32)
        .div_ceil(10);
    let mut rng = Rng::new(10);
    let out = scratch.path("out.bvol");
    let partial = partial_path(&out);
    let (mut kept, mut resumed, mut finished) = (0, 0, 0);
    let mut finish = |rename: bool| {
        if rename {
            brickmarch(line(&out)).success();
        }
        assert!(bytes(&out) == want, "a resumed import made another file");
        assert_intact(&out);
        std::fs::remove_file(&out).expect("removes");
        assert!(!partial.exists());
        finished += 1;
    };
    for kill in 0..kills {
        let mut child = start(line(&out));
        // Every other one as soon as there is a commit to go on from.
        while kill % 2 == 0
            && Volume::open(&partial, &Budget::mib(16)).is_err()
            && child.try_wait().expect("the child is ours").is_none()
        {
            std::thread::sleep(Duration::from_millis(2));
        }
        let most = if kill % 2 == 0 { 300 } else { 1000 };
        let wait = usual.as_micros() as u64 * rng.below(most) / 1000;
        std::thread::sleep(Duration::from_micros(wait));
        child.kill().expect("the child is ours");
        child.wait().expect("waiting for a child works");
        if out.exists() {
            finish(false);
            kept = 0;
            continue;
        }
        let slabs = match Volume::open(&partial, &Budget::mib(16)) {
            Ok(volume) => {
                assert_intact(&partial);
                // A whole volume that was not renamed has all of them.
                let info = volume.info().expect("info");
                info.unfinished_slabs.unwrap_or(u32::MAX)
            }
            Err(_) => 0,
        };
        assert!(
            slabs >= kept,
            "kill {kill}: {slabs} slabs where {kept} were committed"
        );
        resumed += u32::from(slabs > 0);
        kept = slabs;
        if kill % 4 == 3 {
            finish(true);
            kept = 0;
        }
    }
    finish(true);
    assert!(resumed > 0, "no import was ever resumed");
    figure(&format!(
        "kill -9 of a long import: {kills} kills, {resumed} left commits to resume, {finished} times finished to the same file"
    ));
}

struct Mounted(PathBuf);

impl Drop for Mounted {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

#[test]
fn a_disk_that_is_really_full() {
    let scratch = Scratch::new("full");
    let disk = scratch.path("disk");
    std::fs::create_dir(&disk).expect("scratch is writable");
    let mount = Command::new("mount")
        .args(["-t", "tmpfs", "-o", "size=1m", "tmpfs"])
        .arg(&disk)
        .output();
    if !mount.is_ok_and(|o| o.status.success()) {
        skipped("a full disk: a tmpfs cannot be mounted here (needs root)");
        return;
    }
    let mounted = Mounted(disk);
    let mut rng = Rng::new(5);
    let noise: Vec<u8> = (0..128 * 128 * 128).map(|_| rng.next() as u8).collect();
    let raw = scratch.write("noise.raw", noise);
    let out = mounted.0.join("out.bvol");
    let line = [
        "import",
        "@",
        "@",
        "--dims",
        "128,128,128",
        "--type",
        "u8",
        "-q",
    ];
    let run = brickmarch(words(&line, &[&raw, &out]));
    assert_eq!(run.code, Some(1), "{run:#?}");
    assert_eq!(run.stderr.trim_end().lines().count(), 1, "{run:#?}");
    assert!(run.stderr.contains("out.bvol"), "{run:#?}");
    let left: Vec<_> = std::fs::read_dir(&mounted.0)
        .expect("readable")
        .map(|e| e.expect("readable").path())
        .collect();
    assert!(left.is_empty(), "left behind: {left:?}");
    // The same disk takes what fits.
    let small = scratch.write("small.raw", vec![7; 32 * 32 * 32]);
    let line = [
        "import", "@", "@", "--dims", "32,32,32", "--type", "u8", "-q",
    ];
    brickmarch(words(&line, &[&small, &out])).success();
    assert_intact(&out);
    figure("full disk: import to a tmpfs of 1 MiB: one error, nothing left behind");
}
