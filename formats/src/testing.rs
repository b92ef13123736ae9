//! What the tests of every parser share.

use crate::volume::{OpenOptions, Source, open_volume};
use brickmarch::Result;
use std::io::{Read, Write};
use std::path::PathBuf;

/// Opens `bytes` as a file of that name. The file may be gone when the source is read.
pub(crate) fn open_bytes(name: &str, bytes: &[u8]) -> Result<Source> {
    open_with(name, bytes, &OpenOptions::default())
}

pub(crate) fn open_with(name: &str, bytes: &[u8], options: &OpenOptions) -> Result<Source> {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("writes");
    open_volume(&path, options)
}

/// Everything that the reader gives.
pub(crate) fn samples(source: &mut Source) -> std::io::Result<Vec<u8>> {
    let mut out = Vec::new();
    source.reader.read_to_end(&mut out)?;
    assert_eq!(
        out.len() as u64,
        source.grid.domain.count() * source.sample.bytes() as u64
    );
    Ok(out)
}

pub(crate) fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).expect("memory");
    encoder.finish().expect("memory")
}

/// A good small file: every truncation is an error; no flipped byte makes a panic, or more samples
/// than the file can hold.
pub(crate) fn family(name: &str, good: &[u8]) {
    samples(&mut open_bytes(name, good).expect("opens")).expect("reads");
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join(name);
    for n in 0..good.len() {
        std::fs::write(&path, &good[..n]).expect("writes");
        let opened = open_volume(&path, &OpenOptions::default());
        let passed = opened.is_ok_and(|mut source| samples(&mut source).is_ok());
        assert!(!passed, "{name}: the first {n} bytes pass");
    }
    for n in 0..good.len() {
        for mask in [0x01, 0x80, 0xff] {
            let mut bytes = good.to_vec();
            bytes[n] ^= mask;
            std::fs::write(&path, &bytes).expect("writes");
            if let Ok(mut source) = open_volume(&path, &OpenOptions::default()) {
                let mut out = Vec::new();
                // Bounded by the file: a stream that goes on would show here.
                let limit = 64 + 2048 * bytes.len() as u64;
                let read = source.reader.by_ref().take(limit).read_to_end(&mut out);
                assert!((out.len() as u64) < limit, "byte {n} ^ {mask}: endless");
                drop(read);
            }
        }
    }
}

/// The volumes of the shared data set: in `BRICKMARCH_DATA`, or in `../shared/data` beside the
/// workspace. Says so where there are none.
pub(crate) fn shared_volumes() -> Option<PathBuf> {
    let workspace = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..");
    let data = std::env::var_os("BRICKMARCH_DATA")
        .map(PathBuf::from)
        .unwrap_or_else(|| workspace.join("../shared/data"));
    let volumes = data.join("volumes");
    if volumes.is_dir() {
        return Some(volumes);
    }
    #[expect(
        clippy::print_stderr,
        reason = "a skipped comparison says that it is skipped"
    )]
    {
        eprintln!(
            "SKIPPED: no real volumes in {} (set BRICKMARCH_DATA)",
            volumes.display()
        );
    }
    None
}
