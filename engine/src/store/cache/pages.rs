//! Decoded bricks and node pages in memory, never more bytes than allowed, shared by all threads.
//!
//! What it promises:
//! - The charge of an entry is reserved, in the cache's own limit and in the [`Budget`], *before*
//!   its loader runs, and given back after the value is freed. There is no instant of overshoot.
//! - A [`Ref`] pins its entry: eviction skips it. When all that is left is pinned, a load is refused.
//! - One loader per key at a time; whoever asks meanwhile waits for its result. Loaders run outside
//!   every lock. Errors are handed to the waiters and then forgotten; after a panic a waiter loads.
//!
//! The policy is CLOCK (Corbato 1968): a ring per shard, a bit per entry that a hit sets, a hand
//! that clears the bit or, where it is clear, evicts. For walks in Morton order it loads less than
//! LRU and S3-FIFO do, and a hit moves nothing.
//!
//! Lock order: `room` and the shards are leaves, never two at one time; no lock is held while a
//! loader runs, while a value is dropped, or while waiting for another thread's load.

use super::sync::{Arc, AtomicU64, Condvar, Mutex, MutexGuard, ThreadId, current, yield_now};
use crate::budget::{Budget, Permit, human_bytes};
use crate::error::{Error, ErrorKind, Result};
use std::collections::HashMap;
use std::hash::{BuildHasher, BuildHasherDefault, Hash, Hasher};
use std::ops::{Deref, Range};
use std::sync::PoisonError;
use std::sync::atomic::Ordering::{Acquire, Relaxed, Release};

/// Charged per entry on top of what the caller names: ring, table, reference count, permit.
pub const ENTRY_OVERHEAD_BYTES: u64 = 128;

/// Decoded bytes of a 32^3 brick of f32, the usual entry.
const TYPICAL_ENTRY_BYTES: u64 = 128 << 10;
/// Smaller shards would evict what the walk needs next.
const MIN_ENTRIES_PER_SHARD: u64 = 64;
const SHARDS_PER_THREAD: u64 = 4;
/// Ring positions looked at under one hold of a shard's lock.
const SCAN_STEPS: usize = 256;

/// A map from keys to loaded values with a hard byte limit; see the module's promises.
///
/// ```
/// use brickmarch::{Budget, store::cache::PageCache};
/// let cache = PageCache::new(&Budget::mib(8), 1 << 20);
/// let page = cache.get(7u64, 1000, || Ok(vec![7u8; 1000])).unwrap();
/// assert_eq!(page[0], 7);
/// assert_eq!(cache.stats().misses, 1);
/// ```
pub struct PageCache<K, V> {
    budget: Budget,
    totals: Arc<Totals>,
    max_bytes: u64,
    /// Makes the reservation in the two limits one step, so that a half-made one refuses nobody.
    room: Mutex<()>,
    pub(super) shards: Box<[Shard<K, V>]>,
}

/// Counters of a [`PageCache`] at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheStats {
    /// Requests that found their entry.
    pub hits: u64,
    /// Loads started.
    pub misses: u64,
    /// Requests that waited for the load of another thread.
    pub waits: u64,
    /// Entries given up to make room.
    pub evictions: u64,
    /// Bytes charged now: entries, loads under way, and forgotten entries that are still pinned.
    pub bytes: u64,
    /// The part of `bytes` that cannot be evicted now.
    pub pinned_bytes: u64,
    /// Entries that a request would find now.
    pub entries: u64,
}

/// A pinned entry. Clones share it; it is evicted only after the last one is dropped.
#[derive(Debug)]
pub struct Ref<V>(Arc<Entry<V>>);

#[derive(Debug)]
pub(super) struct Entry<V> {
    // Fields drop in this order: the memory is free before the charge is given back.
    value: V,
    charge: Charge,
}

/// Bytes reserved in the cache's limit and in the budget.
#[derive(Debug)]
struct Charge {
    permit: Permit,
    totals: Arc<Totals>,
}

#[derive(Debug, Default)]
struct Totals {
    bytes: AtomicU64,
    /// Bytes of entries that left the ring and are being freed: room that is about to appear.
    leaving: AtomicU64,
}

/// Own cache line, so that locks of neighbouring shards do not disturb each other.
#[repr(align(128))]
pub(super) struct Shard<K, V>(Mutex<Ring<K, V>>);

