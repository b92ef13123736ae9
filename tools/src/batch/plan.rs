//! From the job file to the list of tasks: lists are multiplied out, names of outputs filled in,
//! every command line is checked before anything runs.

use super::file::{self, JobFile};
use crate::args::Cli;
use brickmarch::{Error, Result};
use clap::{CommandFactory, Parser};
use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};
use toml::{Table, Value};

/// Tasks of a batch at most.
const MAX_TASKS: usize = 1_000_000;
/// Operations that a task may have.
const OPERATIONS: [&str; 12] = [
    "import", "export", "info", "verify", "compact", "mesh", "model", "check", "slice", "sample",
    "ray", "render",
];
/// Options that are the batch's affair.
const OWN: [&str; 9] = [
    "threads",
    "json",
    "quiet",
    "verbose",
    "progress",
    "overwrite",
    "resume",
    "help",
    "version",
];
/// Keys of a task that are no options.
const KEYS: [&str; 6] = ["op", "title", "input", "output", "retries", "mem"];
/// Options that name another output.
const OUTPUT_OPTIONS: [&str; 1] = ["picture"];

/// Everything that a batch will do.
#[derive(Debug)]
pub(crate) struct Plan {
    /// Folder that relative inputs start from.
    pub base: PathBuf,
    /// Folder of the outputs.
    pub out: PathBuf,
    /// How many tasks at one time, where the file says it.
    pub jobs: Option<u16>,
    pub tasks: Vec<Task>,
}

/// One run of this program.
#[derive(Debug)]
pub(crate) struct Task {
    pub name: String,
    pub op: String,
    pub input: PathBuf,
    /// Where the output goes, for operations that have one.
    pub output: Option<PathBuf>,
    /// Words of the command line in the order of its operands, then its options.
    words: Vec<Word>,
    /// Tasks whose outputs this one reads.
    pub after: Vec<usize>,
    /// Bytes that it wants; its share when it does not say.
    pub mem: Option<u64>,
    pub retries: u32,
    pub key: String,
}

#[derive(Clone, Debug)]
enum Word {
    Plain(String),
    Input,
    /// The name of an output, in the folder that the task works in.
    Made(String),
}

impl Task {
    /// The command line without limits, its outputs in `folder`.
    pub(crate) fn words(&self, folder: &Path) -> Vec<String> {
        let text = |p: &Path| p.to_string_lossy().into_owned();
        let word = |w: &Word| match w {
            Word::Plain(w) => w.clone(),
            Word::Input => text(&self.input),
            Word::Made(name) => text(&folder.join(name)),
        };
        std::iter::once(self.op.clone())
            .chain(self.words.iter().map(word))
            .collect()
    }

    /// Whether the operation has an option.
    pub(crate) fn takes(&self, option: &str) -> bool {
        options_of(&self.op).is_some_and(|o| o.iter().any(|o| o == option))
    }
}

impl Plan {
    /// Reads a job file.
    ///
    /// # Errors
    /// Names file, line and key, and says what to do.
    pub(crate) fn read(path: &Path) -> Result<Plan> {
        let file = file::read(path)?;
        let mut tasks: Vec<Task> = Vec::new();
        // By the text of the output as the file writes it, and by its path.
        let mut made: HashMap<String, usize> = HashMap::new();
        let mut taken: HashMap<PathBuf, usize> = HashMap::new();
        for (line, table) in &file.tasks {
            let place = format!("{}:{line}", path.display());
            let context = |e: Error| e.context(&place);
            let new = tasks_of(&file, table, &made).map_err(context)?;
            if tasks.len() + new.len() > MAX_TASKS {
                return Err(context(Error::bad_input(format!(
                    "more than {MAX_TASKS} tasks: cut the job in pieces"
                ))));
            }
            for (task, text) in new {
                let number = tasks.len();
                if let Some(output) = &task.output
                    && let Some(other) = taken.insert(output.clone(), number)
                {
                    return Err(context(Error::bad_input(format!(
                        "'{}' and '{}' both write {}: put what differs into `output`, as {{iso}} or {{stem}}",
                        tasks[other].name,
                        task.name,
                        output.display()
                    ))));
                }
                if let Some(text) = text {
                    made.insert(text, number);
                }
                tasks.push(task);
            }
        }
        Ok(Plan {
            base: file.base,
            out: file.out,
            jobs: file.jobs,
            tasks,
        })
    }
}

