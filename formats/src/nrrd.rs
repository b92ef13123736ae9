//! NRRD, attached (`.nrrd`) and detached (`.nhdr`), encodings raw, gzip and text.
//!
//! The format: <https://teem.sourceforge.net/nrrd/format.html>. World coordinates are those of the
//! file's `space` (left-posterior-superior for most medical files), not turned.

use crate::input::{Input, Members};
use crate::limits::{bad, domain, surplus, unsupported};
use crate::nrrd_geometry::geometry;
use crate::samples::{Encoding, Stored, Surplus, not_scalar};
use crate::text::{TextSamples, numbers, shorten};
use crate::volume::Source;
use crate::world::phrase;
use brickmarch::{Error, ErrorKind, Result};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

pub(crate) const MAGIC: &[u8] = b"NRRD000";

/// Key of the sample type that the exporter adds where NRRD has none, as for bits.
pub(crate) const SAMPLE_KEY: &str = "brickmarch sample";

/// Keys of the kind and the background of a volume, which the exporter adds.
pub(crate) const KIND_KEY: &str = "brickmarch kind";
pub(crate) const BACKGROUND_KEY: &str = "brickmarch background";

pub(crate) fn open(mut input: Input) -> Result<Source> {
    let header = Header::read(&mut input)?;
    let mut source = samples(&header, input)?;
    // What another program wrote there does not stop the import.
    let key = |name: &str| header.keys.get(name).map(|v| v.trim());
    if let Some(kind) = key(KIND_KEY).and_then(|v| v.parse().ok()) {
        source.kind = kind;
    }
    if let Some(background) = key(BACKGROUND_KEY).and_then(|v| v.parse().ok()) {
        let mut raw = [0; 4];
        source.sample.put(background, &mut raw);
        if source.sample.get(&raw) == background {
            source.background = background;
        }
    }
    Ok(source)
}

fn samples(header: &Header, input: Input) -> Result<Source> {
    let path = header.path.clone();
    let stored = header.stored()?;
    let axes = header.axes()?;
    let domain = domain(&path, axes.sizes, stored.bytes())?;
    let (index_to_world, units, mut notes) = geometry(header, &axes)?;
    let grid = brickmarch::Grid {
        domain,
        index_to_world,
        units,
    };
    let coding = header.require("encoding")?.to_lowercase();
    let encoding = Encoding {
        stored,
        big_endian: header.big_endian(&coding, stored)?,
        scale: None,
        surplus: Surplus::Note,
    };
    let description = format!(
        "NRRD {}{}, {coding}, {}",
        stored.name(),
        if encoding.big_endian {
            " big-endian"
        } else {
            ""
        },
        phrase(&shorten(header.get("space").unwrap_or("as the axes lie")))
    );

    let skip_lines = header.count("line skip")?.unwrap_or(0);
    let skip_bytes = header.count("byte skip")?.unwrap_or(0);
    let mut data = match header.data_file()? {
        Some(file) => Input::open_plain(&file)
            .map_err(|e| e.context(format!("{}: its data file", path.display())))?,
        None => input,
    };
    skip_data_lines(&mut data, skip_lines)?;
    let needed = domain.count() * stored.bytes() as u64;
    match coding.as_str() {
        "raw" => {
            let skip = match (skip_bytes, data.remaining()) {
                (-1, Some(rest)) => surplus(&data.path, needed, rest)?,
                (-1, None) => {
                    return Err(unsupported(&path, "'byte skip: -1' in a compressed file"));
                }
                (n, _) => n.unsigned_abs(),
            };
            data.skip(skip, "the bytes in front of the samples")?;
            Source::from_input(data, encoding, grid, description, notes)
        }
        "gzip" | "gz" => {
            let (file, late) = (data.path.clone(), data.late.clone());
            let mut stream = Members::new(data, &file, &late);
            // Skipped bytes are inside the compressed data here, and only here.
            let skip = skip_bytes.unsigned_abs();
            if skip_bytes < 0 {
                return Err(unsupported(&path, "'byte skip: -1' in compressed data"));
            }
            let skipped = std::io::copy(&mut stream.by_ref().take(skip), &mut std::io::sink())
                .map_err(|e| Error::io(&file, "reading the bytes in front of the samples", e))?;
            if skipped < skip {
                let text = format!("the compressed data end inside the {skip} skipped bytes");
                return Err(crate::limits::at(&file, ErrorKind::Truncated, text));
            }
            Source::from_stream(
                Box::new(stream),
                &file,
                &late,
                encoding,
                grid,
                description,
                notes,
            )
        }
        "text" | "txt" | "ascii" => {
            data.skip(
                skip_bytes.unsigned_abs(),
                "the bytes in front of the samples",
            )?;
            notes.extend(
                skip_bytes
                    .is_negative()
                    .then(|| "'byte skip' was ignored".into()),
            );
            let (file, late) = (data.path.clone(), data.late.clone());
            let stream = TextSamples::new(data, &file, stored);
            Source::from_stream(
                Box::new(stream),
                &file,
                &late,
                encoding,
                grid,
                description,
                notes,
            )
        }
        other => Err(unsupported(
            &path,
            format!(
                "encoding '{}'; raw, gzip and text are read: save it again as gzip",
                shorten(other)
            ),
        )),
    }
}

