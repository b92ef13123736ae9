//! The volume store.
