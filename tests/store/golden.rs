//! Files that were written once and must read for ever: `tests/golden`. They are never written anew;
//! a change of the format adds files of its own (`v2_...`).

use super::image::{self, kind, put};
use super::{View, changed, open, read_all, small, views};
use crate::support::data::workspace;
use crate::support::report::figure;
use brickmarch::store::{MemoryStorage, Storage, verify_in};
use brickmarch::{Budget, ErrorKind};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::Arc;

/// The folder of the files and of their table.
pub(crate) fn folder() -> PathBuf {
    workspace().join("tests/golden")
}

/// FNV-1a, 64 bits.
fn hash(bytes: &[u8]) -> String {
    let hash = bytes.iter().fold(0xcbf2_9ce4_8422_2325u64, |h, b| {
        (h ^ u64::from(*b)).wrapping_mul(0x0000_0100_0000_01b3)
    });
    format!("{hash:016x}")
}

/// Hash of the file, hash of the samples, and what the volume is. The names are those of
/// [`View::key`].
#[derive(Debug, PartialEq, Eq)]
struct Row {
    file: String,
    samples: String,
    about: String,
}

fn table() -> BTreeMap<String, Row> {
    let text = std::fs::read_to_string(folder().join("contents.txt")).unwrap_or_default();
    let row = |line: &str| {
        let mut words = line.splitn(4, ' ').map(str::to_string);
        let mut next = || words.next().expect("four columns");
        let name = next();
        let row = Row {
            file: next(),
            samples: next(),
            about: next(),
        };
        (name, row)
    };
    text.lines().map(row).collect()
}

/// Names and bytes of all golden volumes.
pub(crate) fn files() -> Vec<(String, Vec<u8>)> {
    let names = table().into_keys().filter(|key| !key.contains('/'));
    names
        .map(|name| {
            let path = folder().join(&name);
            let bytes = std::fs::read(&path);
            let bytes = bytes.unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            (name, bytes)
        })
        .collect()
}

fn about(volume: &brickmarch::store::Volume) -> String {
    let spec = volume.spec();
    let info = volume.info().expect("an open volume has info");
    format!(
        "{} {} edge {} domain {} background {} {} name {:?} history {:?} {} bricks {} tiles {} pages",
        spec.sample.name(),
        spec.kind.name(),
        spec.brick_edge,
        spec.grid.domain,
        spec.background,
        spec.grid.units.name(),
        spec.name,
        spec.history,
        info.bricks_stored,
        info.tiles,
        info.pages,
    )
}

/// What the table says of each volume and level of a file.
fn rows(name: &str, bytes: &[u8], budget: &Budget) -> Vec<(String, Row)> {
    let file = hash(bytes);
    let storage: Arc<dyn Storage> = Arc::new(MemoryStorage::new(bytes.to_vec()));
    let views = views(bytes, budget).unwrap_or_else(|e| panic!("{name}: {e}"));
    let row = |view: &View| {
        let key = view.key(name, &views[0].volume);
        let volume = view.open(&storage, budget);
        let volume = volume.unwrap_or_else(|e| panic!("{key}: {e}"));
        let samples = read_all(&volume).unwrap_or_else(|e| panic!("{key}: {e}"));
        let row = Row {
            file: file.clone(),
            samples: hash(&samples),
            about: about(&volume),
        };
        (key, row)
    };
    views.iter().map(row).collect()
}

#[test]
fn golden_files_read_as_they_were_written() {
    let budget = Budget::mib(24);
    let mut table = table();
    assert!(table.len() >= 20, "{} golden volumes", table.len());
    let mut bytes_all = 0;
    for (name, bytes) in files() {
        assert_eq!(
            hash(&bytes),
            table[&name].file,
            "{name} was written anew: golden files stay as they are, a new format gets new ones"
        );
        bytes_all += bytes.len();
        for (key, now) in rows(&name, &bytes, &budget) {
            let then = table.remove(&key);
            assert_eq!(Some(now), then, "{key}");
        }
        let storage = Arc::new(MemoryStorage::new(bytes));
        let report = verify_in(storage, name.as_ref(), &budget).expect("readable");
        assert!(report.is_intact(), "{name}: {report:?}");
    }
    assert!(table.is_empty(), "not there: {:?}", table.keys());
    assert!(bytes_all < 800 << 10, "{bytes_all} bytes of golden files");
}