/// The tasks of a table, each with the text of its output.
fn tasks_of(
    file: &JobFile,
    table: &Table,
    made: &HashMap<String, usize>,
) -> Result<Vec<(Task, Option<String>)>> {
    let op = text(table, "op")?
        .ok_or_else(|| Error::bad_input(format!("no `op`: one of {}", OPERATIONS.join(", "))))?;
    let known = OPERATIONS.contains(&op.as_str());
    let Some(options) = options_of(&op).filter(|_| known) else {
        return Err(Error::bad_input(format!(
            "op = \"{op}\": use one of {}",
            OPERATIONS.join(", ")
        )));
    };
    for key in table.keys() {
        if OWN.contains(&key.as_str()) {
            return Err(Error::bad_input(format!(
                "`{key}` belongs to the whole batch: give it on its command line"
            )));
        }
        let ours = KEYS.contains(&key.as_str());
        if !ours && !options.contains(&key.replace('_', "-")) {
            return Err(Error::bad_input(format!(
                "`{key}`: `brickmarch {op}` has no such option"
            )));
        }
    }
    let name = text(table, "title")?;
    let retries = match table.get("retries") {
        None => file.retries,
        Some(Value::Integer(n)) if (0..=100).contains(n) => *n as u32,
        Some(other) => return Err(Error::bad_input(format!("retries = {other}: 0 to 100"))),
    };
    let mem = match text(table, "mem")? {
        None => None,
        Some(size) => {
            Some(crate::parse::size(&size).map_err(|e| Error::bad_input(format!("mem: {e}")))?)
        }
    };
    let inputs = inputs(file, table, made)?;
    let choices = multiply(table)?;
    if inputs.len().saturating_mul(choices.len()) > MAX_TASKS {
        return Err(Error::bad_input(format!("more than {MAX_TASKS} tasks")));
    }
    let several = inputs.len() * choices.len() > 1;
    let mut out = Vec::new();
    for input in &inputs {
        for choice in &choices {
            let name = match &name {
                Some(name) if several => format!("{name}[{}]", out.len() + 1),
                Some(name) => name.clone(),
                None => title(&op, &input.text, choice),
            };
            let pattern = text(table, "output")?;
            let task = Blank {
                file,
                op: &op,
                name,
                retries,
                mem,
                input,
                choice,
            };
            out.push(task.fill(pattern.as_deref())?);
        }
    }
    Ok(out)
}

/// What a task is called that has no title: `mesh skull.bvol iso=200`.
fn title(op: &str, input: &str, choice: &Choice) -> String {
    let mut title = format!("{op} {input}");
    for (key, value) in choice.iter().filter(|(_, v)| v.chosen) {
        let value = match value.flag {
            true => (!value.words.is_empty()).to_string(),
            false => value.words.join(","),
        };
        title += &format!(" {key}={value}");
    }
    title
}

/// An input: its path, how the file writes it, and the task that makes it.
struct Input {
    path: PathBuf,
    text: String,
    from: Option<usize>,
}

