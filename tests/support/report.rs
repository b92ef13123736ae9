//! Figures and skipped comparisons: printed, and collected in the file that the environment
//! variable `BRICKMARCH_REPORT` names, so that `tests/run` can show them at the end.

use std::io::Write;

/// A measured figure worth showing.
pub(crate) fn figure(line: &str) {
    note("figure", line);
}

/// A comparison that cannot run here. Says why, loudly.
pub(crate) fn skipped(line: &str) {
    note("SKIPPED", line);
}

#[expect(
    clippy::print_stderr,
    reason = "the place where tests talk to the person who runs them"
)]
fn note(tag: &str, line: &str) {
    eprintln!("{tag}: {line}");
    if let Some(path) = std::env::var_os("BRICKMARCH_REPORT") {
        let file = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(path);
        // One write, so that lines of tests that run at the same time do not mix.
        file.and_then(|mut f| f.write_all(format!("{tag}: {line}\n").as_bytes()))
            .expect("the report file is writable");
    }
}