fn skip_data_lines(data: &mut Input, lines: i64) -> Result<()> {
    use std::io::BufRead;
    for n in 0..lines {
        let path = data.path.clone();
        let skipped = data
            .skip_until(b'\n')
            .map_err(|e| Error::io(&path, "reading the lines in front of the samples", e))?;
        if skipped == 0 {
            let text = format!("the file ends after {n} of {lines} skipped lines");
            return Err(crate::limits::at(&path, ErrorKind::Truncated, text));
        }
    }
    Ok(())
}

/// The fields of a header, names in lower case without inner blanks.
pub(crate) struct Header {
    pub(crate) path: PathBuf,
    fields: BTreeMap<String, String>,
    keys: BTreeMap<String, String>,
}

/// The axes that carry the volume; others have one sample only.
pub(crate) struct Axes {
    /// Number of each among all axes of the file.
    pub(crate) numbers: [usize; 3],
    pub(crate) sizes: [i128; 3],
    /// Axes of the file.
    pub(crate) all: usize,
}

impl Header {
    fn read(input: &mut Input) -> Result<Header> {
        let path = input.path.clone();
        let first = input.header_line()?.unwrap_or_default();
        let version = first.as_bytes().strip_prefix(MAGIC);
        if !version.is_some_and(|v| matches!(v, [b'1'..=b'5'])) {
            return Err(bad(
                &path,
                format!(
                    "'{}' is not the first line of an NRRD file (NRRD0001 to NRRD0005)",
                    shorten(&first)
                ),
            ));
        }
        let mut header = Header {
            path,
            fields: BTreeMap::new(),
            keys: BTreeMap::new(),
        };
        while let Some(line) = input.header_line()? {
            if line.is_empty() {
                break;
            }
            header.add(&line)?;
        }
        Ok(header)
    }

    fn add(&mut self, line: &str) -> Result<()> {
        if line.starts_with('#') {
            return Ok(());
        }
        let Some((name, value)) = line.split_once(':') else {
            return Err(bad(
                &self.path,
                format!("the header line '{}' has no colon", shorten(line)),
            ));
        };
        if let Some(value) = value.strip_prefix('=') {
            self.keys.insert(name.to_owned(), value.to_owned());
            return Ok(());
        }
        let field = plain_name(name);
        if self.fields.insert(field, value.trim().to_owned()).is_some() {
            return Err(bad(
                &self.path,
                format!("the header gives '{}' twice", shorten(name)),
            ));
        }
        Ok(())
    }

    pub(crate) fn get(&self, field: &str) -> Option<&str> {
        self.fields.get(&plain_name(field)).map(String::as_str)
    }

    fn require(&self, field: &str) -> Result<&str> {
        self.get(field)
            .ok_or_else(|| bad(&self.path, format!("the header has no '{field}'")))
    }

    pub(crate) fn wrong(&self, field: &str, want: &str) -> Error {
        let value = self.get(field).unwrap_or_default();
        bad(
            &self.path,
            format!(
                "the header says '{field}: {}', expected is {want}",
                shorten(value)
            ),
        )
    }

