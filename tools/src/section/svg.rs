//! A section as an SVG file: lines as paths, the picture inside if wanted.

use super::Sheet;
use super::overlay::{Contour, hex};
use super::scale_bar::ScaleBar;
use crate::picture::Picture;
use std::io::{self, Write};

/// Writes the file.
///
/// # Errors
/// When `out` cannot be written.
pub(crate) fn write(
    out: &mut dyn Write,
    size: [u32; 2],
    picture: Option<&Picture>,
    sheet: &Sheet,
    contours: &[Contour],
    width: f64,
    bar: Option<&ScaleBar>,
) -> io::Result<()> {
    let [w, h] = size;
    writeln!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\">"
    )?;
    if let Some(picture) = picture {
        write!(
            out,
            "<image width=\"{w}\" height=\"{h}\" href=\"data:image/png;base64,"
        )?;
        let mut text = Base64::new(&mut *out);
        picture.encode_png(&mut text, png::Compression::High)?;
        text.finish()?;
        writeln!(out, "\"/>")?;
    }
    for contour in contours {
        write!(
            out,
            "<path data-iso=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\" stroke-linejoin=\"round\" d=\"",
            contour.iso,
            hex(contour.colour)
        )?;
        for line in contour.lines.iter() {
            for (n, &point) in line.points.iter().enumerate() {
                let [x, y] = sheet.on_paper(point);
                write!(
                    out,
                    "{}{} {}",
                    if n == 0 { 'M' } else { 'L' },
                    short(x),
                    short(y)
                )?;
            }
            if line.closed {
                write!(out, "Z")?;
            }
        }
        writeln!(out, "\"/>")?;
    }
    if let Some(bar) = bar {
        out.write_all(bar.svg().as_bytes())?;
    }
    writeln!(out, "</svg>")
}

/// At most three digits after the point.
fn short(v: f64) -> f64 {
    (v * 1000.0).round() / 1000.0
}

/// Writes what it is given in base 64 (RFC 4648).
struct Base64<'a> {
    out: &'a mut dyn Write,
    waiting: Vec<u8>,
}

impl<'a> Base64<'a> {
    fn new(out: &'a mut dyn Write) -> Self {
        Self {
            out,
            waiting: Vec::with_capacity(3),
        }
    }

    fn triple(&mut self) -> io::Result<()> {
        const DIGITS: &[u8; 64] =
            b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
        let count = self.waiting.len();
        self.waiting.resize(3, 0);
        let [a, b, c] = [0, 1, 2].map(|n| u32::from(self.waiting[n]));
        let bits = a << 16 | b << 8 | c;
        let mut text = [18, 12, 6, 0].map(|shift| DIGITS[(bits >> shift & 63) as usize]);
        text[count + 1..].fill(b'=');
        self.waiting.clear();
        self.out.write_all(&text)
    }

    /// Writes the last digits.
    fn finish(mut self) -> io::Result<()> {
        if self.waiting.is_empty() {
            return Ok(());
        }
        self.triple()
    }
}

impl Write for Base64<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        for &byte in bytes {
            self.waiting.push(byte);
            if self.waiting.len() == 3 {
                self.triple()?;
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base_64_of_the_standard() {
        // The vectors of RFC 4648.
        let vectors = [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
            ("foobar", "Zm9vYmFy"),
        ];
        for (plain, coded) in vectors {
            let mut out = Vec::new();
            let mut text = Base64::new(&mut out);
            text.write_all(plain.as_bytes()).expect("memory");
            text.finish().expect("memory");
            assert_eq!(out, coded.as_bytes());
        }
    }
}
