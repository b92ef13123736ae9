//! Bricks of 16^3 against 32^3, end to end: file size, time to write, to mesh (triangles counted and
//! thrown away), and to read a 64^3 region from a file opened anew. The table in docs/why.md.

use brickmarch::iso::{Extract, extract};
use brickmarch::mesh::Count;
use brickmarch::store::{Volume, VolumeSpec, import_stream, write_field};
use brickmarch::{Box3, Budget, Field, Kind};
use brickmarch_data_gen::{Rng, Scene, SceneField, SceneName};
use std::path::{Path, PathBuf};
use std::time::Instant;

const EDGES: [u32; 2] = [16, 32];
const RUNS: usize = 5;

pub(crate) fn run() {
    let folder = tempfile::tempdir().expect("scratch folder");
    println!(
        "| field | edge | file MiB | write s | mesh 1 thread s | mesh 2 threads s | region 64^3 ms |"
    );
    println!("|---|---|---|---|---|---|---|");
    for (name, n) in [
        (SceneName::LevelSetSphere, 1024),
        (SceneName::LevelSetGyroid, 512),
        (SceneName::Gyroid, 512),
        (SceneName::Ct, 256),
    ] {
        let scene = Scene::new(name, n).expect("a good size");
        let iso = scene.iso();
        let background = f64::from(scene.background());
        let field = SceneField::new(scene);
        compare(&format!("{name} {n}"), iso, |edge| {
            let path = folder.path().join(format!("{name}{edge}.bvol"));
            let spec = VolumeSpec {
                kind: field.kind(),
                background,
                brick_edge: edge,
                ..VolumeSpec::new(*field.grid(), field.sample_type())
            };
            write_field(&field, &spec, &path, &Budget::mib(64)).expect("writes");
            path
        });
    }
    for (name, iso) in [
        ("ct_abdomen_512x512x275_u8.nrrd", 31.5),
        ("bentheimer_500_binary.nrrd", 0.5),
    ] {
        let Some(scan) = scan(name) else {
            println!("SKIPPED: {name}: set BRICKMARCH_DATA to the folder of the real scans");
            continue;
        };
        compare(name, iso, |edge| {
            let path = folder.path().join(format!("{name}{edge}.bvol"));
            let source =
                brickmarch_formats::open_volume(&scan, &Default::default()).expect("opens");
            let spec = VolumeSpec {
                kind: Kind::Density,
                brick_edge: edge,
                ..VolumeSpec::new(source.grid, source.sample)
            };
            let mut reader = source.reader;
            import_stream(&mut reader, &spec, &path, &Budget::mib(64)).expect("imports");
            path
        });
    }
}

fn scan(name: &str) -> Option<PathBuf> {
    let data = PathBuf::from(std::env::var_os("BRICKMARCH_DATA")?);
    Some(data.join("volumes").join(name)).filter(|path| path.exists())
}

fn compare(name: &str, iso: f32, write: impl Fn(u32) -> PathBuf) {
    let mut answers = Vec::new();
    for edge in EDGES {
        let start = Instant::now();
        let path = write(edge);
        let wrote = start.elapsed().as_secs_f64();
        let (one, triangles) = mesh(&path, iso, 1);
        let (two, _) = mesh(&path, iso, 2);
        answers.push(triangles);
        let size = std::fs::metadata(&path).expect("written").len() as f64 / (1 << 20) as f64;
        println!(
            "| {name} | {edge} | {size:.1} | {wrote:.2} | {one:.2} | {two:.2} | {:.2} |",
            region(&path)
        );
    }
    assert_eq!(
        answers[0], answers[1],
        "the mesh does not depend on the brick edge"
    );
}

/// Median seconds, and triangles.
fn mesh(path: &Path, iso: f32, threads: usize) -> (f64, u64) {
    let mut triangles = 0;
    let times = (0..RUNS).map(|_| {
        let budget = Budget::mib(64).with_threads(threads);
        let start = Instant::now();
        let volume = Volume::open(path, &budget).expect("opens");
        let options = Extract {
            iso,
            ..Extract::default()
        };
        triangles = extract(&volume, &options, &budget, &mut Count::default())
            .expect("meshes")
            .triangles;
        start.elapsed().as_secs_f64()
    });
    (median(times.collect()), triangles)
}

/// Median milliseconds of random boxes, the file opened for each.
fn region(path: &Path) -> f64 {
    let mut rng = Rng::new(1);
    let times = (0..200).map(|_| {
        let start = Instant::now();
        let volume = Volume::open(path, &Budget::mib(64)).expect("opens");
        let domain = volume.grid().domain;
        let low: [i32; 3] =
            std::array::from_fn(|a| rng.below(u64::from(domain.size()[a]) - 64) as i32);
        let region = Box3::new(low, low.map(|v| v + 64));
        let mut out = vec![0; region.count() as usize * volume.spec().sample.bytes()];
        volume.read_raw(region, &mut out).expect("reads");
        start.elapsed().as_secs_f64() * 1e3
    });
    median(times.collect())
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}
