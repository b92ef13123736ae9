//! Reads and writes at a place of a scratch file, without its position.

use crate::error::{Error, Result};
use std::fs::File;
use std::path::Path;

/// What messages call a file that has no name.
const NAME: &str = "scratch file";

/// Fills `bytes` from `offset` on.
///
/// # Errors
/// When the operating system refuses or the file ends before.
pub(super) fn read_at(file: &File, bytes: &mut [u8], offset: u64) -> Result<()> {
    read(file, bytes, offset).map_err(|e| Error::io(Path::new(NAME), "reading it back", e))
}

/// Writes all of `bytes` at `offset`.
///
/// # Errors
/// When the operating system refuses.
pub(super) fn write_at(file: &File, bytes: &[u8], offset: u64) -> Result<()> {
    write(file, bytes, offset).map_err(|e| Error::io(Path::new(NAME), "writing", e))
}

#[cfg(unix)]
fn read(file: &File, bytes: &mut [u8], offset: u64) -> std::io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset)
}

#[cfg(unix)]
fn write(file: &File, bytes: &[u8], offset: u64) -> std::io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, offset)
}

#[cfg(windows)]
fn read(file: &File, mut bytes: &mut [u8], mut offset: u64) -> std::io::Result<()> {
    while !bytes.is_empty() {
        let n = std::os::windows::fs::FileExt::seek_read(file, bytes, offset)?;
        if n == 0 {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        bytes = &mut bytes[n..];
        offset += n as u64;
    }
    Ok(())
}

#[cfg(windows)]
fn write(file: &File, mut bytes: &[u8], mut offset: u64) -> std::io::Result<()> {
    while !bytes.is_empty() {
        let n = std::os::windows::fs::FileExt::seek_write(file, bytes, offset)?;
        if n == 0 {
            return Err(std::io::ErrorKind::WriteZero.into());
        }
        bytes = &bytes[n..];
        offset += n as u64;
    }
    Ok(())
}
