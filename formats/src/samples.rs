//! Stored samples of any number type and byte order to little-endian samples of a volume type,
//! as a stream.

use crate::input::LateNotes;
use crate::limits::unsupported;
use brickmarch::{Box3, SampleType};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Samples converted at one time; bounds the memory of a reader.
const CHUNK_SAMPLES: u64 = 16 << 10;

/// Number type of the samples in a source file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stored {
    Bool,
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F16,
    F32,
    F64,
}

impl Stored {
    pub(crate) const fn bytes(self) -> usize {
        match self {
            Stored::Bool | Stored::U8 | Stored::I8 => 1,
            Stored::U16 | Stored::I16 | Stored::F16 => 2,
            Stored::U32 | Stored::I32 | Stored::F32 => 4,
            Stored::U64 | Stored::I64 | Stored::F64 => 8,
        }
    }

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Stored::Bool => "bool",
            Stored::U8 => "u8",
            Stored::I8 => "i8",
            Stored::U16 => "u16",
            Stored::I16 => "i16",
            Stored::U32 => "u32",
            Stored::I32 => "i32",
            Stored::U64 => "u64",
            Stored::I64 => "i64",
            Stored::F16 => "f16",
            Stored::F32 => "f32",
            Stored::F64 => "f64",
        }
    }

    /// The volume type that holds these samples.
    pub(crate) const fn target(self) -> SampleType {
        match self {
            Stored::Bool => SampleType::Bit,
            Stored::U8 => SampleType::U8,
            Stored::I8 => SampleType::I8,
            Stored::U16 => SampleType::U16,
            Stored::I16 => SampleType::I16,
            Stored::U32 | Stored::U64 => SampleType::U32,
            Stored::I32 | Stored::I64 => SampleType::I32,
            Stored::F16 | Stored::F32 | Stored::F64 => SampleType::F32,
        }
    }

    /// What a user should know about the conversion.
    pub(crate) fn note(self) -> Option<String> {
        match self {
            Stored::F64 => Some("f64 samples are rounded to f32 (7 significant digits)".into()),
            Stored::U64 | Stored::I64 => Some(format!(
                "{} samples are stored as {}; a value that does not fit stops the import",
                self.name(),
                self.target().name()
            )),
            _ => None,
        }
    }

    /// One sample, little-endian, exactly `bytes()` long. 64-bit integers are not rounded.
    fn get(self, raw: &[u8]) -> Value {
        match self {
            Stored::Bool => Value::Int(i128::from(raw[0] != 0)),
            Stored::U64 => Value::Int(i128::from(u64::from_le_bytes(eight(raw)))),
            Stored::I64 => Value::Int(i128::from(i64::from_le_bytes(eight(raw)))),
            Stored::F64 => Value::Real(f64::from_le_bytes(eight(raw))),
            Stored::F16 => Value::Real(f64::from(f16_to_f32(u16::from_le_bytes([raw[0], raw[1]])))),
            Stored::F32 => Value::Real(SampleType::F32.get(raw)),
            _ => Value::Int(self.target().get(raw) as i128),
        }
    }
}

enum Value {
    Int(i128),
    Real(f64),
}

fn eight(raw: &[u8]) -> [u8; 8] {
    raw.try_into().expect("eight bytes")
}

/// IEEE 754 binary16 to binary32, exact.
pub(crate) fn f16_to_f32(half: u16) -> f32 {
    let sign = u32::from(half & 0x8000) << 16;
    let exponent = u32::from(half >> 10) & 0x1f;
    let fraction = u32::from(half) & 0x3ff;
    let magnitude = match exponent {
        // Subnormal: fraction * 2^-24 is exact in f32.
        0 => (fraction as f32 * 2f32.powi(-24)).to_bits(),
        31 => 0x7f80_0000 | fraction << 13,
        _ => (exponent + 112) << 23 | fraction << 13,
    };
    f32::from_bits(sign | magnitude)
}

/// What to do with bytes behind the last sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Surplus {
    /// The format has nothing behind its samples: an error.
    Refuse,
    /// Ignored with a note.
    Note,
    /// The rest belongs to something else, and is not looked at.
    Ignore,
}

/// How the samples lie in the stream.
#[derive(Clone, Debug)]
pub(crate) struct Encoding {
    pub(crate) stored: Stored,
    pub(crate) big_endian: bool,
    /// `value = slope * stored + intercept`, giving f32.
    pub(crate) scale: Option<(f64, f64)>,
    pub(crate) surplus: Surplus,
}

impl Encoding {
    pub(crate) fn target(&self) -> SampleType {
        if self.scale.is_some() {
            SampleType::F32
        } else {
            self.stored.target()
        }
    }
}

