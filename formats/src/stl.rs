//! STL, binary, written while the mesh is made.
//!
//! STL has no shared vertices and no keys: 50 B a triangle, at most 2^32 - 1 of them. The normal is
//! that of the flat triangle, zero when it has no area.

use crate::mesh_stream::{Encode, Shape};
use brickmarch::mesh::{Layout, Piece, Totals};
use brickmarch::{Error, ErrorKind, Result};
use std::ops::Range;

/// Bytes of the header with the count.
const HEADER_BYTES: usize = 84;

/// Bytes of a triangle: normal, three corners, two bytes that mean nothing.
const TRIANGLE_BYTES: usize = 50;

/// Encoder of STL.
#[derive(Debug, Default)]
pub(crate) struct Stl;

impl Encode for Stl {
    fn capacity(&self) -> Totals {
        Totals {
            vertices: u64::MAX,
            triangles: u64::from(u32::MAX),
        }
    }

    fn begin(&mut self, layout: Layout) -> Result<Shape> {
        if layout.normals || layout.keys {
            return Err(Error::new(
                ErrorKind::Unsupported,
                "STL holds no vertex normals and no keys: leave them out, or write PLY",
            ));
        }
        Ok(Shape {
            header: HEADER_BYTES as u64,
            vertex: 0,
            triangle: TRIANGLE_BYTES,
        })
    }

    fn vertices(&self, _piece: &Piece, _range: Range<usize>, _out: &mut [u8]) {}

    fn triangles(&self, piece: &Piece, range: Range<usize>, out: &mut [u8]) {
        for (corners, record) in piece.triangles[range]
            .iter()
            .zip(out.chunks_exact_mut(TRIANGLE_BYTES))
        {
            let corners = corners.map(|v| piece.positions[v as usize]);
            let parts = [normal(corners), corners[0], corners[1], corners[2]];
            for (bytes, value) in record
                .chunks_exact_mut(4)
                .zip(parts.iter().flatten().copied())
            {
                bytes.copy_from_slice(&value.to_le_bytes());
            }
            record[48..].fill(0);
        }
    }

    fn header(&self, totals: Totals) -> Vec<u8> {
        // Readers take a file that begins with "solid" for text.
        let mut header = vec![b' '; HEADER_BYTES];
        let title = b"brickmarch binary STL";
        header[..title.len()].copy_from_slice(title);
        // The stream has checked the count.
        header[80..].copy_from_slice(&(totals.triangles as u32).to_le_bytes());
        header
    }
}

fn normal([a, b, c]: [[f32; 3]; 3]) -> [f32; 3] {
    // In f64 no product of f32 differences overflows or vanishes.
    let edge = |p: [f32; 3]| [0, 1, 2].map(|i| f64::from(p[i]) - f64::from(a[i]));
    let (u, v) = (edge(b), edge(c));
    let cross = [
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    ];
    let length = cross.iter().map(|x| x * x).sum::<f64>().sqrt();
    if length > 0.0 {
        cross.map(|x| (x / length) as f32)
    } else {
        [0.0; 3]
    }
}
