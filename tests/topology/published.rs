//! Against the reference of `tests/data/topology`, cell by cell and grid by grid.

use super::{border_loops, mesh, verdict, welded};
use crate::support::data::workspace;
use brickmarch::Inside;
use brickmarch::iso::Boundary;
use std::fs;

/// The numbers of a file, row by row, without its head.
fn rows(name: &str) -> Vec<Vec<i32>> {
    let path = workspace().join("tests/data/topology").join(name);
    let text = fs::read_to_string(&path).expect("kept with the tests");
    let number = |field: &str| field.trim().parse().expect("a whole number");
    text.lines()
        .skip(1)
        .map(|line| line.split(',').map(number).collect())
        .collect()
}

fn check_cells(name: &str, count: usize) {
    let rows = rows(name);
    assert_eq!(rows.len(), count, "{name}");
    for row in rows {
        let values: Vec<f32> = row[1..9].iter().map(|&v| v as f32).collect();
        let (components, euler, loops) = (row[9], row[10], row[11]);
        for inside in [Inside::Above, Inside::Below] {
            let found = mesh([2; 3], &values, 0.0, inside, Boundary::Cut);
            let v = verdict(&found);
            assert!(v.is_manifold(), "{row:?}: {v:?}");
            assert_eq!(
                (
                    v.components as i32,
                    v.euler as i32,
                    border_loops(&found) as i32
                ),
                (components, euler, loops),
                "{name} {row:?}"
            );
            assert_eq!(verdict(&welded(&found)), v, "{row:?}");
        }
    }
}

#[test]
fn random_cells_of_every_mask() {
    check_cells("random_cells.csv", 8 * 256);
}

#[test]
fn cells_with_tunnels() {
    check_cells("tunnel_cells.csv", 240);
}

#[test]
fn random_grids() {
    let rows = rows("random_grids_5x5x5.csv");
    assert_eq!(rows.len(), 399);
    for row in rows {
        let values: Vec<f32> = row[1..126].iter().map(|&v| v as f32).collect();
        for inside in [Inside::Above, Inside::Below] {
            let found = mesh([5; 3], &values, 0.0, inside, Boundary::Cut);
            let v = verdict(&found);
            assert!(v.is_manifold() && v.is_closed(), "{row:?}: {v:?}");
            assert_eq!((v.components as i32, v.euler as i32), (row[126], row[127]));
            assert_eq!(verdict(&welded(&found)), v);
        }
    }
}
