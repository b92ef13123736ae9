//! One run of a command: its budget, its messages, its signals.

use crate::args::{ProgressMode, Run, Say};
use crate::progress::{self, Watcher};
use crate::system;
use brickmarch::{Budget, CancelToken, Result};
use std::io::Write;
use std::sync::atomic::{AtomicI32, Ordering};
use std::time::Instant;

/// The signal that asked us to stop, 0 before one did.
static STOPPED_BY: AtomicI32 = AtomicI32::new(0);

/// What every command needs to run.
pub(crate) struct Job {
    pub budget: Budget,
    pub say: Say,
    started: Instant,
}

impl Job {
    /// A job inside its limits.
    pub(crate) fn new(run: &Run) -> Job {
        Job::without(0, run)
    }

    /// A job inside its limits, when `bytes` of the memory are for something else.
    pub(crate) fn without(bytes: u64, run: &Run) -> Job {
        let Run { limits, say } = run;
        let mut budget = Budget::bytes(limits.mem - bytes);
        if let Some(threads) = limits.threads {
            budget = budget.with_threads(usize::from(threads));
        }
        Job::with_budget(budget, say)
    }

    /// A job with a budget of its own making.
    pub(crate) fn with_budget(budget: Budget, say: &Say) -> Job {
        stop_on_signal(budget.cancel_token());
        Job {
            budget,
            say: say.clone(),
            started: Instant::now(),
        }
    }

    /// Seconds since the job began.
    pub(crate) fn seconds(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// Shows the progress of the budget until the result is dropped.
    pub(crate) fn watch(&self, doing: &str) -> Watcher {
        Watcher::start(doing, 0, &self.budget, &self.say)
    }

    /// The same for work that does not know its own size: `count` does, and is asked only when
    /// somebody looks.
    ///
    /// # Errors
    /// Those of `count`.
    pub(crate) fn watch_counted(
        &self,
        doing: &str,
        count: impl FnOnce() -> Result<u64>,
    ) -> Result<Watcher> {
        let seen = progress::mode(&self.say) != ProgressMode::None;
        let total = if seen { count()? } else { 0 };
        Ok(Watcher::start(doing, total, &self.budget, &self.say))
    }

    /// A message for people, on standard error; nothing with `--quiet`.
    pub(crate) fn note(&self, text: &str) {
        if !self.say.quiet {
            message(text);
        }
    }

    /// A message for the curious, on standard error; only with `--verbose`.
    pub(crate) fn detail(&self, text: &str) {
        if self.say.verbose > 0 {
            message(text);
        }
    }

    /// The result: text for people, or one JSON object.
    ///
    /// # Errors
    /// When standard output cannot be written.
    pub(crate) fn result(&self, text: &str, json: &serde_json::Value) -> std::io::Result<()> {
        let mut out = std::io::stdout().lock();
        if self.say.json {
            writeln!(out, "{json}")?;
        } else {
            write!(out, "{text}")?;
        }
        out.flush()
    }

    /// Peak resident memory as text: "201.3 MiB", or "unknown".
    pub(crate) fn peak_text() -> String {
        system::peak_resident_bytes().map_or("unknown".to_string(), brickmarch::budget::human_bytes)
    }
}

/// A line on standard error. A closed standard error is no reason to fail.
pub(crate) fn message(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// The exit code of the signal that stopped us, if one did.
pub(crate) fn signal_exit_code() -> Option<u8> {
    match STOPPED_BY.load(Ordering::Acquire) {
        0 => None,
        signal => Some(128 + signal as u8),
    }
}

/// The first signal cancels, so that scratch files go; the second ends the program at once.
#[cfg(unix)]
fn stop_on_signal(token: CancelToken) {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    let Ok(mut signals) = signal_hook::iterator::Signals::new([SIGINT, SIGTERM, SIGHUP]) else {
        return; // Signals then keep their default, which ends the program.
    };
    let listen = move || {
        for signal in signals.forever() {
            if STOPPED_BY.swap(signal, Ordering::AcqRel) != 0 {
                std::process::exit(128 + signal);
            }
            token.cancel();
        }
    };
    let _ = std::thread::Builder::new()
        .name("signals".into())
        .spawn(listen);
}

#[cfg(not(unix))]
fn stop_on_signal(_token: CancelToken) {}
