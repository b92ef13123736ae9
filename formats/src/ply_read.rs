//! PLY into a mesh in memory.
//!
//! The header is read by a parser crate. The common layout, binary little endian with float
//! positions and triangles only, is decoded here in blocks; every other layout goes element by
//! element, binary ones through the crate, so that no second copy of the mesh exists.

use crate::aside::read_exact_at;
use crate::lines::next_line;
use crate::loaded::{Input, Loaded, push};
use brickmarch::mesh::{EdgeKey, MeshSource};
use brickmarch::{ErrorKind, Mesh, Permit, Result};
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{
    ElementDef, Encoding, Header, Property, PropertyAccess, PropertyAccessResult, PropertyType,
    ScalarType,
};
use std::io::{BufRead, BufReader, Cursor, Read, Seek, SeekFrom};

/// Longest header that is read.
const MOST_HEADER_BYTES: u64 = 1 << 16;

/// Longest single element; lists declare their own length, which must not be believed.
const MOST_ELEMENT_BYTES: u64 = 1 << 20;

/// Bytes that are decoded at one time.
const BLOCK_BYTES: usize = 1 << 20;

/// Scalars of a vertex that are kept.
const NAMES: [&str; 10] = [
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "edge_x",
    "edge_y",
    "edge_z",
    "edge_axis",
];

/// What is known of the file before its elements are read.
struct Plan {
    header: Header,
    /// Where the elements start.
    start: u64,
    vertices: usize,
    faces: u64,
    normals: bool,
    keys: bool,
}

pub(crate) fn read_ply(mut input: Input) -> Result<Loaded> {
    let plan = plan(&mut input)?;
    let bytes = plan.vertices as u64
        * (12 + if plan.normals { 12 } else { 0 } + if plan.keys { 16 } else { 0 })
        + plan.faces * size_of::<[u32; 3]>() as u64
        + (BLOCK_BYTES as u64 + MOST_ELEMENT_BYTES);
    let mut permit = input.take(bytes)?;
    let mut mesh = Mesh::default();
    mesh.positions.reserve_exact(plan.vertices);
    if plan.normals {
        mesh.normals.reserve_exact(plan.vertices);
    }
    if plan.keys {
        mesh.keys.reserve_exact(plan.vertices);
    }
    // The counts have been checked against the length of the file.
    mesh.triangles.reserve_exact(plan.faces as usize);
    if !(is_plain(&plan) && read_plain(&mut input, &plan, &mut mesh)?) {
        mesh.positions.clear();
        mesh.triangles.clear();
        read_any(&mut input, &plan, &mut mesh, &mut permit)?;
    }
    Ok(Loaded::new(mesh, permit))
}

fn plan(input: &mut Input) -> Result<Plan> {
    let mut bytes = Vec::new();
    (&mut input.file)
        .take(MOST_HEADER_BYTES)
        .read_to_end(&mut bytes)
        .map_err(|e| input.io(e))?;
    // Comments may be in any encoding; the parser wants text.
    for byte in &mut bytes {
        if !byte.is_ascii() {
            *byte = b'?';
        }
    }
    let mut reader = Reader::new(Cursor::new(&bytes[..]));
    let header = Parser::<Record>::new()
        .read_header(&mut reader)
        .map_err(|e| parse_error(input, "in the header", &e))?;
    let start = reader.get_ref().position();
    check_counts(input, &header, input.length - start)?;
    let vertex = header
        .elements
        .get("vertex")
        .ok_or_else(|| input.damaged("the header names no vertices"))?;
    let is_scalar = |name: &str| {
        vertex
            .properties
            .get(name)
            .is_some_and(|p| matches!(p.data_type, PropertyType::Scalar(_)))
    };
    if !NAMES[..3].iter().all(|name| is_scalar(name)) {
        return Err(input.damaged("the vertices have no x, y and z"));
    }
    let face = header.elements.get("face").filter(|face| {
        let is_list = |name| {
            face.properties.get(name).is_some_and(
                |p| matches!(&p.data_type, PropertyType::List(_, index) if !is_float(index)),
            )
        };
        is_list("vertex_indices") || is_list("vertex_index")
    });
    let Some(face) = face else {
        return Err(input.error(
            ErrorKind::Unsupported,
            "no faces with a list vertex_indices: point clouds and strips are not meshes",
        ));
    };
    Ok(Plan {
        start,
        vertices: input.vertex_count(vertex.count as u64)?,
        faces: face.count as u64,
        normals: NAMES[3..6].iter().all(|name| is_scalar(name)),
        keys: NAMES[6..].iter().all(|name| is_scalar(name)),
        header,
    })
}

