//! Records of fixed size, put into numbered buckets on disk and taken out bucket by bucket.

use super::scratch::{read_at, write_at};
use crate::error::Result;
use std::fs::File;

/// Most bytes that a bucket gathers before they are written.
const PART_BYTES: usize = 1 << 16;

/// The place of a part that has none before it.
const NONE: u64 = u64::MAX;

/// Buckets of records of `N` bytes in a scratch file. The parts of a bucket form a chain, last one
/// first.
pub(super) struct Buckets<const N: usize> {
    file: File,
    end: u64,
    /// Bytes that a bucket gathers.
    part_bytes: usize,
    buckets: Vec<Bucket>,
}

struct Bucket {
    part: Vec<u8>,
    last: u64,
    records: u64,
}

impl<const N: usize> Buckets<N> {
    /// `count` empty buckets in `file`, gathering at most `memory` bytes where that is possible.
    pub(super) fn new(file: File, count: usize, memory: u64) -> Self {
        let share = memory as usize / count.max(1);
        let bucket = || Bucket {
            part: Vec::new(),
            last: NONE,
            records: 0,
        };
        Self {
            file,
            end: 0,
            part_bytes: share.clamp(8 * N, PART_BYTES) / N * N,
            buckets: std::iter::repeat_with(bucket).take(count).collect(),
        }
    }

    /// Records of a bucket.
    pub(super) fn records(&self, bucket: usize) -> u64 {
        self.buckets[bucket].records
    }

    /// Adds a record.
    pub(super) fn add(&mut self, bucket: usize, record: &[u8; N]) -> Result<()> {
        let it = &mut self.buckets[bucket];
        if it.part.capacity() == 0 {
            it.part.reserve_exact(self.part_bytes);
        }
        it.part.extend_from_slice(record);
        it.records += 1;
        if it.part.len() >= self.part_bytes {
            self.spill(bucket)?;
        }
        Ok(())
    }

    fn spill(&mut self, bucket: usize) -> Result<()> {
        let it = &mut self.buckets[bucket];
        let mut head = [0; 12];
        head[..8].copy_from_slice(&it.last.to_le_bytes());
        head[8..].copy_from_slice(&(it.part.len() as u32).to_le_bytes());
        write_at(&self.file, &head, self.end)?;
        write_at(&self.file, &it.part, self.end + 12)?;
        it.last = self.end;
        self.end += 12 + it.part.len() as u64;
        it.part.clear();
        Ok(())
    }

    /// Empties a bucket, in no particular order.
    pub(super) fn take(&mut self, bucket: usize, mut each: impl FnMut(&[u8; N])) -> Result<()> {
        let it = &mut self.buckets[bucket];
        let mut part = std::mem::take(&mut it.part);
        part.as_chunks::<N>().0.iter().for_each(&mut each);
        let mut at = std::mem::replace(&mut it.last, NONE);
        it.records = 0;
        while at != NONE {
            let mut head = [0; 12];
            read_at(&self.file, &mut head, at)?;
            let length = u32::from_le_bytes(head[8..].try_into().expect("4 bytes")) as usize;
            part.resize(length.min(self.part_bytes), 0);
            read_at(&self.file, &mut part, at + 12)?;
            part.as_chunks::<N>().0.iter().for_each(&mut each);
            at = u64::from_le_bytes(head[..8].try_into().expect("8 bytes"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_comes_out_of_its_bucket_once() {
        for memory in [0, 1000, 1 << 20] {
            let file = tempfile::tempfile().expect("a scratch file");
            let mut buckets = Buckets::<5>::new(file, 7, memory);
            let record = |n: u32| {
                let [a, b, c, d] = n.to_le_bytes();
                [a, b, c, d, n as u8]
            };
            let of = |n: u32| (n.wrapping_mul(2_654_435_761) >> 7) as usize % 6;
            for n in 0..50_000 {
                buckets.add(of(n), &record(n)).expect("written");
            }
            let mut total = 0;
            for bucket in 0..7 {
                let count = buckets.records(bucket);
                let mut found = Vec::new();
                buckets.take(bucket, |r| found.push(*r)).expect("read");
                assert_eq!(found.len() as u64, count);
                total += count;
                found.sort_unstable_by_key(|r| u32::from_le_bytes([r[0], r[1], r[2], r[3]]));
                let want = (0..50_000).filter(|&n| of(n) == bucket).map(record);
                assert!(
                    found.into_iter().eq(want),
                    "bucket {bucket}, {memory} bytes"
                );
            }
            assert_eq!(total, 50_000);
        }
    }
}
