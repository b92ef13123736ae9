//! The command line program: dispatch and exit codes.

mod args;
mod batch;
mod cmd;
mod colourmap;
mod job;
mod output;
mod paint;
mod parse;
mod picture;
mod progress;
mod render;
mod section;
#[cfg(feature = "serve")]
mod serve;
mod shapes;
mod simplify;
mod system;
mod table;
mod tally;
mod tee;

use args::{Cli, Command};
use clap::Parser;
use std::process::ExitCode;

/// How a command ended that did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Done,
    /// Finished, but the result is not what was asked.
    NotWhatWasAsked,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    if let Some(parent) = cli.die_with_parent {
        system::die_with_parent(parent);
    }
    let ended = match &cli.command {
        Command::Demo(args) => cmd::demo::run(args),
        Command::Import(args) => cmd::import::run(args),
        Command::Export(args) => cmd::export::run(args),
        Command::Verify(args) => cmd::verify::run(args),
        Command::Compact(args) => cmd::compact::run(args),
        Command::Info(args) => cmd::info::run(args),
        Command::Mesh(args) => cmd::mesh::run(args),
        Command::Join(args) => cmd::join::run(args),
        Command::Model(args) => cmd::model::run(args),
        Command::Check(args) => cmd::check::run(args),
        Command::Sample(args) => cmd::sample::run(args),
        Command::Ray(args) => cmd::ray::run(args),
        Command::Render(args) => cmd::render::run(args),
        Command::Slice(args) => cmd::slice::run(args),
        Command::Batch(args) => cmd::batch::run(args),
        #[cfg(feature = "serve")]
        Command::Serve(args) => serve::run(args),
        Command::Completions(args) => cmd::manual::completions(args),
        Command::Man(args) => cmd::manual::pages(args),
    };
    match ended {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::NotWhatWasAsked) => ExitCode::from(3),
        Err(error) => ExitCode::from(report(&error)),
    }
}

/// Says on one line what went wrong; gives the exit code.
fn report(error: &anyhow::Error) -> u8 {
    let io = error
        .chain()
        .find_map(|e| e.downcast_ref::<std::io::Error>());
    if io.is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe) {
        return 0; // The reader of our results has seen enough.
    }
    let cancelled = error
        .downcast_ref::<brickmarch::Error>()
        .is_some_and(|e| e.kind() == brickmarch::ErrorKind::Cancelled);
    if let (true, Some(code)) = (cancelled, job::signal_exit_code()) {
        // An import that has committed keeps what it has, and its error says where.
        let kept = error.to_string();
        let kept = kept.split_once("; ").map(|(_, kept)| kept);
        let what = kept.unwrap_or("unfinished files were removed");
        job::message(&format!("brickmarch: stopped by a signal; {what}"));
        return code;
    }
    let line = format!("{error:#}").replace(['\n', '\r'], " ");
    job::message(&format!("brickmarch: {line}"));
    1
}