/// Whether the elements that the header promises can be in `available` bytes.
fn check_counts(input: &Input, header: &Header, available: u64) -> Result<()> {
    let mut least = 0_u128;
    for element in header.elements.values() {
        let record: u64 = match header.encoding {
            // A digit and a separator each.
            Encoding::Ascii => 2 * element.properties.len() as u64,
            _ => element
                .properties
                .values()
                .map(|p| match &p.data_type {
                    PropertyType::Scalar(scalar) | PropertyType::List(scalar, _) => size(scalar),
                })
                .sum(),
        };
        if record == 0 && element.count > 0 {
            return Err(input.damaged(format_args!("element {} has no properties", element.name)));
        }
        least += u128::from(record) * element.count as u128;
    }
    // The last separator of a text may be missing.
    if least > u128::from(available) + 1 {
        return Err(input.truncated(format_args!(
            "the header promises at least {least} bytes of elements; {available} follow it"
        )));
    }
    Ok(())
}

fn size(scalar: &ScalarType) -> u64 {
    match scalar {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
}

fn is_float(scalar: &ScalarType) -> bool {
    matches!(scalar, ScalarType::Float | ScalarType::Double)
}

fn parse_error(input: &Input, place: &str, error: &ParseError) -> brickmarch::Error {
    let kind = match error.kind() {
        std::io::ErrorKind::UnexpectedEof => ErrorKind::Truncated,
        std::io::ErrorKind::InvalidInput | std::io::ErrorKind::InvalidData => ErrorKind::Damaged,
        _ => ErrorKind::Io,
    };
    let text = error.to_string();
    let words: Vec<&str> = text.split_whitespace().collect();
    let line: String = words.join(" ").chars().take(200).collect();
    input.error(kind, format_args!("{place}: {line}"))
}

fn lost_vertex(input: &Input, face: u64, vertex: i64, count: usize) -> brickmarch::Error {
    input.damaged(format_args!("face {face} names vertex {vertex} of {count}"))
}

// ---- the common layout

/// Bytes of a triangle in the common layout, before what else a face may have.
const TRIANGLE_BYTES: usize = 13;

/// Vertices first and then faces, all scalars of the vertices that are kept in their usual type,
/// one list a face and scalars behind it.
fn is_plain(plan: &Plan) -> bool {
    let header = &plan.header;
    let [Some(first), Some(second)] = [0, 1].map(|i| header.elements.get_index(i)) else {
        return false;
    };
    let usual = |(name, property): (&String, &ply_rs_bw::ply::PropertyDef)| {
        let PropertyType::Scalar(scalar) = &property.data_type else {
            return false;
        };
        match NAMES.iter().position(|n| n == name) {
            Some(0..=5) => *scalar == ScalarType::Float,
            Some(6..=8) => *scalar == ScalarType::Int,
            Some(_) => *scalar == ScalarType::UChar,
            None => true,
        }
    };
    let triangles = |face: &ElementDef| {
        let mut properties = face.properties.values();
        let list = |p: &ply_rs_bw::ply::PropertyDef| {
            matches!(
                &p.data_type,
                PropertyType::List(
                    ScalarType::UChar | ScalarType::Char,
                    ScalarType::Int | ScalarType::UInt
                )
            )
        };
        properties.next().is_some_and(list)
            && properties.all(|p| matches!(p.data_type, PropertyType::Scalar(_)))
    };
    header.encoding == Encoding::BinaryLittleEndian
        && first.0 == "vertex"
        && second.0 == "face"
        && first.1.properties.iter().all(usual)
        && triangles(second.1)
}

/// Calls `each` with `count` records of `size` bytes, many at a time.
fn in_blocks(
    input: &Input,
    count: u64,
    size: usize,
    buffer: &mut Vec<u8>,
    mut each: impl FnMut(u64, &[u8]) -> Result<bool>,
) -> Result<bool> {
    let records = (BLOCK_BYTES / size).max(1) as u64;
    let mut first = 0;
    while first < count {
        input.budget.check_cancelled()?;
        let block = records.min(count - first);
        buffer.resize(block as usize * size, 0);
        (&input.file).read_exact(buffer).map_err(|e| input.io(e))?;
        if !each(first, buffer)? {
            return Ok(false);
        }
        first += block;
    }
    Ok(true)
}

fn float(record: &[u8], at: usize) -> f32 {
    f32::from_bits(word(record, at))
}

fn word(record: &[u8], at: usize) -> u32 {
    let bytes = record[at..at + 4].try_into().expect("four bytes");
    u32::from_le_bytes(bytes)
}

/// Where the records of the common layout are.
struct Records {
    /// Offsets of the scalars of [`NAMES`] in a vertex.
    offsets: [usize; NAMES.len()],
    vertex_bytes: usize,
    face_bytes: usize,
    /// Where the faces start.
    faces: u64,
}

impl Records {
    /// `None` when there are not enough bytes for triangles.
    fn of(plan: &Plan, length: u64) -> Option<Self> {
        let mut offsets = [0; NAMES.len()];
        let mut vertex_bytes = 0;
        for (name, property) in &plan.header.elements["vertex"].properties {
            if let Some(i) = NAMES.iter().position(|n| n == name) {
                offsets[i] = vertex_bytes;
            }
            if let PropertyType::Scalar(scalar) = &property.data_type {
                vertex_bytes += size(scalar) as usize;
            }
        }
        let more = plan.header.elements["face"].properties.values().skip(1);
        let more = more.map(|p| match &p.data_type {
            PropertyType::Scalar(scalar) => size(scalar) as usize,
            PropertyType::List(..) => 0,
        });
        let face_bytes = TRIANGLE_BYTES + more.sum::<usize>();
        // The counts were checked: their product with a byte each is in the file.
        let faces = plan.start + plan.vertices as u64 * vertex_bytes as u64;
        let end = u128::from(faces) + u128::from(plan.faces) * face_bytes as u128;
        (end <= u128::from(length)).then_some(Self {
            offsets,
            vertex_bytes,
            face_bytes,
            faces,
        })
    }
}

/// A PLY file of the common layout, read where it is.
struct InPlace {
    file: std::fs::File,
    path: std::path::PathBuf,
    start: u64,
    vertices: u64,
    triangles: u64,
    records: Records,
}

/// The mesh as it is in the file, or nothing when its layout is another than the common one.
pub(crate) fn ply_in_place(mut input: Input) -> Result<Option<Box<dyn MeshSource>>> {
    let plan = plan(&mut input)?;
    if !is_plain(&plan) {
        return Ok(None);
    }
    let Some(records) = Records::of(&plan, input.length) else {
        return Ok(None);
    };
    Ok(Some(Box::new(InPlace {
        path: input.path.to_path_buf(),
        file: input.file,
        start: plan.start,
        vertices: plan.vertices as u64,
        triangles: plan.faces,
        records,
    })))
}

impl InPlace {
    /// Calls `each` with the number, from 0, and the bytes of each of `count` records of `size`
    /// bytes, which start at `at`; a block of them is in memory.
    fn each(
        &self,
        at: u64,
        count: usize,
        size: usize,
        mut each: impl FnMut(usize, &[u8]) -> Result<()>,
    ) -> Result<()> {
        let records = (BLOCK_BYTES / size).max(1);
        let mut buffer = vec![0; records.min(count) * size];
        for first in (0..count).step_by(records) {
            let block = &mut buffer[..records.min(count - first) * size];
            read_exact_at(&self.file, block, at + (first * size) as u64)
                .map_err(|e| brickmarch::Error::io(&self.path, "reading", e))?;
            for (n, record) in (first..).zip(block.chunks_exact(size)) {
                each(n, record)?;
            }
        }
        Ok(())
    }
}

impl MeshSource for InPlace {
    fn vertices(&self) -> u64 {
        self.vertices
    }

    fn triangles(&self) -> u64 {
        self.triangles
    }

    fn read_positions(&self, first: u64, out: &mut [[f32; 3]]) -> Result<()> {
        let size = self.records.vertex_bytes;
        let at = self.start + first * size as u64;
        self.each(at, out.len(), size, |n, record| {
            out[n] = [0, 1, 2].map(|i| float(record, self.records.offsets[i]));
            Ok(())
        })
    }

    fn read_triangles(&self, first: u64, out: &mut [[u32; 3]]) -> Result<()> {
        let size = self.records.face_bytes;
        let at = self.records.faces + first * size as u64;
        self.each(at, out.len(), size, |n, record| {
            if record[0] != 3 {
                return Err(brickmarch::Error::new(
                    ErrorKind::Unsupported,
                    format!(
                        "{}: face {} has {} corners; a file that is larger than the memory is checked only where \
                         all are triangles: give more with --mem",
                        self.path.display(),
                        first + n as u64,
                        record[0]
                    ),
                ));
            }
            out[n] = [1, 5, 9].map(|at| word(record, at));
            Ok(())
        })
    }
}

/// Reads the common layout; `false` when there is a face with more than three corners.
fn read_plain(input: &mut Input, plan: &Plan, mesh: &mut Mesh) -> Result<bool> {
    let Some(records) = Records::of(plan, input.length) else {
        return Ok(false);
    };
    let (offsets, stride) = (records.offsets, records.vertex_bytes);
    input
        .file
        .seek(SeekFrom::Start(plan.start))
        .map_err(|e| input.io(e))?;
    let mut buffer = Vec::new();
    in_blocks(
        input,
        plan.vertices as u64,
        stride,
        &mut buffer,
        |_, block| {
            let records = block.chunks_exact(stride);
            let three =
                |record: &[u8], at: usize| [0, 1, 2].map(|i| float(record, offsets[at + i]));
            mesh.positions.extend(records.clone().map(|r| three(r, 0)));
            if plan.normals {
                mesh.normals.extend(records.clone().map(|r| three(r, 3)));
            }
            if plan.keys {
                mesh.keys.extend(records.map(|r| EdgeKey {
                    point: [6, 7, 8].map(|i| word(r, offsets[i]) as i32),
                    axis: r[offsets[9]],
                }));
            }
            Ok(true)
        },
    )?;
    in_blocks(
        input,
        plan.faces,
        records.face_bytes,
        &mut buffer,
        |first, block| {
            for (face, record) in (first..).zip(block.chunks_exact(records.face_bytes)) {
                if record[0] != 3 {
                    return Ok(false);
                }
                let corners = [1, 5, 9].map(|at| word(record, at));
                if let Some(&v) = corners.iter().find(|&&v| v as usize >= plan.vertices) {
                    return Err(lost_vertex(input, face, v.into(), plan.vertices));
                }
                mesh.triangles.push(corners);
            }
            Ok(true)
        },
    )
}

// ---- every other layout

/// One element of any kind.
struct Record {
    scalars: [f64; NAMES.len()],
    corners: Vec<i64>,
}

impl PropertyAccess for Record {
    fn new() -> Self {
        Self {
            scalars: [0.0; NAMES.len()],
            corners: Vec::new(),
        }
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        if name == "vertex_indices" || name == "vertex_index" {
            self.corners = match property {
                Property::ListChar(list) => list.into_iter().map(i64::from).collect(),
                Property::ListUChar(list) => list.into_iter().map(i64::from).collect(),
                Property::ListShort(list) => list.into_iter().map(i64::from).collect(),
                Property::ListUShort(list) => list.into_iter().map(i64::from).collect(),
                Property::ListInt(list) => list.into_iter().map(i64::from).collect(),
                Property::ListUInt(list) => list.into_iter().map(i64::from).collect(),
                _ => return PropertyAccessResult::Ignored,
            };
            return PropertyAccessResult::Set;
        }
        let Some(i) = NAMES.iter().position(|n| *n == name) else {
            return PropertyAccessResult::Ignored;
        };
        self.scalars[i] = match property {
            Property::Char(v) => v.into(),
            Property::UChar(v) => v.into(),
            Property::Short(v) => v.into(),
            Property::UShort(v) => v.into(),
            Property::Int(v) => v.into(),
            Property::UInt(v) => v.into(),
            Property::Float(v) => v.into(),
            Property::Double(v) => v,
            _ => return PropertyAccessResult::Ignored,
        };
        PropertyAccessResult::Set
    }
}

fn read_any(input: &mut Input, plan: &Plan, mesh: &mut Mesh, permit: &mut Permit) -> Result<()> {
    mesh.normals.clear();
    mesh.keys.clear();
    input
        .file
        .seek(SeekFrom::Start(plan.start))
        .map_err(|e| input.io(e))?;
    let input = &*input;
    let mut source = BufReader::with_capacity(1 << 16, &input.file);
    let parser = Parser::<Record>::new();
    let mut line = Vec::new();
    for (name, element) in &plan.header.elements {
        for i in 0..element.count as u64 {
            if i % 65_536 == 0 {
                input.budget.check_cancelled()?;
            }
            let place = || format!("{name} {i}");
            let record = match plan.header.encoding {
                Encoding::Ascii => {
                    next_record(input, &mut source, &mut line)?;
                    text_record(&line, element)
                        .map_err(|what| input.damaged(format_args!("{}: {what}", place())))
                }
                Encoding::BinaryLittleEndian => parser
                    .read_little_endian_element(&mut limit(&mut source), element)
                    .map_err(|e| parse_error(input, &place(), &e)),
                Encoding::BinaryBigEndian => parser
                    .read_big_endian_element(&mut limit(&mut source), element)
                    .map_err(|e| parse_error(input, &place(), &e)),
            }?;
            match name.as_str() {
                "vertex" => add_vertex(mesh, &record, plan),
                "face" => add_face(input, mesh, &record, i, plan, permit)?,
                _ => {}
            }
        }
    }
    Ok(())
}

fn add_vertex(mesh: &mut Mesh, record: &Record, plan: &Plan) {
    let three = |at: usize| [0, 1, 2].map(|i| record.scalars[at + i] as f32);
    mesh.positions.push(three(0));
    if plan.normals {
        mesh.normals.push(three(3));
    }
    if plan.keys {
        mesh.keys.push(EdgeKey {
            point: [6, 7, 8].map(|i| record.scalars[i] as i32),
            axis: record.scalars[9] as u8,
        });
    }
}

/// Adds a polygon as a fan from its first corner.
fn add_face(
    input: &Input,
    mesh: &mut Mesh,
    record: &Record,
    face: u64,
    plan: &Plan,
    permit: &mut Permit,
) -> Result<()> {
    let corners = &record.corners;
    if corners.len() < 3 {
        return Err(input.damaged(format_args!("face {face} has {} corners", corners.len())));
    }
    let known = 0..plan.vertices as i64;
    if let Some(&v) = corners.iter().find(|v| !known.contains(v)) {
        return Err(lost_vertex(input, face, v, plan.vertices));
    }
    for pair in corners[1..].windows(2) {
        let triangle = [corners[0], pair[0], pair[1]].map(|v| v as u32);
        push(&mut mesh.triangles, triangle, permit, input)?;
    }
    Ok(())
}

fn limit<R: Read>(source: &mut R) -> std::io::Take<&mut R> {
    source.take(MOST_ELEMENT_BYTES)
}

/// The next line with something in it.
fn next_record(input: &Input, source: &mut impl BufRead, line: &mut Vec<u8>) -> Result<()> {
    loop {
        if next_line(source, line).map_err(|e| input.io(e))? == 0 {
            return Err(input.truncated("the text ends before all elements are there"));
        }
        if !line.trim_ascii().is_empty() {
            return Ok(());
        }
    }
}

fn text_record(line: &[u8], element: &ElementDef) -> Result<Record, String> {
    let text = std::str::from_utf8(line).map_err(|_| "not a line of numbers".to_owned())?;
    let mut record = Record::new();
    let mut words = text.split_ascii_whitespace();
    let mut next = || words.next().ok_or("the line is too short");
    for (name, property) in &element.properties {
        match &property.data_type {
            PropertyType::Scalar(_) => {
                let word = next()?;
                let value = word.parse().map_err(|_| format!("{word:?} is no number"))?;
                record.set_property(name, Property::Double(value));
            }
            PropertyType::List(_, _) => {
                let word = next()?;
                let count: u32 = word
                    .parse()
                    .map_err(|_| format!("{word:?} is no number of entries"))?;
                let keep = name == "vertex_indices" || name == "vertex_index";
                for _ in 0..count {
                    let word = next()?;
                    if keep {
                        let vertex = word
                            .parse()
                            .map_err(|_| format!("{word:?} is no vertex number"))?;
                        record.corners.push(vertex);
                    }
                }
            }
        }
    }
    Ok(record)
}
