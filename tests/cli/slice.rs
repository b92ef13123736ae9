//! `slice` as its users meet it: planes in any direction, isolines, scale bars, PNG and SVG.

use super::bad_input::{case, check_all, prepare};
use super::{scratch_with_raw, words};
use crate::support::program::{Run, brickmarch};
use crate::support::scratch::{Scratch, bytes, f32_bytes};
use brickmarch::Box3;

#[track_caller]
fn ok(scratch: &Scratch, line: &str) -> Run {
    brickmarch(words(scratch, line)).success()
}

/// A ball in 30 x 21 x 26 samples with steps of 0.5.
fn ball(name: &str) -> Scratch {
    let scratch = scratch_with_raw(name);
    let raw = "--dims 30,21,26 --type f32 --kind distance --spacing 0.5,0.5,0.5 -q";
    ok(&scratch, &format!("import @field.raw @a.bvol {raw}"));
    scratch
}

#[test]
fn a_plane_along_the_lattice_is_the_slice_there() {
    let scratch = ball("slice-planes");
    let same = [
        ("--axis x --index 4", "--normal -1,0,0 --origin 2,0,0"),
        ("--axis y --index 13", "--normal 0,1,0 --origin 0,6.5,0"),
        ("--axis z --index 25", "--normal 0,0,2 --origin 1,1,12.5"),
        (
            "--axis z --index 3",
            "--normal 0,0,1 --origin 0,0,3 --space index",
        ),
        (
            "--axis y --index 5",
            "--through 0,2.5,0 --through 9,2.5,0 --through 0,2.5,7",
        ),
    ];
    for (axis, plane) in same {
        for more in ["", "--window -3:9 --map viridis"] {
            let line = |name: &str, which: &str| {
                format!("slice @a.bvol @{name}.png {which} {more} --overwrite -q")
            };
            ok(&scratch, &line("a", axis));
            ok(&scratch, &line("b", plane));
            let (a, b) = (bytes(&scratch.path("a.png")), bytes(&scratch.path("b.png")));
            assert!(a == b, "{axis} is not {plane}");
        }
    }
}

/// The points of the subpaths of an SVG path, and whether each is closed.
fn paths(svg: &str) -> Vec<(Vec<[f64; 2]>, bool)> {
    let data = svg.split(" d=\"").nth(1).expect("a path");
    let data = data.split('"').next().expect("its end");
    let subpath = |text: &str| {
        let closed = text.ends_with('Z');
        let points = text.trim_end_matches('Z').split('L').map(|p| {
            let (x, y) = p.split_once(' ').expect("two numbers");
            [x, y].map(|v| v.parse().expect("a number"))
        });
        (points.collect(), closed)
    };
    data.split('M').skip(1).map(subpath).collect()
}

#[test]
fn isolines_of_a_ball_are_circles_along_and_across_the_lattice() {
    let scratch = ball("slice-circles");
    let centre = [7.1, 5.05, 6.35];
    // Along an axis, and through the middle of the ball in no direction of the lattice.
    let slanted = "--normal 1,2,0.5 --origin 7.1,5.05,6.35 --scale 4 --iso -1.5";
    for (how, radius, scale) in [
        (
            "--axis z --index 12 --scale 3",
            (8.3f64.powi(2) - 0.7f64.powi(2)).sqrt(),
            3.0,
        ),
        (slanted, 8.3 - 1.5, 4.0),
    ] {
        let iso = if how == slanted { "" } else { "--iso 0" };
        let said = ok(
            &scratch,
            &format!("slice @a.bvol @a.svg {how} {iso} --json -q --overwrite"),
        )
        .json();
        assert_eq!(said["isolines"][0]["lines"], 1, "{said}");
        assert_eq!(said["isolines"][0]["closed"], 1, "{said}");
        let length = said["isolines"][0]["length"].as_f64().expect("a length");
        let around = std::f64::consts::PI * radius; // In steps of 0.5, twice the radius times pi.
        assert!((length / around - 1.0).abs() < 0.01, "{length} of {around}");
        let svg = String::from_utf8(bytes(&scratch.path("a.svg"))).expect("text");
        assert!(svg.contains("href=\"data:image/png;base64,iVBORw0KGgo"));
        let all = paths(&svg);
        assert_eq!((all.len(), all[0].1), (1, true));
        let points = &all[0].0;
        let middle: [f64; 2] = if how == slanted {
            let sum = points
                .iter()
                .fold([0.0; 2], |s, p| [s[0] + p[0], s[1] + p[1]]);
            sum.map(|s| s / points.len() as f64)
        } else {
            [(centre[0] / 0.5 + 0.5) * 3.0, (centre[1] / 0.5 + 0.5) * 3.0]
        };
        for p in points {
            let away = (p[0] - middle[0]).hypot(p[1] - middle[1]) / scale;
            assert!((away - radius).abs() < 0.12, "{how}: {away} of {radius}");
        }
    }
    ok(
        &scratch,
        "slice @a.bvol @b.svg --iso 0 --no-image --scale-bar --scale 3 -q",
    );
    let svg = String::from_utf8(bytes(&scratch.path("b.svg"))).expect("text");
    assert!(
        !svg.contains("<image") && svg.contains(">2</text>"),
        "{svg}"
    );
}

