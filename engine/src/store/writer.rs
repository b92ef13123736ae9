//! The only way to make or change a volume file: bricks in any order from any thread, then a commit.

use super::aside::{Aside, create_aside};
use super::catalog::{Counts, encode_attributes};
use super::codec::{Choice, encoder_bytes};
use super::commit::{Saved, SavedPart};
use super::encode::{Batch, BrickEncoder, Encoded};
use super::fitted;
use super::layout::{
    FILE_ID_BYTES, INCOMPAT_BINARY, INCOMPAT_FITTED, INCOMPAT_ROWS, KNOWN_RO_COMPAT, LOG_START,
    MAX_VOLUMES, brick_bytes, record_bytes,
};
use super::log::Log;
use super::open::{Contents, Opened};
use super::page::PageRules;
use super::record::{Ref, Superblock, seed_of};
use super::spec::{Compression, VolumeInfo, VolumeSpec};
use super::storage::{FileStorage, Storage};
use super::tree::Tree;
use super::value::{KeyRange, bits_of, exact_bits_of};
use crate::budget::Budget;
use crate::error::{Error, ErrorKind, Result};
use crate::sample::SampleType;
use std::fs::OpenOptions;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};

/// Writes a volume file: a new one ([`create`](Self::create)), of which nothing appears under the
/// final name before [`finish`](Self::finish), or changes to one ([`open`](Self::open)), which
/// appear with each [`commit`](Self::commit). What was put since the last commit is lost when the
/// writer is dropped; a new file that was not finished is removed.
///
/// Readers are never disturbed: committed bytes are not written again.
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
///
/// let writer = VolumeWriter::open(&path, &budget).unwrap();
/// writer.put_brick([0, 0, 0], &[9; 512]).unwrap();
/// assert_eq!(writer.commit().unwrap(), 2);
/// assert_eq!(Volume::open(&path, &budget).unwrap().info().unwrap().range.max, 9.0);
/// ```
pub struct VolumeWriter {
    pub(super) log: Log,
    pub(super) parts: Vec<Part>,
    pub(super) saved: Mutex<Saved>,
    /// Puts share it, a commit has it alone.
    pub(super) gate: RwLock<()>,
    pub(super) replace: bool,
    /// Which codecs there may be is said in the header of the file, once and for ever.
    pub(super) choice: Choice,
    writer: u64,
    /// Whether the next commit makes a sealed file.
    pub(super) sealed: bool,
    path: PathBuf,
    aside: Option<Aside>,
    pub(super) budget: Budget,
}

/// One volume of the file while it is written.
pub(crate) struct Part {
    pub(crate) spec: VolumeSpec,
    pub(crate) rules: PageRules,
    /// Level of detail of volume `parent`; 0 for a volume of its own.
    pub(crate) lod: u8,
    pub(crate) parent: u16,
    tree: Mutex<Tree>,
    encoders: Mutex<Vec<BrickEncoder>>,
    /// Slabs and source checksum of a running import; of a level of detail 0 and the checksum of
    /// the root page that it was built from.
    mark: Mutex<(u32, u32)>,
    /// Of a level of detail: whether what was put is all of it, as the next commit has its parent.
    built: AtomicBool,
}

impl Part {
    pub(super) fn new(spec: &VolumeSpec, replace: bool, budget: &Budget) -> Result<Self> {
        let rules = rules_of(spec);
        Ok(Self {
            tree: Mutex::new(Tree::new(rules, spec.root_level(), replace, budget)?),
            rules,
            spec: spec.clone(),
            lod: 0,
            parent: 0,
            encoders: Mutex::default(),
            mark: Mutex::default(),
            built: AtomicBool::new(false),
        })
    }

