//! Is a mesh one that the oracle's loops allow?

use crate::support::naive::{Key, Surface, ring_arcs};
use crate::support::topology::{Sets, judge};
use brickmarch::Mesh;
use brickmarch::mesh::EdgeKey;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Axis from which keys name a vertex inside a cell.
const INTERIOR: u8 = 3;

/// Checks everything that can differ between a mesh with keys, in index space, and the oracle:
/// vertices and their places bit for bit, the border of the patch in every cell including its
/// direction, that each loop bounds a disk or two a tunnel, and the topology of the whole.
#[track_caller]
pub(crate) fn assert_same_surface(mesh: &Mesh, want: &Surface, what: &str) {
    same_vertices(mesh, want, what);
    let patches = patches(mesh, what);
    let cells: BTreeSet<[i32; 3]> = patches.keys().copied().collect();
    assert!(
        cells.iter().eq(want.loops.keys()),
        "{what}: other cells have triangles"
    );
    for (cell, patch) in &patches {
        let loops = &want.loops[cell];
        let link = want.tunnels.get(cell);
        same_border(mesh, patch, loops, link, &format!("{what}: cell {cell:?}"));
    }
    let verdict = judge(&mesh.positions, &mesh.triangles);
    let shape = want.shape();
    assert!(verdict.is_manifold(), "{what}: {verdict:?}");
    assert_eq!(
        verdict.components, shape.components as u64,
        "{what}: components"
    );
    assert_eq!(verdict.euler, shape.euler, "{what}: Euler characteristic");
    assert_eq!(
        verdict.border_edges,
        shape.borders.iter().sum::<usize>() as u64,
        "{what}: border"
    );
}

fn same_vertices(mesh: &Mesh, want: &Surface, what: &str) {
    assert_eq!(mesh.keys.len(), mesh.positions.len(), "{what}: keys");
    let on_edges = mesh
        .keys
        .iter()
        .zip(&mesh.positions)
        .filter(|(k, _)| k.axis < INTERIOR);
    let mut got: BTreeMap<Key, [f32; 3]> = BTreeMap::new();
    for (k, &p) in on_edges {
        assert!(
            got.insert((k.point, k.axis), p).is_none(),
            "{what}: two vertices on {k:?}"
        );
    }
    for (key, place) in &want.vertices {
        let found = got
            .get(key)
            .unwrap_or_else(|| panic!("{what}: no vertex on {key:?}"));
        assert_eq!(
            found.map(f32::to_bits),
            place.map(f32::to_bits),
            "{what}: vertex {key:?}: {found:?} {place:?}"
        );
    }
    let extra = got.keys().find(|k| !want.vertices.contains_key(k));
    assert_eq!(extra, None, "{what}: a vertex where nothing is crossed");
}

/// Triangles by the cell that they lie in; none may lie in a face.
fn patches(mesh: &Mesh, what: &str) -> BTreeMap<[i32; 3], Vec<[u32; 3]>> {
    let mut patches: BTreeMap<[i32; 3], Vec<[u32; 3]>> = BTreeMap::new();
    for &t in &mesh.triangles {
        let [a, b, c] = t.map(|v| cells_of(&mesh.keys[v as usize]));
        let common: Vec<_> = a
            .into_iter()
            .filter(|p| b.contains(p) && c.contains(p))
            .collect();
        let [cell] = common[..] else {
            panic!(
                "{what}: triangle {:?} lies in cells {common:?}",
                t.map(|v| mesh.keys[v as usize])
            );
        };
        patches.entry(cell).or_default().push(t);
    }
    patches
}

fn cells_of(key: &EdgeKey) -> Vec<[i32; 3]> {
    if key.axis >= INTERIOR {
        return vec![key.point];
    }
    let others = [[1, 2], [0, 2], [0, 1]][usize::from(key.axis)];
    (0..4)
        .map(|i| {
            let mut p = key.point;
            p[others[0]] -= i & 1;
            p[others[1]] -= i >> 1;
            p
        })
        .collect()
}

/// The triangles of a cell have the loops as their border, run them in the same direction, and are
/// as many disks as there are loops; but two loops that are linked bound one tunnel.
fn same_border(
    mesh: &Mesh,
    patch: &[[u32; 3]],
    loops: &[Vec<Key>],
    link: Option<&[Key; 2]>,
    what: &str,
) {
    let mut directed: BTreeSet<(u32, u32)> = BTreeSet::new();
    for &[a, b, c] in patch {
        for edge in [(a, b), (b, c), (c, a)] {
            assert!(
                directed.insert(edge),
                "{what}: edge {edge:?} runs twice the same way"
            );
        }
    }
    let key = |v: u32| {
        let k = mesh.keys[v as usize];
        (k.point, k.axis)
    };
    let border = directed
        .iter()
        .filter(|&&(a, b)| !directed.contains(&(b, a)));
    let border: BTreeSet<(Key, Key)> = border.map(|&(a, b)| (key(a), key(b))).collect();
    let arcs: BTreeSet<(Key, Key)> = loops.iter().flat_map(|ring| ring_arcs(ring)).collect();
    assert_eq!(
        border, arcs,
        "{what}: the patch has another border than the loops"
    );

    let number: HashMap<u32, u32> = numbered(patch.iter().flatten().copied());
    let mut sets = Sets::new(number.len());
    directed
        .iter()
        .for_each(|(a, b)| sets.join(number[a], number[b]));
    let edges = directed
        .iter()
        .filter(|&&(a, b)| a < b || !directed.contains(&(b, a)))
        .count();
    let euler = number.len() as i64 - edges as i64 + patch.len() as i64;
    let tunnels = usize::from(link.is_some());
    assert_eq!(sets.count(), loops.len() - tunnels, "{what}: pieces");
    assert_eq!(
        euler,
        loops.len() as i64 - 2 * tunnels as i64,
        "{what}: not disks"
    );
    if let Some(ends) = link {
        let at = |end: &Key| number[number.keys().find(|&&v| key(v) == *end).expect("a vertex")];
        let [a, b] = [at(&ends[0]), at(&ends[1])].map(|v| sets.root(v));
        assert_eq!(a, b, "{what}: the tunnel joins other loops");
    }
}

fn numbered(items: impl Iterator<Item = u32>) -> HashMap<u32, u32> {
    let mut out = HashMap::new();
    for item in items {
        let next = out.len() as u32;
        out.entry(item).or_insert(next);
    }
    out
}
