//! Memory is a result: peak resident memory is at most the budget plus 48 MiB, on data that are
//! larger than the budget, as the kernel saw it from outside and as the program says itself.

use crate::support::program::{Run, brickmarch, data_gen};
use crate::support::report::figure;
use crate::support::scratch::Scratch;
use brickmarch::store::{Volume, VolumeSpec, write_field};
use brickmarch::{Box3, Budget, Field, Kind, SampleType, Samples};
use brickmarch_data_gen::{Scene, SceneField, SceneName};

const SLACK: u64 = 48 << 20;
const MIB: [u64; 3] = [24, 64, 256];
/// 448^3 singles are 343 MiB.
const N: u32 = 448;

/// Peak in MiB of a run that succeeded, as seen from outside.
#[track_caller]
fn within(run: Run, mib: u64, what: &str) -> u64 {
    let run = run.success();
    assert!(
        run.peak_bytes > 1 << 20,
        "{what}: nothing was measured: {run:#?}"
    );
    assert!(
        run.peak_bytes <= (mib << 20) + SLACK,
        "{what}: {} MiB resident with a budget of {mib} MiB: {run:#?}",
        run.peak_bytes >> 20
    );
    run.peak_bytes >> 20
}

/// The same, where the program says its peak too.
#[track_caller]
fn within_and_said(run: Run, mib: u64, what: &str) -> u64 {
    let own = run.json()["peak_rss_bytes"].as_u64();
    let own = own.unwrap_or_else(|| panic!("{what} does not say its peak: {run:#?}"));
    // Looking from outside may miss the last moment.
    assert!(
        own <= (mib << 20) + SLACK && own + (1 << 20) >= run.peak_bytes,
        "{what}: says {own}: {run:#?}"
    );
    within(run, mib, what)
}

#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "release only: 343 MiB of samples, several times"
)]
fn peak_memory_stays_within_the_budget() {
    let scratch = Scratch::new("bounds");
    let path = |name: &str| scratch.path(name).to_string_lossy().into_owned();
    let (n, dims) = (N.to_string(), format!("{N},{N},{N}"));
    let (raw, volume) = (path("field.raw"), path("field.bvol"));
    data_gen(["field", "gyroid", "--n", &n, "--out", &raw]).success();
    let mut peaks = [const { Vec::new() }; 4];
    for mib in MIB {
        let mem = format!("{mib}MiB");
        let limits = ["--mem", &mem, "--json", "--quiet", "--overwrite"];
        let run = |words: &[&str]| brickmarch(words.iter().chain(&limits));
        let layout = ["import", &raw, &volume, "--dims", &dims, "--type", "f32"];
        peaks[0].push(within_and_said(run(&layout), mib, "import"));
        let (mesh, out, png) = (path("m.ply"), path("out.raw"), path("s.png"));
        peaks[1].push(within(
            seen(|| run(&["mesh", &volume, &mesh, "--iso", "0"])),
            mib,
            "mesh",
        ));
        peaks[2].push(within_and_said(
            run(&["export", &volume, &out]),
            mib,
            "export",
        ));
        peaks[3].push(within(
            seen(|| run(&["slice", &volume, &png, "--axis", "x"])),
            mib,
            "slice",
        ));
        std::fs::remove_file(mesh).expect("it was written");
        std::fs::remove_file(out).expect("it was written");
    }
    for (what, peaks) in ["import", "mesh", "export", "slice"].iter().zip(peaks) {
        figure(&format!(
            "peak resident MiB of {what}, gyroid {N}^3, budgets {MIB:?} MiB: {peaks:?}"
        ));
    }
}

