//! An open volume file: finds bricks through the octree, decodes them into the cache, gathers rows
//! out of them, and answers ranges without touching a brick.

use super::ahead::{AHEAD_BYTES, Ahead};
use super::cache::{self, PageCache};
use super::catalog::{Counts, Entry};
use super::codec::decode;
use super::damage::{Damage, OnDamage, stand_in};
use super::label::{LabelField, LabelNumbers};
use super::layout::{RECORD_HEADER, brick_bytes, record_bytes};
use super::lod::{MAX_LEVELS, fits};
use super::open::{Contents, Opened};
use super::page::{NODES, Page, PageRules, Slot, page_origin, slot_of};
use super::patch::{Patch, Stored};
use super::record::{RecordKind, Ref};
use super::spare::{Brick, Spare};
use super::spec::{VolumeInfo, VolumeSpec, page_edge};
use super::storage::{FileStorage, Storage};
use super::value::KeyRange;
use super::verify::Problem;
use super::writer::{info_of, rules_of};
use crate::budget::{Budget, Permit};
use crate::error::{Error, ErrorKind, Result};
use crate::field::{Field, Pin, Range, Samples};
use crate::lattice::{Box3, Grid, morton_encode};
use crate::sample::{Kind, SampleType};
use std::fs::File;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// An open volume file. Shared by reference between threads; committed bytes never change, so no
/// reader ever waits for a writer.
///
/// # Memory
/// Decoded bricks take at most 3/8 of the budget, node pages 1/12; each thread that decodes takes a
/// buffer of about two bricks; 256 KiB of buffers of bricks are kept for others. All of it is under permit.
pub struct Volume {
    file: Opened,
    /// In the catalog.
    number: u16,
    names: Vec<String>,
    /// Numbers of the coarser levels, where they fit the samples.
    pub(super) lods: Vec<u16>,
    pub(super) spec: VolumeSpec,
    pub(super) rules: PageRules,
    range: KeyRange,
    counts: Counts,
    page_levels: u8,
    pub(super) root: Option<cache::Ref<Page>>,
    /// By offset and place: both, so that entries outlive a refresh and never stand for another.
    pages: PageCache<(u64, u8, u64), Page>,
    bricks: PageCache<(u64, u64), Brick>,
    spare: Arc<Spare>,
    buffers: Mutex<Vec<Buffers>>,
    budget: Budget,
    decoded: AtomicU64,
    pub(super) damage: Damage,
}

/// Working space of one decoding thread.
struct Buffers {
    record: Vec<u8>,
    planes: Vec<u8>,
    ahead: Ahead,
    _permit: Permit,
}

