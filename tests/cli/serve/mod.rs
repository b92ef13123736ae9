//! `serve`: what it answers, what it refuses, what it takes, and how it ends.

mod browser;
mod client;
mod hostile;
mod load;

use super::words;
use crate::support::program::{brickmarch, data_gen};
use crate::support::scratch::{Scratch, bytes};
use client::{Reply, Server};
use std::io::{Read, Write};
use std::time::{Duration, Instant};

/// A scratch folder with `g.bvol`, a gyroid with two coarser levels.
fn gyroid(name: &str, n: u32) -> Scratch {
    let scratch = Scratch::new(name);
    let path = |name: &str| scratch.path(name).to_string_lossy().into_owned();
    let n = n.to_string();
    data_gen([
        "level-set",
        "gyroid",
        "--n",
        &n,
        "--out",
        &path("flat.bvol"),
    ])
    .success();
    brickmarch(words(&scratch, "export @flat.bvol @g.npy -q")).success();
    brickmarch(words(
        &scratch,
        "import @g.npy @g.bvol --kind distance --background 3 --levels 2 -q",
    ))
    .success();
    scratch
}

/// A scratch folder with `g.bvol`, a ramp of 160^3: 16 MB of samples.
fn ramp(name: &str) -> Scratch {
    let scratch = Scratch::new(name);
    let values: Vec<f32> = (0..160 * 160 * 160).map(|i| (i % 160) as f32).collect();
    scratch.write("g.raw", crate::support::scratch::f32_bytes(&values));
    let line = "import @g.raw @g.bvol --dims 160,160,160 --type f32 -q";
    brickmarch(words(&scratch, line)).success();
    scratch
}

#[test]
fn answers_are_what_the_other_commands_write() {
    let scratch = gyroid("serve-answers", 64);
    let server = Server::start(&scratch, "@g.bvol --mem 64MiB");
    let get = |path: &str| server.get(path);

    let list = get("/api/volumes").ok().json();
    assert_eq!(list["volumes"], serde_json::json!(["g"]));
    let about = get("/api/volumes/g").ok().json();
    assert_eq!(about["volume"]["size"], serde_json::json!([64, 64, 64]));
    assert_eq!(about["levels"][2]["size"], serde_json::json!([16, 16, 16]));

    for (ending, level, min, max) in [
        ("npy", 0, [0, 0, 0], [64, 64, 64]),
        ("raw", 0, [3, 5, 7], [40, 6, 64]),
        ("npy", 1, [0, 9, 30], [32, 32, 31]),
    ] {
        let file = format!("r{level}-{}.{ending}", min[0]);
        let roi: Vec<String> = (0..3).map(|a| format!("{}:{}", min[a], max[a])).collect();
        let line = format!(
            "export @g.bvol @{file} --level {level} --roi {} -q",
            roi.join(",")
        );
        brickmarch(words(&scratch, &line)).success();
        let list = |v: [i32; 3]| format!("{},{},{}", v[0], v[1], v[2]);
        let path = format!(
            "/api/volumes/g/region?min={}&max={}&level={level}&format={ending}",
            list(min),
            list(max)
        );
        assert_eq!(get(&path).ok().body, bytes(&scratch.path(&file)), "{path}");
    }

    for ending in ["ply", "stl"] {
        let line = format!("mesh @g.bvol @m.{ending} --iso 0.25 --level 1 -q");
        brickmarch(words(&scratch, &line)).success();
        let mesh = get(&format!(
            "/api/volumes/g/mesh?iso=0.25&level=1&format={ending}"
        ))
        .ok();
        assert!(
            mesh.body == bytes(&scratch.path(&format!("m.{ending}"))),
            "{ending}"
        );
    }

    let slice = get("/api/volumes/g/slice?axis=y&at=10&window=-3:3&map=viridis").ok();
    assert_eq!(slice.header("x-brickmarch-window"), Some("-3:3"));
    assert_eq!(png_size(&slice.body), [64, 64]);
    let preview = get("/api/volumes/g/preview?iso=0&size=120x100").ok();
    assert_eq!(png_size(&preview.body), [120, 100]);
    assert_eq!(
        preview.body,
        get("/api/volumes/g/preview?iso=0&size=120x100").ok().body
    );

    let at = [20, 30, 40];
    let line = "export @g.bvol @v.raw --roi 20:21,30:31,40:41 -q";
    brickmarch(words(&scratch, line)).success();
    let raw = bytes(&scratch.path("v.raw")).try_into().expect("an f32");
    let value = get("/api/volumes/g/value?at=20,30,40").ok().json();
    assert_eq!(value["at"], serde_json::json!(at));
    assert_eq!(
        value["value"],
        serde_json::json!(f64::from(f32::from_le_bytes(raw)))
    );

    let page = get("/").ok();
    assert!(page.header("content-security-policy").is_some());
    let page = String::from_utf8(page.body).expect("text");
    for outside in ["http://", "https://", "src=\"//", "@import"] {
        assert!(
            !page.contains(outside),
            "the page needs nothing else, but has {outside}"
        );
    }
}

fn png_size(png: &[u8]) -> [u32; 2] {
    assert!(png.starts_with(b"\x89PNG"), "no PNG");
    [16, 20].map(|at| u32::from_be_bytes(png[at..at + 4].try_into().expect("four bytes")))
}

