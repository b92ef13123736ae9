//! `mesh --color`: vertices have the colours of another volume, whatever the tiling, threads and memory.

use super::bad_input::{case, check_all, prepare};
use super::{scratch_with_raw, words};
use crate::support::program::{Run, brickmarch, data_gen};
use crate::support::scratch::{Scratch, bytes};
use brickmarch::field::Dense;
use brickmarch::store::{VolumeSpec, write_fields};
use brickmarch::{Affine, Box3, Budget, Field, Grid, Kind, SampleType};

#[track_caller]
fn ok(scratch: &Scratch, line: &str) -> Run {
    brickmarch(words(scratch, line)).success()
}

/// Another lattice than that of the shape: steps of 1.7, turned axes, another origin; the shape in it.
fn lattice() -> Grid {
    Grid {
        index_to_world: Affine {
            rows: [
                [0.0, 1.7, 0.0, -2.0],
                [1.7, 0.0, 0.0, -3.0],
                [0.0, 0.0, 1.7, -2.5],
            ],
        },
        ..Grid::new(Box3::new([0, -1, 1], [17, 20, 20]))
    }
}

/// Whole numbers that bend between samples.
fn channel(c: usize, [i, j, k]: [i32; 3]) -> f32 {
    match c {
        0 => (12 * (i + 1)).rem_euclid(250) as f32,
        1 => (j * j * 3 + 7 * k).rem_euclid(256) as f32,
        _ => (i * j + 5 * k * k).rem_euclid(256) as f32,
    }
}

fn dense(c: usize, grid: Grid) -> Dense {
    let d = grid.domain;
    let mut values = Vec::new();
    for k in d.min[2]..d.max[2] {
        for j in d.min[1]..d.max[1] {
            values.extend((d.min[0]..d.max[0]).map(|i| channel(c, [i, j, k])));
        }
    }
    Dense::new(grid, values).expect("counts")
}

/// The ball, `a.bvol`, and `c.bvol` with three channels and an atlas.
fn prepared(name: &str) -> Scratch {
    let scratch = scratch_with_raw(name);
    let raw = "--dims 30,21,26 --type f32 --kind distance -q";
    ok(&scratch, &format!("import @field.raw @a.bvol {raw}"));
    let grid = lattice();
    let fields = [0, 1, 2, 1].map(|c| dense(c, grid));
    let names = ["color.r", "color.g", "color.b", "atlas"];
    let specs = names.map(|n| VolumeSpec {
        name: n.into(),
        kind: if n == "atlas" {
            Kind::Label
        } else {
            Kind::Density
        },
        brick_edge: 8,
        ..VolumeSpec::new(grid, SampleType::U8)
    });
    let all: Vec<(&dyn Field, &VolumeSpec)> = (fields.iter().zip(&specs))
        .map(|(f, s)| (f as &dyn Field, s))
        .collect();
    write_fields(&all, &scratch.path("c.bvol"), &Budget::mib(16)).expect("written");
    scratch
}

/// Position and colour.
type Vertex = ([f32; 3], [u8; 3]);

/// Positions and colours of a PLY of the program, and its bytes without colours.
fn vertices(content: &[u8]) -> (Vec<Vertex>, Vec<u8>) {
    let end = b"end_header\n";
    let at = content
        .windows(end.len())
        .position(|w| w == end)
        .expect("a header")
        + end.len();
    let header = String::from_utf8_lossy(&content[..at]).into_owned();
    assert!(header.contains("property uchar red\nproperty uchar green\nproperty uchar blue\n"));
    let count = header
        .lines()
        .find_map(|l| l.strip_prefix("element vertex "));
    let count: usize = count.and_then(|c| c.parse().ok()).expect("a count");
    let (mut found, mut plain) = (Vec::new(), Vec::new());
    for v in content[at..at + 15 * count].chunks(15) {
        let p = [0, 4, 8].map(|n| f32::from_le_bytes(v[n..n + 4].try_into().expect("four")));
        found.push((p, [v[12], v[13], v[14]]));
        plain.extend(&v[..12]);
    }
    plain.extend(&content[at + 15 * count..]);
    (found, plain)
}

