//! `check`: shapes and crossings of triangles, and meshes that do not fit.

use super::words;
use crate::support::data::shared;
use crate::support::program::{Run, brickmarch};
use crate::support::report::figure;
use crate::support::scratch::{Scratch, bytes};
use serde_json::{Value, json};

fn run(scratch: &Scratch, line: &str) -> Run {
    brickmarch(words(scratch, line))
}

fn json(scratch: &Scratch, line: &str) -> Value {
    run(scratch, &format!("{line} --json -q")).success().json()
}

/// A tetrahedron of this edge at this place, as lines of OBJ.
fn tetrahedron(at: [f64; 3], edge: f64, first: usize) -> String {
    let mut text = String::new();
    for corner in [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
    ] {
        let [x, y, z] = [0, 1, 2].map(|a| at[a] + edge * corner[a]);
        text += &format!("v {x} {y} {z}\n");
    }
    for face in [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] {
        let [a, b, c] = face.map(|v| first + v);
        text += &format!("f {a} {b} {c}\n");
    }
    text
}

#[test]
fn known_shapes_and_crossings() {
    let scratch = Scratch::new("check-known");
    let two = |at| tetrahedron([0.0; 3], 1.0, 1) + &tetrahedron(at, 1.0, 5);
    // The corner at 0.2 on each axis goes through the slanted face, which goes through its three
    // faces; the faces of the first at x = 0 and so on stay outside.
    for (name, at, crossing, overlapping) in [
        ("apart", [2.0, 0.0, 0.0], 0, 0),
        ("through", [0.2, 0.2, 0.2], 3, 0),
        // Corner to corner: nothing is inside of both.
        ("touching", [1.0, 0.0, 0.0], 0, 0),
        // Two faces in each of two planes; that at x = 0.25 goes through the slanted one, and its
        // edges lie in the planes of the others.
        ("shifted", [0.25, 0.0, 0.0], 1, 2),
        ("equal", [0.0; 3], 0, 4),
    ] {
        scratch.write(&format!("{name}.obj"), two(at));
        let found = json(&scratch, &format!("check @{name}.obj --crossings all"));
        let crossings = &found["crossings"];
        assert_eq!(
            crossings["overlapping_pairs"], overlapping,
            "{name}: {crossings}"
        );
        assert_eq!(crossings["crossing_pairs"], crossing, "{name}: {crossings}");
        assert_eq!(crossings["checked_triangles"], 8, "{name}");
        let shapes = &found["shapes"];
        let angle = &shapes["min_angle_deg"];
        assert!(
            (angle["least"].as_f64().expect("a number") - 45.0).abs() < 1e-5,
            "{shapes}"
        );
        // Of every four triangles one is equilateral.
        assert!(angle["p95"].as_f64().expect("a number") > 59.9, "{shapes}");
        assert_eq!(shapes["slivers"], 0);
        assert_eq!(found["report"]["genus"], 0);
    }
    let text = run(&scratch, "check @through.obj").success().stdout;
    assert!(
        text.contains("3 crossing and 0 overlapping pairs"),
        "{text}"
    );
    let text = run(&scratch, "check @through.obj --crossings none")
        .success()
        .stdout;
    assert!(!text.contains("crossing"), "{text}");
    let run = run(&scratch, "check @through.obj --crossings some");
    assert_eq!(run.code, Some(2));
}

/// What must not depend on how the mesh was looked at.
fn answer(found: &Value) -> Value {
    json!([
        found["report"],
        found["shapes"],
        found["crossings"],
        found["sound"]
    ])
}

