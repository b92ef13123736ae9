//! Answers to many questions, part by part on the threads of the budget.

use super::cursor::Cursor;
use crate::budget::Budget;
use crate::error::{Error, Result};
use crate::field::Field;
use std::sync::Mutex;

/// Fills `out` in parts of `size` on the threads of the budget: `fill(cursor, place of the part, part)`.
pub(super) fn each_part_of<T: Send>(
    out: &mut [T],
    size: usize,
    budget: &Budget,
    field: &dyn Field,
    fill: impl Fn(&mut Cursor<'_>, usize, &mut [T]) -> Result<()> + Sync,
) -> Result<()> {
    let count = out.len().div_ceil(size);
    let parts = Mutex::new(out.chunks_mut(size).enumerate());
    let failed: Mutex<Option<(usize, Error)>> = Mutex::new(None);
    let work = |cursor: &mut Cursor<'_>| {
        loop {
            let next = parts.lock().expect("no holder panics").next();
            let Some((n, part)) = next else { break };
            let done = budget
                .check_cancelled()
                .and_then(|()| fill(cursor, n * size, part));
            if let Err(e) = done {
                // Of several errors that of the first part is told. The rest is left undone.
                let mut failed = failed.lock().expect("no holder panics");
                if failed.as_ref().is_none_or(|(at, _)| n < *at) {
                    *failed = Some((n, e));
                }
                parts
                    .lock()
                    .expect("no holder panics")
                    .by_ref()
                    .for_each(drop);
                break;
            }
        }
    };
    let mut own = Cursor::new(field, budget)?;
    std::thread::scope(|scope| {
        for _ in 1..budget.threads().min(count) {
            // Threads for which there is no memory are done without.
            let Ok(mut cursor) = Cursor::new(field, budget) else {
                break;
            };
            let work = &work;
            scope.spawn(move || work(&mut cursor));
        }
        work(&mut own);
    });
    match failed.into_inner().expect("no holder panics") {
        Some((_, error)) => Err(error),
        None => Ok(()),
    }
}
