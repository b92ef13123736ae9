//! Work on many things side by side, with the results in their order and never many of them waiting.

use crate::budget::Budget;
use crate::error::Result;
use crossbeam::channel;
use std::collections::BTreeMap;
use std::sync::Mutex;

/// Takes things from `next` until there are none, works on them on the threads of the budget, and hands
/// the results to `take` in the order of `next`, on the calling thread. At most `ahead` results are
/// made and not taken.
///
/// # Errors
/// The first error of any of the three, in that order; `Cancelled`.
pub(super) fn in_order<W: Send, T: Send>(
    budget: &Budget,
    ahead: usize,
    mut next: impl FnMut() -> Result<Option<W>> + Send,
    work: impl Fn(W) -> Result<T> + Sync,
    mut take: impl FnMut(T) -> Result<()>,
) -> Result<()> {
    let threads = budget.threads().min(ahead);
    if threads <= 1 {
        while let Some(thing) = next()? {
            budget.check_cancelled()?;
            take(work(thing)?)?;
        }
        return Ok(());
    }
    let source = Mutex::new((0u64, next));
    // A token is the right to have one result under way.
    let (give, tokens) = channel::bounded::<()>(ahead);
    let (done, results) = channel::unbounded();
    for _ in 0..ahead {
        give.send(()).expect("there is room for all tokens");
    }
    let work = &work;
    let source = &source;
    std::thread::scope(|scope| {
        for _ in 0..threads {
            let (tokens, done) = (tokens.clone(), done.clone());
            scope.spawn(move || {
                while tokens.recv().is_ok() {
                    let (ticket, thing) = {
                        let mut source = source.lock().expect("sources do not panic");
                        let thing = match budget.check_cancelled() {
                            Ok(()) => source.1(),
                            Err(e) => Err(e),
                        };
                        source.0 += 1;
                        (source.0, thing)
                    };
                    let result = match thing {
                        Ok(None) => break,
                        Ok(Some(thing)) => work(thing),
                        Err(e) => Err(e),
                    };
                    if done.send((ticket, result)).is_err() {
                        break;
                    }
                }
            });
        }
        drop((tokens, done));
        // Dropped with the receiver at the end or at an error: both end the threads.
        let (give, results) = (give, results);
        let mut waiting = BTreeMap::new();
        let mut expected = 1;
        for (ticket, result) in &results {
            waiting.insert(ticket, result);
            while let Some(result) = waiting.remove(&expected) {
                take(result?)?;
                expected += 1;
                // Nobody may be left to take it.
                let _ = give.try_send(());
            }
        }
        Ok(())
    })
}
