//! The real program killed at random times, and on a disk that is really full.

use crate::support::program::{brickmarch, start};
use crate::support::report::{figure, skipped};
use crate::support::rng::Rng;
use crate::support::scratch::{Scratch, bytes};
use brickmarch::Budget;
use brickmarch::store::verify;
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
    let kills = kills.and_then(|v| v.parse().ok()).unwrap_or(20u32);
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
