//! Rows of numbers in files: CSV, and NumPy arrays of two axes.

use brickmarch::{Error, Result};
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// Bytes of a NumPy header that is written.
const NPY_HEADER: usize = 128;
/// Bytes of numbers that are turned at a time.
const RAW: usize = 1 << 14;
/// Most bytes of a NumPy header that is read.
const NPY_HEADER_MAX: usize = 1 << 16;

/// Whether a file name says NumPy; CSV otherwise.
pub(crate) fn is_npy(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("npy"))
}

/// Reads rows of `columns` numbers, some at a time.
pub(crate) struct Rows {
    name: String,
    columns: usize,
    from: From,
}

enum From {
    Csv(csv::Reader<BufReader<File>>, csv::StringRecord, bool),
    Npy {
        file: BufReader<File>,
        /// Where the rows start, and how many there are.
        start: u64,
        rows: u64,
        /// Row that is next.
        at: u64,
        wide: bool,
    },
}

impl Rows {
    /// # Errors
    /// When the file cannot be read, or is no array of `columns` columns.
    pub(crate) fn open(path: &Path, columns: usize) -> Result<Rows> {
        let file = File::open(path).map_err(|e| Error::io(path, "opening", e))?;
        let length = file
            .metadata()
            .map_err(|e| Error::io(path, "opening", e))?
            .len();
        let mut file = BufReader::with_capacity(1 << 18, file);
        let from = if is_npy(path) {
            let (rows, wide, start) = npy_header(&mut file, columns)
                .map_err(|e| Error::io(path, "reading the NumPy header", e))?;
            let row = columns as u64 * if wide { 8 } else { 4 };
            if rows.checked_mul(row).and_then(|n| n.checked_add(start)) != Some(length) {
                return Err(Error::bad_input(format!(
                    "{}: the header says {rows} rows of {columns} numbers, and the file has {length} bytes",
                    path.display()
                )));
            }
            From::Npy {
                file,
                start,
                rows,
                at: 0,
                wide,
            }
        } else {
            let reader = csv::ReaderBuilder::new()
                .has_headers(false)
                .flexible(true)
                .comment(Some(b'#'))
                .trim(csv::Trim::All)
                .from_reader(file);
            From::Csv(reader, csv::StringRecord::new(), true)
        };
        Ok(Rows {
            name: path.display().to_string(),
            columns,
            from,
        })
    }

    /// Replaces `out` by the next rows, at most `most`; none at the end.
    ///
    /// # Errors
    /// Names the line that is no row of numbers.
    pub(crate) fn next(&mut self, most: usize, out: &mut Vec<f64>) -> Result<()> {
        out.clear();
        match &mut self.from {
            From::Npy {
                file,
                rows,
                at,
                wide,
                ..
            } => {
                let count = (most as u64).min(*rows - *at);
                *at += count;
                let mut left = count as usize * self.columns;
                let mut raw = [0; RAW];
                let width = if *wide { 8 } else { 4 };
                while left > 0 {
                    let part = left.min(RAW / width);
                    let raw = &mut raw[..part * width];
                    file.read_exact(raw)
                        .map_err(|e| Error::io(Path::new(&self.name), "reading", e))?;
                    if *wide {
                        out.extend(raw.as_chunks().0.iter().map(|&b| f64::from_le_bytes(b)));
                    } else {
                        let singles = raw.as_chunks().0.iter();
                        out.extend(singles.map(|&b| f64::from(f32::from_le_bytes(b))));
                    }
                    left -= part;
                }
            }
            From::Csv(reader, record, first) => {
                while out.len() < most * self.columns
                    && reader
                        .read_record(record)
                        .map_err(|e| Error::bad_input(format!("{}: {e}", self.name)))?
                {
                    let numbers: Vec<f64> = record
                        .iter()
                        .map_while(|f| f.parse().ok())
                        .take(self.columns)
                        .collect();
                    if numbers.len() == self.columns {
                        out.extend(numbers);
                    } else if !*first {
                        // The first line may name the columns.
                        let line = record.position().map_or(0, csv::Position::line);
                        return Err(Error::bad_input(format!(
                            "{}: line {line}: {} numbers with commas are needed, as in {}",
                            self.name,
                            self.columns,
                            vec!["1.5"; self.columns].join(",")
                        )));
                    }
                    *first = false;
                }
            }
        }
        Ok(())
    }
}

impl Rows {
    /// Number of the row that is next and number of all, where [`go_to`](Self::go_to) works: in NumPy
    /// files.
    pub(crate) fn place(&self) -> Option<[u64; 2]> {
        match &self.from {
            From::Csv(..) => None,
            From::Npy { at, rows, .. } => Some([*at, *rows]),
        }
    }

