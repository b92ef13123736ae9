//! PLY, binary little endian, written while the mesh is made.
//!
//! Vertices are `float x y z`, then `nx ny nz`, then the key as `int edge_x edge_y edge_z` and
//! `uchar edge_axis`, then `uchar red green blue`, where present. Faces are `list uchar int vertex_indices`,
//! then `uint label` where present. The bytes of a
//! signed and an unsigned index are the same below 2^31, so the type is decided at the end: `int`,
//! which every reader knows, up to 2^31 vertices, `uint` up to 2^32, which is the limit.
//!
//! The header has the size it would have with the largest counts; a comment fills the difference.

use crate::mesh_stream::{Encode, Shape};
use brickmarch::Result;
use brickmarch::mesh::{Layout, Piece, Totals};
use std::ops::Range;

/// Most vertices whose numbers fit a signed index.
const SIGNED_VERTICES: u64 = 1 << 31;

/// Bytes of a face: the count and three indices.
const FACE_BYTES: usize = 1 + 3 * 4;

/// Encoder of PLY.
#[derive(Debug, Default)]
pub(crate) struct Ply {
    layout: Layout,
    colors: bool,
    labels: bool,
}

impl Ply {
    /// An encoder that writes the colours of vertices.
    pub(crate) fn with_colors() -> Ply {
        Ply {
            colors: true,
            ..Ply::default()
        }
    }

    /// An encoder that writes the label of each face.
    pub(crate) fn with_labels() -> Ply {
        Ply {
            labels: true,
            ..Ply::default()
        }
    }

    fn face_bytes(&self) -> usize {
        FACE_BYTES + if self.labels { 4 } else { 0 }
    }

    fn header_bytes(&self) -> usize {
        let largest = Totals {
            vertices: u64::MAX,
            triangles: u64::MAX,
        };
        header_text(self, largest, 0).len().next_multiple_of(16)
    }
}

fn header_text(ply: &Ply, totals: Totals, padding: usize) -> String {
    let Ply {
        layout,
        colors,
        labels,
    } = *ply;
    let mut text = format!(
        "ply\nformat binary_little_endian 1.0\ncomment brickmarch{:padding$}\nelement vertex {}\n",
        "", totals.vertices
    );
    let mut property = |kind: &str, names: &[&str]| {
        for name in names {
            text.push_str(&format!("property {kind} {name}\n"));
        }
    };
    property("float", &["x", "y", "z"]);
    if layout.normals {
        property("float", &["nx", "ny", "nz"]);
    }
    if layout.keys {
        property("int", &["edge_x", "edge_y", "edge_z"]);
        property("uchar", &["edge_axis"]);
    }
    if colors {
        property("uchar", &["red", "green", "blue"]);
    }
    let index = if totals.vertices <= SIGNED_VERTICES {
        "int"
    } else {
        "uint"
    };
    text.push_str(&format!(
        "element face {}\nproperty list uchar {index} vertex_indices\n",
        totals.triangles
    ));
    if labels {
        text.push_str("property uint label\n");
    }
    text.push_str("end_header\n");
    text
}

fn put_floats(out: &mut [u8], values: [f32; 3]) {
    out[..4].copy_from_slice(&values[0].to_le_bytes());
    out[4..8].copy_from_slice(&values[1].to_le_bytes());
    out[8..12].copy_from_slice(&values[2].to_le_bytes());
}

impl Encode for Ply {
    fn capacity(&self) -> Totals {
        Totals {
            vertices: 1 << 32,
            triangles: u64::MAX,
        }
    }

    fn begin(&mut self, layout: Layout) -> Result<Shape> {
        self.layout = layout;
        Ok(Shape {
            header: self.header_bytes() as u64,
            vertex: 12
                + if layout.normals { 12 } else { 0 }
                + if layout.keys { 13 } else { 0 }
                + if self.colors { 3 } else { 0 },
            triangle: self.face_bytes(),
        })
    }

    fn vertices(&self, piece: &Piece, range: Range<usize>, out: &mut [u8]) {
        let own = &piece.own[range];
        if !self.layout.normals && !self.layout.keys && !self.colors {
            for (&local, record) in own.iter().zip(out.chunks_exact_mut(12)) {
                put_floats(record, piece.positions[local as usize]);
            }
            return;
        }
        let size = out.len() / own.len().max(1);
        for (&local, record) in own.iter().zip(out.chunks_exact_mut(size)) {
            let local = local as usize;
            put_floats(record, piece.positions[local]);
            let mut rest = &mut record[12..];
            if self.layout.normals {
                put_floats(rest, piece.normals[local]);
                rest = &mut rest[12..];
            }
            if self.layout.keys {
                let key = &piece.keys[local];
                for (bytes, value) in rest.chunks_exact_mut(4).zip(key.point) {
                    bytes.copy_from_slice(&value.to_le_bytes());
                }
                rest[12] = key.axis;
                rest = &mut rest[13..];
            }
            if self.colors {
                // A piece without colours is white.
                let color = piece.colors.get(local).copied().unwrap_or([255; 3]);
                rest[..3].copy_from_slice(&color);
            }
        }
    }

    fn triangles(&self, piece: &Piece, range: Range<usize>, out: &mut [u8]) {
        for (corners, record) in piece.triangles[range]
            .iter()
            .zip(out.chunks_exact_mut(self.face_bytes()))
        {
            // The stream has checked that every number fits.
            let [a, b, c] = corners.map(|v| (piece.ids[v as usize] as u32).to_le_bytes());
            record[0] = 3;
            record[1..5].copy_from_slice(&a);
            record[5..9].copy_from_slice(&b);
            record[9..13].copy_from_slice(&c);
            if self.labels {
                // A piece without a label belongs to the background.
                let label = piece.label.unwrap_or(0).to_le_bytes();
                record[13..].copy_from_slice(&label);
            }
        }
    }

    fn header(&self, totals: Totals) -> Vec<u8> {
        let text = |padding| header_text(self, totals, padding);
        text(self.header_bytes() - text(0).len()).into_bytes()
    }
}
