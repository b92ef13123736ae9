//! A server under test, and a client that can also misbehave.

use crate::cli::words;
use crate::support::program::start_piped;
use crate::support::scratch::Scratch;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

/// A running server; killed when dropped.
pub(crate) struct Server {
    child: Child,
    pub(crate) address: SocketAddr,
}

/// An answer.
#[derive(Debug)]
pub(crate) struct Reply {
    pub(crate) status: u16,
    headers: Vec<(String, String)>,
    pub(crate) body: Vec<u8>,
}

impl Server {
    /// Starts `serve` with `args` on a free port.
    pub(crate) fn start(scratch: &Scratch, args: &str) -> Server {
        let line = format!("serve {args} --listen 127.0.0.1:0 --json");
        let mut child = start_piped(words(scratch, &line));
        let mut text = String::new();
        let stdout = child.stdout.take().expect("piped");
        BufReader::new(stdout).read_line(&mut text).expect("a line");
        let said: serde_json::Value = serde_json::from_str(&text)
            .unwrap_or_else(|e| panic!("{line} did not start: {text:?}: {e}"));
        let address = said["address"].as_str().and_then(|a| a.parse().ok());
        Server {
            child,
            address: address.expect("an address"),
        }
    }

    /// A connection with time limits.
    pub(crate) fn connect(&self) -> TcpStream {
        let socket = TcpStream::connect(self.address).expect("it listens");
        let limit = Some(Duration::from_secs(60));
        socket.set_read_timeout(limit).expect("a time limit");
        socket.set_write_timeout(limit).expect("a time limit");
        socket.set_nodelay(true).expect("no delay");
        socket
    }

    /// A connection on which `text` was sent.
    pub(crate) fn send(&self, text: &str) -> TcpStream {
        let mut socket = self.connect();
        socket.write_all(text.as_bytes()).expect("sends");
        socket
    }

    pub(crate) fn get(&self, path: &str) -> Reply {
        self.get_with(path, "")
    }

    /// The same with further header lines.
    pub(crate) fn get_with(&self, path: &str, lines: &str) -> Reply {
        let mut socket = self.send(&format!(
            "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{lines}\r\n"
        ));
        let mut all = Vec::new();
        socket.read_to_end(&mut all).expect("an answer");
        Reply::parse(&all).0
    }

    /// One of the numbers of bytes that the system keeps of the process: VmHWM, VmRSS.
    pub(crate) fn memory(&self, name: &str) -> Option<u64> {
        let path = format!("/proc/{}/status", self.child.id());
        let text = std::fs::read_to_string(path).ok()?;
        let line = text.lines().find_map(|l| l.strip_prefix(name))?;
        let kib = line.trim_start_matches(':').trim().strip_suffix(" kB")?;
        kib.parse::<u64>().ok().map(|v| v << 10)
    }

    /// Sends a signal to the process, which is ours and not yet waited for.
    pub(crate) fn signal(&self, name: &str) {
        let kill = Command::new("kill")
            .args([&format!("-{name}"), &self.child.id().to_string()])
            .status();
        assert!(kill.is_ok_and(|s| s.success()), "kill works");
    }

    /// Waits for the end: the exit code, and how long it took.
    pub(crate) fn wait(&mut self) -> (Option<i32>, Duration) {
        let begun = Instant::now();
        let code = self.child.wait().expect("waiting for a child works").code();
        (code, begun.elapsed())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Reply {
    /// Reads an answer; gives what stands behind it too.
    pub(crate) fn parse(all: &[u8]) -> (Reply, usize) {
        let end = all.windows(4).position(|w| w == b"\r\n\r\n");
        let end = end.unwrap_or_else(|| panic!("no head: {:?}", String::from_utf8_lossy(all)));
        let head = std::str::from_utf8(&all[..end]).expect("a head is text");
        let mut lines = head.split("\r\n");
        let status = lines.next().and_then(|l| l.split(' ').nth(1));
        let headers: Vec<(String, String)> = lines
            .filter_map(|l| l.split_once(':'))
            .map(|(name, value)| (name.to_ascii_lowercase(), value.trim().to_string()))
            .collect();
        let length = headers.iter().find(|(n, _)| n == "content-length");
        let length = length.map_or(0, |(_, v)| v.parse().expect("a number"));
        let body = all[end + 4..]
            .iter()
            .copied()
            .take(length)
            .collect::<Vec<u8>>();
        let used = end + 4 + body.len();
        let reply = Reply {
            status: status.and_then(|s| s.parse().ok()).expect("a status"),
            headers,
            body,
        };
        if reply.status == 200 {
            assert_eq!(reply.body.len(), length, "the body is cut off");
        }
        (reply, used)
    }

    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        let found = self.headers.iter().find(|(n, _)| n == name);
        found.map(|(_, value)| value.as_str())
    }

    /// The reply, when it is a good one.
    #[track_caller]
    pub(crate) fn ok(self) -> Reply {
        assert_eq!(
            self.status,
            200,
            "{:?}",
            String::from_utf8_lossy(&self.body)
        );
        self
    }

    #[track_caller]
    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|e| panic!("no JSON: {e}: {self:?}"))
    }
}

/// A client that keeps its connection.
pub(crate) struct Keeper<'a> {
    server: &'a Server,
    socket: BufReader<TcpStream>,
    used: Instant,
}

impl Keeper<'_> {
    pub(crate) fn new(server: &Server) -> Keeper<'_> {
        Keeper {
            server,
            socket: BufReader::new(server.connect()),
            used: Instant::now(),
        }
    }

    pub(crate) fn get(&mut self, path: &str) -> Reply {
        if self.used.elapsed() > Duration::from_secs(2) {
            // The server may be closing what was idle for so long.
            self.socket = BufReader::new(self.server.connect());
        }
        let text = format!("GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
        self.socket
            .get_mut()
            .write_all(text.as_bytes())
            .expect("sends");
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            let count = self.socket.read_until(b'\n', &mut head).expect("a head");
            assert!(count > 0, "closed: {:?}", String::from_utf8_lossy(&head));
        }
        let text = String::from_utf8(head.clone()).expect("a head is text");
        let length = text.lines().find_map(|l| {
            let (name, value) = l.split_once(':')?;
            name.eq_ignore_ascii_case("content-length")
                .then(|| value.trim().parse().expect("a number"))
        });
        let start = head.len();
        head.resize(start + length.unwrap_or(0), 0);
        self.socket.read_exact(&mut head[start..]).expect("a body");
        self.used = Instant::now();
        Reply::parse(&head).0
    }
}
