//! `mesh --labels`: files per segment, one file of all, and what is refused.

use super::words;
use crate::support::data::shared;
use crate::support::program::{Run, brickmarch};
use crate::support::report::figure;
use crate::support::scratch::{Scratch, bytes};
use serde_json::Value;

/// Nested shells and a lone sample, 8 bits, of which 7 is everywhere else.
fn volume(name: &str) -> Scratch {
    let scratch = Scratch::new(name);
    let mut raw = Vec::new();
    for k in 0..21i32 {
        for j in 0..26i32 {
            for i in 0..40i32 {
                let far = |x: i32| (i - x).pow(2) + (j - 13).pow(2) + (k - 10).pow(2);
                raw.push(match (far(11), far(30)) {
                    _ if [i, j, k] == [20, 2, 3] => 200,
                    (a, _) if a < 16 => 1,
                    (a, _) if a < 70 => 2,
                    (_, b) if b < 60 => 3,
                    (a, b) if a.min(b) < 90 => 0,
                    _ => 7,
                });
            }
        }
    }
    scratch.write("v.raw", raw);
    run(
        &scratch,
        "import @v.raw @v.bvol --dims 40,26,21 --type u8 --kind label --brick 8 -q",
    )
    .success();
    scratch
}

fn run(scratch: &Scratch, line: &str) -> Run {
    brickmarch(words(scratch, line))
}

/// Meshes all labels into files of their own, and each of them alone, and compares.
fn compare(
    scratch: &Scratch,
    volume: &str,
    which: &str,
    ending: &str,
    more: &str,
) -> (usize, Value) {
    let line = format!(
        "mesh @{volume} @all-{{label}}.{ending} --labels {which} {more} --overwrite --measure --json -q --mem 64MiB"
    );
    let together = run(scratch, &line).success().json();
    let labels = together["labels"].as_array().expect("a list").clone();
    for entry in &labels {
        let label = &entry["label"];
        assert_eq!(entry["closed"], true, "{entry}");
        let line = format!(
            "mesh @{volume} @one.{ending} --label {label} {more} --overwrite --measure --json -q"
        );
        let alone = run(scratch, &line).success().json();
        for same in ["vertices", "triangles", "euler", "bytes_out"] {
            assert_eq!(entry[same], alone[same], "{label}: {same}");
        }
        // Sums over pieces, which are cut elsewhere.
        for near in ["area", "signed_volume"] {
            let [a, b] = [entry, &alone].map(|j| j[near].as_f64().expect("a number"));
            assert!((a / b - 1.0).abs() < 1e-9, "{label}: {near} {a} and {b}");
        }
        let [a, b] = [format!("all-{label}.{ending}"), format!("one.{ending}")]
            .map(|name| bytes(&scratch.path(&name)));
        assert!(a == b, "label {label}: other bytes");
    }
    (labels.len(), together)
}

#[test]
fn files_per_segment_have_the_bytes_of_the_segment_alone() {
    let scratch = volume("labels-apart");
    for (ending, more) in [
        ("ply", "--normals --keys"),
        ("obj", ""),
        ("stl", "--space index"),
        ("ply", "--normals --smooth quality --passes 2"),
    ] {
        let (count, _) = compare(&scratch, "v.bvol", "all", ending, more);
        assert_eq!(count, 5);
    }
    // Beside a picture, of a list with the background, smoothed.
    let line = "mesh @v.bvol @s-{label}.ply --labels 0,1,200 --label-smooth 2 --allow-empty \
                --picture @s.png --picture-size 80x60 --json -q";
    let json = run(&scratch, line).success().json();
    let entry = |n: usize| json["labels"][n]["triangles"].as_u64().expect("a count");
    assert!(entry(0) > 100 && entry(1) > 100, "{json}");
    // Two passes leave nothing of a lone sample.
    assert_eq!(entry(2), 0);
    assert!(scratch.path("s-200.ply").exists() && scratch.path("s.png").exists());
    run(&scratch, "check @s-1.ply -q").success();
}