impl Volume {
    /// Opens the newest generation of the file at `path`. Reads a few records, whatever the size of
    /// the file.
    ///
    /// # Errors
    /// `NotAVolume`, `Newer` (naming the feature), `Truncated`, `DamagedRoot`, `Io`.
    pub fn open(path: &Path, budget: &Budget) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io(path, "opening the volume", e))?;
        Self::open_in(Arc::new(FileStorage(file)), path, budget)
    }

    /// Opens the volume in `storage`; `name` is for messages.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_in(storage: Arc<dyn Storage>, name: &Path, budget: &Budget) -> Result<Self> {
        Self::open_nth(Opened::open(storage, name)?, 0, budget)
    }

    /// Opens the volume called `volume` of the file at `path`.
    ///
    /// # Errors
    /// As [`open`](Self::open), or there is no such volume.
    pub fn open_named(path: &Path, volume: &str, budget: &Budget) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io(path, "opening the volume", e))?;
        Self::open_named_in(Arc::new(FileStorage(file)), path, volume, budget)
    }

    /// Opens the volume called `volume` in `storage`; `name` is for messages.
    ///
    /// # Errors
    /// As [`open_named`](Self::open_named).
    pub fn open_named_in(
        storage: Arc<dyn Storage>,
        name: &Path,
        volume: &str,
        budget: &Budget,
    ) -> Result<Self> {
        let file = Opened::open(storage, name)?;
        let entries = file.catalog()?;
        match entries.iter().position(|e| e.lod == 0 && e.name == volume) {
            Some(number) => Self::open_nth(file, number, budget),
            None => Err(file.error(
                ErrorKind::BadInput,
                format!(
                    "no volume named {volume:?}: there are {:?}",
                    names(&entries)
                ),
            )),
        }
    }

    pub(super) fn open_nth(file: Opened, number: usize, budget: &Budget) -> Result<Self> {
        let Part {
            names,
            lods,
            contents:
                Contents {
                    spec,
                    range,
                    counts,
                    entry,
                },
        } = Part::read(&file, number)?;
        let memory = budget.memory_bytes();
        let brick = brick_bytes(spec.sample, spec.brick_edge) as u64;
        let mut volume = Self {
            rules: rules_of(&spec),
            file,
            number: number as u16,
            names,
            lods,
            range,
            counts,
            page_levels: entry.root_level,
            root: None,
            pages: PageCache::with_entry_bytes(budget, memory / 12, page_charge(4096)),
            bricks: PageCache::with_entry_bytes(budget, memory / 8 * 3, brick),
            spare: Spare::new(brick, budget),
            buffers: Mutex::default(),
            budget: budget.clone(),
            decoded: AtomicU64::new(0),
            damage: Damage::default(),
            spec,
        };
        volume.root = volume.load_root(entry.root_level, entry.root, range)?;
        Ok(volume)
    }

    /// The root page, which must have the range of the attributes.
    fn load_root(&self, level: u8, root: Ref, range: KeyRange) -> Result<Option<cache::Ref<Page>>> {
        let mut page = None;
        let mut found = KeyRange::of_bits(self.spec.sample, self.rules.background);
        if !root.is_none() {
            // Without its root nothing of the volume can be found.
            let loaded = self.page(level, [0; 3], root).map_err(|e| match e.kind() {
                ErrorKind::Damaged => Error::new(ErrorKind::DamagedRoot, e.to_string()),
                _ => e,
            })?;
            found = loaded.whole();
            page = Some(loaded);
        }
        if found != range {
            return Err(self.file.error(
                ErrorKind::DamagedRoot,
                "the range in the attributes is not that of the root page",
            ));
        }
        Ok(page)
    }

    /// Goes on to the newest generation of the file; `true` when there is a newer one. What is cached
    /// and did not change stays cached. After an error the volume is as it was.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn refresh(&mut self) -> Result<bool> {
        let file = Opened::open(self.file.storage.clone(), &self.file.path)?;
        if file.root.generation == self.file.root.generation {
            return Ok(false);
        }
        self.show(file)?;
        Ok(true)
    }

    /// The same volume as it was at `generation`, as another reader with caches of its own.
    /// Generations stay readable until the file is compacted.
    ///
    /// # Errors
    /// `BadInput` when there is no such generation, or the volume was not there yet; `Damaged` when
    /// the way back to it is.
    pub fn open_generation(&self, generation: u64) -> Result<Self> {
        let mut file = Opened::open(self.file.storage.clone(), &self.file.path)?;
        file.go_back(generation)?;
        if usize::from(self.number) >= file.catalog()?.len() {
            return Err(file.error(
                ErrorKind::BadInput,
                format!("generation {generation} has no volume {:?}", self.spec.name),
            ));
        }
        Self::open_nth(file, self.number.into(), &self.budget)
    }

    /// Replaces what is shown by the root of `file`, which is the same file.
    fn show(&mut self, file: Opened) -> Result<()> {
        let Part {
            names,
            lods,
            contents:
                Contents {
                    spec,
                    range,
                    counts,
                    entry,
                },
        } = Part::read(&file, self.number.into())?;
        if rules_of(&spec) != self.rules || spec.grid != self.spec.grid {
            return Err(file.error(ErrorKind::BadInput, "another file is in its place"));
        }
        let before = std::mem::replace(&mut self.file, file);
        match self.load_root(entry.root_level, entry.root, range) {
            Ok(root) => self.root = root,
            Err(e) => {
                self.file = before;
                return Err(e);
            }
        }
        (self.spec, self.range, self.counts) = (spec, range, counts);
        (self.names, self.lods, self.page_levels) = (names, lods, entry.root_level);
        Ok(())
    }

    /// Generation of the file that is shown: 1 for a new file, one more for each commit.
    pub fn generation(&self) -> u64 {
        self.file.root.generation
    }

    /// A number that tells files apart: the checksum of the 16 random bytes that each file starts
    /// with, which its copies share. With [`generation`](Self::generation) it names what is shown.
    pub fn file_mark(&self) -> u32 {
        self.file.seed
    }

    /// What reads do from now on where the file is damaged.
    pub fn set_on_damage(&mut self, policy: OnDamage) {
        self.damage.policy = policy;
    }

    /// What was substituted so far, see [`OnDamage::Substitute`]; at most
    /// [`MAX_PROBLEMS`](super::MAX_PROBLEMS) places.
    pub fn substituted(&self) -> Vec<Problem> {
        self.damage.found()
    }

    pub(super) fn number(&self) -> u16 {
        self.number
    }

    pub(super) fn file(&self) -> &Opened {
        &self.file
    }

    pub(super) fn budget(&self) -> &Budget {
        &self.budget
    }

    /// Names of the volumes of the file; [`open`](Self::open) opens the first.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// What the volume is.
    pub fn spec(&self) -> &VolumeSpec {
        &self.spec
    }

    /// What is known of the volume without reading it.
    ///
    /// # Errors
    /// None today; reading the length of the file may fail one day.
    pub fn info(&self) -> Result<VolumeInfo> {
        let file = &self.file;
        Ok(info_of(
            &self.spec,
            self.range,
            &self.counts,
            self.page_levels,
            &file.root,
            file.length,
        ))
    }

    /// Copies the native samples of `region` to `out`, `i` fastest; a bit takes one byte.
    ///
    /// # Errors
    /// A region that is not inside the domain, an `out` of the wrong length, damage.
    pub fn read_raw(&self, region: Box3, out: &mut [u8]) -> Result<()> {
        let width = self.spec.sample.bytes();
        let count = region.count();
        if count.checked_mul(width as u64) != Some(out.len() as u64) {
            return Err(Error::bad_input(format!(
                "{} bytes for the {count} samples of {region}",
                out.len()
            )));
        }
        let [nx, ny, _] = region.size().map(|n| n as usize);
        let step = [nx, nx * ny];
        self.gather(region, |patch| match width {
            1 => patch.put(out, step, |[b]: [u8; 1]| b),
            2 => patch.put(out.as_chunks_mut::<2>().0, step, |b| b),
            _ => patch.put(out.as_chunks_mut::<4>().0, step, |b| b),
        })
    }

    /// The samples that equal `id` as a mask: 1 where they do, 0 elsewhere. Compared in the type of
    /// the samples, so that 32-bit ids are exact.
    pub fn label(&self, id: u32) -> LabelField<'_> {
        LabelField::new(self, id)
    }

    /// The samples as segment numbers, for all labels in one pass.
    ///
    /// # Errors
    /// `Unsupported` for samples of type f32, `BadInput` when there may be samples below zero.
    pub fn labels(&self) -> Result<LabelNumbers<'_>> {
        LabelNumbers::new(self)
    }

    /// Calls `put(position in the region, samples, run)` for runs that cover `region`.
    pub(super) fn gather(&self, region: Box3, mut put: impl FnMut(Patch<'_>)) -> Result<()> {
        let domain = self.spec.grid.domain;
        if region.is_empty() {
            return Ok(());
        }
        if !domain.contains_box(&region) {
            return Err(Error::bad_input(format!(
                "region {region} is not inside the domain {domain}"
            )));
        }
        let edge = self.spec.brick_edge;
        let (low, size) = (domain.local(region.min), region.size());
        let first = low.map(|v| v / edge);
        let last: [u32; 3] = std::array::from_fn(|a| (low[a] + size[a] - 1) / edge);
        let mut cursor = None;
        for bz in first[2]..=last[2] {
            for by in first[1]..=last[1] {
                for bx in first[0]..=last[0] {
                    let brick = [bx, by, bz];
                    // The common part of brick and region, in the region and in the brick.
                    let start: [u32; 3] = std::array::from_fn(|a| (brick[a] * edge).max(low[a]));
                    let n: [usize; 3] = std::array::from_fn(|a| {
                        ((brick[a] * edge + edge).min(low[a] + size[a]) - start[a]) as usize
                    });
                    let to: [usize; 3] = std::array::from_fn(|a| (start[a] - low[a]) as usize);
                    let from: [usize; 3] =
                        std::array::from_fn(|a| (start[a] - brick[a] * edge) as usize);
                    let (data, constant) = match self.locate(brick, &mut cursor)? {
                        (Slot::Background, _) => (None, self.rules.background),
                        (Slot::Tile(bits), _) => (None, bits),
                        (Slot::Child(reference), range) => match self.brick(brick, reference) {
                            Ok(data) => (Some(data), 0),
                            Err(e) => {
                                self.damage.substitute(e, self.spec.brick_box(brick))?;
                                (None, stand_in(&self.rules, range))
                            }
                        },
                    };
                    let samples = match &data {
                        None => Stored::Constant(constant),
                        Some(bytes) if self.spec.sample == SampleType::Bit => Stored::Bits(bytes),
                        Some(bytes) => Stored::Raw(bytes),
                    };
                    put(Patch {
                        to,
                        size: n,
                        from,
                        edge: edge as usize,
                        samples,
                    });
                }
            }
        }
        Ok(())
    }

    /// What the octree says about a brick, and its range where that is a child; `cursor` remembers
    /// the last page above bricks.
    pub(super) fn locate(
        &self,
        brick: [u32; 3],
        cursor: &mut Option<cache::Ref<Page>>,
    ) -> Result<(Slot, KeyRange)> {
        let at = |page: &Page| {
            let slot = slot_of(brick, page.level);
            (page.slot(slot), page.range(slot))
        };
        if let Some(page) = cursor
            && page.origin == page_origin(brick, 1)
        {
            return Ok(at(page));
        }
        let Some(mut page) = self.root.clone() else {
            return Ok((Slot::Background, KeyRange::empty(self.spec.sample)));
        };
        while page.level > 1 {
            let (Slot::Child(reference), range) = at(&page) else {
                return Ok(at(&page));
            };
            let level = page.level - 1;
            let origin = page_origin(brick, level);
            match self.page(level, origin, reference) {
                Ok(below) => page = below,
                Err(e) => {
                    let lost = self.spec.node_box(origin, page_edge(level));
                    self.damage.substitute(e, lost)?;
                    return Ok((Slot::Tile(stand_in(&self.rules, range)), range));
                }
            }
        }
        let found = at(&page);
        *cursor = Some(page);
        Ok(found)
    }

    /// The range of a brick, of a file that has any; `cursor` as for [`locate`](Self::locate).
    pub(super) fn brick_range(
        &self,
        brick: [u32; 3],
        cursor: &mut Option<cache::Ref<Page>>,
    ) -> Result<KeyRange> {
        match cursor {
            Some(page) if page.origin == page_origin(brick, 1) => {
                Ok(page.range(slot_of(brick, page.level)))
            }
            _ => Ok(self.locate(brick, cursor)?.1),
        }
    }

    pub(super) fn page(
        &self,
        level: u8,
        origin: [u32; 3],
        reference: Ref,
    ) -> Result<cache::Ref<Page>> {
        let key = morton_encode(origin);
        self.pages.get(
            (reference.offset, level, key),
            page_charge(reference.length),
            || {
                let _permit = self
                    .budget
                    .take(record_bytes(reference.length), "reading a node page")?;
                let mut buffer = Vec::new();
                self.file.read_page(
                    &self.rules,
                    self.number,
                    level,
                    origin,
                    reference,
                    &mut buffer,
                )
            },
        )
    }

    fn damaged(&self, place: &str, what: impl std::fmt::Display) -> Error {
        self.file
            .error(ErrorKind::Damaged, format!("{place}: {what}"))
    }

    pub(super) fn brick(&self, brick: [u32; 3], reference: Ref) -> Result<cache::Ref<Brick>> {
        let bytes = self.rules.brick_bytes as usize;
        let key = (reference.offset, morton_encode(brick));
        self.bricks.get(key, bytes as u64, || {
            let mut buffers = self.take_buffers()?;
            let mut out = self.spare.take(bytes);
            let result = self.load_brick(brick, reference, &mut buffers, &mut out);
            self.buffers
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push(buffers);
            result.map(|()| self.spare.brick(out))
        })
    }

    fn take_buffers(&self) -> Result<Buffers> {
        if let Some(free) = self
            .buffers
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .pop()
        {
            return Ok(free);
        }
        let bytes = u64::from(self.rules.brick_bytes);
        let permit = self.budget.take(
            record_bytes(self.rules.brick_bytes) + bytes + AHEAD_BYTES as u64,
            "decoding a brick",
        )?;
        Ok(Buffers {
            // Never grown: growth by doubling would go beyond the permit.
            record: Vec::with_capacity(record_bytes(self.rules.brick_bytes) as usize),
            planes: Vec::with_capacity(bytes as usize),
            ahead: Ahead::default(),
            _permit: permit,
        })
    }

    fn load_brick(
        &self,
        brick: [u32; 3],
        reference: Ref,
        buffers: &mut Buffers,
        out: &mut [u8],
    ) -> Result<()> {
        let place = || format!("{brick:?} (samples {})", self.spec.brick_box(brick));
        let head = self.file.read_record(
            &reference,
            RecordKind::Brick,
            self.number,
            &place,
            &mut buffers.record,
            Some(&mut buffers.ahead),
        )?;
        if head.key != morton_encode(brick) || head.level != 0 || head.decoded as usize != out.len()
        {
            return Err(self.damaged(
                &format!("brick {}", place()),
                "its record has another place or size",
            ));
        }
        let stored = &buffers.record[RECORD_HEADER..][..reference.length as usize];
        decode(
            head.codec,
            stored,
            self.spec.sample,
            self.spec.brick_edge,
            out,
            &mut buffers.planes,
        )
        .map_err(|e| self.damaged(&format!("brick {}", place()), e))?;
        self.decoded.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }
}

