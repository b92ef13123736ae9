//! Files that appear whole or not at all: written aside under a temporary name, then renamed.

use crate::error::{Error, ErrorKind, Result};
use std::fs::{File, OpenOptions};
use std::path::{Path, PathBuf};

/// The temporary file; removed when dropped.
pub(crate) struct Aside {
    path: PathBuf,
    renamed: bool,
}

impl Drop for Aside {
    fn drop(&mut self) {
        if !self.renamed {
            // Nothing can be done about a failure here; the name says that it is temporary.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

impl Aside {
    /// A file that is already there under its temporary name.
    pub(crate) fn existing(path: PathBuf) -> Self {
        Self {
            path,
            renamed: false,
        }
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Leaves the file where it is.
    pub(crate) fn keep(mut self) {
        self.renamed = true;
    }

    /// Gives the file its final name, and makes that survive a loss of power.
    pub(crate) fn rename(mut self, to: &Path) -> Result<()> {
        std::fs::rename(&self.path, to)
            .map_err(|e| Error::io(to, &format!("renaming {}", self.path.display()), e))?;
        self.renamed = true;
        sync_folder_of(to)
    }
}

pub(crate) fn create_aside(path: &Path) -> Result<(File, Aside)> {
    let name = path
        .file_name()
        .ok_or_else(|| Error::bad_input(format!("{}: not the name of a file", path.display())))?;
    for attempt in 0..1000u32 {
        let mut aside = name.to_os_string();
        aside.push(format!(".tmp-{}-{attempt}", std::process::id()));
        let aside = path.with_file_name(aside);
        match OpenOptions::new()
            .read(true)
            .write(true)
            .create_new(true)
            .open(&aside)
        {
            Ok(file) => {
                return Ok((
                    file,
                    Aside {
                        path: aside,
                        renamed: false,
                    },
                ));
            }
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(Error::io(&aside, "creating the file", e)),
        }
    }
    Err(Error::new(
        ErrorKind::Io,
        format!(
            "{}: a thousand temporary files are left over: remove them",
            path.display()
        ),
    ))
}

/// Makes the rename survive a loss of power.
fn sync_folder_of(path: &Path) -> Result<()> {
    #[cfg(unix)]
    {
        let folder = path
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        File::open(folder)
            .and_then(|f| f.sync_all())
            .map_err(|e| Error::io(folder, "syncing the folder", e))?;
    }
    #[cfg(not(unix))]
    let _ = path;
    Ok(())
}
