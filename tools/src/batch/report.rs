//! What a batch has done, for people and for programs.

use super::journal::{Entry, Journal};
use super::plan::{Plan, Task};
use super::run::Limits;
use brickmarch::budget::human_bytes;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::PathBuf;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum State {
    Waiting,
    Running,
    Done,
    /// Done by an earlier run.
    Kept,
    Failed,
    /// Its input was not made.
    Skipped,
}

impl State {
    pub(crate) fn is_over(self) -> bool {
        !matches!(self, State::Waiting | State::Running)
    }

    fn name(self) -> &'static str {
        match self {
            State::Waiting => "waiting",
            State::Running => "running",
            State::Done => "done",
            State::Kept => "kept",
            State::Failed => "failed",
            State::Skipped => "skipped",
        }
    }
}

/// A task of the report.
#[derive(Debug)]
pub(crate) struct Line {
    pub name: String,
    pub op: String,
    pub state: State,
    pub seconds: f64,
    pub tries: u32,
    pub outputs: Vec<(PathBuf, u64)>,
    pub error: Option<String>,
    pub result: Value,
}

impl Line {
    /// Takes over what the journal knows of the task, or of the one that it makes a part for.
    pub(super) fn keep(&mut self, entry: &Entry, task: &Task) {
        self.state = State::Kept;
        if entry.key != task.key {
            return;
        }
        self.seconds = entry.seconds;
        self.tries = entry.tries;
        self.outputs = entry
            .outputs
            .iter()
            .map(|o| (o.path.clone(), o.bytes))
            .collect();
        self.result = entry.result.clone();
    }
}

/// All tasks of a batch and what came of them.
#[derive(Debug)]
pub(crate) struct Report {
    pub tasks: Vec<Line>,
    pub seconds: f64,
}

impl Report {
    pub(super) fn new(plan: &Plan) -> Report {
        let line = |t: &super::plan::Task| Line {
            name: t.name.clone(),
            op: t.op.clone(),
            state: State::Waiting,
            seconds: 0.0,
            tries: 0,
            outputs: Vec::new(),
            error: None,
            result: Value::Null,
        };
        Report {
            tasks: plan.tasks.iter().map(line).collect(),
            seconds: 0.0,
        }
    }

    pub(crate) fn count(&self, state: State) -> usize {
        self.tasks.iter().filter(|t| t.state == state).count()
    }

    /// Whether every task has what was asked of it.
    pub(crate) fn is_good(&self) -> bool {
        self.tasks
            .iter()
            .all(|t| matches!(t.state, State::Done | State::Kept))
    }

    /// One line: how far, and how long it may still take.
    pub(crate) fn progress(&self, jobs: usize) -> String {
        let over = self.tasks.iter().filter(|t| t.state.is_over()).count();
        let failed = self.count(State::Failed);
        let mut text = format!("{over} of {} tasks", self.tasks.len());
        if failed > 0 {
            let _ = write!(text, ", {failed} failed");
        }
        if let Some(left) = self.seconds_left(jobs) {
            let _ = write!(text, ", about {left:.0} s left");
        }
        text
    }

    /// From the mean time of each operation; unknown before the first task is over.
    fn seconds_left(&self, jobs: usize) -> Option<f64> {
        let mean = |op: Option<&str>| {
            let over = self
                .tasks
                .iter()
                .filter(|t| t.state == State::Done && op.is_none_or(|op| t.op == op));
            let (n, sum) = over.fold((0, 0.0), |(n, sum), t| (n + 1, sum + t.seconds));
            (n > 0).then(|| sum / f64::from(n))
        };
        let all = mean(None)?;
        let mut left = 0.0;
        let mut known: Vec<(&str, f64)> = Vec::new();
        for task in self.tasks.iter().filter(|t| !t.state.is_over()) {
            let of_op = match known.iter().find(|(op, _)| *op == task.op) {
                Some((_, seconds)) => *seconds,
                None => {
                    let seconds = mean(Some(&task.op)).unwrap_or(all);
                    known.push((&task.op, seconds));
                    seconds
                }
            };
            left += of_op;
        }
        Some(left / jobs as f64)
    }

    /// For programs.
    pub(crate) fn json(&self, plan: &Plan, limits: &Limits) -> Value {
        let task = |t: &Line| {
            let outputs: Vec<Value> = t
                .outputs
                .iter()
                .map(|(path, bytes)| json!({"path": path, "bytes": bytes}))
                .collect();
            json!({
                "name": t.name, "op": t.op, "state": t.state.name(), "seconds": t.seconds, "tries": t.tries,
                "outputs": outputs, "error": t.error, "result": t.result,
            })
        };
        json!({
            "schema": 1, "command": "batch", "out": plan.out, "mem_bytes": limits.mem,
            "threads": limits.threads, "jobs": limits.jobs, "seconds": self.seconds,
            "done": self.count(State::Done), "kept": self.count(State::Kept),
            "failed": self.count(State::Failed), "skipped": self.count(State::Skipped),
            "tasks": self.tasks.iter().map(task).collect::<Vec<_>>(),
        })
    }

    /// For people: a line per task, then the sum.
    pub(crate) fn text(&self, plan: &Plan) -> String {
        let mut text = String::new();
        for task in &self.tasks {
            let _ = write!(
                text,
                "{:<8}{:>9.2} s  {}",
                task.state.name(),
                task.seconds,
                task.name
            );
            for (path, bytes) in &task.outputs {
                let path = path.strip_prefix(&plan.out).unwrap_or(path);
                let _ = write!(text, " -> {} ({})", path.display(), human_bytes(*bytes));
            }
            if let Some(error) = &task.error {
                let _ = write!(text, ": {error}");
            }
            text.push('\n');
        }
        let _ = writeln!(
            text,
            "{}: {} done, {} kept, {} failed, {} skipped in {:.2} s",
            plan.out.display(),
            self.count(State::Done),
            self.count(State::Kept),
            self.count(State::Failed),
            self.count(State::Skipped),
            self.seconds
        );
        text
    }
}

/// The plan: what would be run, in which memory, and what is finished.
pub(crate) fn dry_run(plan: &Plan, limits: &Limits, journal: Option<&Journal>) -> (String, Value) {
    let mut text = String::new();
    let mut tasks = Vec::new();
    for (number, task) in plan.tasks.iter().enumerate() {
        let kept = journal.is_some_and(|j| j.kept(plan, number).is_some());
        let mem = limits.of(task);
        let line = task.line().join(" ");
        let state = if kept { "kept" } else { "to do" };
        let _ = writeln!(
            text,
            "{state:<6} {:>10}  {}: {line}",
            human_bytes(mem),
            task.name
        );
        tasks.push(json!({
            "name": task.name, "op": task.op, "state": state, "mem_bytes": mem, "command": line,
            "input": task.input, "output": task.output, "after": task.after,
        }));
    }
    let to_do = tasks.iter().filter(|t| t["state"] == "to do").count();
    let _ = writeln!(
        text,
        "{to_do} of {} tasks to do, {} at one time with {} threads, in at most {}",
        tasks.len(),
        limits.jobs,
        limits.threads,
        human_bytes(limits.mem)
    );
    let json = json!({
        "schema": 1, "command": "batch", "dry_run": true, "out": plan.out, "mem_bytes": limits.mem,
        "threads": limits.threads, "jobs": limits.jobs, "tasks": tasks,
    });
    (text, json)
}
