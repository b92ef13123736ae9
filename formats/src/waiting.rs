//! Triangles on disk until it is known where in their file they belong.
//!
//! A format has its triangles behind its vertices, whose number is known at the end. Until then
//! they wait in a scratch file, in records as short as they come without effort: corners are numbers within
//! their piece, 16 bits each; and of the global numbers of the vertices only those are kept that
//! do not continue the numbers of the piece. That is half the size of the faces of a PLY, so less is
//! written twice, and the faces themselves are made and written by several threads.

use crate::aside::{read_exact_at, write_all_at};
use brickmarch::mesh::Piece;
use std::fs::File;
use std::io::{Error, ErrorKind, Result};
use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Triangles of a record, at most: records of all kinds stay below 1 MiB.
pub(crate) const RECORD_TRIANGLES: usize = 40 << 10;
/// Vertices that 16 bits can number.
const NEAR_VERTICES: usize = 1 << 16;

/// First triangle, first vertex, label, triangles, vertices, vertices that do not continue the numbers.
const HEAD_BYTES: usize = 8 + 8 + 8 + 4 + 4 + 4;
/// Stands for no label.
const NO_LABEL: u64 = u64::MAX;
/// What a record takes at least for its room to be given back as soon as it was read.
const GIVE_BACK_BYTES: usize = 64 << 10;

/// The scratch file. Records are written and read from any thread in any order.
pub(crate) struct Waiting {
    file: File,
    end: AtomicU64,
}

/// What the start of a record says.
struct Head {
    first_triangle: u64,
    first_vertex: u64,
    label: Option<u32>,
    triangles: usize,
    /// 0: corners are global numbers.
    vertices: usize,
    foreign: usize,
}

/// Buffers of a thread that reads.
#[derive(Default)]
struct Room {
    record: Vec<u8>,
    piece: Piece,
}

impl Waiting {
    /// Starts in an empty file.
    pub(crate) fn new(file: File) -> Self {
        Self {
            file,
            end: AtomicU64::new(0),
        }
    }

    /// Keeps `piece.triangles[range]`, at most [`RECORD_TRIANGLES`], through `buffer`.
    pub(crate) fn put(
        &self,
        piece: &Piece,
        range: Range<usize>,
        buffer: &mut Vec<u8>,
    ) -> Result<()> {
        buffer.clear();
        encode(piece, range, buffer);
        let bytes = buffer.len() as u64;
        let at = self.end.fetch_add(bytes, Ordering::Relaxed);
        if at.checked_add(bytes).is_none() {
            return Err(ErrorKind::FileTooLarge.into());
        }
        write_all_at(&self.file, buffer, at)
    }

    /// Gives every record to `each`, as a piece without anything but its triangles and numbers, in no
    /// order, on so many threads. What was read is given back to the file system where it allows that.
    pub(crate) fn drain(
        &self,
        threads: usize,
        each: impl Fn(&Piece) -> Result<()> + Sync,
    ) -> Result<()> {
        let end = self.end.load(Ordering::Relaxed);
        let next = Mutex::new(0);
        let work = || -> Result<()> {
            let mut room = Room::default();
            loop {
                let (at, head) = {
                    let mut next = next.lock().expect("no thread panicked");
                    if *next >= end {
                        return Ok(());
                    }
                    let head = Head::read(&self.file, *next)?;
                    let at = *next;
                    *next += (HEAD_BYTES + head.body_bytes()) as u64;
                    (at, head)
                };
                room.record.resize(head.body_bytes(), 0);
                read_exact_at(&self.file, &mut room.record, at + HEAD_BYTES as u64)?;
                head.decode(&room.record, &mut room.piece)?;
                each(&room.piece)?;
                give_back(&self.file, at, room.record.len());
            }
        };
        std::thread::scope(|scope| {
            let others: Vec<_> = (1..threads).map(|_| scope.spawn(work)).collect();
            let mut result = work();
            for other in others {
                result = result.and(other.join().expect("no thread panicked"));
            }
            result
        })
    }
}

