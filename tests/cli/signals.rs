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
            let mut child = start(words(&scratch, line));
            let begin = Instant::now();
            while scratch.listing().len() == before.len()
                && begin.elapsed() < Duration::from_secs(20)
            {
                std::thread::sleep(Duration::from_millis(1));
            }
            let kill = Command::new("kill")
                .args([&format!("-{signal}"), &child.id().to_string()])
                .status();
            assert!(
                kill.is_ok_and(|s| s.success()),
                "{line}: it ended before it could be stopped"
            );
            let status = child.wait().expect("waiting for a child works");
            assert_eq!(
                status.code(),
                Some(code),
                "{line} after SIG{signal}: {status}"
            );
            assert_eq!(
                before,
                scratch.listing(),
                "{line} after SIG{signal} left something behind"
            );
        }
    }
}
