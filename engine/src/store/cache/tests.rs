use super::pages::Slot;
use super::*;
use crate::budget::Budget;
use crate::error::{Error, ErrorKind};
use proptest::prelude::*;
use std::cell::Cell;
use std::collections::{HashMap, HashSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Barrier;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize};

const OVERHEAD: u64 = ENTRY_OVERHEAD_BYTES;

fn small(max_bytes: u64) -> (Budget, PageCache<u64, u64>) {
    let budget = Budget::mib(64).with_threads(2);
    let cache = PageCache::new(&budget, max_bytes);
    (budget, cache)
}

/// Waits for another thread without sleeping a fixed time.
fn until(what: impl Fn() -> bool) {
    while !what() {
        std::thread::yield_now();
    }
}

#[test]
fn second_request_does_not_load() {
    let (budget, cache) = small(10_000);
    let first = cache.get(3, 100, || Ok(33)).expect("loads");
    let again = cache
        .get(3, 100, || panic!("is loaded already"))
        .expect("hit");
    assert_eq!((*first, *again), (33, 33));
    assert!(cache.peek(&4).is_none());
    let stats = cache.stats();
    assert_eq!((stats.hits, stats.misses, stats.entries), (1, 1, 1));
    assert_eq!(stats.bytes, 100 + OVERHEAD);
    assert_eq!(stats.pinned_bytes, stats.bytes);
    drop((first, again));
    assert_eq!(cache.stats().pinned_bytes, 0);
    assert_eq!(budget.used_bytes(), 100 + OVERHEAD);
    drop(cache);
    assert_eq!(budget.used_bytes(), 0);
}

#[test]
fn the_charge_is_taken_before_the_loader_runs() {
    let (budget, cache) = small(10_000);
    let seen = cache
        .get(1, 500, || Ok(budget.used_bytes()))
        .expect("loads");
    assert_eq!(*seen, 500 + OVERHEAD);
}

#[test]
fn clock_gives_a_second_chance_to_what_was_used() {
    let (_, cache) = small(3 * (100 + OVERHEAD));
    for key in 0..3 {
        cache.get(key, 100, || Ok(key)).expect("fits");
    }
    cache.peek(&0).expect("is there"); // sets its bit
    cache.get(3, 100, || Ok(3)).expect("evicts one");
    assert!(cache.peek(&0).is_some(), "0 was used");
    assert!(cache.peek(&1).is_none(), "1 was not");
    assert!(cache.peek(&2).is_some());
    assert_eq!(cache.stats().evictions, 1);
}

#[test]
fn pinned_entries_stay_and_a_full_cache_refuses() {
    let (budget, cache) = small(2 * (1000 + OVERHEAD));
    let a = cache.get(1, 1000, || Ok(1)).expect("fits");
    let b = cache.get(2, 1000, || Ok(2)).expect("fits");
    let refused = cache.get(3, 0, || panic!("must not run"));
    let refused = refused.expect_err("all is pinned");
    assert_eq!(refused.kind(), ErrorKind::BudgetExceeded);
    let text = refused.to_string();
    for part in ["128 B", "2.2 KiB of its 2.2 KiB are pinned", "64 MiB"] {
        assert!(text.contains(part), "{part} in: {text}");
    }
    drop(a);
    cache.get(3, 0, || Ok(3)).expect("1 can go");
    assert!(cache.peek(&1).is_none());
    assert_eq!(*b, 2);
    assert!(cache.get(9, u64::MAX, || panic!("must not run")).is_err());
    assert!(
        cache.peek(&3).is_some(),
        "a hopeless request evicts nothing"
    );
    assert!(budget.peak_bytes() <= cache.max_bytes());
}

#[test]
fn a_budget_shared_with_others_is_respected() {
    let budget = Budget::bytes(10_000).with_threads(1);
    let cache: PageCache<u64, u64> = PageCache::new(&budget, u64::MAX);
    for key in 0..100 {
        cache.get(key, 1000, || Ok(key)).expect("evicts");
    }
    assert!(budget.free_bytes() < 1128);
    let entries = cache.stats().entries;
    for key in 50..100 {
        cache.forget(&key);
    }
    assert_eq!((entries, budget.used_bytes()), (8, 0));
    let others = budget.take(9_000, "others").expect("free");
    assert!(cache.get(1, 1000, || Ok(1)).is_err());
    drop(others);
    assert!(cache.get(1, 1000, || Ok(1)).is_ok());
}

