//! Running the real program, and seeing from outside how much memory it takes.

use super::data::workspace;
use std::ffi::OsStr;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
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
    /// Time of all its threads on a processor.
    pub(crate) cpu: Duration,
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

/// Runs a command, collecting its output, its peak memory and its time.
pub(crate) fn run(command: &mut Command) -> Run {
    let text = format!("{command:?}");
    command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut child = command.spawn().unwrap_or_else(|e| panic!("{text}: {e}"));
    let stdout = child.stdout.take().expect("piped");
    let stderr = child.stderr.take().expect("piped");
    let (stdout, stderr, (peak_bytes, cpu)) = std::thread::scope(|scope| {
        let [stdout, stderr] = [
            scope.spawn(|| read_all(stdout)),
            scope.spawn(|| read_all(stderr)),
        ];
        let watched = watch(child.id());
        let text = |reader: std::thread::ScopedJoinHandle<'_, String>| {
            reader.join().expect("a pipe can be read")
        };
        (text(stdout), text(stderr), watched)
    });
    let status = child.wait().expect("waiting for a child works");
    Run {
        code: status.code(),
        stdout,
        stderr,
        peak_bytes,
        cpu,
        command: text,
    }
}

fn read_all(mut pipe: impl Read) -> String {
    let mut bytes = Vec::new();
    pipe.read_to_end(&mut bytes).expect("a pipe can be read");
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Peak memory and time of a child until it ends; nobody may wait for it meanwhile.
///
/// The memory is the kernel's high-water mark of the process (`VmHWM`), which only grows, so that
/// looking often misses at most what the last moment added. (`ru_maxrss` would not do: a child inherits
/// there the mark of the process that started it.) The time of all its threads, in user and kernel
/// mode, is exact to a tick: what ended and was not waited for still has it.
fn watch(child: u32) -> (u64, Duration) {
    let (mut peak, mut cpu) = (0, Duration::ZERO);
    // Where there is no such file nothing is measured.
    while let Ok(stat) = std::fs::read_to_string(format!("/proc/{child}/stat")) {
        // The name of the program, in brackets, may hold anything.
        let rest = stat.rsplit_once(") ").expect("proc(5) says so").1;
        let fields: Vec<&str> = rest.split(' ').collect();
        let ticks = |n: usize| fields[n].parse::<u64>().expect("a number of ticks");
        // A hundred a second, whatever the kernel counts in.
        cpu = Duration::from_millis(10 * (ticks(11) + ticks(12)));
        if fields[0] == "Z" {
            break;
        }
        if let Ok(text) = std::fs::read_to_string(format!("/proc/{child}/status")) {
            let kib = text.lines().find_map(|l| l.strip_prefix("VmHWM:"));
            let kib = kib
                .and_then(|v| v.trim().strip_suffix(" kB"))
                .and_then(|v| v.trim().parse::<u64>().ok());
            peak = peak.max(kib.unwrap_or(0) * 1024);
        }
        std::thread::sleep(Duration::from_micros(200));
    }
    (peak, cpu)
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

/// What an example of the library prints, that `cargo build --examples` makes: unoptimised, since linking all of
/// them in release takes minutes.
pub(crate) fn example(name: &str, args: &[&Path]) -> String {
    static DONE: OnceLock<()> = OnceLock::new();
    DONE.get_or_init(|| {
        let cargo = std::env::var_os("CARGO").unwrap_or("cargo".into());
        let output = Command::new(cargo)
            .args(["build", "--quiet", "--examples", "-p", "brickmarch-tools"])
            .current_dir(workspace())
            .output()
            .expect("cargo runs");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "building examples:\n{stderr}");
    });
    let profiles = build_dir();
    let built = profiles.parent().expect("a folder of profiles");
    let output = Command::new(built.join("debug/examples").join(name))
        .args(args)
        .output()
        .expect("the example runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{name}: {stderr}");
    String::from_utf8(output.stdout).expect("text")
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
    start_with(args, Stdio::null())
}

/// The same with its standard output in a pipe.
pub(crate) fn start_piped(args: impl IntoIterator<Item = String>) -> std::process::Child {
    start_with(args, Stdio::piped())
}

fn start_with(args: impl IntoIterator<Item = String>, stdout: Stdio) -> std::process::Child {
    let mut command = Command::new(binary("brickmarch-tools", "brickmarch"));
    command
        .args(args)
        .stdin(Stdio::null())
        .stdout(stdout)
        .stderr(Stdio::null());
    command
        .spawn()
        .unwrap_or_else(|e| panic!("{command:?}: {e}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bound on a time that is not measured would always hold.
    #[test]
    fn work_takes_time_on_a_processor_and_sleep_does_not() {
        let bash = |script: &str| run(Command::new("bash").args(["-c", script])).success();
        let work = bash("for ((i = 0; i < 300000; i++)); do :; done");
        assert!(work.cpu >= Duration::from_millis(50), "{work:?}");
        assert!(work.peak_bytes > 0, "{work:?}");
        let sleep = bash("sleep 0.3; echo awake; echo late >&2");
        assert!(sleep.cpu < Duration::from_millis(100), "{sleep:?}");
        assert_eq!((&*sleep.stdout, &*sleep.stderr), ("awake\n", "late\n"));
    }
}
