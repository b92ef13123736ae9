//! Behaviour tests; one module per subject, every one against an oracle or a law.
//!
//! Tests that need minutes in an unoptimised build are ignored there and say so; `tests/run` runs
//! the whole package in release mode.

mod architecture;
mod bounds;
mod cli;
mod extraction;
mod reference;
mod store;
mod support;
mod topology;
mod volume;
