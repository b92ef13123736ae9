//! `mesh --component` and `--min-triangles`.

use super::words;
use crate::support::data::shared;
use crate::support::program::{Run, brickmarch};
use crate::support::report::figure;
use crate::support::scratch::{Scratch, bytes, f32_bytes};
use serde_json::Value;

fn run(scratch: &Scratch, line: &str) -> Run {
    brickmarch(words(scratch, line))
}

fn json(scratch: &Scratch, line: &str) -> Value {
    run(scratch, &format!("{line} --json -q")).success().json()
}

/// Balls of radius 9.2, 6.1 and 3.3, the smallest first along x, inside where negative.
fn balls() -> Scratch {
    let scratch = Scratch::new("components");
    let mut values = Vec::new();
    for k in 0..24u8 {
        for j in 0..24u8 {
            for i in 0..60u8 {
                let [x, y, z] = [i, j, k].map(f32::from);
                let ball = |c: f32, r: f32| {
                    ((x - c).powi(2) + (y - 12.0).powi(2) + (z - 12.0).powi(2)).sqrt() - r
                };
                values.push(ball(6.0, 3.3).min(ball(21.0, 6.1)).min(ball(44.0, 9.2)));
            }
        }
    }
    scratch.write("v.raw", f32_bytes(&values));
    let import = "import @v.raw @v.bvol --dims 60,24,24 --type f32 --kind distance --brick 8 -q";
    run(&scratch, import).success();
    scratch
}

#[test]
fn balls_come_by_size() {
    let scratch = balls();
    let volume = |r: f64| 4.0 / 3.0 * std::f64::consts::PI * r.powi(3);
    for (which, radii) in [
        ("--component largest", vec![9.2f64]),
        ("--component 1", vec![9.2]),
        ("--component 2", vec![6.1]),
        ("--component 3", vec![3.3]),
        ("--min-triangles 1", vec![3.3, 6.1, 9.2]),
        ("--min-triangles 800", vec![6.1, 9.2]),
    ] {
        let line = format!("mesh @v.bvol @m.ply {which} --overwrite --measure --normals --keys");
        let made = json(&scratch, &line);
        assert_eq!(made["components_found"], 3, "{which}");
        assert_eq!(made["components_kept"], radii.len(), "{which}");
        let check = json(&scratch, "check @m.ply");
        let report = &check["report"];
        assert_eq!(report["components"], radii.len(), "{which}");
        assert_eq!(report["unused_vertices"], 0, "{which}");
        for same in ["vertices", "triangles"] {
            assert_eq!(report[same], made[same], "{which}: {same}");
        }
        // Flat triangles lie inside of a ball by about a half of a squared edge over its radius.
        let near = 0.7 / radii[0].powi(2);
        let want: f64 = radii.into_iter().map(volume).sum();
        for ours in [&report["volume"], &made["signed_volume"]] {
            let ours = ours.as_f64().expect("a number");
            assert!(
                (ours / want - 1.0).abs() < near,
                "{which}: {ours}, not {want}"
            );
        }
    }
    // All of them is what no choice gives.
    json(&scratch, "mesh @v.bvol @all.ply --normals --keys");
    json(
        &scratch,
        "mesh @v.bvol @kept.ply --normals --keys --min-triangles 0",
    );
    assert!(bytes(&scratch.path("all.ply")) == bytes(&scratch.path("kept.ply")));
    // The same through a seed.
    json(&scratch, "mesh @v.bvol @one.ply --component 2");
    json(&scratch, "mesh @v.bvol @seed.ply --seed 27,12,12");
    let report = |name: &str| json(&scratch, &format!("check @{name}"))["report"].clone();
    let [one, seed] = ["one.ply", "seed.ply"].map(report);
    assert_eq!(one["triangles"], seed["triangles"]);
    assert_eq!(one["bounds"], seed["bounds"]);
}

