//! A file that is written aside and appears under its name whole, or not at all.

use brickmarch::{Error, Result};
use std::fs::File;
use std::path::{Path, PathBuf};
use tempfile::TempPath;

/// An output file in the making, in the folder where it will stay. Dropping it removes it.
#[derive(Debug)]
pub(crate) struct Aside {
    file: File,
    temporary: TempPath,
    path: PathBuf,
    overwrite: bool,
}

impl Aside {
    /// Starts the file that will be `path`.
    ///
    /// # Errors
    /// When `path` exists and `overwrite` is not given, or is no regular file, or its folder cannot
    /// be written.
    pub(crate) fn create(path: &Path, overwrite: bool) -> Result<Self> {
        if let Ok(found) = std::fs::symlink_metadata(path) {
            if !found.is_file() && !found.is_symlink() {
                return Err(Error::bad_input(format!(
                    "{}: is not a regular file and cannot be replaced by one",
                    path.display()
                )));
            }
            if !overwrite {
                return Err(exists(path));
            }
        }
        let Some(name) = path.file_name() else {
            return Err(Error::bad_input(format!(
                "{}: names no file",
                path.display()
            )));
        };
        let mut prefix = name.to_os_string();
        prefix.push(".tmp-");
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix);
        #[cfg(unix)]
        {
            // The process mask applies; the default of the crate would keep others from reading.
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let (file, temporary) = builder
            .tempfile_in(folder(path))
            .map_err(|e| Error::io(path, "cannot write in its folder", e))?
            .into_parts();
        Ok(Self {
            file,
            temporary,
            path: path.to_path_buf(),
            overwrite,
        })
    }

    /// A nameless file in the same folder, gone when closed.
    pub(crate) fn scratch(&self) -> Result<File> {
        scratch_beside(&self.path)
    }

    /// The final name.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The open file.
    pub(crate) fn file(&self) -> &File {
        &self.file
    }

    /// Syncs the file and gives it its name.
    ///
    /// # Errors
    /// When the operating system refuses, or another file took the name meanwhile and `overwrite`
    /// was not given. The file is removed then.
    pub(crate) fn commit(self) -> Result<()> {
        self.file
            .sync_all()
            .map_err(|e| Error::io(&self.path, "syncing", e))?;
        let named = if self.overwrite {
            self.temporary.persist(&self.path)
        } else {
            self.temporary.persist_noclobber(&self.path)
        };
        if let Err(refused) = named {
            if refused.error.kind() == std::io::ErrorKind::AlreadyExists {
                return Err(exists(&self.path));
            }
            return Err(Error::io(
                &self.path,
                "renaming the finished file",
                refused.error,
            ));
        }
        // The name is durable only when the folder is. Not every system can open a folder.
        #[cfg(unix)]
        File::open(folder(&self.path))
            .and_then(|folder| folder.sync_all())
            .map_err(|e| Error::io(&self.path, "syncing its folder", e))?;
        Ok(())
    }
}

/// A nameless file in the folder of `path`, gone when closed.
pub(crate) fn scratch_beside(path: &Path) -> Result<File> {
    tempfile::tempfile_in(folder(path))
        .map_err(|e| Error::io(path, "making a scratch file in its folder", e))
}

fn exists(path: &Path) -> Error {
    Error::bad_input(format!(
        "{}: exists already; --overwrite replaces it",
        path.display()
    ))
}

fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Fills `bytes` from `offset` on.
#[cfg(unix)]
pub(crate) fn read_exact_at(file: &File, bytes: &mut [u8], offset: u64) -> std::io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset)
}

/// Fills `bytes` from `offset` on; the position of the file is not meaningful afterwards.
#[cfg(windows)]
pub(crate) fn read_exact_at(
    file: &File,
    mut bytes: &mut [u8],
    mut offset: u64,
) -> std::io::Result<()> {
    use std::os::windows::fs::FileExt;
    while !bytes.is_empty() {
        let n = file.seek_read(bytes, offset)?;
        if n == 0 {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        bytes = &mut bytes[n..];
        offset += n as u64;
    }
    Ok(())
}

/// Writes all of `bytes` at `offset` without moving the position of the file.
#[cfg(unix)]
pub(crate) fn write_all_at(file: &File, bytes: &[u8], offset: u64) -> std::io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, offset)
}

/// Writes all of `bytes` at `offset`; the position of the file is not meaningful afterwards.
#[cfg(windows)]
pub(crate) fn write_all_at(file: &File, mut bytes: &[u8], mut offset: u64) -> std::io::Result<()> {
    use std::os::windows::fs::FileExt;
    while !bytes.is_empty() {
        let written = file.seek_write(bytes, offset)?;
        if written == 0 {
            return Err(std::io::ErrorKind::WriteZero.into());
        }
        bytes = &bytes[written..];
        offset += written as u64;
    }
    Ok(())
}