#[test]
fn what_a_client_has_is_not_sent_again_until_the_file_grows() {
    let scratch = gyroid("serve-grows", 32);
    let server = Server::start(&scratch, "@g.bvol --mem 64MiB");
    let path = "/api/volumes/g/region?min=0,0,0&max=1,1,1";
    let first = server.get(path).ok();
    let tag = first.header("etag").expect("a tag").to_string();
    let again = |tag: &str| server.get_with(path, &format!("If-None-Match: {tag}\r\n"));
    assert_eq!(again(&tag).status, 304);
    assert_eq!(again("\"other\"").status, 200);

    {
        use brickmarch::store::VolumeWriter;
        let budget = brickmarch::Budget::mib(64);
        let writer = VolumeWriter::open(&scratch.path("g.bvol"), &budget).expect("opens");
        writer.put_constant([0; 3], 0, 2.5).expect("a brick");
        writer.commit().expect("commits");
    }
    let begun = Instant::now();
    while again(&tag).status == 304 {
        assert!(
            begun.elapsed() < Duration::from_secs(20),
            "the new generation is never seen"
        );
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(server.get(path).ok().body, 2.5f32.to_le_bytes());
    let about = server.get("/api/volumes/g").ok().json();
    assert!(about["generation"].as_u64() > Some(1));
}

#[test]
fn a_request_that_does_not_fit_is_told_when_to_come_again() {
    let scratch = ramp("serve-busy");
    let server = Server::start(&scratch, "@g.bvol --mem 64MiB");
    // Regions of 16 MB that nobody reads hold their memory.
    let path = "/api/volumes/g/region?min=0,0,0&max=160,160,160";
    let mut held = Vec::new();
    let refused = (0..60).find_map(|_| {
        let mut socket = server.send(&format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n"));
        let mut head = [0; 12];
        socket.read_exact(&mut head).expect("an answer");
        if head.ends_with(b"200") {
            held.push(socket);
            return None;
        }
        let mut rest = head.to_vec();
        socket
            .set_read_timeout(Some(Duration::from_millis(300)))
            .expect("a time limit");
        let _ = socket.read_to_end(&mut rest);
        Some(Reply::parse(&rest).0)
    });
    let refused = refused.expect("a budget of 64 MiB that holds 60 MB of answers");
    assert_eq!(
        (refused.status, refused.header("retry-after")),
        (503, Some("1"))
    );
    assert!(refused.json()["error"].as_str().is_some());
    drop(held);
    let begun = Instant::now();
    while server.get(path).status != 200 {
        assert!(
            begun.elapsed() < Duration::from_secs(20),
            "the memory never comes back"
        );
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_signal_lets_running_requests_end() {
    let scratch = ramp("serve-stop");
    for signal in ["TERM", "INT"] {
        let mut server = Server::start(&scratch, "@g.bvol --mem 64MiB");
        let path = "/api/volumes/g/region?min=0,0,0&max=160,160,160";
        let mut socket = server.send(&format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n"));
        let mut start = vec![0; 1000];
        socket.read_exact(&mut start).expect("the answer has begun");
        let mut idle = server.send("GET /api/volumes HTTP/1.1\r\nHost: localhost\r\n\r\n");
        let mut some = [0; 12];
        idle.read_exact(&mut some).expect("an answer");
        server.signal(signal);
        std::thread::sleep(Duration::from_millis(300));
        socket
            .read_to_end(&mut start)
            .expect("the rest of the answer");
        let (reply, _) = Reply::parse(&start);
        assert_eq!((reply.status, reply.body.len()), (200, 160 * 160 * 160 * 4));
        let (code, after) = server.wait();
        assert_eq!(code, Some(0), "after SIG{signal}");
        assert!(after < Duration::from_secs(10), "it took {after:?} to stop");
        assert!(std::net::TcpStream::connect(server.address).is_err());
    }
}

#[test]
fn wrong_starts_say_what_is_wrong() {
    let scratch = gyroid("serve-wrong", 24);
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = taken.local_addr().expect("bound");
    for (line, code, says) in [
        ("serve", 2, "VOLUMES"),
        ("serve @missing.bvol", 1, "missing.bvol"),
        ("serve @g.npy", 1, "g.npy"),
        ("serve @g.bvol --mem 1MiB", 1, "--mem"),
        ("serve @g.bvol --listen nowhere", 2, "nowhere"),
        (&format!("serve @g.bvol --listen {address}"), 1, "--listen"),
        (
            "serve @g.bvol --scratch @nofolder --listen 127.0.0.1:0",
            1,
            "nofolder",
        ),
    ] {
        let run = brickmarch(words(&scratch, line));
        assert_eq!(run.code, Some(code), "{line}: {run:?}");
        assert!(run.stderr.contains(says), "{line}: {run:?}");
    }
    // Several volumes, two of one name.
    std::fs::create_dir(scratch.path("other")).expect("a folder");
    std::fs::copy(scratch.path("g.bvol"), scratch.path("other/g.bvol")).expect("copied");
    let server = Server::start(&scratch, "@g.bvol @other/g.bvol @flat.bvol --mem 64MiB");
    let list = server.get("/api/volumes").ok().json();
    assert_eq!(list["volumes"], serde_json::json!(["g", "g-2", "flat"]));
    let mut socket = server.send("");
    let _ = socket.write_all(b"GET / HTTP/1.0\r\n\r\n");
    let mut all = Vec::new();
    socket.read_to_end(&mut all).expect("HTTP/1.0 closes");
    assert_eq!(Reply::parse(&all).0.status, 200);
}
