//! Global numbers of vertices, given out block by block.
//!
//! A lattice edge on the face between two blocks belongs to the earlier block. That block leaves
//! the numbers of its high faces behind, in the order of the face; the later block sees the same
//! samples there, hence the same crossed edges in the same order, and picks the numbers up. So no
//! vertex is ever looked up by place, and what is kept is the faces between done and not done.

use super::block::BlockOutput;
use crate::error::{Error, ErrorKind, Result};
use crate::mesh::{Piece, Totals};
use std::collections::HashMap;

/// Numbers given out so far, and the faces of the front.
#[derive(Debug, Default)]
pub(super) struct Numbering {
    pub(super) totals: Totals,
    faces: HashMap<([i32; 3], u8), Box<[u64]>>,
    front_bytes: u64,
    pub(super) front_bytes_max: u64,
}

impl Numbering {
    /// Numbers that go on from `first`.
    pub(super) fn from(first: Totals) -> Self {
        Self {
            totals: first,
            ..Self::default()
        }
    }

    /// Starts the numbers of a piece.
    pub(super) fn start(&self, piece: &mut Piece) {
        piece.first_vertex = self.totals.vertices;
        piece.first_triangle = self.totals.triangles;
        piece.ids.clear();
        piece.ids.resize(piece.positions.len(), u64::MAX);
        for (i, &local) in piece.own.iter().enumerate() {
            piece.ids[local as usize] = piece.first_vertex + i as u64;
        }
    }

    /// Takes over borrowed numbers of the block at `at` and leaves its own for later blocks, of which the
    /// last ones lie before `end`. Called for the
    /// blocks in their order, after [`start`](Self::start) of their piece.
    pub(super) fn pass(
        &mut self,
        end: [i32; 3],
        at: [i32; 3],
        out: &BlockOutput,
        piece: &mut Piece,
    ) -> Result<()> {
        for axis in 0..3 {
            let low = &out.low[axis];
            if low.is_empty() {
                continue;
            }
            let mut from = at;
            from[axis] -= 1;
            let numbers = self.faces.remove(&(from, axis as u8)).unwrap_or_default();
            if numbers.len() != low.len() {
                return Err(Error::new(
                    ErrorKind::Damaged,
                    format!(
                        "the samples between blocks {from:?} and {at:?} differ from read to read, or the range of a \
                         block does not cover its samples ({} and {} crossed edges)",
                        numbers.len(),
                        low.len()
                    ),
                ));
            }
            self.front_bytes -= face_bytes(low.len());
            for (&local, &id) in low.iter().zip(&numbers) {
                piece.ids[local as usize] = id;
            }
        }
        for axis in 0..3 {
            if at[axis] < end[axis] - 1 && !out.high[axis].is_empty() {
                let numbers: Box<[u64]> = out.high[axis]
                    .iter()
                    .map(|&v| piece.ids[v as usize])
                    .collect();
                self.front_bytes += face_bytes(numbers.len());
                self.faces.insert((at, axis as u8), numbers);
            }
        }
        self.front_bytes_max = self.front_bytes_max.max(self.front_bytes);
        Ok(())
    }

    /// Bytes of the front now.
    pub(super) fn front_bytes(&self) -> u64 {
        self.front_bytes
    }

    /// Ends a piece.
    pub(super) fn end(&mut self, piece: &Piece) {
        self.totals.vertices += piece.own.len() as u64;
        self.totals.triangles += piece.triangles.len() as u64;
    }
}

fn face_bytes(numbers: usize) -> u64 {
    // The numbers, their allocation, and the entry of the map.
    8 * numbers as u64 + 96
}
