//! Isosurface extraction against the naive oracle, and the laws that it keeps.

mod analytic;
mod checker;
pub(crate) mod compare;
mod components;
mod isolines;
mod labels;
mod laws;
mod normals;
mod oracle;
mod parts;
mod redistance;
mod relaxed;
mod seeds;
mod simplified;
mod tiles;
mod world;

use brickmarch::field::Dense;
use brickmarch::iso::{Extract, Stats, extract};
use brickmarch::mesh::Collect;
use brickmarch::{Box3, Budget, Field, Grid, Mesh};

/// Extracts into memory, with keys and in index space.
pub(crate) fn mesh_of(
    field: &dyn Field,
    options: &Extract,
    budget: &Budget,
) -> brickmarch::Result<(Mesh, Stats)> {
    let options = Extract {
        keys: true,
        ..options.clone()
    };
    let mut sink = Collect::default();
    let stats = extract(field, &options, budget, &mut sink)?;
    let mesh = sink.into_mesh();
    assert_eq!(stats.vertices, mesh.positions.len() as u64);
    assert_eq!(stats.triangles, mesh.triangles.len() as u64);
    Ok((mesh, stats))
}

/// A dense field with blocks of `edge`.
pub(crate) fn dense(domain: Box3, values: Vec<f32>, edge: u32) -> Dense {
    let mut field = Dense::new(Grid::new(domain), values).expect("sizes match");
    field.block_edge = edge;
    field
}
