//! Against the reference of `tests/data/topology`, cell by cell and grid by grid.

use super::{border_loops, mesh, verdict, welded};
use crate::support::crossing::crossing_pairs;
use crate::support::data::{shared, workspace};
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

/// Cells of other projects, with saddles and corners at the isovalue among them: those that have one
/// answer get it, and all are surfaces.
#[test]
fn cells_that_others_found_hard() {
    let Some(path) = shared("topology/cells.json", "published cells") else {
        return;
    };
    let text = fs::read_to_string(path).expect("readable");
    let all: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let cells = all["cells"].as_array().expect("a list");
    let numbers = |list: &serde_json::Value| -> Vec<f32> {
        let list = list.as_array().expect("a list").iter();
        list.map(|v| v.as_f64().expect("a number") as f32).collect()
    };
    let mut judged = 0;
    for cell in cells {
        let (values, name) = (numbers(&cell["values"]), &cell["name"]);
        let iso = cell["iso"].as_f64().expect("a number") as f32;
        for inside in [Inside::Above, Inside::Below] {
            let found = mesh([2; 3], &values, iso, inside, Boundary::Cut);
            let v = verdict(&found);
            assert!(v.is_manifold(), "{name}: {v:?}");
            assert_eq!(verdict(&welded(&found)), v, "{name}");
            assert_eq!(
                crossing_pairs(&found.positions, &found.triangles),
                0,
                "{name}"
            );
            if let Some(truth) = cell["truth"].as_object() {
                judged += 1;
                assert_eq!(truth["components"].as_u64(), Some(v.components), "{name}");
                assert_eq!(truth["euler"].as_i64(), Some(v.euler), "{name}");
                let loops = border_loops(&found) as u64;
                assert_eq!(truth["boundary_loops"].as_u64(), Some(loops), "{name}");
            }
        }
    }
    assert!(judged >= 40, "{judged}");
    // Two cells with a face between them that is, or nearly is, singular.
    for pair in all["pairs"].as_array().expect("a list") {
        let (a, b) = (numbers(&pair["a"]), numbers(&pair["b"]));
        let shift = numbers(&pair["shift"]);
        let axis = shift.iter().position(|&v| v == 1.0).expect("a shift");
        let iso = pair["iso"].as_f64().expect("a number") as f32;
        let mut size = [2; 3];
        size[axis] = 3;
        let mut values = vec![0.0; 12];
        for c in 0..8 {
            let at = |along: usize| -> usize {
                let p = |k: usize| (c >> k & 1) + if k == axis { along } else { 0 };
                let row = size[0] as usize;
                p(0) + row * (p(1) + size[1] as usize * p(2))
            };
            values[at(1)] = b[c];
            values[at(0)] = a[c];
        }
        for inside in [Inside::Above, Inside::Below] {
            let found = mesh(size, &values, iso, inside, Boundary::Cap);
            let v = verdict(&found);
            assert!(v.is_manifold() && v.is_closed(), "{pair}: {v:?}");
            assert_eq!(verdict(&welded(&found)), v, "{pair}");
        }
    }
}
