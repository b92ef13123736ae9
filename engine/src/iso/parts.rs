//! A mesh made in parts, on any machine and in any order, and joined to the bytes of a single run.
//!
//! The blocks of a mesh have an order; a part is a run of them. It keeps for every block its vertices,
//! its triangles, and which of its vertices lie on its faces. Global numbers are given when all parts
//! are there, block by block as ever, so joined parts cannot differ from a mesh made at once.
//!
//! File of a part, little-endian: the magic, a CRC32C of the question (isovalue, region, lattice and
//! what else the mesh depends on), number and count of parts, layout, end of the blocks per axis; then records
//! of `length, CRC32C, payload`, the last one of length 0 with the number of the records before it.

use super::block::BlockOutput;
use super::blocks::Candidates;
use super::extract::{Extract, Stats, prepare};
use super::numbering::Numbering;
use super::sweep::sweep_some;
use crate::budget::Budget;
use crate::error::{Error, ErrorKind, Result};
use crate::field::Field;
use crate::mesh::{EdgeKey, Layout, MeshSink, Piece};
use std::io::{Read, Write};
use std::path::Path;

const MAGIC: [u8; 8] = *b"BMPART01";
/// Bytes of a record at most: a block of 32^3 cells has at most some 2^17 vertices.
const MAX_RECORD: u32 = 1 << 28;

/// Which part of how many.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// From 1.
    pub number: u32,
    /// How many there are.
    pub of: u32,
}

impl Part {
    /// The blocks of this part among `all`, half-open.
    fn range(self, all: u64) -> (u64, u64) {
        let at = |n: u32| (u128::from(all) * u128::from(n) / u128::from(self.of)) as u64;
        (at(self.number - 1), at(self.number))
    }
}

/// Meshes one part of a surface and writes it to `out`; [`join_parts`] makes the mesh. Parts have
/// equal numbers of blocks that the surface may cross. `name` is for messages.
///
/// # Errors
/// `BadInput` for options that cannot be cut in parts (seeds) and a part that is none; what
/// [`extract`](super::extract()) reports, but no `EmptySurface`.
///
/// # Memory
/// As [`extract`](super::extract()).
pub fn extract_part(
    field: &dyn Field,
    options: &Extract,
    part: Part,
    budget: &Budget,
    out: &mut (dyn Write + Send),
    name: &Path,
) -> Result<Stats> {
    if part.number == 0 || part.number > part.of || part.of > 1 << 20 {
        return Err(Error::bad_input(format!(
            "part {} of {}: number from 1 to the count, at most 2^20 of them",
            part.number, part.of
        )));
    }
    if !options.seeds.is_empty() {
        return Err(Error::bad_input(
            "a surface found from seeds is one march and cannot be made in parts: leave the seeds out",
        ));
    }
    let (blocks, style) = prepare(field, options)?;
    let inside = style.inside;
    let mut all = 0;
    let mut candidates = Candidates::new(field, blocks, options.iso, inside);
    while candidates.next()?.is_some() {
        all += 1;
        if all % 1024 == 0 {
            budget.check_cancelled()?;
        }
    }
    let mut writer = PartWriter {
        out,
        name,
        payload: Vec::new(),
        records: 0,
    };
    let mut head = Vec::new();
    head.extend(MAGIC);
    for v in [
        question(field, options, style.inside as u32),
        part.number,
        part.of,
        u32::from(options.normals) | u32::from(options.keys) << 1,
    ] {
        head.extend(v.to_le_bytes());
    }
    for v in blocks.range.max {
        head.extend(v.to_le_bytes());
    }
    writer.record(&head)?;
    let decoded = field.blocks_decoded();
    let (from, to) = part.range(all);
    let candidates = Candidates::new(field, blocks, options.iso, inside).only(from, to);
    let mut keep = |piece: &Piece, blocks: &[([i32; 3], BlockOutput)], visited: u64| {
        writer.put(piece, blocks, visited)
    };
    let (mut stats, totals) = sweep_some(candidates, style, budget, &mut keep)?;
    let records = writer.records;
    writer.raw(&0u32.to_le_bytes())?;
    writer.raw(&records.to_le_bytes())?;
    stats.vertices = totals.vertices;
    stats.triangles = totals.triangles;
    stats.blocks_decoded = field.blocks_decoded() - decoded;
    Ok(stats)
}

/// Which part a file is, by its head.
///
/// # Errors
/// `Damaged` when it is no part of a mesh.
pub fn part_of(name: &Path, mut source: &mut dyn Read) -> Result<Part> {
    let source = &mut source;
    Ok(PartReader { source, name }.head()?.part)
}

