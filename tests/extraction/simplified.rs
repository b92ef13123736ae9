//! Simplification: sound, of the same topology, near, and the same from any budget and pieces.

use super::{dense, mesh_of};
use crate::support::fields::{Content, random, sampled, sphere};
use crate::support::report::figure;
use crate::support::rng::{Rng, rounds};
use brickmarch::field::Dense;
use brickmarch::iso::{Boundary, Extract, extract};
use brickmarch::mesh::{Collect, Goal, Report, Simplification, Simplified, Simplify, check};
use brickmarch::{Box3, Budget, ErrorKind, Inside, Kind, Mesh, Result};

fn simplified(
    field: &Dense,
    options: &Extract,
    goal: Goal,
    budget: &Budget,
) -> Result<(Mesh, Simplification)> {
    let how = Simplify {
        goal,
        cube: 12.0,
        corner: [3.37; 3],
    };
    let file = || tempfile::tempfile().expect("a scratch file");
    let mut mesh = Collect::default();
    let mut sink = Simplified::new(how, [file(), file()], budget, &mut mesh)?;
    extract(field, options, budget, &mut sink)?;
    let done = sink.result();
    Ok((mesh.into_mesh(), done))
}

fn report(mesh: &Mesh) -> Report {
    check(mesh, &Budget::mib(256)).expect("checked")
}

/// The topology, and where the border is.
fn topology(r: &Report) -> (i64, [u64; 5], Option<u64>) {
    let counts = [
        r.components,
        r.border_edges,
        r.nonmanifold_edges,
        r.nonmanifold_vertices,
        r.misoriented_edges,
    ];
    (r.euler, counts, r.genus)
}

/// The distance of a point from the nearest of `points`, by brute force.
fn nearest(p: [f32; 3], points: &[[f32; 3]]) -> f64 {
    let square = |q: &[f32; 3]| -> f64 {
        (0..3)
            .map(|a| (f64::from(p[a]) - f64::from(q[a])).powi(2))
            .sum()
    };
    points
        .iter()
        .map(square)
        .fold(f64::INFINITY, f64::min)
        .sqrt()
}

#[test]
fn random_fields_keep_their_topology() {
    let mut rng = Rng::new(91);
    // A round takes seconds.
    for round in 0..rounds(2).min(60) {
        let size = [0, 1, 2].map(|_| rng.between(9, 25));
        let domain = Box3::from_size(size);
        for content in [Content::Smooth, Content::Noise, Content::Bytes] {
            let field = dense(domain, random(content, domain, &mut rng), 8);
            let options = Extract {
                iso: content.iso(),
                inside: Some(Inside::Above),
                index_space: true,
                boundary: if round % 3 == 0 {
                    Boundary::Cut
                } else {
                    Boundary::Cap
                },
                allow_empty: true,
                ..Extract::default()
            };
            let budget = Budget::mib(256);
            let (plain, _) = mesh_of(&field, &options, &budget).expect("meshed");
            let before = report(&plain);
            for goal in [Goal::Ratio(0.05), Goal::Error(0.3)] {
                let what = format!("{content:?} {size:?} {goal:?}");
                let (mesh, done) = simplified(&field, &options, goal, &budget).expect("simplified");
                let after = report(&mesh);
                assert_eq!(topology(&after), topology(&before), "{what}");
                assert_eq!(after.degenerate_triangles, 0, "{what}");
                assert_eq!(after.unused_vertices, 0, "{what}");
                assert_eq!(done.before.triangles, before.triangles, "{what}");
                assert_eq!(done.after.triangles, after.triangles, "{what}");
                if let Goal::Error(e) = goal {
                    assert!(done.distance <= e, "{what}: {}", done.distance);
                }
            }
        }
    }
}

