//! Real scans through the whole program, judged by it and by an independent checker.

use super::words;
use crate::support::data::{ply_check, shared};
use crate::support::program::brickmarch;
use crate::support::python::{has, python};
use crate::support::report::figure;
use crate::support::scratch::Scratch;

/// File, isovalue or label, and what stands in the table beside the data.
const SCANS: [(&str, &str); 8] = [
    ("ct_abdomen_crop128_i16.nrrd", "--iso 200"),
    ("stent_128x128x256_u8.nrrd", "--iso 6.5"),
    ("tooth.nhdr", "--iso 600"),
    ("HeadMRVolume.mhd", "--iso 48"),
    ("embryo_256.mha", "--iso 65"),
    ("ch2.nii.gz", "--iso 49.5"),
    ("aal.nii.gz", "--label 37"),
    ("someones_anatomy.nii.gz", "--iso 42.7"),
];

#[test]
#[cfg_attr(debug_assertions, ignore = "release only: real scans")]
fn real_scans_give_closed_outward_meshes() {
    let judge = ply_check("independent check of real scans")
        .filter(|_| has(&["numpy", "scipy"], "independent check"));
    for (name, surface) in SCANS {
        let Some(source) = shared(&format!("volumes/{name}"), "real scan") else {
            continue;
        };
        let scratch = Scratch::new("scan");
        let kind = if surface.starts_with("--label") {
            "--kind label"
        } else {
            ""
        };
        let import = format!("import {} @v.bvol {kind} --mem 64MiB -q", source.display());
        brickmarch(words(&scratch, &import)).success();
        let run = brickmarch(words(
            &scratch,
            &format!("mesh @v.bvol @m.ply {surface} --mem 64MiB --measure --json -q"),
        ))
        .success();
        let mesh = run.json();
        let check = brickmarch(words(&scratch, "check @m.ply --json -q"))
            .success()
            .json();
        let report = &check["report"];
        assert_eq!(report["triangles"], mesh["triangles"], "{name}");
        assert!(
            report["volume"].as_f64().is_some_and(|v| v > 0.0),
            "{name}: not outward: {check}"
        );
        if let Some(judge) = &judge {
            let path = scratch.path("m.ply");
            let run = python([judge.as_os_str(), path.as_os_str(), "--json".as_ref()]).success();
            let other = run.json();
            for (theirs, ours) in [
                ("triangles", "triangles"),
                ("components", "components"),
                ("euler", "euler"),
            ] {
                assert_eq!(other[theirs], report[ours], "{name}: {theirs}");
            }
            let (a, b) = (other["volume"].as_f64(), report["volume"].as_f64());
            let (a, b) = (a.expect("a number"), b.expect("a number"));
            assert!(
                (a / b - 1.0).abs() < 1e-9 && a > 0.0,
                "{name}: volume {a} and {b}"
            );
        }
        figure(&format!(
            "{name} {surface}: {} triangles, {} components, peak {} MiB of 64 MiB + 48",
            report["triangles"],
            report["components"],
            run.peak_bytes >> 20
        ));
    }
}
