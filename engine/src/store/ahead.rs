//! Reads ahead where records are read in the order in which they stand in the file.

use super::storage::Storage;
use std::io;

/// Most bytes that are read at one time.
pub(crate) const AHEAD_BYTES: usize = 128 << 10;
/// Bytes that may be skipped between two records that count as following each other.
const GAP_BYTES: u64 = 4 << 10;

/// What one thread has read beyond what it was asked for. Each time the guess was right twice as much
/// is read as before, so that what was read in vain is never more than what was needed.
#[derive(Default)]
pub(crate) struct Ahead {
    bytes: Vec<u8>,
    /// Offset of `bytes` in the file.
    start: u64,
    /// End of the record read last.
    next: u64,
    /// Bytes of records in a row.
    run: u64,
}

impl Ahead {
    /// Fills `buffer` from `offset`; reads nothing at or beyond `limit` ahead.
    pub(crate) fn read(
        &mut self,
        storage: &dyn Storage,
        buffer: &mut [u8],
        offset: u64,
        limit: u64,
    ) -> io::Result<()> {
        let length = buffer.len() as u64;
        let follows = offset >= self.next && offset - self.next <= GAP_BYTES;
        self.run = if follows { self.run + length } else { 0 };
        self.next = offset + length;
        if let Some(at) = offset.checked_sub(self.start)
            && at + length <= self.bytes.len() as u64
        {
            buffer.copy_from_slice(&self.bytes[at as usize..][..buffer.len()]);
            return Ok(());
        }
        let wanted = (2 * self.run)
            .min(AHEAD_BYTES as u64)
            .min(limit.saturating_sub(offset));
        if wanted <= length {
            return storage.read_at(buffer, offset);
        }
        self.bytes
            .reserve_exact(AHEAD_BYTES - self.bytes.len().min(AHEAD_BYTES));
        self.bytes.resize(wanted as usize, 0);
        self.start = offset;
        if storage.read_at(&mut self.bytes, offset).is_err() {
            // What lies ahead is no concern of this record.
            self.bytes.clear();
            return storage.read_at(buffer, offset);
        }
        buffer.copy_from_slice(&self.bytes[..buffer.len()]);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::storage::MemoryStorage;
    use super::*;
    use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

    /// Counts calls and bytes, and notes the farthest end of a read.
    #[derive(Default)]
    struct Counted(MemoryStorage, AtomicU64, AtomicU64, AtomicU64);

    impl Storage for Counted {
        fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
            self.1.fetch_add(1, Relaxed);
            self.2.fetch_add(buffer.len() as u64, Relaxed);
            self.3.fetch_max(offset + buffer.len() as u64, Relaxed);
            self.0.read_at(buffer, offset)
        }

        fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<()> {
            self.0.write_at(bytes, offset)
        }

        fn len(&self) -> io::Result<u64> {
            self.0.len()
        }

        fn set_len(&self, length: u64) -> io::Result<()> {
            self.0.set_len(length)
        }

        fn sync(&self) -> io::Result<()> {
            self.0.sync()
        }

        fn lock(&self) -> io::Result<bool> {
            self.0.lock()
        }
    }

    fn storage(length: usize) -> (Counted, Vec<u8>) {
        let bytes: Vec<u8> = (0..length).map(|i| (i * 31 / 7) as u8).collect();
        let storage = Counted::default();
        storage.write_at(&bytes, 0).expect("written");
        (storage, bytes)
    }

    #[test]
    fn every_order_gives_the_bytes_of_the_file() {
        let (storage, bytes) = storage(3 << 20);
        let mut ahead = Ahead::default();
        let (mut at, mut seed) = (0usize, 7usize);
        let mut asked = 0;
        for step in 0..4000 {
            seed = seed
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            let length = 1 + (seed >> 40) % 6000;
            // Runs of some records, then a jump.
            if step % (1 + (seed >> 50) % 30) == 0 || at + length > bytes.len() {
                at = (seed >> 20) % (bytes.len() - 6000);
            }
            let mut buffer = vec![0; length];
            ahead
                .read(&storage, &mut buffer, at as u64, bytes.len() as u64)
                .expect("read");
            assert!(buffer == bytes[at..at + length], "step {step}");
            at += length + (seed >> 33) % 100;
            asked += length as u64;
        }
        assert!(storage.2.load(Relaxed) <= 3 * asked);
    }

    #[test]
    fn records_in_order_take_few_calls_and_nothing_behind_the_limit() {
        let (storage, _) = storage(2 << 20);
        let mut ahead = Ahead::default();
        let limit = (2 << 20) - 10_000;
        for at in (0..limit - 4000).step_by(4000) {
            ahead
                .read(&storage, &mut [0; 4000], at, limit)
                .expect("read");
        }
        assert!(storage.1.load(Relaxed) < 40, "{:?}", storage.1);
        assert!(storage.3.load(Relaxed) <= limit);
        assert!(ahead.bytes.capacity() <= AHEAD_BYTES);
    }
}
