//! Requests that no browser sends. Each is refused cleanly, and the server goes on.

use super::client::{Reply, Server};
use super::{gyroid, ramp};
use std::io::{Read, Write};
use std::time::{Duration, Instant};

const R: &str = "/api/volumes/g/region";

#[test]
fn well_formed_requests_for_what_there_is_not() {
    let scratch = gyroid("serve-refused", 48);
    let server = Server::start(&scratch, "@g.bvol --mem 64MiB --max-region-bytes 100000");
    let huge = "9".repeat(1000);
    let v = "/api/volumes/g";
    for (path, status) in [
        ("/nothing".to_string(), 404),
        ("/api/volumes/nobody".to_string(), 404),
        (
            "/api/volumes/nobody/region?min=0,0,0&max=1,1,1".to_string(),
            404,
        ),
        ("/../../etc/passwd".to_string(), 404),
        ("/api/volumes/../../../../etc/passwd".to_string(), 404),
        ("/api/volumes/..%2F..%2F..%2Fetc%2Fpasswd".to_string(), 404),
        ("/api/volumes/%2e%2e/region".to_string(), 404),
        ("/api/volumes/g.bvol".to_string(), 404),
        (
            format!("/api/volumes/{}", scratch.path("g.bvol").display()),
            404,
        ),
        (
            format!(
                "/api/volumes/{}",
                scratch
                    .path("g.bvol")
                    .display()
                    .to_string()
                    .replace('/', "%2F")
            ),
            404,
        ),
        ("/api/volumes/%00".to_string(), 404),
        ("/api/volumes/%ff".to_string(), 400),
        ("/api/volumes/%".to_string(), 400),
        (format!("/api/volumes/{}", "x".repeat(4000)), 414),
        (format!("{R}?min=0,0,0"), 400),
        (format!("{R}?max=1,1,1"), 400),
        (format!("{R}?min=0,0,0&max=48,48,48"), 413),
        (format!("{R}?min=0,0,0&max=49,1,1"), 400),
        (format!("{R}?min=-1,0,0&max=1,1,1"), 400),
        (format!("{R}?min=0,0,0&max=0,1,1"), 400),
        (format!("{R}?min=5,5,5&max=1,1,1"), 400),
        (
            format!(
                "{R}?min=-2147483648,-2147483648,-2147483648&max=2147483647,2147483647,2147483647"
            ),
            400,
        ),
        (format!("{R}?min=0,0,0&max=2147483648,1,1"), 400),
        (format!("{R}?min=0,0,0&max={huge},1,1"), 400),
        (format!("{R}?min=0,0,0&max=NaN,1,1"), 400),
        (format!("{R}?min=0,0,0&max=1e3,1,1"), 400),
        (format!("{R}?min=0,0,0&max=1,1"), 400),
        (format!("{R}?min=0,0,0&max=1,1,1,1"), 400),
        (format!("{R}?min=0,0,0&min=0,0,0&max=1,1,1"), 400),
        (format!("{R}?min=0,0,0&max=1,1,1&path=/etc/passwd"), 400),
        (format!("{R}?min=0,0,0&max=1,1,1&level=3"), 400),
        (format!("{R}?min=0,0,0&max=1,1,1&level=256"), 400),
        (format!("{R}?min=0,0,0&max=1,1,1&level=-1"), 400),
        (format!("{R}?min=0,0,0&max=1,1,1&format=exe"), 400),
        (format!("{R}?min=%zz&max=1,1,1"), 400),
        (format!("{v}/slice?axis=w"), 400),
        (format!("{v}/slice?at=48"), 400),
        (format!("{v}/slice?at=-1"), 400),
        (format!("{v}/slice?at=nan"), 400),
        (format!("{v}/slice?window=1:1"), 400),
        (format!("{v}/slice?window=nan:inf"), 400),
        (format!("{v}/slice?window=1e999:2"), 400),
        (format!("{v}/slice?scale=1e9"), 400),
        (format!("{v}/slice?scale=NaN"), 400),
        (format!("{v}/slice?scale=16"), 413),
        (format!("{v}/slice?map=rainbow"), 400),
        (format!("{v}/value"), 400),
        (format!("{v}/value?at=48,0,0"), 400),
        (format!("{v}/value?at=0,0,{huge}"), 400),
        (format!("{v}/mesh"), 400),
        (format!("{v}/mesh?iso=NaN"), 400),
        (format!("{v}/mesh?iso=1e40"), 400),
        (format!("{v}/mesh?iso=0&label=1"), 400),
        (format!("{v}/mesh?iso=0&format=exe"), 400),
        (format!("{v}/mesh?iso=-77"), 422),
        (format!("{v}/mesh?iso=0"), 413),
        (format!("{v}/preview?iso=0&size=8192x8192"), 413),
        (format!("{v}/preview?iso=0&size=0x0"), 400),
        (format!("{v}/preview?iso=0&view=1"), 400),
        (format!("{v}/preview?iso=0&view=nan,0"), 400),
    ] {
        let reply = server.get(&path);
        assert_eq!(reply.status, status, "{path}: {reply:?}");
        let said = reply.json();
        assert_eq!(said["status"], status, "{path}");
        let why = said["error"].as_str().expect("a reason");
        assert!(why.len() > 8 && why.len() < 600, "{path}: {why}");
        let folder = scratch.dir().to_string_lossy();
        assert!(
            path.replace("%2F", "/").contains(&*folder) || !why.contains(&*folder),
            "a path is told: {why}"
        );
    }
    server.get("/api/volumes/g").ok();
}

