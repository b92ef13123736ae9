//! Pieces of meshes on disk until it is known what becomes of them.

use super::scratch::{read_at, write_at};
use super::{EdgeKey, LabelSink, Layout, MeshSink, Piece, Totals};
use crate::error::{Error, ErrorKind, Result};
use std::collections::HashMap;
use std::fs::File;

/// Bytes that are gathered before they are written.
const BUFFER_BYTES: usize = 1 << 20;

/// Bytes of a record before its arrays.
const HEAD_BYTES: usize = 8 * 3 + 4 * 3;

/// The link of a record that has none before it.
const NONE: u64 = u64::MAX;

/// A scratch file of pieces. Each record carries a link, an offset of another record or any other
/// number, which is how pieces that belong together are found again without a list in memory.
///
/// # Memory
/// 1 MiB, and one piece while one is read.
#[derive(Debug)]
pub struct Spool {
    file: File,
    layout: Layout,
    /// Bytes on disk; what is in the buffer follows.
    written: u64,
    buffer: Vec<u8>,
}

impl Spool {
    /// A spool in `file`, which is empty and used by nobody else.
    pub fn new(file: File) -> Self {
        Self {
            file,
            layout: Layout::default(),
            written: 0,
            buffer: Vec::new(),
        }
    }

    /// Says what the vertices carry; before the first piece.
    pub fn begin(&mut self, layout: Layout) {
        self.layout = layout;
    }

    /// What the vertices carry.
    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// Keeps `piece` (without colours) and gives the offset of its record.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn append(&mut self, link: u64, piece: &Piece) -> Result<u64> {
        let offset = self.written + self.buffer.len() as u64;
        let out = &mut self.buffer;
        for head in [link, piece.first_vertex, piece.first_triangle] {
            out.extend_from_slice(&head.to_le_bytes());
        }
        for count in [
            piece.positions.len(),
            piece.own.len(),
            piece.triangles.len(),
        ] {
            out.extend_from_slice(&(count as u32).to_le_bytes());
        }
        put(out, piece.positions.as_flattened(), |v: &f32| {
            v.to_le_bytes()
        });
        if self.layout.normals {
            put(out, piece.normals.as_flattened(), |v: &f32| v.to_le_bytes());
        }
        if self.layout.keys {
            put(out, &piece.keys, |key| {
                let mut bytes = [0; 13];
                for (bytes, v) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(key.point) {
                    *bytes = v.to_le_bytes();
                }
                bytes[12] = key.axis;
                bytes
            });
        }
        put(out, &piece.ids, |v| v.to_le_bytes());
        put(out, &piece.own, |v| v.to_le_bytes());
        put(out, piece.triangles.as_flattened(), |v| v.to_le_bytes());
        if self.buffer.len() >= BUFFER_BYTES {
            self.flush()?;
        }
        Ok(offset)
    }

    /// Writes what is in memory; needed before [`read`](Self::read).
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn flush(&mut self) -> Result<()> {
        write_at(&self.file, &self.buffer, self.written)?;
        self.written += self.buffer.len() as u64;
        self.buffer.clear();
        self.buffer.shrink_to(2 * BUFFER_BYTES);
        Ok(())
    }

    /// Bytes on disk.
    pub fn bytes(&self) -> u64 {
        self.written
    }

    /// Reads the record at `offset`, by way of `buffer`, into `piece` and gives its link.
    ///
    /// # Errors
    /// When the file cannot be read, or there is no record.
    pub fn read(&self, offset: u64, piece: &mut Piece, buffer: &mut Vec<u8>) -> Result<u64> {
        let mut head = [0; HEAD_BYTES];
        read_at(&self.file, &mut head, offset)?;
        let long = |i: usize| u64::from_le_bytes(head[8 * i..][..8].try_into().expect("8 bytes"));
        let short = |i: usize| {
            u32::from_le_bytes(head[24 + 4 * i..][..4].try_into().expect("4 bytes")) as usize
        };
        let [vertices, own, triangles] = [short(0), short(1), short(2)];
        let vertex = 12
            + 8
            + if self.layout.normals { 12 } else { 0 }
            + if self.layout.keys { 13 } else { 0 };
        let length = vertices * vertex + own * 4 + triangles * 12;
        let start = offset + HEAD_BYTES as u64;
        if length as u64 > self.written.saturating_sub(start) {
            return Err(Error::new(
                ErrorKind::Damaged,
                "scratch file: what was written to it does not come back",
            ));
        }
        buffer.resize(length, 0);
        read_at(&self.file, buffer, start)?;
        let mut rest = &buffer[..];
        let mut next = |bytes: usize| {
            let (part, after) = rest.split_at(bytes);
            rest = after;
            part
        };
        piece.first_vertex = long(1);
        piece.first_triangle = long(2);
        let float3 = |b: &[u8; 12]| {
            let v = |i: usize| f32::from_le_bytes([b[i], b[i + 1], b[i + 2], b[i + 3]]);
            [v(0), v(4), v(8)]
        };
        get(next(12 * vertices), &mut piece.positions, float3);
        let normals = if self.layout.normals { vertices } else { 0 };
        get(next(12 * normals), &mut piece.normals, float3);
        let keys = if self.layout.keys { vertices } else { 0 };
        get(next(13 * keys), &mut piece.keys, |b: &[u8; 13]| EdgeKey {
            point: [0, 4, 8].map(|i| i32::from_le_bytes([b[i], b[i + 1], b[i + 2], b[i + 3]])),
            axis: b[12],
        });
        get(next(8 * vertices), &mut piece.ids, |b| {
            u64::from_le_bytes(*b)
        });
        get(next(4 * own), &mut piece.own, |b| u32::from_le_bytes(*b));
        get(
            next(12 * triangles),
            &mut piece.triangles,
            |b: &[u8; 12]| {
                [0, 4, 8].map(|i| u32::from_le_bytes([b[i], b[i + 1], b[i + 2], b[i + 3]]))
            },
        );
        let lost = |v: &u32| *v as usize >= vertices;
        if piece.own.iter().any(lost) || piece.triangles.as_flattened().iter().any(lost) {
            return Err(Error::new(
                ErrorKind::Damaged,
                "scratch file: what was written to it does not come back",
            ));
        }
        piece.colors.clear();
        Ok(long(0))
    }
}

