//! Same input, same output: whatever the threads and the memory.

use super::{dense, mesh_of};
use crate::support::fields::{Content, random, sphere};
use crate::support::rng::Rng;
use brickmarch::iso::Extract;
use brickmarch::{Box3, Budget, Mesh};

/// Positions, normals and triangles, for comparison bit for bit.
fn bits(mesh: &Mesh) -> [Vec<[u32; 3]>; 3] {
    let bits = |v: &[[f32; 3]]| v.iter().map(|p| p.map(f32::to_bits)).collect();
    [
        bits(&mesh.positions),
        bits(&mesh.normals),
        mesh.triangles.clone(),
    ]
}

#[test]
fn threads_and_memory_do_not_change_a_bit() {
    let n = if cfg!(debug_assertions) { 48 } else { 100 };
    let domain = Box3::from_size([n, n - 7, n + 5]);
    let mut rng = Rng::new(11);
    for content in [Content::Smooth, Content::Bytes] {
        let field = dense(domain, random(content, domain, &mut rng), 16);
        let options = Extract {
            iso: content.iso(),
            normals: true,
            ..Extract::default()
        };
        let run = |mib, threads| {
            let budget = Budget::mib(mib).with_threads(threads);
            let (mesh, stats) = mesh_of(&field, &options, &budget).expect("there is a surface");
            assert!(budget.peak_bytes() <= mib << 20);
            (bits(&mesh), mesh.keys.clone(), stats)
        };
        let first = run(1024, 1);
        for (mib, threads) in [(1024, 2), (1024, 8), (24, 1), (24, 8)] {
            let other = run(mib, threads);
            assert!(
                first.0 == other.0 && first.1 == other.1,
                "{content:?}: {threads} threads, {mib} MiB"
            );
            assert_eq!(first.2.triangles, other.2.triangles);
        }
    }
}

#[test]
fn a_cancelled_run_stops_with_an_error() {
    let domain = Box3::from_size([40; 3]);
    let field = dense(domain, sphere(domain, [20.0; 3], 15.0), 8);
    let budget = Budget::mib(64);
    budget.cancel_token().cancel();
    let error = mesh_of(&field, &Extract::default(), &budget).expect_err("it was cancelled");
    assert_eq!(error.kind(), brickmarch::ErrorKind::Cancelled, "{error}");
}
