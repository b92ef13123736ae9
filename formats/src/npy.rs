//! NumPy `.npy`, versions 1 to 3.
//!
//! Axes: an array in C order has the shape `(nz, ny, nx)`, an array in Fortran order the shape
//! `(nx, ny, nz)`. In both, x is the axis that varies fastest in the file, so that samples stream
//! without a transpose, and `a` and `numpy.asfortranarray(a.T)` are the same volume.
//! The file states no spacing: world is index space.

use crate::input::Input;
use crate::limits::{HEADER_BYTES_MAX, bad, domain, unsupported};
use crate::samples::{Encoding, Stored, Surplus, not_scalar};
use crate::text::shorten;
use crate::volume::Source;
use brickmarch::Result;
use brickmarch::lattice::Grid;
use std::path::Path;

pub(crate) const MAGIC: &[u8] = b"\x93NUMPY";

pub(crate) fn open(mut input: Input) -> Result<Source> {
    let path = input.path.clone();
    let start = input.read_array(8, "the header")?;
    if !start.starts_with(MAGIC) {
        return Err(bad(&path, "does not start with the mark of a NumPy file"));
    }
    let length_bytes = match start[6] {
        1 => 2,
        2 | 3 => 4,
        version => {
            return Err(unsupported(
                &path,
                format!("version {version} of the NumPy format; versions 1 to 3 are read"),
            ));
        }
    };
    let mut length = [0; 8];
    length[..length_bytes].copy_from_slice(&input.read_array(length_bytes as u64, "the header")?);
    let length = u64::from_le_bytes(length);
    if length > HEADER_BYTES_MAX {
        return Err(bad(
            &path,
            format!("a header of {length} bytes is beyond the limit of {HEADER_BYTES_MAX}"),
        ));
    }
    let text = input.read_array(length, "the header")?;
    let header = Header::parse(&path, &String::from_utf8_lossy(&text))?;
    let (stored, big_endian) = number_type(&path, &header.descr)?;
    let domain = domain(&path, header.dims(&path)?, stored.bytes())?;
    let encoding = Encoding {
        stored,
        big_endian,
        scale: None,
        surplus: Surplus::Note,
    };
    let description = format!(
        "NumPy array {} in {} order, index space",
        header.descr,
        if header.fortran { "Fortran" } else { "C" }
    );
    Source::from_input(input, encoding, Grid::new(domain), description, Vec::new())
}

struct Header {
    descr: String,
    fortran: bool,
    shape: Vec<i128>,
}

impl Header {
    fn parse(path: &Path, text: &str) -> Result<Header> {
        let wrong = |what: &str| bad(path, format!("the NumPy header {what}: {}", shorten(text)));
        let mut literal = Literal { rest: text.trim() };
        let Some(Value::Dict(entries)) =
            literal.value(0).filter(|_| literal.rest.trim().is_empty())
        else {
            return Err(wrong("is not a Python dictionary"));
        };
        let entry = |name: &str| {
            entries
                .iter()
                .find(|(key, _)| *key == Value::Str(name.into()))
                .map(|(_, value)| value)
        };
        let descr = match entry("descr") {
            Some(Value::Str(descr)) => descr.clone(),
            Some(Value::List(_)) => {
                return Err(unsupported(
                    path,
                    "an array of structures; save one plain field of it",
                ));
            }
            _ => return Err(wrong("has no 'descr'")),
        };
        let Some(Value::Bool(fortran)) = entry("fortran_order") else {
            return Err(wrong("has no 'fortran_order'"));
        };
        let shape = match entry("shape") {
            Some(Value::Tuple(axes)) => axes
                .iter()
                .map(|axis| match axis {
                    Value::Int(n) => Some(*n),
                    _ => None,
                })
                .collect::<Option<Vec<i128>>>(),
            _ => None,
        };
        Ok(Header {
            descr,
            fortran: *fortran,
            shape: shape.ok_or_else(|| wrong("has no 'shape'"))?,
        })
    }

    /// x, y, z.
    fn dims(&self, path: &Path) -> Result<[i128; 3]> {
        let shape: [i128; 3] = self.shape.as_slice().try_into().map_err(|_| {
            unsupported(
                path,
                format!(
                    "an array of {} dimensions, shape {:?}; a volume has three, (nz, ny, nx): \
                     save one part of it, or reshape it",
                    self.shape.len(),
                    self.shape
                ),
            )
        })?;
        let [a, b, c] = shape;
        Ok(if self.fortran { shape } else { [c, b, a] })
    }
}

