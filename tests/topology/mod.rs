//! The surface has the topology of the trilinear interpolant in every cell.

mod neighbours;
mod published;
mod random;
mod symmetry;

use crate::support::topology::{Sets, Verdict, judge};
use brickmarch::field::Dense;
use brickmarch::iso::{Boundary, Extract, extract};
use brickmarch::mesh::Collect;
use brickmarch::{Box3, Budget, Grid, Inside, Mesh};
use std::collections::HashMap;

/// The surface of a small grid at `iso`, open at the border, in index space.
fn mesh(size: [i32; 3], values: &[f32], iso: f32, inside: Inside, boundary: Boundary) -> Mesh {
    mesh_of(size, values, iso, inside, boundary, false)
}

/// The same with the keys of the vertices.
fn mesh_with_keys(
    size: [i32; 3],
    values: &[f32],
    iso: f32,
    inside: Inside,
    boundary: Boundary,
) -> Mesh {
    mesh_of(size, values, iso, inside, boundary, true)
}

fn mesh_of(
    size: [i32; 3],
    values: &[f32],
    iso: f32,
    inside: Inside,
    boundary: Boundary,
    keys: bool,
) -> Mesh {
    let grid = Grid::new(Box3::from_size(size));
    let mut field = Dense::new(grid, values.to_vec()).expect("sizes match");
    field.block_edge = 8;
    let options = Extract {
        iso,
        inside: Some(inside),
        boundary,
        index_space: true,
        allow_empty: true,
        keys,
        ..Extract::default()
    };
    let mut sink = Collect::default();
    let budget = Budget::mib(32).with_threads(1);
    extract(&field, &options, &budget, &mut sink).expect("meshes");
    sink.into_mesh()
}

fn verdict(mesh: &Mesh) -> Verdict {
    judge(&mesh.positions, &mesh.triangles)
}

/// The mesh with vertices at one place made one.
fn welded(mesh: &Mesh) -> Mesh {
    let mut numbers: HashMap<[u32; 3], u32> = HashMap::new();
    let mut out = Mesh::default();
    let number = |p: &[f32; 3]| {
        *numbers
            .entry(p.map(|v| (v + 0.0).to_bits()))
            .or_insert_with(|| {
                out.positions.push(*p);
                out.positions.len() as u32 - 1
            })
    };
    let numbers: Vec<u32> = mesh.positions.iter().map(number).collect();
    let triangles = mesh.triangles.iter();
    out.triangles = triangles.map(|t| t.map(|v| numbers[v as usize])).collect();
    out
}

/// Number of loops that the border of a mesh is.
fn border_loops(mesh: &Mesh) -> usize {
    let mut sides = HashMap::new();
    for t in &mesh.triangles {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            *sides.entry((a.min(b), a.max(b))).or_insert(0) += 1;
        }
    }
    let mut sets = Sets::new(mesh.positions.len());
    let mut on_border = vec![false; mesh.positions.len()];
    for (&(a, b), _) in sides.iter().filter(|(_, n)| **n == 1) {
        sets.join(a, b);
        on_border[a as usize] = true;
        on_border[b as usize] = true;
    }
    sets.count() - on_border.iter().filter(|on| !**on).count()
}