/// What is promised is measured another way: against a formula.
#[test]
fn a_sphere_stays_within_the_error() {
    let domain = Box3::from_size([90; 3]);
    let (centre, radius) = ([44.3, 44.9, 45.2], 40.0);
    let mut field = dense(domain, sphere(domain, centre, radius), 16);
    field.kind = Kind::Distance;
    let options = Extract {
        index_space: true,
        normals: true,
        keys: true,
        ..Extract::default()
    };
    let (plain, _) = mesh_of(&field, &options, &Budget::mib(256)).expect("meshed");
    for (error, most) in [(0.02, 0.6), (0.1, 0.3), (0.5, 0.1)] {
        let goal = Goal::Error(error);
        let (mesh, done) =
            simplified(&field, &options, goal, &Budget::mib(256)).expect("simplified");
        assert!(report(&mesh).is_sound() && report(&mesh).genus == Some(0));
        // Vertices are some of those that were, with their keys and normals.
        let mut keys: Vec<_> = plain.keys.iter().zip(&plain.positions).collect();
        keys.sort_unstable_by_key(|k| k.0);
        for ((key, p), n) in mesh.keys.iter().zip(&mesh.positions).zip(&mesh.normals) {
            let at = keys.binary_search_by_key(&key, |k| k.0).expect("was there");
            assert_eq!(keys[at].1, p);
            let out: f64 = (0..3)
                .map(|a| f64::from(n[a]) * (f64::from(p[a]) - centre[a]) / radius)
                .sum();
            assert!(out > 0.999);
        }
        // The sphere bulges out of a triangle most in its middle; the interpolant is 0.01 off.
        let mut worst = 0.0f64;
        for t in &mesh.triangles {
            let middle: [f64; 3] = std::array::from_fn(|a| {
                t.iter()
                    .map(|&v| f64::from(mesh.positions[v as usize][a]))
                    .sum::<f64>()
                    / 3.0
            });
            let r = (0..3)
                .map(|a| (middle[a] - centre[a]).powi(2))
                .sum::<f64>()
                .sqrt();
            worst = worst.max((r - radius).abs());
        }
        figure(&format!(
            "sphere 90 within {error}: {} of {} triangles, {:.4} measured, {worst:.4} in the middles",
            done.after.triangles, done.before.triangles, done.distance
        ));
        assert!(done.distance <= error && worst <= error + 0.01, "{worst}");
        assert!((done.after.triangles as f64) < most * done.before.triangles as f64);
    }
}

/// A box with faces off the lattice, as CAD makes it: planes go, edges and corners stay.
#[test]
fn planes_collapse_and_corners_stay() {
    let domain = Box3::from_size([72; 3]);
    let low = [6.3, 7.7, 8.2];
    let high = [64.6, 63.1, 62.4];
    let values = sampled(domain, |p| {
        (0..3)
            .map(|a| (low[a] - p[a]).max(p[a] - high[a]))
            .fold(f64::NEG_INFINITY, f64::max)
    });
    let mut field = dense(domain, values, 16);
    field.kind = Kind::Distance;
    let options = Extract {
        index_space: true,
        ..Extract::default()
    };
    let budget = Budget::mib(256);
    let (mesh, done) = simplified(&field, &options, Goal::Error(0.1), &budget).expect("simplified");
    let (before, after) = (done.before.triangles, done.after.triangles);
    figure(&format!("box 72 within 0.1: {after} of {before} triangles"));
    assert!(report(&mesh).is_sound() && report(&mesh).genus == Some(0));
    assert!(after * 20 < before, "{after} of {before}");
    let (plain, _) = mesh_of(&field, &options, &budget).expect("meshed");
    for corner in 0..8 {
        let p = std::array::from_fn(|a| {
            (if corner >> a & 1 == 0 {
                low[a]
            } else {
                high[a]
            }) as f32
        });
        let was = nearest(p, &plain.positions);
        assert!(nearest(p, &mesh.positions) < was + 1.0, "{p:?}");
    }
}

#[test]
fn threads_and_memory_do_not_change_a_byte() {
    let mut rng = Rng::new(92);
    let domain = Box3::from_size([44, 36, 30]);
    let field = dense(domain, random(Content::Smooth, domain, &mut rng), 8);
    let options = Extract {
        index_space: true,
        normals: true,
        relax: 1,
        ..Extract::default()
    };
    for goal in [Goal::Ratio(0.1), Goal::Error(0.05)] {
        let one = Budget::mib(512).with_threads(1);
        let first = simplified(&field, &options, goal, &one).expect("simplified");
        for (mib, threads) in [(512, 4), (128, 2)] {
            let budget = Budget::mib(mib).with_threads(threads);
            let other = simplified(&field, &options, goal, &budget).expect("simplified");
            assert!(other == first, "{goal:?}: {mib} MiB, {threads} threads");
            assert!(budget.peak_bytes() <= budget.memory_bytes());
        }
    }
}

#[test]
fn goals_that_are_none_and_too_little_memory_are_said() {
    let domain = Box3::from_size([40; 3]);
    let field = dense(
        domain,
        random(Content::Noise, domain, &mut Rng::new(93)),
        16,
    );
    let options = Extract::default();
    for goal in [
        Goal::Error(0.0),
        Goal::Error(f64::NAN),
        Goal::Error(f64::INFINITY),
        Goal::Ratio(0.0),
        Goal::Ratio(1.0),
        Goal::Ratio(f64::NAN),
    ] {
        let error = simplified(&field, &options, goal, &Budget::mib(64)).expect_err("no goal");
        assert_eq!(error.kind(), ErrorKind::BadInput, "{goal:?}");
    }
    let tight = Budget::mib(24).with_threads(1);
    let error = simplified(&field, &options, Goal::Ratio(0.5), &tight).expect_err("dense noise");
    assert_eq!(error.kind(), ErrorKind::BudgetExceeded);
    assert!(error.to_string().contains("--mem"), "{error}");
}