#[test]
fn a_mesh_beyond_the_memory_gets_the_same_answers() {
    let scratch = Scratch::new("check-parts");
    let mut raw = Vec::new();
    for k in 0..70u32 {
        for j in 0..80u32 {
            for i in 0..90u32 {
                // Bumps and noise: many parts, handles and holes at the border.
                let noise = (i * 73 + j * 151 + k * 283).wrapping_mul(2_654_435_761) >> 24;
                raw.push((noise / 4 + (i * j / 9 + k * 7) % 97) as u8);
            }
        }
    }
    scratch.write("v.raw", raw);
    run(
        &scratch,
        "import @v.raw @v.bvol --dims 90,80,70 --type u8 -q",
    )
    .success();
    for (name, more) in [
        ("a.ply", "--normals --keys"),
        ("cut.ply", "--boundary cut"),
        ("s.stl", ""),
    ] {
        run(
            &scratch,
            &format!("mesh @v.bvol @{name} --iso 70.5 {more} -q"),
        )
        .success();
    }
    let before = scratch.listing();
    for (name, more) in [("a.ply", ""), ("cut.ply", "--open-ok")] {
        for crossings in ["all", "none", "20000"] {
            let line = format!("check @{name} {more} --crossings {crossings}");
            let whole = json(&scratch, &line);
            assert_eq!(whole["in_parts"], false);
            let run = run(&scratch, &format!("{line} --mem 8MiB --json -q")).success();
            let parts = run.json();
            assert_eq!(parts["in_parts"], true, "{name}");
            assert_eq!(answer(&parts), answer(&whole), "{name} {crossings}");
            assert!(run.peak_bytes < (8 + 48) << 20, "{} bytes", run.peak_bytes);
            let bytes = bytes(&scratch.path(name)).len();
            assert!(bytes > 10 << 20, "{bytes} bytes fit");
        }
    }
    // Other formats say what they need.
    let stl = run(&scratch, "check @s.stl --mem 8MiB");
    assert_eq!(stl.code, Some(1));
    assert!(
        stl.stderr.contains("s.stl") && stl.stderr.contains("--mem"),
        "{}",
        stl.stderr
    );
    let nowhere = run(&scratch, "check @a.ply --mem 8MiB --scratch @none");
    assert_eq!(nowhere.code, Some(1));
    assert!(nowhere.stderr.contains("--scratch"), "{}", nowhere.stderr);
    // A face that names a vertex that is not there.
    let mut wreck = bytes(&scratch.path("cut.ply"));
    let end = wreck.len();
    wreck[end - 4..].copy_from_slice(&u32::MAX.to_le_bytes());
    scratch.write("wreck.ply", wreck);
    let lost = run(&scratch, "check @wreck.ply --mem 8MiB");
    assert_eq!(lost.code, Some(1));
    assert!(
        lost.stderr.contains("wreck.ply") && lost.stderr.contains("names vert"),
        "{}",
        lost.stderr
    );
    std::fs::remove_file(scratch.path("wreck.ply")).expect("there");
    assert_eq!(scratch.listing(), before, "something is left");
}

#[test]
#[cfg_attr(debug_assertions, ignore = "release only: real scans")]
fn real_scans_do_not_go_through_themselves() {
    for (name, kind, iso) in [
        ("ct_abdomen_crop128_i16.nrrd", "density", "200"),
        ("tooth.nhdr", "density", "600"),
        ("aal.nii.gz", "mask", "0.5"),
    ] {
        let Some(source) = shared(&format!("volumes/{name}"), "crossings of a scan") else {
            continue;
        };
        let scratch = Scratch::new("check-scan");
        run(
            &scratch,
            &format!("import {} @v.bvol --kind {kind} -q", source.display()),
        )
        .success();
        json(&scratch, &format!("mesh @v.bvol @m.ply --iso {iso}"));
        let found = json(&scratch, "check @m.ply --crossings all");
        let crossings = &found["crossings"];
        assert_eq!(
            crossings["checked_triangles"], found["report"]["triangles"],
            "{name}"
        );
        assert_eq!(crossings["crossing_pairs"], 0, "{name}");
        assert_eq!(crossings["overlapping_pairs"], 0, "{name}");
        assert_eq!(found["report"]["degenerate_triangles"], 0, "{name}");
        figure(&format!(
            "{name} at {iso}: {} triangles, 0 crossings, {} slivers, {} s",
            found["report"]["triangles"], found["shapes"]["slivers"], found["seconds"]
        ));
    }
}