fn inputs(file: &JobFile, table: &Table, made: &HashMap<String, usize>) -> Result<Vec<Input>> {
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

/// Values of the options of one task, by key.
type Choice = Vec<(String, Chosen)>;

#[derive(Clone, Debug)]
struct Chosen {
    /// One word per time that the option is given; none for an option that is left out.
    words: Vec<String>,
    /// An option without a value.
    flag: bool,
    /// One of several.
    chosen: bool,
}

/// Every combination of the values of the options; the last key changes fastest.
fn multiply(table: &Table) -> Result<Vec<Choice>> {
    let mut all: Vec<Choice> = vec![Vec::new()];
    for (key, value) in table {
        if KEYS.contains(&key.as_str()) {
            continue;
        }
        let values: Vec<Chosen> = match value {
            Value::Array(list) if list.is_empty() => {
                return Err(Error::bad_input(format!("`{key}` is an empty list")));
            }
            Value::Array(list) => list
                .iter()
                .map(|v| chosen(key, v, true))
                .collect::<Result<_>>()?,
            one => vec![chosen(key, one, false)?],
        };
        if all.len().saturating_mul(values.len()) > MAX_TASKS {
            return Err(Error::bad_input(format!("more than {MAX_TASKS} tasks")));
        }
        all = all
            .iter()
            .flat_map(|before| {
                values.iter().map(move |value| {
                    let mut choice = before.clone();
                    choice.push((key.clone(), value.clone()));
                    choice
                })
            })
            .collect();
    }
    Ok(all)
}

fn chosen(key: &str, value: &Value, chosen: bool) -> Result<Chosen> {
    let (words, flag) = match value {
        Value::Boolean(true) => (vec![String::new()], true),
        Value::Boolean(false) => (Vec::new(), true),
        Value::Array(list) => (
            list.iter().map(|v| plain(key, v)).collect::<Result<_>>()?,
            false,
        ),
        one => (vec![plain(key, one)?], false),
    };
    Ok(Chosen {
        words,
        flag,
        chosen,
    })
}

fn plain(key: &str, value: &Value) -> Result<String> {
    match value {
        Value::String(s) => Ok(s.clone()),
        Value::Integer(n) => Ok(n.to_string()),
        Value::Float(v) => Ok(v.to_string()),
        other => Err(Error::bad_input(format!(
            "`{key}` = {other}: a text, a number, true or false, or a list of them"
        ))),
    }
}

fn text(table: &Table, key: &str) -> Result<Option<String>> {
    match table.get(key) {
        None => Ok(None),
        Some(Value::String(s)) if !s.is_empty() => Ok(Some(s.clone())),
        Some(other) => Err(Error::bad_input(format!("`{key}` = {other}: a text"))),
    }
}

/// A task before its names are filled in.
struct Blank<'a> {
    file: &'a JobFile,
    op: &'a str,
    name: String,
    retries: u32,
    mem: Option<u64>,
    input: &'a Input,
    choice: &'a Choice,
}

