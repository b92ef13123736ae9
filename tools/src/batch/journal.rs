//! What of a batch is finished: one line per task, synced, in a file that only grows.

use super::{Seen, own_folder};
use crate::batch::plan::{Plan, Task};
use brickmarch::{Error, ErrorKind, Result};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};

/// A line: a task that was finished.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Entry {
    /// The task as it is told from others: its command line without limits.
    pub key: String,
    pub input: Seen,
    pub outputs: Vec<Seen>,
    pub seconds: f64,
    pub tries: u32,
    /// What the task said of itself.
    pub result: serde_json::Value,
}

/// The journal of a folder, held by one batch at a time.
pub(crate) struct Journal {
    path: PathBuf,
    file: File,
    entries: HashMap<String, Entry>,
}

impl Journal {
    /// Opens the journal of the outputs in `out`, or begins one. A line that a kill has cut off is
    /// dropped.
    ///
    /// # Errors
    /// `ForeignWriter` while another batch has it; what the medium reports.
    pub(crate) fn open(out: &Path) -> Result<Journal> {
        let folder = own_folder(out);
        std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, "making the folder", e))?;
        let path = folder.join("journal");
        let failed = |doing: &'static str| {
            let path = path.clone();
            move |e| Error::io(&path, doing, e)
        };
        let file = OpenOptions::new()
            .read(true)
            .append(true)
            .create(true)
            .open(&path)
            .map_err(failed("opening the journal"))?;
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => {
                return Err(Error::new(
                    ErrorKind::ForeignWriter,
                    format!(
                        "{}: another batch works in this folder: wait for it, or give another `out`",
                        out.display()
                    ),
                ));
            }
            // Where a file system has no locks two batches are the user's affair.
            Ok(()) | Err(TryLockError::Error(_)) => {}
        }
        let (entries, whole) = read(&file).map_err(failed("reading the journal"))?;
        file.set_len(whole).map_err(failed("cutting the journal"))?;
        Ok(Journal {
            path,
            file,
            entries,
        })
    }

    /// What is known of the task, when its input and its outputs are as they were.
    pub(crate) fn finished(&self, task: &Task) -> Option<&Entry> {
        let entry = self.entries.get(&task.key)?;
        let same = entry.input.still() && entry.outputs.iter().all(Seen::still);
        (same && entry.input.path == task.input).then_some(entry)
    }

    /// The same for a task of the plan; nothing need be done for a part whose mesh is there.
    pub(crate) fn kept(&self, plan: &Plan, number: usize) -> Option<&Entry> {
        let task = &plan.tasks[number];
        let whole = || self.finished(&plan.tasks[task.part_for?]);
        self.finished(task).or_else(whole)
    }

    /// Adds a line, on the medium when this returns.
    ///
    /// # Errors
    /// What the medium reports.
    pub(crate) fn add(&mut self, entry: Entry) -> Result<()> {
        let mut line = serde_json::to_vec(&entry).expect("an entry is plain data");
        line.push(b'\n');
        self.file
            .write_all(&line)
            .and_then(|()| self.file.sync_data())
            .map_err(|e| Error::io(&self.path, "writing the journal", e))?;
        self.entries.insert(entry.key.clone(), entry);
        Ok(())
    }
}

/// The entries, later ones over earlier ones, and the length of what is whole.
fn read(file: &File) -> std::io::Result<(HashMap<String, Entry>, u64)> {
    let mut reader = BufReader::new(file);
    let (mut entries, mut whole) = (HashMap::new(), 0);
    let mut line = Vec::new();
    loop {
        line.clear();
        let n = reader.read_until(b'\n', &mut line)? as u64;
        let entry = serde_json::from_slice::<Entry>(&line);
        match entry {
            Ok(entry) if line.ends_with(b"\n") => {
                entries.insert(entry.key.clone(), entry);
                whole += n;
            }
            // The end, or what a kill has left of a line: tasks behind it are done again.
            _ => return Ok((entries, whole)),
        }
    }
}
