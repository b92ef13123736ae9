//! `verify`: reads every byte of a volume file and says what is damaged and what is lost.

use super::{seconds, thousands};
use crate::Outcome;
use crate::args::Verify;
use crate::job::Job;
use brickmarch::budget::human_bytes;
use brickmarch::store::verify;
use serde_json::json;
use std::fmt::Write;

/// Damaged places that are shown one by one; JSON has all that the report lists.
const SHOWN_MAX: usize = 20;

pub(crate) fn run(args: &Verify) -> anyhow::Result<Outcome> {
    let job = Job::new(&args.run);
    let report = {
        let _watch = job.watch("verifying");
        verify(&args.volume, &job.budget)?
    };
    let problems = report.problems.len() as u64 + report.more_problems;
    let mut text = format!(
        "{}: {}, {} read, {} records, {} bricks and {} pages whole, {}\n",
        args.volume.display(),
        if report.is_intact() {
            "intact"
        } else {
            "DAMAGED"
        },
        human_bytes(report.bytes),
        thousands(report.records),
        thousands(report.bricks),
        thousands(report.pages),
        seconds(job.seconds()),
    );
    for problem in report.problems.iter().take(SHOWN_MAX) {
        let lost = problem
            .lost
            .map_or(String::new(), |b| format!("; lost: {b}"));
        // Writing to a string cannot fail.
        let _ = writeln!(text, "  {}{lost}", problem.message);
    }
    if problems > SHOWN_MAX as u64 {
        let more = thousands(problems - SHOWN_MAX as u64);
        let _ = writeln!(text, "  and {more} more (--json lists up to 1000)");
    }
    for note in &report.notes {
        let _ = writeln!(text, "  note: {note}");
    }
    let listed: Vec<_> = report
        .problems
        .iter()
        .map(|p| json!({ "message": p.message, "lost": p.lost.map(|b| b.to_string()) }))
        .collect();
    let json = json!({
        "schema": 1, "command": "verify", "file": args.volume, "intact": report.is_intact(),
        "bytes": report.bytes, "records": report.records, "bricks": report.bricks,
        "pages": report.pages, "problems": listed, "more_problems": report.more_problems,
        "notes": report.notes, "seconds": job.seconds(),
        "peak_rss_bytes": crate::system::peak_resident_bytes(),
    });
    job.result(&text, &json)?;
    if report.is_intact() {
        return Ok(Outcome::Done);
    }
    job.note(&format!(
        "{}: damaged in {} places: import it again from its source, or take only the regions that are whole",
        args.volume.display(),
        thousands(problems)
    ));
    Ok(Outcome::NotWhatWasAsked)
}
