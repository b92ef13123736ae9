//! The system's Python, which carries the reference programs (NumPy, SciPy, OpenVDB).

use super::program::{Run, run};
use super::report::skipped;
use std::ffi::OsStr;
use std::process::Command;

/// Debian's interpreter: the one that its packages python3-openvdb and python3-numpy serve.
const PYTHON: &str = "/usr/bin/python3";

/// Whether Python can import `modules`; says loudly that `what` is skipped when not.
pub(crate) fn has(modules: &[&str], what: &str) -> bool {
    let import = format!("import {}", modules.join(", "));
    let found = Command::new(PYTHON).args(["-c", &import]).output();
    let found = found.is_ok_and(|o| o.status.success());
    if !found {
        skipped(&format!(
            "{what}: {PYTHON} cannot import {} (Debian: apt-get install {})",
            modules.join(", "),
            modules
                .iter()
                .map(|m| format!("python3-{}", m.trim_start_matches("py")))
                .collect::<Vec<_>>()
                .join(" ")
        ));
    }
    found
}

/// Runs a script.
pub(crate) fn python<S: AsRef<OsStr>>(args: impl IntoIterator<Item = S>) -> Run {
    run(Command::new(PYTHON).args(args))
}
