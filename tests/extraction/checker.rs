//! The engine's own mesh checker against the independent judgement, on good meshes and on wrecks.

use super::{dense, mesh_of};
use crate::support::fields::{Content, random};
use crate::support::rng::Rng;
use crate::support::topology::judge;
use brickmarch::iso::{Boundary, Extract};
use brickmarch::mesh::check;
use brickmarch::{Box3, Budget, Mesh};

#[track_caller]
fn assert_agree(mesh: &Mesh, what: &str) {
    let ours = check(mesh, &Budget::mib(64).with_threads(2)).expect("fits");
    let judged = judge(&mesh.positions, &mesh.triangles);
    let close = |a: f64, b: f64| (a - b).abs() <= 1e-9 * (1.0 + a.abs().max(b.abs()));
    assert_eq!(ours.vertices, judged.vertices, "{what}");
    assert_eq!(ours.triangles, judged.triangles, "{what}");
    assert_eq!(ours.border_edges, judged.border_edges, "{what}");
    assert_eq!(ours.closed, judged.is_closed(), "{what}");
    assert_eq!(ours.nonmanifold_edges, judged.nonmanifold_edges, "{what}");
    assert_eq!(ours.misoriented_edges, judged.misoriented_edges, "{what}");
    assert_eq!(
        ours.nonmanifold_vertices, judged.nonmanifold_vertices,
        "{what}"
    );
    assert_eq!(ours.degenerate_triangles, judged.degenerate, "{what}");
    assert_eq!(ours.unused_vertices, judged.unused_vertices, "{what}");
    assert_eq!(ours.components, judged.components, "{what}");
    assert_eq!(ours.euler, judged.euler, "{what}");
    assert!(
        close(ours.area, judged.area),
        "{what}: area {} {}",
        ours.area,
        judged.area
    );
    assert!(
        close(ours.volume, judged.volume),
        "{what}: volume {} {}",
        ours.volume,
        judged.volume
    );
}

#[test]
fn the_checker_agrees_with_an_independent_one() {
    let mut rng = Rng::new(61);
    let rounds = if cfg!(debug_assertions) { 2 } else { 10 };
    for round in 0..rounds {
        for content in Content::ALL {
            let domain = Box3::from_size([9, 12, 8]);
            let field = dense(domain, random(content, domain, &mut rng), 8);
            let options = Extract {
                iso: content.iso(),
                boundary: rng.pick(&[Boundary::Cap, Boundary::Cut]),
                ..Extract::default()
            };
            let (good, _) =
                mesh_of(&field, &options, &Budget::mib(64)).expect("there is a surface");
            let what = format!("round {round}, {content:?}");
            assert_agree(&good, &what);
            for _ in 0..6 {
                let mut wreck = good.clone();
                let kind = ruin(&mut wreck, &mut rng);
                assert_agree(&wreck, &format!("{what}, {kind}"));
            }
        }
    }
}

/// Breaks a mesh in one of the ways in which meshes break.
fn ruin(mesh: &mut Mesh, rng: &mut Rng) -> &'static str {
    let n = mesh.triangles.len() as u64;
    let t = rng.below(n) as usize;
    match rng.below(6) {
        0 => {
            mesh.triangles.swap_remove(t);
            "a triangle missing"
        }
        1 => {
            mesh.triangles[t].swap(0, 1);
            "a triangle turned"
        }
        2 => {
            mesh.triangles.push(mesh.triangles[t]);
            "a triangle twice"
        }
        3 => {
            let other = rng.below(n) as usize;
            let (from, to) = (mesh.triangles[t][0], mesh.triangles[other][0]);
            mesh.triangles
                .iter_mut()
                .flatten()
                .filter(|v| **v == from)
                .for_each(|v| *v = to);
            "two vertices joined"
        }
        4 => {
            let [a, b, _] = mesh.triangles[t];
            mesh.positions[a as usize] = mesh.positions[b as usize];
            "a vertex moved onto another"
        }
        _ => {
            let gone = (n / 2).max(1) as usize;
            for _ in 0..gone {
                let t = rng.below(mesh.triangles.len() as u64) as usize;
                mesh.triangles.swap_remove(t);
            }
            "half of the triangles missing"
        }
    }
}
