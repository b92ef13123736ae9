//! Where the shared real data are: `BRICKMARCH_DATA`, or `../shared/data` beside the workspace.

use super::report::skipped;
use std::path::{Path, PathBuf};

/// The root of the workspace.
pub(crate) fn workspace() -> PathBuf {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR"));
    tests
        .parent()
        .expect("tests lies in the workspace")
        .to_path_buf()
}

fn root() -> PathBuf {
    std::env::var_os("BRICKMARCH_DATA")
        .map_or_else(|| workspace().join("../shared/data"), PathBuf::from)
}

/// A file of the shared data, or a loud skip of `what`.
pub(crate) fn shared(name: &str, what: &str) -> Option<PathBuf> {
    let path = root().join(name);
    if path.exists() {
        return Some(path);
    }
    skipped(&format!(
        "{what}: no {name} in {} (set BRICKMARCH_DATA to the folder of test data)",
        root().display()
    ));
    None
}

/// The independent checker `ply_check.py`, which lies beside the data and not in this repository.
pub(crate) fn ply_check(what: &str) -> Option<PathBuf> {
    let path = root().join("../verify/ply_check.py");
    if path.exists() {
        return Some(path);
    }
    skipped(&format!(
        "{what}: no independent checker at {}",
        path.display()
    ));
    None
}
