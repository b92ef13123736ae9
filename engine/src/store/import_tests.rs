//! Imports: the same bytes in every way, stopped ones that go on, sources that are wrong.

use super::import::*;
use super::slabs::fill;
use super::source::Source;
use super::storage::{MemoryStorage, Storage};
use super::tests::{Dense, mixed, spec};
use super::{Volume, VolumeSpec, VolumeWriter, verify};
use crate::{Box3, Budget, ErrorKind, Field, Grid, SampleType};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

#[test]
fn same_bytes_for_any_number_of_threads_and_through_the_scratch_file() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let kinds = [
        SampleType::Bit,
        SampleType::U8,
        SampleType::I16,
        SampleType::F32,
    ];
    for (sample, edge) in kinds
        .map(|s| (s, 32))
        .into_iter()
        .chain([(SampleType::U16, 8)])
    {
        let dense = Dense::new(spec([70, 600, 40], sample, edge), mixed);
        let import = |threads: usize, bytes: u64| {
            let out = folder.path().join("v.bvol");
            let budget = Budget::bytes(bytes).with_threads(threads);
            let info =
                import_stream(&mut &dense.raw[..], &dense.spec, &out, &budget).expect("imports");
            assert_eq!(budget.used_bytes(), 0);
            assert_eq!(std::fs::read_dir(folder.path()).expect("lists").count(), 1);
            (info, std::fs::read(&out).expect("is there"))
        };
        let one = import(1, 64 << 20);
        // Two slabs of 1.3 MiB per byte of sample do not fit the last: it goes through the file.
        let small = (1300 << 10) + sample.bytes() as u64 * (2500 << 10);
        for (threads, bytes) in [(8, 64 << 20), (2, small)] {
            assert!(
                import(threads, bytes) == one,
                "{sample:?} {edge} {threads} {bytes}"
            );
        }
        let out = folder.path().join("v.bvol");
        let budget = Budget::mib(24);
        let volume = Volume::open(&out, &budget).expect("opens");
        dense.check(&volume, dense.spec.grid.domain);
        let report = verify(&out, &budget).expect("verifies");
        assert!(report.is_intact(), "{:?}", report.problems);
    }
}

/// Gives the first `left` bytes, then what `end` makes.
struct Stops<'a> {
    raw: &'a [u8],
    left: usize,
    end: &'a dyn Fn() -> std::io::Error,
}

impl Read for Stops<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        if self.left == 0 {
            return Err((self.end)());
        }
        let n = buffer.len().min(self.left).min(self.raw.len());
        buffer[..n].copy_from_slice(&self.raw[..n]);
        (self.raw, self.left) = (&self.raw[n..], self.left - n);
        Ok(n)
    }
}

#[test]
fn samples_in_a_file_give_the_same_bytes_and_no_scratch_file() {
    use std::io::Write;
    let folder = tempfile::tempdir().expect("scratch folder");
    for (size, sample) in [
        ([75, 64, 37], SampleType::F32),
        ([300, 9, 20], SampleType::U8),
    ] {
        let dense = Dense::new(spec(size, sample, 8), mixed);
        let want = folder.path().join("want.bvol");
        import_stream(&mut &dense.raw[..], &dense.spec, &want, &Budget::mib(24)).expect("imports");
        let mut file = tempfile::tempfile().expect("a file");
        file.write_all(b"header").expect("written");
        file.write_all(&dense.raw).expect("written");
        for (mib, threads) in [(4, 1), (24, 3)] {
            let budget = Budget::mib(mib).with_threads(threads);
            let out = folder.path().join("out.bvol");
            let options = ImportOptions::default();
            import_plain(&file, 6, &dense.spec, &out, &options, &budget).expect("imports");
            assert!(std::fs::read(&out).expect("out") == std::fs::read(&want).expect("want"));
            assert_eq!(std::fs::read_dir(folder.path()).expect("folder").count(), 2);
            assert_eq!(budget.used_bytes(), 0);
        }
    }
}

