//! Progress on standard error: a bar on a terminal, lines otherwise, or JSON lines.

use crate::args::{ProgressMode, Say};
use crate::job::message;
use brickmarch::{Budget, Progress};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::{Arc, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How often a bar moves, and how far apart lines are.
const BAR_STEP: Duration = Duration::from_millis(100);
const LINE_STEP: Duration = Duration::from_secs(5);

/// Shows progress until it is dropped.
pub(crate) struct Watcher {
    stop: Option<mpsc::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Watcher {
    /// Starts to show the progress of `budget` as `say` wants it; `total` is 0 where it is unknown
    /// or where the operation will say.
    pub(crate) fn start(doing: &str, total: u64, budget: &Budget, say: &Say) -> Watcher {
        let mode = mode(say);
        let progress = budget.progress().clone();
        progress.start(total);
        let doing = doing.to_string();
        let (stop, stopped) = mpsc::channel();
        let show = move || match mode {
            ProgressMode::Bar => show_bar(&doing, &progress, &stopped),
            _ => show_lines(&doing, &progress, &stopped, mode == ProgressMode::Json),
        };
        let thread = match mode {
            ProgressMode::None => None,
            _ => std::thread::Builder::new()
                .name("progress".into())
                .spawn(show)
                .ok(),
        };
        Watcher {
            stop: Some(stop),
            thread,
        }
    }
}

/// How progress is shown, never `Auto`.
pub(crate) fn mode(say: &Say) -> ProgressMode {
    match say.progress {
        _ if say.quiet => ProgressMode::None,
        ProgressMode::Auto if say.json => ProgressMode::None,
        ProgressMode::Auto if std::io::stderr().is_terminal() => ProgressMode::Bar,
        ProgressMode::Auto => ProgressMode::Plain,
        other => other,
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // A broken display is no reason to fail.
            let _ = thread.join();
        }
    }
}

/// Waits; true when the watcher was dropped.
fn over(stopped: &mpsc::Receiver<()>, wait: Duration) -> bool {
    !matches!(
        stopped.recv_timeout(wait),
        Err(mpsc::RecvTimeoutError::Timeout)
    )
}

fn show_bar(doing: &str, progress: &Arc<Progress>, stopped: &mpsc::Receiver<()>) {
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
    let style = |template: &str| {
        ProgressStyle::with_template(template)
            .unwrap_or_else(|_| ProgressStyle::default_bar())
            .progress_chars("=> ")
    };
    let known = style("{msg} [{bar:36}] {percent}% {elapsed} (about {eta} left)");
    let unknown = style("{msg} {spinner} {pos} {elapsed}");
    bar.set_style(unknown);
    bar.set_message(doing.to_string());
    let mut total_before = 0;
    while !over(stopped, BAR_STEP) {
        let (done, total) = progress.get();
        if total != total_before {
            if total > 0 {
                bar.set_style(known.clone());
            }
            bar.set_length(total);
            total_before = total;
        }
        bar.set_position(if total > 0 { done.min(total) } else { done });
        bar.tick();
    }
    bar.finish_and_clear();
}

fn show_lines(doing: &str, progress: &Arc<Progress>, stopped: &mpsc::Receiver<()>, json: bool) {
    let started = Instant::now();
    // The first line comes early for who watches a log; a quick job says nothing.
    let mut wait = Duration::from_secs(2);
    while !over(stopped, wait) {
        wait = LINE_STEP;
        let (done, total) = progress.get();
        let seconds = started.elapsed().as_secs();
        if json {
            let line = serde_json::json!({
                "progress": doing, "done": done, "total": total, "seconds": seconds
            });
            message(&line.to_string());
        } else if total > 0 {
            let percent = done.min(total) as f64 / total as f64 * 100.0;
            message(&format!("{doing}: {percent:.0} % after {seconds} s"));
        } else if done > 0 {
            message(&format!("{doing}: {done} done after {seconds} s"));
        }
    }
}
