//! Parts against a mesh made at once, and damaged parts.

use brickmarch::field::{FromFn, Range};
use brickmarch::iso::{Boundary, Extract, Part, Stats, extract, extract_part, join_parts};
use brickmarch::mesh::Collect;
use brickmarch::{Box3, Budget, ErrorKind, Field, Grid, Kind, Mesh};
use std::io::Read;
use std::path::Path;

/// Waves along all axes, from a table.
fn field() -> impl Field {
    let grid = Grid::new(Box3::new([-3, 5, 0], [60, 52, 71]));
    let wave: Vec<f32> = (0..128).map(|i| (i as f32 * 0.31).sin()).collect();
    let value = move |p: [i32; 3]| {
        let at = |a: usize, shift: usize| wave[(p[a] + 8) as usize + shift];
        at(0, 0) * at(1, 5) + at(1, 0) * at(2, 5) + at(2, 0) * at(0, 5)
    };
    FromFn::new(grid, Kind::Density, value, |_| Range::UNKNOWN)
}

fn part(field: &dyn Field, options: &Extract, number: u32, of: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let name = Path::new("part");
    let part = Part { number, of };
    extract_part(field, options, part, &Budget::mib(64), &mut bytes, name).expect("a part");
    bytes
}

fn join(parts: &[Vec<u8>]) -> brickmarch::Result<(Mesh, Stats)> {
    let mut readers: Vec<&[u8]> = parts.iter().map(Vec::as_slice).collect();
    let mut named: Vec<(&Path, &mut dyn Read)> = readers
        .iter_mut()
        .map(|r| (Path::new("part"), r as &mut dyn Read))
        .collect();
    let mut sink = Collect::default();
    let stats = join_parts(&mut named, false, &Budget::mib(64), &mut sink)?;
    Ok((sink.into_mesh(), stats))
}

#[test]
fn parts_in_any_number_join_to_the_mesh() {
    let field = field();
    for (normals, keys, boundary, relax) in [
        (false, false, Boundary::Cap, 0),
        (true, true, Boundary::Cut, 0),
        (true, false, Boundary::Tile, 0),
        (true, false, Boundary::Cap, 1),
    ] {
        let options = Extract {
            iso: 0.1,
            normals,
            keys,
            boundary,
            relax,
            ..Extract::default()
        };
        let mut whole = Collect::default();
        let stats = extract(&field, &options, &Budget::mib(64), &mut whole).expect("a mesh");
        let whole = whole.into_mesh();
        for of in [1, 2, 7, if relax == 0 { 1000 } else { 13 }] {
            let parts: Vec<Vec<u8>> = (1..=of)
                .rev()
                .map(|n| part(&field, &options, n, of))
                .collect();
            let parts: Vec<Vec<u8>> = parts.into_iter().rev().collect();
            let (mesh, joined) = join(&parts).expect("joins");
            assert!(mesh == whole, "{of} parts");
            let counts = |s: Stats| {
                [
                    s.vertices,
                    s.triangles,
                    s.active_cells,
                    s.ambiguous_faces,
                    s.interior_vertices,
                    s.blocks_visited,
                ]
            };
            assert_eq!(counts(joined), counts(stats));
        }
    }
}

#[test]
fn wrong_and_damaged_parts_are_refused() {
    let field = field();
    let options = Extract {
        iso: 0.1,
        ..Extract::default()
    };
    let good: Vec<Vec<u8>> = (1..=3).map(|n| part(&field, &options, n, 3)).collect();
    assert!(join(&good).is_ok());
    let kind = |parts: &[Vec<u8>]| join(parts).expect_err("refused").kind();
    let [a, b, c] = [0, 1, 2].map(|n| good[n].clone());
    assert_eq!(kind(&[a.clone(), b.clone()]), ErrorKind::BadInput);
    assert_eq!(
        kind(&[a.clone(), c.clone(), b.clone()]),
        ErrorKind::BadInput
    );
    assert_eq!(
        kind(&[a.clone(), b.clone(), b.clone()]),
        ErrorKind::BadInput
    );
    assert_eq!(kind(&[]), ErrorKind::BadInput);
    let other = Extract {
        iso: 0.2,
        ..options.clone()
    };
    assert_eq!(
        kind(&[a.clone(), part(&field, &other, 2, 3), c.clone()]),
        ErrorKind::BadInput
    );
    for at in (0..b.len()).step_by(1 + b.len() / 300) {
        let mut flipped = b.clone();
        flipped[at] ^= 0x10;
        let found = kind(&[a.clone(), flipped, c.clone()]);
        assert!(
            matches!(found, ErrorKind::Damaged | ErrorKind::BadInput),
            "{at}: {found:?}"
        );
        let cut = b[..at].to_vec();
        assert_eq!(
            kind(&[a.clone(), cut, c.clone()]),
            ErrorKind::Damaged,
            "cut at {at}"
        );
    }
    let mut longer = b.clone();
    longer.push(0);
    assert_eq!(kind(&[a.clone(), longer, c.clone()]), ErrorKind::Damaged);

    let seeds = Extract {
        seeds: vec![[1, 6, 1]],
        ..options.clone()
    };
    for (options, number, of) in [(&options, 0, 3), (&options, 4, 3), (&seeds, 1, 3)] {
        let part = Part { number, of };
        let refused = extract_part(
            &field,
            options,
            part,
            &Budget::mib(64),
            &mut Vec::new(),
            Path::new("part"),
        );
        assert_eq!(refused.expect_err("refused").kind(), ErrorKind::BadInput);
    }
}
