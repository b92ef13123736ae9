//! Pieces of neighbouring regions join by key into exactly the surface of a single run.

use super::{dense, mesh_of};
use crate::support::fields::{Content, random};
use crate::support::rng::Rng;
use brickmarch::field::Dense;
use brickmarch::iso::{Boundary, Extract};
use brickmarch::mesh::EdgeKey;
use brickmarch::{Box3, Budget, ErrorKind};
use std::collections::BTreeMap;

pub(super) type Places = BTreeMap<EdgeKey, [u32; 3]>;
pub(super) type Triangles = Vec<[EdgeKey; 3]>;

/// The mesh of a region by keys; triangles turned to begin at their least key, and sorted.
pub(super) fn keyed(field: &Dense, options: &Extract) -> (Places, Triangles) {
    let mesh = match mesh_of(field, options, &Budget::mib(64)) {
        Ok((mesh, _)) => mesh,
        Err(e) if e.kind() == ErrorKind::EmptySurface => return Default::default(),
        Err(e) => panic!("{e}"),
    };
    let places = mesh.keys.iter().zip(&mesh.positions);
    let places: Places = places.map(|(&k, p)| (k, p.map(f32::to_bits))).collect();
    assert_eq!(places.len(), mesh.keys.len(), "a key stands twice");
    let mut triangles: Triangles = mesh
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
    (places, triangles)
}

pub(super) fn join(pieces: impl IntoIterator<Item = (Places, Triangles)>) -> (Places, Triangles) {
    let mut all = (Places::new(), Triangles::new());
    for (places, triangles) in pieces {
        for (key, place) in places {
            let before = all.0.insert(key, place);
            assert!(before.is_none_or(|b| b == place), "{key:?} has two places");
        }
        all.1.extend(triangles);
    }
    all.1.sort_unstable();
    all
}

#[test]
fn halves_join_into_the_whole() {
    let mut rng = Rng::new(31);
    let domain = Box3::new([-3, 5, 0], [30, 40, 27]);
    for content in Content::ALL {
        let field = dense(
            domain,
            random(content, domain, &mut rng),
            rng.pick(&[8, 16]),
        );
        let options = |region, boundary| Extract {
            iso: content.iso(),
            region,
            boundary,
            ..Extract::default()
        };
        let whole = keyed(&field, &options(None, Boundary::Cap));
        assert!(!whole.1.is_empty(), "{content:?}");
        for axis in 0..3 {
            let at = rng.between(domain.min[axis] + 1, domain.max[axis]);
            let (mut low, mut high) = (domain, domain);
            low.max[axis] = at;
            high.min[axis] = at;
            let halves = [low, high].map(|r| keyed(&field, &options(Some(r), Boundary::Tile)));
            assert!(
                join(halves) == whole,
                "{content:?}: cut at {at} on axis {axis}"
            );
        }
    }
}

#[test]
fn eight_tiles_join_into_the_whole() {
    let mut rng = Rng::new(32);
    let domain = Box3::from_size([25, 20, 33]);
    let field = dense(domain, random(Content::Bytes, domain, &mut rng), 8);
    let options = |region, boundary| Extract {
        iso: Content::Bytes.iso(),
        region,
        boundary,
        ..Extract::default()
    };
    let whole = keyed(&field, &options(None, Boundary::Cap));
    let split = [7, 11, 16];
    let tiles = (0..8).map(|i| {
        let high = |a: usize| i >> a & 1 == 1;
        Box3::new(
            std::array::from_fn(|a| if high(a) { split[a] } else { domain.min[a] }),
            std::array::from_fn(|a| if high(a) { domain.max[a] } else { split[a] }),
        )
    });
    let joined = join(tiles.map(|tile| keyed(&field, &options(Some(tile), Boundary::Tile))));
    assert!(joined == whole);
}
