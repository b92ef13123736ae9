//! MetaImage (`.mha`, `.mhd`): inline or detached samples, plain, zlib-compressed or text.
//!
//! World coordinates are those of ITK, LPS (x to the left, y to the back, z up), as the file states
//! them. Row `a` of `TransformMatrix` is the world direction of index axis `a`.

use crate::input::{GZIP_MAGIC, Input, Members};
use crate::limits::{bad, domain, surplus, unsupported};
use crate::samples::{Encoding, Stored, Surplus, not_scalar};
use crate::text::{TextSamples, exactly, numbers, shorten};
use crate::volume::Source;
use crate::world::{LPS, phrase};
use brickmarch::{Affine, Error, Grid, Result, Units};
use flate2::bufread::ZlibDecoder;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Names of the fields that a header may begin with.
const FIRST: [&str; 4] = ["ObjectType", "NDims", "Comment", "ObjectSubType"];

pub(crate) fn is_header(head: &[u8]) -> bool {
    FIRST.iter().any(|name| {
        head.strip_prefix(name.as_bytes()).is_some_and(|rest| {
            let rest = &rest[..rest.len().min(8)];
            rest.iter().find(|b| !b.is_ascii_whitespace()) == Some(&b'=')
        })
    })
}

pub(crate) fn open(mut input: Input) -> Result<Source> {
    let path = input.path.clone();
    let header = Header::read(&mut input)?;
    let stored = header.stored()?;
    let domain = domain(&path, header.dims()?, stored.bytes())?;
    let mut notes = Vec::new();
    let grid = Grid {
        domain,
        index_to_world: header.place()?,
        units: header.units(&mut notes),
    };
    let binary = header.flag(&["BinaryData"])?.unwrap_or(true);
    let compressed = header.flag(&["CompressedData"])?.unwrap_or(false);
    let msb = ["BinaryDataByteOrderMSB", "ElementByteOrderMSB"];
    let encoding = Encoding {
        stored,
        big_endian: binary && stored.bytes() > 1 && header.flag(&msb)?.unwrap_or(false),
        scale: None,
        surplus: Surplus::Note,
    };
    let description = format!(
        "MetaImage {}{}{}, {}",
        stored.name(),
        if encoding.big_endian {
            " big-endian"
        } else {
            ""
        },
        if compressed { ", compressed" } else { "" },
        phrase(LPS),
    );
    let mut data = match header.data_file()? {
        Some(file) => Input::open_plain(&file)
            .map_err(|e| e.context(format!("{}: its ElementDataFile", path.display())))?,
        None => input,
    };
    let needed = domain.count() * stored.bytes() as u64;
    match (header.header_size()?, data.remaining()) {
        (-1, Some(rest)) if !compressed => {
            let front = surplus(&data.path, needed, rest)?;
            data.skip(front, "the bytes in front of the samples")?;
        }
        (-1, _) => return Err(unsupported(&path, "HeaderSize = -1 of compressed samples")),
        (n, _) => data.skip(n.unsigned_abs(), "the bytes in front of the samples")?,
    }
    if !compressed && binary {
        return Source::from_input(data, encoding, grid, description, notes);
    }
    let stated = header
        .get(&["CompressedDataSize"])
        .and_then(|t| t.parse().ok());
    if let (true, Some(stated), Some(found)) = (compressed, stated, data.remaining())
        && stated != found
    {
        let stated: u64 = stated;
        notes.push(format!(
            "CompressedDataSize is {stated}, the file has {found} bytes"
        ));
    }
    let (file, late) = (data.path.clone(), data.late.clone());
    let stream: Box<dyn Read + Send> = match (compressed, binary) {
        (true, true) => inflate(data)?,
        (true, false) => return Err(unsupported(&path, "compressed text samples")),
        _ => Box::new(TextSamples::new(data, &file, stored)),
    };
    Source::from_stream(stream, &file, &late, encoding, grid, description, notes)
}

