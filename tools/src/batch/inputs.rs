//! What a task reads: files, and outputs of earlier tasks, by name or by pattern.

use super::file::JobFile;
use brickmarch::{Error, Result};
use std::collections::HashMap;
use std::path::PathBuf;
use toml::{Table, Value};

/// An input: its path, how the file writes it, and the task that makes it.
pub(super) struct Input {
    pub path: PathBuf,
    pub text: String,
    pub from: Option<usize>,
}

/// The inputs of a table; `made` has the outputs of earlier tasks by their text.
///
/// # Errors
/// Says which input there is not.
pub(super) fn inputs(
    file: &JobFile,
    table: &Table,
    made: &HashMap<String, usize>,
) -> Result<Vec<Input>> {
    let list = match table.get("input") {
        Some(Value::String(one)) => vec![one.clone()],
        Some(Value::Array(many)) if !many.is_empty() => many
            .iter()
            .map(|v| v.as_str().map(str::to_string))
            .collect::<Option<_>>()
            .ok_or_else(|| Error::bad_input("`input` is a path or a list of paths, as texts"))?,
        _ => {
            return Err(Error::bad_input(
                "no `input`: give a path, or a list of paths; * stands for any part of a file name",
            ));
        }
    };
    let mut out = Vec::new();
    for text in list {
        if let Some(&from) = made.get(&text) {
            out.push(Input {
                path: file.out.join(&text),
                text,
                from: Some(from),
            });
        } else if text.contains('*') {
            let found = matching(file, &text, made)?;
            if found.is_empty() {
                return Err(Error::bad_input(format!(
                    "input = \"{text}\": no such file, and no earlier task makes one"
                )));
            }
            out.extend(found);
        } else {
            let path = file.base.join(&text);
            if !path.is_file() {
                return Err(Error::bad_input(format!(
                    "input = \"{text}\": there is no file {}, and no earlier task has this `output`",
                    path.display()
                )));
            }
            out.push(Input {
                path,
                text,
                from: None,
            });
        }
    }
    Ok(out)
}

/// What a pattern with `*` in its last part stands for: outputs of earlier tasks, then files.
fn matching(file: &JobFile, pattern: &str, made: &HashMap<String, usize>) -> Result<Vec<Input>> {
    let (folder, name) = pattern.rsplit_once('/').unwrap_or(("", pattern));
    if folder.contains('*') {
        return Err(Error::bad_input(format!(
            "input = \"{pattern}\": * may stand in the name of the file only"
        )));
    }
    let mut out: Vec<Input> = made
        .iter()
        .filter(|(text, _)| {
            let (f, n) = text.rsplit_once('/').unwrap_or(("", text));
            f == folder && matches(name, n)
        })
        .map(|(text, &from)| Input {
            path: file.out.join(text),
            text: text.clone(),
            from: Some(from),
        })
        .collect();
    let full = file.base.join(folder);
    for entry in std::fs::read_dir(&full).into_iter().flatten().flatten() {
        let found = entry.file_name().to_string_lossy().into_owned();
        if matches(name, &found) && entry.path().is_file() {
            out.push(Input {
                path: entry.path(),
                text: if folder.is_empty() {
                    found
                } else {
                    format!("{folder}/{found}")
                },
                from: None,
            });
        }
    }
    out.sort_by(|a, b| a.text.cmp(&b.text));
    Ok(out)
}

/// Whether a name fits a pattern in which `*` stands for any text.
fn matches(pattern: &str, name: &str) -> bool {
    let Some((first, rest)) = pattern.split_once('*') else {
        return pattern == name;
    };
    let Some(after) = name.strip_prefix(first) else {
        return false;
    };
    let ends = after.char_indices().map(|(i, _)| i).chain([after.len()]);
    ends.into_iter().any(|i| matches(rest, &after[i..]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_star_is_any_text() {
        for (pattern, name, fits) in [
            ("*.bvol", "a.bvol", true),
            ("a*b*c", "aXbYc", true),
            ("a*b*c", "aXbY", false),
            ("*", "", true),
            ("é*", "éa", true),
        ] {
            assert_eq!(matches(pattern, name), fits, "{pattern} {name}");
        }
    }
}