#[test]
fn a_forgotten_entry_is_charged_until_its_last_ref_is_gone() {
    let (budget, cache) = small(10_000);
    let old = cache.get(1, 1000, || Ok(1)).expect("loads");
    let clone = old.clone();
    cache.forget(&1);
    assert!(cache.peek(&1).is_none());
    let new = cache.get(1, 1000, || Ok(2)).expect("loads again");
    assert_eq!((*old, *new), (1, 2));
    assert_eq!(budget.used_bytes(), 2 * (1000 + OVERHEAD));
    assert_eq!(cache.stats().pinned_bytes, budget.used_bytes());
    drop(old);
    assert_eq!(budget.used_bytes(), 2 * (1000 + OVERHEAD));
    drop(clone);
    assert_eq!(budget.used_bytes(), 1000 + OVERHEAD);
}

#[test]
fn errors_are_not_cached() {
    let (budget, cache) = small(10_000);
    let failed = cache.get(1, 10, || {
        Err(Error::new(ErrorKind::Damaged, "block 7: bad sum"))
    });
    assert_eq!(failed.expect_err("fails").kind(), ErrorKind::Damaged);
    assert_eq!(budget.used_bytes(), 0);
    assert_eq!(*cache.get(1, 10, || Ok(5)).expect("loads"), 5);
    assert_eq!(cache.stats().misses, 2);
}

#[test]
fn a_loader_may_ask_for_other_keys_but_not_its_own() {
    let (budget, cache) = small(10_000);
    let child = cache.get(2, 10, || Ok(*cache.get(1, 10, || Ok(40))? + 2));
    assert_eq!(*child.expect("loads both"), 42);
    let own = catch_unwind(AssertUnwindSafe(|| {
        cache.get(7, 10, || Ok(*cache.get(7, 10, || Ok(1))?))
    }));
    assert!(own.is_err(), "would wait for itself");
    assert_eq!(budget.used_bytes(), 2 * (10 + OVERHEAD));
    assert_eq!(*cache.get(7, 10, || Ok(8)).expect("slot is clear"), 8);
}

#[test]
fn waiters_get_the_value_of_the_one_loader() {
    let (_, cache) = small(10_000);
    let loads = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| {
                let page = cache.get(1, 10, || {
                    loads.fetch_add(1, Relaxed);
                    until(|| cache.stats().waits == 7);
                    Ok(11)
                });
                assert_eq!(*page.expect("loads"), 11);
            });
        }
    });
    assert_eq!(loads.into_inner(), 1);
}

#[test]
fn waiters_get_the_error_of_the_one_loader() {
    let (_, cache) = small(10_000);
    let loads = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let page = cache.get(1, 10, || {
                    loads.fetch_add(1, Relaxed);
                    until(|| cache.stats().waits == 3);
                    Err(Error::new(ErrorKind::Truncated, "ends at byte 9"))
                });
                let error = page.expect_err("failed");
                assert_eq!(error.kind(), ErrorKind::Truncated);
                assert_eq!(error.to_string(), "ends at byte 9");
            });
        }
    });
    assert_eq!(loads.into_inner(), 1);
    assert!(cache.peek(&1).is_none());
}

#[test]
fn after_a_panic_a_waiter_loads() {
    let (budget, cache) = small(10_000);
    let loading = Barrier::new(2);
    std::thread::scope(|scope| {
        let (cache, loading) = (&cache, &loading);
        let first = scope.spawn(move || {
            let load = || {
                loading.wait();
                until(|| cache.stats().waits == 3);
                panic!("in the decoder")
            };
            catch_unwind(AssertUnwindSafe(|| cache.get(1, 10, load).map(|_| ()))).is_err()
        });
        loading.wait();
        let rest: Vec<_> = (0..3)
            .map(|_| scope.spawn(move || *cache.get(1, 10, || Ok(6)).expect("loads")))
            .collect();
        assert!(first.join().expect("caught"));
        for waiter in rest {
            assert_eq!(waiter.join().expect("no panic here"), 6);
        }
    });
    assert_eq!(cache.stats().misses, 2);
    assert_eq!(budget.used_bytes(), 10 + OVERHEAD);
}

#[test]
fn shards_are_few_when_the_cache_is_small() {
    let budget = Budget::mib(256).with_threads(2);
    let shards = |bytes| PageCache::<u64, u64>::new(&budget, bytes).shards.len();
    assert_eq!(shards(0), 1);
    assert_eq!(shards(8 << 20), 1);
    assert_eq!(shards(17 << 20), 2);
    assert_eq!(shards(u64::MAX), 8);
}

