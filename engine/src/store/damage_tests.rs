//! Damaged, cut and hostile files: an error or the true samples, never wrong ones, never a panic.

use super::layout::*;
use super::record::{Superblock, seed_of};
use super::tests::{Dense, mixed, open, spec};
use super::*;
use crate::{Box3, Budget, ErrorKind, SampleType};
use std::path::Path;
use std::sync::Arc;

fn file(sample: SampleType) -> (Dense, Vec<u8>) {
    let dense = Dense::new(spec([27, 25, 23], sample, 8), mixed);
    let (storage, _) = dense.write(&Budget::mib(24));
    let bytes = storage.to_vec();
    (dense, bytes)
}

fn root(bytes: &[u8]) -> Superblock {
    let id = bytes[HEADER_FILE_ID..][..FILE_ID_BYTES]
        .try_into()
        .expect("16 bytes");
    Superblock::parse(&bytes[4096..8192], seed_of(&id), 4096).expect("finished file")
}

fn read_all(dense: &Dense, bytes: Vec<u8>) -> crate::Result<bool> {
    let budget = Budget::mib(24).with_threads(1);
    let domain = dense.spec.grid.domain;
    let volume = open(Arc::new(MemoryStorage::new(bytes)), &budget)?;
    let mut out = vec![0; dense.raw.len()];
    volume.read_raw(domain, &mut out)?;
    Ok(out == dense.raw && volume.spec() == &dense.spec)
}

fn verify_bytes(bytes: Vec<u8>) -> crate::Result<Report> {
    verify_in(
        Arc::new(MemoryStorage::new(bytes)),
        Path::new("test"),
        &Budget::mib(24),
    )
}

#[test]
fn file_every_byte_damaged() {
    let (dense, bytes) = file(SampleType::U8);
    assert!(read_all(&dense, bytes.clone()).expect("whole"));
    // Everything between header copy and footer is needed to read all samples.
    let needed = (LOG_START + record_bytes(SECTOR as u32)) as usize..root(&bytes).footer as usize;
    assert!(needed.len() > 5000);
    for at in 0..bytes.len() {
        let mut bad = bytes.clone();
        bad[at] ^= 1 << (at % 8);
        match read_all(&dense, bad.clone()) {
            Ok(same) => {
                assert!(same, "wrong samples after damage at {at}");
                assert!(!needed.contains(&at), "damage at {at} was not noticed");
            }
            Err(_) => assert!(needed.contains(&at), "damage at {at} was in the way"),
        }
        // Each verify reads everything: a sample of places, more of them where records are.
        if at % 61 == 0 {
            let report = verify_bytes(bad).expect("damage is no error");
            assert!(!report.is_intact(), "verify did not see damage at {at}");
        }
    }
}

#[test]
fn file_every_truncation() {
    let (dense, bytes) = file(SampleType::I16);
    for end in
        (0..bytes.len())
            .step_by(37)
            .chain([7, 8, 4095, 4096, 12_287, 12_288, bytes.len() - 1])
    {
        let error = read_all(&dense, bytes[..end].to_vec()).expect_err("cut");
        let kinds = [
            ErrorKind::Truncated,
            ErrorKind::DamagedRoot,
            ErrorKind::NotAVolume,
        ];
        assert!(kinds.contains(&error.kind()), "{end}: {error}");
        assert!(
            end < 8 || error.kind() != ErrorKind::NotAVolume,
            "{end}: {error}"
        );
    }
}

#[test]
fn file_extra_bytes_are_an_unfinished_commit() {
    let (dense, mut bytes) = file(SampleType::F32);
    bytes.extend([0xaa; 5000]);
    assert!(read_all(&dense, bytes.clone()).expect("opens"));
    let report = verify_bytes(bytes).expect("verifies");
    assert!(report.is_intact() && report.notes.len() == 1, "{report:?}");
}

#[test]
fn lost_superblocks_and_header_are_rebuilt_from_the_log() {
    let (dense, bytes) = file(SampleType::F32);
    for places in [&[0usize][..], &[4096], &[8192], &[0, 4096, 8192]] {
        let mut bad = bytes.clone();
        for &at in places {
            bad[at..at + SECTOR].fill(0);
        }
        assert!(
            read_all(&dense, bad.clone()).expect("rolls forward"),
            "{places:?}"
        );
        let report = verify_bytes(bad).expect("verifies");
        assert_eq!(report.problems.len(), places.len(), "{report:?}");
        assert!(report.problems.iter().all(|p| p.lost.is_none()));
    }
    // The newest superblock lost and the commit not whole: an error, not generation 0.
    let mut bad = bytes.clone();
    bad[4096..8192].fill(0);
    bad[LOG_START as usize + 6000] ^= 1;
    assert_eq!(
        read_all(&dense, bad).expect_err("damaged").kind(),
        ErrorKind::DamagedRoot
    );
}

#[test]
fn a_damaged_catalog_is_a_damaged_root() {
    let (dense, bytes) = file(SampleType::U8);
    let root = root(&bytes);
    let mut bad = bytes.clone();
    bad[root.catalog.offset as usize + RECORD_HEADER] ^= 1;
    assert_eq!(
        read_all(&dense, bad).expect_err("damaged").kind(),
        ErrorKind::DamagedRoot
    );
}

#[test]
fn a_foreign_record_in_place_is_refused() {
    let (dense, bytes) = file(SampleType::U8);
    let mut other_spec = dense.spec.clone();
    other_spec.name = "other volume".into();
    let other = Dense {
        spec: other_spec,
        raw: dense.raw.clone(),
    };
    let (storage, _) = other.write(&Budget::mib(24));
    let foreign = storage.to_vec();
    assert_ne!(foreign.len(), 0);
    // Same layout, another file id: every stale sector must be noticed.
    for at in (0..bytes.len() - 512).step_by(512) {
        let mut bad = bytes.clone();
        bad[at..at + 512].copy_from_slice(&foreign[at..at + 512]);
        if let Ok(same) = read_all(&dense, bad) {
            assert!(same, "stale sector at {at}");
        }
    }
}

#[test]
fn verify_says_what_is_lost() {
    let (_, bytes) = file(SampleType::F32);
    let root = root(&bytes);
    let report = verify_bytes(bytes.clone()).expect("verifies");
    assert!(
        report.is_intact() && report.bytes >= bytes.len() as u64,
        "{report:?}"
    );
    let info = report.info.expect("has a root");
    assert_eq!(
        (report.bricks, report.pages),
        (info.bricks_stored, info.pages)
    );
    // The first brick record follows the header copy.
    let first = (LOG_START + record_bytes(SECTOR as u32)) as usize;
    let mut bad = bytes.clone();
    bad[first + RECORD_HEADER + 3] ^= 0x10;
    let report = verify_bytes(bad).expect("verifies");
    let lost: Vec<Box3> = report.problems.iter().filter_map(|p| p.lost).collect();
    assert!(lost.len() == 1 && lost[0].count() == 512, "{report:?}");
    assert!(
        report
            .problems
            .iter()
            .any(|p| p.message.contains(&first.to_string()))
    );
    assert!(root.index[0] > 0 && root.index[1] > 0);
    // Both pages of the index: all of the domain.
    let mut bad = bytes.clone();
    bad[root.index[0] as usize + RECORD_HEADER] ^= 1;
    let report = verify_bytes(bad).expect("verifies");
    assert!(
        report.problems[0].message.contains("root") || report.problems[0].lost.is_some(),
        "{report:?}"
    );
}
