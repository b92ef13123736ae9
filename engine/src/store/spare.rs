//! Buffers of decoded bricks that go round: from the cache, when a brick leaves it, to the next brick.
//!
//! A buffer that was just in use is still near the processor, and needs neither zeros nor pages.

use crate::budget::{Budget, Permit};
use std::ops::Deref;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most bytes that lie idle, unless one brick has more.
const IDLE_BYTES: u64 = 256 << 10;

/// Buffers without a brick, under a permit of their own.
pub(super) struct Spare {
    idle: Mutex<Vec<Vec<u8>>>,
    most: usize,
    _permit: Option<Permit>,
}

/// The samples of a brick.
pub(super) struct Brick {
    bytes: Vec<u8>,
    spare: Arc<Spare>,
}

impl Spare {
    /// For bricks of `bytes`; keeps none where the budget has no room.
    pub(super) fn new(bytes: u64, budget: &Budget) -> Arc<Self> {
        let most = (IDLE_BYTES / bytes.max(1)).clamp(1, 64);
        // A large part of a small budget is better spent on bricks in use.
        let fits = most * bytes <= budget.memory_bytes() / 32;
        let permit = fits.then(|| budget.try_take(most * bytes)).flatten();
        Arc::new(Self {
            idle: Mutex::default(),
            most: if permit.is_some() { most as usize } else { 0 },
            _permit: permit,
        })
    }

    fn idle(&self) -> MutexGuard<'_, Vec<Vec<u8>>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A buffer of `bytes`, which hold whatever the brick before had.
    pub(super) fn take(&self, bytes: usize) -> Vec<u8> {
        let used = self.idle().pop();
        used.filter(|buffer| buffer.len() == bytes)
            .unwrap_or_else(|| vec![0; bytes])
    }

    /// Makes a brick of a buffer; it comes back when the brick is dropped.
    pub(super) fn brick(self: &Arc<Self>, bytes: Vec<u8>) -> Brick {
        Brick {
            bytes,
            spare: self.clone(),
        }
    }
}

impl Deref for Brick {
    type Target = [u8];

    #[inline]
    fn deref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for Brick {
    fn drop(&mut self) {
        let mut idle = self.spare.idle();
        if idle.len() < self.spare.most {
            idle.push(std::mem::take(&mut self.bytes));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_come_back_up_to_their_permit_and_not_of_another_size() {
        let budget = Budget::mib(64);
        let spare = Spare::new(100 << 10, &budget);
        assert_eq!(budget.used_bytes(), 200 << 10);
        let bricks: Vec<Brick> = (1..=3)
            .map(|n| {
                let mut bytes = spare.take(100 << 10);
                bytes.fill(n);
                spare.brick(bytes)
            })
            .collect();
        assert_eq!((bricks[0][7], bricks[2][0]), (1, 3));
        drop(bricks);
        assert_eq!(spare.idle().len(), 2);
        assert!(spare.take(100 << 10).iter().all(|&b| b == 2));
        assert_eq!(spare.take(99), vec![0; 99]);
        assert_eq!(spare.idle().len(), 0);
        drop(spare);
        assert_eq!(budget.used_bytes(), 0);
        assert_eq!(Spare::new(100 << 10, &Budget::mib(1)).most, 0);
    }
}