/// The format says zlib; its readers accept gzip, so such files exist.
fn inflate(mut data: Input) -> Result<Box<dyn Read + Send>> {
    use std::io::BufRead;
    let (file, late) = (data.path.clone(), data.late.clone());
    let start = data
        .fill_buf()
        .map_err(|e| Error::io(&file, "reading the samples", e))?;
    Ok(if start.starts_with(&GZIP_MAGIC) {
        Box::new(Members::new(data, &file, &late))
    } else {
        Box::new(ZlibDecoder::new(data))
    })
}

struct Header {
    path: PathBuf,
    fields: BTreeMap<String, String>,
}

impl Header {
    /// Everything up to `ElementDataFile`, which is the last field.
    fn read(input: &mut Input) -> Result<Header> {
        let path = input.path.clone();
        let mut fields = BTreeMap::new();
        while !fields.contains_key("ElementDataFile") {
            let Some(line) = input.header_line()? else {
                return Err(bad(&path, "the header ends without ElementDataFile"));
            };
            if line.trim().is_empty() {
                continue;
            }
            let Some((name, value)) = line.split_once('=') else {
                return Err(bad(
                    &path,
                    format!("the header line '{}' is not 'name = value'", shorten(&line)),
                ));
            };
            let name = name.trim().to_owned();
            if fields.contains_key(&name) && name != "Comment" {
                return Err(bad(
                    &path,
                    format!("the header gives '{}' twice", shorten(&name)),
                ));
            }
            fields.insert(name, value.trim().to_owned());
        }
        Ok(Header { path, fields })
    }

    /// The first of several names for one field.
    fn get(&self, names: &[&str]) -> Option<&str> {
        names
            .iter()
            .find_map(|name| self.fields.get(*name))
            .map(String::as_str)
    }

    fn wrong(&self, name: &str, value: &str, want: &str) -> Error {
        bad(
            &self.path,
            format!(
                "the header says '{name} = {}', expected is {want}",
                shorten(value)
            ),
        )
    }

    fn flag(&self, names: &[&str]) -> Result<Option<bool>> {
        let Some(text) = self.get(names) else {
            return Ok(None);
        };
        match text.chars().next() {
            Some('T' | 't' | '1' | 'Y' | 'y') => Ok(Some(true)),
            Some('F' | 'f' | '0' | 'N' | 'n') => Ok(Some(false)),
            _ => Err(self.wrong(names[0], text, "True or False")),
        }
    }

    fn three(&self, names: &[&str]) -> Result<Option<[f64; 3]>> {
        let Some(text) = self.get(names) else {
            return Ok(None);
        };
        match exactly(text) {
            Some(values) => Ok(Some(values)),
            None => Err(self.wrong(names[0], text, "three numbers")),
        }
    }

    fn stored(&self) -> Result<Stored> {
        let channels = self.get(&["ElementNumberOfChannels"]).unwrap_or("1");
        if channels != "1" {
            let what = format!("{}-component", shorten(channels));
            return Err(not_scalar(&self.path, &what));
        }
        let Some(name) = self.get(&["ElementType"]) else {
            return Err(bad(&self.path, "the header has no 'ElementType'"));
        };
        Ok(match name {
            "MET_UCHAR" | "MET_ASCII_CHAR" => Stored::U8,
            "MET_CHAR" => Stored::I8,
            "MET_USHORT" => Stored::U16,
            "MET_SHORT" => Stored::I16,
            // MetaIO writes 32 bits for long too.
            "MET_UINT" | "MET_ULONG" => Stored::U32,
            "MET_INT" | "MET_LONG" => Stored::I32,
            "MET_ULONG_LONG" => Stored::U64,
            "MET_LONG_LONG" => Stored::I64,
            "MET_FLOAT" => Stored::F32,
            "MET_DOUBLE" => Stored::F64,
            other => return Err(not_scalar(&self.path, &format!("'{}'", shorten(other)))),
        })
    }

