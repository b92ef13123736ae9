//! The command line: files hold the scene, appear whole or not at all, and stay in the budget.

use brickmarch::store::Volume;
use brickmarch::{Budget, Field, Samples};
use brickmarch_data_gen::texture::Painter;
use brickmarch_data_gen::{Scene, SceneName};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A folder that goes away with the test.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).expect("a scratch folder");
        Self(path)
    }

    fn run(&self, arguments: &str) -> Output {
        Command::new(env!("CARGO_BIN_EXE_brickmarch-data-gen"))
            .args(arguments.split(' '))
            .current_dir(&self.0)
            .output()
            .expect("the program starts")
    }

    fn ok(&self, arguments: &str) -> String {
        let output = self.run(arguments);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{arguments}: {error}");
        String::from_utf8(output.stdout).expect("text")
    }

    fn refused(&self, arguments: &str) -> String {
        let output = self.run(arguments);
        assert!(!output.status.success(), "{arguments} should be refused");
        String::from_utf8_lossy(&output.stderr).into_owned()
    }

    fn files(&self) -> Vec<String> {
        let entries = fs::read_dir(&self.0).expect("the scratch folder");
        let name = |e: fs::DirEntry| e.file_name().to_string_lossy().into_owned();
        entries.map(|e| name(e.expect("an entry"))).collect()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Samples of a scene in lattice order.
fn samples(scene: &Scene) -> Vec<f32> {
    let [nx, ny, nz] = scene.size();
    let mut all = vec![0.0; (nx * ny * nz) as usize];
    for (n, row) in (0u32..).zip(all.chunks_mut(nx as usize)) {
        scene.fill_row(n % ny, n / ny, 0, row);
    }
    all
}

#[test]
fn raw_files_hold_the_samples() {
    let scratch = Scratch::new("raw");
    let size = [37, 20, 45];
    for name in SceneName::ALL {
        let scene = Scene::with_size(name, size).expect("a size");
        // Few threads and many, a chunk of all rows and of one.
        for more in ["--threads 1", "--threads 7 --mem 8KiB"] {
            let arguments =
                format!("field {name} --size 37,20,45 --type f32 --out a.raw --overwrite {more}");
            scratch.ok(&arguments);
            let bytes = fs::read(scratch.0.join("a.raw")).expect("the file");
            let expected: Vec<u8> = samples(&scene)
                .iter()
                .flat_map(|v| v.to_le_bytes())
                .collect();
            assert!(bytes == expected, "{arguments}");
        }
    }
    assert_eq!(scratch.files(), ["a.raw"]);
}

#[test]
fn integers_are_scaled_and_rounded() {
    let scratch = Scratch::new("integers");
    for (arguments, scene) in [
        ("ct --n 40", Scene::new(SceneName::Ct, 40)),
        (
            "gyroid --n 40 --type i16",
            Scene::new(SceneName::Gyroid, 40).map(|s| s.quantized(1000.0)),
        ),
        (
            "sphere --n 40 --scale -100000",
            Scene::new(SceneName::Sphere, 40).map(|s| s.quantized(-100_000.0)),
        ),
    ] {
        let scene = scene.expect("a size");
        scratch.ok(&format!("field {arguments} --out a.raw --overwrite"));
        let bytes = fs::read(scratch.0.join("a.raw")).expect("the file");
        let expected: Vec<u8> = samples(&scene)
            .iter()
            .flat_map(|&v| {
                assert_eq!(f32::from(v as i16), v, "an integer of 16 bits");
                (v as i16).to_le_bytes()
            })
            .collect();
        assert!(bytes == expected, "{arguments}");
    }
}

#[test]
fn volumes_hold_the_samples() {
    let scratch = Scratch::new("volumes");
    for (arguments, name, size) in [
        (
            "level-set gyroid --n 70",
            SceneName::LevelSetGyroid,
            [70; 3],
        ),
        (
            "level-set sphere --n 70 --brick 8",
            SceneName::LevelSetSphere,
            [70; 3],
        ),
        ("field ct --size 50,40,30", SceneName::Ct, [50, 40, 30]),
        (
            "field ct --n 40 --type f32 --brick 32",
            SceneName::Ct,
            [40; 3],
        ),
        ("field noise --n 40 --threads 1", SceneName::Noise, [40; 3]),
    ] {
        let scene = Scene::with_size(name, size).expect("a size");
        scratch.ok(&format!("{arguments} --out a.bvol --overwrite"));
        let budget = Budget::mib(64);
        let volume = Volume::open(&scratch.0.join("a.bvol"), &budget).expect("a volume");
        let domain = volume.grid().domain;
        assert_eq!(domain.size(), size);
        assert_eq!(volume.spec().name, name.name());
        assert_eq!(volume.spec().background, f64::from(scene.background()));
        let mut values = vec![f32::NAN; domain.count() as usize];
        let mut out = Samples::dense(&mut values, domain);
        volume.read(domain, &mut out).expect("the samples");
        assert!(values == samples(&scene), "{arguments}");
    }
    assert_eq!(scratch.files(), ["a.bvol"]);
    let error = scratch.refused("field ct --n 20 --out a.bvol");
    assert!(error.contains("--overwrite"), "{error}");
    let error = scratch.refused("field ct --n 20 --brick 12 --out b.bvol");
    assert!(error.contains("brick edge 12"), "{error}");
    assert_eq!(scratch.files(), ["a.bvol"]);
}

#[test]
fn refusals_say_why_and_leave_nothing() {
    let scratch = Scratch::new("refusals");
    for (arguments, reason) in [
        ("field sphere --n 1 --out a.raw", "2 to"),
        ("field sphere --n 4000000000 --out a.raw", "needs"),
        ("field sphere --n 64 --out a.txt", ".raw or .bvol"),
        ("field sphere --n 64 --out missing/a.raw", "missing"),
        ("field sphere --n 4096 --out a.raw --mem 4KiB", "--mem"),
        (
            "field sphere --n 64 --out a.raw --type f32 --scale 3",
            "--type i16",
        ),
        ("field sphere --n 64 --out a.raw --scale 0", "not zero"),
        ("field sphere --out a.raw", "--n"),
        ("field sphear --n 64 --out a.raw", "two-spheres"),
        ("field sphere --n 64 --out a.raw --mem 12XB", "MiB"),
        ("level-set torus --n 64 --out a.raw", "gyroid"),
    ] {
        let error = scratch.refused(arguments);
        assert!(error.contains(reason), "{arguments}: {error}");
        assert_eq!(scratch.files(), [""; 0], "{arguments}");
    }
    scratch.ok("level-set sphere --n 32 --out a.raw");
    let before = fs::read(scratch.0.join("a.raw")).expect("the file");
    let error = scratch.refused("field sphere --n 16 --out a.raw");
    assert!(error.contains("--overwrite"), "{error}");
    let after = fs::read(scratch.0.join("a.raw")).expect("the file");
    assert_eq!(before, after);
}

#[test]
fn answers_are_printed_as_json() {
    let scratch = Scratch::new("answers");
    let parse = |text: String| serde_json::from_str::<serde_json::Value>(&text).expect("JSON");
    let torus = parse(scratch.ok("exact torus --n 100 --json"));
    let area = torus["exact"]["area"].as_f64().expect("a number");
    assert!((area - 4.0 * std::f64::consts::PI.powi(2) * 30.0 * 12.0).abs() < 1e-6);
    assert_eq!(torus["lattice"]["capped"]["genus"], 1);
    assert_eq!(torus["lattice"]["unambiguous"], true);
    let shifted = parse(scratch.ok("exact torus --n 100 --json --iso 2 --no-lattice"));
    assert!(shifted["exact"].is_null() && shifted["lattice"].is_null());
    let text = scratch.ok("exact noise --n 64");
    assert!(
        text.contains("no formula") && text.contains("ambiguous"),
        "{text}"
    );
}

#[test]
fn textures_are_three_volumes_on_the_grid_that_was_asked_for() {
    let scratch = Scratch::new("texture");
    scratch.ok("field ct --n 40 --out ct.bvol");
    let budget = Budget::mib(16);
    let open = |name: &str, volume: &str| {
        Volume::open_named(&scratch.0.join(name), volume, &budget).expect("a volume")
    };
    let like = Volume::open(&scratch.0.join("ct.bvol"), &budget).expect("a volume");
    for texture in ["wood", "marble"] {
        let line = format!("texture {texture} --like ct.bvol --out t.bvol --period 30 --overwrite");
        scratch.ok(&format!("{line} --threads 1"));
        let first = fs::read(scratch.0.join("t.bvol")).expect("the file");
        scratch.ok(&format!("{line} --threads 5 --mem 8MiB"));
        assert!(first == fs::read(scratch.0.join("t.bvol")).expect("the file"));
        let mut painter = Painter::new(texture.parse().expect("a texture"));
        let centre = {
            let [low, high] = brickmarch_data_gen::TextureField::bounds(like.grid());
            let parts = [0.3, 0.2, 0.5];
            std::array::from_fn::<f64, 3, _>(|a| low[a] + (high[a] - low[a]) * parts[a])
        };
        for (channel, name) in ["color.r", "color.g", "color.b"].into_iter().enumerate() {
            let volume = open("t.bvol", name);
            assert_eq!(volume.grid(), like.grid());
            let region = volume.grid().domain;
            let mut values = vec![0.0; region.count() as usize];
            volume
                .read(region, &mut Samples::dense(&mut values, region))
                .expect("read");
            let mut seen = std::collections::BTreeSet::new();
            for (n, &value) in values.iter().enumerate() {
                let n = n as i32;
                let index = [n % 40, n / 40 % 40, n / 1600].map(f64::from);
                let world = like.grid().index_to_world.apply(index);
                let p = std::array::from_fn(|a| (world[a] - centre[a]) / 30.0);
                assert_eq!(
                    f64::from(value),
                    painter.colour(p)[channel].round(),
                    "{texture} {name} {n}"
                );
                seen.insert(value as u8);
            }
            assert!(seen.len() > 60, "{texture} {name}: {} values", seen.len());
        }
    }
    let error = scratch.refused("texture oak --n 9 --out x.bvol");
    assert!(error.contains("oak") && error.contains("marble"), "{error}");
    for (arguments, word) in [
        ("texture wood --n 9 --out x.raw", "x.raw"),
        ("texture wood --n 9 --out t.bvol", "--overwrite"),
        ("texture wood --n 0 --out x.bvol", "--n"),
        ("texture wood --n 9 --period 0 --out x.bvol", "--period"),
        ("texture wood --n 9 --centre 1,2 --out x.bvol", "X,Y,Z"),
        ("texture wood --like gone.bvol --out x.bvol", "gone.bvol"),
        ("texture wood --out x.bvol", "--n"),
    ] {
        let error = scratch.refused(arguments);
        assert!(error.contains(word), "{arguments}: {error}");
        assert!(!scratch.0.join("x.bvol").exists() && !scratch.0.join("x.raw").exists());
    }
}
