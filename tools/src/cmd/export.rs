//! `export`: samples of a volume in another format.

use super::{named, pick, region, seconds};
use crate::Outcome;
use crate::args::Export;
use crate::job::Job;
use crate::output::{self, Replace};
use brickmarch::Field;
use brickmarch::budget::human_bytes;
use brickmarch_formats as formats;
use serde_json::json;

pub(crate) fn run(args: &Export) -> anyhow::Result<Outcome> {
    let replace = Replace::from(&args.overwrite);
    let job = Job::new(&args.run);
    let volume = pick::open(&args.volume, &args.pick, &job.budget)?;
    output::check_target(&args.out, replace)?;
    let blame = named(&[&args.volume, &args.out]);
    let region = region::resolve(&args.region, volume.grid()).map_err(&blame)?;
    let options = formats::Export {
        format: None,
        gzip: args.gzip,
        overwrite: replace == Replace::Yes,
    };
    let made = {
        let _watch = job.watch("exporting");
        formats::export_volume(&volume, region, &args.out, &options, &job.budget).map_err(blame)?
    };
    let size = made.region.size();
    let text = format!(
        "{}: {} x {} x {} {}, {}, {}, peak {}\n",
        args.out.display(),
        size[0],
        size[1],
        size[2],
        made.sample.name(),
        human_bytes(made.bytes),
        seconds(job.seconds()),
        Job::peak_text(),
    );
    let json = json!({
        "schema": 1, "command": "export", "volume": args.volume, "out": args.out,
        "region": { "min": made.region.min, "max": made.region.max }, "size": size,
        "sample": made.sample.name(), "bytes_out": made.bytes, "seconds": job.seconds(),
        "blocks_decoded": volume.blocks_decoded(),
        "peak_rss_bytes": crate::system::peak_resident_bytes(),
    });
    job.result(&text, &json)?;
    Ok(pick::outcome(&volume, &args.volume, &job))
}
