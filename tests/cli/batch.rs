//! `batch`: many tasks in one budget, stopped and gone on with, with failures among them.

use crate::support::data::shared;
use crate::support::fields::{Content, random};
use crate::support::program::{Run, brickmarch, data_gen, start};
use crate::support::report::figure;
use crate::support::rng::Rng;
use crate::support::scratch::{Scratch, f32_bytes};
use brickmarch::Box3;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

fn batch(job: &Path, more: &[&str]) -> Run {
    let job = job.to_string_lossy();
    let words = ["batch", &*job, "--json", "--quiet"];
    brickmarch(words.iter().chain(more))
}

/// A folder with sources and a job of 53 tasks on them: all that a batch does on real scans and on
/// generated fields, one task that fails and two that need what it does not make.
fn job(scratch: &Scratch) -> PathBuf {
    let noise = random(
        Content::Noise,
        Box3::from_size([96, 80, 72]),
        &mut Rng::new(7),
    );
    scratch.write("noise.raw", f32_bytes(&noise));
    let gyroid = scratch.path("gyroid.bvol");
    let gyroid = gyroid.to_string_lossy();
    data_gen(["level-set", "gyroid", "--n", "160", "--out", &*gyroid]).success();
    let real = [
        ("volumes/ct_abdomen_crop128_i16.nrrd", "ct.nrrd"),
        ("volumes/tooth.nhdr", "tooth.nhdr"),
        ("volumes/tooth.raw", "tooth.raw"),
        ("volumes/ch2.nii.gz", "ch2.nii.gz"),
    ];
    for (name, place) in real {
        match shared(name, "a batch on real scans") {
            Some(path) => {
                std::fs::copy(path, scratch.path(place)).expect("copied");
            }
            None if place.ends_with(".raw") => {}
            // Without the scans the tasks are the same on a field of our own.
            None => {
                let words = ["export", &*gyroid];
                let copy = scratch.path("copy.nrrd");
                let copy = copy.to_string_lossy();
                brickmarch(words.iter().copied().chain([&*copy, "--overwrite"])).success();
                std::fs::copy(scratch.path("copy.nrrd"), scratch.path(place)).expect("copied");
            }
        }
    }
    scratch.write(
        "job.toml",
        br#"
out = "out"
retries = 1
[[task]]
op = "import"
input = ["ct.nrrd", "tooth.nhdr", "ch2.nii.gz"]
output = "{stem}.bvol"
levels = 1
[[task]]
op = "import"
input = "noise.raw"
output = "noise.bvol"
dims = "96,80,72"
type = "f32"
[[task]]
title = "cut off"
op = "import"
input = "noise.raw"
output = "cut.bvol"
dims = "96,80,73"
type = "f32"
[[task]]
title = "from nothing"
op = "mesh"
input = "cut.bvol"
output = "cut-{iso}.stl"
iso = [0, 0.5]
[[task]]
op = "mesh"
input = ["ct.bvol", "tooth.bvol", "ch2.bvol"]
output = "{stem}/{iso}-{level}.ply"
iso = [80, 120, 160, 200]
level = [0, 1]
allow-empty = true
[[task]]
op = "mesh"
input = "noise.bvol"
output = "noise-{iso}.ply"
iso = [0, 0.25]
mem = "96MiB"
[[task]]
op = "mesh"
input = "noise.bvol"
output = "tiled-{iso}.ply"
iso = 0.25
tiles = 7
[[task]]
op = "check"
input = "noise-*.ply"
[[task]]
op = "slice"
input = ["gyroid.bvol", "ct.bvol"]
output = "{stem}-{axis}.png"
axis = ["x", "y", "z"]
[[task]]
op = "verify"
input = ["gyroid.bvol", "noise.bvol"]
[[task]]
op = "export"
input = "noise.bvol"
output = "noise.npy"
"#,
    );
    scratch.path("job.toml")
}

