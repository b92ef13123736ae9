//! The volume store.

pub mod cache;
