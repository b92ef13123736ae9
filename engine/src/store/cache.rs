//! The page cache: [`PageCache`] in `pages`, apart from where its locks come from, so that tests can
//! run it with locks under their control.

mod pages;
#[cfg(test)]
mod schedules;
mod sync;
#[cfg(test)]
mod tests;

pub use pages::{CacheStats, ENTRY_OVERHEAD_BYTES, PageCache, Ref};
