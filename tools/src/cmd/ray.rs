//! `ray`: first crossing, largest value or integral of a volume along rays.

use super::{ask, named, pick, region, seconds, thousands};
use crate::Outcome;
use crate::args::{Ray as Args, Space};
use crate::job::Job;
use crate::output::{self, Replace};
use brickmarch::Field;
use brickmarch::query::{Ray, Rays};
use serde_json::json;

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let replace = Replace::from(&args.overwrite);
    if let Some(out) = &args.out {
        output::check_target(out, replace)?;
    }
    let job = Job::new(&args.run);
    let volume = pick::open(&args.volume, &args.pick, &job.budget)?;
    let grid = *volume.grid();
    let blame = named(&[&args.volume, &args.rays]);
    let part = region::resolve(&args.region, &grid).map_err(&blame)?;
    let rays = Rays::new(&volume, part.unwrap_or(grid.domain), &job.budget).map_err(&blame)?;
    let names: &[&str] = match (args.what.iso, args.what.max) {
        (Some(_), _) => &["t", "x", "y", "z", "rising"],
        (_, true) => &["t", "x", "y", "z", "value"],
        _ => &["integral", "length"],
    };
    let mut hits = 0u64;
    let back = grid.index_to_world.inverse().map_err(&blame)?;
    let count = ask::by_batches(
        &args.rays,
        6,
        args.out.as_deref(),
        replace,
        names,
        &job,
        |rows, batch, put| {
            let (mut numbers, mut out) = (Vec::new(), Vec::new());
            loop {
                rows.next(batch, &mut numbers)?;
                if numbers.is_empty() {
                    return Ok(());
                }
                let given: Vec<Ray> = numbers
                    .as_chunks::<6>()
                    .0
                    .iter()
                    .map(|&[x, y, z, dx, dy, dz]| Ray {
                        origin: [x, y, z],
                        direction: [dx, dy, dz],
                    })
                    .collect();
                let turned: Vec<Ray> = given
                    .iter()
                    .map(|ray| match args.space {
                        Space::Index => *ray,
                        Space::World => Ray {
                            origin: back.apply(ray.origin),
                            direction: back.rows.map(|r| {
                                let d = ray.direction;
                                r[0] * d[0] + r[1] * d[1] + r[2] * d[2]
                            }),
                        },
                    })
                    .collect();
                let mut answers = vec![[f64::NAN; 2]; given.len()];
                rays.cast(&turned, &mut answers, &job.budget, |cursor, ray| {
                    Ok(if let Some(iso) = args.what.iso {
                        let found = rays.first_crossing(cursor, ray, iso, 0.0)?;
                        found.map_or([f64::NAN; 2], |c| [c.t, f64::from(u8::from(c.rising))])
                    } else if args.what.max {
                        let found = rays.maximum(cursor, ray)?;
                        found.map_or([f64::NAN; 2], |p| [p.t, p.value])
                    } else {
                        let found = rays.integral(cursor, ray)?;
                        [found.sum, found.length]
                    })
                })?;
                for (ray, [a, b]) in given.iter().zip(answers) {
                    if names.len() == 2 {
                        // Steps of t are as long as the direction is.
                        let length = ray.direction.iter().map(|d| d * d).sum::<f64>().sqrt();
                        hits += u64::from(b > 0.0);
                        out.extend([a * length, b * length]);
                    } else {
                        hits += u64::from(!a.is_nan());
                        let [x, y, z] = ray.at(a);
                        out.extend([a, x, y, z, b]);
                    }
                }
                put(&mut out)?;
                job.budget.check_cancelled()?;
            }
        },
    )
    .map_err(blame)?;
    let Some(out) = &args.out else {
        return Ok(Outcome::Done);
    };
    let text = format!(
        "{}: {} rays, {} with an answer, {}, peak {}\n",
        out.display(),
        thousands(count),
        thousands(hits),
        seconds(job.seconds()),
        Job::peak_text()
    );
    let json = json!({
        "schema": 1, "command": "ray", "out": out, "rays": count, "answers": hits,
        "blocks_decoded": volume.blocks_decoded(), "seconds": job.seconds(),
        "peak_rss_bytes": crate::system::peak_resident_bytes(),
    });
    job.result(&text, &json)?;
    Ok(pick::outcome(&volume, &args.volume, &job))
}