impl Encoding {
    /// Whether the stored bytes are the samples, little-endian, as they are.
    pub(crate) fn is_plain(&self) -> bool {
        let (stored, target) = (self.stored.bytes(), self.target());
        self.scale.is_none()
            && stored == target.bytes()
            && target != SampleType::Bit
            && (stored == 1 || !self.big_endian)
    }
}

/// Yields exactly the samples of `domain` as little-endian [`Encoding::target`], `i` fastest.
///
/// The end of the stream is looked at before the last samples are handed out, so that a checksum
/// behind compressed data counts.
pub(crate) struct SampleReader {
    inner: Box<dyn Read + Send>,
    path: PathBuf,
    late: LateNotes,
    encoding: Encoding,
    domain: Box3,
    done: u64,
    stored: Vec<u8>,
    ready: Vec<u8>,
    given: usize,
    failed: Option<(io::ErrorKind, String)>,
}

impl SampleReader {
    pub(crate) fn new(
        inner: Box<dyn Read + Send>,
        path: &Path,
        late: &LateNotes,
        encoding: Encoding,
        domain: Box3,
    ) -> Self {
        Self {
            inner,
            path: path.to_owned(),
            late: late.clone(),
            encoding,
            domain,
            done: 0,
            stored: Vec::new(),
            ready: Vec::new(),
            given: 0,
            failed: None,
        }
    }

    /// Index of the sample with this number in the stream.
    fn index(&self, number: u64) -> [u64; 3] {
        let [nx, ny, _] = self.domain.size().map(u64::from);
        [number % nx, number / nx % ny, number / nx / ny]
    }

    /// Converts the next chunk into `ready`.
    fn refill(&mut self) -> io::Result<()> {
        let width = self.encoding.stored.bytes();
        let samples = (self.domain.count() - self.done).min(CHUNK_SAMPLES);
        self.stored.resize(samples as usize * width, 0);
        let found = self.fill()?;
        if found < self.stored.len() {
            let name = self.path.display();
            let found = self.done * width as u64 + found as u64;
            let expected = self.domain.count() * width as u64;
            return Err(io::Error::new(
                io::ErrorKind::UnexpectedEof,
                format!("{name}: the samples end early: {expected} bytes expected, {found} found"),
            ));
        }
        self.convert()?;
        self.done += samples;
        if self.done == self.domain.count() {
            self.check_end()?;
        }
        Ok(())
    }

    /// Reads until `stored` is full or the stream ends.
    fn fill(&mut self) -> io::Result<usize> {
        let mut found = 0;
        while found < self.stored.len() {
            match self.inner.read(&mut self.stored[found..]) {
                Ok(0) => break,
                Ok(n) => found += n,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => {
                    let at = self.done * self.encoding.stored.bytes() as u64 + found as u64;
                    return Err(self.broken(&e, at));
                }
            }
        }
        Ok(found)
    }

    fn broken(&self, error: &io::Error, at: u64) -> io::Error {
        let name = self.path.display();
        let what = match error.kind() {
            io::ErrorKind::UnexpectedEof => "the compressed data end early",
            io::ErrorKind::InvalidInput | io::ErrorKind::InvalidData => "the samples are damaged",
            _ => "reading the samples",
        };
        let kind = match error.kind() {
            io::ErrorKind::InvalidInput => io::ErrorKind::InvalidData,
            kind => kind,
        };
        io::Error::new(
            kind,
            format!("{name}: {what} (after {at} bytes of samples): {error}"),
        )
    }

    fn check_end(&mut self) -> io::Result<()> {
        if self.encoding.surplus == Surplus::Ignore {
            return Ok(());
        }
        let width = self.encoding.stored.bytes() as u64;
        let expected = self.domain.count() * width;
        let mut byte = [0];
        let extra = loop {
            match self.inner.read(&mut byte) {
                Ok(n) => break n > 0,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(self.broken(&e, expected)),
            }
        };
        if extra {
            let message = format!(
                "{}: there is more behind the {expected} bytes of samples that the dimensions ask for",
                self.path.display()
            );
            if self.encoding.surplus == Surplus::Refuse {
                return Err(io::Error::new(io::ErrorKind::InvalidData, message));
            }
            self.late.add(format!("{message}; it was ignored"));
        }
        Ok(())
    }

