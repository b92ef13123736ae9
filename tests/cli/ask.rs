//! Questions through the program: points, rays, histograms and pictures, against what is known.

use super::{DOMAIN, samples, scratch_with_raw, words};
use crate::support::program::{Run, brickmarch};
use crate::support::scratch::Scratch;
use std::fmt::Write;

const CENTRE: [f64; 3] = [14.2, 10.1, 12.7];
const RADIUS: f64 = 8.3;

fn with_volume(name: &str) -> Scratch {
    let scratch = scratch_with_raw(name);
    run(
        &scratch,
        "import @field.raw @a.bvol --dims 30,21,26 --type f32 --kind distance --spacing 0.5,1,2 -q",
    );
    scratch
}

#[track_caller]
fn run(scratch: &Scratch, line: &str) -> Run {
    brickmarch(words(scratch, line)).success()
}

fn numbers(text: &str) -> Vec<Vec<f64>> {
    let row = |line: &str| {
        line.split(',')
            .map(|n| n.parse().expect("a number"))
            .collect()
    };
    text.lines().skip(1).map(row).collect()
}

#[test]
fn points_in_csv_and_npy_get_the_samples_and_what_is_between() {
    let scratch = with_volume("ask-points");
    let values = samples();
    let mut csv = String::from("x,y,z\n");
    let mut expected = Vec::new();
    for n in 0..400 {
        let p = [n * 7 % 30, n * 5 % 21, n * 3 % 25];
        let at = |k: usize| values[p[0] + 30 * (p[1] + 21 * k)];
        // Half way along z, in the world.
        let z = 2.0 * (p[2] as f64 + 0.5);
        writeln!(csv, "{},{},{z}", 0.5 * p[0] as f64, p[1]).expect("a string");
        expected.push(at(p[2]) + (at(p[2] + 1) - at(p[2])) * 0.5);
    }
    csv += "-1,0,0\n";
    scratch.write("p.csv", csv);
    let out = run(&scratch, "sample @a.bvol @p.csv --mem 16MiB").stdout;
    let rows = numbers(&out);
    assert_eq!(rows.len(), 401);
    for (row, want) in rows.iter().zip(&expected) {
        assert_eq!(row[3], f64::from(*want));
    }
    assert!(rows[400][3].is_nan());
    // The same through NumPy files: what was written is read again.
    run(
        &scratch,
        "sample @a.bvol @p.csv -o @once.npy --outside -5 -q",
    );
    let raw = std::fs::read(scratch.path("once.npy")).expect("written");
    assert!(raw.starts_with(b"\x93NUMPY\x01\x00") && raw.len() == 128 + 401 * 32);
    let last = f64::from_le_bytes(*raw.last_chunk().expect("long"));
    assert_eq!(last, -5.0);
    let wrong = brickmarch(words(&scratch, "sample @a.bvol @once.npy -q"));
    assert_eq!(wrong.code, Some(1));
    assert!(wrong.stderr.contains("(N, 3)"), "{}", wrong.stderr);
    let index = run(
        &scratch,
        "sample @a.bvol @p.csv --space index --method nearest --gradient",
    );
    assert!(index.stdout.starts_with("x,y,z,value,gx,gy,gz\n"));
    scratch.write("bad.csv", "1,2,3\n1,two,3\n");
    let bad = brickmarch(words(&scratch, "sample @a.bvol @bad.csv"));
    assert_eq!(bad.code, Some(1));
    assert!(bad.stderr.contains("line 2"), "{}", bad.stderr);
    for cut in [0, 5, 9, 60, 127, 130] {
        std::fs::write(scratch.path("cut.npy"), &raw[..cut]).expect("scratch");
        let refused = brickmarch(words(&scratch, "sample @a.bvol @cut.npy"));
        assert_eq!(refused.code, Some(1), "{cut}");
        assert!(refused.stderr.contains("cut.npy"), "{}", refused.stderr);
    }
}

#[test]
fn rays_meet_the_ball_where_it_is() {
    let scratch = with_volume("ask-rays");
    // Along x through the middle of the ball, in index space; one beside it.
    scratch.write(
        "r.csv",
        "-5,10.1,12.7,1,0,0\n40,10.1,12.7,-2,0,0\n-5,0.5,0.5,1,0,0\n",
    );
    let out = run(&scratch, "ray @a.bvol @r.csv --iso 0 --space index").stdout;
    let rows = numbers(&out);
    let [left, right] = [CENTRE[0] - RADIUS, CENTRE[0] + RADIUS];
    // The distance to a ball is bent: linear pieces are within a twentieth of a step.
    assert!(
        (rows[0][1] - left).abs() < 0.05 && rows[0][4] == 0.0,
        "{out}"
    );
    assert!((rows[1][1] - right).abs() < 0.05 && (rows[1][0] - (40.0 - right) / 2.0).abs() < 0.05);
    assert!(rows[2][0].is_nan());
    let sum = run(&scratch, "ray @a.bvol @r.csv --integral --space index").stdout;
    assert!(
        numbers(&sum).iter().all(|r| (r[1] - 29.0).abs() < 1e-9),
        "{sum}"
    );
    let max = run(&scratch, "ray @a.bvol @r.csv --max --space index").stdout;
    let expected = samples()[..].iter().copied().fold(f32::MIN, f32::max);
    assert!(numbers(&max).iter().all(|r| r[4] <= f64::from(expected)));
    let none = brickmarch(words(&scratch, "ray @a.bvol @r.csv"));
    assert_eq!(none.code, Some(2));
}

