//! A number for each vertex of a mesh, on disk.

use super::scratch::{read_at, write_at};
use crate::error::{Error, Result};
use std::fs::File;
use std::path::Path;

/// Numbers that are read at one time.
const BLOCK: u64 = 1 << 12;

/// An array of 64-bit numbers in a scratch file.
#[derive(Debug)]
pub(super) struct Slots {
    file: File,
}

impl Slots {
    pub(super) fn new(file: File) -> Self {
        Self { file }
    }

    /// Sets the numbers from `first` on.
    pub(super) fn write(&self, first: u64, numbers: &[u64], buffer: &mut Vec<u8>) -> Result<()> {
        buffer.clear();
        buffer.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
        write_at(&self.file, buffer, 8 * first)
    }

    /// Calls `take(index in places, number)` for each of `places`. Places near each other are read
    /// together.
    pub(super) fn read(&self, places: &[u64], mut take: impl FnMut(usize, u64)) -> Result<()> {
        let mut order: Vec<u32> = (0..places.len() as u32).collect();
        order.sort_unstable_by_key(|&i| places[i as usize]);
        let mut buffer = [0; 8 * BLOCK as usize];
        let mut i = 0;
        while i < order.len() {
            let first = places[order[i] as usize];
            let run = order[i..]
                .iter()
                .take_while(|&&n| places[n as usize] - first < BLOCK)
                .count();
            let last = places[order[i + run - 1] as usize];
            let bytes = &mut buffer[..8 * (last - first + 1) as usize];
            read_at(&self.file, bytes, 8 * first)?;
            for &n in &order[i..i + run] {
                let at = (places[n as usize] - first) as usize;
                take(n as usize, u64::from_le_bytes(bytes.as_chunks::<8>().0[at]));
            }
            i += run;
        }
        Ok(())
    }
}

impl Slots {
    /// Makes room for `count` numbers, all 0.
    pub(super) fn clear(&self, count: u64) -> Result<()> {
        let failed = |e| Error::io(Path::new("scratch file"), "making room in it", e);
        self.file.set_len(8 * count).map_err(failed)
    }

    /// Calls `change(index in places, number)` for each of `places`, ascending, and keeps what it
    /// leaves in the number.
    pub(super) fn update(
        &self,
        places: &[u32],
        mut change: impl FnMut(usize, &mut u64),
    ) -> Result<()> {
        let mut buffer = [0; 8 * BLOCK as usize];
        let mut i = 0;
        while i < places.len() {
            let first = u64::from(places[i]);
            let near = |&&v: &&u32| u64::from(v) - first < BLOCK;
            let run = places[i..].iter().take_while(near).count();
            let last = u64::from(places[i + run - 1]);
            let bytes = &mut buffer[..8 * (last - first + 1) as usize];
            read_at(&self.file, bytes, 8 * first)?;
            for n in i..i + run {
                let slot =
                    &mut bytes.as_chunks_mut::<8>().0[(u64::from(places[n]) - first) as usize];
                let mut number = u64::from_le_bytes(*slot);
                change(n, &mut number);
                *slot = number.to_le_bytes();
            }
            write_at(&self.file, bytes, 8 * first)?;
            i += run;
        }
        Ok(())
    }
}
