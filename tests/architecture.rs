//! Who may use whom, read from the sources: `docs/architecture.md` as a test.

use crate::support::data::workspace;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Modules of the engine and what each may use beside itself.
const MAY_USE: [(&str, &[&str]); 14] = [
    ("cpu", &[]),
    ("error", &[]),
    ("budget", &["error"]),
    ("lattice", &["error"]),
    ("sample", &["error"]),
    ("field", &["error", "lattice", "sample"]),
    ("mesh", &["error", "budget", "lattice"]),
    (
        "iso",
        &[
            "cpu", "error", "budget", "lattice", "sample", "field", "mesh",
        ],
    ),
    (
        "store",
        &["cpu", "error", "budget", "lattice", "sample", "field"],
    ),
    ("model", &["error", "lattice", "sample", "field"]),
    ("query", &["error", "budget", "lattice", "sample", "field"]),
    (
        "redistance",
        &[
            "error", "budget", "lattice", "sample", "field", "mesh", "iso",
        ],
    ),
    ("refine", &["error", "budget", "field", "mesh", "model"]),
    (
        "raw_file",
        &["error", "budget", "lattice", "sample", "field"],
    ),
];

/// Names that `engine/src/lib.rs` re-exports, by the module that they come from.
const REEXPORTS: [(&str, &[&str]); 6] = [
    ("budget", &["Budget", "CancelToken", "Permit", "Progress"]),
    ("error", &["Error", "ErrorKind", "Result"]),
    ("field", &["Field", "Range", "Samples"]),
    ("lattice", &["Affine", "Box3", "Grid", "Units"]),
    ("mesh", &["Mesh", "MeshSink"]),
    ("sample", &["Inside", "Kind", "SampleType"]),
];

/// Files that may contain unsafe code, and must say why.
const UNSAFE: [&str; 7] = [
    "engine/src/iso/dispatch.rs",
    "engine/src/iso/dispatch/x86.rs",
    "engine/src/raw_file/map.rs",
    "engine/src/store/filter_vector.rs",
    "engine/src/store/fitted_vector.rs",
    "engine/src/store/map.rs",
    "engine/src/store/rows_vector.rs",
];

/// Names in `crate::...` paths of a source without comments and tests.
fn crate_uses(code: &str) -> Vec<String> {
    let mut out = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        if let Some(group) = rest.strip_prefix('{') {
            let end = group.find('}').unwrap_or(group.len());
            // Only the first segment of each entry counts.
            out.extend(group[..end].split(',').map(|e| first_name(e.trim())));
        } else {
            out.push(first_name(rest));
        }
    }
    out.retain(|name| !name.is_empty());
    out
}

fn first_name(path: &str) -> String {
    path.chars()
        .take_while(|c| c.is_alphanumeric() || *c == '_')
        .collect()
}

/// Source without comments, documentation and the test module at its end.
fn code_of(text: &str) -> String {
    let end = text.find("#[cfg(test)]\nmod tests {").unwrap_or(text.len());
    let lines = text[..end]
        .lines()
        .map(|l| l.split("//").next().unwrap_or(""));
    lines.collect::<Vec<_>>().join("\n")
}

/// Whether a file is a module that its parent declares for tests only.
fn is_test_only(path: &Path) -> bool {
    let (Some(dir), Some(stem)) = (path.parent(), path.file_stem()) else {
        return false;
    };
    let declared = format!("#[cfg(test)]\nmod {};", stem.to_string_lossy());
    let parents = [
        dir.join("mod.rs"),
        dir.join("lib.rs"),
        dir.join("main.rs"),
        dir.with_extension("rs"),
    ];
    let mut texts = parents.iter().filter_map(|p| fs::read_to_string(p).ok());
    texts.any(|text| text.contains(&declared))
}