/// The trilinear value of a channel at a place in the world, in double precision; `None` beyond the samples.
fn oracle(c: usize, world: [f32; 3]) -> Option<f64> {
    let grid = lattice();
    let w = world.map(f64::from);
    let index = [(w[1] + 3.0) / 1.7, (w[0] + 2.0) / 1.7, (w[2] + 2.5) / 1.7];
    let d = grid.domain;
    if (0..3).any(|a| index[a] < f64::from(d.min[a]) || index[a] > f64::from(d.max[a] - 1)) {
        return None;
    }
    let mut sum = 0.0;
    for corner in 0..8usize {
        let mut weight = 1.0;
        let p: [i32; 3] = std::array::from_fn(|a| {
            let (low, bit) = (index[a].floor(), corner >> a & 1);
            let t = index[a] - low;
            weight *= if bit == 1 { t } else { 1.0 - t };
            low as i32 + bit as i32
        });
        if weight > 0.0 {
            sum += weight * f64::from(channel(c, p));
        }
    }
    Some(sum)
}

#[test]
fn vertices_have_the_trilinear_colour_of_their_place() {
    let scratch = prepared("color-oracle");
    ok(&scratch, "mesh @a.bvol @plain.ply -q");
    let plain = bytes(&scratch.path("plain.ply"));
    for (how, mesh) in [("", "mesh"), ("--roi 2:20,0:20,3:25", "part")] {
        ok(
            &scratch,
            &format!("mesh @a.bvol @{mesh}.ply --color @c.bvol {how} -q"),
        );
        let (found, rest) = vertices(&bytes(&scratch.path(&format!("{mesh}.ply"))));
        assert!(found.len() > 800);
        for &(p, colour) in &found {
            for c in 0..3 {
                let want = oracle(c, p).expect("the ball lies in the samples");
                let off = (f64::from(colour[c]) - want).abs();
                assert!(
                    off <= 0.5 + 1e-3,
                    "channel {c} at {p:?}: {} of {want}",
                    colour[c]
                );
            }
        }
        // Nothing but the colours is other than without.
        assert!(mesh == "part" || plain.ends_with(&rest));
        let check = ok(&scratch, &format!("check @{mesh}.ply --json -q")).json();
        assert_eq!(check["sound"], true, "{check}");
        assert_eq!(check["report"]["vertices"], found.len(), "{check}");
    }
    // In the space of the lattice positions are others, colours are not.
    ok(
        &scratch,
        "import @field.raw @b.bvol --dims 30,21,26 --type f32 --kind distance --spacing 0.5,0.6,0.7 -q",
    );
    let mut colours = ["world", "index"].map(|space| {
        ok(
            &scratch,
            &format!("mesh @b.bvol @b.ply --space {space} --color @c.bvol -q --overwrite"),
        );
        let (found, _) = vertices(&bytes(&scratch.path("b.ply")));
        found.into_iter().map(|v| v.1).collect::<Vec<_>>()
    });
    let [world, index] = &mut colours;
    assert_eq!(world.len(), index.len());
    let far = |(a, b): (&[u8; 3], &[u8; 3])| (0..3).any(|c| a[c].abs_diff(b[c]) > 1);
    assert_eq!(
        world
            .iter()
            .zip(index.iter())
            .filter(|&(a, b)| far((a, b)))
            .count(),
        0
    );
}

#[test]
fn colours_do_not_depend_on_threads_memory_or_the_way_to_the_file() {
    let scratch = prepared("color-same");
    for how in [
        "",
        "--smooth quality",
        "--simplify 30%",
        "--component largest",
    ] {
        let mut first = Vec::new();
        for limits in [
            "--threads 1 --mem 32MiB",
            "--threads 2 --mem 1GiB",
            "--threads 8 --mem 160MiB",
        ] {
            ok(
                &scratch,
                &format!(
                    "mesh @a.bvol @m.ply --color @c.bvol --picture @m.png --picture-size 80x60 {how} {limits} --overwrite -q"
                ),
            );
            let made = [bytes(&scratch.path("m.ply")), bytes(&scratch.path("m.png"))];
            assert!(first.is_empty() || first == made, "{how} {limits}");
            first = made.into();
        }
        let (found, _) = vertices(&first[0]);
        for &(p, colour) in &found {
            let want = oracle(0, p).expect("inside");
            assert!(
                (f64::from(colour[0]) - want).abs() <= 0.5 + 1e-3,
                "{how} {p:?}"
            );
        }
        ok(
            &scratch,
            &format!(
                "mesh @a.bvol @m.ply --picture @n.png --picture-size 80x60 {how} --overwrite -q"
            ),
        );
        assert!(
            first[1] != bytes(&scratch.path("n.png")),
            "the picture has no colours"
        );
    }
}

