//! Files that somebody made on purpose: every checksum holds, the content does not. An error or some
//! samples, within the budget; never a panic, a hang or an allocation by an unchecked number.

use super::layout::*;
use super::record::{Superblock, seed_of};
use super::tests::{Dense, mixed, open, spec};
use super::*;
use crate::{Box3, Budget, ErrorKind, Field, SampleType};
use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// A whole file whose records can be changed.
#[derive(Clone)]
struct Forge {
    bytes: Vec<u8>,
    seed: u32,
    /// Places of the records, children before parents.
    records: Vec<Range<usize>>,
}

impl Forge {
    fn new(bytes: Vec<u8>) -> Self {
        let id = bytes[HEADER_FILE_ID..][..FILE_ID_BYTES].try_into();
        let seed = seed_of(&id.expect("16 bytes"));
        let end = Superblock::parse(&bytes[4096..8192], seed, 4096).map(|root| root.footer);
        let end = end.expect("finished file") as usize;
        let (mut records, mut at) = (Vec::new(), LOG_START as usize);
        while at < end {
            let whole = record_bytes(get_u32(&bytes, at + RECORD_PAYLOAD)) as usize;
            records.push(at..at + whole);
            at += whole;
        }
        Self {
            bytes,
            seed,
            records,
        }
    }

    fn of_kind(&self, kind: u8) -> Vec<Range<usize>> {
        let wanted = |r: &&Range<usize>| self.bytes[r.start + RECORD_KIND] == kind;
        self.records.iter().filter(wanted).cloned().collect()
    }

    /// Makes all checksums right again, and the references that carry them.
    fn seal(mut self) -> Vec<u8> {
        let mut changed: Vec<([u8; 12], [u8; 4])> = Vec::new();
        let records = self.records.clone();
        for record in records {
            self.follow(record.clone(), &changed);
            let bytes = &mut self.bytes[record.clone()];
            let old = get_u32(bytes, RECORD_CRC);
            let new = crc32c::crc32c_append(self.seed, &bytes[..RECORD_CRC]);
            let new = crc32c::crc32c_append(new, &bytes[RECORD_HEADER..]);
            put_u32(bytes, RECORD_CRC, new);
            if old != new {
                let mut place = [0; 12];
                put_u64(&mut place, 0, record.start as u64);
                put_u32(&mut place, 8, get_u32(bytes, RECORD_PAYLOAD));
                changed.push((place, new.to_le_bytes()));
            }
        }
        self.follow(SECTOR..2 * SECTOR, &changed);
        let block = &mut self.bytes[SECTOR..2 * SECTOR];
        let crc = crc32c::crc32c_append(self.seed, &block[..SUPER_CRC]);
        put_u32(block, SUPER_CRC, crc);
        self.bytes
    }

    /// New checksums into the references to changed records.
    fn follow(&mut self, part: Range<usize>, changed: &[([u8; 12], [u8; 4])]) {
        for (place, crc) in changed {
            let bytes = &self.bytes[part.clone()];
            let found: Vec<usize> = (0..bytes.len() - REF_BYTES)
                .step_by(4)
                .filter(|&at| bytes[at..].starts_with(place))
                .collect();
            for at in found {
                self.bytes[part.start + at + REF_CRC..][..4].copy_from_slice(crc);
            }
        }
    }
}

const REF_CRC: usize = REF_BYTES - 4;

/// Everything that a reader may be asked, on a corner of the domain.
fn use_all(bytes: &[u8]) -> crate::Result<()> {
    let budget = Budget::mib(24).with_threads(1);
    let storage = Arc::new(MemoryStorage::new(bytes.to_vec()));
    let result = open(storage.clone(), &budget).and_then(|volume| {
        volume.info()?;
        let domain = volume.grid().domain;
        let corner = Box3::new(domain.min, domain.min.map(|v| v.saturating_add(40)));
        let corner = corner.intersect(&domain);
        volume.range(domain)?;
        volume.label(3).range(domain)?;
        let mut raw = vec![0; corner.count() as usize * volume.spec().sample.bytes()];
        volume.read_raw(corner, &mut raw)?;
        volume.forget(corner);
        let mut values = vec![0.0; corner.count() as usize];
        let mut samples = crate::Samples::dense(&mut values, corner);
        volume.label(3).read(corner, &mut samples)?;
        Ok(())
    });
    assert_eq!(budget.used_bytes(), 0, "nothing is kept");
    assert!(budget.peak_bytes() <= budget.memory_bytes());
    // Damage is no error here, whatever it is.
    let verified = verify_in(storage, Path::new("test"), &budget);
    if let Err(error) = verified {
        let kinds = [ErrorKind::Unsupported, ErrorKind::LimitExceeded];
        assert!(kinds.contains(&error.kind()), "verify gave up: {error}");
    }
    result
}