fn number_type(path: &Path, descr: &str) -> Result<(Stored, bool)> {
    let (order, code) = match descr.chars().next() {
        Some(order @ ('<' | '>' | '|' | '=')) => (order, &descr[1..]),
        _ => ('<', descr),
    };
    let stored = match code {
        "b1" => Stored::Bool,
        "u1" => Stored::U8,
        "i1" => Stored::I8,
        "u2" => Stored::U16,
        "i2" => Stored::I16,
        "u4" => Stored::U32,
        "i4" => Stored::I32,
        "u8" => Stored::U64,
        "i8" => Stored::I64,
        "f2" => Stored::F16,
        "f4" => Stored::F32,
        "f8" => Stored::F64,
        _ => return Err(not_scalar(path, &format!("'{}'", shorten(descr)))),
    };
    Ok((stored, order == '>'))
}

/// The few Python literals that a header is made of.
#[derive(Debug, PartialEq)]
enum Value {
    Str(String),
    Bool(bool),
    Int(i128),
    Tuple(Vec<Value>),
    List(Vec<Value>),
    Dict(Vec<(Value, Value)>),
}

struct Literal<'a> {
    rest: &'a str,
}

impl Literal<'_> {
    /// Deepest nesting; a header needs two.
    const DEPTH_MAX: u32 = 8;

    fn eat(&mut self, token: &str) -> bool {
        self.rest = self.rest.trim_start();
        let found = self.rest.strip_prefix(token);
        self.rest = found.unwrap_or(self.rest);
        found.is_some()
    }

    fn value(&mut self, depth: u32) -> Option<Value> {
        if depth > Self::DEPTH_MAX {
            return None;
        }
        if self.eat("{") {
            return self.entries(depth).map(Value::Dict);
        }
        if self.eat("(") {
            return self.items(")", depth).map(Value::Tuple);
        }
        if self.eat("[") {
            return self.items("]", depth).map(Value::List);
        }
        for (word, value) in [("True", true), ("False", false)] {
            if self.eat(word) {
                return Some(Value::Bool(value));
            }
        }
        for quote in ["'", "\""] {
            if self.eat(quote) {
                let (text, rest) = self.rest.split_once(quote)?;
                self.rest = rest;
                return (!text.contains('\\')).then(|| Value::Str(text.into()));
            }
        }
        let negative = self.eat("-");
        let digits = self.rest.len()
            - self
                .rest
                .trim_start_matches(|c: char| c.is_ascii_digit())
                .len();
        let (number, rest) = self.rest.split_at(digits);
        // Python 2 wrote long integers with an L.
        self.rest = rest.strip_prefix('L').unwrap_or(rest);
        let number: i128 = number.parse().ok()?;
        Some(Value::Int(if negative { -number } else { number }))
    }

    fn items(&mut self, end: &str, depth: u32) -> Option<Vec<Value>> {
        let mut items = Vec::new();
        while !self.eat(end) {
            items.push(self.value(depth + 1)?);
            if !self.eat(",") {
                return self.eat(end).then_some(items);
            }
        }
        Some(items)
    }

    fn entries(&mut self, depth: u32) -> Option<Vec<(Value, Value)>> {
        let mut entries = Vec::new();
        while !self.eat("}") {
            let key = self.value(depth + 1)?;
            if !self.eat(":") {
                return None;
            }
            entries.push((key, self.value(depth + 1)?));
            if !self.eat(",") {
                return self.eat("}").then_some(entries);
            }
        }
        Some(entries)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{family, open_bytes, samples};
    use brickmarch::{ErrorKind, Kind, SampleType};

    fn file(version: u8, dict: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([version, 0]);
        let length = dict.len() as u32 + 1;
        if version == 1 {
            bytes.extend((length as u16).to_le_bytes());
        } else {
            bytes.extend(length.to_le_bytes());
        }
        bytes.extend(dict.bytes());
        bytes.push(b'\n');
        bytes.extend(data);
        bytes
    }

    fn dict(descr: &str, fortran: bool, shape: &str) -> String {
        let fortran = if fortran { "True" } else { "False" };
        format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}   ")
    }

    #[test]
    fn npy_axes_of_both_orders() {
        let data: Vec<u8> = (0..24).collect();
        for (fortran, shape) in [(false, "(4, 3, 2)"), (true, "(2, 3, 4)")] {
            for version in 1..=3 {
                let bytes = file(version, &dict("|u1", fortran, shape), &data);
                let mut source = open_bytes("a.npy", &bytes).expect("opens");
                assert_eq!(source.grid.domain.size(), [2, 3, 4]);
                assert_eq!(samples(&mut source).expect("reads"), data);
            }
        }
    }

    #[test]
    fn npy_types() {
        let cases = [
            ("|b1", SampleType::Bit, Kind::Mask),
            ("<i2", SampleType::I16, Kind::Density),
            (">u4", SampleType::U32, Kind::Density),
            ("<f2", SampleType::F32, Kind::Density),
            ("<f8", SampleType::F32, Kind::Density),
            ("<i8", SampleType::I32, Kind::Density),
        ];
        for (descr, sample, kind) in cases {
            let width: usize = descr[2..].parse().expect("digit");
            let bytes = file(1, &dict(descr, false, "(1, 1, 2)"), &vec![0; 2 * width]);
            let mut source = open_bytes("a.npy", &bytes).expect("opens");
            assert_eq!((source.sample, source.kind), (sample, kind), "{descr}");
            assert_eq!(
                samples(&mut source).expect("reads").len(),
                2 * sample.bytes()
            );
        }
        for descr in ["<c8", "|O", "|S5", "<U3", "<M8[ns]", "", "é"] {
            let bytes = file(1, &dict(descr, false, "(1, 1, 2)"), &[0; 64]);
            let error = open_bytes("a.npy", &bytes).err().expect("not a number");
            assert_eq!(error.kind(), ErrorKind::Unsupported, "{descr}: {error}");
        }
    }

    #[test]
    fn npy_wrong_headers() {
        let refused = |dict: &str| {
            let bytes = file(1, dict, &[0; 64]);
            open_bytes("a.npy", &bytes)
                .err()
                .expect("wrong")
                .to_string()
        };
        for shape in [
            "(0, 1, 1)",
            "(1, -1, 1)",
            "(8, 8)",
            "()",
            "(2,2,2,2)",
            "3",
            "('a',1,1)",
        ] {
            refused(&dict("|u1", false, shape));
        }
        assert!(
            refused("{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (1,1,1)}")
                .contains("structures")
        );
        for text in [
            "",
            "{",
            "[]",
            "{'descr': '<f4'}",
            "{'a' 'b'}",
            &"(".repeat(5000),
        ] {
            refused(text);
        }
        assert!(open_bytes("a.npy", &file(9, &dict("|u1", false, "(1,1,1)"), &[0])).is_err());
        assert!(open_bytes("a.npy", b"not numpy at all").is_err());
    }

    #[test]
    fn npy_huge_declared_sizes() {
        let huge = i64::MAX.to_string();
        for shape in [
            format!("({huge}, {huge}, {huge})"),
            "(100000000, 100000000, 100000000)".into(),
            "(1000, 1000, 1000)".into(),
            format!("({}, 1, 1)", "9".repeat(60)),
        ] {
            let bytes = file(1, &dict("<f4", false, &shape), &[0; 64]);
            assert!(open_bytes("a.npy", &bytes).is_err(), "{shape}");
        }
        let mut bytes = file(2, &dict("<f4", false, "(1,1,1)"), &[0; 4]);
        bytes[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(open_bytes("a.npy", &bytes).is_err());
    }

    #[test]
    fn npy_truncations_and_flips() {
        let data: Vec<u8> = (0..24u16).flat_map(|v| v.to_le_bytes()).collect();
        family("a.npy", &file(1, &dict("<u2", false, "(2, 3, 4)"), &data));
    }

    #[test]
    fn npy_extra_bytes_are_noted() {
        let bytes = file(1, &dict("|u1", false, "(1, 1, 2)"), &[1, 2, 3]);
        let mut source = open_bytes("a.npy", &bytes).expect("opens");
        assert_eq!(samples(&mut source).expect("reads"), [1, 2]);
        assert_eq!(source.notes.len(), 1);
    }
}
