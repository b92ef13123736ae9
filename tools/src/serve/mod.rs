//! `serve`: volumes over HTTP, on the local machine by default.
//!
//! ```text
//! socket --> wire (limits of HTTP, time limits) --> route (path, query) --> answer
//!                                                                            |
//!   shelf (open volumes, a share of the memory each) <-----------------------+
//! ```
//!
//! One thread does all that waits; work runs on as many threads as the budget has. Everything large
//! is under a permit of one budget: half of it are the caches of open volumes, the rest is for
//! answers, each of which takes its permit before it starts, or is refused with 503.

mod answer;
mod body;
mod query;
mod refusal;
mod route;
mod shelf;
mod surface;
mod wire;

use crate::Outcome;
use crate::args;
use crate::job::{Job, message};
use brickmarch::{Budget, CancelToken, Error};
use shelf::Shelf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Less than this holds no caches and no picture.
const MEM_MIN: u64 = 64 << 20;

/// What every request may use.
struct Site {
    shelf: Shelf,
    budget: Budget,
    /// Meshes and previews, which take all threads, come one at a time.
    surfaces: tokio::sync::Semaphore,
    max_region_bytes: u64,
    scratch: tempfile::TempDir,
    /// Names given out in `scratch`.
    scratch_names: AtomicU64,
    /// Whether only this machine can reach us, so that every request must be addressed to it.
    loopback: bool,
    verbose: bool,
}

pub(crate) fn run(args: &args::Serve) -> anyhow::Result<Outcome> {
    let memory = args.run.limits.mem;
    if memory < MEM_MIN {
        return Err(Error::bad_input("serve needs at least 64 MiB: give more with --mem").into());
    }
    // A signal cancels the budget of the job, which nothing here works under: requests that run
    // are finished.
    let job = Job::new(&args.run);
    let stop = job.budget.cancel_token();
    let threads = job.budget.threads();
    let budget = Budget::bytes(memory).with_threads(threads);
    let shelf = Shelf::open(&args.volumes, &budget)?;
    let folder = args.scratch.clone().unwrap_or_else(std::env::temp_dir);
    let scratch = tempfile::Builder::new()
        .prefix("brickmarch-serve-")
        .tempdir_in(&folder)
        .map_err(|e| Error::io(&folder, "making a folder for meshes", e))?;
    let site = Arc::new(Site {
        shelf,
        budget,
        surfaces: tokio::sync::Semaphore::new(1),
        max_region_bytes: args.max_region_bytes,
        scratch,
        scratch_names: AtomicU64::new(0),
        loopback: args.listen.ip().is_loopback(),
        verbose: args.run.say.verbose > 0,
    });
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .max_blocking_threads(threads + 1)
        .build()?;
    let served = runtime.block_on(serve(args, &job, site, stop));
    // What still works was cancelled.
    runtime.shutdown_timeout(std::time::Duration::from_secs(5));
    served.map(|()| Outcome::Done)
}

async fn serve(
    args: &args::Serve,
    job: &Job,
    site: Arc<Site>,
    stop: CancelToken,
) -> anyhow::Result<()> {
    let listener = tokio::net::TcpListener::bind(args.listen)
        .await
        .map_err(|e| {
            let remedy = "take another address or port with --listen, or port 0 for a free one";
            anyhow::anyhow!("{}: listening: {e}: {remedy}", args.listen)
        })?;
    let address = listener.local_addr()?;
    let names: Vec<&str> = site.shelf.names().collect();
    let text = format!("http://{address}/ serves {}\n", names.join(", "));
    let json = serde_json::json!({
        "schema": 1, "command": "serve", "address": address.to_string(),
        "url": format!("http://{address}/"), "volumes": names, "mem_bytes": args.run.limits.mem,
    });
    job.result(&text, &json)?;
    if !site.loopback {
        job.note("brickmarch: anyone who can reach this address can read these volumes");
    }
    let left = wire::serve(listener, site.clone(), stop).await;
    if left > 0 {
        job.note(&format!(
            "brickmarch: stopped; {left} requests were cut off"
        ));
    }
    Ok(())
}

impl Site {
    /// A name for a file in the scratch folder.
    fn scratch_path(&self, ending: &str) -> std::path::PathBuf {
        let number = self.scratch_names.fetch_add(1, Ordering::Relaxed);
        self.scratch.path().join(format!("{number}.{ending}"))
    }

    /// A line for the curious.
    fn log(&self, line: &str) {
        if self.verbose {
            message(line);
        }
    }
}
