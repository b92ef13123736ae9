//! A command that is stopped says so by its exit code, and leaves nothing behind.

use super::words;
use crate::support::fields::{Content, random};
use crate::support::program::start;
use crate::support::rng::Rng;
use crate::support::scratch::{Scratch, f32_bytes};
use brickmarch::Box3;
use std::process::Command;
use std::time::{Duration, Instant};

#[test]
#[cfg_attr(debug_assertions, ignore = "release only: needs a run of some seconds")]
fn a_stopped_command_leaves_nothing() {
    let scratch = Scratch::new("signals");
    let n = 224;
    let noise = random(Content::Noise, Box3::from_size([n; 3]), &mut Rng::new(8));
    scratch.write("noise.raw", f32_bytes(&noise));
    let import = format!("import @noise.raw @noise.bvol --dims {n},{n},{n} --type f32 -q");
    crate::support::program::brickmarch(words(&scratch, &import)).success();
    for (signal, code) in [("TERM", 143), ("INT", 130)] {
        for line in [
            "mesh @noise.bvol @out.ply --iso 0 --threads 1 -q",
            "export @noise.bvol @out.npy --threads 1 -q",
        ] {
            let before = scratch.listing();
            // On a busy machine a run may end before the signal comes; then it is run again.
            let seen = (0..5)
                .map(|_| stop(&scratch, line, signal))
                .find(|code| *code != Some(0))
                .unwrap_or_else(|| panic!("{line}: it always ended before it could be stopped"));
            assert_eq!(seen, Some(code), "{line} after SIG{signal}");
            assert_eq!(
                before,
                scratch.listing(),
                "{line} after SIG{signal} left something behind"
            );
        }
    }
}

/// Starts a command, sends the signal once it writes, and gives its exit code.
fn stop(scratch: &Scratch, line: &str, signal: &str) -> Option<i32> {
    let before = scratch.listing();
    let mut child = start(words(scratch, line));
    let begin = Instant::now();
    while scratch.listing().len() == before.len() && begin.elapsed() < Duration::from_secs(20) {
        std::thread::sleep(Duration::from_millis(1));
    }
    let kill = Command::new("kill")
        .args([&format!("-{signal}"), &child.id().to_string()])
        .status();
    assert!(
        kill.is_ok_and(|s| s.success()),
        "the child is ours and not yet waited for"
    );
    let code = child.wait().expect("waiting for a child works").code();
    if code == Some(0) {
        for path in scratch
            .listing()
            .into_keys()
            .filter(|p| !before.contains_key(p))
        {
            std::fs::remove_file(&path).expect("its output");
        }
    }
    code
}