#[test]
fn a_stopped_import_goes_on() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let out = folder.path().join("v.bvol");
    let spec = spec([100, 60, 90], SampleType::U16, 8);
    let dense = Dense::new(spec.clone(), mixed);
    let slab = 100 * 60 * 8 * 2;
    let entries = || std::fs::read_dir(folder.path()).expect("lists").count();
    for levels in [0, 2] {
        let options = ImportOptions {
            resume: true,
            levels,
            ..ImportOptions::default()
        };
        let import = |source: &mut dyn Read, threads: usize| {
            let budget = Budget::mib(24).with_threads(threads);
            import_committing(
                Source::stream(source, &spec),
                &spec,
                &out,
                &options,
                3 * slab as u64,
                &budget,
            )
        };
        import(&mut &dense.raw[..], 2).expect("in one go");
        let whole = std::fs::read(&out).expect("is there");
        std::fs::remove_file(&out).expect("removes");
        let broken = || std::io::Error::other("the cable");
        let stops = |left: usize, threads: usize| {
            let mut source = Stops {
                raw: &dense.raw,
                left,
                end: &broken,
            };
            import(&mut source, threads).expect_err("stops")
        };
        // Before the first commit nothing is kept.
        let error = stops(slab * 5 / 2, 1);
        assert!(!error.to_string().contains("partial"), "{error}");
        assert_eq!(entries(), 0);
        for (cut, kept) in [(4, 3), (5, 3), (7, 6), (11, 9)] {
            let error = stops(slab * cut + 77, cut).to_string();
            assert!(error.contains(&format!("keeps {kept} of 12")), "{error}");
            assert!(!out.exists() && entries() == 1);
            let partial = Volume::open(&partial_path(&out), &Budget::mib(24)).expect("opens");
            assert_eq!(partial.info().expect("info").unfinished_slabs, Some(kept));
            let mut done = spec.grid.domain;
            done.max[2] = done.min[2] + 8 * kept as i32;
            dense.check(&partial, done);
            let report = verify(&partial_path(&out), &Budget::mib(24)).expect("verifies");
            assert!(report.is_intact(), "{:?}", report.problems);
        }
        // Another source, other settings, a writer for changes: refused, and nothing is lost.
        let mut other = dense.raw.clone();
        other[slab] ^= 1;
        let error = import(&mut &other[..], 1).expect_err("another source");
        assert_eq!(error.kind(), ErrorKind::BadInput, "{error}");
        let coarse = VolumeSpec {
            brick_edge: 16,
            ..spec.clone()
        };
        let budget = Budget::mib(24);
        let error = import_with(&mut &dense.raw[..], &coarse, &out, &options, &budget)
            .expect_err("other settings");
        assert_eq!(error.kind(), ErrorKind::BadInput, "{error}");
        assert!(VolumeWriter::open(&partial_path(&out), &budget).is_err());
        assert_eq!(entries(), 1);
        import(&mut &dense.raw[..], 3).expect("goes on");
        assert!(std::fs::read(&out).expect("is there") == whole);
        assert_eq!(entries(), 1);
        std::fs::remove_file(&out).expect("removes");
        // Killed before the rename: it is renamed when it is of this source.
        std::fs::write(partial_path(&out), &whole).expect("writes");
        let error = import(&mut &other[..], 1).expect_err("another source");
        assert_eq!(error.kind(), ErrorKind::BadInput, "{error}");
        import(&mut &dense.raw[..], 1).expect("renames");
        assert!(std::fs::read(&out).expect("is there") == whole);
        assert_eq!(entries(), 1);
        std::fs::remove_file(&out).expect("removes");
        // Without resuming what is left over is replaced; rubbish too small for a commit as well.
        stops(slab * 4, 1);
        import_stream(&mut &dense.raw[..], &spec, &out, &budget).expect("anew");
        std::fs::remove_file(&out).expect("removes");
        for rubbish in [&[][..], &whole[..5000], &whole[..12288], &[0; 20_000]] {
            std::fs::write(partial_path(&out), rubbish).expect("writes");
            import(&mut &dense.raw[..], 1).expect("anew");
            assert!(std::fs::read(&out).expect("is there") == whole);
            std::fs::remove_file(&out).expect("removes");
        }
    }
}

