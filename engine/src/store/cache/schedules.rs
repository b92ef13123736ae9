//! The cache once more, with locks and threads whose every step a scheduler chooses: what the cache
//! promises holds in any order of steps. `BRICKMARCH_SCHEDULES` asks for more schedules.

/// Stands for `super::sync`.
mod sync {
    pub(super) use shuttle::sync::atomic::AtomicU64;
    pub(super) use shuttle::sync::{Arc, Condvar, Mutex, MutexGuard};
    pub(super) use shuttle::thread::{ThreadId, current, yield_now};
}

#[path = "pages.rs"]
#[allow(
    clippy::duplicate_mod,
    dead_code,
    unreachable_pub,
    reason = "the text of another module; not all of it is asked here"
)]
mod pages;

use crate::budget::Budget;
use crate::error::{Error, ErrorKind};
use pages::{ENTRY_OVERHEAD_BYTES, PageCache};
use shuttle::scheduler::{PctScheduler, RandomScheduler};
use shuttle::sync::Arc;
use shuttle::{Config, Runner, thread};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::SeqCst};

const CHARGE: u64 = 1000;
const ENTRY: u64 = CHARGE + ENTRY_OVERHEAD_BYTES;
const THREADS: u64 = 3;

/// A value that knows whether its memory is given back.
struct Value {
    key: u64,
    alive: std::sync::Arc<AtomicU64>,
}

impl Value {
    fn new(key: u64, alive: &std::sync::Arc<AtomicU64>) -> Self {
        alive.fetch_add(1, SeqCst);
        Self {
            key,
            alive: alive.clone(),
        }
    }
}

impl Drop for Value {
    fn drop(&mut self) {
        self.alive.fetch_sub(1, SeqCst);
    }
}

/// The cache with what the tests count.
struct World {
    budget: Budget,
    cache: PageCache<u64, Value>,
    alive: std::sync::Arc<AtomicU64>,
    loading: [AtomicBool; 8],
}

impl World {
    fn new(entries: u64) -> Arc<Self> {
        let budget = Budget::mib(1).with_threads(THREADS as usize);
        Arc::new(Self {
            cache: PageCache::new(&budget, entries * ENTRY),
            budget,
            alive: Default::default(),
            loading: Default::default(),
        })
    }

    /// Loads as a volume does, with a step in the middle.
    fn load(&self, key: u64) -> crate::Result<Value> {
        let other = self.loading[key as usize].swap(true, SeqCst);
        assert!(!other, "two threads load key {key}");
        let value = Value::new(key, &self.alive);
        thread::yield_now();
        assert!(self.loading[key as usize].swap(false, SeqCst));
        self.check();
        Ok(value)
    }

    fn check(&self) {
        let alive = self.alive.load(SeqCst);
        let used = self.budget.used_bytes();
        assert!(used <= self.cache.max_bytes(), "{used} bytes");
        assert!(alive * ENTRY <= used, "{alive} values in {used} bytes");
    }

    fn end(&self) {
        let stats = self.cache.stats();
        assert_eq!(stats.pinned_bytes, 0);
        assert_eq!(stats.bytes, self.budget.used_bytes());
        assert_eq!(stats.entries * ENTRY, stats.bytes);
        assert_eq!(self.alive.load(SeqCst), stats.entries);
        (0..8).for_each(|key| self.cache.forget(&key));
        assert_eq!((self.budget.used_bytes(), self.alive.load(SeqCst)), (0, 0));
    }
}

/// Runs `threads` side by side in many orders of their steps: chosen evenly, and such as meet rare
/// bugs (Burckhardt et al., A Randomized Scheduler with Probabilistic Guarantees, 2010).
fn in_any_order(entries: u64, job: fn(&World, u64)) {
    let asked = std::env::var("BRICKMARCH_SCHEDULES").ok();
    let schedules = asked.map_or(1500, |n| {
        n.parse().expect("BRICKMARCH_SCHEDULES is a number")
    });
    let test = move || {
        let world = World::new(entries);
        let threads: Vec<_> = (0..THREADS)
            .map(|n| {
                let world = world.clone();
                thread::spawn(move || job(&world, n))
            })
            .collect();
        for thread in threads {
            thread.join().expect("no thread panics");
        }
        world.end();
    };
    // The same schedules in every run.
    let random = RandomScheduler::new_from_seed(1, schedules);
    Runner::new(random, Config::new()).run(test);
    let rare = PctScheduler::new_from_seed(2, 3, schedules);
    Runner::new(rare, Config::new()).run(test);
}

#[test]
fn one_pin_per_thread_is_never_refused() {
    // Room for what the threads can pin at one time, and nothing more.
    in_any_order(THREADS, |world, thread| {
        for step in 0..3 {
            let key = (thread + step * step) % 5;
            let value = world.cache.get(key, CHARGE, || world.load(key));
            let value = value.expect("the others pin one entry each");
            thread::yield_now();
            assert_eq!(value.key, key);
            world.check();
        }
    });
}

#[test]
fn a_full_cache_refuses_and_goes_on() {
    in_any_order(2, |world, thread| {
        for key in [thread, 3, (thread + 1) % 3] {
            match world.cache.get(key, CHARGE, || world.load(key)) {
                Ok(value) => {
                    thread::yield_now();
                    assert_eq!(value.key, key);
                }
                Err(error) => assert_eq!(error.kind(), ErrorKind::BudgetExceeded, "{error}"),
            }
            world.check();
        }
    });
}

#[test]
fn forgetting_beside_loads_and_pins() {
    in_any_order(THREADS + 1, |world, thread| {
        for step in 0..3 {
            let key = step % 2;
            if (thread + step) % 3 == 0 {
                world.cache.forget(&key);
                continue;
            }
            // A forgotten entry that is pinned keeps its room, so that there may be too little.
            if let Ok(value) = world.cache.get(key, CHARGE, || world.load(key)) {
                world.cache.forget(&key);
                let peeked = world.cache.peek(&(1 - key));
                thread::yield_now();
                assert_eq!(value.key, key);
                assert!(peeked.is_none_or(|p| p.key == 1 - key));
            }
            world.check();
        }
    });
}

#[test]
fn a_failing_loader_costs_nobody_the_key() {
    in_any_order(THREADS, |world, thread| {
        let fails = || {
            thread::yield_now();
            Err(Error::new(ErrorKind::Damaged, "a loader that fails"))
        };
        match thread {
            0 => {
                // Or another thread has loaded it.
                let got = world.cache.get(1, CHARGE, fails);
                assert!(got.is_ok_and(|v| v.key == 1) || thread == 0);
            }
            _ => match world.cache.get(1, CHARGE, || world.load(1)) {
                Ok(value) => assert_eq!(value.key, 1),
                // It waited for the one that failed.
                Err(error) => assert_eq!(error.kind(), ErrorKind::Damaged),
            },
        }
        let value = world.cache.get(2, CHARGE, || world.load(2));
        assert_eq!(value.expect("fits").key, 2);
    });
}

#[test]
fn after_a_panic_a_waiter_loads() {
    in_any_order(THREADS, |world, thread| {
        if thread == 0 {
            let panics = || -> crate::Result<Value> {
                thread::yield_now();
                std::panic::resume_unwind(Box::new("a loader that panics"))
            };
            let got = catch_unwind(AssertUnwindSafe(|| world.cache.get(1, CHARGE, panics)));
            assert!(got.is_err() || got.is_ok_and(|v| v.is_ok_and(|v| v.key == 1)));
        } else {
            let value = world.cache.get(1, CHARGE, || world.load(1));
            assert_eq!(value.expect("loads after the panic").key, 1);
        }
    });
}
