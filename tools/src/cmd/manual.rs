//! `completions` and `man`, both from the one definition of the command line.

use crate::Outcome;
use crate::args::{Cli, Completions, Man};
use crate::output::{self, Replace};
use anyhow::Context;
use clap::CommandFactory;
use std::io::Write;

pub(crate) fn completions(args: &Completions) -> anyhow::Result<Outcome> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "brickmarch", &mut script);
    std::io::stdout().write_all(&script)?;
    Ok(Outcome::Done)
}

pub(crate) fn pages(args: &Man) -> anyhow::Result<Outcome> {
    let dir = &args.dir;
    std::fs::create_dir_all(dir)
        .with_context(|| format!("{}: making the folder", dir.display()))?;
    let mut root = Cli::command();
    root.build();
    let mut commands = vec![(String::from("brickmarch"), root.clone())];
    for sub in root.get_subcommands().filter(|s| s.get_name() != "help") {
        let name = format!("brickmarch-{}", sub.get_name());
        commands.push((name, sub.clone()));
    }
    for (name, command) in commands {
        // Leaked once per page: clap holds names for the length of the program.
        let name: &'static str = name.leak();
        let mut page = Vec::new();
        clap_mangen::Man::new(command.name(name)).render(&mut page)?;
        let path = dir.join(format!("{name}.1"));
        output::write_whole(&path, Replace::Yes, |file| file.write_all(&page))?;
        writeln!(std::io::stdout(), "{}", path.display())?;
    }
    Ok(Outcome::Done)
}
