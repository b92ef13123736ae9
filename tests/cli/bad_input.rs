//! Bad input: one line on standard error that names file, place and remedy, exit code 1 (2 for
//! wrong usage), no panic, and nothing left behind.

use super::{DOMAIN, samples, scratch_with_raw, words};
use crate::support::program::{Run, brickmarch};
use crate::support::scratch::{Scratch, bytes, f32_bytes};
use crate::volume::write;
use brickmarch::store::VolumeSpec;
use brickmarch::{Box3, Grid, Kind, SampleType};

/// What a refused command must be like.
pub(super) struct Case {
    /// Words of the command; `@name` is a file in scratch space.
    line: &'static str,
    /// The exit code: 1 bad input, 2 wrong usage, 3 not what was asked.
    code: i32,
    /// Words that standard error must contain: the file, the place, the remedy.
    says: &'static [&'static str],
}

pub(super) const fn case(line: &'static str, code: i32, says: &'static [&'static str]) -> Case {
    Case { line, code, says }
}

#[track_caller]
fn check(scratch: &Scratch, case: &Case) {
    let before = scratch.listing();
    let run = brickmarch(words(scratch, case.line));
    let what = format!("brickmarch {}\n{run:#?}", case.line);
    assert_eq!(run.code, Some(case.code), "exit code of {what}");
    assert_clean(&run, case.code, &what);
    for word in case.says {
        assert!(
            run.stderr.contains(word),
            "standard error lacks '{word}': {what}"
        );
    }
    assert_eq!(
        before,
        scratch.listing(),
        "something was left behind by {what}"
    );
}

/// No panic, nothing on standard output, and one line unless the usage is explained.
fn assert_clean(run: &Run, code: i32, what: &str) {
    for sign in ["panicked", "RUST_BACKTRACE", "overflow", "thread '"] {
        assert!(!run.stderr.contains(sign), "a panic shows in {what}");
    }
    if code == 1 {
        assert_eq!(run.stderr.lines().count(), 1, "not one line: {what}");
        assert_eq!(run.stdout, "", "results of a failed command: {what}");
        assert!(
            run.stderr.len() < 1000,
            "not a line that a person reads: {what}"
        );
    }
    assert!(!run.stderr.trim().is_empty(), "silent: {what}");
}

/// Runs every case and reports all that fail, not just the first.
pub(super) fn check_all(scratch: &Scratch, cases: &[Case]) {
    let before = scratch.listing();
    let failed: Vec<String> = cases
        .iter()
        .filter_map(|case| {
            let run = std::panic::AssertUnwindSafe(|| check(scratch, case));
            let error = std::panic::catch_unwind(run).err()?;
            // One case that goes wrong must not spoil the next.
            for path in scratch
                .listing()
                .into_keys()
                .filter(|p| !before.contains_key(p))
            {
                std::fs::remove_file(&path).expect("a file that the command left");
            }
            let text = error.downcast_ref::<String>().cloned();
            Some(text.unwrap_or_else(|| format!("brickmarch {}", case.line)))
        })
        .collect();
    assert!(
        failed.is_empty(),
        "{} of {} cases:\n{}",
        failed.len(),
        cases.len(),
        failed.join("\n\n")
    );
}

/// Scratch space with volumes, and with sources that are wrong in one way each.
pub(super) fn prepare(name: &str) -> Scratch {
    let scratch = scratch_with_raw(name);
    volumes(&scratch);
    sources(&scratch);
    scratch
}

fn volumes(scratch: &Scratch) {
    let values = samples();
    let mut spec = VolumeSpec::new(Grid::new(DOMAIN), SampleType::F32);
    write(&scratch.path("density.bvol"), &spec, &values);
    spec.kind = Kind::Distance;
    write(&scratch.path("distance.bvol"), &spec, &values);
    write(
        &scratch.path("nan.bvol"),
        &spec,
        &vec![f32::NAN; values.len()],
    );
    let ids: Vec<f32> = values
        .iter()
        .map(|v| if *v < 0.0 { 7.0 } else { 0.0 })
        .collect();
    let mut labels = VolumeSpec::new(Grid::new(DOMAIN), SampleType::U8);
    labels.kind = Kind::Label;
    write(&scratch.path("label.bvol"), &labels, &ids);

    let good = bytes(&scratch.path("distance.bvol"));
    scratch.write("cut.bvol", &good[..good.len() / 2]);
    scratch.write("header-only.bvol", &good[..64]);
    let mut magic = good.clone();
    magic[0] ^= 0xff;
    scratch.write("magic.bvol", magic);
    let mut flipped = good.clone();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 0x10;
    scratch.write("flipped.bvol", flipped);
    scratch.write("text.bvol", "hello\n");
    scratch.write("empty.bvol", "");
    scratch.write("exists.ply", "mine");
    scratch.write("exists.bvol", "mine");
    scratch.write("exists.png", "mine");
    scratch.write("exists.raw", "mine");
    std::fs::create_dir(scratch.path("folder")).expect("scratch is writable");
}

fn sources(scratch: &Scratch) {
    let raw = f32_bytes(&samples());
    let nrrd = |header: &str, data: &[u8]| [b"NRRD0004\n", header.as_bytes(), b"\n", data].concat();
    let good = "type: float\ndimension: 3\nsizes: 30 21 26\nendian: little\nencoding: raw\n";
    scratch.write("cut.raw", &raw[..raw.len() - 5]);
    scratch.write("long.raw", [&raw[..], b"xx"].concat());
    scratch.write("cut.nrrd", nrrd(good, &raw[..raw.len() - 400]));
    scratch.write(
        "magic.nrrd",
        [b"NOPE0004\n", good.as_bytes(), b"\n", &raw[..]].concat(),
    );
    scratch.write(
        "type.nrrd",
        nrrd(&good.replace("float", "quaternion"), &raw),
    );
    scratch.write(
        "zero.nrrd",
        nrrd(&good.replace("30 21 26", "30 0 26"), &raw),
    );
    scratch.write(
        "negative.nrrd",
        nrrd(&good.replace("30 21 26", "30 -21 26"), &raw),
    );
    let absurd = "4000000000 4000000000 4000000000";
    scratch.write("absurd.nrrd", nrrd(&good.replace("30 21 26", absurd), &raw));
    let large = "100000 100000 100000";
    scratch.write("large.nrrd", nrrd(&good.replace("30 21 26", large), &raw));
    scratch.write(
        "flat.nrrd",
        nrrd(
            &good
                .replace("dimension: 3", "dimension: 2")
                .replace(" 26", ""),
            &raw,
        ),
    );
    scratch.write(
        "gone.nhdr",
        format!("NRRD0004\n{good}data file: nowhere.raw\n\n"),
    );
    scratch.write(
        "gzip.nrrd",
        nrrd(&good.replace("raw", "gzip"), b"this is not gzip"),
    );

    let npy = |header: &str, data: &[u8]| {
        let padded = format!("{header:<117}\n");
        [
            b"\x93NUMPY\x01\x00",
            &(padded.len() as u16).to_le_bytes()[..],
            padded.as_bytes(),
            data,
        ]
        .concat()
    };
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (26, 21, 30), }";
    scratch.write("cut.npy", npy(header, &raw[..raw.len() / 2]));
    scratch.write("complex.npy", npy(&header.replace("<f4", "<c8"), &raw));
    scratch.write(
        "flat.npy",
        npy(&header.replace("(26, 21, 30)", "(26, 630)"), &raw),
    );
    scratch.write("object.npy", npy(&header.replace("'<f4'", "'|O'"), &raw));
    scratch.write(
        "absurd.npy",
        npy(
            &header.replace("(26, 21, 30)", "(9999999999, 9999999999, 9999999999)"),
            &raw,
        ),
    );
    scratch.write("magic.npy", &raw);
    scratch.write("header.npy", &npy(header, &raw)[..40]);

    scratch.write("magic.nii", vec![7u8; 400]);
    scratch.write("short.nii", vec![0u8; 100]);
    scratch.write("series.nii", nifti([4, 30, 21, 13, 2], &raw));
    scratch.write("cut.nii", nifti([3, 30, 21, 26, 1], &raw[..raw.len() - 4]));
    scratch.write("zero.nii", nifti([3, 30, 0, 26, 1], &raw));
    scratch.write("negative.nii", nifti([3, 30, -5, 26, 1], &raw));
    scratch.write("gzip.nii.gz", b"not gzip at all");
    scratch.write("cut.nii.gz", [0x1f, 0x8b, 8, 0, 0]);

    let mha = |header: &str| [header.as_bytes(), &raw].concat();
    let good = "ObjectType = Image\nNDims = 3\nDimSize = 30 21 26\nElementType = MET_FLOAT\nElementDataFile = LOCAL\n";
    scratch.write("type.mha", mha(&good.replace("MET_FLOAT", "MET_STRING")));
    scratch.write("cut.mha", &mha(good)[..good.len() + 1000]);
    scratch.write("zero.mha", mha(&good.replace("30 21 26", "0 21 26")));
    scratch.write("gone.mhd", good.replace("LOCAL", "nowhere.raw"));
    scratch.write("magic.mha", vec![0u8; 300]);
    scratch.write("unknown.xyz", "1 2 3\n");

    scratch.write("text.ply", "solid nothing\n");
    scratch.write(
        "cut.ply",
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n",
    );
    let lies = "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\n\
                property float z\nelement face 4000000000\nproperty list uchar int vertex_indices\nend_header\n";
    scratch.write("absurd.ply", lies);
    scratch.write("cut.stl", vec![9u8; 83]);
    scratch.write("index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n");
}