/// Storage whose writer is killed after some calls that change it.
struct Killed {
    bytes: Arc<MemoryStorage>,
    calls: AtomicUsize,
}

impl Killed {
    fn call(&self) -> std::io::Result<()> {
        let left = self
            .calls
            .fetch_update(Ordering::SeqCst, Ordering::SeqCst, |n| n.checked_sub(1));
        left.map(drop)
            .map_err(|_| std::io::Error::other("the kill"))
    }
}

impl Storage for Killed {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> std::io::Result<()> {
        self.bytes.read_at(buffer, offset)
    }
    fn write_at(&self, bytes: &[u8], offset: u64) -> std::io::Result<()> {
        self.call()?;
        self.bytes.write_at(bytes, offset)
    }
    fn len(&self) -> std::io::Result<u64> {
        self.bytes.len()
    }
    fn set_len(&self, length: u64) -> std::io::Result<()> {
        self.call()?;
        self.bytes.set_len(length)
    }
    fn sync(&self) -> std::io::Result<()> {
        self.call()?;
        self.bytes.sync()
    }
    fn lock(&self) -> std::io::Result<bool> {
        self.bytes.lock()
    }
}

#[test]
fn an_import_killed_at_any_call_goes_on_to_the_same_bytes() {
    let spec = spec([40, 20, 30], SampleType::U16, 8);
    let dense = Dense::new(spec.clone(), mixed);
    for (levels, commit_bytes) in [(0, u64::MAX), (1, u64::MAX), (0, 1), (1, 1)] {
        let options = ImportOptions {
            resume: true,
            levels,
            ..ImportOptions::default()
        };
        let import = |bytes: &Arc<MemoryStorage>, calls: usize| {
            let storage = Arc::new(Killed {
                bytes: bytes.clone(),
                calls: AtomicUsize::new(calls),
            });
            let name = Path::new("killed.bvol");
            let budget = Budget::mib(24).with_threads(1);
            let source = &mut &dense.raw[..];
            import_in(
                storage.clone(),
                name,
                source,
                &spec,
                &options,
                commit_bytes,
                &budget,
            )
            .map(|_| calls - storage.calls.load(Ordering::SeqCst))
        };
        let whole = Arc::new(MemoryStorage::default());
        let calls = import(&whole, usize::MAX).expect("in one go");
        assert!(calls > 20, "{calls}");
        let whole = whole.to_vec();
        for killed in 0..calls {
            let left = Arc::new(MemoryStorage::default());
            import(&left, killed).expect_err("killed");
            import(&left, usize::MAX).expect("goes on");
            assert!(
                left.to_vec() == whole,
                "killed after {killed} of {calls} calls"
            );
            // Killed twice.
            let left = Arc::new(MemoryStorage::default());
            import(&left, killed).expect_err("killed");
            if import(&left, killed / 2).is_err() {
                import(&left, usize::MAX).expect("goes on");
            }
            assert!(
                left.to_vec() == whole,
                "killed after {killed} of {calls} calls, and again"
            );
        }
    }
}

#[test]
fn sources_of_the_wrong_length_are_refused() {
    let folder = tempfile::tempdir().expect("scratch folder");
    let out = folder.path().join("v.bvol");
    let spec = spec([30, 20, 20], SampleType::U16, 8);
    for (bytes, kind) in [
        (0, ErrorKind::Truncated),
        (23_999, ErrorKind::Truncated),
        (24_001, ErrorKind::BadInput),
    ] {
        let error = import_stream(&mut &vec![1; bytes][..], &spec, &out, &Budget::mib(24))
            .expect_err("refused");
        assert_eq!(error.kind(), kind, "{error}");
        assert!(error.to_string().contains("24000"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).expect("lists").count(), 0);
    }
}

