//! `model`: scenes into volumes and meshes, and scenes that are wrong in one way each.

use super::bad_input::{case, check_all};
use super::words;
use crate::support::data::workspace;
use crate::support::program::{Run, brickmarch};
use crate::support::scratch::{Scratch, bytes, f32_bytes};
use serde_json::Value;

const BOUNDS: &str = "bounds = { min = [-1, -1, -1], max = [1, 1, 1] }\n";
const BALL: &str = "[model]\nshape = \"sphere\"\nradius = 0.7\n";

fn run(scratch: &Scratch, line: &str) -> Run {
    brickmarch(words(scratch, line)).success()
}

fn json(scratch: &Scratch, line: &str) -> Value {
    run(scratch, &format!("{line} --json -q")).json()
}

#[test]
fn resolution_and_voxel_say_the_same_in_two_ways() {
    let scratch = Scratch::new("model-size");
    scratch.write("ball.toml", format!("resolution = 20\n{BOUNDS}{BALL}"));
    let sizes = ["", "--resolution 40", "--voxel 0.05"].map(|how| {
        let found = json(
            &scratch,
            &format!("model @ball.toml @out.ply {how} --overwrite"),
        );
        assert_eq!(found["closed"], true, "{found}");
        (found["size"].clone(), bytes(&scratch.path("out.ply")))
    });
    assert_eq!(sizes[0].0, serde_json::json!([21, 21, 21]));
    assert_eq!(sizes[1].0, serde_json::json!([41, 41, 41]));
    assert!(sizes[1] == sizes[2], "the same lattice, the same bytes");
}

#[test]
fn a_volume_has_the_surface_of_the_scene() {
    let scratch = Scratch::new("model-volume");
    let scene = workspace().join("data-gen/scenes/csg.toml");
    let scene = scene.to_string_lossy();
    let direct = json(
        &scratch,
        &format!("model {scene} @direct.ply --resolution 110"),
    );
    for how in ["", "--band 5", "--full"] {
        let line = format!("model {scene} @v.bvol --resolution 110 {how} --overwrite");
        let written = json(&scratch, &line);
        let all = written["bricks"].as_u64().expect("a count");
        let evaluated = written["bricks_evaluated"].as_u64().expect("a count");
        if how == "--full" {
            assert_eq!(evaluated, all, "{written}");
        } else {
            assert!(evaluated < all, "{written}");
        }
        json(&scratch, "verify @v.bvol");
        let meshed = json(&scratch, "mesh @v.bvol @v.ply --iso 0 --overwrite");
        assert_eq!(meshed["triangles"], direct["triangles"], "{how}");
        assert!(
            bytes(&scratch.path("v.ply")) == bytes(&scratch.path("direct.ply")),
            "{how}: the mesh of the volume and the direct one differ"
        );
    }
}

#[test]
fn bytes_do_not_depend_on_threads_or_memory() {
    let scratch = Scratch::new("model-same");
    for name in ["machine_part", "heat_exchanger", "metaballs"] {
        let scene = workspace().join(format!("data-gen/scenes/{name}.toml"));
        let scene = scene.to_string_lossy();
        for out in ["out.ply", "out.bvol"] {
            let of = |how: &str| {
                let line = format!("model {scene} @{out} --resolution 70 --overwrite -q {how}");
                run(&scratch, &line);
                bytes(&scratch.path(out))
            };
            let one = of("--threads 1 --mem 64MiB");
            assert!(one == of("--threads 2 --mem 256MiB"), "{name} {out}");
        }
    }
}

#[test]
fn a_dry_run_prints_the_tree_and_writes_nothing() {
    let scratch = Scratch::new("model-dry");
    scratch.write("ball.toml", format!("{BOUNDS}{BALL}"));
    let before = scratch.listing();
    let line = "model @ball.toml @out.ply --resolution 100 --dry-run";
    let text = run(&scratch, line).stdout;
    assert!(text.contains("Sphere { radius: 0.7 }"), "{text}");
    assert!(text.contains("of 343 blocks"), "{text}");
    let found = json(&scratch, line);
    assert!(
        found["blocks"].as_u64() < found["blocks_all"].as_u64(),
        "{found}"
    );
    assert_eq!(before, scratch.listing());
}