pub(super) struct Ring<K, V> {
    pub(super) slots: HashMap<K, Slot<V>, BuildHasherDefault<FoldHasher>>,
    pub(super) pages: Vec<Option<Page<K, V>>>,
    free: Vec<u32>,
    hand: usize,
    hits: u64,
    misses: u64,
    waits: u64,
    evictions: u64,
}

pub(super) enum Slot<V> {
    /// Position in `Ring::pages`.
    Ready(u32),
    Loading(Arc<Flight<V>>),
}

pub(super) struct Page<K, V> {
    key: K,
    entry: Arc<Entry<V>>,
    used: bool,
}

/// How eviction picks pages.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Sweep {
    /// CLOCK.
    Hand,
    /// Every page once, its bit ignored: before a refusal, when the hands of several threads may
    /// have passed each other.
    All,
}

/// A load under way.
pub(super) struct Flight<V> {
    loader: ThreadId,
    outcome: Mutex<Outcome<V>>,
    changed: Condvar,
}

enum Outcome<V> {
    Pending,
    Loaded(Arc<Entry<V>>),
    Failed(ErrorKind, String),
    /// The loader panicked: somebody else may try.
    Abandoned,
}

impl<V> Clone for Ref<V> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<V> Deref for Ref<V> {
    type Target = V;

    #[inline]
    fn deref(&self) -> &V {
        &self.0.value
    }
}

impl<K: Copy + Eq + Hash + Send + Sync, V: Send + Sync> PageCache<K, V> {
    /// An empty cache of at most `max_bytes`, all of them taken from `budget` when they are needed.
    pub fn new(budget: &Budget, max_bytes: u64) -> Self {
        Self::with_entry_bytes(budget, max_bytes, TYPICAL_ENTRY_BYTES)
    }

    /// The same where a usual entry has `entry_bytes`; decides the number of shards, nothing else.
    pub fn with_entry_bytes(budget: &Budget, max_bytes: u64, entry_bytes: u64) -> Self {
        let usual = entry_bytes.max(1).saturating_add(ENTRY_OVERHEAD_BYTES);
        let entries = max_bytes.min(budget.memory_bytes()) / usual;
        let wanted = SHARDS_PER_THREAD.saturating_mul(budget.threads() as u64);
        let shards = (entries / MIN_ENTRIES_PER_SHARD).clamp(1, wanted.min(1 << 12));
        Self {
            budget: budget.clone(),
            totals: Arc::default(),
            max_bytes,
            room: Mutex::new(()),
            shards: (0..shards).map(|_| Shard(Mutex::default())).collect(),
        }
    }

    /// The limit in bytes.
    pub fn max_bytes(&self) -> u64 {
        self.max_bytes
    }

    /// The entry of `key`, loaded if need be, pinned until the [`Ref`] and its clones are dropped.
    ///
    /// `load` must not allocate more than `charge_bytes` for the value. It may ask this cache for
    /// other keys as long as the keys wait for each other in one direction (node before child).
    ///
    /// # Errors
    /// [`ErrorKind::BudgetExceeded`] when the rest of the cache or of the budget is pinned or taken
    /// by others; else what `load` reports. A waiter gets the kind and message of its loader's error.
    ///
    /// # Panics
    /// When `load` asks for its own key, which would wait for itself.
    ///
    /// # Memory
    /// `charge_bytes` + [`ENTRY_OVERHEAD_BYTES`], reserved before `load` runs.
    pub fn get(
        &self,
        key: K,
        charge_bytes: u64,
        load: impl FnOnce() -> Result<V>,
    ) -> Result<Ref<V>> {
        let home = self.home(&key);
        loop {
            let flight = {
                let mut ring = self.shards[home].lock();
                match ring.slots.get(&key) {
                    Some(&Slot::Ready(at)) => return Ok(ring.hit(at)),
                    Some(Slot::Loading(flight)) => {
                        let flight = flight.clone();
                        ring.waits += 1;
                        flight
                    }
                    None => {
                        let flight = Arc::new(Flight::new());
                        ring.slots.insert(key, Slot::Loading(flight.clone()));
                        ring.misses += 1;
                        drop(ring);
                        return self.fill(home, key, flight, charge_bytes, load);
                    }
                }
            };
            if let Some(result) = flight.wait() {
                return result;
            }
        }
    }