#[test]
fn a_histogram_counts_every_sample_of_its_region() {
    let scratch = with_volume("ask-histogram");
    let line = "info @a.bvol --histogram 10 --window -5:5 --roi 2:20,0:21,3:9 --json";
    let json = run(&scratch, line).json()["samples"].take();
    let mut counts = [0u64; 10];
    let (mut below, mut above, mut count) = (0, 0, 0);
    for (n, v) in samples().into_iter().map(f64::from).enumerate() {
        let [i, j, k] = [n % 30, n / 30 % 21, n / 630];
        if !(2..20).contains(&i) || j >= 21 || !(3..9).contains(&k) {
            continue;
        }
        count += 1;
        match v {
            v if v < -5.0 => below += 1,
            v if v > 5.0 => above += 1,
            v => counts[((v + 5.0) as usize).min(9)] += 1,
        }
    }
    assert_eq!(json["counts"], serde_json::json!(counts));
    assert_eq!(
        (&json["below"], &json["above"]),
        (&below.into(), &above.into())
    );
    assert_eq!(json["count"], count);
    assert_eq!(DOMAIN.count(), 30 * 21 * 26);
}

#[test]
fn pictures_do_not_depend_on_threads_and_show_something() {
    let scratch = with_volume("ask-render");
    for (n, what) in [
        "",
        "--no-occlusion",
        "--fog --window -9:9",
        "--max --map viridis",
    ]
    .into_iter()
    .enumerate()
    {
        let mut first = Vec::new();
        for limits in ["--threads 1 --mem 64MiB", "--threads 3"] {
            run(
                &scratch,
                &format!("render @a.bvol @{n}.png --size 80x60 {what} {limits} --overwrite -q"),
            );
            let bytes = std::fs::read(scratch.path(&format!("{n}.png"))).expect("written");
            assert!(first.is_empty() || first == bytes, "{what}");
            first = bytes;
        }
        assert!(first.len() > 1000, "{what}: {} bytes", first.len());
    }
    let pictures: Vec<_> = (0..4)
        .map(|n| std::fs::read(scratch.path(&format!("{n}.png"))).expect("written"))
        .collect();
    for a in 0..4 {
        assert!((0..a).all(|b| pictures[a] != pictures[b]), "{a}");
    }
    let wrong = brickmarch(words(&scratch, "render @a.bvol @x.png --fog --opacity 1.5"));
    assert_eq!(wrong.code, Some(1));
    assert!(!scratch.path("x.png").exists());
}

#[test]
fn points_in_no_order_come_back_in_their_order() {
    let scratch = with_volume("ask-scattered");
    // More than a batch, so that the file is read again, and a stretch in order between.
    let mut seed = 3u64;
    let mut next = |size: f64| {
        seed = seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (seed >> 11) as f64 / (1u64 << 53) as f64 * size - 0.5
    };
    let mut points = Vec::new();
    for n in 0..50_000 {
        points.push(match n {
            20_000..30_000 => [f64::from(n - 20_000) * 0.002, 3.25, 7.5],
            _ => [next(30.0), next(21.5), next(26.0)],
        });
    }
    let mut raw = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (50000, 3), }";
    raw.extend(format!("{header:<117}\n").bytes());
    raw.extend(points.iter().flatten().flat_map(|v| v.to_le_bytes()));
    scratch.write("p.npy", raw);
    let lines = points.iter().map(|[x, y, z]| format!("{x},{y},{z}\n"));
    scratch.write("p.csv", lines.collect::<String>());
    for gradient in ["", "--gradient"] {
        let common = format!("--space index -q --overwrite {gradient}");
        // Rows of text cannot be read again: answered batch by batch.
        let line = format!("sample @a.bvol @p.csv -o @text.npy --threads 1 {common}");
        run(&scratch, &line);
        let expected = std::fs::read(scratch.path("text.npy")).expect("written");
        let columns = if gradient.is_empty() { 4 } else { 7 };
        assert_eq!(expected.len(), 128 + 50_000 * 8 * columns);
        for limits in [
            "--mem 12MiB --threads 2",
            "--mem 24MiB --threads 1",
            "--mem 256MiB --threads 3",
        ] {
            let line = format!("sample @a.bvol @p.npy -o @out.npy {limits} {common}");
            run(&scratch, &line);
            let got = std::fs::read(scratch.path("out.npy")).expect("written");
            assert!(got == expected, "{limits} {gradient}");
        }
    }
}