#[test]
fn a_component_that_is_not_there_is_said() {
    let scratch = balls();
    let before = scratch.listing();
    for (line, code, said) in [
        ("--component 4", 1, "the surface has 3 components"),
        (
            "--min-triangles 100000",
            1,
            "no component has 100000 triangles",
        ),
        ("--component 0", 2, "a number from 1"),
        ("--component 1 --min-triangles 2", 2, "cannot be used with"),
    ] {
        let run = run(&scratch, &format!("mesh @v.bvol @m.ply {line}"));
        assert_eq!(run.code, Some(code), "{line}: {run:?}");
        assert!(run.stderr.contains(said), "{line}: {}", run.stderr);
        assert_eq!(scratch.listing(), before, "{line}");
    }
    let made = json(&scratch, "mesh @v.bvol @m.ply --component 4 --allow-empty");
    assert_eq!(made["triangles"], 0);
}

#[test]
fn the_largest_part_of_every_segment() {
    let scratch = Scratch::new("components-labels");
    let raw = (0..40 * 20 * 20).map(|n| {
        let [i, j, k] = [n % 40, n / 40 % 20, n / 800];
        match (i, j, k) {
            (2..=5 | 20..=33, 3..=15, 3..=15) => 1,
            (8..=14, 4..=9, 4..=9) | (36, 4, 4) => 2,
            _ => 0u8,
        }
    });
    scratch.write("v.raw", raw.collect::<Vec<u8>>());
    let import = "import @v.raw @v.bvol --dims 40,20,20 --type u8 --kind label --brick 8 -q";
    run(&scratch, import).success();
    let apart = json(
        &scratch,
        "mesh @v.bvol @l-{label}.ply --labels all --component largest",
    );
    let together = json(
        &scratch,
        "mesh @v.bvol @all.ply --labels all --component largest --picture @p.png",
    );
    for (n, label) in [1, 2].into_iter().enumerate() {
        json(
            &scratch,
            &format!("mesh @v.bvol @{label}.ply --label {label} --component largest"),
        );
        let [a, b] = ["l-", ""].map(|p| bytes(&scratch.path(&format!("{p}{label}.ply"))));
        assert!(a == b, "{label}");
        assert_eq!(
            apart["labels"][n]["triangles"],
            together["labels"][n]["triangles"]
        );
        let check = json(&scratch, &format!("check @{label}.ply"));
        assert_eq!(check["report"]["components"], 1);
        assert_eq!(
            check["report"]["triangles"],
            apart["labels"][n]["triangles"]
        );
    }
    let check = json(&scratch, "check @all.ply");
    assert_eq!(check["report"]["components"], 2);
    assert_eq!(check["report"]["triangles"], together["triangles"]);
}

#[test]
#[cfg_attr(debug_assertions, ignore = "release only: a real scan")]
fn the_largest_component_of_a_scan() {
    let Some(source) = shared(
        "volumes/ct_abdomen_crop128_i16.nrrd",
        "components of a scan",
    ) else {
        return;
    };
    let scratch = Scratch::new("components-scan");
    run(&scratch, &format!("import {} @v.bvol -q", source.display())).success();
    json(&scratch, "mesh @v.bvol @all.ply --iso 200");
    let all = json(&scratch, "check @all.ply")["report"]["components"].clone();
    let mut files = Vec::new();
    for (n, limits) in [
        "--threads 1 --mem 24MiB",
        "--threads 2 --mem 24MiB",
        "--threads 2",
    ]
    .into_iter()
    .enumerate()
    {
        let line = format!("mesh @v.bvol @{n}.ply --iso 200 --component largest {limits}");
        let made = json(&scratch, &line);
        assert_eq!(made["components_found"], all);
        files.push(bytes(&scratch.path(&format!("{n}.ply"))));
        if n == 0 {
            let check = json(&scratch, "check @0.ply")["report"].clone();
            assert_eq!(check["components"], 1);
            assert_eq!(check["closed"], true);
            figure(&format!(
                "largest of {all} components of the CT crop: {} triangles, genus {}",
                made["triangles"], check["genus"]
            ));
        }
    }
    assert!(
        files.iter().all(|f| *f == files[0]),
        "threads or memory show"
    );
}
