//! Running the real program, and seeing from outside how much memory it takes.

use super::data::workspace;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

/// What a run of the program did.
#[derive(Debug)]
pub(crate) struct Run {
    /// Exit code; `None` when a signal ended it.
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
    /// Peak resident memory as the kernel counted it, read from outside while it ran.
    pub(crate) peak_bytes: u64,
    command: String,
}

impl Run {
    /// The run, when it succeeded.
    #[track_caller]
    pub(crate) fn success(self) -> Self {
        assert_eq!(self.code, Some(0), "{self:#?}");
        self
    }

    /// The JSON object on standard output.
    #[track_caller]
    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("no JSON ({e}): {self:#?}"))
    }
}

/// Runs `brickmarch` with `args` and waits for its end.
pub(crate) fn brickmarch<S: AsRef<OsStr>>(args: impl IntoIterator<Item = S>) -> Run {
    run(Command::new(binary("brickmarch-tools", "brickmarch")).args(args))
}

/// Runs the generator of test data.
pub(crate) fn data_gen<S: AsRef<OsStr>>(args: impl IntoIterator<Item = S>) -> Run {
    run(Command::new(binary("brickmarch-data-gen", "brickmarch-data-gen")).args(args))
}

/// Runs a command, collecting its output and its peak memory.
pub(crate) fn run(command: &mut Command) -> Run {
    let text = format!("{command:?}");
    command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let child = command.spawn().unwrap_or_else(|e| panic!("{text}: {e}"));
    let status = PathBuf::from(format!("/proc/{}/status", child.id()));
    let done = std::sync::atomic::AtomicBool::new(false);
    let (output, peak_bytes) = std::thread::scope(|scope| {
        let watcher = scope.spawn(|| watch_peak(&status, &done));
        let output = child.wait_with_output();
        done.store(true, std::sync::atomic::Ordering::Release);
        (output, watcher.join().expect("the watcher does not panic"))
    });
    let Output {
        status,
        stdout,
        stderr,
    } = output.expect("waiting for a child works");
    Run {
        code: status.code(),
        stdout: String::from_utf8_lossy(&stdout).into_owned(),
        stderr: String::from_utf8_lossy(&stderr).into_owned(),
        peak_bytes,
        command: text,
    }
}

/// The kernel's high-water mark of the process (`VmHWM`), which only grows, so that looking often
/// misses at most what the last moment added. (`ru_maxrss` would not do: a child inherits there
/// the mark of the process that started it.)
fn watch_peak(status: &Path, done: &std::sync::atomic::AtomicBool) -> u64 {
    let mut peak = 0;
    while !done.load(std::sync::atomic::Ordering::Acquire) {
        if let Ok(text) = std::fs::read_to_string(status) {
            let kib = text.lines().find_map(|l| l.strip_prefix("VmHWM:"));
            let kib = kib
                .and_then(|v| v.trim().strip_suffix(" kB"))
                .and_then(|v| v.trim().parse::<u64>().ok());
            peak = peak.max(kib.unwrap_or(0) * 1024);
        }
        std::thread::sleep(Duration::from_micros(200));
    }
    peak
}

/// Path of a program of this workspace, in the build directory and the profile of this test.
fn binary(package: &str, name: &str) -> PathBuf {
    let path = build_dir().join(name);
    build(package);
    assert!(
        path.exists(),
        "{} is missing: run `cargo build{} -p {package}` first",
        path.display(),
        if cfg!(debug_assertions) {
            ""
        } else {
            " --release"
        }
    );
    path
}

fn build_dir() -> PathBuf {
    let test = std::env::current_exe().expect("a running program has a path");
    let deps = test.parent().expect("tests lie in a folder");
    deps.parent()
        .expect("which lies in the build directory")
        .to_path_buf()
}

/// Brings the programs up to date once per test process, so that no test ever judges an old build.
/// Without Cargo (the test program started by hand) what is there is taken.
fn build(package: &str) {
    static DONE: OnceLock<()> = OnceLock::new();
    DONE.get_or_init(|| {
        let Some(cargo) = std::env::var_os("CARGO") else {
            return;
        };
        let mut command = Command::new(cargo);
        command.args([
            "build",
            "--quiet",
            "-p",
            "brickmarch-tools",
            "-p",
            "brickmarch-data-gen",
        ]);
        if !cfg!(debug_assertions) {
            command.arg("--release");
        }
        let output = command
            .current_dir(workspace())
            .output()
            .expect("cargo runs");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.success(),
            "building {package} failed:\n{stderr}"
        );
    });
}

/// Runs `brickmarch` where no file may grow beyond `kib` KiB.
pub(crate) fn limited(args: impl IntoIterator<Item = String>, kib: u32) -> Run {
    let script = format!("trap '' XFSZ; ulimit -f {kib}; exec \"$@\"");
    let program = binary("brickmarch-tools", "brickmarch");
    run(Command::new("bash")
        .args(["-c", &script, "limited"])
        .arg(program)
        .args(args))
}

/// Starts `brickmarch` without waiting for it.
pub(crate) fn start(args: impl IntoIterator<Item = String>) -> std::process::Child {
    let mut command = Command::new(binary("brickmarch-tools", "brickmarch"));
    command
        .args(args)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    command
        .spawn()
        .unwrap_or_else(|e| panic!("{command:?}: {e}"))
}
