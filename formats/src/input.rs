//! A source file as a byte stream: plain, or gzip unwrapped on the fly.

use crate::limits::{HEADER_BYTES_MAX, bad};
use crate::volume::PlainSamples;
use brickmarch::{Error, ErrorKind, Result};
use flate2::bufread::GzDecoder;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

const BUFFER_BYTES: usize = 64 << 10;

/// Bytes at the start that tell formats apart; NIfTI-1 has its magic at 344.
const HEAD_BYTES: u64 = 1024;

pub(crate) const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];

/// What is noticed only while the samples are read. Clones share the list.
#[derive(Clone, Debug, Default)]
pub(crate) struct LateNotes(Arc<Mutex<Vec<String>>>);

impl LateNotes {
    pub(crate) fn add(&self, note: String) {
        self.0.lock().expect("no panic under the lock").push(note);
    }

    pub(crate) fn get(&self) -> Vec<String> {
        self.0.lock().expect("no panic under the lock").clone()
    }
}

/// An open source file at some position of its (unwrapped) bytes.
pub(crate) struct Input {
    pub(crate) path: PathBuf,
    /// The first bytes, unwrapped; fewer only where the file is shorter.
    pub(crate) head: Vec<u8>,
    pub(crate) late: LateNotes,
    stream: Stream,
    /// Bytes of the whole file; `None` where the file is compressed.
    length: Option<u64>,
    position: u64,
}

enum Stream {
    Plain(BufReader<File>),
    Gzip(Box<BufReader<Members<BufReader<File>>>>),
}

impl Input {
    /// Opens a regular file and leaves its bytes as they are.
    pub(crate) fn open_plain(path: &Path) -> Result<Input> {
        let (file, length) = open_file(path)?;
        let mut input = Input {
            path: path.to_owned(),
            head: Vec::new(),
            late: LateNotes::default(),
            stream: Stream::Plain(BufReader::with_capacity(BUFFER_BYTES, file)),
            length: Some(length),
            position: 0,
        };
        input.head = input.read_up_to(HEAD_BYTES)?;
        input.seek_to(0)?;
        Ok(input)
    }

    /// Opens a regular file; unwraps it where it starts as gzip does.
    pub(crate) fn open(path: &Path) -> Result<Input> {
        let plain = Input::open_plain(path)?;
        if !plain.head.starts_with(&GZIP_MAGIC) {
            return Ok(plain);
        }
        let late = LateNotes::default();
        let mut first = unwrap(open_file(path)?.0, path, &late);
        let mut head = Vec::new();
        // A damaged stream shows itself again, with a message, when the header is read.
        let _ = first.by_ref().take(HEAD_BYTES).read_to_end(&mut head);
        let late = LateNotes::default();
        let stream = Stream::Gzip(Box::new(unwrap(open_file(path)?.0, path, &late)));
        Ok(Input {
            path: path.to_owned(),
            head,
            late,
            stream,
            length: None,
            position: 0,
        })
    }

    pub(crate) fn is_gzip(&self) -> bool {
        matches!(self.stream, Stream::Gzip(_))
    }

    /// Bytes from here to the end; `None` where only reading can tell.
    pub(crate) fn remaining(&self) -> Option<u64> {
        self.length.map(|n| n.saturating_sub(self.position))
    }

    /// The file from here on, opened once more, where it is not compressed.
    pub(crate) fn plain(&self) -> Result<Option<PlainSamples>> {
        let Stream::Plain(stream) = &self.stream else {
            return Ok(None);
        };
        let file = stream
            .get_ref()
            .try_clone()
            .map_err(|e| Error::io(&self.path, "opening", e))?;
        Ok(Some(PlainSamples {
            file,
            offset: self.position,
        }))
    }

    fn seek_to(&mut self, position: u64) -> Result<()> {
        if let Stream::Plain(file) = &mut self.stream {
            file.seek(SeekFrom::Start(position))
                .map_err(|e| Error::io(&self.path, "seeking", e))?;
            self.position = position;
        }
        Ok(())
    }

    /// Goes `bytes` forward.
    ///
    /// # Errors
    /// `Truncated` when there are fewer.
    pub(crate) fn skip(&mut self, bytes: u64, what: &str) -> Result<()> {
        let skipped = match self.remaining() {
            Some(rest) => {
                if bytes <= rest {
                    self.seek_to(self.position + bytes)?;
                }
                rest.min(bytes)
            }
            None => io::copy(&mut self.by_ref().take(bytes), &mut io::sink())
                .map_err(|e| Error::io(&self.path, what, e))?,
        };
        if skipped < bytes {
            return Err(self.ends_inside(what, bytes, skipped));
        }
        Ok(())
    }

    /// The next `bytes` bytes, a number of our own and not of the file.
    ///
    /// # Errors
    /// `Truncated` when there are fewer.
    pub(crate) fn read_array(&mut self, bytes: u64, what: &str) -> Result<Vec<u8>> {
        let read = self.read_up_to(bytes)?;
        if (read.len() as u64) < bytes {
            return Err(self.ends_inside(what, bytes, read.len() as u64));
        }
        Ok(read)
    }

    fn read_up_to(&mut self, bytes: u64) -> Result<Vec<u8>> {
        let path = self.path.clone();
        let mut read = Vec::new();
        self.take(bytes)
            .read_to_end(&mut read)
            .map_err(|e| Error::io(&path, "reading the header", e))?;
        Ok(read)
    }