fn encode(piece: &Piece, range: Range<usize>, out: &mut Vec<u8>) {
    let triangles = &piece.triangles[range.clone()];
    let near = piece.ids.len() <= NEAR_VERTICES && !piece.ids.is_empty();
    let vertices = if near { piece.ids.len() } else { 0 };
    out.extend((piece.first_triangle + range.start as u64).to_le_bytes());
    out.extend(piece.first_vertex.to_le_bytes());
    out.extend(piece.label.map_or(NO_LABEL, u64::from).to_le_bytes());
    out.extend((triangles.len() as u32).to_le_bytes());
    out.extend((vertices as u32).to_le_bytes());
    out.extend([0; 4]);
    if !near {
        let ids = triangles.as_flattened().iter();
        out.extend(ids.flat_map(|&v| piece.ids[v as usize].to_le_bytes()));
        return;
    }
    let corners = triangles.as_flattened();
    let start = out.len();
    out.resize(start + 2 * corners.len(), 0);
    let places = out[start..].as_chunks_mut::<2>().0;
    for (place, &v) in places.iter_mut().zip(corners) {
        *place = (v as u16).to_le_bytes();
    }
    // A bit for each vertex: whether it has the next number of the piece.
    let bits = out.len();
    out.resize(bits + vertices.div_ceil(64) * 8, 0);
    let mut next = piece.first_vertex;
    let mut foreign = 0u32;
    for (i, ids) in piece.ids.chunks(64).enumerate() {
        let mut word = 0u64;
        for (bit, &id) in ids.iter().enumerate() {
            let continues = id == next;
            word |= u64::from(continues) << bit;
            next += u64::from(continues);
        }
        out[bits + 8 * i..][..8].copy_from_slice(&word.to_le_bytes());
        let mut others = !word & (u64::MAX >> (64 - ids.len()));
        foreign += others.count_ones();
        while others != 0 {
            out.extend_from_slice(&ids[others.trailing_zeros() as usize].to_le_bytes());
            others &= others - 1;
        }
    }
    out[HEAD_BYTES - 4..HEAD_BYTES].copy_from_slice(&foreign.to_le_bytes());
}

fn damaged() -> Error {
    Error::new(
        ErrorKind::InvalidData,
        "the scratch file was changed by somebody else",
    )
}

impl Head {
    fn read(file: &File, at: u64) -> Result<Self> {
        let mut bytes = [0; HEAD_BYTES];
        read_exact_at(file, &mut bytes, at)?;
        let (long, short) = bytes.split_at(24);
        let long = |i: usize| long.as_chunks::<8>().0[i];
        let short = |i: usize| u32::from_le_bytes(short.as_chunks::<4>().0[i]) as usize;
        let label = u64::from_le_bytes(long(2));
        let head = Self {
            first_triangle: u64::from_le_bytes(long(0)),
            first_vertex: u64::from_le_bytes(long(1)),
            label: (label != NO_LABEL).then_some(label as u32),
            triangles: short(0),
            vertices: short(1),
            foreign: short(2),
        };
        let sound = head.triangles <= RECORD_TRIANGLES
            && head.vertices <= NEAR_VERTICES
            && head.foreign <= head.vertices;
        if sound { Ok(head) } else { Err(damaged()) }
    }

    fn body_bytes(&self) -> usize {
        let corner = if self.vertices == 0 { 8 } else { 2 };
        self.triangles * 3 * corner + self.vertices.div_ceil(64) * 8 + self.foreign * 8
    }

    fn decode(&self, body: &[u8], piece: &mut Piece) -> Result<()> {
        piece.first_triangle = self.first_triangle;
        piece.first_vertex = self.first_vertex;
        piece.label = self.label;
        piece.ids.clear();
        piece.triangles.resize(self.triangles, [0; 3]);
        let corners = piece.triangles.as_flattened_mut();
        if self.vertices == 0 {
            let ids = body.as_chunks::<8>().0;
            piece
                .ids
                .extend(ids.iter().map(|id| u64::from_le_bytes(*id)));
            (0..).zip(corners).for_each(|(i, corner)| *corner = i);
            return Ok(());
        }
        let (near, rest) = body.split_at(2 * corners.len());
        let mut most = 0;
        for (corner, near) in corners.iter_mut().zip(near.as_chunks::<2>().0) {
            *corner = u32::from(u16::from_le_bytes(*near));
            most = most.max(*corner);
        }
        let (words, foreign) = rest.split_at(self.vertices.div_ceil(64) * 8);
        let mut foreign = foreign.as_chunks::<8>().0.iter();
        let mut next = self.first_vertex;
        for (i, word) in words.as_chunks::<8>().0.iter().enumerate() {
            let (mut word, mut left) =
                (u64::from_le_bytes(*word), (self.vertices - 64 * i).min(64));
            // Run by run.
            while left > 0 {
                let run = (word.trailing_ones() as usize).min(left);
                piece.ids.extend(next..next + run as u64);
                next += run as u64;
                left -= run;
                word = word.unbounded_shr(run as u32);
                let others = (word.trailing_zeros() as usize).min(left);
                for _ in 0..others {
                    let id = foreign.next().ok_or_else(damaged)?;
                    piece.ids.push(u64::from_le_bytes(*id));
                }
                left -= others;
                word = word.unbounded_shr(others as u32);
            }
        }
        if most as usize >= piece.ids.len() && self.triangles > 0 {
            return Err(damaged());
        }
        Ok(())
    }
}