    fn stored(&self) -> Result<Stored> {
        let name = self.require("type")?;
        Ok(match name {
            "uchar" | "unsigned char" | "uint8" | "uint8_t" => match self.keys.get(SAMPLE_KEY) {
                Some(sample) if sample == "bit" => Stored::Bool,
                _ => Stored::U8,
            },
            "signed char" | "int8" | "int8_t" => Stored::I8,
            "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => {
                Stored::I16
            }
            "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => {
                Stored::U16
            }
            "int" | "signed int" | "int32" | "int32_t" => Stored::I32,
            "uint" | "unsigned int" | "uint32" | "uint32_t" => Stored::U32,
            "longlong"
            | "long long"
            | "long long int"
            | "signed long long"
            | "signed long long int"
            | "int64"
            | "int64_t" => Stored::I64,
            "ulonglong"
            | "unsigned long long"
            | "unsigned long long int"
            | "uint64"
            | "uint64_t" => Stored::U64,
            "float" => Stored::F32,
            "double" => Stored::F64,
            other => return Err(not_scalar(&self.path, &format!("'{}'", shorten(other)))),
        })
    }

    /// Three axes with samples; more are accepted where they hold one sample each.
    fn axes(&self) -> Result<Axes> {
        let dimension: usize = self
            .require("dimension")?
            .parse()
            .ok()
            .filter(|n| (1..=16).contains(n))
            .ok_or_else(|| self.wrong("dimension", "a number from 1 to 16"))?;
        let sizes: Vec<i128> = numbers(self.require("sizes")?)
            .filter(|sizes: &Vec<i128>| sizes.len() == dimension)
            .ok_or_else(|| self.wrong("sizes", &format!("{dimension} whole numbers")))?;
        let kinds: Vec<&str> = self
            .get("kinds")
            .unwrap_or_default()
            .split_whitespace()
            .collect();
        let is_space = |axis: usize| match kinds.get(axis) {
            Some(kind) => ["domain", "space", "???", "none"].contains(kind),
            None => true,
        };
        let kept: Vec<usize> = (0..dimension)
            .filter(|&axis| dimension == 3 || sizes[axis] != 1)
            .collect();
        if let Some(&axis) = kept.iter().find(|&&axis| !is_space(axis)) {
            let what = format!("'{}' (axis {axis})", shorten(kinds[axis]));
            return Err(not_scalar(&self.path, &what));
        }
        let numbers: [usize; 3] = kept.as_slice().try_into().map_err(|_| {
            unsupported(
                &self.path,
                format!(
                    "{dimension} axes of {} samples; a volume has three: cut or join slices first \
                     (unu slice, unu join)",
                    self.get("sizes").map(shorten).unwrap_or_default()
                ),
            )
        })?;
        Ok(Axes {
            numbers,
            sizes: numbers.map(|axis| sizes[axis]),
            all: dimension,
        })
    }

    fn big_endian(&self, coding: &str, stored: Stored) -> Result<bool> {
        let binary = !matches!(coding, "text" | "txt" | "ascii");
        match self.get("endian") {
            _ if stored.bytes() == 1 || !binary => Ok(false),
            Some("little") => Ok(false),
            Some("big") => Ok(true),
            Some(_) => Err(self.wrong("endian", "little or big")),
            None => Err(bad(
                &self.path,
                format!(
                    "the header has no 'endian', which {} samples need: add 'endian: little' or 'endian: big'",
                    stored.name()
                ),
            )),
        }
    }

    fn count(&self, field: &str) -> Result<Option<i64>> {
        let Some(text) = self.get(field) else {
            return Ok(None);
        };
        let lowest = if field == "byte skip" { -1 } else { 0 };
        text.parse()
            .ok()
            .filter(|&n: &i64| n >= lowest)
            .map(Some)
            .ok_or_else(|| self.wrong(field, "a count"))
    }

    /// The detached file, relative to the folder of the header.
    fn data_file(&self) -> Result<Option<PathBuf>> {
        let Some(name) = self.get("data file") else {
            return Ok(None);
        };
        if name.starts_with("LIST") || name.contains('%') {
            return Err(unsupported(
                &self.path,
                "samples in several data files; join them into one (unu save -f nrrd)",
            ));
        }
        if name.is_empty() {
            return Err(self.wrong("data file", "a file name"));
        }
        let folder = self.path.parent().unwrap_or(Path::new(""));
        Ok(Some(folder.join(name)))
    }
}

