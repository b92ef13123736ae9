//! Locks and threads of the cache: those of the standard library. `schedules` compiles the cache once
//! more with replacements that run every order of steps.

pub(super) use std::sync::atomic::AtomicU64;
pub(super) use std::sync::{Arc, Condvar, Mutex, MutexGuard};
pub(super) use std::thread::{ThreadId, current, yield_now};