    fn convert(&mut self) -> io::Result<()> {
        let Encoding { stored, scale, .. } = self.encoding;
        if self.encoding.big_endian {
            swap_bytes(&mut self.stored, stored.bytes());
        }
        self.given = 0;
        let target = self.encoding.target();
        let native = target.bytes() == stored.bytes() && stored != Stored::F16;
        if scale.is_none() && native && stored != Stored::Bool {
            std::mem::swap(&mut self.ready, &mut self.stored);
            return Ok(());
        }
        let samples = self.stored.len() / stored.bytes();
        self.ready.resize(samples * target.bytes(), 0);
        let sources = self.stored.chunks_exact(stored.bytes());
        let targets = self.ready.chunks_exact_mut(target.bytes());
        for (n, (source, out)) in sources.zip(targets).enumerate() {
            let fits = match (stored.get(source), scale) {
                (Value::Int(v), None) => put_integer(target, v, out),
                (Value::Real(v), None) => put_real(v, out),
                (Value::Int(v), Some((slope, intercept))) => {
                    put_real(v as f64 * slope + intercept, out)
                }
                (Value::Real(v), Some((slope, intercept))) => put_real(v * slope + intercept, out),
            };
            if !fits {
                let shown = match stored.get(source) {
                    Value::Int(v) => v.to_string(),
                    Value::Real(v) => v.to_string(),
                };
                let [i, j, k] = self.index(self.done + n as u64);
                return Err(io::Error::new(
                    io::ErrorKind::InvalidData,
                    format!(
                        "{}: the {} sample {shown} at {i},{j},{k} does not fit {}: \
                         convert the file to a type that brickmarch stores ({})",
                        self.path.display(),
                        stored.name(),
                        target.name(),
                        SUPPORTED
                    ),
                ));
            }
        }
        Ok(())
    }
}

pub(crate) const SUPPORTED: &str = "u8, i8, u16, i16, u32, i32, f32";

/// The error for samples of more than one component or of an exotic type.
pub(crate) fn not_scalar(path: &Path, what: &str) -> brickmarch::Error {
    unsupported(
        path,
        format!(
            "{what} samples are not supported: one number per sample of type {SUPPORTED}, \
             or u64, i64, f64 that is converted"
        ),
    )
}

fn put_integer(target: SampleType, value: i128, out: &mut [u8]) -> bool {
    match target {
        SampleType::U32 => u32::try_from(value).is_ok_and(|v| {
            out.copy_from_slice(&v.to_le_bytes());
            true
        }),
        SampleType::I32 => i32::try_from(value).is_ok_and(|v| {
            out.copy_from_slice(&v.to_le_bytes());
            true
        }),
        _ => {
            target.put(value as f64, out);
            true
        }
    }
}

/// False where a finite value becomes infinite.
fn put_real(value: f64, out: &mut [u8]) -> bool {
    let rounded = value as f32;
    out.copy_from_slice(&rounded.to_le_bytes());
    rounded.is_finite() || !value.is_finite()
}

fn swap_bytes(raw: &mut [u8], width: usize) {
    fn each<const N: usize>(raw: &mut [u8]) {
        raw.as_chunks_mut::<N>()
            .0
            .iter_mut()
            .for_each(|c| c.reverse());
    }
    match width {
        2 => each::<2>(raw),
        4 => each::<4>(raw),
        8 => each::<8>(raw),
        _ => {}
    }
}

impl Read for SampleReader {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if let Some((kind, message)) = &self.failed {
            return Err(io::Error::new(*kind, message.clone()));
        }
        if out.is_empty() {
            return Ok(0);
        }
        if self.given == self.ready.len() {
            if self.done == self.domain.count() {
                return Ok(0);
            }
            if let Err(error) = self.refill() {
                self.failed = Some((error.kind(), error.to_string()));
                return Err(error);
            }
        }
        let n = out.len().min(self.ready.len() - self.given);
        out[..n].copy_from_slice(&self.ready[self.given..self.given + n]);
        self.given += n;
        Ok(n)
    }
}

/// Checks the types that a source file can hold against the whole pipeline.
#[cfg(test)]
mod tests {
    use super::*;

    fn read(encoding: Encoding, bytes: &[u8], dims: [i32; 3]) -> (io::Result<Vec<u8>>, usize) {
        let late = LateNotes::default();
        let domain = Box3::from_size(dims);
        let inner = Box::new(io::Cursor::new(bytes.to_vec()));
        let mut reader = SampleReader::new(inner, Path::new("x"), &late, encoding, domain);
        let mut out = Vec::new();
        let result = reader.read_to_end(&mut out).map(|_| out);
        (result, late.get().len())
    }

    fn plain(stored: Stored) -> Encoding {
        Encoding {
            stored,
            big_endian: false,
            scale: None,
            surplus: Surplus::Refuse,
        }
    }

    #[test]
    fn half_floats_are_exact() {
        for (half, value) in [
            (0x0000, 0.0),
            (0x8000, -0.0),
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
            (0x0001, 5.960_464_5e-8),
            (0x03ff, 6.097_555e-5),
            (0x0400, 6.103_515_6e-5),
            (0x7c00, f32::INFINITY),
            (0xfc00, f32::NEG_INFINITY),
        ] {
            assert_eq!(f16_to_f32(half).to_bits(), f32::to_bits(value), "{half:#x}");
        }
        assert!(f16_to_f32(0x7e00).is_nan());
    }

