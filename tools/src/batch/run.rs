//! The schedule: tasks in the order of the file as soon as what they read is there, side by side as
//! long as their memory fits into the budget.

use super::child::{Ended, Running, Share};
use super::journal::{Entry, Journal};
use super::plan::{Plan, Task};
use super::report::{Report, State};
use super::{Seen, own_folder};
use brickmarch::{Error, ErrorKind, Result};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// How often tasks are looked at.
pub(super) const TICK: Duration = Duration::from_millis(10);
/// What a process takes beside its budget: program, stacks, buffers of the system.
const OVERHEAD: u64 = 14 << 20;
/// The least that a task gets when it does not say.
const LEAST: u64 = 48 << 20;

/// What the whole batch may use.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    pub mem: u64,
    pub threads: usize,
    /// How many tasks at one time.
    pub jobs: usize,
}

impl Limits {
    /// `jobs` where nobody says it: as many as have a core and [`LEAST`] bytes each.
    pub(crate) fn new(mem: u64, threads: usize, jobs: Option<u16>) -> Limits {
        let fit = (mem / (LEAST + OVERHEAD)).max(1) as usize;
        Limits {
            mem,
            threads,
            jobs: jobs.map_or(threads.min(fit), usize::from).max(1),
        }
    }

    /// Memory of a task that does not say how much it wants.
    pub(crate) fn share(&self) -> u64 {
        let jobs = self.jobs as u64;
        (self.mem.saturating_sub((jobs - 1) * OVERHEAD) / jobs).max(1 << 20)
    }

    /// Memory that a task gets.
    pub(crate) fn of(&self, task: &Task) -> u64 {
        task.mem.unwrap_or(self.share())
    }
}

/// Runs what is not done yet. `look` is told how far things are after each task and now and then;
/// `cancelled` asks whether to stop.
///
/// # Errors
/// `Cancelled`; `BudgetExceeded` for a task that wants more than there is; what the medium reports. What
/// a task fails of is in the report.
pub(crate) fn run(
    plan: &Plan,
    limits: &Limits,
    journal: &mut Journal,
    cancelled: &dyn Fn() -> bool,
    look: &mut dyn FnMut(&Report),
) -> Result<Report> {
    if let Some(task) = plan.tasks.iter().find(|t| limits.of(t) > limits.mem) {
        return Err(Error::new(
            ErrorKind::BudgetExceeded,
            format!(
                "'{}' wants {}, the batch has {}: give more --mem, or less in the job file",
                task.name,
                brickmarch::budget::human_bytes(limits.of(task)),
                brickmarch::budget::human_bytes(limits.mem)
            ),
        ));
    }
    let mut batch = Batch {
        plan,
        limits,
        report: Report::new(plan),
        running: Vec::new(),
        first: 0,
        tries: vec![0; plan.tasks.len()],
    };
    let started = Instant::now();
    while !batch.over() {
        if cancelled() {
            for task in batch.running.drain(..) {
                task.stop();
            }
            return Err(Error::new(
                ErrorKind::Cancelled,
                "stopped; what is finished is in the journal: run the batch again to go on",
            ));
        }
        let moved = batch.collect(journal)? | batch.start_some(journal)?;
        batch.report.seconds = started.elapsed().as_secs_f64();
        look(&batch.report);
        if !moved {
            std::thread::sleep(TICK);
        }
    }
    // Folders of tasks that were stopped for good, and of plans that are no more. Parts stay where a
    // mesh could not be joined yet.
    let _ = std::fs::remove_dir_all(own_folder(&plan.out).join("work"));
    let joined = |n: usize| matches!(batch.report.tasks[n].state, State::Done | State::Kept);
    if plan.tasks.iter().filter_map(|t| t.part_for).all(joined) {
        let _ = std::fs::remove_dir_all(own_folder(&plan.out).join("parts"));
    }
    Ok(batch.report)
}

struct Batch<'a> {
    plan: &'a Plan,
    limits: &'a Limits,
    report: Report,
    running: Vec<Running>,
    /// No task before this one waits.
    first: usize,
    /// Times that each task was started.
    tries: Vec<u32>,
}

