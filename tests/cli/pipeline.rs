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
    let mesh = ok(&scratch, "mesh @a.bvol @m.ply --json -q").json();
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