#[test]
fn one_shard_can_take_the_room_of_all_others() {
    let budget = Budget::mib(1).with_threads(8);
    let cache: PageCache<u64, u64> = PageCache::with_entry_bytes(&budget, 1 << 20, 100);
    assert_eq!(cache.shards.len(), 32);
    for key in 0..5000 {
        cache.get(key, 100, || Ok(key)).expect("fits");
    }
    let all = (1 << 20) - OVERHEAD;
    cache
        .get(1 << 40, all, || Ok(0))
        .expect("all others can go");
    assert_eq!(cache.stats().entries, 1);
    assert_eq!(budget.peak_bytes(), 1 << 20);
}

#[test]
fn hashes_spread_over_shards_and_buckets() {
    // Offsets of pages, Morton-like codes and small integers, the keys that volumes use.
    for stride in [1u64, 40, 4096, 1 << 15, 1 << 33] {
        let budget = Budget::mib(64).with_threads(4);
        let cache: PageCache<(u32, u64), ()> = PageCache::with_entry_bytes(&budget, 64 << 20, 128);
        let shards = cache.shards.len() as u64;
        for i in 0..8192 {
            cache.get((1, i * stride), 0, || Ok(())).expect("fits");
        }
        for shard in &cache.shards {
            let pages = shard.lock().pages.len() as u64;
            let even = 8192 / shards;
            assert!(
                (even / 2..even * 2).contains(&pages),
                "stride {stride}: {pages} of {even}"
            );
        }
    }
}

#[derive(Clone, Debug)]
enum Op {
    Get { key: u64, bytes: u64 },
    Fail { key: u64 },
    Panic { key: u64 },
    Unpin { which: usize },
    Peek { key: u64 },
    Forget { key: u64 },
}

fn ops() -> impl Strategy<Value = Vec<Op>> {
    let key = 0..24u64;
    let op = prop_oneof![
        8 => (key.clone(), 0..600u64).prop_map(|(key, bytes)| Op::Get { key, bytes }),
        1 => key.clone().prop_map(|key| Op::Fail { key }),
        1 => key.clone().prop_map(|key| Op::Panic { key }),
        6 => (0..64usize).prop_map(|which| Op::Unpin { which }),
        2 => key.clone().prop_map(|key| Op::Peek { key }),
        1 => key.prop_map(|key| Op::Forget { key }),
    ];
    prop::collection::vec(op, 1..200)
}

/// What the cache must hold: the live values by number, however it chooses what to evict.
#[derive(Default)]
struct Model {
    /// Key to (number of the load, charge); entries vanish when the cache says that it evicted.
    entries: HashMap<u64, (u64, u64)>,
    /// Pins held by the test: number of the load, charge, and the pin.
    pins: Vec<(u64, u64, u64, Ref<u64>)>,
}

impl Model {
    /// Charge of everything that is pinned, each load once.
    fn pinned(&self) -> u64 {
        let mut seen = HashSet::new();
        self.pins
            .iter()
            .filter(|(_, number, ..)| seen.insert(*number))
            .map(|(_, _, charge, _)| charge)
            .sum()
    }

    fn live(&self) -> u64 {
        let kept: HashSet<u64> = self.entries.values().map(|e| e.0).collect();
        let mut seen = HashSet::new();
        let orphans = self
            .pins
            .iter()
            .filter(|(_, number, ..)| !kept.contains(number) && seen.insert(*number));
        self.entries.values().map(|e| e.1).sum::<u64>() + orphans.map(|p| p.2).sum::<u64>()
    }

