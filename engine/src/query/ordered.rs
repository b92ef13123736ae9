//! Work on many things side by side, with the results in their order and never many of them waiting.

use crate::budget::Budget;
use crate::error::Result;
use crossbeam::channel;
use std::collections::BTreeMap;
use std::sync::Mutex;

/// Tickets that may be under way for each thread.
pub(super) const AHEAD: usize = 3;

/// Takes things from `next` until there are none, works on them on the threads of the budget, and hands
/// the results to `take` in the order of `next`, on the calling thread. At most `ahead` results are
/// made and not taken. Where that is many, threads take several things at a time.
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
    let group = (ahead / (AHEAD * threads)).max(1);
    let tickets = ahead / group;
    let source = Mutex::new((0u64, next));
    // A token is the right to have one group of results under way.
    let (give, tokens) = channel::bounded::<()>(tickets);
    let (done, results) = channel::unbounded();
    for _ in 0..tickets {
        give.send(()).expect("there is room for all tokens");
    }
    let work = &work;
    let source = &source;
    std::thread::scope(|scope| {
        for _ in 0..threads {
            let (tokens, done) = (tokens.clone(), done.clone());
            scope.spawn(move || {
                while tokens.recv().is_ok() {
                    let mut things = Vec::with_capacity(group);
                    let (ticket, mut ended) = {
                        let mut source = source.lock().expect("sources do not panic");
                        source.0 += 1;
                        let ended = loop {
                            if things.len() == group {
                                break None;
                            }
                            match budget.check_cancelled().and_then(|()| source.1()) {
                                Ok(Some(thing)) => things.push(thing),
                                Ok(None) => break Some(Ok(())),
                                Err(e) => break Some(Err(e)),
                            }
                        };
                        (source.0, ended)
                    };
                    let mut made = Vec::with_capacity(things.len());
                    for thing in things {
                        match work(thing) {
                            Ok(result) => made.push(result),
                            Err(e) => {
                                ended = Some(Err(e));
                                break;
                            }
                        }
                    }
                    let last = ended.is_some();
                    if done.send((ticket, made, ended)).is_err() || last {
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
        for (ticket, made, ended) in &results {
            waiting.insert(ticket, (made, ended));
            while let Some((made, ended)) = waiting.remove(&expected) {
                made.into_iter().try_for_each(&mut take)?;
                if let Some(Err(e)) = ended {
                    return Err(e);
                }
                expected += 1;
                // Nobody may be left to take it.
                let _ = give.try_send(());
            }
        }
        Ok(())
    })
}