impl Blank<'_> {
    fn fill(self, pattern: Option<&str>) -> Result<(Task, Option<String>)> {
        let operands = operands_of(self.op);
        let wants_output = operands.iter().any(|o| o == "out");
        let output = match (pattern, wants_output) {
            (Some(pattern), true) => Some(self.expand("output", pattern)?),
            (None, true) => {
                return Err(Error::bad_input(format!(
                    "no `output`: `{}` writes a file; {{stem}} stands for the name of the input, {{KEY}} for the value of an option",
                    self.op
                )));
            }
            (Some(_), false) => {
                return Err(Error::bad_input(format!(
                    "`output`: `{}` writes no file; what it says goes into the report",
                    self.op
                )));
            }
            (None, false) => None,
        };
        let mut words = Vec::new();
        for (n, operand) in operands.iter().enumerate() {
            if n == 0 {
                words.push(Word::Input);
            } else if operand == "out" {
                words.push(Word::Made(file_name(output.as_deref().unwrap_or_default())));
            } else {
                let given = self
                    .choice
                    .iter()
                    .find(|(k, _)| k.replace('_', "-") == *operand);
                let Some((_, value)) = given else {
                    return Err(Error::bad_input(format!(
                        "no `{operand}`: `{}` needs it",
                        self.op
                    )));
                };
                words.extend(value.words.iter().cloned().map(Word::Plain));
            }
        }
        for (key, value) in self.choice {
            let key = key.replace('_', "-");
            if operands.contains(&key) {
                continue;
            }
            for word in &value.words {
                if value.flag {
                    words.push(Word::Plain(format!("--{key}")));
                } else if OUTPUT_OPTIONS.contains(&key.as_str()) {
                    words.push(Word::Plain(format!("--{key}")));
                    words.push(Word::Made(file_name(&self.expand(&key, word)?)));
                } else {
                    words.push(Word::Plain(format!("--{key}={word}")));
                }
            }
        }
        let mut task = Task {
            name: self.name,
            op: self.op.to_string(),
            input: self.input.path.clone(),
            output: output.as_ref().map(|o| self.file.out.join(o)),
            words,
            after: self.input.from.into_iter().collect(),
            mem: self.mem,
            retries: self.retries,
            key: String::new(),
        };
        let line = task.words(
            task.output
                .as_deref()
                .and_then(Path::parent)
                .unwrap_or(Path::new("")),
        );
        Cli::try_parse_from(std::iter::once("brickmarch").chain(line.iter().map(String::as_str)))
            .map_err(|e| {
            let text = e.to_string();
            let first = text.lines().next().unwrap_or_default();
            let first = first.strip_prefix("error: ").unwrap_or(first);
            Error::bad_input(format!("'{}': {first}", task.name))
        })?;
        task.key = serde_json::json!(line).to_string();
        Ok((task, output))
    }

    /// A name with `{stem}`, `{title}` and `{KEY}` filled in: a relative path that stays below `out`.
    fn expand(&self, what: &str, pattern: &str) -> Result<String> {
        let mut out = String::new();
        let mut rest = pattern;
        while let Some((before, after)) = rest.split_once('{') {
            let (key, behind) = after.split_once('}').ok_or_else(|| {
                Error::bad_input(format!("{what} = \"{pattern}\": a {{ without its }}"))
            })?;
            let value = match key {
                "stem" => stem(&self.input.text).to_string(),
                "title" => self.name.clone(),
                _ => match self.choice.iter().find(|(k, _)| k == key) {
                    Some((_, value)) if value.flag => (!value.words.is_empty()).to_string(),
                    Some((_, value)) => value.words.join("_"),
                    None => {
                        return Err(Error::bad_input(format!(
                            "{what} = \"{pattern}\": the task has no `{key}`; {{stem}} and {{title}} are known too"
                        )));
                    }
                },
            };
            out += before;
            out.extend(value.chars().map(|c| match c {
                c if c.is_alphanumeric() => c,
                '.' | '-' | '+' => c,
                _ => '_',
            }));
            rest = behind;
        }
        out += rest;
        let inside = Path::new(&out)
            .components()
            .all(|c| matches!(c, Component::Normal(_)));
        if !inside || file_name(&out).is_empty() {
            return Err(Error::bad_input(format!(
                "{what} = \"{out}\": the name of a file inside of the folder `out`"
            )));
        }
        Ok(out)
    }
}

