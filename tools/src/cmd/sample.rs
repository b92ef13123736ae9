//! `sample`: values, and gradients, of a volume at points.

use super::{ask, named, pick, seconds, thousands};
use crate::Outcome;
use crate::args::Sample;
use crate::job::Job;
use crate::output::{self, Replace};
use brickmarch::Field;
use brickmarch::query::{Sampling, sample_gradients, sample_points};
use serde_json::json;

pub(crate) fn run(args: &Sample) -> anyhow::Result<Outcome> {
    let replace = Replace::from(&args.overwrite);
    if let Some(out) = &args.out {
        output::check_target(out, replace)?;
    }
    let job = Job::new(&args.run);
    let volume = pick::open(&args.volume, &args.pick, &job.budget)?;
    let options = Sampling {
        method: args.method.into(),
        space: ask::space(args.space),
        outside: args.outside,
    };
    let names: &[&str] = if args.gradient {
        &["x", "y", "z", "value", "gx", "gy", "gz"]
    } else {
        &["x", "y", "z", "value"]
    };
    let mut without = 0u64;
    let count = ask::by_batches(
        &args.points,
        3,
        args.out.as_deref(),
        replace,
        names,
        &job,
        |rows, out| {
            let points = rows.as_chunks::<3>().0;
            let mut values = vec![0.0; points.len()];
            sample_points(&volume, points, &options, &mut values, &job.budget)?;
            let mut slopes = vec![[0.0; 3]; if args.gradient { points.len() } else { 0 }];
            sample_gradients(
                &volume,
                &points[..slopes.len()],
                &options,
                &mut slopes,
                &job.budget,
            )?;
            for (n, (point, value)) in points.iter().zip(values).enumerate() {
                out.extend_from_slice(point);
                out.push(f64::from(value));
                without += u64::from(value.is_nan());
                if let Some(slope) = slopes.get(n) {
                    out.extend(slope.map(f64::from));
                }
            }
            Ok(())
        },
    )
    .map_err(named(&[&args.volume, &args.points]))?;
    let Some(out) = &args.out else {
        return Ok(Outcome::Done);
    };
    let text = format!(
        "{}: {} points, {} without a value, {}, peak {}\n",
        out.display(),
        thousands(count),
        thousands(without),
        seconds(job.seconds()),
        Job::peak_text()
    );
    let json = json!({
        "schema": 1, "command": "sample", "out": out, "points": count, "without_value": without,
        "blocks_decoded": volume.blocks_decoded(), "seconds": job.seconds(),
        "peak_rss_bytes": crate::system::peak_resident_bytes(),
    });
    job.result(&text, &json)?;
    Ok(pick::outcome(&volume, &args.volume, &job))
}
