//! The file of a part.
//!
//! Little-endian records of `length, CRC32C, payload`, the last one of length 0 with the number of the
//! records before it. The first is the head: the magic, a CRC32C of the question (isovalue, region, lattice and
//! what else the mesh depends on), number and count of parts, layout, end of the blocks per axis.

use super::Part;
use crate::budget::{Budget, Permit};
use crate::error::{Error, ErrorKind, Result};
use crate::iso::block::BlockOutput;
use crate::mesh::{EdgeKey, Layout, Piece};
use std::io::{Read, Write};
use std::path::Path;

const MAGIC: [u8; 8] = *b"BMPART01";
/// Bytes of a record at most: a block of 32^3 cells has at most some 2^17 vertices.
const MAX_RECORD: u32 = 1 << 28;

/// The writing end of a part.
pub(super) struct PartWriter<'a> {
    out: &'a mut (dyn Write + Send),
    name: &'a Path,
    layout: Layout,
    payload: Vec<u8>,
    records: u32,
}

impl<'a> PartWriter<'a> {
    pub(super) fn begin(
        out: &'a mut (dyn Write + Send),
        name: &'a Path,
        head: &Head,
    ) -> Result<Self> {
        let mut payload = MAGIC.to_vec();
        let flags = u32::from(head.layout.normals) | u32::from(head.layout.keys) << 1;
        for v in [head.question, head.part.number, head.part.of, flags] {
            payload.extend(v.to_le_bytes());
        }
        for v in head.end {
            payload.extend(v.to_le_bytes());
        }
        let mut writer = Self {
            out,
            name,
            layout: head.layout,
            payload: Vec::new(),
            records: 0,
        };
        writer.record(&payload)?;
        Ok(writer)
    }

    /// Says how many records there are.
    pub(super) fn finish(mut self) -> Result<()> {
        let records = self.records;
        self.raw(&0u32.to_le_bytes())?;
        self.raw(&records.to_le_bytes())
    }

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
        // Whoever moves vertices knows them by key, wanted or not.
        let keys = if self.layout.keys {
            &piece.keys[..]
        } else {
            &[]
        };
        for key in keys {
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

/// The first record.
#[derive(Clone, Copy, Debug)]
pub(super) struct Head {
    /// What the mesh depends on, as one number.
    pub(super) question: u32,
    pub(super) part: Part,
    pub(super) layout: Layout,
    /// End of the blocks.
    pub(super) end: [i32; 3],
}

impl Head {
    pub(super) fn same_mesh(&self, other: &Head) -> bool {
        (self.question, self.layout, self.end) == (other.question, other.layout, other.end)
    }
}

pub(super) struct PartReader<'a, 'b> {
    pub(super) source: &'a mut &'b mut dyn Read,
    pub(super) name: &'a Path,
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

    pub(super) fn head(&mut self) -> Result<Head> {
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

    /// The next record, with the memory that it and what is read from it need; nothing after the last.
    pub(super) fn record(
        &mut self,
        payload: &mut Vec<u8>,
        budget: &Budget,
    ) -> Result<Option<Permit>> {
        let length = self.word()?;
        if length == 0 {
            return Ok(None);
        }
        if length > MAX_RECORD {
            return Err(self.damaged("a record is too long"));
        }
        // For the bytes, and for the piece that they become.
        let permit = budget.take(3 * u64::from(length), "a record of a part")?;
        self.payload(length, payload)?;
        Ok(Some(permit))
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
    pub(super) fn end(&mut self, records: u32) -> Result<()> {
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

/// Blocks of a part and their piece.
#[derive(Default)]
pub(super) struct Record {
    pub(super) piece: Piece,
    pub(super) blocks: Vec<([i32; 3], BlockOutput)>,
    /// Blocks that were looked at.
    pub(super) visited: u64,
}

pub(super) fn not_what_it_says() -> Error {
    Error::new(ErrorKind::Damaged, "a record does not hold what it says")
}

impl Record {
    /// Reads what [`PartWriter::put`] wrote.
    pub(super) fn read(&mut self, payload: &[u8], layout: Layout) -> Result<()> {
        let mut bytes = Bytes(payload);
        self.fill(&mut bytes, layout)
            .filter(|()| bytes.0.is_empty())
            .ok_or_else(not_what_it_says)
    }

    fn fill(&mut self, p: &mut Bytes<'_>, layout: Layout) -> Option<()> {
        self.visited = p.long()?;
        let vertices = p.word()? as usize;
        let own = p.word()? as usize;
        let triangles = p.word()? as usize;
        let blocks = p.word()?;
        let piece = &mut self.piece;
        p.points(vertices, &mut piece.positions)?;
        let normals = if layout.normals { vertices } else { 0 };
        p.points(normals, &mut piece.normals)?;
        piece.keys.clear();
        if layout.keys {
            let bytes = p.some(vertices.checked_mul(13)?)?;
            piece.keys.extend(bytes.as_chunks::<13>().0.iter().map(key));
        }
        piece.own = p.list(own, vertices)?;
        let corners = p.list(triangles.checked_mul(3)?, vertices)?;
        piece.triangles.clear();
        piece
            .triangles
            .extend_from_slice(corners.as_chunks::<3>().0);
        self.blocks.clear();
        for _ in 0..blocks {
            self.blocks.push(p.block(vertices)?);
        }
        Some(())
    }
}

fn key(bytes: &[u8; 13]) -> EdgeKey {
    let [a, b, c] = [0, 4, 8].map(|n| [bytes[n], bytes[n + 1], bytes[n + 2], bytes[n + 3]]);
    EdgeKey {
        point: [a, b, c].map(i32::from_le_bytes),
        axis: bytes[12],
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

    /// `n` triples of floats.
    fn points(&mut self, n: usize, out: &mut Vec<[f32; 3]>) -> Option<()> {
        let bytes = self.some(n.checked_mul(12)?)?;
        out.clear();
        out.extend(bytes.as_chunks::<12>().0.iter().map(|b| {
            let all = b.as_chunks::<4>().0;
            [all[0], all[1], all[2]].map(f32::from_le_bytes)
        }));
        Some(())
    }

    /// A block, whose faces name vertices below `vertices`.
    fn block(&mut self, vertices: usize) -> Option<([i32; 3], BlockOutput)> {
        let at = [self.word()?, self.word()?, self.word()?].map(|v| v as i32);
        let mut out = BlockOutput {
            active_cells: self.long()?,
            ambiguous_faces: self.long()?,
            interior_vertices: self.long()?,
            ..BlockOutput::default()
        };
        for face in out.low.iter_mut().chain(&mut out.high) {
            let n = self.word()? as usize;
            *face = self.list(n, vertices)?;
        }
        Some((at, out))
    }
}