    pub(super) fn tree(&self) -> MutexGuard<'_, Tree> {
        self.tree.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn mark(&self) -> (u32, u32) {
        *self.mark.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn set_mark(&self, mark: (u32, u32)) {
        *self.mark.lock().unwrap_or_else(PoisonError::into_inner) = mark;
    }

    pub(super) fn is_built(&self) -> bool {
        self.built.load(Ordering::Acquire)
    }

    pub(super) fn set_built(&self, built: bool) {
        self.built.store(built, Ordering::Release);
    }

    /// Forgets what was put since the last commit.
    pub(super) fn forget(&self) {
        self.tree().clear();
        self.set_built(false);
    }

    fn check_inside(&self, brick: [u32; 3]) -> Result<()> {
        let bricks = self.rules.bricks;
        if !self.rules.in_domain(brick) {
            return Err(Error::bad_input(format!(
                "brick {brick:?} is outside of the lattice of {bricks:?} bricks"
            )));
        }
        Ok(())
    }

    fn batch_bytes(&self, bricks: u64) -> u64 {
        bricks * record_bytes(self.rules.brick_bytes) + 64
    }
}

impl VolumeWriter {
    /// Starts a volume that will be at `path`; an existing file there is replaced at the end.
    ///
    /// # Errors
    /// A spec that does not hold, or the file cannot be made.
    pub fn create(path: &Path, spec: &VolumeSpec, budget: &Budget) -> Result<Self> {
        spec.validate().map_err(|e| e.context(path.display()))?;
        let (file, aside) = create_aside(path)?;
        let storage = Arc::new(FileStorage(file));
        let is_locked = take_lock(storage.as_ref(), aside.path())?;
        Self::start(storage, is_locked, path, spec, budget, Some(aside))
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
        let is_locked = take_lock(storage.as_ref(), name)?;
        Self::start(storage, is_locked, name, spec, budget, None)
    }

    /// Opens the file at `path` for changes. One writer at a time: it holds an advisory lock, and
    /// where a file system has no locks a commit notices the commit of another writer.
    ///
    /// # Errors
    /// As [`Volume::open`](super::Volume::open); `ForeignWriter` while another writer has the file;
    /// `Newer` for a file that this version may only read.
    pub fn open(path: &Path, budget: &Budget) -> Result<Self> {
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .open(path)
            .map_err(|e| Error::io(path, "opening the volume for writing", e))?;
        Self::open_in(Arc::new(FileStorage(file)), path, budget)
    }

    /// Opens the file in `storage` for changes; `name` is for messages.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_in(storage: Arc<dyn Storage>, name: &Path, budget: &Budget) -> Result<Self> {
        let is_locked = take_lock(storage.as_ref(), name)?;
        let random = RandomState::new().build_hasher().finish();
        let mut writer = Self::resume(storage, is_locked, name, name, true, budget)?;
        writer.writer = random | 1;
        if writer.parts[0].mark().0 != 0 {
            return Err(Error::bad_input(format!(
                "{}: an import that was not finished: resume it, or import again",
                name.display()
            )));
        }
        Ok(writer)
    }

    pub(super) fn start(
        storage: Arc<dyn Storage>,
        is_locked: bool,
        path: &Path,
        spec: &VolumeSpec,
        budget: &Budget,
        aside: Option<Aside>,
    ) -> Result<Self> {
        let place = aside.as_ref().map_or(path, |a| a.path()).to_path_buf();
        let id = file_id(spec);
        // A file that starts with other samples stays readable without those codecs.
        let incompat = match spec.sample {
            SampleType::F32 => INCOMPAT_ROWS,
            sample if fitted::is_for(sample) => INCOMPAT_FITTED | INCOMPAT_BINARY,
            _ => INCOMPAT_BINARY,
        };
        let log = Log::create(storage.clone(), is_locked, place.clone(), &id, incompat)?;
        let file = Opened {
            storage,
            path: place,
            seed: seed_of(&id),
            root: Superblock {
                log_end: LOG_START,
                ..Superblock::default()
            },
            length: 0,
            superblocks: [None; 2],
            incompat,
            ro_compat: 0,
            notes: Vec::new(),
        };
        Ok(Self {
            log,
            parts: vec![Part::new(spec, false, budget)?],
            saved: Mutex::new(Saved {
                file,
                parts: Vec::new(),
            }),
            gate: RwLock::default(),
            replace: false,
            choice: choice_of(incompat),
            // Nobody else knows a file that has no name yet.
            writer: 0,
            sealed: false,
            path: path.to_path_buf(),
            aside,
            budget: budget.clone(),
        })
    }