    fn dims(&self) -> Result<[i128; 3]> {
        if let Some(kind) = self.get(&["ObjectType"])
            && kind != "Image"
        {
            return Err(unsupported(
                &self.path,
                format!(
                    "a MetaIO object of type '{}'; only Image is read",
                    shorten(kind)
                ),
            ));
        }
        let text = self.get(&["DimSize"]).unwrap_or_default();
        let sizes: Vec<i128> =
            numbers(text).ok_or_else(|| self.wrong("DimSize", text, "three whole numbers"))?;
        let dimensions = self.get(&["NDims"]).unwrap_or("3");
        if dimensions.parse() != Ok(sizes.len()) {
            let want = format!("{} as DimSize = {} has it", sizes.len(), shorten(text));
            return Err(self.wrong("NDims", dimensions, &want));
        }
        sizes.try_into().map_err(|sizes: Vec<i128>| {
            unsupported(
                &self.path,
                format!(
                    "an image of {} dimensions ({}); a volume has three",
                    sizes.len(),
                    shorten(text)
                ),
            )
        })
    }

    fn place(&self) -> Result<Affine> {
        let spacing = self
            .three(&["ElementSpacing", "ElementSize"])?
            .unwrap_or([1.0; 3]);
        let origin = self
            .three(&["Offset", "Position", "Origin"])?
            .unwrap_or([0.0; 3]);
        let names = ["TransformMatrix", "Rotation", "Orientation"];
        let mut columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        if let Some(text) = self.get(&names) {
            let values: [f64; 9] =
                exactly(text).ok_or_else(|| self.wrong(names[0], text, "nine numbers"))?;
            columns = std::array::from_fn(|a| std::array::from_fn(|r| values[3 * a + r]));
        }
        for (column, step) in columns.iter_mut().zip(spacing) {
            *column = column.map(|v| v * step);
        }
        Ok(Affine::from_columns(columns, origin))
    }

    /// Millimetres, as ITK means it, unless the file says otherwise.
    fn units(&self, notes: &mut Vec<String>) -> Units {
        match self.get(&["DistanceUnits"]) {
            None | Some("mm" | "?" | "") => Units::Millimetre,
            Some("um") => Units::Micrometre,
            Some("m") => Units::Metre,
            Some(other) => {
                notes.push(format!("DistanceUnits '{}' are not known", shorten(other)));
                Units::Unknown
            }
        }
    }

    fn header_size(&self) -> Result<i64> {
        let text = self.get(&["HeaderSize"]).unwrap_or("0");
        text.parse()
            .ok()
            .filter(|&n: &i64| n >= -1)
            .ok_or_else(|| self.wrong("HeaderSize", text, "a count of bytes, or -1"))
    }