#[test]
fn a_dry_run_of_a_volume_counts_the_bricks_that_are_evaluated() {
    let scratch = Scratch::new("model-dry-volume");
    for name in ["machine_part", "barth_sextic", "metaballs"] {
        let scene = workspace().join(format!("data-gen/scenes/{name}.toml"));
        let scene = scene.to_string_lossy();
        for how in ["", "--band 5", "--full"] {
            let line = format!("model {scene} @v.bvol --resolution 100 --overwrite {how}");
            let expected = json(&scratch, &format!("{line} --dry-run"));
            let written = json(&scratch, &line);
            assert_eq!(expected["bricks_all"], written["bricks"], "{name} {how}");
            assert_eq!(
                expected["bricks"], written["bricks_evaluated"],
                "{name} {how}: {expected}"
            );
        }
    }
}

#[test]
fn colours_follow_the_parts() {
    let scratch = Scratch::new("model-colours");
    let two = "[model]\nunion = [\n\
        { shape = \"sphere\", radius = 0.4, move = [-0.5, 0, 0], color = \"#ff0000\" },\n\
        { shape = \"sphere\", radius = 0.4, move = [0.5, 0, 0], color = \"#0000ff\" }]\n";
    scratch.write("two.toml", format!("{BOUNDS}{two}"));
    run(
        &scratch,
        "model @two.toml @two.ply --resolution 16 --colors -q",
    );
    let content = bytes(&scratch.path("two.ply"));
    let end = b"end_header\n";
    let at = content
        .windows(end.len())
        .position(|w| w == end)
        .expect("a header")
        + end.len();
    let header = String::from_utf8_lossy(&content[..at]);
    let count = header
        .lines()
        .find_map(|l| l.strip_prefix("element vertex "));
    let count: usize = count.and_then(|c| c.parse().ok()).expect("a count");
    assert!(header.contains("property uchar red"), "{header}");
    let stride = 15;
    let mut seen = [0; 2];
    for vertex in content[at..].chunks(stride).take(count) {
        let x = f32::from_le_bytes(vertex[..4].try_into().expect("four bytes"));
        let wanted: [u8; 3] = if x < 0.0 { [255, 0, 0] } else { [0, 0, 255] };
        assert_eq!(vertex[12..15], wanted, "at {x}");
        seen[usize::from(x < 0.0)] += 1;
    }
    assert!(seen[0] > 20 && seen[1] > 20, "{seen:?}");
}

/// Every sample of a named volume of `v.bvol`, and its size.
fn samples(scratch: &Scratch, volume: &str) -> Vec<f32> {
    let line = format!("export @v.bvol @v.raw --name {volume} --overwrite -q");
    run(scratch, &line);
    let content = bytes(&scratch.path("v.raw"));
    if volume.starts_with("color") {
        return content.into_iter().map(f32::from).collect();
    }
    let (values, rest) = content.as_chunks::<4>();
    assert!(rest.is_empty());
    values.iter().map(|&v| f32::from_le_bytes(v)).collect()
}