impl Batch<'_> {
    fn over(&mut self) -> bool {
        while self
            .report
            .tasks
            .get(self.first)
            .is_some_and(|t| t.state.is_over())
        {
            self.first += 1;
        }
        self.first == self.plan.tasks.len()
    }

    /// Where a task works.
    fn folder(&self, number: usize) -> PathBuf {
        let key = crc32c::crc32c(self.plan.tasks[number].key.as_bytes());
        own_folder(&self.plan.out).join(format!("work/{number}-{key:08x}"))
    }

    /// Starts what can start, in order; a task that waits for memory lets no later one pass, so that
    /// it gets its turn.
    fn start_some(&mut self, journal: &Journal) -> Result<bool> {
        let mut moved = false;
        for number in self.first..self.plan.tasks.len() {
            if self.report.tasks[number].state != State::Waiting {
                continue;
            }
            let task = &self.plan.tasks[number];
            let before: Vec<State> = task
                .after
                .iter()
                .map(|&n| self.report.tasks[n].state)
                .collect();
            let missing = before
                .iter()
                .position(|s| matches!(s, State::Failed | State::Skipped));
            if let Some(n) = missing {
                let cause = &self.plan.tasks[task.after[n]].name;
                self.report.tasks[number].state = State::Skipped;
                self.report.tasks[number].error =
                    Some(format!("'{cause}' has made no input for it"));
                moved = true;
                continue;
            }
            if !before.iter().all(|s| s.is_over()) {
                continue;
            }
            if let Some(entry) = journal.kept(self.plan, number) {
                self.report.tasks[number].keep(entry, task);
                moved = true;
                continue;
            }
            let share = Share {
                mem: self.limits.of(task),
                threads: (self.limits.threads / self.limits.jobs).max(1),
            };
            let used: u64 = self.running.iter().map(|r| r.mem + OVERHEAD).sum();
            if self.running.len() >= self.limits.jobs || used + share.mem > self.limits.mem {
                return Ok(moved);
            }
            self.tries[number] += 1;
            let folder = self.folder(number);
            let tries = self.tries[number];
            let child = Running::start(number, task, &self.plan.base, folder, &share, tries)?;
            self.running.push(child);
            self.report.tasks[number].state = State::Running;
            moved = true;
        }
        Ok(moved)
    }

    /// Takes in what is over.
    fn collect(&mut self, journal: &mut Journal) -> Result<bool> {
        let mut moved = false;
        for n in (0..self.running.len()).rev() {
            if let Some(ended) = self.running[n].ended()? {
                let child = self.running.swap_remove(n);
                self.take_in(&child, ended, journal)?;
                moved = true;
            }
        }
        Ok(moved)
    }

    fn take_in(&mut self, child: &Running, ended: Ended, journal: &mut Journal) -> Result<()> {
        let task = &self.plan.tasks[child.number];
        let line = &mut self.report.tasks[child.number];
        line.seconds += ended.seconds;
        line.tries = child.tries;
        // A mesh that is open stays open however often it is checked; so does a wrong option.
        let hopeless = matches!(ended.status.code(), Some(2 | 3));
        if !ended.status.success() {
            if child.tries <= task.retries && !hopeless {
                line.state = State::Waiting;
                return Ok(());
            }
            line.state = State::Failed;
            line.error = Some(ended.error);
            line.result = ended.result;
            child.clear();
            return Ok(());
        }
        let outputs = child.deliver(task)?;
        let entry = Entry {
            key: task.key.clone(),
            input: Seen::at(&task.input)?,
            outputs,
            seconds: line.seconds,
            tries: child.tries,
            result: ended.result,
        };
        line.keep(&entry, task);
        line.state = State::Done;
        journal.add(entry)?;
        child.clear();
        // Parts of a mesh that is there.
        for part in task.after.iter().map(|&n| &self.plan.tasks[n]) {
            if let (Some(_), Some(path)) = (part.part_for, &part.output) {
                let _ = std::fs::remove_file(path);
            }
        }
        Ok(())
    }
}