/// A NIfTI-1 file of f32 with `dim` (number of axes, then sizes).
fn nifti(dim: [i16; 5], data: &[u8]) -> Vec<u8> {
    let mut file = vec![0u8; 352];
    file[..4].copy_from_slice(&348i32.to_le_bytes());
    for (i, v) in [dim[0], dim[1], dim[2], dim[3], dim[4], 1, 1, 1]
        .into_iter()
        .enumerate()
    {
        file[40 + 2 * i..][..2].copy_from_slice(&v.to_le_bytes());
    }
    file[70..72].copy_from_slice(&16i16.to_le_bytes());
    file[72..74].copy_from_slice(&32i16.to_le_bytes());
    for i in 0..8 {
        file[76 + 4 * i..][..4].copy_from_slice(&1f32.to_le_bytes());
    }
    file[108..112].copy_from_slice(&352f32.to_le_bytes());
    file[344..348].copy_from_slice(b"n+1\0");
    file.extend_from_slice(data);
    file
}

#[test]
fn wrong_sources_are_refused() {
    let scratch = prepare("bad-sources");
    check_all(
        &scratch,
        &[
            case("import @missing.nrrd @out.bvol", 1, &["missing.nrrd"]),
            case(
                "import @missing.raw @out.bvol --dims 1,1,1 --type u8",
                1,
                &["missing.raw"],
            ),
            case("import @folder @out.bvol", 1, &["folder"]),
            case("import @unknown.xyz @out.bvol", 1, &["unknown.xyz", "nrrd"]),
            case("import @field.raw @out.bvol", 1, &["field.raw", "--dims"]),
            case(
                "import @cut.raw @out.bvol --dims 30,21,26 --type f32",
                1,
                &["cut.raw", "65520", "65515"],
            ),
            case(
                "import @long.raw @out.bvol --dims 30,21,26 --type f32",
                1,
                &["long.raw", "65520", "65522"],
            ),
            case(
                "import @field.raw @out.bvol --dims 30,0,26 --type f32",
                2,
                &["--dims"],
            ),
            case(
                "import @field.raw @out.bvol --dims 30,-1,26 --type f32",
                2,
                &["--dims"],
            ),
            case(
                "import @field.raw @out.bvol --dims 2000000000,2000000000,2000000000 --type f32",
                1,
                &["field.raw"],
            ),
            case(
                "import @field.raw @out.bvol --dims 30,21,26 --type f99",
                2,
                &["f99", "f32"],
            ),
            case(
                "import @field.raw @out.bvol --dims 30,21 --type f32",
                2,
                &["30,21"],
            ),
            case("import @field.raw", 2, &["OUT"]),
            case("import @cut.nrrd @out.bvol", 1, &["cut.nrrd"]),
            case("import @magic.nrrd @out.bvol", 1, &["magic.nrrd"]),
            case(
                "import @type.nrrd @out.bvol",
                1,
                &["type.nrrd", "quaternion"],
            ),
            case(
                "import @zero.nrrd @out.bvol",
                1,
                &["zero.nrrd", "30 x 0 x 26"],
            ),
            case(
                "import @negative.nrrd @out.bvol",
                1,
                &["negative.nrrd", "-21"],
            ),
            case(
                "import @absurd.nrrd @out.bvol",
                1,
                &["absurd.nrrd", "4000000000"],
            ),
            case("import @large.nrrd @out.bvol", 1, &["large.nrrd"]),
            case("import @flat.nrrd @out.bvol", 1, &["flat.nrrd", "three"]),
            case("import @gone.nhdr @out.bvol", 1, &["nowhere.raw"]),
            case("import @gzip.nrrd @out.bvol", 1, &["gzip.nrrd"]),
            case("import @cut.npy @out.bvol", 1, &["cut.npy"]),
            case("import @complex.npy @out.bvol", 1, &["complex.npy", "<c8"]),
            case("import @flat.npy @out.bvol", 1, &["flat.npy", "630"]),
            case("import @object.npy @out.bvol", 1, &["object.npy", "O"]),
            case("import @absurd.npy @out.bvol", 1, &["absurd.npy"]),
            case("import @magic.npy @out.bvol", 1, &["magic.npy"]),
            case("import @header.npy @out.bvol", 1, &["header.npy"]),
            case("import @magic.nii @out.bvol", 1, &["magic.nii"]),
            case("import @short.nii @out.bvol", 1, &["short.nii"]),
            case(
                "import @series.nii @out.bvol",
                1,
                &["series.nii", "--volume"],
            ),
            case(
                "import @series.nii @out.bvol --volume 2",
                1,
                &["series.nii", "2"],
            ),
            case("import @cut.nii @out.bvol", 1, &["cut.nii"]),
            case("import @zero.nii @out.bvol", 1, &["zero.nii"]),
            case("import @negative.nii @out.bvol", 1, &["negative.nii"]),
            case("import @gzip.nii.gz @out.bvol", 1, &["gzip.nii.gz"]),
            case("import @cut.nii.gz @out.bvol", 1, &["cut.nii.gz"]),
            case("import @type.mha @out.bvol", 1, &["type.mha", "MET_STRING"]),
            case("import @cut.mha @out.bvol", 1, &["cut.mha"]),
            case(
                "import @zero.mha @out.bvol",
                1,
                &["zero.mha", "0 x 21 x 26"],
            ),
            case("import @gone.mhd @out.bvol", 1, &["nowhere.raw"]),
            case("import @magic.mha @out.bvol", 1, &["magic.mha"]),
            case(
                "import @field.raw @exists.bvol --dims 30,21,26 --type f32",
                1,
                &["exists.bvol", "--overwrite"],
            ),
            case(
                "import @field.raw @nowhere/out.bvol --dims 30,21,26 --type f32",
                1,
                &["nowhere"],
            ),
            case(
                "import @field.raw @exists.ply/out.bvol --dims 30,21,26 --type f32",
                1,
                &["exists.ply"],
            ),
            case(
                "import @field.raw @folder --dims 30,21,26 --type f32",
                1,
                &["folder"],
            ),
            case(
                "import @field.raw @out.bvol --dims 30,21,26 --type f32 --mem 1KiB",
                1,
                &["--mem"],
            ),
            case(
                "import @field.raw @out.bvol --dims 30,21,26 --type f32 --mem lots",
                2,
                &["lots"],
            ),
        ],
    );
}

