//! Files appear whole or not at all, and are replaced only when that was asked.

use brickmarch::{Error, Result};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Whether an existing file may be replaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Replace {
    Yes,
    No,
}

impl From<&crate::args::Overwrite> for Replace {
    fn from(args: &crate::args::Overwrite) -> Replace {
        if args.overwrite {
            Replace::Yes
        } else {
            Replace::No
        }
    }
}

/// Checks before the work starts that `path` can be written: its folder is there, and the file is
/// not, unless it may be replaced.
///
/// # Errors
/// Names the file and what to do.
pub(crate) fn check_target(path: &Path, replace: Replace) -> Result<()> {
    let folder = folder_of(path);
    if !folder.is_dir() {
        return Err(Error::bad_input(format!(
            "{}: there is no folder '{}': make it first",
            path.display(),
            folder.display()
        )));
    }
    if path.is_dir() {
        return Err(Error::bad_input(format!(
            "{}: is a folder: name a file in it",
            path.display()
        )));
    }
    if replace == Replace::No && path.exists() {
        return Err(Error::bad_input(format!(
            "{}: exists already: give --overwrite to replace it",
            path.display()
        )));
    }
    Ok(())
}

/// Writes a file aside, syncs it and gives it its name. Returns its size in bytes.
///
/// # Errors
/// When the file exists and may not be replaced, or writing fails; nothing is left then.
pub(crate) fn write_whole(
    path: &Path,
    replace: Replace,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<u64> {
    check_target(path, replace)?;
    let failed = |doing: &'static str| move |e| Error::io(path, doing, e);
    let aside = tempfile::Builder::new()
        .prefix(".brickmarch-")
        .tempfile_in(folder_of(path))
        .map_err(failed("creating a file beside it"))?;
    let copy = aside.as_file().try_clone().map_err(failed("writing"))?;
    let mut writer = BufWriter::new(copy);
    fill(&mut writer).map_err(failed("writing"))?;
    writer.flush().map_err(failed("writing"))?;
    aside.as_file().sync_all().map_err(failed("syncing"))?;
    let bytes = aside.as_file().metadata().map_err(failed("writing"))?.len();
    relax_mode(aside.as_file());
    match replace {
        Replace::Yes => aside.persist(path).map_err(|e| e.error),
        Replace::No => aside.persist_noclobber(path).map_err(|e| e.error),
    }
    .map_err(failed("giving it its name"))?;
    Ok(bytes)
}

/// Scratch files are private; a result has the mode that any new file would have.
fn relax_mode(file: &File) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mask =
            crate::system::status_field("Umask:").and_then(|v| u32::from_str_radix(&v, 8).ok());
        let mode = 0o666 & !mask.unwrap_or(0o022);
        // A file system without modes keeps its own.
        let _ = file.set_permissions(std::fs::Permissions::from_mode(mode));
    }
    #[cfg(not(unix))]
    let _ = file;
}

/// The folder of a file name, `.` where it names none.
pub(crate) fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}
