//! The job file: TOML with one table per task, in which lists stand for several tasks.

use brickmarch::{Error, Result};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use toml::{Spanned, Table};

/// Bytes of a job file at most.
const MAX_FILE: u64 = 16 << 20;

/// A job file as it is written.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Text {
    out: Option<PathBuf>,
    #[serde(default)]
    retries: u32,
    jobs: Option<u16>,
    #[serde(default)]
    task: Vec<Spanned<Table>>,
}

/// A job file that was read.
#[derive(Debug)]
pub(super) struct JobFile {
    /// Folder of the file, which its paths start from.
    pub base: PathBuf,
    /// Folder of the outputs.
    pub out: PathBuf,
    pub retries: u32,
    pub jobs: Option<u16>,
    /// The tables with their lines, from 1.
    pub tasks: Vec<(usize, Table)>,
}

/// # Errors
/// Names the file, the line and what is wrong.
pub(super) fn read(path: &Path) -> Result<JobFile> {
    let name = path.display();
    let meta = std::fs::metadata(path).map_err(|e| Error::io(path, "opening the job file", e))?;
    if meta.len() > MAX_FILE || !meta.is_file() {
        return Err(Error::bad_input(format!(
            "{name}: a job file is a text of at most {} MiB",
            MAX_FILE >> 20
        )));
    }
    let text =
        std::fs::read_to_string(path).map_err(|e| Error::io(path, "reading the job file", e))?;
    let line_of = |at: usize| 1 + text[..at.min(text.len())].matches('\n').count();
    let parsed: Text = toml::from_str(&text).map_err(|e| {
        let line = e.span().map_or(1, |s| line_of(s.start));
        Error::bad_input(format!(
            "{name}:{line}: {}",
            e.message().replace('\n', "; ")
        ))
    })?;
    if parsed.task.is_empty() {
        return Err(Error::bad_input(format!(
            "{name}: no task: write [[task]] and below it op = \"mesh\", input and output"
        )));
    }
    let folder = match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let base = folder
        .canonicalize()
        .map_err(|e| Error::io(folder, "finding the folder of the job file", e))?;
    Ok(JobFile {
        out: base.join(parsed.out.unwrap_or_else(|| "out".into())),
        base,
        retries: parsed.retries,
        jobs: parsed.jobs,
        tasks: parsed
            .task
            .into_iter()
            .map(|t| (line_of(t.span().start), t.into_inner()))
            .collect(),
    })
}