#[test]
fn golden_files_have_every_codec_type_and_kind() {
    let (mut codecs, mut words) = (BTreeSet::new(), BTreeSet::new());
    let mut levels = BTreeSet::new();
    for (_, bytes) in files() {
        codecs.extend(image::of_kind(&bytes, kind::BRICK).iter().map(|r| r.codec));
        levels.extend(image::of_kind(&bytes, kind::PAGE).iter().map(|r| r.level));
    }
    for row in table().values() {
        words.extend(row.about.split(' ').take(4).map(str::to_string));
    }
    assert_eq!(codecs, BTreeSet::from([0, 1, 2, 3, 4, 5, 6, 7, 8, 9]));
    assert_eq!(levels, BTreeSet::from([1, 2]));
    for mark in ["/distances", "@1", "@2"] {
        assert!(table().keys().any(|key| key.contains(mark)), "no {mark}");
    }
    for sample in brickmarch::SampleType::ALL {
        assert!(words.contains(sample.name()), "no golden {}", sample.name());
    }
    for kind in brickmarch::Kind::ALL {
        assert!(words.contains(kind.name()), "no golden {}", kind.name());
    }
    for edge in ["8", "16", "32", "64"] {
        assert!(words.contains(edge), "no golden file with edge {edge}");
    }
}

/// What the current writer makes of the same samples reads the same, whatever its bytes.
#[test]
fn the_current_writer_keeps_the_golden_samples() {
    let table = table();
    let budget = Budget::mib(24);
    for small in small::all() {
        let volume = open(small.file(), &budget).expect("its own file");
        let samples = read_all(&volume).expect("its own file");
        assert!(samples == small.raw, "{}", small.name);
        let row = &table[&format!("v1_{}.bvol", small.name)];
        assert_eq!(hash(&samples), row.samples, "{}", small.name);
    }
}

/// The same for files with several commits, volumes and levels.
#[test]
fn the_current_writer_keeps_the_golden_samples_of_changed_files() {
    let table = table();
    let budget = Budget::mib(24);
    for (name, bytes) in changed::all() {
        for (key, now) in rows(&format!("v1_{name}.bvol"), &bytes, &budget) {
            assert_eq!(table[&key].samples, now.samples, "{key}");
        }
    }
}

/// Adds files that are missing, after a new one was described in `small` or `changed`. Never replaces
/// one.
#[test]
#[ignore = "writes to tests/golden: run by hand when a golden file is added"]
fn add_missing_golden_files() {
    let mut table = table();
    let budget = Budget::mib(24);
    let small = small::all().into_iter().map(|s| (s.name, s.file()));
    for (name, bytes) in small.chain(changed::all()) {
        let name = format!("v1_{name}.bvol");
        let path = folder().join(&name);
        if table.contains_key(&name) || path.exists() {
            continue;
        }
        let rows = rows(&name, &bytes, &budget);
        std::fs::write(&path, &bytes).expect("the folder is writable");
        figure(&format!(
            "{name}: {} bytes, {} volumes and levels",
            bytes.len(),
            rows.len()
        ));
        table.extend(rows);
    }
    let mut text = String::new();
    for (name, row) in &table {
        writeln!(text, "{name} {} {} {}", row.file, row.samples, row.about).expect("memory");
    }
    std::fs::write(folder().join("contents.txt"), text).expect("the folder is writable");
}

/// A header with another word at `at`.
fn with_header(at: usize, value: u64) -> Vec<u8> {
    let (_, mut bytes) = files().swap_remove(0);
    put(&mut bytes, at, value.to_le_bytes());
    image::reseal(&mut bytes);
    bytes
}

#[test]
fn files_from_the_future_are_refused_by_the_name_of_the_feature() {
    let budget = Budget::mib(24);
    for (bit, name) in [
        (0, "zstd bricks"),
        (1, "chunks of several bricks"),
        (2, "more than one channel"),
        (6, "feature bit 6"),
        (63, "feature bit 63"),
    ] {
        let error = open(with_header(16, 1 << bit), &budget)
            .err()
            .expect("refused");
        assert_eq!(error.kind(), ErrorKind::Newer, "{error}");
        assert!(error.to_string().contains(name), "{error}");
    }
    // Major 2, minor 0, length as it is.
    let error = open(with_header(8, 4096 << 32 | 2), &budget)
        .err()
        .expect("refused");
    assert_eq!(error.kind(), ErrorKind::Newer, "{error}");
    assert!(error.to_string().contains("version 2"), "{error}");
    // What may be ignored is: a later minor version, features of writers, harmless features.
    for (at, value) in [
        (8, 4096 << 32 | 9 << 16 | 1),
        (24, u64::MAX),
        (32, u64::MAX),
    ] {
        let volume = open(with_header(at, value), &budget).expect("may be read");
        read_all(&volume).expect("may be read");
    }
}
