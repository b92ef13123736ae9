//! Samples written as text, and the small text that headers are made of.

use crate::samples::Stored;
use std::io::{self, BufRead, Read};
use std::path::{Path, PathBuf};

/// Longest number in a text of samples; the shortest exact form of any double is far below.
const TOKEN_BYTES_MAX: usize = 512;

/// Turns numbers separated by white space or commas into little-endian samples of a stored type.
pub(crate) struct TextSamples<R> {
    inner: R,
    path: PathBuf,
    stored: Stored,
    count: u64,
    ready: Vec<u8>,
    given: usize,
}

impl<R: BufRead> TextSamples<R> {
    pub(crate) fn new(inner: R, path: &Path, stored: Stored) -> Self {
        Self {
            inner,
            path: path.to_owned(),
            stored,
            count: 0,
            ready: Vec::new(),
            given: 0,
        }
    }

    fn token(&mut self) -> io::Result<Option<String>> {
        let mut token = Vec::new();
        loop {
            let available = self.inner.fill_buf()?;
            let Some(&byte) = available.first() else {
                break;
            };
            self.inner.consume(1);
            if !(byte.is_ascii_whitespace() || byte == b',') {
                token.push(byte);
            } else if !token.is_empty() {
                break;
            }
            if token.len() > TOKEN_BYTES_MAX {
                return Err(self.not_a_number(&String::from_utf8_lossy(&token)));
            }
        }
        Ok((!token.is_empty()).then(|| String::from_utf8_lossy(&token).into_owned()))
    }

    fn not_a_number(&self, token: &str) -> io::Error {
        let shown: String = token
            .chars()
            .take(20)
            .flat_map(char::escape_debug)
            .collect();
        io::Error::new(
            io::ErrorKind::InvalidData,
            format!(
                "{}: '{shown}', number {} of the text, is not a sample of type {}",
                self.path.display(),
                self.count,
                self.stored.name()
            ),
        )
    }
}

impl<R: BufRead> Read for TextSamples<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if self.given == self.ready.len() && !out.is_empty() {
            self.given = 0;
            self.ready.clear();
            let Some(token) = self.token()? else {
                return Ok(0);
            };
            encode(self.stored, &token, &mut self.ready)
                .ok_or_else(|| self.not_a_number(&token))?;
            self.count += 1;
        }
        let n = out.len().min(self.ready.len() - self.given);
        out[..n].copy_from_slice(&self.ready[self.given..self.given + n]);
        self.given += n;
        Ok(n)
    }
}

fn encode(stored: Stored, token: &str, out: &mut Vec<u8>) -> Option<()> {
    match stored {
        Stored::Bool => out.push(u8::from(token.parse::<u8>().ok()? != 0)),
        Stored::U8 => out.extend(token.parse::<u8>().ok()?.to_le_bytes()),
        Stored::I8 => out.extend(token.parse::<i8>().ok()?.to_le_bytes()),
        Stored::U16 => out.extend(token.parse::<u16>().ok()?.to_le_bytes()),
        Stored::I16 => out.extend(token.parse::<i16>().ok()?.to_le_bytes()),
        Stored::U32 => out.extend(token.parse::<u32>().ok()?.to_le_bytes()),
        Stored::I32 => out.extend(token.parse::<i32>().ok()?.to_le_bytes()),
        Stored::U64 => out.extend(token.parse::<u64>().ok()?.to_le_bytes()),
        Stored::I64 => out.extend(token.parse::<i64>().ok()?.to_le_bytes()),
        Stored::F32 => out.extend(token.parse::<f32>().ok()?.to_le_bytes()),
        Stored::F64 => out.extend(token.parse::<f64>().ok()?.to_le_bytes()),
        Stored::F16 => return None,
    }
    Some(())
}

/// All numbers of a header field, separated by white space; `None` where one is not a number.
pub(crate) fn numbers<T: std::str::FromStr>(text: &str) -> Option<Vec<T>> {
    text.split_whitespace().map(|t| t.parse().ok()).collect()
}

/// Exactly `N` numbers.
pub(crate) fn exactly<T: std::str::FromStr, const N: usize>(text: &str) -> Option<[T; N]> {
    numbers(text)?.try_into().ok()
}

/// `text` cut to a length that fits an error message, control characters escaped.
pub(crate) fn shorten(text: &str) -> String {
    let shown: String = text
        .trim()
        .chars()
        .take(80)
        .flat_map(char::escape_debug)
        .collect();
    if text.trim().chars().count() > 80 {
        shown + "..."
    } else {
        shown
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(stored: Stored, text: &str) -> io::Result<Vec<u8>> {
        let mut out = Vec::new();
        TextSamples::new(text.as_bytes(), Path::new("x"), stored).read_to_end(&mut out)?;
        Ok(out)
    }

    #[test]
    fn text_of_every_separator() {
        let bytes = read(Stored::U8, "\n 1 2,3\t4\r\n,5").expect("numbers");
        assert_eq!(bytes, [1, 2, 3, 4, 5]);
        let bytes = read(Stored::F32, "1e-3 nan -inf").expect("numbers");
        assert_eq!(bytes[..4], 1e-3f32.to_le_bytes());
        assert_eq!(bytes.len(), 12);
    }

    #[test]
    fn text_that_is_not_numbers() {
        for text in ["256", "-1", "x", "1.5", &"1".repeat(10_000)] {
            let error = read(Stored::U8, &format!("7 {text}")).expect_err(text);
            assert!(
                error.to_string().contains("number 1 of the text"),
                "{error}"
            );
        }
    }

    #[test]
    fn shortened_text_has_no_control_characters() {
        assert_eq!(shorten(" a\u{7}b "), "a\\u{7}b");
        assert!(shorten(&"ä".repeat(1000)).len() < 200);
    }
}