/// Colours and attributes of a volume file are those of the nearer ball, at every sample with
/// `--full`, and beside the surface without.
#[test]
fn a_volume_has_colours_and_attributes_beside_it() {
    let scratch = Scratch::new("model-colour-volumes");
    let two = "[model]\nunion = [\n\
        { shape = \"sphere\", radius = 0.4, move = [-0.5, 0, 0], color = \"#ff8000\", attributes = { heat = 2.5 } },\n\
        { shape = \"sphere\", radius = 0.3, move = [0.5, 0, 0], color = \"#0000ff\" }]\n";
    scratch.write("two.toml", format!("{BOUNDS}{two}"));
    let n = 81usize;
    let channels = [
        ("color.r", [255.0, 0.0], 204.0),
        ("color.g", [128.0, 0.0], 204.0),
        ("color.b", [0.0, 255.0], 204.0),
        ("heat", [2.5, 0.0], 0.0),
    ];
    for how in ["--full", ""] {
        run(
            &scratch,
            &format!("model @two.toml @v.bvol --resolution 80 --colors -q --overwrite {how}"),
        );
        json(&scratch, "verify @v.bvol");
        for (name, colours, default) in channels {
            let got = samples(&scratch, name);
            assert_eq!(got.len(), n * n * n);
            let (mut near, mut plain) = (0, 0);
            for (i, &value) in got.iter().enumerate() {
                let p = [i % n, i / n % n, i / n / n].map(|v| v as f64 / 40.0 - 1.0);
                let to = |x: f64| ((p[0] - x).powi(2) + p[1] * p[1] + p[2] * p[2]).sqrt();
                let both = [to(-0.5) - 0.4, to(0.5) - 0.3];
                if (both[0] - both[1]).abs() < 1e-9 {
                    continue;
                }
                let want = colours[usize::from(both[1] < both[0])];
                let is_near = both[0].min(both[1]).abs() < 0.05;
                near += usize::from(is_near);
                plain += usize::from(value == default && value != want);
                assert!(
                    value == want || (!is_near && how.is_empty() && value == default),
                    "{how} {name}: {value} at {p:?}, not {want}"
                );
            }
            assert!(near > 5000, "{near}");
            assert_eq!(plain == 0, how == "--full", "{how} {name}: {plain} samples");
        }
    }
    let of = |how: &str| {
        let line = format!("model @two.toml @v.bvol --resolution 80 --colors -q --overwrite {how}");
        run(&scratch, &line);
        bytes(&scratch.path("v.bvol"))
    };
    assert!(of("--threads 1 --mem 64MiB") == of("--threads 2 --mem 256MiB"));
}

#[test]
fn a_redistanced_scan_can_be_offset() {
    let scratch = Scratch::new("model-redistance");
    // A density of a ball of radius 12, of no useful scale.
    let value = |n: i32| {
        let at = [n % 40, n / 40 % 40, n / 1600];
        let square: f32 = at.map(|c| (c as f32 - 19.3).powi(2)).iter().sum();
        (-square / 60.0).exp() * 1000.0
    };
    let values: Vec<f32> = (0..64_000).map(value).collect();
    scratch.write("ball.raw", f32_bytes(&values));
    let iso = (-144.0f32 / 60.0).exp() * 1000.0;
    let scene = format!(
        "bounds = {{ min = [0, 0, 0], max = [39, 39, 39] }}\n[parts.scan]\nshape = \"volume\"\n\
         file = \"ball.raw\"\ndims = [40, 40, 40]\ntype = \"f32\"\niso = {iso}\nredistance = 4\n\
         [model]\nuse = \"scan\"\n"
    );
    for offset in [-2.0f64, 2.0] {
        scratch.write("scan.toml", format!("{scene}offset = {offset}\n"));
        let line = "model @scan.toml @out.ply --resolution 78 --overwrite";
        let found = json(&scratch, line)["signed_volume"]
            .as_f64()
            .expect("a number");
        let known = 4.0 / 3.0 * std::f64::consts::PI * (12.0 + offset).powi(3);
        assert!((found / known - 1.0).abs() < 0.02, "{found}, {known}");
    }
}