    /// Adopts evictions: only unpinned entries may have gone.
    fn follow(&mut self, cache: &PageCache<u64, u64>) {
        let pinned: HashSet<u64> = self.pins.iter().map(|p| p.1).collect();
        let before = cache.stats();
        self.entries.retain(|key, (number, _)| {
            let there = {
                let ring = cache.shards[cache.home(key)].lock();
                matches!(ring.slots.get(key), Some(Slot::Ready(_)))
            };
            assert!(there || !pinned.contains(number), "evicted while pinned");
            there
        });
        assert_eq!(before.entries, self.entries.len() as u64);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn any_sequence_agrees_with_a_plain_map(
        ops in ops(),
        max in 1000..6000u64,
        others in prop_oneof![Just(0u64), 1000..5000u64],
    ) {
        // Two limits: the cache's own, and a pool of which others hold a part.
        let budget = Budget::bytes(others + 4000).with_threads(2);
        let _held = budget.take(others, "others").expect("fits");
        let cache = PageCache::with_entry_bytes(&budget, max, 1);
        let limit = max.min(4000);
        let mut model = Model::default();
        let mut number = 0;
        for op in ops {
            match op {
                Op::Get { key, bytes } => {
                    let known = model.entries.get(&key).copied();
                    let loaded = Cell::new(false);
                    let pinned = model.pinned();
                    let got = cache.get(key, bytes, || { loaded.set(true); Ok(number) });
                    prop_assert_eq!(loaded.get(), known.is_none() && got.is_ok());
                    let charge = bytes + OVERHEAD;
                    match (known, got) {
                        (Some((number, charge)), Ok(page)) => {
                            prop_assert_eq!(*page, number);
                            model.pins.push((key, number, charge, page));
                        }
                        (None, Ok(page)) => {
                            prop_assert_eq!(*page, number);
                            model.entries.insert(key, (number, charge));
                            model.pins.push((key, number, charge, page));
                            number += 1;
                        }
                        (Some(_), Err(error)) => panic!("a hit failed: {error}"),
                        (None, Err(error)) => {
                            prop_assert_eq!(error.kind(), ErrorKind::BudgetExceeded);
                            prop_assert!(pinned + charge > limit, "{} + {} <= {}", pinned, charge, limit);
                        }
                    }
                }
                Op::Fail { key } => {
                    let known = model.entries.contains_key(&key);
                    let got = cache.get(key, 0, || Err(Error::bad_input("no such page")));
                    prop_assert_eq!(got.is_ok(), known);
                }
                Op::Panic { key } => {
                    let known = model.entries.contains_key(&key);
                    let got = catch_unwind(AssertUnwindSafe(|| {
                        // Quiet: resumed, not raised.
                        cache.get(key, 0, || std::panic::resume_unwind(Box::new(())))
                    }));
                    match got {
                        Ok(Ok(_)) => prop_assert!(known),
                        Ok(Err(error)) => prop_assert_eq!(error.kind(), ErrorKind::BudgetExceeded),
                        Err(_) => prop_assert!(!known),
                    }
                }
                Op::Unpin { which } if !model.pins.is_empty() => {
                    let at = which % model.pins.len();
                    let (_, number, _, page) = model.pins.swap_remove(at);
                    prop_assert_eq!(*page, number);
                }
                Op::Unpin { .. } => {}
                Op::Peek { key } => {
                    let known = model.entries.get(&key).map(|e| e.0);
                    prop_assert_eq!(cache.peek(&key).map(|page| *page), known);
                }
                Op::Forget { key } => {
                    cache.forget(&key);
                    model.entries.remove(&key);
                }
            }
            model.follow(&cache);
            let stats = cache.stats();
            prop_assert_eq!(stats.bytes, model.live());
            prop_assert_eq!(stats.bytes + others, budget.used_bytes());
            prop_assert_eq!(stats.pinned_bytes, model.pinned());
            prop_assert!(stats.bytes <= limit);
        }
        prop_assert!(budget.peak_bytes() <= others + limit);
    }
}

/// Eight threads, loaders that fail and panic at random, pins held across requests.
#[test]
fn threads_hammering_one_cache_never_overshoot_and_load_once() {
    const THREADS: usize = 8;
    const KEYS: u64 = 96;
    let requests: u64 = if cfg!(debug_assertions) {
        20_000
    } else {
        100_000
    };
    for (max_bytes, entry_bytes) in [(24 * 1128, 1000), (200 * 1128, 1)] {
        // The pool is smaller than the sum of the cache's limit and what others ask for.
        let budget = Budget::bytes(max_bytes + 4000).with_threads(THREADS);
        let cache: PageCache<u64, Vec<u64>> =
            PageCache::with_entry_bytes(&budget, max_bytes, entry_bytes);
        let loading: Vec<AtomicUsize> = (0..KEYS).map(|_| AtomicUsize::new(0)).collect();
        let (refused, failed, panicked) = (AtomicU64::new(0), AtomicU64::new(0), AtomicU64::new(0));
        let done = AtomicBool::new(false);
        std::thread::scope(|scope| {
            let watcher = scope.spawn(|| {
                let mut samples = 0u64;
                while !done.load(Relaxed) {
                    let stats = cache.stats();
                    assert!(stats.bytes <= max_bytes, "{stats:?}");
                    assert!(budget.used_bytes() <= budget.memory_bytes());
                    samples += 1;
                }
                samples
            });
            let workers: Vec<_> = (0..THREADS as u64)
                .map(|thread| {
                    let (cache, loading, budget) = (&cache, &loading, &budget);
                    let (refused, failed, panicked) = (&refused, &failed, &panicked);
                    scope.spawn(move || {
                        let mut random = 0x9e37_79b9_7f4a_7c15u64 ^ (thread << 32);
                        let mut next = move || {
                            random ^= random << 13;
                            random ^= random >> 7;
                            random ^= random << 17;
                            random
                        };
                        let mut pins: Vec<(u64, Ref<Vec<u64>>)> = Vec::new();
                        for _ in 0..requests {
                            let (a, b) = (next(), next());
                            // Skewed: half of the requests go to a few hot keys.
                            let key = if a & 1 == 0 {
                                (a >> 8) % 8
                            } else {
                                (a >> 8) % KEYS
                            };
                            let fate = b % 64;
                            let words = (key % 5 + 1) * 25;
                            let load = || {
                                let now = &loading[key as usize];
                                assert_eq!(now.fetch_add(1, Relaxed), 0, "two loaders of {key}");
                                if b >> 8 & 3 == 0 {
                                    std::thread::yield_now();
                                }
                                let page = vec![key; words as usize];
                                now.fetch_sub(1, Relaxed);
                                match fate {
                                    0 => Err(Error::new(ErrorKind::Damaged, format!("key {key}"))),
                                    1 => std::panic::resume_unwind(Box::new(())),
                                    _ => Ok(page),
                                }
                            };
                            let got =
                                catch_unwind(AssertUnwindSafe(|| cache.get(key, words * 8, load)));
                            match got {
                                Ok(Ok(page)) => {
                                    assert_eq!(page.len() as u64, words);
                                    assert!(page.iter().all(|&v| v == key));
                                    pins.push((key, page));
                                }
                                Ok(Err(error)) if error.kind() == ErrorKind::BudgetExceeded => {
                                    refused.fetch_add(1, Relaxed);
                                    pins.clear();
                                }
                                Ok(Err(error)) => {
                                    assert_eq!(error.to_string(), format!("key {key}"));
                                    failed.fetch_add(1, Relaxed);
                                }
                                Err(_) => {
                                    panicked.fetch_add(1, Relaxed);
                                }
                            }
                            if pins.len() > (b >> 16) as usize % 4 {
                                let (key, page) = pins.swap_remove((b >> 24) as usize % pins.len());
                                assert_eq!(page[0], key);
                            }
                            match b >> 32 & 255 {
                                0 => cache.forget(&key),
                                1 => drop(budget.try_take(3000)),
                                _ => {}
                            }
                        }
                    })
                })
                .collect();
            for worker in workers {
                worker.join().expect("no worker failed an assertion");
            }
            done.store(true, Relaxed);
            assert!(watcher.join().expect("never too many bytes") > 0);
        });
        let stats = cache.stats();
        assert_eq!(stats.pinned_bytes, 0, "{stats:?}");
        assert_eq!(stats.bytes, budget.used_bytes());
        assert!(budget.peak_bytes() <= budget.memory_bytes());
        assert!(stats.hits > 0 && stats.misses > 0, "{stats:?}");
        assert!(failed.into_inner() > 0 && panicked.into_inner() > 0);
        if entry_bytes == 1000 {
            assert!(stats.evictions > 0, "{stats:?}");
        }
        let charged: u64 = (0..KEYS)
            .filter_map(|key| cache.peek(&key).map(|_| (key % 5 + 1) * 200 + OVERHEAD))
            .sum();
        assert_eq!(charged, stats.bytes);
        drop(cache);
        assert_eq!(budget.used_bytes(), 0);
    }
}

/// With one page of room per thread and no pins held over, no request may be refused, however the
/// threads race for what is evicted.
#[test]
fn threads_within_the_stated_minimum_are_never_refused() {
    const THREADS: u64 = 8;
    let budget = Budget::bytes(THREADS * (1000 + OVERHEAD)).with_threads(THREADS as usize);
    let cache: PageCache<u64, u64> = PageCache::with_entry_bytes(&budget, u64::MAX, 1);
    std::thread::scope(|scope| {
        for thread in 0..THREADS {
            let cache = &cache;
            scope.spawn(move || {
                for i in 0..20_000u64 {
                    let key = (i * 7 + thread * 13) % 64;
                    let page = cache.get(key, 1000, || Ok(key)).expect("never refused");
                    assert_eq!(*page, key);
                }
            });
        }
    });
    assert!(budget.peak_bytes() <= budget.memory_bytes());
}