#[test]
fn wrong_questions_are_refused() {
    let scratch = prepare("bad-questions");
    check_all(
        &scratch,
        &[
            case("mesh @missing.bvol @out.ply --iso 0", 1, &["missing.bvol"]),
            case("mesh @text.bvol @out.ply --iso 0", 1, &["text.bvol"]),
            case("mesh @empty.bvol @out.ply --iso 0", 1, &["empty.bvol"]),
            case(
                "mesh @header-only.bvol @out.ply --iso 0",
                1,
                &["header-only.bvol"],
            ),
            case("mesh @cut.bvol @out.ply --iso 0", 1, &["cut.bvol"]),
            case("mesh @flipped.bvol @out.ply --iso 0", 1, &["flipped.bvol"]),
            case(
                "mesh @field.raw @out.ply --iso 0",
                1,
                &["field.raw", "import"],
            ),
            case("mesh @folder @out.ply --iso 0", 1, &["folder"]),
            case("mesh @density.bvol @out.ply", 1, &["density.bvol", "--iso"]),
            case(
                "mesh @density.bvol @out.ply --iso 1000",
                1,
                &["density.bvol", "1000", "-7.9", "13.6", "--allow-empty"],
            ),
            case("mesh @density.bvol @out.ply --iso nan", 2, &["nan"]),
            case("mesh @nan.bvol @out.ply", 1, &["nan.bvol"]),
            case("mesh @label.bvol @out.ply", 1, &["label.bvol", "--label"]),
            case(
                "mesh @label.bvol @out.ply --label 9",
                1,
                &["label.bvol", "9"],
            ),
            case(
                "mesh @distance.bvol @out.ply --seed 0,0,0",
                1,
                &["distance.bvol", "0,0,0"],
            ),
            case(
                "mesh @distance.bvol @out.ply --seed 99,0,0",
                1,
                &["distance.bvol", "99"],
            ),
            case("mesh @distance.bvol @out.ply --seed 1,2", 2, &["1,2"]),
            case(
                "mesh @distance.bvol @out.ply --roi 0:99,0:9,0:9",
                1,
                &["distance.bvol", "0:30,0:21,0:26"],
            ),
            case(
                "mesh @distance.bvol @out.ply --roi -5:9,0:9,0:9",
                1,
                &["distance.bvol", "0:30,0:21,0:26"],
            ),
            case(
                "mesh @distance.bvol @out.ply --roi 9:0,0:9,0:9",
                2,
                &["9:0"],
            ),
            case(
                "mesh @distance.bvol @out.ply --roi 0:3,0:3,0:3",
                1,
                &["distance.bvol", "0:3,0:3,0:3"],
            ),
            case("mesh @distance.bvol @out.xyz", 1, &["out.xyz", "ply"]),
            case("mesh @distance.bvol @out", 1, &["out", "ply"]),
            case(
                "mesh @distance.bvol @exists.ply",
                1,
                &["exists.ply", "--overwrite"],
            ),
            case("mesh @distance.bvol @nowhere/out.ply", 1, &["nowhere"]),
            case(
                "mesh @distance.bvol @exists.ply/out.ply",
                1,
                &["exists.ply"],
            ),
            case("mesh @distance.bvol @out.ply --mem 1KiB", 1, &["--mem"]),
            case(
                "mesh @distance.bvol @out.ply --boundary open",
                2,
                &["open", "cap"],
            ),
            case("mesh @distance.bvol", 2, &["OUT"]),
            case(
                "slice @distance.bvol @out.png --index 99",
                1,
                &["distance.bvol", "99"],
            ),
            case(
                "slice @distance.bvol @out.png --index -1",
                1,
                &["distance.bvol", "-1"],
            ),
            case("slice @distance.bvol @out.gif", 1, &["out.gif", "png"]),
            case(
                "slice @distance.bvol @exists.png",
                1,
                &["exists.png", "--overwrite"],
            ),
            case("slice @flipped.bvol @out.png", 1, &["flipped.bvol"]),
            case("info @missing.bvol", 1, &["missing.bvol"]),
            case("info @text.bvol", 1, &["text.bvol"]),
            case("check @missing.ply", 1, &["missing.ply"]),
            case("check @text.ply", 1, &["text.ply"]),
            case("check @cut.ply", 1, &["cut.ply"]),
            case("check @absurd.ply", 1, &["absurd.ply"]),
            case("check @cut.stl", 1, &["cut.stl"]),
            case("check @index.obj", 1, &["index.obj", "9"]),
            case("check @unknown.xyz", 1, &["unknown.xyz", "ply"]),
            case("frobnicate", 2, &["frobnicate"]),
            case("mesh", 2, &["VOLUME"]),
        ],
    );
}