/// Scenes in files of their own, wrong in one way each.
fn scenes(scratch: &Scratch) {
    let scene = |name: &str, rest: &str| {
        scratch.write(&format!("{name}.toml"), format!("{BOUNDS}{rest}"));
    };
    scene("ball", BALL);
    scene(
        "empty",
        "[model]\nshape = \"sphere\"\nradius = 0.1\nmove = [9, 0, 0]\n",
    );
    scene(
        "loop",
        "include = [\"loop2.toml\"]\n[model]\nuse = \"loop2\"\n",
    );
    scene("loop2", "# first\n# second\ninclude = [\"loop.toml\"]\n");
    scene(
        "circle",
        "[parts.a]\nuse = \"b\"\n[parts.b]\nuse = \"a\"\n[model]\nuse = \"a\"\n",
    );
    for n in 0..20 {
        scene(
            &format!("deep{n}"),
            &format!("include = [\"deep{}.toml\"]\n{BALL}", n + 1),
        );
    }
    scene("deep20", BALL);
    let many: String = (0..300)
        .map(|n| format!("{{ file = \"ball.toml\", as = \"b{n}\" }},\n"))
        .collect();
    scene("many", &format!("include = [\n{many}]\n{BALL}"));
    let mut doubling = String::from("[parts.p0]\nshape = \"sphere\"\nradius = 0.5\n");
    for n in 1..40 {
        doubling += &format!("[parts.p{n}]\nunion = [\"p{0}\", \"p{0}\"]\n", n - 1);
    }
    scene("doubling", &format!("{doubling}[model]\nuse = \"p39\"\n"));
    let nested = format!(
        "[model]\n{}{}\n",
        "union = [{ ".repeat(150),
        " }]".repeat(150)
    );
    scene("nested", &nested);
    scene(
        "taken",
        "[model]\nshape = \"sphere\"\nradius = 0.5\nattributes = { \"color.r\" = 1 }\n",
    );
    scratch.write("huge.toml", vec![b'#'; (16 << 20) + 1]);
    scratch.write("binary.toml", [0xff, 0xfe, 0x00, 0x80]);
    scratch.write("nothing.toml", "");
    scratch.write("exists.ply", "mine");
    scratch.write("exists.bvol", "mine");
    std::fs::create_dir(scratch.path("folder.toml")).expect("scratch is writable");
    let leaf = |file: &str, more: &str| {
        format!("[parts.a]\nshape = \"volume\"\nfile = \"{file}\"\n{more}\n[model]\nuse = \"a\"\n")
    };
    scratch.write("cut.bvol", b"BVOL, and then nothing of the kind");
    scratch.write("short.raw", f32_bytes(&[0.0; 20]));
    scene("leaf-cut", &leaf("cut.bvol", "iso = 1"));
    scene("leaf-none", &leaf("none.nrrd", "iso = 1"));
    scene(
        "leaf-short",
        &leaf("short.raw", "dims = [4, 4, 4]\ntype = \"f32\"\niso = 1"),
    );
    scene(
        "leaf-type",
        &leaf("short.raw", "dims = [4, 4, 4]\ntype = \"f99\"\niso = 1"),
    );
    scene(
        "leaf-dims",
        &leaf("short.raw", "dims = [4, 0, 4]\ntype = \"f32\"\niso = 1"),
    );
    let good = "dims = [4, 5, 1]\ntype = \"f32\"\niso = 1\nredistance = 1";
    scene("leaf-flat", &leaf("short.raw", good));
    let level = "dims = [5, 2, 2]\ntype = \"f32\"\niso = 1\nas = \"level\"\nredistance = 1";
    scene("leaf-as", &leaf("short.raw", level));
    scene(
        "leaf-iso",
        &leaf("short.raw", "dims = [4, 5, 1]\ntype = \"f32\""),
    );
}

