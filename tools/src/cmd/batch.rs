//! `batch`: many tasks in one memory budget.

use crate::Outcome;
use crate::args::{Batch, ProgressMode};
use crate::batch::{self, Journal, Limits, Plan};
use crate::job::Job;
use crate::output::{self, Replace};
use crate::progress;
use brickmarch::Error;
use std::io::Write;
use std::time::{Duration, Instant};

/// How far apart messages of progress are.
const STEP: Duration = Duration::from_secs(5);

pub(crate) fn run(args: &Batch) -> anyhow::Result<Outcome> {
    let job = Job::new(&args.run);
    let plan = Plan::read(&args.file)?;
    let threads = job.budget.threads();
    let limits = Limits::new(args.run.limits.mem, threads, args.jobs.or(plan.jobs));
    if args.dry_run {
        // A plan writes nothing, not even the folder of the outputs.
        let journal = match batch::own_folder(&plan.out).is_dir() {
            true => Some(Journal::open(&plan.out)?),
            false => None,
        };
        let (text, json) = batch::dry_run(&plan, &limits, journal.as_ref());
        job.result(&text, &json)?;
        return Ok(Outcome::Done);
    }
    std::fs::create_dir_all(&plan.out)
        .map_err(|e| Error::io(&plan.out, "making the folder of the outputs", e))?;
    let mut journal = Journal::open(&plan.out)?;
    let mut said = Instant::now();
    let mode = progress::mode(&job.say);
    let mut look = |report: &batch::Report| {
        if mode != ProgressMode::None && said.elapsed() >= STEP {
            said = Instant::now();
            job.note(&report.progress(limits.jobs));
        }
    };
    let cancelled = || job.budget.check_cancelled().is_err();
    let report = batch::run(&plan, &limits, &mut journal, &cancelled, &mut look)?;
    let json = report.json(&plan, &limits);
    let path = plan.out.join("report.json");
    output::write_whole(&path, Replace::Yes, |file| writeln!(file, "{json:#}"))?;
    job.result(&report.text(&plan), &json)?;
    if !report.is_good() {
        anyhow::bail!(
            "{}: not every task was done: see the lines above and {}",
            args.file.display(),
            path.display()
        );
    }
    Ok(Outcome::Done)
}