/// `Data File` and `datafile` are the same field.
fn plain_name(name: &str) -> String {
    name.to_lowercase().split_whitespace().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{family, gzip, open_bytes, samples};
    use crate::volume::{OpenOptions, open_volume};
    use brickmarch::SampleType;

    const HEAD: &str = "NRRD0004\n# a comment\ntype: short\ndimension: 3\nsizes: 2 3 4\n";

    fn file(more: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = format!("{HEAD}{more}\n").into_bytes();
        bytes.extend(data);
        bytes
    }

    fn big() -> Vec<u8> {
        (0..24i16).flat_map(|v| (v - 7).to_be_bytes()).collect()
    }

    fn little() -> Vec<u8> {
        (0..24i16).flat_map(|v| (v - 7).to_le_bytes()).collect()
    }

    fn reads(bytes: &[u8]) -> Source {
        let mut source = open_bytes("a.nrrd", bytes).expect("opens");
        assert_eq!(source.grid.domain.size(), [2, 3, 4]);
        assert_eq!(source.sample, SampleType::I16);
        assert_eq!(samples(&mut source).expect("reads"), little());
        source
    }

    fn refused(bytes: &[u8]) -> String {
        let error = match open_bytes("a.nrrd", bytes) {
            Err(error) => error.to_string(),
            Ok(mut source) => samples(&mut source).expect_err("wrong").to_string(),
        };
        assert!(error.contains("a.nrrd: "), "{error}");
        error
    }

    #[test]
    fn nrrd_encodings() {
        reads(&file("endian: big\nencoding: raw\n", &big()));
        reads(&file(
            "endian: little\nencoding: gzip\nkey:=value: with colon\n",
            &gzip(&little()),
        ));
        let text: String = (0..24).map(|v| format!("{} ", v - 7)).collect();
        reads(&file("encoding: ascii\n", text.as_bytes()));
        // The whole file in gzip.
        reads(&gzip(&file("endian: big\nencoding: raw\n", &big())));
        for other in ["bzip2", "hex", "zstd"] {
            let error = refused(&file(&format!("endian: big\nencoding: {other}\n"), &big()));
            assert!(error.contains("raw, gzip and text"), "{error}");
        }
    }

    #[test]
    fn nrrd_skips() {
        let behind = |front: &[u8], data: Vec<u8>| [front, &data].concat();
        reads(&file(
            "endian: big\nencoding: raw\nline skip: 2\nbyte skip: 3\n",
            &behind(b"one\ntwo\nabc", big()),
        ));
        reads(&file(
            "endian: big\nencoding: raw\nbyte skip: -1\n",
            &behind(b"anything", big()),
        ));
        reads(&file(
            "endian: big\nencoding: gzip\nline skip: 1\nbyteskip: 5\n",
            &behind(b"a line\n", gzip(&behind(b"front", big()))),
        ));
        for wrong in [
            "byte skip: -2",
            "line skip: -1",
            "byte skip: 9223372036854775807",
            "line skip: 99",
        ] {
            refused(&file(
                &format!("endian: big\nencoding: raw\n{wrong}\n"),
                &big(),
            ));
        }
    }

    #[test]
    fn nrrd_detached() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("a.nhdr");
        let header = format!("{HEAD}encoding: gzip\nendian: little\ndata file: a.raw.gz");
        std::fs::write(&path, header).expect("writes");
        let missing = open_volume(&path, &OpenOptions::default())
            .err()
            .expect("missing");
        assert!(
            missing.to_string().contains("a.nhdr: its data file"),
            "{missing}"
        );
        assert!(missing.to_string().contains("a.raw.gz"), "{missing}");
        std::fs::write(folder.path().join("a.raw.gz"), gzip(&little())).expect("writes");
        let mut source = open_volume(&path, &OpenOptions::default()).expect("opens");
        assert_eq!(samples(&mut source).expect("reads"), little());
        for several in ["LIST", "a%03d.raw 1 4 1"] {
            let error = refused(&file(
                &format!("endian: big\nencoding: raw\ndata file: {several}\n"),
                b"",
            ));
            assert!(error.contains("several data files"), "{error}");
        }
    }

    #[test]
    fn nrrd_axes_of_one_sample_are_dropped() {
        let text = "NRRD0005\ntype: uint8\ndimension: 4\nsizes: 1 2 1 3\nencoding: raw\n\nabcdef";
        assert!(refused(text.as_bytes()).contains("three"));
        let text = text
            .replace("sizes: 1 2 1 3", "sizes: 1 2 3 1")
            .replace("dimension: 4", "dimension: 3");
        assert!(refused(text.as_bytes()).contains("sizes"));
        let four = "NRRD0005\ntype: uint8\ndimension: 4\nsizes: 1 2 3 4\nkinds: vector domain domain domain\n\
                    space: RAS\nspace directions: none (1,0,0) (0,2,0) (0,0,3)\nencoding: raw\n\nabcdefghijklmnopqrstuvwx";
        let source = open_bytes("a.nrrd", four.as_bytes()).expect("opens");
        assert_eq!(source.grid.index_to_world.spacing(), [1.0, 2.0, 3.0]);
        let colours = "NRRD0005\ntype: uint8\ndimension: 3\nsizes: 3 2 2\nkinds: RGB-color domain domain\n\
                       encoding: raw\n\nabcdefghijkl";
        assert!(refused(colours.as_bytes()).contains("RGB-color"));
    }

    #[test]
    fn nrrd_wrong_headers() {
        let with = |from: &str, to: &str| {
            let good = format!("{HEAD}endian: big\nencoding: raw\n\n");
            assert!(good.contains(from), "{from}");
            let mut bytes = good.replace(from, to).into_bytes();
            bytes.extend(big());
            refused(&bytes)
        };
        with("NRRD0004", "NRRD0009");
        with("type: short", "type: block");
        with("type: short", "kind: short");
        with("sizes: 2 3 4", "sizes: 0 3 4");
        with("sizes: 2 3 4", "sizes: -2 3 4");
        with("sizes: 2 3 4", "sizes: 2 3");
        with("sizes: 2 3 4", "sizes: 2 3 four");
        with("sizes: 2 3 4", "sizes: 2 3 4\nsizes: 2 3 4");
        with("dimension: 3", "dimension: 99999999");
        with("dimension: 3\nsizes: 2 3 4", "dimension: 2\nsizes: 6 4");
        with("endian: big", "endian: middle");
        assert!(with("endian: big\n", "").contains("endian: little"));
        with("encoding: raw", "");
        with("encoding: raw", "no colon here");
        assert!(open_bytes("a.nrrd", b"PNG").is_err());
    }

    #[test]
    fn nrrd_huge_declared_sizes() {
        for sizes in [
            "1000 1000 1000",
            "99999999999 99999999999 99999999999",
            "100000000 100000000 100000000",
            &format!("{0} {0} {0}", "9".repeat(50)),
        ] {
            let bytes = file("endian: big\nencoding: raw\n", &big());
            let text = String::from_utf8_lossy(&bytes).replace("2 3 4", sizes);
            refused(text.as_bytes());
        }
        // A compressed file does not tell its length: reading stops where the data do.
        let packed = file("endian: big\nencoding: gzip\n", &gzip(&big()));
        let at = packed
            .windows(5)
            .position(|w| w == b"2 3 4")
            .expect("sizes");
        let mut huge = packed[..at].to_vec();
        huge.extend(b"99999 99999 99999");
        huge.extend(&packed[at + 5..]);
        assert!(refused(&huge).contains("48 found"));
        let long = file(&format!("key:={}\n", "x".repeat(2 << 20)), &big());
        assert!(refused(&long).contains("longer than"));
    }

    #[test]
    fn nrrd_truncations_and_flips() {
        family("a.nrrd", &file("endian: big\nencoding: raw\n", &big()));
        family(
            "a.nrrd",
            &file("endian: big\nencoding: gzip\n", &gzip(&big())),
        );
    }

    #[test]
    fn nrrd_extra_bytes_are_noted() {
        let mut bytes = big();
        bytes.push(0);
        assert_eq!(
            reads(&file("endian: big\nencoding: raw\n", &bytes))
                .notes
                .len(),
            1
        );
        let source = reads(&file("endian: big\nencoding: gzip\n", &gzip(&bytes)));
        assert_eq!(source.late_notes().len(), 1);
    }

    #[test]
    fn nrrd_checksum_behind_the_samples_counts() {
        let mut bytes = file("endian: big\nencoding: gzip\n", &gzip(&big()));
        let last = bytes.len() - 8;
        bytes[last] ^= 1;
        let mut source = open_bytes("a.nrrd", &bytes).expect("opens");
        // Exactly as many bytes as there are samples: the error must come before the last of them.
        let mut out = vec![0; 48];
        assert!(source.reader.read_exact(&mut out).is_err());
    }
}