/// Bytes of all files below a folder but what the batch keeps of itself and the times in its report.
fn outputs(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut all = BTreeMap::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(next) = open.pop() {
        for entry in std::fs::read_dir(&next).into_iter().flatten() {
            let path = entry.expect("listed").path();
            let name = path
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            if path.is_dir() {
                open.push(path);
            } else if name != "journal" && name != "report.json" {
                let inside = path.strip_prefix(folder).expect("below it").to_path_buf();
                all.insert(inside, std::fs::read(&path).expect("readable"));
            }
        }
    }
    all
}

fn states(report: &serde_json::Value) -> [u64; 4] {
    ["done", "kept", "failed", "skipped"].map(|k| report[k].as_u64().expect("a count"))
}

/// Resident bytes of a process and of its children, 0 when it is over.
fn resident(pid: u32) -> u64 {
    let one = |pid: &str| {
        let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
        let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"));
        let kib = line.and_then(|l| l.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok());
        kib.unwrap_or(0) << 10
    };
    let own = pid.to_string();
    let children = std::fs::read_to_string(format!("/proc/{pid}/task/{pid}/children"));
    let children = children.unwrap_or_default();
    one(&own) + children.split_whitespace().map(one).sum::<u64>()
}

#[test]
#[cfg_attr(debug_assertions, ignore = "release only: 53 tasks, many times")]
fn a_batch_is_bounded_and_goes_on_after_any_kill() {
    let scratch = Scratch::new("batch");
    let file = job(&scratch);
    let out = scratch.path("out");
    const MIB: u64 = 256;
    let limits = ["--mem", "256MiB"];
    let planned = batch(&file, &["--dry-run"]).success().json();
    let tasks = planned["tasks"].as_array().expect("a list").len();
    assert!(tasks >= 40 && !out.exists(), "{planned}");

    let name = file.to_string_lossy().into_owned();
    let words = ["batch", &name, "-q", "--mem", "256MiB"].map(str::to_string);

    // Whole, with its memory watched.
    let mut child = start(words.clone());
    let mut peak = 0;
    let code = loop {
        peak = peak.max(resident(child.id()));
        if let Some(status) = child.try_wait().expect("ours") {
            break status.code();
        }
        std::thread::sleep(Duration::from_micros(500));
    };
    assert_eq!(code, Some(1), "a task fails");
    assert!(
        peak > 8 << 20 && peak <= (MIB + 48) << 20,
        "{} MiB",
        peak >> 20
    );
    let whole = outputs(&out);
    let named = |name: &str| &whole[Path::new(name)];
    assert!(
        named("tiled-0.25.ply") == named("noise-0.25.ply"),
        "seven tiles give another mesh"
    );
    assert!(whole.keys().all(|p| !p.starts_with(".brickmarch-batch")));
    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("report.json")).expect("a report"))
            .expect("is JSON");
    assert_eq!(states(&report), [tasks as u64 - 3, 0, 1, 2], "{report:#}");
    let failed: Vec<_> = report["tasks"]
        .as_array()
        .expect("a list")
        .iter()
        .filter(|t| t["state"] == "failed")
        .map(|t| {
            (
                t["name"].to_string(),
                t["tries"].as_u64(),
                t["error"].to_string(),
            )
        })
        .collect();
    // What ends early is tried again.
    assert!(
        failed
            .iter()
            .any(|f| f.0.contains("cut off") && f.1 == Some(2)),
        "{failed:?}"
    );

    // Killed again and again, it comes to the same.
    std::fs::remove_dir_all(&out).expect("removed");
    let mut rng = Rng::new(41);
    let kills =
        std::env::var("BRICKMARCH_BATCH_KILLS").map_or(20, |n| n.parse().expect("a number"));
    let (mut done, mut ended) = (0, 0);
    for _ in 0..kills {
        let mut child = start(words.clone());
        let wait = Duration::from_millis(rng.below(120));
        let begin = Instant::now();
        while begin.elapsed() < wait && child.try_wait().expect("ours").is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        ended += u32::from(child.try_wait().expect("ours").is_some());
        child.kill().expect("ours");
        child.wait().expect("ours");
        // Nothing that has its name is half made, and nothing done is undone.
        for (path, bytes) in outputs(&out) {
            if !path.starts_with(".brickmarch-batch") {
                assert!(whole.get(&path) == Some(&bytes), "{}", path.display());
            }
        }
        let kept = batch(&file, &["--dry-run"]).success().json();
        let kept = kept["tasks"].as_array().expect("a list").iter();
        let kept = kept.filter(|t| t["state"] == "kept").count();
        assert!(kept >= done, "{kept} tasks are done after {done} were");
        done = kept;
    }
    let last = batch(&file, &limits);
    assert_eq!(last.code, Some(1), "{last:#?}");
    assert_eq!(states(&last.json())[1], done as u64);
    let now = outputs(&out);
    assert!(
        now.keys().eq(whole.keys()),
        "{:?}\n{:?}",
        now.keys(),
        whole.keys()
    );
    assert!(now == whole, "other bytes after kills");
    // Only what failed is tried again.
    let again = batch(&file, &limits).json();
    assert_eq!(states(&again), [0, tasks as u64 - 3, 1, 2]);
    figure(&format!(
        "batch of {tasks} tasks in {MIB} MiB: {} MiB resident in all its processes at most; {kills} kills, {ended} of them \
         after the end; the same {} files",
        peak >> 20,
        whole.len()
    ));
}