/// Source files below a folder, without those that are tests only.
fn sources(dir: &Path) -> Vec<PathBuf> {
    let mut out = Vec::new();
    for entry in fs::read_dir(dir).unwrap_or_else(|e| panic!("{}: {e}", dir.display())) {
        let path = entry.expect("readable").path();
        if path.is_dir() {
            if path
                .file_name()
                .is_some_and(|n| n != "target" && n != ".git")
                && !is_test_only(&path)
            {
                out.extend(sources(&path));
            }
        } else if path.extension().is_some_and(|e| e == "rs") && !is_test_only(&path) {
            out.push(path);
        }
    }
    out.sort();
    out
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The top-level module of a file below `engine/src`.
fn module_of(path: &Path, src: &Path) -> String {
    let inner = path.strip_prefix(src).expect("below src");
    let first = inner.components().next().expect("not empty");
    let name = first.as_os_str().to_string_lossy();
    name.trim_end_matches(".rs").to_string()
}

#[test]
fn engine_modules_use_only_what_they_may() {
    let src = workspace().join("engine/src");
    let allowed: BTreeMap<&str, &[&str]> = MAY_USE.into_iter().collect();
    let mut wrong = Vec::new();
    for path in sources(&src) {
        let module = module_of(&path, &src);
        if module == "lib" {
            continue;
        }
        let Some(may) = allowed.get(module.as_str()) else {
            wrong.push(format!(
                "module {module} is not in the table of docs/architecture.md"
            ));
            continue;
        };
        for name in crate_uses(&code_of(&read(&path))) {
            let from = REEXPORTS
                .iter()
                .find(|(_, names)| names.contains(&name.as_str()));
            let used = from.map_or(name.as_str(), |(module, _)| module);
            if used != module && !may.contains(&used) {
                wrong.push(format!(
                    "{}: {module} uses {used} (as crate::{name})",
                    path.display()
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_table_is_the_one_in_the_docs() {
    let docs = read(&workspace().join("docs/architecture.md"));
    for (module, may) in MAY_USE {
        let may = if may.is_empty() {
            "nothing".to_string()
        } else {
            may.join(", ")
        };
        let row = format!("| `{module}` | {may} |");
        assert!(
            docs.contains(&row),
            "docs/architecture.md lacks the row: {row}"
        );
    }
}

#[test]
fn the_engine_prints_nothing_and_reads_no_environment() {
    let wrong = offences(
        "engine/src",
        // A module of tests, behind cfg(test).
        &["engine/src/store/measure.rs"],
        &[
            "println!",
            "eprintln!",
            "print!(",
            "env::var",
            "build_global(",
        ],
    );
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn formats_do_not_mesh_and_tools_do_not_reach_into_cells() {
    let wrong = offences("formats/src", &[], &["iso::", "data_gen"]);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Exact answers must not come from the thing under test: in `data-gen` only the adapter and the
/// program (with its writer) may name the engine.
#[test]
fn ground_truth_does_not_use_the_engine() {
    let writers = [
        "data-gen/src/adapter.rs",
        "data-gen/src/main.rs",
        "data-gen/src/texture_field.rs",
        "data-gen/src/write.rs",
    ];
    let wrong = offences("data-gen/src", &writers, &["brickmarch::"]);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn unsafe_code_is_where_it_may_be_and_says_why() {
    let mut wrong = Vec::new();
    for package in ["engine", "formats", "tools", "data-gen", "tests", "benches"] {
        for path in sources(&workspace().join(package)) {
            let name = relative(&path);
            let text = read(&path);
            let code = code_of(&text);
            let uses = code.contains("unsafe ") && !name.ends_with("tests/architecture.rs");
            if uses && !UNSAFE.contains(&name.as_str()) {
                wrong.push(format!(
                    "{name}: unsafe code; add it to the list only with a reason"
                ));
            }
            if uses
                && !(code.contains("unsafe_code")
                    && code.contains("reason =")
                    && text.contains("SAFETY"))
            {
                wrong.push(format!(
                    "{name}: unsafe code without a reason or a SAFETY comment"
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn nothing_names_a_place_on_one_machine() {
    // Written apart, so that this file does not find itself.
    let folders = ["work", "home", "root", "farm"].map(|f| format!("/{f}/"));
    let mut wrong = Vec::new();
    for path in tracked_texts(&workspace()) {
        let text = read(&path);
        for (number, line) in text.lines().enumerate() {
            let found = folders.iter().any(|folder| {
                line.match_indices(folder.as_str()).any(|(at, _)| {
                    let before = line[..at].chars().next_back();
                    let after = line[at + folder.len()..].chars().next();
                    !before.is_some_and(|c| c.is_alphanumeric() || "_.-/".contains(c))
                        && after.is_some_and(char::is_alphabetic)
                })
            });
            if found {
                wrong.push(format!(
                    "{}:{}: {}",
                    relative(&path),
                    number + 1,
                    line.trim()
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn relative(path: &Path) -> String {
    let inner = path.strip_prefix(workspace()).unwrap_or(path);
    inner.to_string_lossy().into_owned()
}

fn offences(dir: &str, except: &[&str], needles: &[&str]) -> Vec<String> {
    let mut out = Vec::new();
    for path in sources(&workspace().join(dir)) {
        let name = relative(&path);
        let code = code_of(&read(&path));
        let found = needles.iter().filter(|n| code.contains(**n));
        if !except.contains(&name.as_str()) {
            out.extend(found.map(|n| format!("{name}: {n}")));
        }
    }
    out
}

/// Sources, scripts, manifests and documents of the workspace.
fn tracked_texts(dir: &Path) -> Vec<PathBuf> {
    let mut out = Vec::new();
    for entry in fs::read_dir(dir).expect("readable") {
        let path = entry.expect("readable").path();
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        if path.is_dir() {
            if name != "target" && name != ".git" && name != ".venv" {
                out.extend(tracked_texts(&path));
            }
        } else if ["rs", "md", "toml", "py", "sh"]
            .iter()
            .any(|e| name.ends_with(&format!(".{e}")))
            || ["run", "check", "deep", "bench"].contains(&name.as_str())
        {
            out.push(path);
        }
    }
    out
}