fn put<T, const N: usize>(out: &mut Vec<u8>, values: &[T], bytes: impl Fn(&T) -> [u8; N]) {
    let start = out.len();
    out.resize(start + N * values.len(), 0);
    for (record, value) in out[start..].as_chunks_mut::<N>().0.iter_mut().zip(values) {
        *record = bytes(value);
    }
}

fn get<T, const N: usize>(bytes: &[u8], out: &mut Vec<T>, value: impl Fn(&[u8; N]) -> T) {
    out.clear();
    out.extend(bytes.as_chunks::<N>().0.iter().map(value));
}

/// The meshes of many labels in one scratch file. The records of a label form a chain, last piece
/// first; sinks take pieces in any order.
///
/// # Memory
/// That of [`Spool`], and 40 B a label, which [`extract_labels`](crate::iso::extract_labels) counts.
#[derive(Debug)]
pub struct LabelSpool {
    spool: Spool,
    last: HashMap<u32, u64>,
    capacity: Totals,
}

impl LabelSpool {
    /// A spool in `file`, empty and used by nobody else, for meshes of at most `capacity` each.
    pub fn new(file: File, capacity: Totals) -> Self {
        Self {
            spool: Spool::new(file),
            last: HashMap::new(),
            capacity,
        }
    }

    /// What the vertices carry.
    pub fn layout(&self) -> Layout {
        self.spool.layout()
    }

    /// Writes what is in memory; needed before [`replay`](Self::replay).
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn flush(&mut self) -> Result<()> {
        self.spool.flush()
    }

