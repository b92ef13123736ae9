//! The engine's meshes against dense marching cubes without tables.

use super::compare::assert_same_surface;
use super::{dense, mesh_of};
use crate::support::fields::{Content, random};
use crate::support::naive::Question;
use crate::support::rng::{Rng, rounds};
use crate::support::topology::judge;
use brickmarch::iso::{Boundary, Extract};
use brickmarch::{Box3, Budget, ErrorKind, Inside};

/// One random case: the engine against the oracle, on either side and with either border.
fn compare_one(content: Content, domain: Box3, edge: u32, rng: &mut Rng) {
    let values = random(content, domain, rng);
    let inside = rng.pick(&[Inside::Above, Inside::Below]);
    let boundary = rng.pick(&[Boundary::Cap, Boundary::Cut]);
    let iso = content.iso();
    let what = format!("{content:?} {domain} blocks of {edge} {inside:?} {boundary:?}");
    let question = Question {
        values: &values,
        domain,
        iso,
        inside,
        cap: boundary == Boundary::Cap,
    };
    let want = question.march();
    let options = Extract {
        iso,
        inside: Some(inside),
        boundary,
        index_space: true,
        ..Extract::default()
    };
    let field = dense(domain, values.clone(), edge);
    let budget = Budget::mib(64).with_threads(2);
    match mesh_of(&field, &options, &budget) {
        Ok((mesh, stats)) => {
            assert_same_surface(&mesh, &want, &what);
            if boundary == Boundary::Cap {
                let verdict = judge(&mesh.positions, &mesh.triangles);
                assert!(
                    verdict.is_closed() && verdict.volume > 0.0,
                    "{what}: {verdict:?}"
                );
            }
            assert_eq!(stats.active_cells, want.loops.len() as u64, "{what}");
            assert_eq!(stats.ambiguous_faces, want.ambiguous_faces, "{what}");
        }
        Err(error) => {
            assert_eq!(error.kind(), ErrorKind::EmptySurface, "{what}: {error}");
            assert!(want.vertices.is_empty(), "{what}: {error}");
        }
    }
    assert_eq!(budget.used_bytes(), 0, "{what}: permits were not returned");
}

/// A box of random place and size, sometimes only one sample thick.
fn random_box(rng: &mut Rng, most: i32) -> Box3 {
    let min: [i32; 3] = std::array::from_fn(|_| rng.between(-70, 70));
    let max = min.map(|m| {
        m + if rng.chance(8) {
            1
        } else {
            rng.between(2, most + 1)
        }
    });
    Box3::new(min, max)
}

#[test]
fn random_fields_agree_with_the_oracle() {
    let rounds = rounds(if cfg!(debug_assertions) { 6 } else { 60 });
    let mut rng = Rng::new(20_251);
    for _ in 0..rounds {
        for content in Content::ALL {
            let domain = random_box(&mut rng, 20);
            compare_one(content, domain, rng.pick(&[8, 16, 32]), &mut rng);
        }
    }
}

#[test]
fn every_size_up_to_a_few_samples_agrees() {
    let mut rng = Rng::new(77);
    let most = if cfg!(debug_assertions) { 3 } else { 5 };
    for size in
        (0..most * most * most).map(|n| [n % most + 1, n / most % most + 1, n / most / most + 1])
    {
        for content in Content::ALL {
            compare_one(content, Box3::from_size(size), 8, &mut rng);
        }
    }
}

#[test]
#[cfg_attr(debug_assertions, ignore = "release only: large")]
fn fields_of_many_blocks_agree_with_the_oracle() {
    let mut rng = Rng::new(5);
    for (content, size, edge) in [
        (Content::Noise, [67, 35, 41], 8),
        (Content::Noise, [35, 41, 67], 32),
        (Content::Smooth, [130, 33, 64], 16),
        (Content::Bytes, [65, 66, 31], 32),
        (Content::Infinite, [33, 65, 34], 16),
    ] {
        compare_one(content, Box3::from_size(size), edge, &mut rng);
    }
}

#[test]
fn block_edges_do_not_change_the_mesh() {
    let mut rng = Rng::new(9);
    let domain = Box3::new([-5, 3, -40], [36, 40, 1]);
    for content in [Content::Smooth, Content::Bytes, Content::Nan] {
        let values = random(content, domain, &mut rng);
        let options = Extract {
            iso: content.iso(),
            index_space: true,
            ..Extract::default()
        };
        let sorted = |edge| {
            let field = dense(domain, values.clone(), edge);
            let (mesh, _) =
                mesh_of(&field, &options, &Budget::mib(64)).expect("there is a surface");
            // The order follows the blocks; the surface does not.
            let mut triangles: Vec<_> = mesh
                .triangles
                .iter()
                .map(|t| {
                    let mut keys = t.map(|v| mesh.keys[v as usize]);
                    let least = (0..3).min_by_key(|&i| keys[i]).expect("three corners");
                    keys.rotate_left(least);
                    keys
                })
                .collect();
            triangles.sort_unstable();
            triangles
        };
        let first = sorted(8);
        assert_eq!(first, sorted(16), "{content:?}");
        assert_eq!(first, sorted(32), "{content:?}");
    }
}
