//! What `sample` and `ray` share: rows in, answers out, batch by batch.

use crate::args::Space;
use crate::job::Job;
use crate::output::{self, Replace};
use crate::table::{Rows, Table, is_npy};
use brickmarch::{Error, Result};
use std::io::BufWriter;
use std::path::Path;
use std::sync::mpsc::sync_channel;

/// Rows of a batch: with their answers some MiB.
const BATCH: usize = 1 << 16;
/// Bytes of a row and its answers, of which there may be two and one on its way to the file.
const ROW_BYTES: usize = 256;

/// Takes rows of answers, and leaves room for the next ones.
pub(super) type Put<'a> = dyn FnMut(&mut Vec<f64>) -> Result<()> + 'a;

/// Reads `source` in rows of `columns` numbers, and writes what `answer(rows, batch, put)` puts:
/// `names.len()` numbers for each row, of at most `batch` rows at a time. To standard output when there is
/// no `out`. With more than one thread, answers are written while the next ones are found. Returns the
/// number of rows.
pub(super) fn by_batches(
    source: &Path,
    columns: usize,
    out: Option<&Path>,
    replace: Replace,
    names: &[&str],
    job: &Job,
    answer: impl FnOnce(&mut Rows, usize, &mut Put<'_>) -> Result<()> + Send,
) -> Result<u64> {
    let most = ((job.budget.memory_bytes() / 16) as usize / ROW_BYTES).clamp(256, BATCH);
    let _permit = job
        .budget
        .take((most * ROW_BYTES) as u64, "a batch of rows")?;
    let mut rows = Rows::open(source, columns)?;
    let threads = job.budget.threads();
    let fill = move |put: &mut Put<'_>| answer(&mut rows, most, put);
    let Some(path) = out else {
        let out = BufWriter::new(std::io::stdout().lock());
        let failed = |e| Error::io(Path::new("standard output"), "writing", e);
        let mut table = Table::csv(out, names).map_err(failed)?;
        let mut count = 0;
        return overlapped(threads, fill, |answers| {
            count += (answers.len() / names.len()) as u64;
            table.rows(answers).map_err(failed)
        })
        .map(|()| count);
    };
    let mut count = 0;
    let mut error = None;
    let written = output::write_whole(path, replace, |file| {
        let write = |table: std::io::Result<Table<&mut BufWriter<std::fs::File>>>| {
            let mut table = table?;
            let failed = |e| Error::io(path, "writing", e);
            let filled = overlapped(threads, fill, |answers| table.rows(answers).map_err(failed));
            if let Err(e) = filled {
                error = Some(e);
                return Err(std::io::Error::other("stopped"));
            }
            count = table.finish()?;
            Ok(())
        };
        match is_npy(path) {
            true => write(Table::npy(file, names)),
            false => write(Table::csv(file, names)),
        }
    });
    match error {
        Some(e) => Err(e),
        None => written.map(|_| count),
    }
}

/// Runs `fill`, and hands what it puts to `write`, on this thread; on two where there may be more.
fn overlapped(
    threads: usize,
    fill: impl FnOnce(&mut Put<'_>) -> Result<()> + Send,
    mut write: impl FnMut(&[f64]) -> Result<()>,
) -> Result<()> {
    if threads < 2 {
        return fill(&mut |answers| {
            write(answers)?;
            answers.clear();
            Ok(())
        });
    }
    // One batch is written and none waits; its memory comes back.
    let (give, taken) = sync_channel::<Vec<f64>>(0);
    let (give_back, free) = sync_channel::<Vec<f64>>(2);
    std::thread::scope(|scope| {
        let filling = scope.spawn(move || {
            fill(&mut |answers| {
                let next = free.try_recv().unwrap_or_default();
                let full = std::mem::replace(answers, next);
                // Nobody takes it after an error of writing, which is told.
                give.send(full).map_err(|_| Error::bad_input("stopped"))
            })
        });
        let mut written = Ok(());
        for mut answers in &taken {
            written = write(&answers);
            if written.is_err() {
                break;
            }
            answers.clear();
            let _ = give_back.try_send(answers);
        }
        drop(taken);
        match filling.join() {
            Ok(filled) => written.and(filled),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}

/// What coordinates mean, for the library.
pub(super) fn space(space: Space) -> brickmarch::query::Space {
    match space {
        Space::World => brickmarch::query::Space::World,
        Space::Index => brickmarch::query::Space::Index,
    }
}