    /// The entry of `key` if it is loaded.
    pub fn peek(&self, key: &K) -> Option<Ref<V>> {
        let mut ring = self.shards[self.home(key)].lock();
        match ring.slots.get(key) {
            Some(&Slot::Ready(at)) => Some(ring.hit(at)),
            _ => None,
        }
    }

    /// Drops the entry of `key`: at once, or with the last [`Ref`] to it. The next request loads
    /// again. A load under way is not disturbed.
    pub fn forget(&self, key: &K) {
        let mut ring = self.shards[self.home(key)].lock();
        if let Some(&Slot::Ready(at)) = ring.slots.get(key) {
            let entry = ring.remove(at);
            drop(ring); // the value is freed outside the lock
            drop(entry);
        }
    }

    /// Counters now. Looks at every entry.
    pub fn stats(&self) -> CacheStats {
        let mut stats = CacheStats::default();
        let mut idle_bytes = 0;
        for shard in &self.shards {
            let ring = shard.lock();
            stats.hits += ring.hits;
            stats.misses += ring.misses;
            stats.waits += ring.waits;
            stats.evictions += ring.evictions;
            for page in ring.pages.iter().flatten() {
                stats.entries += 1;
                if !page.is_pinned() {
                    idle_bytes += page.bytes();
                }
            }
        }
        stats.bytes = self.totals.bytes.load(Relaxed);
        stats.pinned_bytes = stats.bytes.saturating_sub(idle_bytes);
        stats
    }

    /// Runs the loader and publishes what became of it.
    fn fill(
        &self,
        home: usize,
        key: K,
        flight: Arc<Flight<V>>,
        charge_bytes: u64,
        load: impl FnOnce() -> Result<V>,
    ) -> Result<Ref<V>> {
        // Dropped in any way, also by a panic of the loader, it clears the slot and wakes waiters.
        let mut guard = LoadGuard {
            shard: &self.shards[home],
            key,
            flight: &flight,
            outcome: Outcome::Abandoned,
        };
        let loaded = self.make_room(home, charge_bytes).and_then(|charge| {
            let value = load()?;
            Ok(Arc::new(Entry { value, charge }))
        });
        match loaded {
            Ok(entry) => {
                guard.outcome = Outcome::Loaded(entry.clone());
                Ok(Ref(entry))
            }
            Err(error) => {
                guard.outcome = Outcome::Failed(error.kind(), error.to_string());
                Err(error)
            }
        }
    }

    /// Reserves the charge of an entry, evicting what is needed, from shard `home` first.
    fn make_room(&self, home: usize, charge_bytes: u64) -> Result<Charge> {
        let asked = charge_bytes.saturating_add(ENTRY_OVERHEAD_BYTES);
        if asked > self.max_bytes.min(self.budget.memory_bytes()) {
            return Err(self.refusal(asked));
        }
        loop {
            if let Some(charge) = self.try_charge(asked) {
                return Ok(charge);
            }
            if self.evict(home, asked, Sweep::Hand) || self.evict(home, asked, Sweep::All) {
                continue;
            }
            if self.totals.leaving.load(Acquire) > 0 {
                // Another thread is freeing entries; there may be room in a moment.
                yield_now();
                continue;
            }
            return self.try_charge(asked).ok_or_else(|| self.refusal(asked));
        }
    }

    fn try_charge(&self, asked: u64) -> Option<Charge> {
        let _one_at_a_time = lock(&self.room);
        let bytes = self.totals.bytes.load(Relaxed);
        if bytes.checked_add(asked)? > self.max_bytes {
            return None;
        }
        let permit = self.budget.try_take(asked)?;
        self.totals.bytes.fetch_add(asked, Relaxed);
        Some(Charge {
            permit,
            totals: self.totals.clone(),
        })
    }