/// Frees the room of a record that was read; that it cannot costs nothing but room.
fn give_back(file: &File, at: u64, body: usize) {
    if body < GIVE_BACK_BYTES {
        return;
    }
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::FallocateFlags;
        let flags = FallocateFlags::PUNCH_HOLE | FallocateFlags::KEEP_SIZE;
        let _ = rustix::fs::fallocate(file, flags, at, (HEAD_BYTES + body) as u64);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (file, at);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A piece whose numbers continue but for every seventh.
    fn piece(vertices: u32, triangles: u32, first: u64) -> Piece {
        let mut next = 5_000_000_000 + first;
        let ids = (0..vertices).map(|i| {
            if i % 7 == 3 {
                return u64::from(i) * 3;
            }
            next += 1;
            next - 1
        });
        Piece {
            first_triangle: first,
            first_vertex: 5_000_000_000 + first,
            label: (first % 2 == 1).then_some(u32::MAX),
            ids: ids.collect(),
            triangles: (0..triangles)
                .map(|t| [t % vertices, (t * 7 + 1) % vertices, vertices - 1])
                .collect(),
            ..Piece::default()
        }
    }

    fn corners(piece: &Piece) -> Vec<[u64; 3]> {
        (0..piece.triangles.len())
            .map(|t| piece.triangle_ids(t))
            .collect()
    }

    #[test]
    fn every_triangle_comes_back_with_its_number_and_label() {
        let pieces = [
            piece(3, 1, 0),
            piece(1000, 1999, 1),
            piece(64, 70_000, 2000),
            piece(65_536, 65_537, 100_001),
            piece(65_537, 70_000, 200_000),
        ];
        for threads in [1, 3] {
            let waiting = Waiting::new(tempfile::tempfile().expect("scratch"));
            let mut buffer = Vec::new();
            for piece in pieces.iter().rev() {
                let count = piece.triangles.len();
                for start in (0..count).step_by(RECORD_TRIANGLES) {
                    let range = start..count.min(start + RECORD_TRIANGLES);
                    waiting.put(piece, range, &mut buffer).expect("kept");
                }
            }
            let found = Mutex::new(Vec::new());
            let note = |piece: &Piece| {
                let all = (piece.first_triangle..).zip(corners(piece));
                let mut found = found.lock().expect("no panic");
                found.extend(all.map(|(t, corners)| (t, corners, piece.label)));
                Ok(())
            };
            waiting.drain(threads, note).expect("read");
            let mut found = found.into_inner().expect("no panic");
            found.sort_unstable();
            let expected = pieces.iter().flat_map(|piece| {
                let all = (piece.first_triangle..).zip(corners(piece));
                all.map(|(t, corners)| (t, corners, piece.label))
            });
            assert!(found.into_iter().eq(expected), "{threads} threads");
        }
    }

    #[test]
    fn a_usual_record_takes_half_of_a_face() {
        let piece = piece(20_000, 40_960, 1);
        let mut bytes = Vec::new();
        encode(&piece, 0..RECORD_TRIANGLES, &mut bytes);
        assert!(bytes.len() < RECORD_TRIANGLES * 8, "{}", bytes.len());
    }

    #[test]
    fn a_changed_file_is_an_error() {
        let file = tempfile::tempfile().expect("scratch");
        let waiting = Waiting::new(file.try_clone().expect("again"));
        let piece = piece(100, 200, 7);
        waiting.put(&piece, 0..200, &mut Vec::new()).expect("kept");
        for (at, byte) in [(27, 0x7f), (32, 1), (HEAD_BYTES as u64, 0xff)] {
            let mut was = [0];
            read_exact_at(&file, &mut was, at).expect("read");
            write_all_at(&file, &[byte], at).expect("changed");
            let result = waiting.drain(1, |_| Ok(()));
            assert!(result.is_err(), "byte {at}");
            write_all_at(&file, &was, at).expect("changed back");
        }
        waiting.drain(1, |_| Ok(())).expect("sound again");
    }
}
