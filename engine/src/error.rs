//! The one error type: a kind that a program can match, and a message that a person can act on.

use std::fmt;
use std::path::Path;

/// What went wrong, for programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The operating system refused: file missing, permission, disk full.
    Io,
    /// An argument or an input makes no sense: dimensions, isovalue, region, seed.
    BadInput,
    /// The input is well formed but asks for something that is not supported.
    Unsupported,
    /// The file is not a brickmarch volume.
    NotAVolume,
    /// The file was written by a later version and names a feature that this one does not know.
    Newer,
    /// A checksum or a structural rule of the format does not hold.
    Damaged,
    /// The root of a volume is damaged; an older state is never shown in its place.
    DamagedRoot,
    /// The file ends before its content does.
    Truncated,
    /// A number in a file, or a count of the work, is beyond a stated limit.
    LimitExceeded,
    /// The memory budget does not allow the operation.
    BudgetExceeded,
    /// Another writer owns the volume.
    ForeignWriter,
    /// The writer saw a failed sync and refuses further work.
    Poisoned,
    /// The surface is empty: nothing crosses the isovalue.
    EmptySurface,
    /// The caller cancelled the operation.
    Cancelled,
}

/// An error with its kind and a one-line message that names file, place and remedy.
#[derive(Debug, thiserror::Error)]
pub struct Error {
    kind: ErrorKind,
    message: String,
}

/// Result of every fallible function of the engine.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl Error {
    /// Makes an error of `kind` with `message`.
    pub fn new(kind: ErrorKind, message: impl Into<String>) -> Self {
        Self {
            kind,
            message: message.into(),
        }
    }

    /// Shorthand for [`ErrorKind::BadInput`].
    pub fn bad_input(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::BadInput, message)
    }

    /// Wraps an operating system error that happened on `path` while `doing` ("reading the header").
    pub fn io(path: &Path, doing: &str, source: std::io::Error) -> Self {
        let kind = match source.kind() {
            std::io::ErrorKind::UnexpectedEof => ErrorKind::Truncated,
            std::io::ErrorKind::InvalidData => ErrorKind::Damaged,
            _ => ErrorKind::Io,
        };
        // The text of the system is part of the message, so it is not a source beside it.
        Self {
            kind,
            message: format!("{}: {doing}: {source}", path.display()),
        }
    }

    /// Puts `text` behind the message.
    #[must_use]
    pub(crate) fn followed_by(mut self, text: &str) -> Self {
        self.message.push_str(text);
        self
    }

    /// Puts `context` (usually a path) in front of the message.
    #[must_use]
    pub fn context(mut self, context: impl fmt::Display) -> Self {
        self.message = format!("{context}: {}", self.message);
        self
    }

    /// The kind, for programs.
    pub fn kind(&self) -> ErrorKind {
        self.kind
    }
}