#[test]
fn lines_end_at_the_samples_and_regions_and_pictures_are_the_same_every_time() {
    let scratch = ball("slice-ends");
    let half = "--normal 3,1,2 --roi 0:30,0:11,0:26 --iso 0 --scale 4";
    let said = ok(&scratch, &format!("slice @a.bvol @a.svg {half} --json -q")).json();
    assert_eq!(said["isolines"][0]["lines"], 1, "{said}");
    assert_eq!(
        said["isolines"][0]["closed"], 0,
        "half a ball is open: {said}"
    );
    let mut first: Option<[Vec<u8>; 2]> = None;
    for limits in ["--threads 1 --mem 8MiB", "--threads 3"] {
        for name in ["c.png", "c.svg"] {
            ok(
                &scratch,
                &format!(
                    "slice @a.bvol @{name} {half} --iso 2 --scale-bar --map viridis {limits} --overwrite -q"
                ),
            );
        }
        let files = ["c.png", "c.svg"].map(|n| bytes(&scratch.path(n)));
        assert!(first.as_ref().is_none_or(|f| *f == files), "{limits}");
        first = Some(files);
    }
    // Window and level say the same as the window.
    ok(&scratch, "slice @a.bvol @w.png --window -2:6 -q");
    ok(&scratch, "slice @a.bvol @l.png --window-level 8,2 -q");
    assert!(bytes(&scratch.path("w.png")) == bytes(&scratch.path("l.png")));
}

#[test]
fn not_a_number_is_no_paper_and_ends_no_file() {
    let scratch = Scratch::new("slice-nan");
    let domain = Box3::from_size([20, 20, 3]);
    let values = (0..domain.count()).map(|n| {
        if n % 20 < 9 {
            f32::NAN
        } else {
            (n % 20) as f32
        }
    });
    scratch.write("n.raw", f32_bytes(&values.collect::<Vec<f32>>()));
    ok(
        &scratch,
        "import @n.raw @n.bvol --dims 20,20,3 --type f32 -q",
    );
    for how in ["", "--normal 0,0,1", "--normal 0,0.02,1"] {
        let line = format!("slice @n.bvol @n.png {how} --iso 12.5 --json -q --overwrite");
        let said = ok(&scratch, &line).json();
        // The line of 12.5 rises; beside the values that are not numbers the inside ends too.
        assert_eq!(said["isolines"][0]["lines"], 1, "{how}: {said}");
        assert_eq!(said["window"][0], 9.0, "{how}: {said}");
    }
}

#[test]
fn wrong_planes_and_lines_are_refused() {
    let scratch = prepare("bad-slices");
    check_all(
        &scratch,
        &[
            case(
                "slice @distance.bvol @out.gif",
                1,
                &["out.gif", ".png", ".svg"],
            ),
            case(
                "slice @distance.bvol @out.png --no-image",
                1,
                &["out.png", ".svg"],
            ),
            case(
                "slice @distance.bvol @out.png --normal 0,0,0",
                1,
                &["distance.bvol", "--normal"],
            ),
            case(
                "slice @distance.bvol @out.png --normal 0,nan,0",
                2,
                &["nan"],
            ),
            case("slice @distance.bvol @out.png --normal 1,0", 2, &["1,0"]),
            case(
                "slice @distance.bvol @out.png --normal 1,0,0 --up 2,0,0",
                1,
                &["distance.bvol", "--up"],
            ),
            case(
                "slice @distance.bvol @out.png --normal 1,0,0 --axis x",
                2,
                &["--axis"],
            ),
            case(
                "slice @distance.bvol @out.png --origin 1,0,0",
                2,
                &["--normal"],
            ),
            case(
                "slice @distance.bvol @out.png --normal 1,0,0 --origin 99,0,0",
                1,
                &["distance.bvol", "does not meet", "29"],
            ),
            case(
                "slice @distance.bvol @out.png --through 0,0,0 --through 1,1,1",
                1,
                &["distance.bvol", "three times"],
            ),
            case(
                "slice @distance.bvol @out.png --through 0,0,0 --through 1,1,1 --through 2,2,2",
                1,
                &["distance.bvol", "on a line"],
            ),
            case(
                "slice @distance.bvol @out.png --scale-bar",
                1,
                &["distance.bvol", "--scale"],
            ),
            case("slice @distance.bvol @out.png --line-width 0", 2, &["0.1"]),
            case(
                "slice @distance.bvol @out.png --window-level 0,5",
                2,
                &["above 0"],
            ),
            case(
                "slice @distance.bvol @out.png --window-level 1,5 --window 0:1",
                2,
                &["--window"],
            ),
            case("slice @distance.bvol @out.png --iso inf", 2, &["inf"]),
            case(
                "slice @distance.bvol @out.svg --normal 1,2,3 --scale 64 --mem 2MiB",
                1,
                &["distance.bvol", "--scale", "--mem"],
            ),
        ],
    );
}
