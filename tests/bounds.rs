//! Memory is a result: peak resident memory is at most the budget plus 48 MiB, on data that are
//! larger than the budget, as the kernel saw it from outside and as the program says itself.

use crate::support::program::{Run, brickmarch, data_gen};
use crate::support::report::figure;
use crate::support::scratch::Scratch;
use brickmarch::store::{VolumeSpec, write_field};
use brickmarch::{Budget, Field, Kind, SampleType};
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
    // Looking from outside once a millisecond may miss the last one.
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
            run(&["mesh", &volume, &mesh, "--iso", "0"]),
            mib,
            "mesh",
        ));
        peaks[2].push(within_and_said(
            run(&["export", &volume, &out]),
            mib,
            "export",
        ));
        peaks[3].push(within(
            run(&["slice", &volume, &png, "--axis", "x"]),
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
