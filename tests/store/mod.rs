//! The file format from outside: damage of every byte, hostile files, files of every
//! version, and an independent reader; and against what a disk may do: crashes, faults, kills.

mod beside;
mod broken;
mod changed;
mod crash;
mod damage;
mod disk;
mod far;
mod faults;
mod fence;
mod golden;
mod handmade;
mod hostile;
mod image;
mod kill;
mod operations;
mod reader;
mod small;
mod states;
mod tale;

use brickmarch::store::{MemoryStorage, Storage, Volume};
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

/// A volume of a file: its name and level of detail.
#[derive(Clone, Debug, PartialEq, Eq)]
struct View {
    volume: String,
    level: u8,
}

impl View {
    /// As it is written in the table of golden files: `file`, `file/volume` or `file/volume@level`.
    fn key(&self, file: &str, first: &str) -> String {
        match (self.level, &*self.volume) {
            (0, volume) if volume == first => file.to_string(),
            (0, volume) => format!("{file}/{volume}"),
            (level, volume) => format!("{file}/{volume}@{level}"),
        }
    }

    /// Opens it beside the first volume of the file.
    fn open(&self, storage: &Arc<dyn Storage>, budget: &Budget) -> Result<Volume> {
        let volume =
            Volume::open_named_in(storage.clone(), "small.bvol".as_ref(), &self.volume, budget)?;
        match self.level {
            0 => Ok(volume),
            level => volume.level(level),
        }
    }
}

/// Every volume of a file with its levels, the first volume first.
fn views(bytes: &[u8], budget: &Budget) -> Result<Vec<View>> {
    let storage: Arc<dyn Storage> = Arc::new(MemoryStorage::new(bytes.to_vec()));
    let mut views = Vec::new();
    let first = Volume::open_in(storage.clone(), "small.bvol".as_ref(), budget)?;
    for volume in first.names() {
        let own = View {
            volume: volume.clone(),
            level: 0,
        };
        let levels = own.open(&storage, budget)?.levels();
        views.push(own);
        views.extend((1..=levels).map(|level| View {
            volume: volume.clone(),
            level,
        }));
    }
    Ok(views)
}