#[test]
fn one_volume_is_coloured_by_a_map_and_beyond_it_is_the_plain_colour() {
    let scratch = prepared("color-map");
    // Segments by the nearest sample, each in a colour of its own; 0 is none.
    ok(&scratch, "mesh @a.bvol @l.ply --color @c.bvol:atlas -q");
    let (found, _) = vertices(&bytes(&scratch.path("l.ply")));
    let mut colours: Vec<[u8; 3]> = found.iter().map(|v| v.1).collect();
    colours.sort_unstable();
    colours.dedup();
    assert!(colours.len() > 20, "{}", colours.len());
    // Grey from 40 to 200 of one channel.
    ok(
        &scratch,
        "mesh @a.bvol @g.ply --color @c.bvol:color.g --color-map grey --color-window 40:200 -q",
    );
    for (p, colour) in vertices(&bytes(&scratch.path("g.ply"))).0 {
        let place = (oracle(1, p).expect("inside") - 40.0) / 160.0 * 255.0;
        let want = place.clamp(0.0, 255.0);
        assert!(
            (f64::from(colour[0]) - want).abs() <= 0.51,
            "{p:?} {colour:?} {want}"
        );
        assert!(colour[0] == colour[1] && colour[1] == colour[2]);
    }
    // Only a corner of the ball lies in eight samples.
    data_gen([
        "texture",
        "wood",
        "--n",
        "14",
        "--out",
        &scratch.path("w.bvol").to_string_lossy(),
    ])
    .success();
    let run = ok(
        &scratch,
        "mesh @a.bvol @w.ply --color @w.bvol --colour 010203 --json",
    );
    let plain = run.json()["vertices_without_color"]
        .as_u64()
        .expect("a count");
    assert!(run.stderr.contains("w.bvol"), "{run:?}");
    let (found, _) = vertices(&bytes(&scratch.path("w.ply")));
    let beyond = |p: [f32; 3]| p.iter().any(|&v| v > 14.0);
    assert_eq!(found.iter().filter(|v| beyond(v.0)).count() as u64, plain);
    assert!(
        plain > 100 && (plain as usize) < found.len(),
        "{plain} of {}",
        found.len()
    );
    for (p, colour) in found {
        assert_eq!(colour == [1, 2, 3], beyond(p), "{p:?}");
    }
    // The colours that a scene writes are read as they are.
    scratch.write(
        "two.toml",
        "bounds = { min = [-1, -1, -1], max = [1, 1, 1] }\n[model]\nshape = \"sphere\"\nradius = 0.6\ncolor = \"#ff8000\"\n",
    );
    ok(
        &scratch,
        "model @two.toml @two.bvol --resolution 40 --colors -q",
    );
    ok(&scratch, "mesh @two.bvol @two.ply --color @two.bvol -q");
    let (found, _) = vertices(&bytes(&scratch.path("two.ply")));
    assert!(found.len() > 500 && found.iter().all(|v| v.1 == [255, 128, 0]));
}

#[test]
fn wrong_colours_are_refused() {
    let scratch = prepare("bad-colors");
    data_gen([
        "texture",
        "marble",
        "--n",
        "9",
        "--out",
        &scratch.path("m.bvol").to_string_lossy(),
    ])
    .success();
    check_all(
        &scratch,
        &[
            case(
                "mesh @distance.bvol @out.stl --color @m.bvol",
                1,
                &["out.stl", ".ply"],
            ),
            case(
                "mesh @distance.bvol @out.ply --color @missing.bvol",
                1,
                &["missing.bvol"],
            ),
            case(
                "mesh @distance.bvol @out.ply --color @text.bvol",
                1,
                &["text.bvol"],
            ),
            case(
                "mesh @distance.bvol @out.ply --color @flipped.bvol",
                1,
                &["flipped.bvol"],
            ),
            case(
                "mesh @distance.bvol @out.ply --color @m.bvol:bark",
                1,
                &["m.bvol", "bark", "color.r"],
            ),
            case(
                "mesh @distance.bvol @out.ply --color @m.bvol --color-window 0:1",
                1,
                &["m.bvol", "--color-window"],
            ),
            case(
                "mesh @distance.bvol @out.ply --color-map grey",
                2,
                &["--color"],
            ),
            case(
                "mesh @distance.bvol @out.part --part 1/2 --color @m.bvol",
                2,
                &["--part", "--color"],
            ),
            case(
                "mesh @label.bvol @out.ply --labels all --color @m.bvol",
                2,
                &["--labels", "--color"],
            ),
            case(
                "mesh @distance.bvol @out.ply --color @m.bvol --mem 1MiB",
                1,
                &["--mem"],
            ),
        ],
    );
}
