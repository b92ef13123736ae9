//! From the job file to the list of tasks: lists are multiplied out, names of outputs filled in,
//! every command line is checked before anything runs.

use super::file::{self, JobFile};
use super::inputs::{Input, inputs};
use super::tiles;
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
const KEYS: [&str; 7] = ["op", "title", "input", "output", "retries", "mem", "tiles"];
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
#[derive(Clone, Debug)]
pub(crate) struct Task {
    pub name: String,
    pub op: String,
    /// What it depends on: done again when this is not as it was.
    pub input: PathBuf,
    /// Where the output goes, for operations that have one.
    pub output: Option<PathBuf>,
    /// Words of the command line in the order of its operands, then its options.
    pub(super) words: Vec<Word>,
    /// Tasks whose outputs this one reads.
    pub after: Vec<usize>,
    /// The task that this one makes a part for. It need not be done when that one is.
    pub part_for: Option<usize>,
    /// Bytes that it wants; its share when it does not say.
    pub mem: Option<u64>,
    pub retries: u32,
    pub key: String,
}

#[derive(Clone, Debug)]
pub(super) enum Word {
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

    /// The command line as it is told to people, and by which the task is known.
    pub(crate) fn line(&self) -> Vec<String> {
        let folder = self.output.as_deref().and_then(Path::parent);
        self.words(folder.unwrap_or(Path::new("")))
    }

    /// Whether the program takes the command line.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(super) fn check(&self) -> Result<()> {
        let line = self.line();
        let words = std::iter::once("brickmarch").chain(line.iter().map(String::as_str));
        Cli::try_parse_from(words).map(drop).map_err(|e| {
            let text = e.to_string();
            let first = text.lines().next().unwrap_or_default();
            let first = first.strip_prefix("error: ").unwrap_or(first);
            Error::bad_input(format!("'{}': {first}", self.name))
        })
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
            let tiles = tiles::count(table).map_err(context)?;
            if tasks.len() + new.len().saturating_mul(1 + tiles.unwrap_or(0)) > MAX_TASKS {
                return Err(context(Error::bad_input(format!(
                    "more than {MAX_TASKS} tasks: cut the job in pieces"
                ))));
            }
            for (mut task, text) in new {
                if let Some(tiles) = tiles {
                    let parts = tiles::cut(&mut task, tiles, tasks.len(), &file.out);
                    parts[0].check().map_err(context)?;
                    tasks.extend(parts);
                }
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
        if op == "mesh" && key == "part" {
            return Err(Error::bad_input(
                "`part` is given by the batch: write tiles = N for a mesh that is made in N parts",
            ));
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
            part_for: None,
            mem: self.mem,
            retries: self.retries,
            key: String::new(),
        };
        let line = task.line();
        task.check()?;
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
#[path = "plan_tests.rs"]
mod tests;
