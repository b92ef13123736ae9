//! OpenVDB as the external reference: the same voxels, the same number of crossed edges, the same
//! area and volume.

use crate::support::data::workspace;
use crate::support::program::{Run, brickmarch};
use crate::support::python::{has, python};
use crate::support::report::figure;
use crate::support::scratch::{Scratch, bytes};
use crate::support::topology::judge;
use brickmarch::field::Dense;
use brickmarch::iso::{Extract, extract};
use brickmarch::mesh::Collect;
use brickmarch::{Box3, Budget, Grid, Kind};
use std::ffi::OsStr;
use std::path::Path;

const MODULES: [&str; 2] = ["pyopenvdb", "numpy"];

fn reference(command: &str, args: &[&dyn AsRef<OsStr>]) -> Run {
    let script = workspace().join("tests/reference/openvdb/reference.py");
    let all = [script.as_os_str(), OsStr::new(command)];
    python(all.into_iter().chain(args.iter().map(|a| (*a).as_ref()))).success()
}

#[test]
fn closed_level_sets_have_the_same_surface() {
    if !has(&MODULES, "OpenVDB comparison of surfaces") {
        return;
    }
    let scratch = Scratch::new("openvdb-mesh");
    let (raw, vdb) = (scratch.path("field.raw"), scratch.path("field.vdb"));
    for (scene, n, euler) in [
        ("sphere", 128, Some(2)),
        ("torus", 128, Some(0)),
        ("gyroid", 160, None),
    ] {
        let size = n.to_string();
        reference("make", &[&scene, &size, &raw, &vdb]);
        let theirs = reference("mesh", &[&raw, &size]).json();
        let number = |key: &str| {
            theirs[key]
                .as_f64()
                .unwrap_or_else(|| panic!("{key} in {theirs}"))
        };

        let mut field =
            Dense::new(Grid::new(Box3::from_size([n; 3])), read_f32(&raw)).expect("n^3 values");
        field.kind = Kind::Distance;
        let mut sink = Collect::default();
        let budget = Budget::mib(64);
        let stats =
            extract(&field, &Extract::default(), &budget, &mut sink).expect("there is a surface");
        let mesh = sink.into_mesh();
        let ours = judge(&mesh.positions, &mesh.triangles);
        assert!(ours.is_closed() && ours.is_manifold(), "{scene}: {ours:?}");
        assert!(euler.is_none_or(|e| e == ours.euler), "{scene}: {ours:?}");

        let on_edges = stats.vertices - stats.interior_vertices;
        assert_eq!(
            on_edges as f64,
            number("quads"),
            "{scene}: our vertices, their quads"
        );
        assert_eq!(
            on_edges as f64,
            number("crossed_edges"),
            "{scene}: our vertices, crossed edges"
        );
        let off = |ours: f64, theirs: f64| (ours / theirs - 1.0).abs() * 100.0;
        let (area, volume) = (
            off(ours.area, number("area")),
            off(ours.volume, number("volume")),
        );
        figure(&format!(
            "OpenVDB {}: {scene} {n}^3: our vertices {on_edges} = their quads; area {:.1} and {:.1} ({area:.4} % \
             apart), volume {:.1} and {:.1} ({volume:.4} % apart)",
            theirs["version"].as_str().unwrap_or("?"),
            ours.area,
            number("area"),
            ours.volume,
            number("volume"),
        ));
        assert!(area < 0.1 && volume < 0.1, "{scene}: {ours:?} {theirs}");
    }
}

fn read_f32(path: &Path) -> Vec<f32> {
    bytes(path)
        .as_chunks::<4>()
        .0
        .iter()
        .map(|b| f32::from_le_bytes(*b))
        .collect()
}

/// raw -> our volume -> raw.
fn through_our_volume(raw: &Path, n: i32, scratch: &Scratch, name: &str) -> std::path::PathBuf {
    let volume = scratch.path(&format!("{name}.bvol"));
    let out = scratch.path(&format!("{name}.raw"));
    let dims = format!("{n},{n},{n}");
    let import = ["import".as_ref(), raw.as_os_str(), volume.as_os_str()];
    let layout = ["--dims", &dims, "--type", "f32", "--kind", "distance", "-q"].map(OsStr::new);
    brickmarch(import.into_iter().chain(layout)).success();
    brickmarch([
        "export".as_ref(),
        volume.as_os_str(),
        out.as_os_str(),
        "-q".as_ref(),
    ])
    .success();
    out
}

#[test]
fn voxel_values_are_equal_both_ways() {
    if !has(&MODULES, "OpenVDB comparison of voxels") {
        return;
    }
    let scratch = Scratch::new("openvdb-voxels");
    let mut voxels = 0;
    for (scene, n) in [("sphere", 100), ("torus", 64), ("gyroid", 77)] {
        let (raw, vdb) = (scratch.path("theirs.raw"), scratch.path("theirs.vdb"));
        let size = n.to_string();
        // Theirs, through our volume, is theirs.
        reference("make", &[&scene, &size, &raw, &vdb]);
        let ours = through_our_volume(&raw, n, &scratch, &format!("{scene}-in"));
        assert!(
            bytes(&ours) == bytes(&raw),
            "{scene}: import and export changed voxels"
        );
        let same = reference("same", &[&vdb, &ours, &size]).json();
        // Ours, through their grid and file, through our volume, is ours.
        let back = scratch.path("back.vdb");
        reference("load", &[&ours, &size, &back]);
        let again = through_our_volume(&ours, n, &scratch, &format!("{scene}-back"));
        reference("same", &[&back, &again, &size]);
        voxels += same["voxels"].as_u64().expect("a count");
    }
    figure(&format!(
        "OpenVDB: {voxels} voxels of 3 level sets equal bit for bit, both ways"
    ));
}
