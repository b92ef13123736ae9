//! A mesh that is made in parts: one task for each, and one that joins them.

use super::own_folder;
use super::plan::{Task, Word};
use brickmarch::{Error, Result};
use std::path::Path;
use toml::{Table, Value};

/// Parts of a mesh at most.
const MOST: i64 = 4096;

/// How many parts the meshes of a table are cut in.
///
/// # Errors
/// For another operation, for a count that is none, and for options that need the mesh as a whole.
pub(super) fn count(table: &Table) -> Result<Option<usize>> {
    let tiles = match table.get("tiles") {
        None => return Ok(None),
        Some(Value::Integer(n)) if (1..=MOST).contains(n) => *n as usize,
        Some(other) => {
            return Err(Error::bad_input(format!(
                "tiles = {other}: a number from 1 to {MOST}"
            )));
        }
    };
    if table.get("op").and_then(Value::as_str) != Some("mesh") {
        return Err(Error::bad_input("`tiles` is for op = \"mesh\" only"));
    }
    Ok(Some(tiles))
}

/// Makes `task` the one that joins the parts and gives the tasks that make them, which will have the
/// numbers from `first` on.
pub(super) fn cut(task: &mut Task, tiles: usize, first: usize, out: &Path) -> Vec<Task> {
    let key = crc32c::crc32c(task.key.as_bytes());
    let folder = own_folder(out).join("parts");
    let mut words = vec![Word::Made(name_of(task.output.as_deref()))];
    let mut parts = Vec::new();
    for number in 1..=tiles {
        // The number of the task keeps two of one checksum apart.
        let name = format!("{first}-{key:08x}-{number}of{tiles}.part");
        let path = folder.join(&name);
        words.push(Word::Plain(path.to_string_lossy().into_owned()));
        let mut part = task.clone();
        part.name = format!("{} part {number}/{tiles}", task.name);
        part.output = Some(path);
        part.part_for = Some(first + tiles);
        for word in &mut part.words {
            if let Word::Made(made) = word {
                made.clone_from(&name);
            }
        }
        part.words
            .push(Word::Plain(format!("--part={number}/{tiles}")));
        part.key = serde_json::json!(part.line()).to_string();
        parts.push(part);
    }
    // Only all parts together can be empty.
    let empty = |w: &&Word| matches!(w, Word::Plain(w) if w == "--allow-empty");
    words.extend(task.words.iter().find(empty).cloned());
    task.op = "join".into();
    task.words = words;
    task.after = (first..first + tiles).collect();
    task.key = serde_json::json!([task.key, tiles]).to_string();
    parts
}

fn name_of(path: Option<&Path>) -> String {
    let name = path.and_then(Path::file_name).unwrap_or_default();
    name.to_string_lossy().into_owned()
}
