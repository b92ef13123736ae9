//! `compact`: a volume file without dead bytes.

use super::{named, seconds};
use crate::Outcome;
use crate::args::Compact;
use crate::job::Job;
use crate::output::{self, Replace};
use brickmarch::budget::human_bytes;
use brickmarch::store;
use serde_json::json;

pub(crate) fn run(args: &Compact) -> anyhow::Result<Outcome> {
    let job = Job::new(&args.run);
    output::check_target(&args.out, Replace::from(&args.overwrite))?;
    let before = std::fs::metadata(&args.volume).map_or(0, |m| m.len());
    let info = {
        let _watch = job.watch("compacting");
        store::compact(&args.volume, &args.out, &job.budget)
            .map_err(named(&[&args.volume, &args.out]))?
    };
    let text = format!(
        "{}: {} from {}, {}, peak {}\n",
        args.out.display(),
        human_bytes(info.bytes_file),
        human_bytes(before),
        seconds(job.seconds()),
        Job::peak_text(),
    );
    let json = json!({
        "schema": 1, "command": "compact", "volume": args.volume, "out": args.out,
        "bytes_in": before, "bytes_out": info.bytes_file, "sealed": info.sealed,
        "seconds": job.seconds(), "peak_rss_bytes": crate::system::peak_resident_bytes(),
    });
    job.result(&text, &json)?;
    Ok(Outcome::Done)
}