/// Joins all parts of a mesh, given in their order, into `sink`. The names are for messages.
///
/// # Errors
/// `BadInput` for parts of different meshes, missing or twice; `Damaged` for a part that is not whole;
/// `EmptySurface` when there is no triangle, unless `allow_empty`; what the sink reports.
///
/// # Memory
/// One record of a part, some MiB, and the front.
pub fn join_parts(
    parts: &mut [(&Path, &mut dyn Read)],
    allow_empty: bool,
    budget: &Budget,
    sink: &mut dyn MeshSink,
) -> Result<Stats> {
    let mut join = Join {
        numbering: Numbering::default(),
        stats: Stats::default(),
        payload: Vec::new(),
        piece: Piece::default(),
    };
    let mut first: Option<Head> = None;
    let count = parts.len() as u32;
    for (n, (name, source)) in parts.iter_mut().enumerate() {
        let name: &Path = name;
        let mut source = PartReader { source, name };
        let head = source.head()?;
        if head.part.of != count || head.part.number != n as u32 + 1 {
            return Err(Error::bad_input(format!(
                "{}: is part {} of {}: give every part once, {count} were given",
                name.display(),
                head.part.number,
                head.part.of
            )));
        }
        match &first {
            None => sink.begin(head.layout)?,
            Some(first) if first.same_mesh(&head) => {}
            Some(_) => {
                return Err(Error::bad_input(format!(
                    "{}: is a part of another mesh, by isovalue, region, options or volume",
                    name.display()
                )));
            }
        }
        let mut records = 1;
        while source.record(&mut join.payload, budget)? {
            budget.check_cancelled()?;
            join.take(&head, sink)
                .map_err(|e| e.context(name.display()))?;
            records += 1;
        }
        source.end(records)?;
        first.get_or_insert(head);
    }
    let Some(_) = first else {
        return Err(Error::bad_input("no parts were given"));
    };
    let totals = join.numbering.totals;
    if totals.triangles == 0 && !allow_empty {
        return Err(Error::new(
            ErrorKind::EmptySurface,
            "the parts hold no triangle: nothing crosses the isovalue; allow an empty mesh (--allow-empty)",
        ));
    }
    sink.finish(totals)?;
    join.stats.vertices = totals.vertices;
    join.stats.triangles = totals.triangles;
    join.stats.front_bytes_max = join.numbering.front_bytes_max;
    Ok(join.stats)
}

/// What a mesh depends on, as one number.
fn question(field: &dyn Field, options: &Extract, inside: u32) -> u32 {
    let grid = field.grid();
    let mut bytes = Vec::new();
    let region = options.region.unwrap_or(grid.domain);
    for point in [grid.domain.min, grid.domain.max, region.min, region.max] {
        bytes.extend(point.iter().flat_map(|v| v.to_le_bytes()));
    }
    for v in grid.index_to_world.rows.iter().flatten() {
        bytes.extend(v.to_le_bytes());
    }
    bytes.extend(options.iso.to_le_bytes());
    bytes.extend([
        inside as u8,
        options.boundary as u8,
        options.index_space.into(),
        field.block_edge().min(255) as u8,
    ]);
    crc32c::crc32c(&bytes)
}

/// The writing end of a part.
pub(super) struct PartWriter<'a> {
    out: &'a mut (dyn Write + Send),
    name: &'a Path,
    payload: Vec<u8>,
    records: u32,
}