    /// Makes `row` the next one.
    ///
    /// # Errors
    /// When the file has no such row or cannot go there.
    pub(crate) fn go_to(&mut self, row: u64) -> Result<()> {
        let failed = |e| Error::io(Path::new(&self.name), "going back in it", e);
        match &mut self.from {
            From::Npy {
                file,
                start,
                rows,
                at,
                wide,
            } if row <= *rows => {
                let bytes = self.columns as u64 * if *wide { 8 } else { 4 };
                file.seek(SeekFrom::Start(*start + row * bytes))
                    .map_err(failed)?;
                *at = row;
                Ok(())
            }
            _ => Err(failed(io::ErrorKind::Unsupported.into())),
        }
    }
}

/// Number of rows, whether they are f64, and where they start.
fn npy_header(file: &mut BufReader<File>, columns: usize) -> io::Result<(u64, bool, u64)> {
    let wrong = |what: String| io::Error::new(io::ErrorKind::InvalidData, what);
    let mut start = [0; 8];
    file.read_exact(&mut start)?;
    if !start.starts_with(b"\x93NUMPY") || !(1..=3).contains(&start[6]) {
        return Err(wrong("not a NumPy file of version 1 to 3".into()));
    }
    let width = if start[6] == 1 { 2 } else { 4 };
    let mut length = [0; 8];
    file.read_exact(&mut length[..width])?;
    let length = u64::from_le_bytes(length) as usize;
    if length > NPY_HEADER_MAX {
        return Err(wrong(format!("a header of {length} bytes")));
    }
    let mut text = vec![0; length];
    file.read_exact(&mut text)?;
    let text = String::from_utf8_lossy(&text)
        .replace([' ', '"'], "")
        .replace('\'', "");
    let wide = match (text.contains("descr:<f8"), text.contains("descr:<f4")) {
        (true, _) => true,
        (_, true) => false,
        _ => {
            return Err(wrong(
                "numbers must be float32 or float64, little-endian".into(),
            ));
        }
    };
    let shape = text
        .split_once("shape:(")
        .and_then(|(_, rest)| rest.split_once(')'))
        .map(|(shape, _)| shape.trim_end_matches(','));
    let axes: Option<Vec<u64>> = shape.and_then(|s| s.split(',').map(|n| n.parse().ok()).collect());
    match axes.as_deref() {
        Some(&[rows, n]) if n == columns as u64 && text.contains("fortran_order:False") => {
            Ok((rows, wide, (8 + width + length) as u64))
        }
        _ => Err(wrong(format!(
            "an array in C order of shape (N, {columns}) is needed"
        ))),
    }
}

/// Writes rows of numbers.
pub(crate) struct Table<W> {
    out: W,
    npy: bool,
    columns: usize,
    rows: u64,
}

impl<W: Write> Table<W> {
    /// CSV with a line of `names`.
    pub(crate) fn csv(mut out: W, names: &[&str]) -> io::Result<Self> {
        writeln!(out, "{}", names.join(","))?;
        Ok(Self {
            out,
            npy: false,
            columns: names.len(),
            rows: 0,
        })
    }

    /// A NumPy array of float64 with a column for each of `names`.
    pub(crate) fn npy(mut out: W, names: &[&str]) -> io::Result<Self> {
        out.write_all(&[0; NPY_HEADER])?;
        Ok(Self {
            out,
            npy: true,
            columns: names.len(),
            rows: 0,
        })
    }

    /// Adds rows, one after another.
    pub(crate) fn rows(&mut self, numbers: &[f64]) -> io::Result<()> {
        debug_assert_eq!(numbers.len() % self.columns, 0);
        self.rows += (numbers.len() / self.columns) as u64;
        if self.npy {
            let mut raw = [0; RAW];
            for part in numbers.chunks(RAW / 8) {
                for (to, value) in raw.as_chunks_mut().0.iter_mut().zip(part) {
                    *to = value.to_le_bytes();
                }
                self.out.write_all(&raw[..part.len() * 8])?;
            }
            return Ok(());
        }
        for row in numbers.chunks(self.columns) {
            for (n, value) in row.iter().enumerate() {
                let end = if n + 1 == row.len() { '\n' } else { ',' };
                write!(self.out, "{value}{end}")?;
            }
        }
        Ok(())
    }
}

impl<W: Write + Seek> Table<W> {
    /// Completes the file: a NumPy header says how many rows there are.
    pub(crate) fn finish(mut self) -> io::Result<u64> {
        if self.npy {
            let text = format!(
                "{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, {}), }}",
                self.rows, self.columns
            );
            self.out.seek(SeekFrom::Start(0))?;
            self.out.write_all(b"\x93NUMPY\x01\x00")?;
            self.out
                .write_all(&(NPY_HEADER as u16 - 10).to_le_bytes())?;
            writeln!(self.out, "{text:<width$}", width = NPY_HEADER - 11)?;
            self.out.seek(SeekFrom::End(0))?;
        }
        Ok(self.rows)
    }
}
