//! The commands, one file each.

pub(crate) mod check;
pub(crate) mod demo;
pub(crate) mod export;
pub(crate) mod import;
pub(crate) mod info;
pub(crate) mod manual;
pub(crate) mod mesh;
pub(crate) mod slice;
pub(crate) mod verify;

mod region;
