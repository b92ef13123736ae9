//! Many tasks in one memory budget: a job file becomes a plan, the plan is run by this program
//! itself, one process per task, and a journal says what need not be done again.
//!
//! A process per task keeps one bad input from taking the others down, and gives all memory of a
//! task back at its end. Outputs are made in a folder of their own and moved to their place whole.

mod child;
mod file;
mod inputs;
mod journal;
mod plan;
mod report;
mod run;
mod tiles;

pub(crate) use journal::Journal;
pub(crate) use plan::Plan;
pub(crate) use report::{Report, dry_run};
pub(crate) use run::{Limits, run};

use brickmarch::{Error, Result};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// The folder of a batch for what it keeps of itself, inside the folder of the outputs.
pub(crate) fn own_folder(out: &Path) -> PathBuf {
    out.join(".brickmarch-batch")
}

/// What is seen of a file without reading it.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(crate) struct Seen {
    pub path: PathBuf,
    pub bytes: u64,
    /// Time of the last change in nanoseconds since 1970.
    pub changed: u128,
}

impl Seen {
    /// # Errors
    /// When there is no such file.
    pub(crate) fn at(path: &Path) -> Result<Seen> {
        let failed = |e| Error::io(path, "looking at the file", e);
        let meta = std::fs::metadata(path).map_err(failed)?;
        let changed = meta.modified().map_err(failed)?;
        Ok(Seen {
            path: path.to_path_buf(),
            bytes: meta.len(),
            changed: changed
                .duration_since(UNIX_EPOCH)
                .map_or(0, |d| d.as_nanos()),
        })
    }

    /// Whether the file is still as it was.
    pub(crate) fn still(&self) -> bool {
        Seen::at(&self.path).is_ok_and(|now| now == *self)
    }
}
