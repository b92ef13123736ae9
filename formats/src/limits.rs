//! Limits of what an importer believes: every number from a file passes here before it is used to
//! allocate, to multiply or to seek.

use brickmarch::{Box3, Error, ErrorKind, Result};
use std::path::Path;

/// A header, or the text part of a file, is at most this long.
pub const HEADER_BYTES_MAX: u64 = 1 << 20;

/// Samples per axis are at most this many; the limit of the volume file.
pub const AXIS_SAMPLES_MAX: i128 = 1 << 27;

/// The samples of one volume take at most this many bytes.
pub const VOLUME_BYTES_MAX: u128 = 1 << 60;

/// The domain `0..dims`, after every axis and the product were checked.
///
/// # Errors
/// `BadInput` for an axis that is zero or negative, `LimitExceeded` for one beyond
/// [`AXIS_SAMPLES_MAX`] or a volume beyond [`VOLUME_BYTES_MAX`].
pub(crate) fn domain(path: &Path, dims: [i128; 3], sample_bytes: usize) -> Result<Box3> {
    let shown = || format!("{} x {} x {}", dims[0], dims[1], dims[2]);
    if dims.iter().any(|&n| n <= 0) {
        return Err(at(
            path,
            ErrorKind::BadInput,
            format!(
                "the dimensions {} are not positive: a volume needs at least one sample on every axis",
                shown()
            ),
        ));
    }
    if dims.iter().any(|&n| n > AXIS_SAMPLES_MAX) {
        return Err(at(
            path,
            ErrorKind::LimitExceeded,
            format!(
                "the dimensions {} exceed the limit of {AXIS_SAMPLES_MAX} samples per axis",
                shown()
            ),
        ));
    }
    let bytes = dims
        .iter()
        .fold(sample_bytes as u128, |product, &n| product * n as u128);
    if bytes > VOLUME_BYTES_MAX {
        return Err(at(
            path,
            ErrorKind::LimitExceeded,
            format!(
                "the dimensions {} ask for {bytes} bytes, the limit is {VOLUME_BYTES_MAX}",
                shown()
            ),
        ));
    }
    Ok(Box3::from_size(dims.map(|n| n as i32)))
}

/// Compares the bytes that the header asks for with those that are there. Gives the surplus.
///
/// # Errors
/// `Truncated`, naming both numbers.
pub(crate) fn surplus(path: &Path, needed: u64, found: u64) -> Result<u64> {
    found.checked_sub(needed).ok_or_else(|| {
        at(
            path,
            ErrorKind::Truncated,
            format!(
                "the header asks for {needed} bytes of samples, the file has {found}: \
                 it is cut short, or the header is wrong"
            ),
        )
    })
}

/// An error at `path`.
pub(crate) fn at(path: &Path, kind: ErrorKind, message: impl Into<String>) -> Error {
    Error::new(kind, message).context(path.display())
}

/// A `BadInput` at `path`.
pub(crate) fn bad(path: &Path, message: impl Into<String>) -> Error {
    at(path, ErrorKind::BadInput, message)
}

/// An `Unsupported` at `path`.
pub(crate) fn unsupported(path: &Path, message: impl Into<String>) -> Error {
    at(path, ErrorKind::Unsupported, message)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absurd_dimensions_are_refused() {
        let check = |dims| domain(Path::new("x"), dims, 4);
        assert_eq!(check([3, 2, 1]).expect("fine").size(), [3, 2, 1]);
        for (dims, kind) in [
            ([0, 1, 1], ErrorKind::BadInput),
            ([1, -1, 1], ErrorKind::BadInput),
            ([1, 1, AXIS_SAMPLES_MAX + 1], ErrorKind::LimitExceeded),
            ([AXIS_SAMPLES_MAX; 3], ErrorKind::LimitExceeded),
            ([i128::MAX; 3], ErrorKind::LimitExceeded),
        ] {
            assert_eq!(check(dims).expect_err("absurd").kind(), kind, "{dims:?}");
        }
    }

    #[test]
    fn a_short_file_names_both_numbers() {
        let error = surplus(Path::new("x"), 10, 9).expect_err("short");
        assert_eq!(error.kind(), ErrorKind::Truncated);
        assert!(error.to_string().contains("10 bytes"), "{error}");
        assert_eq!(surplus(Path::new("x"), 10, 12).expect("enough"), 2);
    }
}
