//! Where triangles go while they are made.
//!
//! A mesh arrives in pieces. Every piece says where its vertices and triangles stand in the whole
//! (`first_vertex`, `first_triangle`), so pieces may be written from several threads and in any
//! order, and the file is still the same, byte for byte.

use super::Mesh;
use crate::error::{Error, ErrorKind, Result};
use std::sync::Mutex;

/// Identity of a vertex: the lattice edge it lies on, or the cell it lies in.
///
/// Meshes of neighbouring regions join by key, exactly, never by distance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct EdgeKey {
    /// Lower end point of the edge, or lowest corner of the cell.
    pub point: [i32; 3],
    /// Direction of the edge: 0, 1, 2; or 3 and more for the vertices inside the cell.
    pub axis: u8,
}

/// What the vertices of a mesh carry beside their position.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Layout {
    /// Unit normals.
    pub normals: bool,
    /// Keys.
    pub keys: bool,
}

/// Counts of a finished mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Number of vertices.
    pub vertices: u64,
    /// Number of triangles.
    pub triangles: u64,
}

/// Part of a mesh. Local vertices are those that the triangles of this piece use; some of them
/// (`own`) are new, the others belong to earlier pieces and are repeated here for sinks that need
/// positions.
#[derive(Clone, Debug, Default)]
pub struct Piece {
    /// Global number of the first vertex in `own`.
    pub first_vertex: u64,
    /// Global number of the first triangle.
    pub first_triangle: u64,
    /// World position of each local vertex.
    pub positions: Vec<[f32; 3]>,
    /// World position of each local vertex before it was moved for better triangles, or empty.
    pub unmoved: Vec<[f32; 3]>,
    /// Unit normal of each local vertex, or empty.
    pub normals: Vec<[f32; 3]>,
    /// Key of each local vertex, or empty.
    pub keys: Vec<EdgeKey>,
    /// Colour of each local vertex, red, green, blue; or empty.
    pub colors: Vec<[u8; 3]>,
    /// Label of all triangles of this piece, for sinks that write it.
    pub label: Option<u32>,
    /// Global number of each local vertex.
    pub ids: Vec<u64>,
    /// Local numbers of the new vertices; the global number of `own[i]` is `first_vertex + i`.
    pub own: Vec<u32>,
    /// Triangles by local numbers, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Piece {
    /// Bytes of the buffers.
    pub fn capacity_bytes(&self) -> u64 {
        (self.positions.capacity() * 12
            + self.unmoved.capacity() * 12
            + self.normals.capacity() * 12
            + self.keys.capacity() * size_of::<EdgeKey>()
            + self.colors.capacity() * 3
            + self.ids.capacity() * 8
            + self.own.capacity() * 4
            + self.triangles.capacity() * 12) as u64
    }

    /// Global numbers of the corners of local triangle `t`.
    #[inline]
    pub fn triangle_ids(&self, t: usize) -> [u64; 3] {
        self.triangles[t].map(|v| self.ids[v as usize])
    }
}

/// A receiver of vertices and triangles.
///
/// The order of calls is `begin`, any number of `write` (from any thread, in any order), `finish`.
/// Nothing appears under the final name before `finish`; a sink that is dropped without it leaves
/// nothing behind.
pub trait MeshSink: Sync {
    /// Most vertices and triangles that the receiver can hold.
    fn capacity(&self) -> Totals {
        Totals {
            vertices: u64::MAX,
            triangles: u64::MAX,
        }
    }

    /// Says what the vertices carry.
    ///
    /// # Errors
    /// When the receiver cannot take it.
    fn begin(&mut self, layout: Layout) -> Result<()>;

    /// Takes a piece.
    ///
    /// # Errors
    /// When the receiver is full or fails.
    fn write(&self, piece: &Piece) -> Result<()>;

    /// Completes the mesh.
    ///
    /// # Errors
    /// When the receiver fails; nothing is left under the final name then.
    fn finish(&mut self, totals: Totals) -> Result<()>;
}

/// A receiver of the meshes of many labels, piece by piece. The pieces of a label come in order,
/// those of different labels in between each other.
pub trait LabelSink: Send {
    /// Most vertices and triangles that the mesh of a label may have.
    fn capacity(&self) -> Totals {
        Totals {
            vertices: u64::MAX,
            triangles: u64::MAX,
        }
    }

    /// Says what the vertices carry.
    ///
    /// # Errors
    /// When the receiver cannot take it.
    fn begin(&mut self, layout: Layout) -> Result<()>;

    /// Takes a piece of the mesh of `label`.
    ///
    /// # Errors
    /// When the receiver is full or fails.
    fn write(&mut self, label: u32, piece: &Piece) -> Result<()>;
}

/// Collects the mesh in memory.
#[derive(Debug, Default)]
pub struct Collect {
    layout: Layout,
    mesh: Mutex<Mesh>,
}

impl Collect {
    /// The mesh, after `finish`.
    pub fn into_mesh(self) -> Mesh {
        self.mesh.into_inner().expect("no writer panicked")
    }
}

impl MeshSink for Collect {
    fn capacity(&self) -> Totals {
        Totals {
            vertices: 1 << 32,
            triangles: u64::MAX,
        }
    }

    fn begin(&mut self, layout: Layout) -> Result<()> {
        self.layout = layout;
        Ok(())
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        let mut mesh = self.mesh.lock().expect("no writer panicked");
        let first = piece.first_vertex as usize;
        let vertices = first + piece.own.len();
        if vertices > 1 << 32 {
            return Err(Error::new(
                ErrorKind::LimitExceeded,
                "a mesh in memory holds at most 2^32 vertices",
            ));
        }
        let grown = mesh.positions.len().max(vertices);
        mesh.positions.resize(grown, [0.0; 3]);
        if self.layout.normals {
            mesh.normals.resize(grown, [0.0; 3]);
        }
        if self.layout.keys {
            mesh.keys.resize(
                grown,
                EdgeKey {
                    point: [0; 3],
                    axis: 0,
                },
            );
        }
        for (i, &local) in piece.own.iter().enumerate() {
            mesh.positions[first + i] = piece.positions[local as usize];
            if self.layout.normals {
                mesh.normals[first + i] = piece.normals[local as usize];
            }
            if self.layout.keys {
                mesh.keys[first + i] = piece.keys[local as usize];
            }
        }
        let first = piece.first_triangle as usize;
        let grown = mesh.triangles.len().max(first + piece.triangles.len());
        mesh.triangles.resize(grown, [0; 3]);
        for t in 0..piece.triangles.len() {
            mesh.triangles[first + t] = piece.triangle_ids(t).map(|v| v as u32);
        }
        Ok(())
    }

    fn finish(&mut self, totals: Totals) -> Result<()> {
        let mesh = self.mesh.get_mut().expect("no writer panicked");
        debug_assert_eq!(mesh.positions.len() as u64, totals.vertices);
        debug_assert_eq!(mesh.triangles.len() as u64, totals.triangles);
        Ok(())
    }
}

/// Counts and throws away.
#[derive(Debug, Default)]
pub struct Count {
    /// The counts, after `finish`.
    pub totals: Totals,
}

impl MeshSink for Count {
    fn begin(&mut self, _layout: Layout) -> Result<()> {
        Ok(())
    }

    fn write(&self, _piece: &Piece) -> Result<()> {
        Ok(())
    }

    fn finish(&mut self, totals: Totals) -> Result<()> {
        self.totals = totals;
        Ok(())
    }
}
