//! Every scene of the gallery reads; every kind of mistake is one error with line and remedy.

use super::Scene;
use brickmarch::Budget;
use brickmarch::model::Model;
use std::path::Path;

fn read(text: &str) -> Result<Scene, String> {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("s.toml");
    std::fs::write(&path, text).expect("written");
    Scene::read(&path, &Budget::mib(64)).map_err(|e| {
        let message = e.to_string();
        message.replace(&format!("{}/", dir.path().display()), "")
    })
}

fn scene(rest: &str) -> String {
    format!("bounds = {{ min = [-1, -1, -1], max = [1, 1, 1] }}\n{rest}")
}

#[test]
fn every_scene_of_the_gallery_reads_and_has_an_inside_and_an_outside() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../data-gen/scenes");
    let mut count = 0;
    for entry in std::fs::read_dir(folder).expect("the gallery") {
        let path = entry.expect("readable").path();
        if path.extension().is_none_or(|e| e != "toml") {
            continue;
        }
        let scene = Scene::read(&path, &Budget::mib(64)).expect("reads");
        let model = Model::new(&scene.shape, scene.lattice(24).expect("a lattice"));
        let model = model.expect("a model");
        let (side, iso) = (model.convention().inside(), model.convention().iso());
        let [low, high] = scene.bounds;
        let mut seen = [false; 2];
        for i in 0..15u32.pow(3) {
            let at = [i % 15, i / 15 % 15, i / 225];
            let p = [0, 1, 2].map(|a| low[a] + (high[a] - low[a]) * f64::from(at[a]) / 14.0);
            let value = model.value(p).expect("reads") as f32;
            seen[usize::from(side.contains(value, iso))] = true;
        }
        assert_eq!(seen, [true; 2], "{}", path.display());
        count += 1;
    }
    assert!(count >= 12, "{count} scenes");
}

#[test]
fn parameters_parts_and_includes_work_together() {
    let dir = tempfile::tempdir().expect("a folder");
    let inner = "[parameters]\nd = 1\nr = \"d/2\"\n[model]\nshape = \"sphere\"\nradius = \"r\"\n";
    std::fs::write(dir.path().join("ball.toml"), inner).expect("written");
    let outer = scene(
        "include = [{ file = \"ball.toml\", as = \"small\", set = { d = 0.4 } }, \"ball.toml\"]\n\
         [model]\ndifference = [\"ball\", { use = \"small\", move = [0.5, 0, 0] }]\n",
    );
    let path = dir.path().join("s.toml");
    std::fs::write(&path, outer).expect("written");
    let scene = Scene::read(&path, &Budget::mib(64)).expect("reads");
    let model = Model::new(&scene.shape, scene.lattice(16).expect("a lattice")).expect("a model");
    let value = |x: f64| model.value([x, 0.0, 0.0]).expect("reads");
    assert!((value(-0.3) + 0.2).abs() < 1e-12);
    assert!((value(0.5) - 0.2).abs() < 1e-12);
}