    /// Frees unpinned entries until `asked` bytes fit or none is left. Whether there is hope: some
    /// were freed, or there was room when we looked.
    fn evict(&self, home: usize, asked: u64, sweep: Sweep) -> bool {
        let mut freed = 0;
        for step in 0..self.shards.len() {
            let shard = &self.shards[(home + step) % self.shards.len()];
            let pages = shard.lock().pages.len();
            let steps = match sweep {
                Sweep::Hand => 2 * pages, // the first turn may only clear the bits
                Sweep::All => pages,
            };
            for first in (0..steps).step_by(SCAN_STEPS) {
                let wanted = self.missing(asked);
                if wanted == 0 {
                    return true;
                }
                let batch = first..steps.min(first + SCAN_STEPS);
                freed += self.evict_batch(shard, batch, sweep, wanted);
            }
        }
        freed > 0
    }

    fn evict_batch(
        &self,
        shard: &Shard<K, V>,
        batch: Range<usize>,
        sweep: Sweep,
        wanted: u64,
    ) -> u64 {
        let (victims, bytes) = {
            let mut ring = shard.lock();
            let (victims, bytes) = ring.take_idle(batch, sweep, wanted);
            // Before the lock is released: nobody may find the ring empty and no room on its way.
            self.totals.leaving.fetch_add(bytes, Relaxed);
            (victims, bytes)
        };
        drop(victims);
        self.totals.leaving.fetch_sub(bytes, Release);
        bytes
    }

    /// Bytes that must be freed before `asked` fit in both limits.
    fn missing(&self, asked: u64) -> u64 {
        let bytes = self.totals.bytes.load(Relaxed);
        let here = bytes.saturating_add(asked).saturating_sub(self.max_bytes);
        here.max(asked.saturating_sub(self.budget.free_bytes()))
    }

    fn refusal(&self, asked: u64) -> Error {
        Error::new(
            ErrorKind::BudgetExceeded,
            format!(
                "the cache was asked for {}; {} of its {} are pinned, and {} of the budget of {} are in use: give more with --mem",
                human_bytes(asked),
                human_bytes(self.stats().pinned_bytes),
                human_bytes(self.max_bytes),
                human_bytes(self.budget.used_bytes()),
                human_bytes(self.budget.memory_bytes()),
            ),
        )
    }

    #[inline]
    pub(super) fn home(&self, key: &K) -> usize {
        if self.shards.len() == 1 {
            return 0;
        }
        // The table inside the shard uses the lowest and the topmost bits.
        let hash = BuildHasherDefault::<FoldHasher>::default().hash_one(key);
        (hash >> 24) as u32 as usize % self.shards.len()
    }
}

impl<K, V> Shard<K, V> {
    #[inline]
    pub(super) fn lock(&self) -> MutexGuard<'_, Ring<K, V>> {
        lock(&self.0)
    }
}

/// Nothing that can panic in the middle of a change runs under our locks, so poison means nothing.
#[inline]
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<K, V> Default for Ring<K, V> {
    fn default() -> Self {
        Self {
            slots: HashMap::default(),
            pages: Vec::new(),
            free: Vec::new(),
            hand: 0,
            hits: 0,
            misses: 0,
            waits: 0,
            evictions: 0,
        }
    }
}

impl<K: Copy + Eq + Hash, V> Ring<K, V> {
    #[inline]
    fn hit(&mut self, at: u32) -> Ref<V> {
        self.hits += 1;
        let page = self.pages[at as usize].as_mut().expect("slots name pages");
        page.used = true;
        Ref(page.entry.clone())
    }

    fn insert(&mut self, key: K, entry: Arc<Entry<V>>) {
        let page = Some(Page {
            key,
            entry,
            used: false,
        });
        let at = match self.free.pop() {
            Some(at) => {
                self.pages[at as usize] = page;
                at
            }
            None => {
                self.pages.push(page);
                u32::try_from(self.pages.len() - 1).expect("2^32 entries take 512 GiB of overhead")
            }
        };
        self.slots.insert(key, Slot::Ready(at));
    }

    fn remove(&mut self, at: u32) -> Arc<Entry<V>> {
        let page = self.pages[at as usize].take().expect("slots name pages");
        self.slots.remove(&page.key);
        self.free.push(at);
        page.entry
    }

