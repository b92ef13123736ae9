//! The programs of `tools/examples` run, say what is true, and stay short.

use crate::support::program::example;
use crate::support::scratch::Scratch;
use brickmarch::Budget;
use brickmarch_formats::read_mesh;
use std::path::Path;

const MOST_LINES: usize = 40;

#[test]
fn every_example_is_shorter_than_forty_lines() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tools/examples");
    let mut names = Vec::new();
    for entry in folder.read_dir().expect("there are examples") {
        let path = entry.expect("readable").path();
        let text = std::fs::read_to_string(&path).expect("text");
        let lines = text.lines().count();
        assert!(lines < MOST_LINES, "{}: {lines} lines", path.display());
        names.push(path.file_stem().expect("a name").to_owned());
    }
    names.sort();
    let all = [
        "edit_bricks",
        "import_scan",
        "mesh_formula",
        "probe",
        "stream_region",
    ];
    assert_eq!(names, all);
}

#[test]
fn examples_give_true_answers() {
    let scratch = Scratch::new("examples");
    let at = |name: &str| scratch.path(name);

    let said = example("mesh_formula", &[&at("gyroid.ply"), Path::new("48")]);
    let mesh = read_mesh(&at("gyroid.ply"), &Budget::mib(64)).expect("a mesh");
    let (triangles, vertices) = (mesh.triangles.len(), mesh.positions.len());
    assert!(triangles > 10_000, "{said}");
    assert!(
        said.ends_with(&format!("{triangles} triangles, {vertices} vertices\n")),
        "{said}"
    );

    // A ramp along x of 16 x 8 x 8 bytes.
    let ramp: Vec<u8> = (0..16 * 8 * 8).map(|i| 10 * (i % 16) as u8).collect();
    let header = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 16 8 8\nencoding: raw\n\n";
    std::fs::write(at("ramp.nrrd"), [header.as_bytes(), &ramp].concat()).expect("written");
    let (volume, iso) = (at("ramp.bvol"), Path::new("45"));
    let said = example(
        "import_scan",
        &[&at("ramp.nrrd"), &volume, &at("ramp.ply"), iso],
    );
    assert!(said.contains("for 1024 of samples"), "{said}");
    assert!(at("ramp.ply").exists());

    let said = example("probe", &[&volume, iso]);
    assert!(said.contains("[0.0, 18.75, 37.5, 56.25, 75.0, "), "{said}");
    assert!(said.contains("crosses 45 at [4.50000000"), "{said}");

    let numbers = ["2", "0", "0", "6", "8", "8"].map(Path::new);
    let args: Vec<&Path> = [&*volume].into_iter().chain(numbers).collect();
    let said = example("stream_region", &args);
    assert!(said.ends_with("mean 35\n"), "{said}");

    let said = example("edit_bricks", &[&at("edit.bvol")]);
    let mean = (0..32_768).map(|i| f64::from(i % 251)).sum::<f64>() / 32_768.0;
    assert!(
        said.contains(&format!("before: mean {mean:.3}\n")),
        "{said}"
    );
    assert!(said.ends_with("after: mean 200.000\n"), "{said}");
}
