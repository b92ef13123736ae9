//! What goes in comes out, the same every time.

use super::{samples, scratch_with_raw, words};
use crate::support::program::{Run, brickmarch};
use crate::support::scratch::{Scratch, bytes, f32_bytes};

#[track_caller]
fn ok(scratch: &Scratch, line: &str) -> Run {
    brickmarch(words(scratch, line)).success()
}

const RAW: &str = "--dims 30,21,26 --type f32 --kind distance -q";

#[test]
fn every_format_brings_the_samples_back() {
    let scratch = scratch_with_raw("formats");
    let raw = f32_bytes(&samples());
    ok(&scratch, &format!("import @field.raw @a.bvol {RAW}"));
    for name in ["b.raw", "b.npy", "b.nrrd"] {
        ok(&scratch, &format!("export @a.bvol @{name} -q"));
        let again = if name == "b.raw" {
            RAW
        } else {
            "--kind distance -q"
        };
        ok(
            &scratch,
            &format!("import @{name} @b.bvol {again} --overwrite"),
        );
        ok(&scratch, "export @b.bvol @c.raw --overwrite -q");
        assert!(
            bytes(&scratch.path("c.raw")) == raw,
            "{name} changed samples"
        );
    }
    assert!(bytes(&scratch.path("b.raw")) == raw);
}

#[test]
fn a_region_is_exported_as_it_is() {
    let scratch = scratch_with_raw("region");
    ok(&scratch, &format!("import @field.raw @a.bvol {RAW}"));
    ok(
        &scratch,
        "export @a.bvol @part.raw --roi 3:17,20:21,5:26 -q",
    );
    let values = samples();
    let mut want = Vec::new();
    for k in 5..26 {
        for i in 3..17 {
            want.push(values[i + 30 * (20 + 21 * k)]);
        }
    }
    assert!(bytes(&scratch.path("part.raw")) == f32_bytes(&want));
}

#[test]
fn threads_and_memory_do_not_change_a_byte() {
    let scratch = scratch_with_raw("same-bytes");
    let mut first: Option<[Vec<u8>; 4]> = None;
    for (threads, mem) in [(1, "1GiB"), (2, "24MiB"), (8, "1GiB"), (8, "24MiB")] {
        let limits = format!("--threads {threads} --mem {mem} --overwrite -q");
        ok(
            &scratch,
            &format!(
                "import @field.raw @a.bvol --dims 30,21,26 --type f32 --kind distance {limits}"
            ),
        );
        for name in ["m.ply", "m.stl", "m.obj"] {
            ok(&scratch, &format!("mesh @a.bvol @{name} {limits}"));
        }
        let files = ["a.bvol", "m.ply", "m.stl", "m.obj"].map(|name| bytes(&scratch.path(name)));
        match &first {
            None => first = Some(files),
            Some(first) => assert!(*first == files, "{threads} threads, {mem}: other bytes"),
        }
    }
}

#[test]
fn info_verify_check_and_slice_say_what_is_there() {
    let scratch = scratch_with_raw("say");
    ok(&scratch, &format!("import @field.raw @a.bvol {RAW}"));
    let info = ok(&scratch, "info @a.bvol --json").json();
    assert!(info.to_string().contains("distance"), "{info}");
    ok(&scratch, "verify @a.bvol -q");
    let mesh = ok(&scratch, "mesh @a.bvol @m.ply --measure --json -q").json();
    let number = |v: &serde_json::Value, key: &str| {
        v[key].as_f64().unwrap_or_else(|| panic!("{key} in {v}"))
    };
    let volume = 4.0 / 3.0 * std::f64::consts::PI * 8.3f64.powi(3);
    assert!(
        (number(&mesh, "signed_volume") / volume - 1.0).abs() < 0.02,
        "{mesh}"
    );
    for name in ["m.ply", "m.stl", "m.obj"] {
        ok(&scratch, &format!("mesh @a.bvol @{name} --overwrite -q"));
        let check = ok(&scratch, &format!("check @{name} --json -q")).json();
        assert_eq!(check["sound"], true, "{name}: {check}");
        assert_eq!(
            check["report"]["triangles"], mesh["triangles"],
            "{name}: {check}"
        );
        assert_eq!(
            check["report"]["vertices"], mesh["vertices"],
            "{name}: {check}"
        );
        assert_eq!(check["report"]["genus"], 0, "{name}: {check}");
    }
    ok(
        &scratch,
        "mesh @a.bvol @open.ply --boundary cut --roi 0:14,0:20,0:25 -q",
    );
    let open = brickmarch(words(&scratch, "check @open.ply"));
    assert_eq!(open.code, Some(3), "{open:#?}");
    ok(&scratch, "slice @a.bvol @s.png -q");
    assert_eq!(&bytes(&scratch.path("s.png"))[..8], b"\x89PNG\r\n\x1a\n");
}