    /// Takes out unpinned pages worth `wanted` bytes, looking at no more positions than `batch`.
    fn take_idle(
        &mut self,
        batch: Range<usize>,
        sweep: Sweep,
        wanted: u64,
    ) -> (Vec<Arc<Entry<V>>>, u64) {
        let mut victims = Vec::new();
        let mut bytes = 0;
        for position in batch {
            if bytes >= wanted {
                break;
            }
            let at = match sweep {
                Sweep::Hand => self.hand % self.pages.len(),
                Sweep::All => position,
            };
            self.hand = at + 1;
            match &mut self.pages[at] {
                // A pinned page keeps its bit: it is in use right now.
                Some(page) if !page.is_pinned() => {
                    if std::mem::take(&mut page.used) && sweep == Sweep::Hand {
                        continue;
                    }
                    bytes += page.bytes();
                    self.evictions += 1;
                    victims.push(self.remove(at as u32));
                }
                _ => {}
            }
        }
        (victims, bytes)
    }
}

impl<K, V> Page<K, V> {
    /// New references are made under the shard's lock or from existing ones, so that under the
    /// lock a count of one means that nobody has it and nobody can get it.
    fn is_pinned(&self) -> bool {
        Arc::strong_count(&self.entry) > 1
    }

    fn bytes(&self) -> u64 {
        self.entry.charge.permit.bytes()
    }
}

impl Drop for Charge {
    fn drop(&mut self) {
        self.totals.bytes.fetch_sub(self.permit.bytes(), Relaxed);
    }
}

impl<V> Flight<V> {
    fn new() -> Self {
        Self {
            loader: current().id(),
            outcome: Mutex::new(Outcome::Pending),
            changed: Condvar::new(),
        }
    }

    /// What the loader got; `None` when it panicked and the caller should try itself.
    fn wait(&self) -> Option<Result<Ref<V>>> {
        assert!(
            self.loader != current().id(),
            "a loader asked the cache for the key that it is loading"
        );
        let mut outcome = lock(&self.outcome);
        loop {
            match &*outcome {
                Outcome::Pending => {}
                Outcome::Loaded(entry) => return Some(Ok(Ref(entry.clone()))),
                Outcome::Failed(kind, message) => {
                    return Some(Err(Error::new(*kind, message.clone())));
                }
                Outcome::Abandoned => return None,
            }
            outcome = self
                .changed
                .wait(outcome)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }
}

struct LoadGuard<'a, K: Copy + Eq + Hash, V> {
    shard: &'a Shard<K, V>,
    key: K,
    flight: &'a Flight<V>,
    outcome: Outcome<V>,
}

impl<K: Copy + Eq + Hash, V> Drop for LoadGuard<'_, K, V> {
    fn drop(&mut self) {
        let mut ring = self.shard.lock();
        match &self.outcome {
            Outcome::Loaded(entry) => ring.insert(self.key, entry.clone()),
            _ => drop(ring.slots.remove(&self.key)),
        }
        drop(ring);
        *lock(&self.flight.outcome) = std::mem::replace(&mut self.outcome, Outcome::Pending);
        self.flight.changed.notify_all();
    }
}

/// Folded multiplication of 64-bit words: a few cycles for keys of one or two integers. Not keyed,
/// so that the same requests give the same evictions in every run.
#[derive(Clone, Copy, Default)]
pub(super) struct FoldHasher(u64);

impl FoldHasher {
    #[inline]
    fn fold(&mut self, word: u64) {
        // Fractions of pi and of the golden ratio: odd, without pattern.
        let a = u128::from((self.0 ^ word) ^ 0x243f_6a88_85a3_08d3);
        let product = a * 0x9e37_79b9_7f4a_7c15;
        self.0 = (product as u64) ^ ((product >> 64) as u64);
    }
}

impl Hasher for FoldHasher {
    fn write(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.fold(u64::from_le_bytes(word));
        }
        self.fold(bytes.len() as u64);
    }

    #[inline]
    fn write_u8(&mut self, v: u8) {
        self.fold(u64::from(v));
    }

    #[inline]
    fn write_u32(&mut self, v: u32) {
        self.fold(u64::from(v));
    }

    #[inline]
    fn write_u64(&mut self, v: u64) {
        self.fold(v);
    }

    #[inline]
    fn write_usize(&mut self, v: usize) {
        self.fold(v as u64);
    }

    #[inline]
    fn finish(&self) -> u64 {
        // A second turn spreads the low bits of small keys to the top.
        let mut last = *self;
        last.fold(0x1319_8a2e_0370_7344);
        last.0
    }
}