#[test]
#[cfg_attr(debug_assertions, ignore = "release only: a field of 1024^3")]
fn a_large_sparse_volume_is_never_dense() {
    let scratch = Scratch::new("sparse");
    let path = |name: &str| scratch.path(name).to_string_lossy().into_owned();
    let (volume, mesh) = (path("sphere.bvol"), path("m.ply"));
    // 4 GiB as an array.
    let scene = Scene::new(SceneName::LevelSetSphere, 1024).expect("a good size");
    let field = SceneField::new(scene);
    let mut spec = VolumeSpec::new(*field.grid(), SampleType::F32);
    spec.kind = Kind::Distance;
    let budget = Budget::mib(64);
    write_field(&field, &spec, volume.as_ref(), &budget).expect("it can be written");
    let made = budget.peak_bytes() >> 20;
    let file = std::fs::metadata(&volume).expect("it was written").len();
    assert!(file < 200 << 20, "{file} bytes for a sparse volume");
    let run = brickmarch([
        "mesh", &volume, &mesh, "--mem", "64MiB", "--json", "--quiet",
    ]);
    let vertices = run.json()["vertices"].as_u64();
    let meshed = within_and_said(run, 64, "mesh");
    figure(&format!(
        "level set of a sphere, 1024^3: {} MiB file, {} vertices; {made} MiB under permit to write and {meshed} MiB to mesh \
         with a budget of 64 MiB",
        file >> 20,
        vertices.unwrap_or(0)
    ));
}

/// A run that was looked at while it ran. The short ones are over in some milliseconds, which on a
/// busy machine is less than the time between two looks: they are run again.
fn seen(run: impl Fn() -> Run) -> Run {
    let runs = std::iter::repeat_with(run).take(100);
    let mut last = None;
    for run in runs {
        if run.peak_bytes > 1 << 20 {
            return run;
        }
        last = Some(run);
    }
    last.expect("it ran")
}

/// What came of a command that may refuse: its peak in MiB, `None` where it refused.
#[track_caller]
fn within_or_refused(run: Run, mib: u64, what: &str) -> Option<u64> {
    if run.code == Some(0) {
        return Some(within(run, mib, what));
    }
    assert_eq!(run.code, Some(1), "{what}: {run:#?}");
    // Of the need and of the way out, before the memory was taken.
    assert!(
        run.stderr.contains("--mem") && run.stderr.trim_end().lines().count() == 1,
        "{what} with {mib} MiB refuses without a remedy: {run:#?}"
    );
    assert!(
        run.peak_bytes <= (mib << 20) + SLACK,
        "{what} refused after taking {} MiB of {mib}: {run:#?}",
        run.peak_bytes >> 20
    );
    None
}