#[test]
fn levels_and_compaction() {
    let scratch = scratch_with_raw("levels");
    let halved: Vec<f32> = {
        let values = samples();
        let at = |p: [usize; 3]| f64::from(values[p[0] + 30 * (p[1] + 21 * p[2])]);
        let mut out = Vec::new();
        for [k, j, i] in (0..13 * 11 * 15).map(|n| [2 * (n / 165), 2 * (n / 15 % 11), 2 * (n % 15)])
        {
            let (mut sum, mut count) = (0.0, 0.0);
            for (x, y, z) in (0..8).map(|c| (i + (c & 1), j + (c >> 1 & 1), k + (c >> 2))) {
                if x < 30 && y < 21 && z < 26 {
                    sum += at([x, y, z]);
                    count += 1.0;
                }
            }
            out.push((sum / count) as f32);
        }
        out
    };
    ok(
        &scratch,
        &format!("import @field.raw @a.bvol --levels 9 --brick 8 {RAW}"),
    );
    let info = ok(&scratch, "info @a.bvol --json").json();
    // 30 samples are two bricks of edge 8 after one halving, one after two.
    assert_eq!(info["levels"], 2, "{info}");
    ok(&scratch, "compact @a.bvol @b.bvol -q");
    let info = ok(&scratch, "info @b.bvol --json").json();
    assert_eq!(info["sealed"], true, "{info}");
    assert_eq!(info["volume"]["bytes_dead"], 0, "{info}");
    for name in ["a", "b"] {
        ok(&scratch, &format!("verify @{name}.bvol -q"));
        ok(
            &scratch,
            &format!("export @{name}.bvol @{name}.raw --level 1 -q"),
        );
        assert!(bytes(&scratch.path(&format!("{name}.raw"))) == f32_bytes(&halved));
    }
    let refused = brickmarch(words(&scratch, "export @a.bvol @c.raw --level 3"));
    assert_eq!(refused.code, Some(1), "{refused:#?}");
    assert!(refused.stderr.contains("level"), "{refused:#?}");
    let itself = brickmarch(words(&scratch, "compact @a.bvol @a.bvol"));
    assert_eq!(itself.code, Some(1), "{itself:#?}");
    ok(&scratch, "compact @a.bvol @a.bvol --overwrite -q");
    assert!(bytes(&scratch.path("a.bvol")) == bytes(&scratch.path("b.bvol")));
}

#[test]
fn damage_is_an_error_unless_a_substitute_is_asked_for() {
    let scratch = scratch_with_raw("substitute");
    ok(
        &scratch,
        &format!("import @field.raw @a.bvol --brick 8 {RAW}"),
    );
    let mut file = bytes(&scratch.path("a.bvol"));
    let middle = file.len() / 2;
    file[middle] ^= 1;
    scratch.write("bad.bvol", file);
    let refused = brickmarch(words(&scratch, "export @bad.bvol @bad.raw -q"));
    assert_eq!(refused.code, Some(1), "{refused:#?}");
    assert!(!scratch.path("bad.raw").exists());
    let told = brickmarch(words(
        &scratch,
        "export @bad.bvol @bad.raw --on-damage substitute",
    ));
    assert_eq!(told.code, Some(3), "{told:#?}");
    assert!(told.stderr.contains("substituted"), "{told:#?}");
    let (bad, good) = (bytes(&scratch.path("bad.raw")), f32_bytes(&samples()));
    let differ = bad
        .chunks(4)
        .zip(good.chunks(4))
        .filter(|(a, b)| a != b)
        .count();
    assert!((1..=512).contains(&differ), "{differ} samples differ");
}

