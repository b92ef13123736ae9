//! The volumes that are served, and which of them are open.
//!
//! An open level of a volume has a share of the budget of its own, so that the caches of one never
//! starve another; the share is under permit. The share that was not used for longest is given up
//! for another level. A request keeps what it reads: what it sees is one generation of the file.

use super::refusal::Refusal;
use brickmarch::store::Volume;
use brickmarch::{Budget, Permit, Result};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Levels open at one time at most.
const OPEN_MAX: u64 = 6;
/// How long a file is taken to be as it was.
const FRESH: Duration = Duration::from_secs(1);

/// A level of a volume, as one generation of its file has it.
pub(super) struct Shown {
    pub(super) volume: Volume,
    place: usize,
    level: u8,
    file: Option<FileNumber>,
    checked: Mutex<Instant>,
    _share: Permit,
}

/// A volume that can be asked for.
struct Entry {
    /// In addresses.
    name: String,
    path: PathBuf,
    /// In its file.
    inner: String,
}

/// Volumes by name.
pub(super) struct Shelf {
    entries: Vec<Entry>,
    /// The one used last is last.
    open: Mutex<Vec<Arc<Shown>>>,
    open_max: usize,
    share: u64,
    budget: Budget,
}

/// Enough to open a volume and see its root page.
const PROBE_BYTES: u64 = 2 << 20;

/// What tells whether a path leads to another file than before.
type FileNumber = (u64, u64);

impl Shelf {
    /// Opens every file once, to see that it can be read and what is in it.
    ///
    /// # Errors
    /// What opening a volume reports.
    pub(super) fn open(paths: &[PathBuf], budget: &Budget) -> Result<Shelf> {
        let mut entries: Vec<Entry> = Vec::new();
        let mut levels = 0;
        for path in paths {
            let first = Volume::open(path, budget)?;
            let stem = path.file_stem().unwrap_or_default().to_string_lossy();
            let several = first.names().len() > 1;
            for inner in first.names() {
                let wanted = if several {
                    format!("{stem}:{inner}")
                } else {
                    stem.to_string()
                };
                let taken = |name: &str| entries.iter().any(|e| e.name == name);
                let name = (1..)
                    .map(|n| {
                        if n == 1 {
                            wanted.clone()
                        } else {
                            format!("{wanted}-{n}")
                        }
                    })
                    .find(|name| !taken(name))
                    .expect("the numbers do not end");
                entries.push(Entry {
                    name,
                    path: path.clone(),
                    inner: inner.clone(),
                });
                levels += 1 + u64::from(Volume::open_named(path, inner, budget)?.levels());
            }
        }
        let open_max = levels.clamp(1, OPEN_MAX);
        Ok(Shelf {
            entries,
            open: Mutex::default(),
            open_max: open_max as usize,
            share: budget.memory_bytes() / 2 / open_max,
            budget: budget.clone(),
        })
    }

    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.iter().map(|e| e.name.as_str())
    }

    /// The level of a volume in the newest generation that its file has (or had a second ago).
    ///
    /// # Errors
    /// 404 for a name that is not served, 400 for a level that there is not, 503 when all shares are
    /// in use, and what opening reports.
    pub(super) fn get(&self, name: &str, level: u8) -> Result<Arc<Shown>, Refusal> {
        let Some(place) = self.entries.iter().position(|e| e.name == name) else {
            let names: Vec<&str> = self.names().take(20).collect();
            return Err(Refusal::missing(format!(
                "no volume {}; there are: {}",
                super::query::quoted(name),
                names.join(", ")
            )));
        };
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let found = open
            .iter()
            .position(|s| (s.place, s.level) == (place, level));
        let shown = match found.map(|at| open.remove(at)) {
            Some(shown) => self.refreshed(shown)?,
            None => {
                while open.len() >= self.open_max {
                    // The oldest that nobody reads.
                    let idle = open.iter().position(|s| Arc::strong_count(s) == 1);
                    open.remove(idle.ok_or_else(Refusal::busy)?);
                }
                let share = self.budget.try_take(self.share).ok_or_else(Refusal::busy)?;
                self.load(place, level, share)?
            }
        };
        open.push(shown.clone());
        Ok(shown)
    }

    fn load(&self, place: usize, level: u8, share: Permit) -> Result<Arc<Shown>, Refusal> {
        let entry = &self.entries[place];
        let budget = Budget::bytes(share.bytes()).with_threads(self.budget.threads());
        let file = file_number(&entry.path);
        let volume = Volume::open_named(&entry.path, &entry.inner, &budget)?;
        let volume = if level == 0 {
            volume
        } else if level <= volume.levels() {
            volume.level(level)?
        } else {
            return Err(Refusal::bad(format!(
                "no level {level}: the coarsest is {}",
                volume.levels()
            )));
        };
        Ok(Arc::new(Shown {
            volume,
            place,
            level,
            file,
            checked: Mutex::new(Instant::now()),
            _share: share,
        }))
    }

    /// The same level after a look at its file. Where nobody reads it goes on in place and keeps what
    /// is cached; otherwise it is opened anew beside, where there is memory for that.
    fn refreshed(&self, mut shown: Arc<Shown>) -> Result<Arc<Shown>, Refusal> {
        {
            let mut checked = shown.checked.lock().unwrap_or_else(PoisonError::into_inner);
            if checked.elapsed() < FRESH {
                drop(checked);
                return Ok(shown);
            }
            *checked = Instant::now();
        }
        let (place, level) = (shown.place, shown.level);
        let replaced = file_number(&self.entries[place].path) != shown.file;
        if let (false, Some(alone)) = (replaced, Arc::get_mut(&mut shown)) {
            let before = alone.volume.generation();
            let still = alone.volume.refresh();
            // A level may be built of older samples now; only opening tells.
            if still.is_ok() && (level == 0 || alone.volume.generation() == before) {
                return Ok(shown);
            }
        }
        let share = match Arc::strong_count(&shown) {
            1 => {
                drop(shown);
                self.budget.try_take(self.share).ok_or_else(Refusal::busy)?
            }
            _ if !replaced && self.is_newest(&shown) => return Ok(shown),
            _ => match self.budget.try_take(self.share) {
                Some(share) => share,
                None => return Ok(shown),
            },
        };
        self.load(place, level, share)
    }

    /// Whether the file has no newer generation, as far as can be told now.
    fn is_newest(&self, shown: &Shown) -> bool {
        let entry = &self.entries[shown.place];
        let Some(permit) = self.budget.try_take(PROBE_BYTES) else {
            return true;
        };
        let budget = Budget::bytes(permit.bytes());
        let newest = Volume::open_named(&entry.path, &entry.inner, &budget);
        newest.is_ok_and(|v| {
            (v.file_mark(), v.generation()) == (shown.volume.file_mark(), shown.volume.generation())
        })
    }
}

impl Shown {
    /// What an answer about this level depends on, as the text of an entity tag: file, generation
    /// and the version of this program.
    pub(super) fn tag(&self) -> String {
        format!(
            "\"{:08x}-{}-{}-{}\"",
            self.volume.file_mark(),
            self.volume.generation(),
            self.level,
            env!("CARGO_PKG_VERSION")
        )
    }
}

#[cfg(unix)]
fn file_number(path: &Path) -> Option<FileNumber> {
    use std::os::unix::fs::MetadataExt;
    let meta = std::fs::metadata(path).ok()?;
    Some((meta.dev(), meta.ino()))
}

#[cfg(not(unix))]
fn file_number(_path: &Path) -> Option<FileNumber> {
    None
}
