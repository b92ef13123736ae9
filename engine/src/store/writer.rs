//! The only way to make a volume file: bricks in any order from any thread, then one commit.

use super::catalog::{Counts, Entry, encode_attributes, encode_catalog};
use super::codec::{Encoder, encoder_bytes, pack_bits};
use super::layout::{FILE_ID_BYTES, RECORD_HEADER, brick_bytes, record_bytes};
use super::log::Log;
use super::meta;
use super::page::PageRules;
use super::record::{Head, RecordKind, Ref, seal};
use super::spec::{VolumeInfo, VolumeSpec};
use super::storage::{FileStorage, Storage};
use super::tree::Tree;
use super::value::{KeyRange, bits_of, bits_of_raw, exact_bits_of, scan};
use crate::budget::{Budget, Permit};
use crate::error::{Error, ErrorKind, Result};
use crate::lattice::morton_encode;
use crate::sample::SampleType;
use std::fs::{File, OpenOptions};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Writes a volume file. Nothing appears under the final name before [`finish`](Self::finish);
/// dropping an unfinished writer removes what it wrote aside.
///
/// ```
/// use brickmarch::{Box3, Budget, Field, Grid, SampleType};
/// use brickmarch::store::{Volume, VolumeSpec, VolumeWriter};
/// let folder = tempfile::tempdir().unwrap();
/// let path = folder.path().join("ball.bvol");
/// let budget = Budget::mib(24);
/// let spec = VolumeSpec { brick_edge: 8, ..VolumeSpec::new(Grid::new(Box3::from_size([16, 8, 8])), SampleType::U8) };
/// let writer = VolumeWriter::create(&path, &spec, &budget).unwrap();
/// writer.put_brick([1, 0, 0], &[7; 512]).unwrap();
/// writer.finish().unwrap();
/// let volume = Volume::open(&path, &budget).unwrap();
/// assert_eq!(volume.range(Box3::new([0, 0, 0], [8, 8, 8])).unwrap().max, 0.0);
/// assert_eq!(volume.range(Box3::new([0, 0, 0], [9, 8, 8])).unwrap().max, 7.0);
/// ```
pub struct VolumeWriter {
    log: Log,
    tree: Mutex<Tree>,
    counts: Mutex<Counts>,
    spec: VolumeSpec,
    background: u32,
    path: PathBuf,
    aside: Option<Aside>,
    budget: Budget,
    encoders: Mutex<Vec<BrickEncoder>>,
}

/// The temporary file; removed when dropped.
pub(crate) struct Aside {
    path: PathBuf,
    renamed: bool,
}