#[test]
fn smoothing_says_what_it_did_and_bytes_stay_the_same() {
    let scratch = scratch_with_raw("smooth");
    ok(&scratch, &format!("import @field.raw @a.bvol {RAW}"));
    ok(&scratch, "mesh @a.bvol @plain.ply -q");
    let line = "mesh @a.bvol @m.ply --smooth quality --measure --overwrite --json -q";
    let mut first: Option<Vec<u8>> = None;
    for limits in [
        "--threads 1 --mem 1GiB",
        "--threads 2 --mem 24MiB",
        "--threads 8 --mem 24MiB",
    ] {
        let said = ok(&scratch, &format!("{line} {limits}")).json();
        let angle = |when: &str, which: &str| {
            let number = &said["shapes"][when]["min_angle_deg"][which];
            number.as_f64().unwrap_or_else(|| panic!("{said}"))
        };
        assert!(angle("before", "p1") < 5.0, "{said}");
        assert!(angle("after", "least") >= 20.0, "{said}");
        assert!(angle("after", "p1") >= 26.0 && angle("after", "p50") >= 42.0);
        let ratio = &said["shapes"]["after"]["radius_ratio"]["p1"];
        assert!(ratio.as_f64().is_some_and(|r| r > 0.4), "{said}");
        let made = bytes(&scratch.path("m.ply"));
        match &first {
            None => first = Some(made),
            Some(first) => assert!(*first == made, "{limits}: other bytes"),
        }
    }
    let plain = bytes(&scratch.path("plain.ply"));
    let first = first.expect("meshed");
    assert_eq!(plain.len(), first.len());
    // The triangles are the same records at the end of the file.
    let tail = plain.len() / 2;
    assert!(plain[tail..] == first[tail..], "triangles changed");
    let check = ok(&scratch, "check @m.ply --json -q").json();
    assert_eq!(check["sound"], true, "{check}");
    let text = ok(
        &scratch,
        "mesh @a.bvol @m.ply --smooth quality --measure --overwrite",
    );
    assert!(text.stdout.contains("after: min angle"), "{text:#?}");
    for wrong in [
        "--passes 2",
        "--smooth quality --passes 0",
        "--smooth quality --passes 6",
        "--smooth much",
    ] {
        let run = brickmarch(words(&scratch, &format!("mesh @a.bvol @n.ply {wrong} -q")));
        assert_eq!(run.code, Some(2), "{wrong}: {run:#?}");
    }
}

#[test]
fn simplifying_says_what_it_did_and_bytes_stay_the_same() {
    let scratch = scratch_with_raw("simplify");
    ok(&scratch, &format!("import @field.raw @a.bvol {RAW}"));
    let plain = ok(&scratch, "mesh @a.bvol @plain.ply --json -q --measure").json();
    let count = |json: &serde_json::Value, name: &str| json[name].as_u64().expect("a count");
    for (goal, share) in [("10%", 0.105), ("0.2", 0.3)] {
        let line = format!("mesh @a.bvol @m.ply --simplify {goal} --measure --overwrite --json -q");
        let mut first: Option<Vec<u8>> = None;
        for limits in ["--threads 1 --mem 1GiB", "--threads 2 --mem 96MiB"] {
            let said = ok(&scratch, &format!("{line} {limits}")).json();
            assert_eq!(said["closed"], true, "{said}");
            assert_eq!(said["euler"], plain["euler"], "{said}");
            let before = count(&said["simplified"], "triangles_before");
            assert_eq!(before, count(&plain, "triangles"));
            let after = count(&said, "triangles") as f64;
            assert!(after < share * before as f64, "{said}");
            let distance = said["simplified"]["distance"].as_f64().expect("measured");
            assert!(distance > 0.0 && distance < 1.0, "{said}");
            let made = bytes(&scratch.path("m.ply"));
            match &first {
                None => first = Some(made),
                Some(first) => assert!(*first == made, "{limits}: other bytes"),
            }
        }
        let check = ok(&scratch, "check @m.ply --json -q").json();
        assert_eq!(check["sound"], true, "{check}");
    }
    let text = ok(&scratch, "mesh @a.bvol @m.ply --simplify 10% --overwrite");
    assert!(text.stdout.contains("Hausdorff distance"), "{text:#?}");
    // Together with others that stand between the surface and the file.
    let line = "mesh @a.bvol @m.ply --simplify 20% --smooth quality --component largest --normals \
                --overwrite --json -q";
    let said = ok(&scratch, line).json();
    assert_eq!(said["components_kept"], 1, "{said}");
    for wrong in [
        "--simplify 0",
        "--simplify 100%",
        "--simplify x",
        "--simplify 5% --part 1/2",
    ] {
        let run = brickmarch(words(&scratch, &format!("mesh @a.bvol @n.ply {wrong} -q")));
        assert_eq!(run.code, Some(2), "{wrong}: {run:#?}");
    }
}
