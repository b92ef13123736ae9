//! Threads that encode batches of bricks side by side and hand them over in the order of their
//! tickets, so that the bytes of the file do not depend on scheduling.

use super::encode::BrickEncoder;
use super::writer::VolumeWriter;
use crate::budget::Budget;
use crate::error::{Error, ErrorKind, Result};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Edge in samples of the cube that makes one batch, about 1 MiB of f32.
pub(crate) const BATCH_EDGE: u32 = 64;

/// The order of the tickets, and the first error.
#[derive(Default)]
pub(crate) struct Crew {
    state: Mutex<State>,
    turn: Condvar,
}

#[derive(Default)]
struct State {
    next: u64,
    /// Batches that are written whole.
    written: u64,
    failed: bool,
    error: Option<Error>,
}

impl Crew {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Appends the batch of `encoder` when all smaller tickets have got their place.
    /// Tickets must be handed out in order and each must arrive here or in [`fail`](Self::fail).
    pub(crate) fn append(
        &self,
        ticket: u64,
        writer: &VolumeWriter,
        encoder: &BrickEncoder,
    ) -> Result<()> {
        let mut state = self.state();
        while state.next != ticket {
            if state.failed {
                return Err(stopped());
            }
            state = self
                .turn
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
        if state.failed {
            return Err(stopped());
        }
        let offset = writer.reserve(&encoder.batch)?;
        state.next += 1;
        drop(state);
        self.turn.notify_all();
        writer.write_reserved(&encoder.batch, offset)?;
        self.state().written += 1;
        self.turn.notify_all();
        Ok(())
    }

    /// Waits until `tickets` batches are written whole; `false` when somebody failed.
    pub(crate) fn wait_for(&self, tickets: u64) -> bool {
        let mut state = self.state();
        while state.written < tickets && !state.failed {
            state = self
                .turn
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
        !state.failed
    }

    /// Stops everybody; the first error is kept.
    pub(crate) fn fail(&self, error: Error) {
        let mut state = self.state();
        if !state.failed {
            state.error = Some(error);
        }
        state.failed = true;
        drop(state);
        self.turn.notify_all();
    }

    pub(crate) fn has_failed(&self) -> bool {
        self.state().failed
    }

    /// Runs `work`, and stops everybody when it fails or panics.
    pub(crate) fn run(&self, work: impl FnOnce() -> Result<()>) {
        struct OnPanic<'a>(&'a Crew);
        impl Drop for OnPanic<'_> {
            fn drop(&mut self) {
                if std::thread::panicking() {
                    self.0.fail(stopped());
                }
            }
        }
        let guard = OnPanic(self);
        if let Err(error) = work() {
            guard.0.fail(error);
        }
    }

    /// # Errors
    /// The first error.
    pub(crate) fn finish(self) -> Result<()> {
        let state = self
            .state
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner);
        match (state.failed, state.error) {
            (false, _) => Ok(()),
            (true, error) => Err(error.unwrap_or_else(stopped)),
        }
    }
}

fn stopped() -> Error {
    Error::new(
        ErrorKind::Cancelled,
        "stopped because another thread failed",
    )
}

/// How many threads fit when each takes `bytes`, leaving half of the free budget to others.
pub(crate) fn threads_for(budget: &Budget, bytes: u64) -> usize {
    let fit = budget.free_bytes() / 2 / bytes.max(1);
    (fit as usize).clamp(1, budget.threads())
}