#[test]
fn requests_that_are_none() {
    let scratch = gyroid("serve-hostile", 48);
    let server = Server::start(&scratch, "@g.bvol --mem 64MiB");
    let before = server.memory("VmHWM");
    let host = "Host: localhost\r\n";
    let many: String = (0..200).map(|i| format!("x{i}: y\r\n")).collect();
    for (text, statuses) in [
        ("\r\n\r\n\r\n\r\n".to_string(), &[400][..]),
        ("NONSENSE\r\n\r\n".to_string(), &[400]),
        ("GET\r\n\r\n".to_string(), &[400]),
        (format!("GET / HTTP/9.9\r\n{host}\r\n"), &[400, 505]),
        (format!("GET  /  HTTP/1.1\r\n{host}\r\n"), &[400]),
        (
            format!("GET / HTTP/1.1\r\n{host} folded: x\r\n\r\n"),
            &[400],
        ),
        (format!("GET / HTTP/1.1\r\nNo colon\r\n{host}\r\n"), &[400]),
        (format!("GET /\0 HTTP/1.1\r\n{host}\r\n"), &[400]),
        (format!("GET /\u{fc} HTTP/1.1\r\n{host}\r\n"), &[400, 404]),
        ("GET / HTTP/1.1\r\n\r\n".to_string(), &[400]),
        (format!("GET / HTTP/1.1\r\n{host}{host}\r\n"), &[400]),
        (
            "GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n".to_string(),
            &[421],
        ),
        (
            "GET / HTTP/1.1\r\nHost: localhost.evil.example:80\r\n\r\n".to_string(),
            &[421],
        ),
        (
            format!("GET http://evil.example/ HTTP/1.1\r\n{host}\r\n"),
            &[421],
        ),
        (
            format!("GET / HTTP/1.1\r\n{host}X: {}\r\n\r\n", "x".repeat(1 << 20)),
            &[431],
        ),
        (format!("GET / HTTP/1.1\r\n{host}{many}\r\n"), &[431]),
        (
            format!("GET /{} HTTP/1.1\r\n{host}\r\n", "x".repeat(12_000)),
            &[414],
        ),
        (
            format!("GET /{} HTTP/1.1\r\n{host}\r\n", "x".repeat(1 << 20)),
            &[414, 431],
        ),
        (
            format!("POST / HTTP/1.1\r\n{host}Content-Length: 5\r\n\r\nhello"),
            &[405],
        ),
        (format!("PUT /api/volumes/g HTTP/1.1\r\n{host}\r\n"), &[405]),
        (
            format!("DELETE /api/volumes/g HTTP/1.1\r\n{host}\r\n"),
            &[405],
        ),
        (format!("OPTIONS * HTTP/1.1\r\n{host}\r\n"), &[405]),
        (
            format!("CONNECT evil.example:80 HTTP/1.1\r\n{host}\r\n"),
            &[405],
        ),
        (format!("TRACE / HTTP/1.1\r\n{host}\r\n"), &[405]),
        (
            format!("GET / HTTP/1.1\r\n{host}Content-Length: 99999999999\r\n\r\nx"),
            &[413],
        ),
        (
            format!("GET / HTTP/1.1\r\n{host}Content-Length: 99999999999999999999999\r\n\r\n"),
            &[400],
        ),
        (
            format!("GET / HTTP/1.1\r\n{host}Content-Length: -1\r\n\r\n"),
            &[400],
        ),
        (
            format!("GET / HTTP/1.1\r\n{host}Content-Length: 1\r\nContent-Length: 2\r\n\r\nxx"),
            &[400],
        ),
        (
            format!("GET / HTTP/1.1\r\n{host}Transfer-Encoding: chunked\r\n\r\nzzzz\r\n"),
            &[413],
        ),
        (
            format!(
                "GET / HTTP/1.1\r\n{host}Transfer-Encoding: chunked\r\nContent-Length: 3\r\n\r\n0\r\n\r\n"
            ),
            &[400, 413],
        ),
        ("PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".to_string(), &[400, 505]),
        ("\u{16}\u{3}\u{1}\u{2}\0\u{1}\0\u{1}".to_string(), &[400]),
    ] {
        let shown: String = text.chars().take(60).collect();
        let mut socket = server.connect();
        // The server may have refused and closed before it has all.
        let _ = socket.write_all(text.as_bytes());
        let _ = socket.shutdown(std::net::Shutdown::Write);
        let mut all = Vec::new();
        let ended = socket.read_to_end(&mut all);
        if all.is_empty() {
            // Closed, or reset where we were still sending.
            continue;
        }
        let _ = ended;
        let (reply, _) = Reply::parse(&all);
        assert!(statuses.contains(&reply.status), "{shown:?}: {reply:?}");
        server.get("/api/volumes").ok();
    }
    if let (Some(before), Some(after)) = (before, server.memory("VmHWM")) {
        assert!(after < before + (8 << 20), "{before} bytes grew to {after}");
    }
}