#[test]
fn wrong_scenes_and_options_are_one_error_with_place_and_remedy() {
    let scratch = Scratch::new("model-bad");
    scenes(&scratch);
    check_all(
        &scratch,
        &[
            case(
                "model @loop.toml @out.ply",
                1,
                &["loop2.toml:4: ", "break the circle"],
            ),
            case(
                "model @circle.toml @out.ply",
                1,
                &["circle.toml:", "a -> b -> a", "break the circle"],
            ),
            case(
                "model @deep0.toml @out.ply",
                1,
                &["deep15.toml:2: ", "16 levels", "include less"],
            ),
            case(
                "model @many.toml @out.ply",
                1,
                &["many.toml:", "256 files", "include less"],
            ),
            case(
                "model @doubling.toml @out.bvol",
                1,
                &["doubling.toml:", "nodes", "repeat"],
            ),
            case("model @nested.toml @out.ply", 1, &["nested.toml:3: "]),
            case(
                "model @huge.toml @out.ply",
                1,
                &["huge.toml", "at most 16777216"],
            ),
            case("model @binary.toml @out.ply", 1, &["binary.toml", "UTF-8"]),
            case(
                "model @nothing.toml @out.ply",
                1,
                &["nothing.toml:1: ", "'bounds' is missing: add"],
            ),
            case(
                "model @folder.toml @out.ply",
                1,
                &["folder.toml", "not a regular file"],
            ),
            case(
                "model @none.toml @out.ply",
                1,
                &["none.toml", "No such file"],
            ),
            case(
                "model @leaf-cut.toml @out.ply",
                1,
                &["leaf-cut.toml:4: ", "cut.bvol"],
            ),
            case(
                "model @leaf-none.toml @out.ply",
                1,
                &["leaf-none.toml:4: ", "none.nrrd"],
            ),
            case(
                "model @leaf-short.toml @out.ply",
                1,
                &["leaf-short.toml:4: ", "short.raw", "256"],
            ),
            case(
                "model @leaf-type.toml @out.ply",
                1,
                &["leaf-type.toml:", "f99"],
            ),
            case(
                "model @leaf-dims.toml @out.ply",
                1,
                &["leaf-dims.toml:", "'dims'", "whole numbers from 1"],
            ),
            case(
                "model @leaf-flat.toml @out.ply",
                1,
                &["leaf-flat.toml:8: ", "two samples"],
            ),
            case(
                "model @leaf-as.toml @out.ply",
                1,
                &["leaf-as.toml:9: ", "leave 'as' out"],
            ),
            case(
                "model @leaf-iso.toml @out.ply",
                1,
                &["leaf-iso.toml:", "'iso' is missing"],
            ),
            case(
                "model @empty.toml @out.ply",
                1,
                &["empty.toml", "--allow-empty"],
            ),
            // What is asked of a good scene.
            case(
                "model @ball.toml @out.ply --resolution 0",
                2,
                &["--resolution", "1..=1048576"],
            ),
            case(
                "model @ball.toml @out.ply --resolution 1048577",
                2,
                &["--resolution"],
            ),
            case(
                "model @ball.toml @out.ply --resolution 8 --voxel 1",
                2,
                &["--voxel", "cannot be used"],
            ),
            case(
                "model @ball.toml @out.ply --voxel 0",
                1,
                &["ball.toml", "voxel", "above 0"],
            ),
            case(
                "model @ball.toml @out.ply --voxel=-1",
                1,
                &["ball.toml", "voxel", "above 0"],
            ),
            case("model @ball.toml @out.ply --voxel nan", 2, &["--voxel"]),
            case(
                "model @ball.toml @out.bvol --voxel 1e-9",
                1,
                &["ball.toml", "make the voxel larger"],
            ),
            case(
                "model @ball.toml @out.bvol --band 0",
                1,
                &["--band 0", "from 1"],
            ),
            case("model @ball.toml @out.bvol --band inf", 2, &["--band"]),
            case(
                "model @ball.toml @out.bvol --band 4 --full",
                2,
                &["--full", "cannot be used"],
            ),
            case(
                "model @ball.toml @out.bvol --normals",
                1,
                &["out.bvol", "--normals", "write a .ply"],
            ),
            case(
                "model @taken.toml @out.bvol --colors",
                1,
                &["out.bvol", "\"color.r\"", "already"],
            ),
            case(
                "model @ball.toml @out.stl --colors",
                1,
                &["out.stl", ".ply"],
            ),
            case("model @ball.toml @out.xyz", 1, &["out.xyz", ".ply"]),
            case("model @ball.toml @out", 1, &["out", ".ply"]),
            case(
                "model @ball.toml @exists.ply",
                1,
                &["exists.ply", "--overwrite"],
            ),
            case(
                "model @ball.toml @exists.bvol",
                1,
                &["exists.bvol", "--overwrite"],
            ),
            case("model @ball.toml @none/out.ply", 1, &["none"]),
            case(
                "model @ball.toml @out.ply --picture @out.jpg",
                1,
                &["out.jpg", ".png"],
            ),
            case("model @ball.toml @out.ply --mem 1", 1, &["MiB"]),
            case("model @ball.toml", 2, &["OUT"]),
        ],
    );
}