#[test]
fn one_file_of_all_says_the_label_of_every_face() {
    let scratch = volume("labels-together");
    let line = "mesh @v.bvol @all.ply --labels all --json -q --threads 2";
    let json = run(&scratch, line).success().json();
    let ply = bytes(&scratch.path("all.ply"));
    let end = b"end_header\n";
    let header = ply
        .windows(end.len())
        .position(|w| w == end)
        .expect("a header")
        + end.len();
    let text = String::from_utf8_lossy(&ply[..header]).into_owned();
    assert!(text.contains("property uint label\n"), "{text}");
    let count = |key: &str| json[key].as_u64().expect("a count") as usize;
    let (vertices, faces) = (count("vertices"), count("triangles"));
    assert_eq!(ply.len(), header + 12 * vertices + 17 * faces);
    // Faces by label, and no vertex shared between two.
    let mut found: Vec<(u32, u64)> = Vec::new();
    let mut owner = vec![None; vertices];
    for face in ply[header + 12 * vertices..].chunks_exact(17) {
        let word = |at: usize| u32::from_le_bytes(face[at..at + 4].try_into().expect("4 bytes"));
        let label = word(13);
        match found.last_mut() {
            Some((last, n)) if *last == label => *n += 1,
            _ => found.push((label, 1)),
        }
        for corner in [1, 5, 9] {
            let owner = &mut owner[word(corner) as usize];
            assert_eq!(*owner.get_or_insert(label), label);
        }
    }
    let listed: Vec<(u32, u64)> = json["labels"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|e| {
            (
                e["label"].as_u64().expect("one") as u32,
                e["triangles"].as_u64().expect("some"),
            )
        })
        .collect();
    assert_eq!(found, listed);
    // What the labels are to other readers: a property to pass over.
    let check = run(&scratch, "check @all.ply --json -q").success().json();
    assert_eq!(check["report"]["triangles"], json["triangles"]);
    let mut parts = 0;
    for (label, _) in listed {
        run(
            &scratch,
            &format!("mesh @v.bvol @{label}.ply --label {label} -q"),
        )
        .success();
        let one = run(&scratch, &format!("check @{label}.ply --json -q"))
            .success()
            .json();
        parts += one["report"]["components"].as_u64().expect("a count");
    }
    assert!(parts > 5);
    assert_eq!(check["report"]["components"], parts);
}

#[test]
fn mistakes_with_labels_are_said_before_anything_is_written() {
    let scratch = volume("labels-wrong");
    scratch.write("f.raw", [0u8; 4 * 27]);
    scratch.write("n.raw", [0xffu8; 27]);
    let imports = [
        "import @f.raw @f.bvol --dims 3,3,3 --type f32 -q",
        "import @n.raw @n.bvol --dims 3,3,3 --type i8 --kind label -q",
    ];
    for line in imports {
        run(&scratch, line).success();
    }
    scratch.write("old-2.ply", "mine");
    let before = scratch.listing();
    for (line, code, said) in [
        ("mesh @v.bvol @a.obj --labels all", 1, "{label}"),
        (
            "mesh @v.bvol @{label}/a.ply --labels all",
            1,
            "name of a folder",
        ),
        (
            "mesh @v.bvol @none/{label}.ply --labels all",
            1,
            "there is no folder",
        ),
        (
            "mesh @v.bvol @{label}.xyz --labels all",
            1,
            "names no mesh format",
        ),
        (
            "mesh @v.bvol @old-{label}.ply --labels 1,2,3",
            1,
            "old-2.ply: exists already",
        ),
        (
            "mesh @v.bvol @{label}.ply --labels 1,5",
            1,
            "no surface of label 5",
        ),
        (
            "mesh @v.bvol @{label}.ply --labels 1,x",
            2,
            "segment numbers with commas",
        ),
        (
            "mesh @v.bvol @{label}.ply --labels all --label 3",
            2,
            "cannot be used with",
        ),
        (
            "mesh @v.bvol @{label}.ply --label 3 --label-smooth 1",
            2,
            "cannot be used with",
        ),
        (
            "mesh @v.bvol @{label}.ply --labels all --label-smooth 5",
            2,
            "5",
        ),
        ("mesh @f.bvol @{label}.ply --labels all", 1, "f32"),
        (
            "mesh @n.bvol @{label}.ply --labels all",
            1,
            "lowest sample is -1",
        ),
    ] {
        let run = run(&scratch, line);
        assert_eq!(run.code, Some(code), "{line}: {run:?}");
        assert!(run.stderr.contains(said), "{line}: {}", run.stderr);
        assert_eq!(scratch.listing(), before, "{line} leaves something");
    }
}

#[test]
#[cfg_attr(debug_assertions, ignore = "release only: real segmentations")]
fn real_segmentations_in_one_pass() {
    let em = "25024949,27949591,28792756,67324698";
    for (name, which) in [
        ("aal.nii.gz", "all"),
        ("frogtissue.mhd", "all"),
        ("em_labels_512_u32.nrrd", em),
    ] {
        let Some(source) = shared(&format!("volumes/{name}"), "labels of a real segmentation")
        else {
            continue;
        };
        let scratch = Scratch::new("labels-real");
        let import = format!("import {} @v.bvol --kind label -q", source.display());
        run(&scratch, &import).success();
        let (count, json) = compare(&scratch, "v.bvol", which, "ply", "");
        let info = run(&scratch, "info @v.bvol --json -q").success().json();
        // Every brick is decoded once at most, whatever the number of labels.
        let (decoded, stored) = (
            json["blocks_decoded"].as_u64(),
            info["volume"]["bricks_stored"].as_u64(),
        );
        assert!(decoded <= stored, "{name}: {decoded:?} of {stored:?}");
        figure(&format!(
            "{name} --labels {which}: {count} labels, {} triangles, {decoded:?} bricks decoded of {stored:?}, {} s, \
             every file equal to its label alone",
            json["triangles"], json["seconds"]
        ));
    }
}