impl Drop for Aside {
    fn drop(&mut self) {
        if !self.renamed {
            // Nothing can be done about a failure here; the name says that it is temporary.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

impl Aside {
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }
}

/// What came out of one brick.
pub(crate) enum Encoded {
    Background,
    Tile(u32),
    /// Sealed record in the output of the encoder, relative offset.
    Brick(Ref, KeyRange),
}

/// A batch of encoded bricks in the order of the file.
#[derive(Default)]
pub(crate) struct Batch {
    pub(crate) bytes: Vec<u8>,
    pub(crate) bricks: Vec<([u32; 3], Encoded)>,
}

impl Batch {
    pub(crate) fn clear(&mut self) {
        self.bytes.clear();
        self.bricks.clear();
    }
}

/// Buffers of one thread for encoding.
pub(crate) struct BrickEncoder {
    encoder: Encoder,
    padded: Vec<u8>,
    packed: Vec<u8>,
    pub(crate) batch: Batch,
    _permit: Permit,
}

impl VolumeWriter {
    /// Starts a volume that will be at `path`; an existing file there is replaced at the end.
    ///
    /// # Errors
    /// A spec that does not hold, or the file cannot be made.
    pub fn create(path: &Path, spec: &VolumeSpec, budget: &Budget) -> Result<Self> {
        spec.validate().map_err(|e| e.context(path.display()))?;
        let (file, aside) = create_aside(path)?;
        let storage = FileStorage(file);
        match storage.lock() {
            Ok(true) => {}
            Ok(false) => {
                return Err(Error::new(
                    ErrorKind::ForeignWriter,
                    format!("{}: locked by another writer", aside.path.display()),
                ));
            }
            // Some network file systems have no locks; the fence of the commit remains.
            Err(_) => {}
        }
        Self::start(Arc::new(storage), path, spec, budget, Some(aside))
    }

    /// Starts a volume in empty `storage`; `name` is for messages.
    ///
    /// # Errors
    /// A spec that does not hold, or the storage refuses.
    pub fn create_in(
        storage: Arc<dyn Storage>,
        name: &Path,
        spec: &VolumeSpec,
        budget: &Budget,
    ) -> Result<Self> {
        spec.validate().map_err(|e| e.context(name.display()))?;
        Self::start(storage, name, spec, budget, None)
    }

    fn start(
        storage: Arc<dyn Storage>,
        path: &Path,
        spec: &VolumeSpec,
        budget: &Budget,
        aside: Option<Aside>,
    ) -> Result<Self> {
        let place = aside.as_ref().map_or(path, |a| &a.path).to_path_buf();
        let rules = rules_of(spec);
        let log = Log::create(storage, place, &file_id(spec))?;
        Ok(Self {
            log,
            tree: Mutex::new(Tree::new(rules, spec.root_level(), budget)?),
            counts: Mutex::default(),
            spec: spec.clone(),
            background: rules.background,
            path: path.to_path_buf(),
            aside,
            budget: budget.clone(),
            encoders: Mutex::default(),
        })
    }

    /// Bricks per axis; brick `[0, 0, 0]` starts at the smallest point of the domain.
    pub fn bricks(&self) -> [u32; 3] {
        self.spec.bricks()
    }

    /// What is being written.
    pub fn spec(&self) -> &VolumeSpec {
        &self.spec
    }

    /// Puts a brick: `edge^3` raw little-endian samples, `i` fastest (a bit takes one byte). Samples
    /// beyond the domain are ignored. Any order, any thread; each brick once. A brick of one value
    /// becomes a tile, one of the background is not stored.
    ///
    /// The offsets of bricks in the file follow the order of the calls; for bytes that do not depend
    /// on threads put them from one thread, or use [`write_field`](super::write_field).
    ///
    /// # Errors
    /// A brick outside of the lattice, put twice, or of the wrong length; a write that fails.
    pub fn put_brick(&self, brick: [u32; 3], raw: &[u8]) -> Result<()> {
        let edge = self.spec.brick_edge as usize;
        let length = edge.pow(3) * self.spec.sample.bytes();
        if raw.len() != length {
            return Err(Error::bad_input(format!(
                "brick {brick:?} of {} bytes instead of {length}",
                raw.len()
            )));
        }
        self.check_inside(brick)?;
        let mut encoder = self.take_encoder()?;
        encoder.batch.clear();
        encoder.encode(self, brick, raw);
        let result = self.append(&encoder.batch);
        self.give_back(encoder);
        result
    }

    /// Makes a cube of `2^level` bricks per axis from brick `node_min` constant. The part of the
    /// cube outside of the domain is ignored.
    ///
    /// # Errors
    /// A cube that does not lie on its own lattice, a value that the sample type cannot hold, or
    /// bricks put twice.
    pub fn put_constant(&self, node_min: [u32; 3], level: u8, value: f64) -> Result<()> {
        let bits = exact_bits_of(self.spec.sample, value, "the constant")?;
        self.put_constant_bits(node_min, level, bits)
    }

    pub(crate) fn put_constant_bits(&self, node_min: [u32; 3], level: u8, bits: u32) -> Result<()> {
        self.check_inside(node_min)?;
        let most = 3 * self.spec.root_level();
        if level > most || node_min.iter().any(|&b| b & ((1u32 << level) - 1) != 0) {
            return Err(Error::bad_input(format!(
                "a cube of level {level} at brick {node_min:?}: it must start at a multiple of its edge, and level {most} is the highest"
            )));
        }
        if bits == self.background {
            return Ok(());
        }
        self.tree().put_tile(node_min, level, bits)
    }

    fn check_inside(&self, brick: [u32; 3]) -> Result<()> {
        let bricks = self.bricks();
        if (0..3).any(|a| brick[a] >= bricks[a]) {
            return Err(Error::bad_input(format!(
                "brick {brick:?} is outside of the lattice of {bricks:?} bricks"
            )));
        }
        Ok(())
    }

    fn tree(&self) -> std::sync::MutexGuard<'_, Tree> {
        self.tree.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn take_encoder(&self) -> Result<BrickEncoder> {
        let free = self
            .encoders
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .pop();
        free.map_or_else(|| self.new_encoder(1), Ok)
    }

    pub(crate) fn give_back(&self, encoder: BrickEncoder) {
        self.encoders
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(encoder);
    }

    /// Bytes that [`new_encoder`](Self::new_encoder) takes from the budget.
    pub(crate) fn encoder_charge(&self, bricks: u64) -> u64 {
        let (sample, edge) = (self.spec.sample, self.spec.brick_edge);
        let raw = u64::from(edge).pow(3) * sample.bytes() as u64;
        encoder_bytes(sample, edge) + 2 * raw + self.batch_bytes(bricks)
    }

    fn batch_bytes(&self, bricks: u64) -> u64 {
        bricks * record_bytes(brick_bytes(self.spec.sample, self.spec.brick_edge) as u32) + 64
    }

    pub(crate) fn background_bits(&self) -> u32 {
        self.background
    }

    /// Buffers for batches of `bricks` bricks.
    pub(crate) fn new_encoder(&self, bricks: u64) -> Result<BrickEncoder> {
        let permit = self
            .budget
            .take(self.encoder_charge(bricks), "compressing bricks")?;
        let mut encoder = BrickEncoder {
            encoder: Encoder::default(),
            padded: Vec::new(),
            packed: Vec::new(),
            batch: Batch::default(),
            _permit: permit,
        };
        encoder
            .batch
            .bytes
            .reserve_exact(self.batch_bytes(bricks) as usize);
        Ok(encoder)
    }

    /// Appends a batch: a place in the file, the bytes, then the slots.
    pub(crate) fn append(&self, batch: &Batch) -> Result<()> {
        let offset = self.reserve(batch)?;
        self.write_reserved(batch, offset)
    }

    /// First half of [`append`](Self::append): the place in the file, in the order of the calls.
    pub(crate) fn reserve(&self, batch: &Batch) -> Result<u64> {
        let refs: Vec<Ref> = batch
            .bricks
            .iter()
            .filter_map(|(_, e)| {
                if let Encoded::Brick(r, _) = e {
                    Some(*r)
                } else {
                    None
                }
            })
            .collect();
        self.log.reserve(&batch.bytes, &refs)
    }

    /// Second half of [`append`](Self::append), any time later.
    pub(crate) fn write_reserved(&self, batch: &Batch, offset: u64) -> Result<()> {
        if !batch.bytes.is_empty() {
            self.log.write_reserved(&batch.bytes, offset)?;
        }
        let (mut bricks, mut stored) = (0, 0);
        let mut tree = self.tree();
        for &(brick, ref encoded) in &batch.bricks {
            match *encoded {
                Encoded::Background => {}
                Encoded::Tile(bits) => tree.put_tile(brick, 0, bits)?,
                Encoded::Brick(mut reference, range) => {
                    reference.offset += offset;
                    tree.put_child(brick, reference, range)?;
                    bricks += 1;
                    stored += u64::from(reference.length);
                }
            }
        }
        drop(tree);
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        counts.bricks += bricks;
        counts.stored += stored;
        Ok(())
    }

    /// Commits, syncs and renames to the final name.
    ///
    /// # Errors
    /// A write, sync or rename that fails; nothing is then under the final name.
    pub fn finish(mut self) -> Result<VolumeInfo> {
        let aside = self.aside.take();
        let place = aside.as_ref().map_or(&self.path, |a| &a.path).clone();
        let mut counts = *self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let generation = self.log.generation;
        let rules = rules_of(&self.spec);
        let tree = std::mem::replace(&mut *self.tree(), Tree::new(rules, 0, &self.budget)?);
        let mut index = [u64::MAX, 0];
        let done = tree.finish(generation, |head, record| {
            let reference = self.log.append(head, record)?;
            let end = reference.offset + super::layout::record_bytes(reference.length);
            index = [index[0].min(reference.offset), end];
            Ok(reference)
        })?;
        let index = if done.pages == 0 {
            [0, 0]
        } else {
            [index[0], index[1] - index[0]]
        };
        (counts.tiles, counts.tile_bricks, counts.pages) =
            (done.tiles, done.tile_bricks, done.pages);
        let append = |kind: RecordKind, payload: Vec<u8>| {
            let mut record = vec![0; RECORD_HEADER];
            record.extend(payload);
            self.log.append(&Head::new(kind, generation), record)
        };
        let history = match self.spec.history.as_str() {
            "" => Ref::default(),
            text => append(RecordKind::History, meta::encode(text)?)?,
        };
        let attributes = append(
            RecordKind::Attributes,
            encode_attributes(&self.spec, done.range, &counts),
        )?;
        let entry = Entry {
            attributes,
            history,
            root: done.root,
            root_level: if done.root.is_none() {
                0
            } else {
                self.spec.root_level()
            },
            name: self.spec.name.clone(),
        };
        let catalog = append(RecordKind::Catalog, encode_catalog(&entry))?;
        let root = self.log.commit(catalog, index)?;
        if let Some(mut aside) = aside {
            std::fs::rename(&aside.path, &self.path).map_err(|e| {
                Error::io(&self.path, &format!("renaming {}", aside.path.display()), e)
            })?;
            aside.renamed = true;
            sync_folder_of(&self.path)?;
        }
        let length = self
            .log
            .storage
            .len()
            .map_err(|e| Error::io(&place, "asking for the length", e))?;
        Ok(info_of(
            &self.spec,
            done.range,
            &counts,
            entry.root_level,
            &root,
            length,
        ))
    }
}

/// What every page of the volume must obey.
pub(crate) fn rules_of(spec: &VolumeSpec) -> PageRules {
    PageRules {
        sample: spec.sample,
        background: bits_of(spec.sample, spec.background),
        bricks: spec.bricks(),
        brick_bytes: brick_bytes(spec.sample, spec.brick_edge) as u32,
    }
}

pub(crate) fn info_of(
    spec: &VolumeSpec,
    range: KeyRange,
    counts: &Counts,
    page_levels: u8,
    root: &super::record::Superblock,
    length: u64,
) -> VolumeInfo {
    let samples = spec.grid.domain.count();
    let bytes_raw = match spec.sample {
        SampleType::Bit => samples.div_ceil(8),
        _ => samples.saturating_mul(spec.sample.bytes() as u64),
    };
    let bricks: u64 = spec.bricks().into_iter().map(u64::from).product();
    VolumeInfo {
        domain: spec.grid.domain,
        sample: spec.sample,
        kind: spec.kind,
        brick_edge: spec.brick_edge,
        range: range.to_range(spec.sample),
        bricks_stored: counts.bricks,
        bricks_constant: counts.tile_bricks,
        bricks_background: bricks
            .saturating_sub(counts.bricks)
            .saturating_sub(counts.tile_bricks),
        tiles: counts.tiles,
        pages: counts.pages,
        page_levels,
        bytes_raw,
        bytes_stored: counts.stored,
        bytes_live: root.live,
        bytes_dead: root.garbage,
        bytes_file: length,
        compression: bytes_raw as f64 / length.max(1) as f64,
    }
}

impl BrickEncoder {
    /// Appends the brick of whole `raw` samples to the batch.
    pub(crate) fn encode(&mut self, writer: &VolumeWriter, brick: [u32; 3], raw: &[u8]) {
        let spec = &writer.spec;
        let inside = spec.brick_box(brick).size();
        let edge = spec.brick_edge as usize;
        let raw = if inside == [spec.brick_edge; 3] {
            raw
        } else {
            self.padded.clear();
            self.padded.extend_from_slice(raw);
            pad(
                &mut self.padded,
                edge,
                spec.sample.bytes(),
                inside.map(|n| n as usize),
            );
            &self.padded
        };
        let (range, constant) = scan_bits(spec.sample, raw);
        if constant {
            let bits = match spec.sample {
                SampleType::Bit => u32::from(raw[0] != 0),
                sample => bits_of_raw(sample, raw),
            };
            let encoded = if bits == writer.background {
                Encoded::Background
            } else {
                Encoded::Tile(bits)
            };
            self.batch.bricks.push((brick, encoded));
            return;
        }
        let bytes = if spec.sample == SampleType::Bit {
            self.packed.resize(raw.len() / 8, 0);
            pack_bits(raw, &mut self.packed);
            &self.packed
        } else {
            raw
        };
        let out = &mut self.batch.bytes;
        let start = out.len();
        out.resize(start + RECORD_HEADER, 0);
        let codec = self
            .encoder
            .encode(spec.sample, spec.brick_edge, bytes, out);
        let head = Head {
            codec,
            decoded: bytes.len() as u32,
            key: morton_encode(brick),
            ..Head::new(RecordKind::Brick, writer.log.generation)
        };
        let reference = seal(out, start, &head, writer.log.seed);
        self.batch
            .bricks
            .push((brick, Encoded::Brick(reference, range)));
    }
}

/// [`scan`], where any byte but 0 is a set bit.
fn scan_bits(sample: SampleType, raw: &[u8]) -> (KeyRange, bool) {
    if sample != SampleType::Bit {
        return scan(sample, raw);
    }
    let (any, all) = (raw.iter().any(|&b| b != 0), raw.iter().all(|&b| b != 0));
    (
        KeyRange {
            low: all.into(),
            high: any.into(),
            has_nan: false,
        },
        any == all,
    )
}

/// Repeats the last sample inside along each axis, so that ranges stay tight.
fn pad(raw: &mut [u8], edge: usize, width: usize, inside: [usize; 3]) {
    let [nx, ny, nz] = inside;
    let (row, slice) = (edge * width, edge * edge * width);
    for k in 0..nz {
        for j in 0..ny {
            let line = &mut raw[k * slice + j * row..][..row];
            let (kept, rest) = line.split_at_mut(nx * width);
            for sample in rest.chunks_mut(width) {
                sample.copy_from_slice(&kept[(nx - 1) * width..]);
            }
        }
        for j in ny..edge {
            raw.copy_within(
                k * slice + (ny - 1) * row..k * slice + ny * row,
                k * slice + j * row,
            );
        }
    }
    for k in nz..edge {
        raw.copy_within((nz - 1) * slice..nz * slice, k * slice);
    }
}

/// 128 bits that depend on the spec only, so that equal input gives equal files (FNV-1a, twice).
fn file_id(spec: &VolumeSpec) -> [u8; FILE_ID_BYTES] {
    let mut bytes = encode_attributes(spec, KeyRange::empty(spec.sample), &Counts::default());
    bytes.extend_from_slice(spec.name.as_bytes());
    bytes.push(0);
    bytes.extend_from_slice(spec.history.as_bytes());
    let hash = |seed: u64| {
        bytes.iter().fold(seed, |h, &b| {
            (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01b3)
        })
    };
    let low = hash(0xcbf2_9ce4_8422_2325);
    let mut id = [0; FILE_ID_BYTES];
    id[..8].copy_from_slice(&low.to_le_bytes());
    id[8..].copy_from_slice(&hash(low ^ 0x9e37_79b9_7f4a_7c15).to_le_bytes());
    id
}

pub(crate) fn create_aside(path: &Path) -> Result<(File, Aside)> {
    let name = path
        .file_name()
        .ok_or_else(|| Error::bad_input(format!("{}: not the name of a file", path.display())))?;
    for attempt in 0..1000u32 {
        let mut aside = name.to_os_string();
        aside.push(format!(".tmp-{}-{attempt}", std::process::id()));
        let aside = path.with_file_name(aside);
        match OpenOptions::new()
            .read(true)
            .write(true)
            .create_new(true)
            .open(&aside)
        {
            Ok(file) => {
                return Ok((
                    file,
                    Aside {
                        path: aside,
                        renamed: false,
                    },
                ));
            }
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(Error::io(&aside, "creating the file", e)),
        }
    }
    Err(Error::new(
        ErrorKind::Io,
        format!(
            "{}: a thousand temporary files are left over: remove them",
            path.display()
        ),
    ))
}

/// Makes the rename survive a loss of power.
fn sync_folder_of(path: &Path) -> Result<()> {
    #[cfg(unix)]
    {
        let folder = path
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        File::open(folder)
            .and_then(|f| f.sync_all())
            .map_err(|e| Error::io(folder, "syncing the folder", e))?;
    }
    #[cfg(not(unix))]
    let _ = path;
    Ok(())
}
