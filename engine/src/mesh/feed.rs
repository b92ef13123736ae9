//! A mesh in memory, cut into pieces for a sink.

use super::{Layout, Mesh, MeshSink, Piece, Totals};
use crate::error::{Error, Result};

/// Writes the whole of `mesh` into `sink` by pieces of about `piece_triangles` triangles, from
/// `begin` to `finish`. Vertices and triangles keep their numbers.
///
/// # Errors
/// When a triangle names a vertex that the mesh does not have, or the sink fails.
///
/// # Memory
/// One piece at a time.
pub fn feed(mesh: &Mesh, sink: &mut dyn MeshSink, piece_triangles: usize) -> Result<()> {
    let count = mesh.positions.len();
    let lost = |triangle: &[u32; 3]| triangle.iter().any(|&v| v as usize >= count);
    if let Some(t) = mesh.triangles.iter().position(lost) {
        return Err(Error::bad_input(format!(
            "triangle {t} names vertices {:?} of a mesh with {count}",
            mesh.triangles[t]
        )));
    }
    sink.begin(layout(mesh))?;
    for piece in pieces(mesh, piece_triangles) {
        sink.write(&piece)?;
    }
    sink.finish(Totals {
        vertices: count as u64,
        triangles: mesh.triangles.len() as u64,
    })
}

/// What the vertices of `mesh` carry.
pub fn layout(mesh: &Mesh) -> Layout {
    Layout {
        normals: !mesh.normals.is_empty(),
        keys: !mesh.keys.is_empty(),
    }
}

/// Cuts `mesh` into pieces of at most about `piece_triangles` triangles and as many new vertices.
///
/// Unlike the pieces of an extraction, one may use vertices that are new in a later one.
///
/// # Panics
/// When a triangle names a vertex that the mesh does not have.
pub fn pieces(mesh: &Mesh, piece_triangles: usize) -> impl Iterator<Item = Piece> + '_ {
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    let count = vertices.max(triangles).div_ceil(piece_triangles.max(1));
    let cut = move |whole: usize, i: usize| (whole as u128 * i as u128 / count as u128) as usize;
    (0..count).map(move |i| {
        let own = cut(vertices, i)..cut(vertices, i + 1);
        let triangles = cut(triangles, i)..cut(triangles, i + 1);
        let mut ids: Vec<u64> = mesh.triangles[triangles.clone()]
            .iter()
            .flatten()
            .map(|&v| u64::from(v))
            .chain(own.start as u64..own.end as u64)
            .collect();
        ids.sort_unstable();
        ids.dedup();
        let local = |id: u64| ids.binary_search(&id).expect("every corner is listed") as u32;
        let pick = |from: &[[f32; 3]]| -> Vec<[f32; 3]> {
            ids.iter()
                .filter_map(|&id| from.get(id as usize).copied())
                .collect()
        };
        Piece {
            first_vertex: own.start as u64,
            first_triangle: triangles.start as u64,
            positions: ids.iter().map(|&id| mesh.positions[id as usize]).collect(),
            unmoved: Vec::new(),
            normals: pick(&mesh.normals),
            keys: ids
                .iter()
                .filter_map(|&id| mesh.keys.get(id as usize).copied())
                .collect(),
            colors: Vec::new(),
            label: None,
            own: (own.start as u64..own.end as u64).map(local).collect(),
            triangles: mesh.triangles[triangles]
                .iter()
                .map(|corners| corners.map(|v| local(u64::from(v))))
                .collect(),
            ids,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{Collect, EdgeKey};

    fn strip(n: u32) -> Mesh {
        let point = |i: u32| [i as f32, (i % 2) as f32, 0.5];
        Mesh {
            positions: (0..n + 2).map(point).collect(),
            normals: (0..n + 2).map(|_| [0.0, 0.0, 1.0]).collect(),
            keys: (0..n + 2)
                .map(|i| EdgeKey {
                    point: [i as i32; 3],
                    axis: 2,
                })
                .collect(),
            // The last triangles first, so that pieces use vertices of others.
            triangles: (0..n).rev().map(|i| [i, i + 1, i + 2]).collect(),
        }
    }

    #[test]
    fn pieces_of_any_size_give_the_mesh_again() {
        for n in [1, 2, 7, 100] {
            let mesh = strip(n);
            for size in [0, 1, 2, 3, 64, usize::MAX] {
                let mut sink = Collect::default();
                feed(&mesh, &mut sink, size).expect("fed");
                assert_eq!(sink.into_mesh(), mesh, "{n} triangles by {size}");
            }
        }
        let mut sink = Collect::default();
        feed(&Mesh::default(), &mut sink, 8).expect("fed");
        assert_eq!(sink.into_mesh(), Mesh::default());
    }

    #[test]
    fn a_lost_vertex_is_an_error() {
        let mut mesh = strip(4);
        mesh.triangles[2][1] = 6;
        let error = feed(&mesh, &mut Collect::default(), 2).expect_err("no such vertex");
        assert!(error.to_string().contains("triangle 2"), "{error}");
    }
}