impl PartWriter<'_> {
    fn raw(&mut self, bytes: &[u8]) -> Result<()> {
        self.out
            .write_all(bytes)
            .map_err(|e| Error::io(self.name, "writing a part", e))
    }

    fn record(&mut self, payload: &[u8]) -> Result<()> {
        self.raw(&(payload.len() as u32).to_le_bytes())?;
        self.raw(&crc32c::crc32c(payload).to_le_bytes())?;
        self.raw(payload)?;
        self.records += 1;
        Ok(())
    }

    /// Adds blocks and their piece, in the order of the blocks.
    pub(super) fn put(
        &mut self,
        piece: &Piece,
        blocks: &[([i32; 3], BlockOutput)],
        visited: u64,
    ) -> Result<()> {
        let mut p = std::mem::take(&mut self.payload);
        p.clear();
        let word = |p: &mut Vec<u8>, v: usize| p.extend((v as u32).to_le_bytes());
        p.extend(visited.to_le_bytes());
        for n in [
            piece.positions.len(),
            piece.own.len(),
            piece.triangles.len(),
            blocks.len(),
        ] {
            word(&mut p, n);
        }
        for v in piece.positions.iter().chain(&piece.normals).flatten() {
            p.extend(v.to_le_bytes());
        }
        for key in &piece.keys {
            key.point.iter().for_each(|v| p.extend(v.to_le_bytes()));
            p.push(key.axis);
        }
        for v in piece.own.iter().chain(piece.triangles.iter().flatten()) {
            p.extend(v.to_le_bytes());
        }
        for (at, out) in blocks {
            at.iter().for_each(|v| p.extend(v.to_le_bytes()));
            for v in [out.active_cells, out.ambiguous_faces, out.interior_vertices] {
                p.extend(v.to_le_bytes());
            }
            for face in out.low.iter().chain(&out.high) {
                word(&mut p, face.len());
                face.iter().for_each(|v| p.extend(v.to_le_bytes()));
            }
        }
        let done = self.record(&p);
        self.payload = p;
        done
    }
}

#[derive(Clone, Copy, Debug)]
struct Head {
    question: u32,
    part: Part,
    layout: Layout,
    end: [i32; 3],
}

impl Head {
    fn same_mesh(&self, other: &Head) -> bool {
        (self.question, self.layout, self.end) == (other.question, other.layout, other.end)
    }
}

struct PartReader<'a, 'b> {
    source: &'a mut &'b mut dyn Read,
    name: &'a Path,
}

impl PartReader<'_, '_> {
    fn damaged(&self, what: &str) -> Error {
        Error::new(
            ErrorKind::Damaged,
            format!("{}: {what}: make this part again", self.name.display()),
        )
    }

    fn word(&mut self) -> Result<u32> {
        let mut bytes = [0; 4];
        self.source
            .read_exact(&mut bytes)
            .map_err(|_| self.damaged("the part ends early"))?;
        Ok(u32::from_le_bytes(bytes))
    }

    fn head(&mut self) -> Result<Head> {
        let mut payload = Vec::new();
        let length = self.word()?;
        if length != 36 {
            return Err(self.damaged("is no part of a mesh"));
        }
        self.payload(length, &mut payload)?;
        if payload[..8] != MAGIC {
            return Err(self.damaged("is no part of a mesh, or one of another version"));
        }
        let word = |n: usize| {
            let bytes = payload[8 + 4 * n..][..4].try_into().expect("four bytes");
            u32::from_le_bytes(bytes)
        };
        Ok(Head {
            question: word(0),
            part: Part {
                number: word(1),
                of: word(2),
            },
            layout: Layout {
                normals: word(3) & 1 != 0,
                keys: word(3) & 2 != 0,
            },
            end: [4, 5, 6].map(|n| word(n) as i32),
        })
    }

    /// The next record; false at the last one.
    fn record(&mut self, payload: &mut Vec<u8>, budget: &Budget) -> Result<bool> {
        let length = self.word()?;
        if length == 0 {
            return Ok(false);
        }
        if length > MAX_RECORD {
            return Err(self.damaged("a record is too long"));
        }
        // For the bytes, and for the piece that they become.
        let _permit = budget.take(3 * u64::from(length), "a record of a part")?;
        self.payload(length, payload)?;
        Ok(true)
    }

    fn payload(&mut self, length: u32, payload: &mut Vec<u8>) -> Result<()> {
        let crc = self.word()?;
        payload.clear();
        let mut some = (&mut *self.source).take(length.into());
        let read = some.read_to_end(payload);
        read.map_err(|e| Error::io(self.name, "reading a part", e))?;
        if payload.len() != length as usize {
            return Err(self.damaged("the part ends early"));
        }
        if crc32c::crc32c(payload) != crc {
            return Err(self.damaged("a record has a wrong checksum"));
        }
        Ok(())
    }

    /// After the last record.
    fn end(&mut self, records: u32) -> Result<()> {
        if self.word()? != records {
            return Err(self.damaged("records are missing"));
        }
        let mut more = [0];
        match self.source.read(&mut more) {
            Ok(0) => Ok(()),
            Ok(_) => Err(self.damaged("bytes follow the last record")),
            Err(e) => Err(Error::io(self.name, "reading a part", e)),
        }
    }
}

/// The joined mesh so far.
struct Join {
    numbering: Numbering,
    stats: Stats,
    payload: Vec<u8>,
    piece: Piece,
}