/// Vertices and faces of a binary PLY without anything else.
fn halves(ply: &[u8], vertices: usize) -> (Vec<[f32; 3]>, &[u8]) {
    let end = b"end_header\n";
    let header = ply.windows(end.len()).position(|w| w == end);
    let body = &ply[header.expect("a header") + end.len()..];
    let (points, faces) = body.split_at(12 * vertices);
    let number = |b: &[u8]| f32::from_le_bytes(b.try_into().expect("4 bytes"));
    let point = |p: &[u8]| [number(&p[..4]), number(&p[4..8]), number(&p[8..])];
    (points.chunks_exact(12).map(point).collect(), faces)
}

#[test]
fn refined_vertices_lie_on_the_formula() {
    let scratch = Scratch::new("model-refine");
    scratch.write("ball.toml", format!("resolution = 23\n{BOUNDS}{BALL}"));
    let mut meshes = ["", "--refine"].map(|how| {
        let found = json(
            &scratch,
            &format!("model @ball.toml @out.ply {how} --overwrite"),
        );
        let count = found["vertices"].as_u64().expect("a count") as usize;
        let ply = bytes(&scratch.path("out.ply"));
        let (points, faces) = halves(&ply, count);
        (points, faces.to_vec())
    });
    let off = |points: &[[f32; 3]]| {
        let far = |p: &[f32; 3]| p.map(|v| f64::from(v).powi(2)).iter().sum::<f64>().sqrt();
        points
            .iter()
            .map(|p| (far(p) - 0.7).abs())
            .fold(0.0, f64::max)
    };
    let [(plain, faces), (refined, same)] = &mut meshes;
    assert!(faces == same, "other triangles");
    // By the curvature of the field between two samples; then by the rounding of positions. A
    // vertex that stays a thousandth of a cell from a sample is off by as much.
    let margin = 1e-3 * 2.0 / 23.0;
    assert!(off(plain) > 5.0 * margin, "{}", off(plain));
    assert!(off(refined) < margin, "{}", off(refined));
    let middle = |points: &mut Vec<[f32; 3]>| {
        let mut all: Vec<f64> = points.iter().map(|&p| off(&[p])).collect();
        all.sort_by(f64::total_cmp);
        all[all.len() / 2]
    };
    assert!(middle(plain) > 1e-5 && middle(refined) < 1e-7);
}

#[test]
fn refining_keeps_the_topology_whatever_the_threads() {
    let scratch = Scratch::new("model-refine-topology");
    for (scene, resolution) in [
        ("tanglecube", 40),
        ("barth_sextic", 60),
        ("machine_part", 70),
    ] {
        let scene = workspace().join(format!("data-gen/scenes/{scene}.toml"));
        let line = format!("model {} @M.ply --resolution {resolution}", scene.display());
        let plain = json(
            &scratch,
            &format!("{line} --overwrite").replace("@M", "@plain"),
        );
        let refined = json(
            &scratch,
            &format!("{line} --refine --threads 2 --overwrite").replace("@M", "@refined"),
        );
        json(
            &scratch,
            &format!("{line} --refine --threads 1 --mem 32MiB --overwrite").replace("@M", "@again"),
        );
        let [a, b, c] =
            ["plain", "refined", "again"].map(|name| bytes(&scratch.path(&format!("{name}.ply"))));
        assert!(a != b && b == c, "{line}");
        for same in ["vertices", "triangles", "euler", "closed"] {
            assert_eq!(plain[same], refined[same], "{line}: {same}");
        }
        let found = json(&scratch, "check @refined.ply --crossings all");
        assert_eq!(found["sound"], true, "{found}");
        assert_eq!(found["crossings"]["crossing_pairs"], 0, "{line}: {found}");
    }
    scratch.write("ball.toml", format!("resolution = 20\n{BOUNDS}{BALL}"));
    let refused = brickmarch(words(&scratch, "model @ball.toml @out.bvol --refine"));
    assert!(refused.code != Some(0) && refused.stderr.contains("--refine"));
}
