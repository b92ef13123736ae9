//! `mesh --part` and `join`: a mesh in parts, made and named in any order.

use crate::support::program::{brickmarch, data_gen};
use crate::support::rng::Rng;
use crate::support::scratch::Scratch;

#[test]
fn seven_parts_in_random_order_join_to_the_bytes_of_one_run() {
    let scratch = Scratch::new("parts");
    let path = |name: &str| scratch.path(name).to_string_lossy().into_owned();
    let (gyroid, whole) = (path("gyroid.bvol"), path("whole.ply"));
    data_gen(["level-set", "gyroid", "--n", "128", "--out", &gyroid]).success();
    let how = ["--iso=0", "--boundary=cut", "--normals"];
    let mesh = |more: &[&str], out: &str| {
        let words = ["mesh", &gyroid, out].into_iter().chain(how);
        brickmarch(words.chain(more.iter().copied()))
    };
    mesh(&[], &whole).success();
    let whole = std::fs::read(whole).expect("was written");
    let mut rng = Rng::new(11);
    let mut order: Vec<usize> = (1..=7).collect();
    let mut shuffle = |list: &mut Vec<usize>| {
        for n in (1..list.len()).rev() {
            list.swap(n, rng.below(n as u64 + 1) as usize);
        }
    };
    shuffle(&mut order);
    let part = |n: usize| path(&format!("{n}.part"));
    for (k, &n) in order.iter().enumerate() {
        let threads = format!("--threads={}", 1 + k % 3);
        let more = [&format!("--part={n}/7"), &threads, "--mem=48MiB"];
        mesh(&more.map(|w| w as &str), &part(n)).success();
    }
    for name in ["joined.ply", "again.ply", "joined.obj"] {
        shuffle(&mut order);
        let out = path(name);
        let names: Vec<String> = order.iter().map(|&n| part(n)).collect();
        let words = ["join", &out].into_iter();
        brickmarch(words.chain(names.iter().map(String::as_str))).success();
        let joined = std::fs::read(&out).expect("was written");
        assert!(
            name.ends_with("obj") || joined == whole,
            "{name}: other bytes than in one run"
        );
    }

    // A part that is missing, twice, of another mesh, damaged, or none at all: nothing is written.
    let out = path("bad.ply");
    let joined = |names: &[String]| {
        let words = ["join", &out].into_iter();
        let run = brickmarch(words.chain(names.iter().map(String::as_str)));
        assert_eq!(run.code, Some(1), "{run:#?}");
        assert!(!std::path::Path::new(&out).exists());
        assert_eq!(run.stderr.trim().lines().count(), 1, "{}", run.stderr);
        run.stderr.clone()
    };
    let all: Vec<String> = (1..=7).map(part).collect();
    assert!(joined(&all[..6]).contains("of 7"));
    let mut twice = all.clone();
    twice[3] = part(5);
    assert!(joined(&twice).contains("every part once"));
    let other = path("other.part");
    let words = ["mesh", &gyroid, &other, "--iso=0.5", "--part=2/7"];
    brickmarch(words).success();
    let mut mixed = all.clone();
    mixed[1] = other;
    assert!(joined(&mixed).contains("another mesh"));
    let mut bytes = std::fs::read(part(4)).expect("is there");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    scratch.write("damaged.part", bytes);
    let mut damaged = all.clone();
    damaged[3] = path("damaged.part");
    let said = joined(&damaged);
    assert!(
        said.contains("damaged.part") && said.contains("checksum"),
        "{said}"
    );
    let mut none = all;
    none[0] = gyroid.clone();
    assert!(joined(&none).contains("no part of a mesh"));
}
