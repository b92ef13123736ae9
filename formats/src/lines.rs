//! Text lines on their way to a parser, changed as they pass.

use brickmarch::{Error, Result};
use std::io::{BufRead, ErrorKind, Read, Seek, SeekFrom};

/// Longest line that is read; a text file without line ends must not fill the memory.
const MOST_LINE_BYTES: u64 = 1 << 20;

/// Reads one line without its end into `line`; one that ends in a backslash goes on in the next,
/// unless it is a comment. Gives how many lines of the source that took, 0 at its end.
pub(crate) fn next_line(source: &mut impl BufRead, line: &mut Vec<u8>) -> std::io::Result<u64> {
    line.clear();
    let mut count = 0;
    loop {
        let room = MOST_LINE_BYTES - line.len() as u64;
        if source.take(room).read_until(b'\n', line)? == 0 {
            return Ok(count);
        }
        count += 1;
        if line.last() == Some(&b'\n') {
            line.pop();
        } else if line.len() as u64 == MOST_LINE_BYTES {
            return Err(std::io::Error::new(
                ErrorKind::InvalidData,
                "a line longer than 1 MiB",
            ));
        }
        if line.last() == Some(&b'\r') {
            line.pop();
        }
        if line.last() != Some(&b'\\') || line.trim_ascii_start().starts_with(b"#") {
            return Ok(count);
        }
        line.pop();
        line.push(b' ');
    }
}

/// A reader of what `rewrite` makes of the lines of `source`.
///
/// `rewrite` gets the number of a line (from 1) and its text, or nothing once at the end, and adds
/// the bytes that take its place. Its error ends the text and waits in `failure`.
pub(crate) struct Rewrite<R, F> {
    source: R,
    rewrite: F,
    number: u64,
    line: Vec<u8>,
    out: Vec<u8>,
    at: usize,
    ended: bool,
    pub(crate) failure: Option<Error>,
}

impl<R: BufRead, F: FnMut(Option<(u64, &str)>, &mut Vec<u8>) -> Result<()>> Rewrite<R, F> {
    pub(crate) fn new(source: R, rewrite: F) -> Self {
        Self {
            source,
            rewrite,
            number: 0,
            line: Vec::new(),
            out: Vec::new(),
            at: 0,
            ended: false,
            failure: None,
        }
    }

    fn advance(&mut self) -> std::io::Result<()> {
        self.out.clear();
        self.at = 0;
        let first = self.number + 1;
        let count = next_line(&mut self.source, &mut self.line)?;
        self.number += count;
        let text = String::from_utf8_lossy(&self.line);
        let line = (count > 0).then_some((first, &*text));
        self.ended = count == 0;
        (self.rewrite)(line, &mut self.out).map_err(|error| {
            let message = error.to_string();
            self.failure = Some(error);
            std::io::Error::new(ErrorKind::InvalidData, message)
        })
    }
}

impl<R: BufRead, F: FnMut(Option<(u64, &str)>, &mut Vec<u8>) -> Result<()>> Read for Rewrite<R, F> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        while self.at == self.out.len() {
            if self.ended {
                return Ok(0);
            }
            self.advance()?;
        }
        let count = buffer.len().min(self.out.len() - self.at);
        buffer[..count].copy_from_slice(&self.out[self.at..self.at + count]);
        self.at += count;
        Ok(count)
    }
}

/// Back to the start only, for parsers that look at the first line and begin again.
impl<R: BufRead + Seek, F> Seek for Rewrite<R, F> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        if to != SeekFrom::Start(0) {
            return Err(ErrorKind::Unsupported.into());
        }
        self.source.seek(to)?;
        self.number = 0;
        self.out.clear();
        self.at = 0;
        self.ended = false;
        Ok(0)
    }
}