impl Join {
    fn take(&mut self, head: &Head, sink: &mut dyn MeshSink) -> Result<()> {
        let bad = || Error::new(ErrorKind::Damaged, "a record does not hold what it says");
        let mut p = Bytes(&self.payload);
        let piece = &mut self.piece;
        self.stats.blocks_visited += p.long().ok_or_else(bad)?;
        let mut count = || p.word().map(|n| n as usize).ok_or_else(bad);
        let (vertices, own, triangles, blocks) = (count()?, count()?, count()?, count()?);
        let floats = |p: &mut Bytes<'_>, out: &mut Vec<[f32; 3]>, n: usize| {
            let bytes = p.some(n.checked_mul(12)?)?;
            out.clear();
            let all = bytes
                .as_chunks::<4>()
                .0
                .iter()
                .map(|b| f32::from_le_bytes(*b));
            let all: Vec<f32> = all.collect();
            out.extend_from_slice(all.as_chunks::<3>().0);
            Some(())
        };
        floats(&mut p, &mut piece.positions, vertices).ok_or_else(bad)?;
        let n = if head.layout.normals { vertices } else { 0 };
        floats(&mut p, &mut piece.normals, n).ok_or_else(bad)?;
        piece.keys.clear();
        if head.layout.keys {
            let bytes = p.some(vertices * 13).ok_or_else(bad)?;
            piece.keys.extend(bytes.as_chunks::<13>().0.iter().map(|b| {
                let at = |n: usize| i32::from_le_bytes(b[4 * n..][..4].try_into().expect("four"));
                EdgeKey {
                    point: [at(0), at(1), at(2)],
                    axis: b[12],
                }
            }));
        }
        piece.own = p.list(own, vertices).ok_or_else(bad)?;
        let corners = p
            .list(triangles.checked_mul(3).ok_or_else(bad)?, vertices)
            .ok_or_else(bad)?;
        piece.triangles.clear();
        piece
            .triangles
            .extend_from_slice(corners.as_chunks::<3>().0);
        self.numbering.start(piece);
        for _ in 0..blocks {
            let mut at = [0; 3];
            for v in &mut at {
                *v = p.word().ok_or_else(bad)? as i32;
            }
            let mut out = BlockOutput {
                active_cells: p.long().ok_or_else(bad)?,
                ambiguous_faces: p.long().ok_or_else(bad)?,
                interior_vertices: p.long().ok_or_else(bad)?,
                ..BlockOutput::default()
            };
            for face in out.low.iter_mut().chain(&mut out.high) {
                let n = p.word().ok_or_else(bad)? as usize;
                *face = p.list(n, vertices).ok_or_else(bad)?;
            }
            self.numbering.pass(head.end, at, &out, piece)?;
            self.stats.active_cells += out.active_cells;
            self.stats.ambiguous_faces += out.ambiguous_faces;
            self.stats.interior_vertices += out.interior_vertices;
        }
        if !p.0.is_empty() || piece.ids.contains(&u64::MAX) {
            return Err(bad());
        }
        self.numbering.end(piece);
        let (totals, capacity) = (self.numbering.totals, sink.capacity());
        if totals.vertices > capacity.vertices || totals.triangles > capacity.triangles {
            return Err(Error::new(
                ErrorKind::LimitExceeded,
                "the mesh is larger than the output format can hold: choose another format",
            ));
        }
        if piece.triangles.is_empty() && piece.own.is_empty() {
            return Ok(());
        }
        sink.write(piece)
    }
}

/// Bytes that are taken from the front.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn some(&mut self, n: usize) -> Option<&'a [u8]> {
        let (some, rest) = self.0.split_at_checked(n)?;
        self.0 = rest;
        Some(some)
    }

    fn word(&mut self) -> Option<u32> {
        let bytes = self.some(4)?.try_into().ok()?;
        Some(u32::from_le_bytes(bytes))
    }

    fn long(&mut self) -> Option<u64> {
        let bytes = self.some(8)?.try_into().ok()?;
        Some(u64::from_le_bytes(bytes))
    }

    /// `n` numbers below `end`.
    fn list(&mut self, n: usize, end: usize) -> Option<Vec<u32>> {
        let bytes = self.some(n.checked_mul(4)?)?;
        let list: Vec<u32> = bytes
            .as_chunks::<4>()
            .0
            .iter()
            .map(|b| u32::from_le_bytes(*b))
            .collect();
        list.iter().all(|&v| (v as usize) < end).then_some(list)
    }
}