    /// Writes the mesh of `label` to `sink`, last piece first; `begin` and `finish` are the caller's.
    ///
    /// # Errors
    /// When the scratch file cannot be read or the sink fails.
    ///
    /// # Memory
    /// One piece.
    pub fn replay(&self, label: u32, sink: &dyn MeshSink) -> Result<()> {
        let (mut piece, mut buffer) = (Piece::default(), Vec::new());
        let mut at = self.last.get(&label).copied().unwrap_or(NONE);
        while at != NONE {
            at = self.spool.read(at, &mut piece, &mut buffer)?;
            piece.label = Some(label);
            sink.write(&piece)?;
        }
        Ok(())
    }
}

impl LabelSink for LabelSpool {
    fn capacity(&self) -> Totals {
        self.capacity
    }

    fn begin(&mut self, layout: Layout) -> Result<()> {
        self.spool.begin(layout);
        Ok(())
    }

    fn write(&mut self, label: u32, piece: &Piece) -> Result<()> {
        let last = self.last.entry(label).or_insert(NONE);
        *last = self.spool.append(*last, piece)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_meshes::{cube, torus};
    use crate::mesh::{Collect, Mesh, feed::pieces, layout};

    fn dressed(mut mesh: Mesh) -> Mesh {
        let n = mesh.positions.len();
        mesh.normals = (0..n).map(|i| [0.0, i as f32, -1.5]).collect();
        mesh.keys = (0..n)
            .map(|i| EdgeKey {
                point: [i as i32, -7, 1 << 30],
                axis: (i % 5) as u8,
            })
            .collect();
        mesh
    }

    #[test]
    fn meshes_between_each_other_come_back_whole() {
        let meshes = [
            (7, dressed(torus(2.0, 0.5, 90, 60))),
            (u32::MAX, dressed(cube([1.0; 3], 2.0))),
        ];
        let file = tempfile::tempfile().expect("a scratch file");
        let mut spool = LabelSpool::new(file, Totals::default());
        LabelSink::begin(&mut spool, layout(&meshes[0].1)).expect("begun");
        let mut lists = meshes.each_ref().map(|(l, m)| (*l, pieces(m, 11)));
        loop {
            let mut more = false;
            for (label, pieces) in &mut lists {
                if let Some(piece) = pieces.next() {
                    LabelSink::write(&mut spool, *label, &piece).expect("written");
                    more = true;
                }
            }
            if !more {
                break;
            }
        }
        spool.flush().expect("written");
        for (label, mesh) in &meshes {
            let mut sink = Collect::default();
            MeshSink::begin(&mut sink, spool.layout()).expect("begun");
            spool.replay(*label, &sink).expect("read");
            assert_eq!(sink.into_mesh(), *mesh);
        }
        let sink = Collect::default();
        spool.replay(8, &sink).expect("nothing");
        assert_eq!(sink.into_mesh(), Mesh::default());
    }

    #[test]
    fn a_scratch_file_that_lost_its_end_is_an_error() {
        let mesh = torus(2.0, 0.5, 30, 20);
        let file = tempfile::tempfile().expect("a scratch file");
        let mut spool = Spool::new(file.try_clone().expect("cloned"));
        let offsets: Vec<u64> = pieces(&mesh, 100)
            .map(|piece| spool.append(0, &piece).expect("kept"))
            .collect();
        spool.flush().expect("written");
        file.set_len(spool.bytes() - 1).expect("cut");
        let last = *offsets.last().expect("some");
        let read = |at| spool.read(at, &mut Piece::default(), &mut Vec::new());
        assert!(read(last).is_err());
        // Counts that say more than there is.
        write_at(&file, &[255; 12], offsets[0] + 24).expect("written");
        let error = read(offsets[0]).expect_err("too many");
        assert_eq!(error.kind(), ErrorKind::Damaged);
    }
}
