//! The file format from outside: damage of every byte, hostile files, files of every
//! version, and an independent reader.

mod damage;
mod golden;
mod handmade;
mod hostile;
mod image;
mod reader;
mod small;

use brickmarch::store::{MemoryStorage, Volume};
use brickmarch::{Budget, Result};
use std::path::Path;
use std::sync::Arc;

/// A volume in memory.
fn open(bytes: Vec<u8>, budget: &Budget) -> Result<Volume> {
    Volume::open_in(
        Arc::new(MemoryStorage::new(bytes)),
        Path::new("small.bvol"),
        budget,
    )
}

/// All samples of a volume.
fn read_all(volume: &Volume) -> Result<Vec<u8>> {
    super::volume::read_all(volume, volume.spec().grid.domain)
}
