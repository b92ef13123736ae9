//! Every scene of the gallery through the real program: closed 2-manifold meshes, and the volume,
//! area and genus that are known from other sources than the engine.

use super::words;
use crate::support::data::workspace;
use crate::support::program::brickmarch;
use crate::support::scratch::Scratch;
use serde_json::Value;
use std::f64::consts::PI;

/// The report of `check` about the mesh of a scene.
fn report(scratch: &Scratch, scene: &str, resolution: u32) -> Value {
    let line = format!("model {scene} @out.ply --resolution {resolution} --overwrite -q");
    brickmarch(words(scratch, &line)).success();
    let line = "check @out.ply --crossings none --json -q";
    brickmarch(words(scratch, line)).success().json()["report"].take()
}

fn gallery(name: &str) -> String {
    let path = workspace().join(format!("data-gen/scenes/{name}.toml"));
    path.to_string_lossy().into_owned()
}

/// Components and genus of each scene where it follows from what the scene says, at a resolution
/// that shows it.
///
/// Not asked, since nobody counted them: the tunnels of the heat exchanger's gyroid, of the sextic
/// around its double points, of the cubic, of the bone, and of the flange, where holes graze the shaft.
const KNOWN: [(&str, u32, u64, u64); 12] = [
    ("sphere", 32, 1, 0),
    ("torus", 32, 1, 1),
    // A cube with three holes that meet.
    ("csg", 48, 1, 5),
    // Eight bulges on the corners of a cube, joined along its twelve edges: 12 - 8 + 1.
    ("tanglecube", 48, 1, 5),
    // A bore, and four screw holes.
    ("machine_part", 96, 1, 5),
    ("metaballs", 48, 1, 0),
    ("power_blend", 48, 1, 0),
    ("soft", 64, 1, 0),
    // Two balls with a gap between them, wider than a cell only here.
    ("contact", 384, 2, 0),
    // Letters and a frame on a plate: pits, no holes.
    ("letters", 96, 1, 0),
    // The tunnel of the road.
    ("terrain", 64, 1, 1),
    // The room inside opens at both ends of the seat tube and where the top tube leaves the bounds:
    // three openings, two handles. The stays are solid.
    ("bicycle_joint", 96, 1, 2),
];

