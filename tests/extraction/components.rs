//! Components kept while a mesh passes, against the same choice made in memory.

use super::{dense, mesh_of};
use crate::support::fields::{Content, random};
use crate::support::rng::Rng;
use brickmarch::iso::{Extract, extract};
use brickmarch::mesh::{Collect, Components, Kept, Layout, MeshSink, Totals, Which, feed};
use brickmarch::{Box3, Budget, ErrorKind, Mesh, Result};
use std::collections::BTreeMap;
use std::fs::File;

fn scratch() -> [File; 3] {
    [(); 3].map(|()| tempfile::tempfile().expect("a scratch file"))
}

/// The number of the component of each vertex: its lowest vertex, spread until nothing changes.
fn lowest(mesh: &Mesh) -> Vec<u32> {
    let mut lowest: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    loop {
        let mut changed = false;
        for t in &mesh.triangles {
            let least = t
                .map(|v| lowest[v as usize])
                .into_iter()
                .min()
                .expect("three");
            for v in t {
                changed |= lowest[*v as usize] != least;
                lowest[*v as usize] = least;
            }
        }
        if !changed {
            return lowest;
        }
    }
}

/// What should be kept of `mesh`, in plain words.
fn chosen(mesh: &Mesh, which: Which) -> (Mesh, u64, u64) {
    let lowest = lowest(mesh);
    let mut sizes: BTreeMap<u32, u64> = BTreeMap::new();
    for t in &mesh.triangles {
        *sizes.entry(lowest[t[0] as usize]).or_default() += 1;
    }
    let mut order: Vec<(u32, u64)> = sizes.into_iter().collect();
    // A stable sort keeps the lower vertex first among equals.
    order.sort_by_key(|&(_, size)| std::cmp::Reverse(size));
    let found = order.len() as u64;
    match which {
        Which::AtLeast(least) => order.retain(|&(_, size)| size >= least),
        Which::Largest(n) => {
            order = order.get(n as usize - 1).copied().into_iter().collect();
        }
    }
    let stays = |v: usize| order.iter().any(|&(part, _)| part == lowest[v]);
    let stays: Vec<bool> = (0..lowest.len()).map(stays).collect();
    let mut place = vec![u32::MAX; lowest.len()];
    let mut out = Mesh::default();
    for v in (0..lowest.len()).filter(|&v| stays[v]) {
        place[v] = out.positions.len() as u32;
        out.positions.push(mesh.positions[v]);
        out.normals.extend(mesh.normals.get(v));
        out.keys.extend(mesh.keys.get(v));
    }
    let kept = mesh.triangles.iter().filter(|t| stays[t[0] as usize]);
    out.triangles = kept.map(|t| t.map(|v| place[v as usize])).collect();
    (out, found, order.len() as u64)
}

/// Sends a mesh through the choice.
fn through(
    which: Which,
    budget: &Budget,
    send: impl FnOnce(&mut dyn MeshSink) -> Result<()>,
) -> Result<(Mesh, Kept)> {
    let mut collect = Collect::default();
    let mut components = Components::new(which, true, scratch(), budget, &mut collect)?;
    send(&mut components)?;
    let kept = components.kept();
    drop(components);
    let mesh = collect.into_mesh();
    let totals = Totals {
        vertices: mesh.positions.len() as u64,
        triangles: mesh.triangles.len() as u64,
    };
    assert_eq!(kept.totals, totals);
    Ok((mesh, kept))
}

const CHOICES: [Which; 6] = [
    Which::Largest(1),
    Which::Largest(2),
    Which::Largest(7),
    Which::AtLeast(1),
    Which::AtLeast(20),
    Which::AtLeast(1 << 40),
];