/// Every command at every budget, on 64 MiB of samples.
#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "release only: every command, several times"
)]
fn every_command_stays_within_its_budget_or_says_what_it_needs() {
    let scratch = Scratch::new("bounds-all");
    let path = |name: &str| scratch.path(name).to_string_lossy().into_owned();
    let (raw, volume, levels) = (path("field.raw"), path("field.bvol"), path("levels.bvol"));
    let (packed, ply, wood) = (path("packed.nrrd"), path("all.ply"), path("wood.bvol"));
    data_gen(["texture", "wood", "--n", "128", "--out", &wood]).success();
    data_gen(["field", "gyroid", "--n", "256", "--out", &raw]).success();
    let dims = ["--dims", "256,256,256", "--type", "f32"];
    let import = |out| ["import", &raw, out].into_iter().chain(dims);
    brickmarch(import(&volume)).success();
    brickmarch(["export", &volume, &packed, "--gzip"]).success();
    brickmarch(["mesh", &volume, &ply, "--iso", "0"]).success();
    let (out, picture, folder) = (path("out"), path("p.png"), path("demo"));
    let file = |extension: &str| format!("{out}.{extension}");
    let (bvol, npy, nrrd, stl, obj, mesh, png, man) = (
        file("bvol"),
        file("npy"),
        file("nrrd"),
        file("stl"),
        file("obj"),
        file("ply"),
        file("png"),
        file("man"),
    );
    let mut commands: Vec<(&str, Vec<&str>)> = vec![
        (
            "import --levels",
            import(&levels).chain(["--levels", "9"]).collect(),
        ),
        ("import of gzip", vec!["import", &packed, &bvol]),
        (
            "import of small bricks",
            import(&bvol).chain(["--brick", "8"]).collect(),
        ),
        ("compact", vec!["compact", &levels, &bvol]),
        ("info", vec!["info", &levels]),
        ("verify", vec!["verify", &levels]),
        ("export to npy", vec!["export", &volume, &npy]),
        ("export to gzip", vec!["export", &volume, &nrrd, "--gzip"]),
        (
            "export of a level",
            vec!["export", &levels, &npy, "--level", "1"],
        ),
        (
            "mesh to ply",
            vec!["mesh", &volume, &mesh, "--iso", "0", "--normals", "--keys"],
        ),
        ("mesh to stl", vec!["mesh", &volume, &stl, "--iso", "0"]),
        ("mesh to obj", vec!["mesh", &volume, &obj, "--iso", "0"]),
        (
            "mesh of a level",
            vec!["mesh", &levels, &mesh, "--iso", "0", "--level", "1"],
        ),
        (
            "mesh with a picture",
            vec!["mesh", &volume, &mesh, "--iso", "0", "--picture", &picture],
        ),
        (
            "mesh with a large picture",
            vec![
                "mesh",
                &volume,
                &mesh,
                "--iso",
                "0",
                "--picture",
                &picture,
                "--picture-size",
                "6000x6000",
            ],
        ),
        ("slice", vec!["slice", &volume, &png, "--axis", "x"]),
        (
            "slice enlarged",
            vec!["slice", &volume, &png, "--axis", "z", "--scale", "16"],
        ),
        (
            "slice in any direction",
            vec!["slice", &volume, &png, "--normal", "1,2,3", "--iso", "0"],
        ),
        (
            "mesh in colours",
            vec!["mesh", &volume, &mesh, "--iso", "0", "--color", &wood],
        ),
        (
            "mesh in the colours of a map",
            vec!["mesh", &volume, &mesh, "--iso", "0", "--color", &volume],
        ),
        ("check", vec!["check", &ply]),
        ("demo", vec!["demo", &folder, "--size", "128"]),
    ];
    // One through the surface, by walking it.
    let seed = seed_of(&volume);
    commands.push((
        "mesh from a seed",
        vec!["mesh", &volume, &mesh, "--iso", "0", "--seed", &seed],
    ));
    let mut refusals = 0;
    for (what, words) in &commands {
        let writes = !matches!(words[0], "info" | "verify" | "check");
        let mut peaks = Vec::new();
        for mib in MIB {
            let mem = format!("{mib}MiB");
            let mut limits = vec!["--mem", &mem, "--quiet"];
            limits.extend(writes.then_some("--overwrite"));
            let peak =
                within_or_refused(seen(|| brickmarch(words.iter().chain(&limits))), mib, what);
            // More memory must not be refused where less was enough.
            let before = peaks.last().copied().flatten();
            assert!(peak.is_some() || before.is_none(), "{what} at {mib} MiB");
            refusals += u32::from(peak.is_none());
            peaks.push(peak);
        }
        let said = peaks
            .iter()
            .map(|p| p.map_or("refused".into(), |p: u64| p.to_string()));
        let said: Vec<String> = said.collect();
        figure(&format!(
            "peak resident MiB of {what}, gyroid 256^3, budgets {MIB:?} MiB: {}",
            said.join(", ")
        ));
    }
    // A mesh of 100 MB cannot be checked in 24 MiB: the way of refusing is looked at too.
    assert!(refusals > 0);
    // Without a budget of their own: the smallest one must do.
    for words in [
        vec!["completions", "bash"],
        vec!["man", &man],
        vec!["--help"],
    ] {
        within(seen(|| brickmarch(&words)), MIB[0], words[0]);
    }
}

/// A cell of the volume that the isosurface of 0 crosses, as `--seed` wants it.
fn seed_of(volume: &str) -> String {
    let volume = Volume::open(volume.as_ref(), &Budget::mib(64)).expect("it was written");
    let region = Box3::from_size([64, 1, 1]);
    let mut values = vec![0.0; 64];
    volume
        .read(region, &mut Samples::dense(&mut values, region))
        .expect("sound");
    let crossed = values
        .windows(2)
        .position(|w| (w[0] >= 0.0) != (w[1] >= 0.0));
    format!("{},0,0", crossed.expect("a gyroid crosses every row"))
}