/// What a file says of one of its volumes.
struct Part {
    names: Vec<String>,
    lods: Vec<u16>,
    contents: Contents,
}

impl Part {
    fn read(file: &Opened, number: usize) -> Result<Self> {
        let mut entries = file.catalog()?;
        if number >= entries.len() {
            return Err(file.error(ErrorKind::BadInput, "another file is in its place"));
        }
        Ok(Self {
            names: names(&entries),
            lods: lods(file, &entries, number)?,
            contents: file.contents(number as u16, entries.swap_remove(number))?,
        })
    }
}

fn names(entries: &[Entry]) -> Vec<String> {
    let own = entries.iter().filter(|e| e.lod == 0);
    own.map(|e| e.name.clone()).collect()
}

/// Numbers of the coarser levels of volume `number`, from level 1 on without gap; those that were
/// built from other samples are left out.
fn lods(file: &Opened, entries: &[Entry], number: usize) -> Result<Vec<u16>> {
    let mut lods = Vec::new();
    if entries[number].lod != 0 {
        return Ok(lods);
    }
    for lod in 1..=MAX_LEVELS {
        let of_this = |e: &Entry| (e.lod, usize::from(e.parent)) == (lod, number);
        let Some(level) = entries.iter().position(of_this) else {
            break;
        };
        let counts = file.contents(level as u16, entries[level].clone())?.counts;
        if !fits(&entries[number], &counts) {
            break;
        }
        lods.push(level as u16);
    }
    Ok(lods)
}