    #[test]
    fn big_endian_is_turned_for_every_width() {
        for stored in [Stored::U16, Stored::I32, Stored::F32] {
            let bytes: Vec<u8> = (1..=8).collect();
            let mut turned = bytes.clone();
            swap_bytes(&mut turned, stored.bytes());
            let dims = [(8 / stored.bytes()) as i32, 1, 1];
            let big = Encoding {
                big_endian: true,
                ..plain(stored)
            };
            assert_eq!(read(big, &bytes, dims).0.expect("reads"), turned);
        }
        let f64s: Vec<u8> = [1.5f64, -2.0]
            .iter()
            .flat_map(|v| v.to_be_bytes())
            .collect();
        let big = Encoding {
            big_endian: true,
            ..plain(Stored::F64)
        };
        let want: Vec<u8> = [1.5f32, -2.0]
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        assert_eq!(read(big, &f64s, [1, 2, 1]).0.expect("reads"), want);
    }

    #[test]
    fn wide_integers_fit_or_name_the_place() {
        let fits = [0u64, u64::from(u32::MAX), 7, 9];
        let bytes: Vec<u8> = fits.iter().flat_map(|v| v.to_le_bytes()).collect();
        let want: Vec<u8> = fits
            .iter()
            .flat_map(|&v| (v as u32).to_le_bytes())
            .collect();
        assert_eq!(
            read(plain(Stored::U64), &bytes, [2, 2, 1]).0.expect("fits"),
            want
        );
        let signed = [0i64, -5, i64::from(i32::MIN), i64::from(i32::MAX) + 1];
        let bytes: Vec<u8> = signed.iter().flat_map(|v| v.to_le_bytes()).collect();
        let error = read(plain(Stored::I64), &bytes, [1, 2, 2])
            .0
            .expect_err("too big");
        assert!(error.to_string().contains("2147483648 at 0,1,1"), "{error}");
    }

    #[test]
    fn doubles_keep_infinity_but_do_not_make_it() {
        let of = |v: f64| read(plain(Stored::F64), &v.to_le_bytes(), [1, 1, 1]).0;
        assert!(of(f64::INFINITY).is_ok() && of(f64::NAN).is_ok() && of(3e38).is_ok());
        assert!(
            of(1e39)
                .expect_err("overflow")
                .to_string()
                .contains("does not fit")
        );
    }

    #[test]
    fn scaling_gives_floats() {
        let scaled = Encoding {
            scale: Some((0.5, -1.0)),
            ..plain(Stored::I16)
        };
        assert_eq!(scaled.target(), SampleType::F32);
        let bytes: Vec<u8> = [4i16, -3].iter().flat_map(|v| v.to_le_bytes()).collect();
        let want: Vec<u8> = [1f32, -2.5].iter().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(read(scaled, &bytes, [2, 1, 1]).0.expect("reads"), want);
    }

    #[test]
    fn booleans_become_zero_and_one() {
        let (bits, _) = read(plain(Stored::Bool), &[0, 1, 255], [3, 1, 1]);
        assert_eq!(bits.expect("reads"), [0, 1, 1]);
    }

    #[test]
    fn too_few_and_too_many_bytes() {
        for n in 0..8 {
            let (short, _) = read(plain(Stored::U16), &vec![7; n], [2, 2, 1]);
            let error = short.expect_err("short");
            assert_eq!(error.kind(), io::ErrorKind::UnexpectedEof);
            let text = format!("8 bytes expected, {n} found");
            assert!(error.to_string().contains(&text), "{error}");
        }
        assert!(read(plain(Stored::U16), &[7; 9], [2, 2, 1]).0.is_err());
        let noted = Encoding {
            surplus: Surplus::Note,
            ..plain(Stored::U16)
        };
        let (long, notes) = read(noted, &[7; 9], [2, 2, 1]);
        assert_eq!((long.expect("fine").len(), notes), (8, 1));
    }

    #[test]
    fn chunks_join_without_a_seam() {
        let dims = [1000, 50, 1];
        let bytes: Vec<u8> = (0..50_000u32)
            .flat_map(|v| (v as u16).to_be_bytes())
            .collect();
        let big = Encoding {
            big_endian: true,
            ..plain(Stored::U16)
        };
        let want: Vec<u8> = (0..50_000u32)
            .flat_map(|v| (v as u16).to_le_bytes())
            .collect();
        assert!(read(big, &bytes, dims).0.expect("reads") == want);
    }
}