    /// The detached file, relative to the folder of the header.
    fn data_file(&self) -> Result<Option<PathBuf>> {
        let name = self.get(&["ElementDataFile"]).unwrap_or_default();
        if matches!(name, "LOCAL" | "Local" | "local") {
            return Ok(None);
        }
        if name.starts_with("LIST") || name.contains('%') {
            return Err(unsupported(
                &self.path,
                "samples in several data files; save the volume as one file",
            ));
        }
        if name.is_empty() {
            return Err(self.wrong("ElementDataFile", name, "a file name or LOCAL"));
        }
        let folder = self.path.parent().unwrap_or(Path::new(""));
        Ok(Some(folder.join(name)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{family, gzip, open_bytes, samples};
    use crate::volume::{OpenOptions, open_volume};
    use brickmarch::{ErrorKind, SampleType};
    use std::io::Write;

    const HEAD: &str = "ObjectType = Image\nNDims = 3\nDimSize = 2 3 4\nElementType = MET_SHORT\n";

    fn file(more: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = format!("{HEAD}{more}ElementDataFile = LOCAL\n").into_bytes();
        bytes.extend(data);
        bytes
    }

    fn little() -> Vec<u8> {
        (0..24i16).flat_map(|v| (v - 7).to_le_bytes()).collect()
    }

    fn big() -> Vec<u8> {
        (0..24i16).flat_map(|v| (v - 7).to_be_bytes()).collect()
    }

    fn zlib(bytes: &[u8]) -> Vec<u8> {
        let level = flate2::Compression::fast();
        let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), level);
        encoder.write_all(bytes).expect("memory");
        encoder.finish().expect("memory")
    }

    fn reads(bytes: &[u8]) -> Source {
        let mut source = open_bytes("a.mha", bytes).expect("opens");
        assert_eq!(source.grid.domain.size(), [2, 3, 4]);
        assert_eq!(source.sample, SampleType::I16);
        assert_eq!(samples(&mut source).expect("reads"), little());
        source
    }

    fn refused(bytes: &[u8]) -> Error {
        match open_bytes("a.mha", bytes) {
            Err(error) => error,
            Ok(mut source) => Error::io(
                Path::new("a"),
                "reading",
                samples(&mut source).expect_err("wrong"),
            ),
        }
    }

    #[test]
    fn metaimage_encodings() {
        reads(&file("", &little()));
        reads(&file("BinaryDataByteOrderMSB = True\n", &big()));
        reads(&file("ElementByteOrderMSB = true\n", &big()));
        reads(&file("CompressedData = True\n", &zlib(&little())));
        reads(&file(
            "CompressedData = True\nElementByteOrderMSB = True\n",
            &zlib(&big()),
        ));
        reads(&file("CompressedData = True\n", &gzip(&little())));
        let text: String = (0..24).map(|v| format!("{} ", v - 7)).collect();
        reads(&file("BinaryData = False\n", text.as_bytes()));
        let stated = zlib(&little()).len() + 3;
        let more = format!("CompressedData = True\nCompressedDataSize = {stated}\n");
        assert_eq!(reads(&file(&more, &zlib(&little()))).notes.len(), 1);
    }

    #[test]
    fn metaimage_detached() {
        let folder = tempfile::tempdir().expect("folder");
        let at = |name: &str| folder.path().join(name);
        let write = |more: &str, name: &str| {
            std::fs::write(at("a.mhd"), format!("{HEAD}{more}ElementDataFile = {name}"))
                .expect("writes");
            open_volume(&at("a.mhd"), &OpenOptions::default())
        };
        let missing = write("", "a.raw").err().expect("missing").to_string();
        assert!(
            missing.contains("ElementDataFile") && missing.contains("a.raw"),
            "{missing}"
        );
        std::fs::write(at("a.raw"), [b"head".as_slice(), &big()].concat()).expect("writes");
        for size in ["4", "-1"] {
            let more = format!("HeaderSize = {size}\nElementByteOrderMSB = True\n");
            let mut source = write(&more, "a.raw").expect("opens");
            assert_eq!(samples(&mut source).expect("reads"), little());
        }
        std::fs::write(at("a.zraw"), zlib(&little())).expect("writes");
        let mut source = write("CompressedData = True\n", "a.zraw").expect("opens");
        assert_eq!(samples(&mut source).expect("reads"), little());
        for several in ["LIST", "LIST 2", "a%02d.raw 1 4 1"] {
            let error = write("", several).err().expect("several");
            assert_eq!(error.kind(), ErrorKind::Unsupported, "{error}");
        }
        assert!(write("HeaderSize = 999\n", "a.raw").is_err());
        assert!(write("HeaderSize = -1\nCompressedData = True\n", "a.zraw").is_err());
        assert!(write("", "").is_err());
    }

    #[test]
    fn metaimage_places() {
        let place = |more: &str| {
            let source = open_bytes("a.mha", &file(more, &little())).expect("opens");
            (source.grid.index_to_world, source.grid.units)
        };
        let (map, units) = place("ElementSpacing = 0.5 2 3\nOffset = 1 -2 0.1\n");
        assert_eq!(map, Affine::from_spacing([0.5, 2.0, 3.0], [1.0, -2.0, 0.1]));
        assert_eq!(units, Units::Millimetre);
        // Index x runs along world y, y along -x: rows are the axes.
        let (map, units) = place(
            "TransformMatrix = 0 1 0 -1 0 0 0 0 -1\nElementSpacing = 2 3 4\nPosition = 5 6 7\nDistanceUnits = um\n",
        );
        assert_eq!(map.apply([1.0, 0.0, 0.0]), [5.0, 8.0, 7.0]);
        assert_eq!(map.apply([0.0, 1.0, 0.0]), [2.0, 6.0, 7.0]);
        assert_eq!(map.apply([0.0, 0.0, 1.0]), [5.0, 6.0, 3.0]);
        assert!(map.is_left_handed());
        assert_eq!(units, Units::Micrometre);
    }

    #[test]
    fn metaimage_wrong_headers() {
        let with = |from: &str, to: &str| {
            let good = String::from_utf8(file("", b"")).expect("text");
            assert!(good.contains(from), "{from}");
            let mut bytes = good.replace(from, to).into_bytes();
            bytes.extend(little());
            refused(&bytes)
        };
        with("DimSize = 2 3 4", "DimSize = 0 3 4");
        with("DimSize = 2 3 4", "DimSize = 2 -3 4");
        with("DimSize = 2 3 4", "DimSize = 2 3 5");
        with("DimSize = 2 3 4", "DimSize = 2 3");
        with("DimSize = 2 3 4", "DimSize = 2 3 x");
        with("DimSize = 2 3 4\n", "");
        with(
            "DimSize = 2 3 4",
            "DimSize = 99999999999 99999999999 99999999999",
        );
        with("DimSize = 2 3 4", "DimSize = 100000000 100000000 100000000");
        with("ElementType = MET_SHORT\n", "");
        for (to, kind) in [
            ("ElementType = MET_SHORT_ARRAY", ErrorKind::Unsupported),
            (
                "ElementType = MET_SHORT\nElementNumberOfChannels = 3",
                ErrorKind::Unsupported,
            ),
            (
                "ElementType = MET_SHORT\nElementSpacing = 0 1 1",
                ErrorKind::BadInput,
            ),
            (
                "ElementType = MET_SHORT\nElementSpacing = 1 1",
                ErrorKind::BadInput,
            ),
            (
                "ElementType = MET_SHORT\nTransformMatrix = 1 0 0 1",
                ErrorKind::BadInput,
            ),
            (
                "ElementType = MET_SHORT\nCompressedData = maybe",
                ErrorKind::BadInput,
            ),
            (
                "ElementType = MET_SHORT\nHeaderSize = -2",
                ErrorKind::BadInput,
            ),
            (
                "ElementType = MET_SHORT\nDimSize = 2 3 4",
                ErrorKind::BadInput,
            ),
            (
                "ElementType = MET_SHORT\nno equals sign",
                ErrorKind::BadInput,
            ),
        ] {
            assert_eq!(with("ElementType = MET_SHORT", to).kind(), kind, "{to}");
        }
        assert_eq!(
            with("NDims = 3\nDimSize = 2 3 4", "NDims = 2\nDimSize = 6 4").kind(),
            ErrorKind::Unsupported
        );
        assert_eq!(with("= Image", "= Tube").kind(), ErrorKind::Unsupported);
        with("ElementDataFile = LOCAL\n", "");
        assert!(open_bytes("a.mha", b"PNG").is_err());
    }

    #[test]
    fn metaimage_huge_declared_sizes() {
        let packed = file("CompressedData = True\n", &zlib(&little()));
        let text = HEAD.replace("2 3 4", "9999 9999 9999");
        let mut huge = text.into_bytes();
        huge.extend(&packed[HEAD.len()..]);
        assert_eq!(refused(&huge).kind(), ErrorKind::Truncated);
    }

    #[test]
    fn metaimage_truncations_and_flips() {
        family("a.mha", &file("ElementByteOrderMSB = True\n", &big()));
        family("a.mha", &file("CompressedData = True\n", &zlib(&little())));
    }

    #[test]
    fn metaimage_extra_bytes_are_noted() {
        let mut bytes = little();
        bytes.push(1);
        assert_eq!(reads(&file("", &bytes)).notes.len(), 1);
        let source = reads(&file("CompressedData = True\n", &zlib(&bytes)));
        assert_eq!(source.late_notes().len(), 1);
    }
}