fn file(sample: SampleType) -> Forge {
    let dense = Dense::new(spec([80, 75, 20], sample, 8), mixed);
    let (storage, _) = dense.write(&Budget::mib(24));
    Forge::new(storage.to_vec())
}

#[test]
fn forged_content_under_right_checksums() {
    let cases = if cfg!(debug_assertions) { 400 } else { 4000 };
    for sample in [
        SampleType::Bit,
        SampleType::U8,
        SampleType::I16,
        SampleType::F32,
    ] {
        let good = file(sample);
        use_all(&good.clone().seal()).expect("whole");
        let mut random = 0x9e37_79b9_7f4a_7c15u64 ^ sample as u64;
        let mut next = |below: usize| {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            (random >> 16) as usize % below
        };
        // Page, catalog, attributes, history, brick: few bricks are as good as many.
        let kinds = [3u8, 4, 5, 7, 2].map(|kind| good.of_kind(kind));
        let mut refused = 0;
        for _ in 0..cases {
            let mut bad = good.clone();
            for _ in 0..1 + next(2) {
                let records = &kinds[next(kinds.len())];
                let record = records[next(records.len().min(40))].clone();
                let bytes = &mut bad.bytes[record];
                // Mostly the payload; else codec, flags, decoded length, key or level.
                let at = if next(5) == 0 {
                    [RECORD_CODEC, RECORD_DECODED, RECORD_KEY, RECORD_LEVEL][next(4)]
                } else {
                    let rest = bytes.len() - RECORD_HEADER;
                    // The start is where counts and masks are.
                    let most = if next(2) == 0 { rest.min(96) } else { rest };
                    RECORD_HEADER + next(most)
                };
                let value: u64 = match next(6) {
                    0 => 0,
                    1 => u64::MAX,
                    2 => i64::MAX as u64,
                    3 => 1 << next(64),
                    _ => next(1 << 30) as u64,
                };
                let width = [1, 1, 4, 8][next(4)].min(bytes.len() - at);
                if at >= RECORD_HEADER || width == 1 {
                    bytes[at..at + width].copy_from_slice(&value.to_le_bytes()[..width]);
                } else {
                    bytes[at] = value as u8;
                }
            }
            refused += u32::from(use_all(&bad.seal()).is_err());
        }
        assert!(refused > cases / 10, "{sample:?}: {refused} refused");
    }
}

#[test]
fn a_root_page_of_impossible_length_is_a_damaged_root() {
    let mut bad = file(SampleType::U8);
    let catalog = bad.of_kind(4)[0].clone();
    let root = catalog.start + RECORD_HEADER + CATALOG_HEAD + ENTRY_ROOT;
    put_u32(&mut bad.bytes, root + REF_LENGTH, u32::MAX);
    let error = use_all(&bad.seal()).expect_err("refused");
    assert_eq!(error.kind(), ErrorKind::DamagedRoot, "{error}");
}

/// Counts what is read.
struct Counting(MemoryStorage, AtomicU64);

impl Storage for Counting {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        self.1.fetch_add(buffer.len() as u64, Relaxed);
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

/// A damaged stretch full of record starts that each name 64 KiB: looking for the next whole record
/// must not read all of them.
#[test]
fn verify_does_not_chase_every_false_record() {
    let mut bad = file(SampleType::U8);
    let at = bad.bytes.len();
    let stretch = 512 << 10;
    bad.bytes.resize(at + stretch, 0);
    for record in (at..at + stretch - 16).step_by(16) {
        put_u32(&mut bad.bytes, record + RECORD_MAGIC_AT, RECORD_MAGIC);
        bad.bytes[record + RECORD_KIND] = 2;
        put_u32(&mut bad.bytes, record + RECORD_PAYLOAD, 1 << 16);
    }
    put_u64(
        &mut bad.bytes,
        SECTOR + SUPER_LOG_END,
        (at + stretch) as u64,
    );
    let bytes = bad.seal();
    let length = bytes.len() as u64;
    let storage = Arc::new(Counting(MemoryStorage::new(bytes), AtomicU64::new(0)));
    let report = verify_in(storage.clone(), Path::new("test"), &Budget::mib(24));
    assert!(!report.expect("damage is no error").is_intact());
    let read = storage.1.load(Relaxed);
    assert!(read < 16 * length, "{read} bytes of a file of {length}");
}