/// Bytes in memory of a page whose payload has this length, at most.
fn page_charge(length: u32) -> u64 {
    (size_of::<Page>() + NODES * 8) as u64 + u64::from(length)
}

impl Field for Volume {
    fn grid(&self) -> &Grid {
        &self.spec.grid
    }

    fn kind(&self) -> Kind {
        self.spec.kind
    }

    fn block_edge(&self) -> u32 {
        self.spec.brick_edge.min(32)
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()> {
        let sample = self.spec.sample;
        let step = [out.row, out.slice];
        let values = &mut *out.values;
        self.gather(region, |patch| match sample {
            SampleType::Bit | SampleType::U8 => {
                patch.put(values, step, |[b]: [u8; 1]| f32::from(b));
            }
            SampleType::I8 => patch.put(values, step, |[b]: [u8; 1]| f32::from(b as i8)),
            SampleType::U16 => patch.put(values, step, |b| f32::from(u16::from_le_bytes(b))),
            SampleType::I16 => patch.put(values, step, |b| f32::from(i16::from_le_bytes(b))),
            SampleType::U32 => patch.put(values, step, |b| u32::from_le_bytes(b) as f32),
            SampleType::I32 => patch.put(values, step, |b| i32::from_le_bytes(b) as f32),
            SampleType::F32 => patch.put(values, step, f32::from_le_bytes),
        })
    }

    fn range(&self, region: Box3) -> Result<Range> {
        Ok(self.key_range(region)?.to_range(self.spec.sample))
    }

    fn pin(&self, point: [i32; 3]) -> Result<Pin> {
        self.pin_brick(point)
    }

    fn forget(&self, region: Box3) {
        let domain = self.spec.grid.domain;
        let region = region.intersect(&domain);
        if region.is_empty() {
            return;
        }
        let edge = self.spec.brick_edge;
        // Bricks whose part of the domain lies inside the region.
        let first = domain.local(region.min).map(|v| v.div_ceil(edge));
        let last = domain.local(region.max);
        let end: [u32; 3] = std::array::from_fn(|a| {
            if region.max[a] == domain.max[a] {
                last[a].div_ceil(edge)
            } else {
                last[a] / edge
            }
        });
        let mut cursor = None;
        for z in first[2]..end[2] {
            for y in first[1]..end[1] {
                for x in first[0]..end[0] {
                    // Where the index cannot be read there is nothing to forget.
                    if let Ok((Slot::Child(brick), _)) = self.locate([x, y, z], &mut cursor) {
                        let key = (brick.offset, morton_encode([x, y, z]));
                        self.bricks.forget(&key);
                    }
                }
            }
        }
    }

    fn blocks_decoded(&self) -> u64 {
        self.decoded.load(Ordering::Relaxed)
    }
}