#[test]
fn meshes_of_every_scene_are_closed_manifolds_of_the_known_genus() {
    let scratch = Scratch::new("gallery");
    let folder = workspace().join("data-gen/scenes");
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .expect("the gallery")
        .map(|e| {
            e.expect("readable")
                .file_name()
                .to_string_lossy()
                .into_owned()
        })
        .filter_map(|name| name.strip_suffix(".toml").map(str::to_string))
        .collect();
    names.sort();
    assert!(names.len() >= 17, "{names:?}");
    let mut problems = Vec::new();
    for name in &names {
        let known = KNOWN.iter().find(|k| k.0 == name);
        let report = report(&scratch, &gallery(name), known.map_or(56, |k| k.1));
        let sound = ["closed", "manifold", "oriented"]
            .iter()
            .all(|k| report[k] == true);
        if !sound || report["degenerate_triangles"] != 0 {
            problems.push(format!("{name}: {report}"));
        }
        if let Some(&(_, _, components, genus)) = known
            && (report["components"] != components || report["genus"] != genus)
        {
            problems.push(format!(
                "{name}: {components} components of genus {genus} expected: {report}"
            ));
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

/// Volume by columns along z, whose length above (x, y) is known: the midpoint rule, whose error is
/// far below that of the meshes.
fn columns(half: f64, length: impl Fn(f64, f64) -> f64) -> f64 {
    const N: usize = 2000;
    let step = half / N as f64;
    let at = |i: usize| (i as f64 + 0.5) * step;
    // A quarter: the solids here are symmetric.
    let sum: f64 = (0..N * N).map(|i| length(at(i % N), at(i / N))).sum();
    4.0 * sum * step * step
}

/// Length of a column of the box and the ball without three rods.
fn csg_column(x: f64, y: f64) -> f64 {
    let (ball, rod) = (1.32f64 * 1.32, 0.25);
    let flat = x * x + y * y;
    if flat < rod || flat > ball {
        return 0.0;
    }
    let high = (ball - flat).sqrt().min(1.0);
    let low = (rod - x * x).max(rod - y * y).max(0.0).sqrt();
    2.0 * (high - low).max(0.0)
}

/// Length of a column of `t(x) + t(y) + t(z) + 11.8 < 0`, `t(a) = a^4 - 5 a^2`.
fn tanglecube_column(x: f64, y: f64) -> f64 {
    let t = |a: f64| a.powi(4) - 5.0 * a * a;
    let under = 25.0 - 4.0 * (t(x) + t(y) + 11.8);
    if under <= 0.0 {
        return 0.0;
    }
    let ends = [-1.0, 1.0].map(|s| (0.5 * (5.0 + s * under.sqrt())).max(0.0).sqrt());
    2.0 * (ends[1] - ends[0])
}

/// The bearing block by elementary geometry.
fn machine_part_volume() -> f64 {
    // A box with rounded edges: its core, slabs on the faces, quarters of rods and of a ball.
    let (core, r) = ([72.0, 72.0, 8.0], 4.0);
    let [a, b, c] = core;
    let plate = a * b * c
        + 2.0 * r * (a * b + b * c + c * a)
        + PI * r * r * (a + b + c)
        + 4.0 / 3.0 * PI * r * r * r;
    let barrel = PI * 24.0 * 24.0 * 46.0;
    // Between the corner and a quarter of a circle, turned around the barrel (Pappus).
    let fillet = |r: f64, at: f64| {
        2.0 * PI * (at * r * r * (1.0 - PI / 4.0) + r * r * r * (5.0 / 6.0 - PI / 4.0))
    };
    let bore = PI * 14.0 * 14.0 * 62.0;
    let holes = 4.0 * PI * 4.5 * 4.5 * 16.0;
    // The part of a disk within 4 of its middle line.
    let strip = |r: f64| 2.0 * (4.0 * (r * r - 16.0).sqrt() + r * r * (4.0 / r).asin());
    let slot = 21.0 * (strip(24.0) - strip(14.0));
    plate + barrel + fillet(6.0, 24.0) - bore - holes - slot
}

/// Primitives, turned so that no face lies in the lattice: text of the shape, volume, and area where
/// the surface is smooth (cells cut edges, which costs area in the first order of their size).
fn primitives() -> Vec<(&'static str, f64, Option<f64>)> {
    let cap = 4.0 * PI * 0.16;
    vec![
        (
            "shape = \"sphere\"\nradius = 0.8",
            4.0 / 3.0 * PI * 0.512,
            Some(4.0 * PI * 0.64),
        ),
        (
            "shape = \"quadratic-sphere\"\nradius = 0.8",
            4.0 / 3.0 * PI * 0.512,
            Some(4.0 * PI * 0.64),
        ),
        (
            "shape = \"ellipsoid\"\nradii = [0.9, 0.5, 0.6]",
            4.0 / 3.0 * PI * 0.27,
            None,
        ),
        (
            "shape = \"box\"\nsize = [1.1, 0.9, 0.7]",
            1.1 * 0.9 * 0.7,
            None,
        ),
        (
            "shape = \"cylinder\"\nradius = 0.5\nheight = 1.1",
            PI * 0.25 * 1.1,
            None,
        ),
        (
            "shape = \"capsule\"\nfrom = [-0.5, 0, 0]\nto = [0.4, 0.2, 0]\nradius = 0.4",
            0.85f64.sqrt() * PI * 0.16 + 4.0 / 3.0 * PI * 0.064,
            Some(0.85f64.sqrt() * 2.0 * PI * 0.4 + cap),
        ),
        (
            "shape = \"cone\"\nbottom = 0.7\ntop = 0.3\nheight = 1.2",
            PI * 1.2 / 3.0 * (0.49 + 0.21 + 0.09),
            None,
        ),
        (
            "shape = \"torus\"\nmajor = 0.7\nminor = 0.25",
            2.0 * PI * PI * 0.7 * 0.0625,
            Some(4.0 * PI * PI * 0.7 * 0.25),
        ),
        (
            "shape = \"extrude\"\ncontours = [[[-0.7, -0.5], [0.7, -0.5], [0, 0.7]]]\nheight = 0.9",
            0.5 * 1.4 * 1.2 * 0.9,
            None,
        ),
        (
            // A disk around (0.6, 0), turned: a torus again.
            "shape = \"revolve\"\nlines = [[[0.6, 0.1]]]\npen = 0.5",
            2.0 * PI * PI * 0.6 * 0.0625,
            Some(4.0 * PI * PI * 0.6 * 0.25),
        ),
        (
            "shape = \"formula\"\nvalue = \"x^4 + y^4 + z^4 - 0.3\"",
            // 8 Gamma(5/4)^3 / Gamma(7/4) c^3, c^4 = 0.3
            6.481_987_351_786_965 * 0.3f64.powf(0.75),
            None,
        ),
        (
            // A wall around a ball, and the ball moved out.
            "shape = \"sphere\"\nradius = 0.6\nshell = 0.2\noffset = 0.05",
            4.0 / 3.0 * PI * (0.421_875 - 0.091_125),
            Some(4.0 * PI * (0.5625 + 0.2025)),
        ),
    ]
}

/// Relative errors against the known values at three resolutions, each twice the one before.
fn errors(scratch: &Scratch, scene: &str, first: u32, key: &str, known: f64) -> [f64; 3] {
    [1, 2, 4].map(|times| {
        let found = report(scratch, scene, first * times)[key].as_f64();
        (found.expect("a number") / known - 1.0).abs()
    })
}

#[test]
fn errors_of_volumes_and_areas_fall_with_the_square_of_the_step() {
    let scratch = Scratch::new("gallery-errors");
    let mut cases = vec![
        (gallery("sphere"), 32, "volume", 4.0 / 3.0 * PI),
        (gallery("sphere"), 32, "area", 4.0 * PI),
        (gallery("torus"), 32, "volume", 2.0 * PI * PI * 0.8 * 0.09),
        (gallery("torus"), 32, "area", 4.0 * PI * PI * 0.8 * 0.3),
        (gallery("csg"), 48, "volume", columns(1.0, csg_column)),
        (
            gallery("tanglecube"),
            48,
            "volume",
            columns(2.6, tanglecube_column),
        ),
        (gallery("machine_part"), 64, "volume", machine_part_volume()),
    ];
    for (n, (text, volume, area)) in primitives().into_iter().enumerate() {
        let name = format!("p{n}.toml");
        let bounds = "bounds = { min = [-1.3, -1.31, -1.27], max = [1.3, 1.31, 1.27] }";
        let scene = format!("{bounds}\n[model]\n{text}\nrotate = [23, 31, 12]\n");
        let path = scratch.write(&name, scene).to_string_lossy().into_owned();
        cases.push((path.clone(), 32, "volume", volume));
        cases.extend(area.map(|area| (path, 32, "area", area)));
    }
    let mut problems = Vec::new();
    for (scene, first, key, known) in cases {
        let found = errors(&scratch, &scene, first, key, known);
        // Two halvings should make it 16 times smaller; the cut of the lattice varies a little.
        let fall = found[0] / found[2];
        if !(fall > 9.0 && found[2] < 2e-3) {
            let text = std::fs::read_to_string(&scene).unwrap_or_default();
            let text = text.lines().skip(1).collect::<Vec<_>>().join("; ");
            problems.push(format!(
                "{key} of {scene} ({text}): {found:?} of {known}, {fall}"
            ));
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}
