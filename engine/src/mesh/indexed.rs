//! The indexed triangle mesh: plain arrays of positions and indices.

/// An indexed triangle mesh in memory.
///
/// # Memory
/// 12 B a vertex, 12 B a triangle, 12 B a normal and 16 B a key where present.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// World positions.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals pointing out, one a vertex, or empty.
    pub normals: Vec<[f32; 3]>,
    /// Lattice edge of each vertex, or empty.
    pub keys: Vec<super::EdgeKey>,
    /// Corners, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}