#[test]
fn wrong_exports_are_refused() {
    let scratch = prepare("bad-exports");
    check_all(
        &scratch,
        &[
            case("export @missing.bvol @out.raw", 1, &["missing.bvol"]),
            case("export @distance.bvol @out.xyz", 1, &["out.xyz", "nrrd"]),
            case(
                "export @distance.bvol @exists.raw",
                1,
                &["exists.raw", "--overwrite"],
            ),
            case("export @distance.bvol @nowhere/out.raw", 1, &["nowhere"]),
            case(
                "export @distance.bvol @out.raw --roi 0:99,0:9,0:9",
                1,
                &["distance.bvol", "0:30,0:21,0:26"],
            ),
            case("export @flipped.bvol @out.raw", 1, &["flipped.bvol"]),
            case("verify @missing.bvol", 1, &["missing.bvol"]),
            case("verify @text.bvol", 1, &["text.bvol"]),
            case("verify @flipped.bvol", 3, &["flipped.bvol"]),
        ],
    );
}

/// A disk that is full, by a limit on the size of files.
#[test]
fn a_full_disk_leaves_nothing() {
    let scratch = prepare("full-disk");
    let values = crate::support::fields::random(
        crate::support::fields::Content::Noise,
        Box3::from_size([64; 3]),
        &mut crate::support::rng::Rng::new(4),
    );
    scratch.write("noise.raw", f32_bytes(&values));
    let spec = VolumeSpec::new(Grid::new(Box3::from_size([64; 3])), SampleType::F32);
    write(&scratch.path("noise.bvol"), &spec, &values);
    for line in [
        "import @noise.raw @out.bvol --dims 64,64,64 --type f32",
        "mesh @noise.bvol @out.ply --iso 0",
        "mesh @noise.bvol @out.stl --iso 0",
        "mesh @noise.bvol @out.obj --iso 0",
        "export @noise.bvol @out.raw",
    ] {
        let before = scratch.listing();
        // With the signal ignored a write beyond the limit is an error, as on a full disk.
        let run = crate::support::program::limited(words(&scratch, line), 200);
        let what = format!("brickmarch {line}\n{run:#?}");
        assert_eq!(run.code, Some(1), "{what}");
        assert_clean(&run, 1, &what);
        assert!(run.stderr.contains("out."), "the file is not named: {what}");
        assert_eq!(
            before,
            scratch.listing(),
            "something was left behind by {what}"
        );
    }
}

#[test]
fn an_empty_mesh_is_written_only_when_allowed() {
    let scratch = prepare("empty-mesh");
    let line = "mesh @density.bvol @out.ply --iso 1000 --allow-empty --json -q";
    let run = brickmarch(words(&scratch, line)).success();
    assert_eq!(run.json()["triangles"], 0, "{run:#?}");
    assert!(scratch.path("out.ply").exists());
}
