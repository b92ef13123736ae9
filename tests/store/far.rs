//! Files of terabytes in a little memory: offsets past 2^31, 2^32, 2^40 and 2^44 in every way of
//! reading and changing.

use super::image::{crc32c, put};
use crate::support::rng::Rng;
use brickmarch::store::{
    MemoryStorage, OnDamage, Storage, Volume, VolumeSpec, VolumeWriter, compact_in, verify_in,
};
use brickmarch::{Box3, Budget, Field, Grid, SampleType};
use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex};

const PAGE: u64 = 4096;
const NAME: &str = "far.bvol";

/// Bytes by pages; what was never written is zero and takes no memory.
#[derive(Default)]
struct Sparse {
    pages: Mutex<BTreeMap<u64, Box<[u8]>>>,
    length: Mutex<u64>,
}

impl Storage for Sparse {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let end = offset.checked_add(buffer.len() as u64);
        if end.is_none_or(|end| end > *self.length.lock().expect("no panic")) {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        let pages = self.pages.lock().expect("no panic");
        for (n, byte) in (offset..).zip(buffer) {
            let page = pages.get(&(n / PAGE));
            *byte = page.map_or(0, |page| page[(n % PAGE) as usize]);
        }
        Ok(())
    }

    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<()> {
        let mut pages = self.pages.lock().expect("no panic");
        for (n, &byte) in (offset..).zip(bytes) {
            let page = pages
                .entry(n / PAGE)
                .or_insert_with(|| vec![0; PAGE as usize].into());
            page[(n % PAGE) as usize] = byte;
        }
        let mut length = self.length.lock().expect("no panic");
        *length = (*length).max(offset + bytes.len() as u64);
        Ok(())
    }

    fn len(&self) -> io::Result<u64> {
        Ok(*self.length.lock().expect("no panic"))
    }

    fn set_len(&self, to: u64) -> io::Result<()> {
        *self.length.lock().expect("no panic") = to;
        Ok(())
    }

    fn sync(&self) -> io::Result<()> {
        Ok(())
    }

    fn lock(&self) -> io::Result<bool> {
        Ok(true)
    }
}

fn spec(name: &str) -> VolumeSpec {
    VolumeSpec {
        brick_edge: 8,
        name: name.into(),
        ..VolumeSpec::new(Grid::new(Box3::from_size([44, 40, 24])), SampleType::U16)
    }
}

fn noise(seed: u64) -> Vec<u8> {
    let mut rng = Rng::new(seed);
    (0..44 * 40 * 24 * 2).map(|_| rng.next() as u8).collect()
}

/// Moves the log end of the first generation, so that the next commit begins there.
fn move_log_end(storage: &Sparse, to: u64) {
    let mut block = [0; 4096];
    let mut id = [0; 16];
    storage.read_at(&mut block, 4096).expect("there");
    storage.read_at(&mut id, 40).expect("there");
    put(&mut block, 16, to.to_le_bytes());
    let crc = crc32c(crc32c(0, &id), &block[..4092]);
    put(&mut block, 4092, crc.to_le_bytes());
    storage.write_at(&block, 4096).expect("memory");
    storage.set_len(to).expect("memory");
}

fn check(storage: &Arc<Sparse>, volume: &str, raw: &[u8], budget: &Budget) -> Volume {
    let name = Path::new(NAME);
    let volume = Volume::open_named_in(storage.clone(), name, volume, budget).expect("sound");
    assert!(super::read_all(&volume).expect("sound") == raw);
    volume
}

fn far_beyond(bits: u32) {
    let budget = Budget::mib(24).with_threads(2);
    let storage = Arc::new(Sparse::default());
    let name = Path::new(NAME);
    let (first, second, third) = (noise(1), noise(2), noise(3));
    let dense = |raw, writer: &VolumeWriter, number| {
        let spec = &spec("");
        crate::volume::Dense { spec, raw }.put_all_in(writer, number);
    };
    let writer = VolumeWriter::create_in(storage.clone(), name, &spec("one"), &budget);
    let writer = writer.expect("memory");
    dense(&first, &writer, 0);
    writer.finish().expect("memory");
    // Records stand on both sides of the border.
    let border = 1 << bits;
    move_log_end(&storage, border - 3 * PAGE);
    let mut old = check(&storage, "one", &first, &budget);

    let writer = || VolumeWriter::open_in(storage.clone(), name, &budget).expect("sound");
    let mut changes = writer();
    dense(&second, &changes, 0);
    let number = changes.add_volume(&spec("two")).expect("another name");
    dense(&third, &changes, number);
    changes.build_levels(1).expect("memory");
    drop(changes);
    let end = storage.len().expect("memory");
    assert!(end > border + 20 * PAGE, "nothing stands behind 2^{bits}");
    let volume = check(&storage, "one", &second, &budget);
    assert_eq!((volume.levels(), volume.generation()), (1, 3));
    super::read_all(&volume.level(1).expect("built")).expect("sound");
    check(&storage, "two", &third, &budget);
    assert_eq!(volume.info().expect("sound").bytes_file, end);

    // Older readers, older generations, newer ones.
    assert!(super::read_all(&old).expect("sound") == first);
    let back = volume.open_generation(1).expect("is there");
    assert!(super::read_all(&back).expect("sound") == first);
    assert!(old.refresh().expect("sound"));
    assert!(super::read_all(&old).expect("sound") == second);

    // The newest superblock lost: commits are found behind the border.
    let mut saved = [0; 4096];
    storage.read_at(&mut saved, 4096).expect("there");
    storage.write_at(&[0; 4096], 4096).expect("memory");
    let walked = check(&storage, "one", &second, &budget);
    assert_eq!(walked.generation(), 3);
    storage.write_at(&saved, 4096).expect("memory");

    // Into a file that is not sparse.
    let small = Arc::new(MemoryStorage::default());
    compact_in(storage.clone(), small.clone(), name, &budget).expect("sound");
    let compacted = Volume::open_in(small.clone(), name, &budget).expect("sound");
    assert!(super::read_all(&compacted).expect("sound") == second);
    assert!(verify_in(small, name, &budget).expect("reads").is_intact());

    // Damage there is noticed, named by its offset, and substituted on request.
    let mut byte = [0];
    let hole = border + 2 * PAGE + 123;
    storage.read_at(&mut byte, hole).expect("there");
    storage.write_at(&[byte[0] ^ 1], hole).expect("memory");
    let mut damaged = Volume::open_in(storage.clone(), name, &budget).expect("the root is sound");
    let error = super::read_all(&damaged).expect_err("damaged").to_string();
    let offset = error
        .split("offset ")
        .nth(1)
        .and_then(|t| t.split(':').next());
    let offset: u64 = offset
        .and_then(|t| t.parse().ok())
        .unwrap_or_else(|| panic!("{error}"));
    assert!((border..=hole).contains(&offset), "{error}");
    damaged.set_on_damage(OnDamage::Substitute);
    super::read_all(&damaged).expect("substitutes");
    assert_eq!(damaged.substituted().len(), 1);
    let domain = damaged.spec().grid.domain;
    assert!(damaged.range(domain).is_ok());
    let bytes = storage.pages.lock().expect("no panic").len() as u64 * PAGE;
    assert!(bytes < 4 << 20, "{bytes} bytes for a sparse file");
}

#[test]
fn offsets_past_2_to_the_31() {
    far_beyond(31);
}

#[test]
fn offsets_past_2_to_the_32() {
    far_beyond(32);
}

#[test]
fn offsets_past_2_to_the_40() {
    far_beyond(40);
}

#[test]
fn offsets_past_2_to_the_44() {
    far_beyond(44);
}