fn file_name(path: &str) -> String {
    let name = Path::new(path).file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// The name of a file without folder and endings.
fn stem(path: &str) -> &str {
    let name = path.rsplit('/').next().unwrap_or(path);
    let name = name.strip_suffix(".gz").unwrap_or(name);
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// Long options and operands of an operation.
fn options_of(op: &str) -> Option<Vec<String>> {
    let program = Cli::command();
    let command = program.find_subcommand(op)?;
    Some(
        command
            .get_arguments()
            .map(|a| match a.get_long() {
                Some(long) => long.to_string(),
                None => a.get_id().to_string(),
            })
            .collect(),
    )
}

/// Operands of an operation, in order.
fn operands_of(op: &str) -> Vec<String> {
    let program = Cli::command();
    let command = program.find_subcommand(op);
    command
        .into_iter()
        .flat_map(|c| c.get_positionals())
        .map(|a| a.get_id().to_string())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(text: &str) -> Result<Plan> {
        let folder = tempfile::tempdir().expect("a folder");
        for name in ["a.bvol", "b.bvol", "c.raw"] {
            std::fs::write(folder.path().join(name), b"x").expect("written");
        }
        let path = folder.path().join("job.toml");
        std::fs::write(&path, text).expect("written");
        Plan::read(&path)
    }

    #[test]
    fn lists_are_multiplied_and_names_filled_in() {
        let plan = plan(
            "[[task]]\nop = \"mesh\"\ninput = [\"a.bvol\", \"b.bvol\"]\noutput = \"{stem}/{iso}.ply\"\n\
             iso = [1, -2.5]\nnormals = true\nkeys = false\nseed = [[\"1,2,3\", \"4,5,6\"]]\n\
             [[task]]\nop = \"check\"\ninput = \"a/*.ply\"\n",
        )
        .expect("a good plan");
        let outputs: Vec<_> = plan
            .tasks
            .iter()
            .filter_map(|t| t.output.as_ref())
            .collect();
        let end = |p: &PathBuf| p.strip_prefix(&plan.out).expect("below").to_path_buf();
        assert_eq!(
            outputs.into_iter().map(end).collect::<Vec<_>>(),
            ["a/1.ply", "a/-2.5.ply", "b/1.ply", "b/-2.5.ply"].map(PathBuf::from)
        );
        let line = plan.tasks[1].words(Path::new("w")).join(" ");
        assert!(
            line.ends_with("a.bvol w/-2.5.ply --iso=-2.5 --normals --seed=1,2,3 --seed=4,5,6"),
            "{line}"
        );
        // What an earlier task makes is an input like a file, and is waited for.
        assert_eq!(plan.tasks.len(), 6);
        assert_eq!(
            (&plan.tasks[4].after[..], &plan.tasks[5].after[..]),
            (&[1][..], &[0][..])
        );
    }

    #[test]
    fn mistakes_are_said_with_their_line() {
        let mesh = "[[task]]\nop = \"mesh\"\ninput = \"a.bvol\"\n";
        for (text, line, part) in [
            (String::new(), None, "no task"),
            ("x = 1\n".into(), Some(1), "unknown field `x`"),
            ("\n[[task]]\nop = 3\n".into(), Some(2), "`op` = 3"),
            ("[[task]]\nop = \"demo\"\n".into(), Some(1), "use one of"),
            (
                "[[task]]\nop = \"mesh\"\noutput = \"x\"\n".into(),
                Some(1),
                "no `input`",
            ),
            (mesh.into(), Some(1), "no `output`"),
            (
                format!("{mesh}output = \"{{iso}}.ply\"\n"),
                Some(1),
                "has no `iso`",
            ),
            (
                format!("{mesh}output = \"../x.ply\"\n"),
                Some(1),
                "inside of the folder",
            ),
            (
                format!("{mesh}output = \"x.ply\"\nisos = 1\n"),
                Some(1),
                "no such option",
            ),
            (
                format!("{mesh}output = \"x.ply\"\nthreads = 1\n"),
                Some(1),
                "whole batch",
            ),
            (
                format!("{mesh}output = \"x.ply\"\niso = []\n"),
                Some(1),
                "empty list",
            ),
            (
                format!("{mesh}output = \"x.ply\"\niso = \"much\"\n"),
                Some(1),
                "much",
            ),
            (
                format!("{mesh}output = \"x.ply\"\niso = [1, 2]\n"),
                Some(1),
                "both write",
            ),
            (
                format!("{mesh}output = \"x.ply\"\nmem = \"lots\"\n"),
                Some(1),
                "mem",
            ),
            (
                "[[task]]\nop = \"info\"\ninput = \"none.bvol\"\n".into(),
                Some(1),
                "there is no file",
            ),
            (
                "[[task]]\nop = \"info\"\ninput = \"*.none\"\n".into(),
                Some(1),
                "no such file",
            ),
            (
                "[[task]]\nop = \"info\"\ninput = \"a.bvol\"\noutput = \"x\"\n".into(),
                Some(1),
                "writes no file",
            ),
            ("[[task]\n".into(), Some(1), ""),
        ] {
            let error = plan(&text).expect_err(&text).to_string();
            let place = line.map_or("job.toml: ".to_string(), |l| format!("job.toml:{l}: "));
            assert!(
                error.contains(&place) && error.contains(part),
                "{text}: {error}"
            );
            assert!(!error.contains('\n'), "{error}");
        }
    }

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