#[test]
fn a_changed_input_or_a_lost_output_is_done_again() {
    let scratch = super::scratch_with_raw("batch-again");
    scratch.write(
        "job.toml",
        b"[[task]]\nop = \"import\"\ninput = \"field.raw\"\noutput = \"f.bvol\"\ndims = \"30,21,26\"\ntype = \"f32\"\n\
          [[task]]\nop = \"mesh\"\ninput = \"f.bvol\"\noutput = \"f.ply\"\niso = 0\n\
          [[task]]\nop = \"info\"\ninput = \"field.raw\"\n",
    );
    let file = scratch.path("job.toml");
    // The last task is given no volume: it fails and stops nobody.
    let first = batch(&file, &[]);
    assert_eq!(
        (first.code, states(&first.json())),
        (Some(1), [2, 0, 1, 0]),
        "{first:#?}"
    );
    assert_eq!(states(&batch(&file, &[]).json()), [0, 2, 1, 0]);
    std::fs::remove_file(scratch.path("out/f.ply")).expect("it was made");
    assert_eq!(states(&batch(&file, &[]).json()), [1, 1, 1, 0]);
    std::thread::sleep(Duration::from_millis(20));
    scratch.write("field.raw", f32_bytes(&super::samples()));
    assert_eq!(states(&batch(&file, &[]).json()), [2, 0, 1, 0]);
    // What a kill has cut off of the journal is done again.
    let journal = scratch.path("out/.brickmarch-batch/journal");
    let bytes = std::fs::read(&journal).expect("it is there");
    std::fs::write(&journal, &bytes[..bytes.len() - 7]).expect("cut");
    assert_eq!(states(&batch(&file, &[]).json()), [1, 1, 1, 0]);
}

#[test]
fn tasks_that_cannot_be_are_refused_before_any_runs() {
    let scratch = super::scratch_with_raw("batch-bad");
    let task = "[[task]]\nop = \"import\"\ninput = \"field.raw\"\noutput = \"f.bvol\"\ndims = \"30,21,26\"\ntype = \"f32\"\n";
    for (text, part) in [
        (format!("{task}mem = \"1GiB\"\n"), "--mem"),
        (format!("{task}brick = 7\n"), "job.toml:1"),
        (format!("{task}{task}"), "both write"),
        ("task = 3\n".to_string(), "job.toml:1"),
        ("\u{0}".to_string(), "job.toml:1"),
    ] {
        scratch.write("job.toml", text.as_bytes());
        let run = batch(&scratch.path("job.toml"), &[]);
        assert_eq!(run.code, Some(1), "{text}: {run:#?}");
        assert!(
            run.stderr.contains(part) && run.stderr.lines().count() == 1,
            "{text}: {run:#?}"
        );
        assert!(!scratch.path("out/f.bvol").exists(), "{text}");
    }
    let run = batch(&scratch.path("none.toml"), &[]);
    assert!(
        run.code == Some(1) && run.stderr.contains("none.toml"),
        "{run:#?}"
    );
}