    /// Goes on with the file in `storage`, which is at `place` and will be at `path`.
    pub(super) fn resume(
        storage: Arc<dyn Storage>,
        is_locked: bool,
        place: &Path,
        path: &Path,
        replace: bool,
        budget: &Budget,
    ) -> Result<Self> {
        let file = Opened::open(storage, place)?;
        if file.ro_compat & !KNOWN_RO_COMPAT != 0 {
            return Err(file.error(
                ErrorKind::Newer,
                format!(
                    "feature bit {} of a later version: this program may read the file, not change it",
                    (file.ro_compat & !KNOWN_RO_COMPAT).trailing_zeros()
                ),
            ));
        }
        let mut parts = Vec::new();
        let mut saved = Vec::new();
        for Contents {
            spec,
            range,
            counts,
            entry,
        } in file.all_contents()?
        {
            parts.push(Part {
                lod: entry.lod,
                parent: entry.parent,
                mark: Mutex::new((counts.slabs, counts.source_crc)),
                ..Part::new(&spec, replace, budget)?
            });
            saved.push(SavedPart {
                entry,
                range,
                counts,
            });
        }
        Ok(Self {
            choice: choice_of(file.incompat),
            log: Log::open(&file, is_locked)?,
            parts,
            saved: Mutex::new(Saved { file, parts: saved }),
            gate: RwLock::default(),
            replace,
            writer: 0,
            sealed: false,
            path: path.to_path_buf(),
            aside: None,
            budget: budget.clone(),
        })
    }

    /// Says how bricks that are put from now on are compressed.
    ///
    /// ```
    /// # use brickmarch::{Box3, Budget, Grid, SampleType};
    /// # use brickmarch::store::{Compression, VolumeSpec, VolumeWriter};
    /// # let folder = tempfile::tempdir().unwrap();
    /// let spec = VolumeSpec::new(Grid::new(Box3::from_size([64; 3])), SampleType::U8);
    /// let path = folder.path().join("small.bvol");
    /// let mut writer = VolumeWriter::create(&path, &spec, &Budget::mib(24)).unwrap();
    /// writer.set_compression(Compression::Small);
    /// ```
    pub fn set_compression(&mut self, compression: Compression) {
        self.choice.smallest = compression == Compression::Small;
    }

    /// Adds another volume to the file and gives its number for
    /// [`put_brick_in`](Self::put_brick_in). It is there from the next commit on.
    ///
    /// # Errors
    /// A spec that does not hold, a name that another volume of the file has, too many volumes.
    pub fn add_volume(&mut self, spec: &VolumeSpec) -> Result<usize> {
        spec.validate()
            .map_err(|e| e.context(self.path.display()))?;
        if self
            .parts
            .iter()
            .any(|p| p.lod == 0 && p.spec.name == spec.name)
        {
            return Err(Error::bad_input(format!(
                "{}: there is a volume named {:?} already",
                self.path.display(),
                spec.name
            )));
        }
        self.add_part(Part::new(spec, self.replace, &self.budget)?)
    }

    pub(super) fn add_part(&mut self, part: Part) -> Result<usize> {
        if self.parts.len() >= usize::from(MAX_VOLUMES) {
            return Err(Error::new(
                ErrorKind::LimitExceeded,
                format!("{}: at most {MAX_VOLUMES} volumes", self.path.display()),
            ));
        }
        self.parts.push(part);
        Ok(self.parts.len() - 1)
    }

    /// Bricks per axis of the first volume; brick `[0, 0, 0]` starts at the smallest point of the
    /// domain.
    pub fn bricks(&self) -> [u32; 3] {
        self.parts[0].rules.bricks
    }

    /// What the first volume is.
    pub fn spec(&self) -> &VolumeSpec {
        &self.parts[0].spec
    }

    /// What each volume of the file is, in the order of their numbers.
    pub fn specs(&self) -> impl Iterator<Item = &VolumeSpec> {
        self.parts.iter().map(|p| &p.spec)
    }

    /// Puts a brick of the first volume: `edge^3` raw little-endian samples, `i` fastest (a bit
    /// takes one byte). Samples beyond the domain are ignored. Any order, any thread. A brick of one
    /// value becomes a tile, one of the background is not stored.
    ///
    /// In a new file each brick may be put once between commits; in a file that was opened a brick
    /// replaces what is there.
    ///
    /// The offsets of bricks in the file follow the order of the calls; for bytes that do not depend
    /// on threads put them from one thread, or use [`write_field`](super::write_field).
    ///
    /// # Errors
    /// A brick outside of the lattice, put twice, or of the wrong length; a write that fails.
    pub fn put_brick(&self, brick: [u32; 3], raw: &[u8]) -> Result<()> {
        self.put_brick_in(0, brick, raw)
    }