#[test]
fn every_mistake_is_one_error_with_its_line_and_a_remedy() {
    let ball = "[parts.a]\nshape = \"sphere\"\nradius = 1\n";
    let model = "[model]\nuse = \"a\"\n";
    for (text, line, words) in [
        ("bounds = [".to_string(), 1, "TOML"),
        (
            "[model]\nshape = \"sphere\"\nradius = 1\n".to_string(),
            1,
            "'bounds' is missing",
        ),
        (
            "bounds = { min = [0, 0, 0], max = [0, 1, 1] }\n".to_string(),
            1,
            "empty",
        ),
        (scene(""), 1, "no [model]"),
        (
            scene("colour = 1\n[model]\nshape = \"sphere\"\nradius = 1\n"),
            2,
            "unknown key 'colour'",
        ),
        (scene("units = \"inch\"\n"), 2, "give one of none, um"),
        (scene("resolution = 0\n"), 2, "at least 1"),
        (scene("[model]\nshape = \"spere\"\n"), 3, "sphere"),
        (
            scene("[model]\nshape = \"sphere\"\n"),
            2,
            "'radius' is missing",
        ),
        (
            scene("[model]\nshape = \"sphere\"\nradius = \"q\"\n"),
            4,
            "'q' is not defined",
        ),
        (
            scene("[model]\nshape = \"sphere\"\nradius = \"1 +\"\n"),
            4,
            "character",
        ),
        (
            scene("[model]\nshape = \"sphere\"\nradius = \"x\"\n"),
            4,
            "parameters only",
        ),
        (
            scene("[model]\nshape = \"sphere\"\nradius = true\n"),
            4,
            "give a number",
        ),
        (
            scene("[model]\nshape = \"sphere\"\nradius = nan\n"),
            4,
            "finite",
        ),
        (
            scene("[model]\nshape = \"sphere\"\nradius = -1\n"),
            2,
            "above 0",
        ),
        (
            scene("[model]\nshape = \"sphere\"\nradius = 1\nsize = 2\n"),
            5,
            "unknown key 'size'",
        ),
        (
            scene("[model]\nshape = \"box\"\nsize = [1, 2]\n"),
            4,
            "list of 3",
        ),
        (scene("[model]\nunion = []\n"), 3, "at least one"),
        (scene("[model]\nunion = 3\n"), 3, "list of parts"),
        (scene("[model]\nunion = [3]\n"), 3, "name of a part"),
        (
            scene("[model]\nunion = [\"b\"]\n"),
            3,
            "no part is called 'b'",
        ),
        (
            scene("[model]\nuse = \"b.c\"\n"),
            3,
            "no part is called 'b.c'",
        ),
        (scene("[model]\ncolor = \"#123456\"\n"), 2, "says nothing"),
        (
            scene("[model]\nuse = \"a\"\nshape = \"box\"\n"),
            2,
            "only one",
        ),
        (
            scene(&format!("{ball}color = \"red\"\n{model}")),
            5,
            "#rrggbb",
        ),
        (
            scene(&format!("{ball}color = [1, 2, 3]\n{model}")),
            5,
            "from 0 to 1",
        ),
        (scene(&format!("{ball}rotate = 3\n{model}")), 5, "list of 3"),
        (
            scene(&format!("{ball}mirror = \"w\"\n{model}")),
            5,
            "x, y, z",
        ),
        (
            scene(&format!("{ball}transform = [3]\n{model}")),
            5,
            "no table",
        ),
        (
            scene(&format!("{ball}around = 2.5\n{model}")),
            5,
            "whole number",
        ),
        (
            scene(&format!("{ball}convert = \"distance\"\nslope = 1\n{model}")),
            2,
            "takes a level",
        ),
        (
            scene("[parts.a]\nuse = \"b\"\n[parts.b]\nuse = \"a\"\n[model]\nuse = \"a\"\n"),
            5,
            "break the circle",
        ),
        (
            scene("[parameters]\na = \"b\"\nb = \"a\"\n[model]\n"),
            3,
            "not defined",
        ),
        (scene("include = [\"none.toml\"]\n"), 2, "cannot include"),
        (scene("include = [\"s.toml\"]\n"), 2, "includes itself"),
        (
            scene("[model]\nshape = \"volume\"\nfile = \"none.bvol\"\niso = 1\n"),
            4,
            "none.bvol",
        ),
        (
            scene("[model]\nshape = \"extrude\"\nheight = 1\n"),
            2,
            "outline",
        ),
        (
            scene(
                "[model]\nshape = \"extrude\"\nheight = 1\ntext = \"\u{e4}\"\npen = 1\nsize = 1\n",
            ),
            2,
            "no letter",
        ),
        (
            scene("[model]\nshape = \"polynomial\"\nterms = [[1, 0.5, 0, 0]]\n"),
            4,
            "whole exponents",
        ),
        (
            scene("[model]\nshape = \"heights\"\nvalues = [[1, 2], [1]]\n"),
            4,
            "same number",
        ),
        (
            scene(
                "[model]\nunion = [{ shape = \"gyroid\", period = 1 }, { shape = \"sphere\", radius = 1 }]\nsmooth = 1\n",
            ),
            2,
            "slope",
        ),
    ] {
        let error = read(&text).expect_err(&text);
        assert!(
            error.starts_with(&format!("s.toml:{line}: ")),
            "line {line} expected: {error}"
        );
        assert!(error.contains(words), "'{words}' expected: {error}");
        assert!(!error.contains('\n'), "one line: {error}");
    }
}