    /// The next line of a text header without its end; `None` at the end of the file. Bytes that
    /// are not UTF-8 are replaced.
    ///
    /// # Errors
    /// When the header would be longer than [`HEADER_BYTES_MAX`].
    pub(crate) fn header_line(&mut self) -> Result<Option<String>> {
        let allowed = HEADER_BYTES_MAX.saturating_sub(self.position);
        let path = self.path.clone();
        let mut line = Vec::new();
        self.take(allowed)
            .read_until(b'\n', &mut line)
            .map_err(|e| Error::io(&path, "reading the header", e))?;
        if line.last() != Some(&b'\n') && line.len() as u64 == allowed {
            return Err(bad(
                &self.path,
                format!("the header is longer than {HEADER_BYTES_MAX} bytes"),
            ));
        }
        if line.is_empty() {
            return Ok(None);
        }
        while matches!(line.last(), Some(b'\n' | b'\r')) {
            line.pop();
        }
        Ok(Some(String::from_utf8_lossy(&line).into_owned()))
    }

    fn ends_inside(&self, what: &str, expected: u64, found: u64) -> Error {
        crate::limits::at(
            &self.path,
            ErrorKind::Truncated,
            format!("the file ends inside {what}: {expected} bytes expected, {found} found"),
        )
    }
}

impl Read for Input {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let n = match &mut self.stream {
            Stream::Plain(r) => r.read(out),
            Stream::Gzip(r) => r.read(out),
        }?;
        self.position += n as u64;
        Ok(n)
    }
}

impl BufRead for Input {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        match &mut self.stream {
            Stream::Plain(r) => r.fill_buf(),
            Stream::Gzip(r) => r.fill_buf(),
        }
    }

    fn consume(&mut self, n: usize) {
        self.position += n as u64;
        match &mut self.stream {
            Stream::Plain(r) => r.consume(n),
            Stream::Gzip(r) => r.consume(n),
        }
    }
}

/// A regular file and its length. Pipes and devices have no length to check against.
fn open_file(path: &Path) -> Result<(File, u64)> {
    let opening = |e| Error::io(path, "opening", e);
    let meta = std::fs::metadata(path).map_err(opening)?;
    if !meta.is_file() {
        return Err(bad(path, "not a regular file"));
    }
    Ok((File::open(path).map_err(opening)?, meta.len()))
}

fn unwrap(file: File, path: &Path, late: &LateNotes) -> BufReader<Members<BufReader<File>>> {
    let raw = BufReader::with_capacity(BUFFER_BYTES, file);
    BufReader::with_capacity(BUFFER_BYTES, Members::new(raw, path, late))
}

/// All members of a gzip stream, one after the other. Bytes behind the last member that are not
/// gzip are ignored with a note, as `gzip` does.
pub(crate) struct Members<R> {
    /// `None` behind the last.
    member: Option<GzDecoder<R>>,
    path: PathBuf,
    late: LateNotes,
}

impl<R: BufRead> Members<R> {
    pub(crate) fn new(inner: R, path: &Path, late: &LateNotes) -> Self {
        Self {
            member: Some(GzDecoder::new(inner)),
            path: path.to_owned(),
            late: late.clone(),
        }
    }
}

impl<R: BufRead> Read for Members<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if out.is_empty() {
            return Ok(0);
        }
        loop {
            let Some(member) = &mut self.member else {
                return Ok(0);
            };
            let n = member.read(out)?;
            if n > 0 {
                return Ok(n);
            }
            // The end of a member, its checksum verified.
            let rest = member.get_mut().fill_buf()?;
            let another = rest.starts_with(&GZIP_MAGIC);
            if !another && !rest.is_empty() {
                self.late.add(format!(
                    "{}: bytes behind the compressed data were ignored",
                    self.path.display()
                ));
            }
            let ended = self.member.take();
            if another {
                self.member = ended.map(|member| GzDecoder::new(member.into_inner()));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::{Compression, write::GzEncoder};
    use std::io::Write;

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(bytes).expect("memory");
        encoder.finish().expect("memory")
    }

    fn unwrap_all(bytes: &[u8]) -> (io::Result<Vec<u8>>, Vec<String>) {
        let late = LateNotes::default();
        let mut out = Vec::new();
        let read = Members::new(bytes, Path::new("x.gz"), &late).read_to_end(&mut out);
        (read.map(|_| out), late.get())
    }

    #[test]
    fn members_are_joined_and_padding_is_noted() {
        let mut file = gzip(b"one ");
        file.extend(gzip(b""));
        file.extend(gzip(b"two"));
        let (joined, notes) = unwrap_all(&file);
        assert_eq!(
            (joined.expect("good"), notes.len()),
            (b"one two".to_vec(), 0)
        );
        file.extend([0; 512]);
        let (padded, notes) = unwrap_all(&file);
        assert_eq!(
            (padded.expect("good"), notes.len()),
            (b"one two".to_vec(), 1)
        );
    }

    #[test]
    fn members_every_truncation_is_an_error() {
        let file = gzip(b"some text that is long enough");
        for n in 0..file.len() {
            assert!(unwrap_all(&file[..n]).0.is_err(), "{n} bytes");
        }
    }

    #[test]
    fn header_lines_are_bounded() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("long");
        std::fs::write(&path, vec![b'a'; HEADER_BYTES_MAX as usize + 10]).expect("writes");
        let mut input = Input::open(&path).expect("opens");
        let error = input.header_line().expect_err("too long");
        assert!(error.to_string().contains("longer than"), "{error}");
        assert!(Input::open(folder.path()).is_err());
        assert!(Input::open(&folder.path().join("missing")).is_err());
    }
}