    /// [`put_brick`](Self::put_brick) into the volume of this number.
    ///
    /// # Errors
    /// As [`put_brick`](Self::put_brick), or no such volume.
    pub fn put_brick_in(&self, volume: usize, brick: [u32; 3], raw: &[u8]) -> Result<()> {
        let _shared = self.gate.read().unwrap_or_else(PoisonError::into_inner);
        let part = self.own_part(volume)?;
        let edge = part.spec.brick_edge as usize;
        let length = edge.pow(3) * part.spec.sample.bytes();
        if raw.len() != length {
            return Err(Error::bad_input(format!(
                "brick {brick:?} of {} bytes instead of {length}",
                raw.len()
            )));
        }
        part.check_inside(brick)?;
        self.log.check()?;
        let mut encoder = self.take_encoder(volume)?;
        encoder.batch.clear();
        encoder.encode(self, brick, raw);
        let result = self.append(&encoder.batch);
        self.give_back(encoder);
        result
    }

    /// Makes a cube of `2^level` bricks per axis from brick `node_min` of the first volume constant.
    /// The part of the cube outside of the domain is ignored.
    ///
    /// # Errors
    /// A cube that does not lie on its own lattice, a value that the sample type cannot hold, or
    /// bricks put twice.
    pub fn put_constant(&self, node_min: [u32; 3], level: u8, value: f64) -> Result<()> {
        self.put_constant_in(0, node_min, level, value)
    }

    /// [`put_constant`](Self::put_constant) into the volume of this number.
    ///
    /// # Errors
    /// As [`put_constant`](Self::put_constant), or no such volume.
    pub fn put_constant_in(
        &self,
        volume: usize,
        node_min: [u32; 3],
        level: u8,
        value: f64,
    ) -> Result<()> {
        let _shared = self.gate.read().unwrap_or_else(PoisonError::into_inner);
        let sample = self.own_part(volume)?.spec.sample;
        self.log.check()?;
        let bits = exact_bits_of(sample, value, "the constant")?;
        self.put_constant_bits(volume, node_min, level, bits)
    }

    pub(crate) fn put_constant_bits(
        &self,
        volume: usize,
        node_min: [u32; 3],
        level: u8,
        bits: u32,
    ) -> Result<()> {
        let part = self.part(volume)?;
        part.check_inside(node_min)?;
        let most = 3 * part.spec.root_level();
        if level > most || node_min.iter().any(|&b| b & ((1u32 << level) - 1) != 0) {
            return Err(Error::bad_input(format!(
                "a cube of level {level} at brick {node_min:?}: it must start at a multiple of its edge, and level {most} is the highest"
            )));
        }
        part.tree().put_constant(node_min, level, bits)
    }

    /// A volume that may be written to: a level of detail is built from its samples only.
    fn own_part(&self, volume: usize) -> Result<&Part> {
        let part = self.part(volume)?;
        if part.lod != 0 {
            return Err(Error::bad_input(format!(
                "{}: volume number {volume} is a level of detail of volume {}: change that one and build the levels again",
                self.path.display(),
                part.parent
            )));
        }
        Ok(part)
    }

    fn part(&self, volume: usize) -> Result<&Part> {
        self.parts.get(volume).ok_or_else(|| {
            Error::bad_input(format!(
                "{}: volume number {volume} of {}",
                self.path.display(),
                self.parts.len()
            ))
        })
    }

    pub(crate) fn take_encoder(&self, volume: usize) -> Result<BrickEncoder> {
        let free = self.parts[volume]
            .encoders
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .pop();
        free.map_or_else(|| self.new_encoder(volume, 1), Ok)
    }

    pub(crate) fn give_back(&self, encoder: BrickEncoder) {
        self.parts[encoder.batch.volume]
            .encoders
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(encoder);
    }

    /// Bytes that [`new_encoder`](Self::new_encoder) takes from the budget.
    pub(crate) fn encoder_charge(&self, volume: usize, bricks: u64) -> u64 {
        let part = &self.parts[volume];
        let (sample, edge) = (part.spec.sample, part.spec.brick_edge);
        let raw = u64::from(edge).pow(3) * sample.bytes() as u64;
        encoder_bytes(sample, edge) + 2 * raw + part.batch_bytes(bricks)
    }

