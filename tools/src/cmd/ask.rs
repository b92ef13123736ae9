//! What `sample` and `ray` share: rows in, answers out, batch by batch.

use crate::args::Space;
use crate::job::Job;
use crate::output::{self, Replace};
use crate::table::{Rows, Table, is_npy};
use brickmarch::{Error, Result};
use std::io::BufWriter;
use std::path::Path;

/// Rows of a batch: with their answers some MiB.
const BATCH: usize = 1 << 17;
/// Bytes of a row and its answer, at most.
const ROW_BYTES: usize = 160;

/// Reads `source` in rows of `columns` numbers, and writes for each batch what `answer(rows, out)`
/// appends to `out`: `names.len()` numbers for each row. To standard output when there is no `out`.
/// Returns the number of rows.
pub(super) fn by_batches(
    source: &Path,
    columns: usize,
    out: Option<&Path>,
    replace: Replace,
    names: &[&str],
    job: &Job,
    mut answer: impl FnMut(&[f64], &mut Vec<f64>) -> Result<()>,
) -> Result<u64> {
    let most = ((job.budget.memory_bytes() / 4) as usize / ROW_BYTES).clamp(256, BATCH);
    let _permit = job
        .budget
        .take((most * ROW_BYTES) as u64, "a batch of rows")?;
    let mut rows = Rows::open(source, columns)?;
    let mut fill = |put: &mut dyn FnMut(&[f64]) -> std::io::Result<()>| -> Result<()> {
        let (mut numbers, mut answers) = (Vec::new(), Vec::new());
        loop {
            rows.next(most, &mut numbers)?;
            if numbers.is_empty() {
                return Ok(());
            }
            answers.clear();
            answer(&numbers, &mut answers)?;
            for row in answers.chunks(names.len()) {
                put(row).map_err(|e| Error::io(Path::new("answers"), "writing", e))?;
            }
            job.budget.check_cancelled()?;
        }
    };
    let Some(path) = out else {
        let out = BufWriter::new(std::io::stdout().lock());
        let failed = |e| Error::io(Path::new("standard output"), "writing", e);
        let mut table = Table::csv(out, names).map_err(failed)?;
        let mut count = 0;
        fill(&mut |row| {
            count += 1;
            table.row(row)
        })?;
        return Ok(count);
    };
    let mut count = 0;
    let mut error = None;
    let written = output::write_whole(path, replace, |file| {
        let mut write = |table: std::io::Result<Table<&mut BufWriter<std::fs::File>>>| {
            let mut table = table?;
            if let Err(e) = fill(&mut |row| table.row(row)) {
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

/// What coordinates mean, for the library.
pub(super) fn space(space: Space) -> brickmarch::query::Space {
    match space {
        Space::World => brickmarch::query::Space::World,
        Space::Index => brickmarch::query::Space::Index,
    }
}