#[test]
fn scenes_that_multiply_themselves_are_stopped() {
    let mut text = String::from("[parts.p0]\nshape = \"sphere\"\nradius = 0.5\n");
    for n in 1..60 {
        text.push_str(&format!(
            "[parts.p{n}]\nunion = [\"p{}\", \"p{}\"]\n",
            n - 1,
            n - 1
        ));
    }
    text.push_str("[model]\nuse = \"p59\"\n");
    let error = read(&scene(&text)).expect_err("too many");
    assert!(error.contains("repeat"), "{error}");
    let deep = format!(
        "[model]\n{}{}\n",
        "union = [{ ".repeat(300),
        " }]".repeat(300)
    );
    assert!(read(&scene(&deep)).is_err());
}

/// The mesh of a scene of the gallery.
fn gallery_mesh(name: &str, resolution: u32) -> brickmarch::Mesh {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../data-gen/scenes");
    let path = folder.join(format!("{name}.toml"));
    let budget = Budget::mib(256);
    let scene = Scene::read(&path, &budget).expect("reads");
    let grid = scene.lattice(resolution).expect("a lattice");
    let model = Model::new(&scene.shape, grid).expect("a model");
    let options = brickmarch::iso::Extract {
        iso: model.convention().iso(),
        ..Default::default()
    };
    let mut sink = brickmarch::mesh::Collect::default();
    brickmarch::iso::extract(&model, &options, &budget, &mut sink).expect("meshes");
    sink.into_mesh()
}

/// Genus of one closed surface, from its Euler characteristic.
fn genus(mesh: &brickmarch::Mesh) -> i64 {
    let (v, f) = (mesh.positions.len() as i64, mesh.triangles.len() as i64);
    assert_eq!(f % 2, 0, "closed");
    1 - (v - f / 2) / 2
}

#[test]
fn meshes_of_scenes_are_closed_with_the_known_genus() {
    for (name, resolution, wanted) in [
        ("sphere", 32, 0),
        ("torus", 32, 1),
        ("csg", 48, 5),
        ("tanglecube", 48, 5),
        ("machine_part", 96, 5),
        ("metaballs", 48, 0),
    ] {
        let mesh = gallery_mesh(name, resolution);
        let mut sides = std::collections::BTreeMap::new();
        for &[a, b, c] in &mesh.triangles {
            for side in [(a, b), (b, c), (c, a)] {
                *sides.entry(side).or_insert(0) += 1;
            }
        }
        let closed = sides
            .iter()
            .all(|(&(a, b), &n)| n == 1 && sides.get(&(b, a)) == Some(&1));
        assert!(
            closed,
            "{name}: every side has one partner in the other direction"
        );
        assert_eq!(genus(&mesh), wanted, "{name}");
    }
}

#[test]
fn errors_of_volume_and_area_fall_with_the_square_of_the_step() {
    use std::f64::consts::PI;
    for (name, volume, area) in [
        ("sphere", 4.0 / 3.0 * PI, 4.0 * PI),
        (
            "torus",
            2.0 * PI * PI * 0.8 * 0.09,
            4.0 * PI * PI * 0.8 * 0.3,
        ),
    ] {
        let errors = [32, 64, 128].map(|n| {
            let mesh = gallery_mesh(name, n);
            [
                (brickmarch::mesh::measure::volume(&mesh) - volume).abs() / volume,
                (brickmarch::mesh::measure::area(&mesh) - area).abs() / area,
            ]
        });
        for which in 0..2 {
            let fall = errors[0][which] / errors[2][which];
            // Two halvings: 16 times; rougher where the surface cuts the lattice differently.
            assert!((10.0..26.0).contains(&fall), "{name}: {errors:?}");
        }
    }
}
