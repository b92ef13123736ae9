//! What the tests stand on: the program under test, scratch space, oracles, a fixed generator.

#![allow(dead_code, reason = "each helper is used by some of the modules only")]

pub(crate) mod crossing;
pub(crate) mod data;
pub(crate) mod fields;
pub(crate) mod naive;
pub(crate) mod program;
pub(crate) mod python;
pub(crate) mod report;
pub(crate) mod rng;
pub(crate) mod scratch;
pub(crate) mod topology;
pub(crate) mod tunnel;
pub(crate) mod whole;
