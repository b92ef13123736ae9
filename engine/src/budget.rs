//! Memory, threads, cancellation and progress of a long operation, as one argument.
//!
//! Everything large holds a [`Permit`] from the one pool of its [`Budget`]: the permit is taken
//! first, the memory is allocated second. A request that does not fit is an error, never a silent
//! overshoot.

use crate::error::{Error, ErrorKind, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Memory bytes, threads, cancellation and progress. Cloning shares all of them.
///
/// ```
/// use brickmarch::Budget;
/// let budget = Budget::mib(64).with_threads(2);
/// let permit = budget.take(1 << 20, "a buffer").unwrap();
/// assert_eq!(budget.used_bytes(), 1 << 20);
/// drop(permit);
/// assert_eq!(budget.used_bytes(), 0);
/// assert!(budget.take(1 << 30, "a mountain").is_err());
/// ```
#[derive(Clone, Debug)]
pub struct Budget {
    pool: Arc<Pool>,
    threads: usize,
    cancel: CancelToken,
    progress: Arc<Progress>,
}

#[derive(Debug)]
struct Pool {
    total: u64,
    used: AtomicU64,
    peak: AtomicU64,
}

/// A reserved share of a [`Budget`]; returns it when dropped.
#[derive(Debug)]
pub struct Permit {
    pool: Arc<Pool>,
    bytes: u64,
}

/// Set once to stop an operation; checked once per brick.
#[derive(Clone, Debug, Default)]
pub struct CancelToken(Arc<AtomicBool>);

/// Work done and work known so far, in units of the operation (bricks or bytes).
#[derive(Debug, Default)]
pub struct Progress {
    done: AtomicU64,
    total: AtomicU64,
}

impl Default for Budget {
    /// 256 MiB and all cores.
    fn default() -> Self {
        Self::mib(256)
    }
}

impl Budget {
    /// A budget of `bytes` of memory and as many threads as the machine has cores.
    pub fn bytes(bytes: u64) -> Self {
        let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
        Self {
            pool: Arc::new(Pool {
                total: bytes,
                used: AtomicU64::new(0),
                peak: AtomicU64::new(0),
            }),
            threads,
            cancel: CancelToken::default(),
            progress: Arc::default(),
        }
    }

    /// A budget of `mib` mebibytes.
    pub fn mib(mib: u64) -> Self {
        Self::bytes(mib << 20)
    }

    /// The same pool with at most `threads` threads (at least one).
    #[must_use]
    pub fn with_threads(mut self, threads: usize) -> Self {
        self.threads = threads.max(1);
        self
    }

    /// Upper limit of threads; an operation uses fewer when its memory does not suffice for all.
    pub fn threads(&self) -> usize {
        self.threads
    }

    /// The whole budget in bytes.
    pub fn memory_bytes(&self) -> u64 {
        self.pool.total
    }

    /// Bytes under permit now.
    pub fn used_bytes(&self) -> u64 {
        self.pool.used.load(Ordering::Relaxed)
    }

    /// Bytes not under permit now.
    pub fn free_bytes(&self) -> u64 {
        self.pool.total.saturating_sub(self.used_bytes())
    }

    /// The most bytes that were under permit at one time.
    pub fn peak_bytes(&self) -> u64 {
        self.pool.peak.load(Ordering::Relaxed)
    }

    /// Reserves `bytes` for `what`.
    ///
    /// # Errors
    /// [`ErrorKind::BudgetExceeded`], naming what was asked, used and allowed.
    pub fn take(&self, bytes: u64, what: &str) -> Result<Permit> {
        self.try_take(bytes)
            .ok_or_else(|| self.refusal(bytes, what))
    }

    /// Reserves `bytes` if they are free.
    pub fn try_take(&self, bytes: u64) -> Option<Permit> {
        self.pool.reserve(bytes).then(|| Permit {
            pool: self.pool.clone(),
            bytes,
        })
    }

    fn refusal(&self, bytes: u64, what: &str) -> Error {
        Error::new(
            ErrorKind::BudgetExceeded,
            format!(
                "{what} needs {} of memory; {} of the budget of {} are in use: give more with --mem",
                human_bytes(bytes),
                human_bytes(self.used_bytes()),
                human_bytes(self.pool.total)
            ),
        )
    }

    /// The token that cancels operations of this budget.
    pub fn cancel_token(&self) -> CancelToken {
        self.cancel.clone()
    }

    /// Progress of the operation that runs under this budget.
    pub fn progress(&self) -> &Arc<Progress> {
        &self.progress
    }

    /// # Errors
    /// [`ErrorKind::Cancelled`] after [`CancelToken::cancel`].
    pub fn check_cancelled(&self) -> Result<()> {
        if self.cancel.is_cancelled() {
            return Err(Error::new(ErrorKind::Cancelled, "stopped on request"));
        }
        Ok(())
    }
}

impl Pool {
    fn reserve(&self, bytes: u64) -> bool {
        let taken = self
            .used
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, |used| {
                used.checked_add(bytes).filter(|&sum| sum <= self.total)
            });
        if let Ok(before) = taken {
            self.peak.fetch_max(before + bytes, Ordering::Relaxed);
        }
        taken.is_ok()
    }
}

impl Permit {
    /// Bytes that this permit covers.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Tries to cover `bytes` in all; shrinking always succeeds.
    pub fn try_resize(&mut self, bytes: u64) -> bool {
        if bytes > self.bytes && !self.pool.reserve(bytes - self.bytes) {
            return false;
        }
        if bytes < self.bytes {
            self.pool
                .used
                .fetch_sub(self.bytes - bytes, Ordering::AcqRel);
        }
        self.bytes = bytes;
        true
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        self.pool.used.fetch_sub(self.bytes, Ordering::AcqRel);
    }
}

impl CancelToken {
    /// Asks every operation that shares this token to stop.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// Whether [`cancel`](Self::cancel) was called.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

impl Progress {
    /// Starts a phase of `total` units.
    pub fn start(&self, total: u64) {
        self.done.store(0, Ordering::Relaxed);
        self.total.store(total, Ordering::Relaxed);
    }

    /// Counts `units` as done.
    pub fn add(&self, units: u64) {
        self.done.fetch_add(units, Ordering::Relaxed);
    }

    /// Units done and units known.
    pub fn get(&self) -> (u64, u64) {
        (
            self.done.load(Ordering::Relaxed),
            self.total.load(Ordering::Relaxed),
        )
    }
}

/// `1536` as "1.5 KiB".
pub fn human_bytes(bytes: u64) -> String {
    let units = ["B", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB"];
    let mut value = bytes as f64;
    let mut unit = 0;
    while value >= 1024.0 && unit + 1 < units.len() {
        value /= 1024.0;
        unit += 1;
    }
    if unit == 0 || value.fract() == 0.0 {
        format!("{value:.0} {}", units[unit])
    } else {
        format!("{value:.1} {}", units[unit])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn permits_never_exceed_the_pool() {
        let budget = Budget::bytes(100);
        let first = budget.take(60, "first").expect("fits");
        assert!(budget.try_take(41).is_none());
        let mut second = budget.take(40, "second").expect("fits exactly");
        assert!(!second.try_resize(41));
        assert!(second.try_resize(10));
        assert_eq!(budget.used_bytes(), 70);
        drop(first);
        assert!(second.try_resize(100));
        assert_eq!(budget.peak_bytes(), 100);
        drop(second);
        assert_eq!(budget.used_bytes(), 0);
        let refused = budget.take(u64::MAX, "everything").expect_err("too much");
        assert_eq!(refused.kind(), ErrorKind::BudgetExceeded);
    }
}