    /// Buffers for batches of `bricks` bricks of a volume.
    pub(crate) fn new_encoder(&self, volume: usize, bricks: u64) -> Result<BrickEncoder> {
        let permit = self
            .budget
            .take(self.encoder_charge(volume, bricks), "compressing bricks")?;
        let mut encoder = BrickEncoder::new(volume, permit);
        let bytes = self.parts[volume].batch_bytes(bricks) as usize;
        encoder.batch.bytes.reserve_exact(bytes);
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
        if refs.is_empty() {
            return Ok(0);
        }
        self.log.reserve(&batch.bytes, &refs)
    }

    /// Second half of [`append`](Self::append), any time later.
    pub(crate) fn write_reserved(&self, batch: &Batch, offset: u64) -> Result<()> {
        if !batch.bytes.is_empty() {
            self.log.write_reserved(&batch.bytes, offset)?;
        }
        let part = &self.parts[batch.volume];
        let mut tree = part.tree();
        for &(brick, ref encoded) in &batch.bricks {
            match *encoded {
                Encoded::Constant(bits) => tree.put_constant(brick, 0, bits)?,
                Encoded::Brick(mut reference, range) => {
                    reference.offset += offset;
                    tree.put_child(brick, reference, range)?;
                }
            }
        }
        Ok(())
    }

    /// Makes everything put so far part of the file and gives the generation. When it returns, the
    /// data would survive a kill and a loss of power. With nothing new it gives the last generation.
    ///
    /// # Errors
    /// A failed write, of this call or of a put before it: the commit is given up, the file stays at
    /// its last generation, and what was put must be put again; the writer may go on. `ForeignWriter`
    /// when another writer has changed the file, `Poisoned` after a failed sync: from then on every
    /// call fails, and the file must be opened again.
    pub fn commit(&self) -> Result<u64> {
        self.publish(self.writer)
    }

    /// Commits, and gives a new file its final name.
    ///
    /// # Errors
    /// As [`commit`](Self::commit), or a rename that fails; a new file is then not there.
    pub fn finish(mut self) -> Result<VolumeInfo> {
        self.publish(if self.replace { self.writer } else { 0 })?;
        if let Some(aside) = self.aside.take() {
            aside.rename(&self.path)?;
        }
        self.info()
    }

    /// The same, for a file that has a temporary name.
    pub(super) fn with_aside(mut self, aside: Aside) -> Self {
        self.aside = Some(aside);
        self
    }

    /// Slabs that a running import has committed.
    pub(super) fn committed_slabs(&self) -> u32 {
        let saved = self.saved.lock().unwrap_or_else(PoisonError::into_inner);
        saved.parts.first().map_or(0, |p| p.counts.slabs)
    }

    /// Leaves an unfinished new file under its temporary name.
    pub(super) fn keep(mut self) {
        if let Some(aside) = self.aside.take() {
            aside.keep();
        }
    }

    /// What the last commit has of the first volume.
    pub(super) fn info(&self) -> Result<VolumeInfo> {
        let saved = self.saved.lock().unwrap_or_else(PoisonError::into_inner);
        let length = self
            .log
            .storage
            .len()
            .map_err(|e| Error::io(&self.path, "asking for the length", e))?;
        let part = &saved.parts[0];
        Ok(info_of(
            &self.parts[0].spec,
            part.range,
            &part.counts,
            part.entry.root_level,
            &saved.file.root,
            length,
        ))
    }
}

fn choice_of(incompat: u64) -> Choice {
    Choice {
        rows: incompat & INCOMPAT_ROWS != 0,
        fitted: incompat & INCOMPAT_FITTED != 0,
        binary: incompat & INCOMPAT_BINARY != 0,
        smallest: false,
    }
}

/// Whether the file is locked now: some network file systems have no locks, and only the fence
/// remains.
pub(super) fn take_lock(storage: &dyn Storage, path: &Path) -> Result<bool> {
    match storage.lock() {
        Ok(true) => Ok(true),
        Ok(false) => Err(Error::new(
            ErrorKind::ForeignWriter,
            format!("{}: locked by another writer", path.display()),
        )),
        Err(_) => Ok(false),
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
    root: &Superblock,
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
        generation: root.generation,
        sealed: root.sealed,
        unfinished_slabs: (counts.slabs != 0).then_some(counts.slabs),
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