/// A real scan, big-endian 16-bit, against the dense array.
#[test]
#[expect(clippy::print_stderr, reason = "a skipped comparison says so")]
fn tooth_reads_back_in_random_boxes() {
    let shared = std::env::var_os("BRICKMARCH_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let Ok(big_endian) = std::fs::read(shared.join("volumes/tooth.raw")) else {
        eprintln!(
            "SKIPPED tooth_reads_back_in_random_boxes: no volumes/tooth.raw; set BRICKMARCH_DATA"
        );
        return;
    };
    let raw: Vec<u8> = big_endian
        .as_chunks::<2>()
        .0
        .iter()
        .flat_map(|&[a, b]| [b, a])
        .collect();
    let folder = tempfile::tempdir().expect("scratch folder");
    let out = folder.path().join("tooth.bvol");
    let domain = Box3::from_size([103, 94, 161]);
    for edge in [8, 16, 32, 64] {
        let spec = VolumeSpec {
            brick_edge: edge,
            ..VolumeSpec::new(Grid::new(domain), SampleType::U16)
        };
        let dense = Dense {
            spec,
            raw: raw.clone(),
        };
        let budget = Budget::mib(24);
        let info = import_stream(&mut &raw[..], &dense.spec, &out, &budget).expect("imports");
        assert_eq!((info.range.min, info.range.max), (0.0, 1300.0));
        assert!(info.compression > 1.2, "{}", info.compression);
        let volume = Volume::open(&out, &budget).expect("opens");
        let mut state = 1u32;
        let mut random = |n: i32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as i32 % n
        };
        dense.check(&volume, domain);
        for _ in 0..20 {
            let a: [i32; 3] = std::array::from_fn(|axis| random(domain.max[axis]));
            let b: [i32; 3] = std::array::from_fn(|axis| random(domain.max[axis]));
            let region = Box3::new(
                std::array::from_fn(|axis| a[axis].min(b[axis])),
                std::array::from_fn(|axis| a[axis].max(b[axis]) + 1),
            );
            dense.check(&volume, region);
        }
        assert!(verify(&out, &budget).expect("verifies").is_intact());
        assert_eq!(volume.range(domain).expect("range"), info.range);
    }
}

/// The checksum over what several threads have read in pieces is that of the source.
#[test]
fn the_mark_of_an_import_from_a_file_is_that_of_a_stream() {
    use std::io::Write;
    for (size, sample, edge) in [
        ([75, 64, 70], SampleType::F32, 8),
        // Too wide for one run a row in a small budget.
        ([600, 40, 200], SampleType::U8, 32),
    ] {
        let dense = Dense::new(spec(size, sample, edge), mixed);
        let two_slabs = 2 * dense.raw.len() as u64 * u64::from(edge) / size[2] as u64;
        let mut file = tempfile::tempfile().expect("a file");
        file.write_all(b"header").expect("written");
        file.write_all(&dense.raw).expect("written");
        for threads in [1, 3] {
            let budget = Budget::mib(4).with_threads(threads);
            let storage = Arc::new(MemoryStorage::default());
            let name = Path::new("marked.bvol");
            let writer = VolumeWriter::create_in(storage.clone(), name, &dense.spec, &budget)
                .expect("begins");
            let mut source = Source::in_file(&file, 6, &dense.spec).expect("opens");
            fill(&mut source, &writer, name, two_slabs, &budget).expect("fills");
            let slabs = dense.spec.bricks()[2];
            let mark = (slabs, crc32c::crc32c(&dense.raw));
            assert_eq!(writer.parts[0].mark(), mark, "{size:?} {threads}");
            assert_eq!(
                writer.commit().expect("commits"),
                u64::from(slabs.div_ceil(2))
            );
            let volume = Volume::open_in(storage, name, &budget).expect("opens");
            dense.check(&volume, dense.spec.grid.domain);
        }
    }
}