#[test]
fn slow_clients_do_not_hinder_others() {
    let scratch = ramp("serve-slow");
    let server = Server::start(&scratch, "@g.bvol --mem 64MiB");
    // More of them than there are threads: some say nothing, some stop in the middle, some never
    // read what they asked for.
    let mut slow = Vec::new();
    for i in 0..60 {
        slow.push(server.send(match i % 3 {
            0 => "",
            1 => "GET / HTTP/1.1\r\nHost: local",
            _ => "GET /api/volumes/g/region?min=0,0,0&max=160,160,160 HTTP/1.1\r\nHost: localhost\r\n\r\n",
        }));
    }
    let begun = Instant::now();
    for _ in 0..20 {
        server
            .get("/api/volumes/g/region?min=0,0,0&max=16,16,16")
            .ok();
    }
    assert!(
        begun.elapsed() < Duration::from_secs(15),
        "{:?}",
        begun.elapsed()
    );
    // One byte now and then does not keep a connection.
    let mut drip = server.send("GET / HTTP/1.1\r\n");
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(25) {
        std::thread::sleep(Duration::from_millis(400));
        if drip.write_all(b"x").is_err() {
            break;
        }
    }
    assert!(
        begun.elapsed() < Duration::from_secs(12),
        "a dripping client stays"
    );
    // Those that said nothing were closed as well.
    let mut rest = Vec::new();
    slow[0]
        .set_read_timeout(Some(Duration::from_secs(15)))
        .expect("a time limit");
    let closed = slow[0].read_to_end(&mut rest);
    assert!(closed.is_ok() || rest.is_empty(), "{closed:?}");
    server.get("/api/volumes").ok();
}
