//! One task as a process of its own, which dies with the batch.

use super::Seen;
use super::plan::Task;
use brickmarch::{Error, Result};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Instant;

/// Bytes of what a task says that are read.
const MAX_SAID: u64 = 1 << 20;

/// A task that runs.
pub(super) struct Running {
    pub number: usize,
    pub mem: u64,
    pub tries: u32,
    child: Child,
    folder: PathBuf,
    started: Instant,
}

/// What came of it.
pub(super) struct Ended {
    pub status: ExitStatus,
    pub seconds: f64,
    /// The JSON object of the command; null when it said nothing that can be read.
    pub result: serde_json::Value,
    /// The last line of its standard error.
    pub error: String,
}

/// What a task may use.
pub(super) struct Share {
    pub mem: u64,
    pub threads: usize,
}

impl Running {
    /// Starts a task in `base`; it works in `folder`, where an import may find what it left before.
    ///
    /// # Errors
    /// What the system reports.
    pub(super) fn start(
        number: usize,
        task: &Task,
        base: &Path,
        folder: PathBuf,
        share: &Share,
        tries: u32,
    ) -> Result<Running> {
        // What an import has committed is worth keeping, unless going on with it has failed.
        tidy(&folder, task.takes("resume") && tries == 1)?;
        let program = std::env::current_exe()
            .map_err(|e| Error::io(Path::new("brickmarch"), "finding this program", e))?;
        let said = |name: &str| {
            let path = folder.join(name);
            File::create(&path).map_err(|e| Error::io(&path, "creating the file", e))
        };
        let mut command = Command::new(program);
        command
            .args(task.words(&folder))
            .args(["--json", "--progress=none"])
            .arg(format!("--die-with-parent={}", std::process::id()))
            .arg(format!("--mem={}", share.mem))
            .current_dir(base)
            .stdin(Stdio::null())
            .stdout(said(SAID)?)
            .stderr(said(ERRORS)?);
        if task.takes("threads") {
            command.arg(format!("--threads={}", share.threads));
        }
        if task.takes("overwrite") {
            command.arg("--overwrite");
        }
        if task.takes("resume") && tries == 1 {
            command.arg("--resume");
        }
        let child = command
            .spawn()
            .map_err(|e| Error::io(&folder, "starting a task", e))?;
        Ok(Running {
            number,
            mem: share.mem,
            tries,
            child,
            folder,
            started: Instant::now(),
        })
    }

    /// What came of the task, when it is over.
    ///
    /// # Errors
    /// What the system reports.
    pub(super) fn ended(&mut self) -> Result<Option<Ended>> {
        let status = self
            .child
            .try_wait()
            .map_err(|e| Error::io(&self.folder, "waiting for a task", e))?;
        Ok(status.map(|status| Ended {
            status,
            seconds: self.started.elapsed().as_secs_f64(),
            result: serde_json::from_str(&read(&self.folder.join(SAID))).unwrap_or_default(),
            error: last_line(&read(&self.folder.join(ERRORS)), status),
        }))
    }

    /// Asks the task to stop and waits until it has.
    pub(super) fn stop(mut self) {
        #[cfg(unix)]
        if let Some(pid) = i32::try_from(self.child.id())
            .ok()
            .and_then(rustix::process::Pid::from_raw)
        {
            let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        }
        let asked = Instant::now();
        while let Ok(None) = self.child.try_wait() {
            if asked.elapsed().as_secs() >= 10 {
                let _ = self.child.kill();
            }
            std::thread::sleep(super::run::TICK);
        }
    }

    /// Moves what the task has made to the folder of its output.
    ///
    /// # Errors
    /// What the medium reports.
    pub(super) fn deliver(&self, task: &Task) -> Result<Vec<Seen>> {
        let mut seen = Vec::new();
        if let Some(to) = task.output.as_deref().and_then(Path::parent) {
            std::fs::create_dir_all(to).map_err(|e| Error::io(to, "making the folder", e))?;
            for from in files(&self.folder)? {
                let name = from.file_name().unwrap_or_default();
                if name == SAID || name == ERRORS {
                    continue;
                }
                let place = to.join(name);
                if place.is_dir() {
                    return Err(Error::bad_input(format!(
                        "{}: is a folder: a file has to go there",
                        place.display()
                    )));
                }
                std::fs::rename(&from, &place)
                    .map_err(|e| Error::io(&place, "moving the output to its place", e))?;
                seen.push(Seen::at(&place)?);
            }
        }
        seen.sort_by(|a, b| a.path.cmp(&b.path));
        Ok(seen)
    }

    /// Removes the folder that the task worked in.
    pub(super) fn clear(&self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

const SAID: &str = ".said";
const ERRORS: &str = ".errors";

/// Empties the folder of a task, or makes it; `keep` leaves imports that can be gone on with.
fn tidy(folder: &Path, keep: bool) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "making the folder", e))?;
    for path in files(folder)? {
        if !(keep && path.extension().is_some_and(|e| e == "partial")) {
            std::fs::remove_file(&path)
                .map_err(|e| Error::io(&path, "removing what an earlier try left", e))?;
        }
    }
    Ok(())
}

fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let failed = |e| Error::io(folder, "listing the folder", e);
    let mut out = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        out.push(entry.map_err(failed)?.path());
    }
    Ok(out)
}

fn read(path: &Path) -> String {
    let mut bytes = Vec::new();
    if let Ok(file) = File::open(path) {
        let _ = file.take(MAX_SAID).read_to_end(&mut bytes);
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

fn last_line(text: &str, status: ExitStatus) -> String {
    let last = text.lines().rfind(|l| !l.trim().is_empty());
    let last = last.map(|l| l.strip_prefix("brickmarch: ").unwrap_or(l));
    match (last, status.code()) {
        (Some(line), _) => line.to_string(),
        (None, Some(3)) => "finished, but the result is not what was asked".to_string(),
        (None, _) => format!("ended without a word: {status}"),
    }
}