#[test]
fn what_is_kept_of_an_extraction_is_what_memory_keeps() {
    let mut rng = Rng::new(611);
    for round in 0..6 {
        let domain = Box3::new([-4, 0, 9], [45, 38, 51]);
        let content = rng.pick(&[Content::Noise, Content::Smooth, Content::Bytes]);
        let field = dense(
            domain,
            random(content, domain, &mut rng),
            rng.pick(&[8, 32]),
        );
        let options = Extract {
            // Away from the middle noise falls into many parts.
            iso: content.iso() + rng.pick(&[0.0, 0.3]),
            normals: true,
            keys: true,
            allow_empty: true,
            ..Extract::default()
        };
        let (mesh, _) = mesh_of(&field, &options, &Budget::mib(256)).expect("meshes");
        for which in CHOICES {
            let (want, found, stays) = chosen(&mesh, which);
            for threads in [1, 3] {
                let budget = Budget::mib(32).with_threads(threads);
                let (ours, kept) = through(which, &budget, |sink| {
                    extract(&field, &options, &budget, sink).map(|_| ())
                })
                .expect("fits");
                assert!(
                    ours == want,
                    "{round}: {content:?}, {which:?}, {threads} threads"
                );
                assert_eq!((kept.found, kept.kept), (found, stays));
                assert_eq!(budget.used_bytes(), 0);
            }
        }
    }
}

/// Shells, a strip that crosses them, lone triangles; and vertices that no triangle names.
fn mixed(rng: &mut Rng) -> Mesh {
    let mut mesh = Mesh::default();
    let count = 700;
    mesh.positions = (0..count).map(|i| [i as f32, 0.5, -1.0]).collect();
    for _ in 0..rng.pick(&[60, 150, 230]) {
        let corner = |rng: &mut Rng| rng.below(count) as u32;
        mesh.triangles.push([corner(rng), corner(rng), corner(rng)]);
    }
    mesh
}

/// Pieces in any order, which may use vertices of later ones.
#[test]
fn how_a_mesh_is_cut_does_not_show() {
    let mut rng = Rng::new(612);
    for _ in 0..20 {
        let mesh = mixed(&mut rng);
        for which in CHOICES {
            let (want, found, stays) = chosen(&mesh, which);
            for size in [1, 3, 50, usize::MAX] {
                let budget = Budget::mib(16);
                let (ours, kept) =
                    through(which, &budget, |sink| feed(&mesh, sink, size)).expect("fits");
                assert!(ours == want, "{which:?} by {size}");
                assert_eq!((kept.found, kept.kept), (found, stays));
                let (backwards, _) = through(which, &budget, |sink| {
                    sink.begin(Layout::default())?;
                    let pieces: Vec<_> = brickmarch::mesh::pieces(&mesh, size).collect();
                    pieces.iter().rev().try_for_each(|p| sink.write(p))?;
                    sink.finish(Totals {
                        vertices: mesh.positions.len() as u64,
                        triangles: mesh.triangles.len() as u64,
                    })
                })
                .expect("fits");
                assert!(backwards == want, "{which:?} by {size}, backwards");
            }
        }
    }
}

#[test]
fn too_many_parts_for_the_memory_and_none_at_all_are_said() {
    let mut rng = Rng::new(613);
    let domain = Box3::from_size([200, 200, 100]);
    // One sample in thirty: as many parts.
    let values: Vec<f32> = (0..domain.count())
        .map(|_| f32::from(u8::from(rng.chance(30))))
        .collect();
    let field = dense(domain, values, 32);
    let options = Extract {
        iso: 0.5,
        ..Extract::default()
    };
    let run = |budget: &Budget, which| {
        let mut count = brickmarch::mesh::Count::default();
        let mut sink = Components::new(which, false, scratch(), budget, &mut count)?;
        extract(&field, &options, budget, &mut sink)?;
        Ok::<_, brickmarch::Error>(sink.kept())
    };
    let kept = run(&Budget::mib(64).with_threads(1), Which::AtLeast(9)).expect("fits");
    assert!(
        kept.found > 50_000 && kept.kept > 1000 && kept.kept < kept.found,
        "{kept:?}"
    );
    let tight = Budget::mib(14).with_threads(1);
    let error = run(&tight, Which::Largest(1)).expect_err("too many");
    assert_eq!(error.kind(), ErrorKind::BudgetExceeded);
    let text = error.to_string();
    assert!(
        text.contains("components of pieces so far") && text.contains("--mem"),
        "{text}"
    );
    assert_eq!(tight.used_bytes(), 0);
    let error = run(&Budget::mib(64), Which::Largest(kept.found + 1)).expect_err("too few");
    assert_eq!(error.kind(), ErrorKind::EmptySurface);
    assert!(
        error
            .to_string()
            .contains(&format!("{} components", kept.found)),
        "{error}"
    );
}
