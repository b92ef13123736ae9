//! Coarser levels of a volume: level k has twice the spacing of level k - 1, and each of its samples
//! stands for 2 x 2 x 2 of those (fewer at the upper border), see [`reduce`]. Built brick by brick
//! from the level before, which is read back from the file.

use super::catalog::{Counts, Entry};
use super::fill::{Bricks, Room, fill_with};
use super::open::Opened;
use super::spec::VolumeSpec;
use super::value::{bits_of_key, bits_of_raw, is_nan, key_of};
use super::volume::Volume;
use super::writer::{Part, VolumeWriter};
use crate::error::{Error, Result};
use crate::lattice::{Affine, Box3, Grid};
use crate::sample::{Kind, SampleType};
use std::sync::PoisonError;

/// Most coarser levels of a volume: more than any domain has.
pub(crate) const MAX_LEVELS: u8 = 27;

/// Whether a level with these counts was built from what its parent has now. The checksum of the root
/// page stands for all samples, because each page holds the checksums of what is below it.
pub(super) fn fits(parent: &Entry, level: &Counts) -> bool {
    level.source_crc == parent.root.crc
}

impl VolumeSpec {
    /// The next coarser level: the lattice point `q` stands for the points from `2 (q - q0) + p0`
    /// on, where `p0` and `q0 = floor(p0 / 2)` are the smallest points of the two domains, and lies
    /// in the middle of two of them per axis.
    #[must_use]
    pub fn coarser(&self) -> VolumeSpec {
        let fine = self.grid.domain;
        let min = fine.min.map(|v| v.div_euclid(2));
        let size = fine.size().map(|n| n.div_ceil(2) as i32);
        let domain = Box3::new(min, std::array::from_fn(|a| min[a] + size[a]));
        let offset: [f64; 3] =
            std::array::from_fn(|a| f64::from(fine.min[a]) + 0.5 - 2.0 * f64::from(min[a]));
        let to_world = self.grid.index_to_world;
        let moved = to_world.apply(offset);
        let rows = std::array::from_fn(|r| {
            let [x, y, z, _] = to_world.rows[r];
            [2.0 * x, 2.0 * y, 2.0 * z, moved[r]]
        });
        VolumeSpec {
            grid: Grid {
                domain,
                index_to_world: Affine { rows },
                units: self.grid.units,
            },
            history: String::new(),
            ..self.clone()
        }
    }

    /// Whether the volume is one brick, so that a coarser level gains nothing.
    fn is_one_brick(&self) -> bool {
        self.bricks() == [1; 3]
    }
}

impl VolumeWriter {
    /// Commits, then builds `count` coarser levels of the first volume, or as many as there are
    /// until one is a single brick, each with a commit of its own. Levels that are there and fit the
    /// samples are kept; after samples have changed they are built anew.
    ///
    /// # Errors
    /// As [`commit`](Self::commit), and what reading the level before reports. A level that was not
    /// finished is given up; the writer may go on.
    ///
    /// # Memory
    /// Per thread about 1 MiB of encoded bricks and eight bricks of the level before.
    pub fn build_levels(&mut self, count: u8) -> Result<()> {
        self.commit()?;
        let mut fine = 0;
        for lod in 1..=count.min(MAX_LEVELS) {
            if self.parts[fine].spec.is_one_brick() {
                break;
            }
            let spec = self.parts[fine].spec.coarser();
            let part = match self
                .parts
                .iter()
                .position(|p| (p.lod, p.parent) == (lod, 0))
            {
                Some(part) => part,
                None => {
                    let mut part = Part::new(&spec, self.replace, &self.budget)?;
                    part.lod = lod;
                    self.add_part(part)?
                }
            };
            if !self.level_fits(part) {
                let built = self.build_level(fine, part).and_then(|()| {
                    self.parts[part].set_built(true);
                    self.commit()
                });
                built.inspect_err(|_| self.give_up_level(part))?;
            }
            fine = part;
        }
        Ok(())
    }

    /// Whether a level was built from what the first volume has now.
    fn level_fits(&self, part: usize) -> bool {
        let saved = self.saved.lock().unwrap_or_else(PoisonError::into_inner);
        saved
            .parts
            .get(part)
            .is_some_and(|p| fits(&saved.parts[0].entry, &p.counts))
    }

    /// What was built of a level before something failed is not for the next commit.
    fn give_up_level(&mut self, part: usize) {
        self.parts[part].forget();
        self.log.forget();
        let saved = self.saved.get_mut().unwrap_or_else(PoisonError::into_inner);
        self.parts.truncate(saved.parts.len());
    }

    fn build_level(&self, fine: usize, part: usize) -> Result<()> {
        let (storage, path) = {
            let saved = self.saved.lock().unwrap_or_else(PoisonError::into_inner);
            (saved.file.storage.clone(), saved.file.path.clone())
        };
        let fine = Volume::open_nth(Opened::open(storage, &path)?, fine, &self.budget)?;
        fill_with(&Coarser { fine: &fine }, self, part, &self.budget)
    }
}

/// The bricks of the next coarser level of a volume.
struct Coarser<'a> {
    fine: &'a Volume,
}

impl Coarser<'_> {
    /// The finer samples of a box of local coordinates, cut to the domain.
    fn finer(&self, min: [u32; 3], size: [u32; 3]) -> Box3 {
        let domain = self.fine.spec().grid.domain;
        let at = |a: usize, v: u64| {
            let v = (2 * v).min(u64::from(domain.size()[a]));
            (i64::from(domain.min[a]) + v as i64) as i32
        };
        Box3::new(
            std::array::from_fn(|a| at(a, min[a].into())),
            std::array::from_fn(|a| at(a, u64::from(min[a]) + u64::from(size[a]))),
        )
    }
}

impl Bricks for Coarser<'_> {
    fn constant(&self, spec: &VolumeSpec, region: Box3) -> Result<Option<u32>> {
        let min = spec.grid.domain.local(region.min);
        let range = self.fine.key_range(self.finer(min, region.size()))?;
        let one = range.low == range.high && !range.has_nan;
        Ok(one.then(|| bits_of_key(spec.sample, range.low)))
    }

    fn brick(
        &self,
        spec: &VolumeSpec,
        region: Box3,
        raw: &mut [u8],
        room: &mut Room,
    ) -> Result<()> {
        let min = spec.grid.domain.local(region.min);
        let finer = self.finer(min, region.size());
        let width = spec.sample.bytes();
        let samples = &mut room.raw[..finer.count() as usize * width];
        self.fine.read_raw(finer, samples)?;
        let size = finer.size().map(|n| n as usize);
        let edge = spec.brick_edge as usize;
        reduce(spec.sample, spec.kind, samples, size, raw, edge);
        Ok(())
    }

    fn room(&self, spec: &VolumeSpec) -> Room {
        Room {
            raw: vec![0; room_bytes(spec) as usize],
            values: Vec::new(),
        }
    }

    fn room_bytes(&self, spec: &VolumeSpec) -> u64 {
        room_bytes(spec)
    }
}

fn room_bytes(spec: &VolumeSpec) -> u64 {
    (2 * u64::from(spec.brick_edge)).pow(3) * spec.sample.bytes() as u64
}

/// Halves a dense block of `size` samples; rows of the result are `edge` apart, slices `edge^2`.
///
/// Masks, labels, colours and bits: the value that most of the (up to) eight samples have, of
/// several such the lowest (NaN last). Other integers: their mean, halves to the even neighbour.
/// f32: the sum in f64, along i, then j, then k, divided by their number, rounded to f32; NaN when
/// one of them is.
pub(crate) fn reduce(
    sample: SampleType,
    kind: Kind,
    fine: &[u8],
    size: [usize; 3],
    coarse: &mut [u8],
    edge: usize,
) {
    let width = sample.bytes();
    let by_vote =
        sample == SampleType::Bit || matches!(kind, Kind::Mask | Kind::Label | Kind::Color);
    let [nx, ny, nz] = size;
    for k in 0..nz.div_ceil(2) {
        for j in 0..ny.div_ceil(2) {
            for i in 0..nx.div_ceil(2) {
                let mut cell = [0u32; 8];
                let mut n = 0;
                for z in 2 * k..(2 * k + 2).min(nz) {
                    for y in 2 * j..(2 * j + 2).min(ny) {
                        for x in 2 * i..(2 * i + 2).min(nx) {
                            cell[n] = bits_of_raw(sample, &fine[(x + nx * (y + ny * z)) * width..]);
                            n += 1;
                        }
                    }
                }
                let bits = if by_vote {
                    vote(sample, &mut cell[..n])
                } else {
                    mean(sample, &cell[..n])
                };
                let at = (i + edge * (j + edge * k)) * width;
                coarse[at..at + width].copy_from_slice(&bits.to_le_bytes()[..width]);
            }
        }
    }
}

fn vote(sample: SampleType, cell: &mut [u32]) -> u32 {
    cell.sort_unstable_by_key(|&bits| (is_nan(sample, bits), key_of(sample, bits)));
    let (mut best, mut most) = (cell[0], 0);
    for group in cell.chunk_by(|a, b| a == b) {
        if group.len() > most {
            (best, most) = (group[0], group.len());
        }
    }
    best
}

fn mean(sample: SampleType, cell: &[u32]) -> u32 {
    let n = cell.len() as f64;
    let value = |bits: u32| sample.get(&bits.to_le_bytes());
    // Starts with a sample, not with 0, so that -0 stays. Integers and their sums are exact.
    let sum = cell[1..].iter().fold(value(cell[0]), |s, &b| s + value(b));
    let mean = sum / n;
    if sample == SampleType::F32 {
        return if mean.is_nan() {
            f32::NAN.to_bits()
        } else {
            (mean as f32).to_bits()
        };
    }
    super::value::bits_of(sample, mean.round_ties_even())
}

impl Volume {
    /// Coarser levels that fit the samples.
    pub fn levels(&self) -> u8 {
        self.lods.len() as u8
    }

    /// The volume with `2^level` times the spacing; level 0 is the volume itself, opened once more.
    ///
    /// # Errors
    /// `BadInput` when it was not built, or was built from samples that have changed since.
    pub fn level(&self, level: u8) -> Result<Volume> {
        let number = match level {
            0 => Some(self.number()),
            _ => self.lods.get(usize::from(level) - 1).copied(),
        };
        let Some(number) = number else {
            return Err(Error::bad_input(format!(
                "{}: no level of detail {level}, there are {}: import with levels, or build them",
                self.file().path.display(),
                self.levels()
            )));
        };
        Volume::open_nth(self.file().clone(), number.into(), self.budget())
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Dense, mixed, spec};
    use super::super::{ImportOptions, VolumeWriter, import_with, verify};
    use super::*;
    use crate::Budget;

    /// The dense reduction, written as the definition says.
    fn coarser(dense: &Dense) -> Dense {
        let spec = dense.spec.coarser();
        let domain = dense.spec.grid.domain;
        let raw_at = |p: [i32; 3]| {
            let at = domain.offset_of(p) * spec.sample.bytes();
            spec.sample.get(&dense.raw[at..])
        };
        let vote = spec.sample == SampleType::Bit || spec.kind != Kind::Density;
        let value = |q: [u32; 3]| {
            let p: [i32; 3] = std::array::from_fn(|a| domain.min[a] + 2 * q[a] as i32);
            let cell = Box3::new(p, p.map(|v| v + 2)).intersect(&domain);
            let mut values = Vec::new();
            for k in cell.min[2]..cell.max[2] {
                for j in cell.min[1]..cell.max[1] {
                    for i in cell.min[0]..cell.max[0] {
                        values.push(raw_at([i, j, k]));
                    }
                }
            }
            if vote {
                values.sort_by(f64::total_cmp);
                let count = |v: f64| values.iter().filter(|&&w| w == v).count();
                let most = values.iter().map(|&v| count(v)).max().expect("not empty");
                return *values
                    .iter()
                    .find(|&&v| count(v) == most)
                    .expect("the winner");
            }
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            if spec.sample == SampleType::F32 {
                mean
            } else {
                mean.round_ties_even()
            }
        };
        Dense::new(spec.clone(), value)
    }

    #[test]
    fn levels_equal_the_dense_reduction() {
        let folder = tempfile::tempdir().expect("scratch folder");
        let out = folder.path().join("v.bvol");
        let cases = SampleType::ALL
            .map(|s| (s, Kind::Density))
            .into_iter()
            .chain([(SampleType::U32, Kind::Label), (SampleType::U8, Kind::Mask)]);
        for (sample, kind) in cases {
            let mut spec = spec([75, 64, 37], sample, 8);
            spec.kind = kind;
            let mut dense = Dense::new(spec, |p| {
                if sample == SampleType::Bit {
                    f64::from((p[0] / 3 + p[1] / 5 + p[2]) % 2)
                } else {
                    mixed(p)
                }
            });
            let bytes = |threads: usize| {
                let budget = Budget::mib(24).with_threads(threads);
                let options = ImportOptions {
                    levels: 20,
                    ..ImportOptions::default()
                };
                import_with(&mut &dense.raw[..], &dense.spec, &out, &options, &budget)
                    .expect("imports");
                assert_eq!(budget.used_bytes(), 0);
                std::fs::read(&out).expect("is there")
            };
            assert!(bytes(1) == bytes(3), "{sample:?}");
            let budget = Budget::mib(24);
            let volume = Volume::open(&out, &budget).expect("opens");
            assert_eq!(volume.levels(), 4);
            assert_eq!(volume.names().len(), 1);
            for level in 0..=4 {
                let coarse = volume.level(level).expect("was built");
                if level > 0 {
                    dense = coarser(&dense);
                }
                assert_eq!(coarse.spec().grid, dense.spec.grid);
                dense.check(&coarse, dense.spec.grid.domain);
            }
            assert!(volume.level(5).is_err());
            let report = verify(&out, &budget).expect("verifies");
            assert!(report.is_intact(), "{:?}", report.problems);
        }
    }

    #[test]
    fn levels_of_changed_samples_are_not_shown() {
        let folder = tempfile::tempdir().expect("scratch folder");
        let out = folder.path().join("v.bvol");
        let budget = Budget::mib(24);
        let mut dense = Dense::new(spec([75, 64, 37], SampleType::I16, 8), mixed);
        let options = ImportOptions {
            levels: 2,
            ..ImportOptions::default()
        };
        import_with(&mut &dense.raw[..], &dense.spec, &out, &options, &budget).expect("imports");
        let mut writer = VolumeWriter::open(&out, &budget).expect("opens");
        writer.put_constant([1, 1, 1], 0, 77.0).expect("puts");
        writer.commit().expect("commits");
        let stale = Volume::open(&out, &budget).expect("opens");
        assert_eq!(stale.levels(), 0);
        assert!(stale.level(1).is_err());
        writer.build_levels(2).expect("builds");
        let generation = writer.commit().expect("nothing to do");
        writer.build_levels(2).expect("nothing to do");
        assert_eq!(writer.commit().expect("nothing to do"), generation);
        drop(writer);
        for k in 8..16 {
            for j in 8..16 {
                for i in 8..16usize {
                    let at = (i + 75 * (j + 64 * k)) * 2;
                    dense.raw[at..at + 2].copy_from_slice(&77i16.to_le_bytes());
                }
            }
        }
        let volume = Volume::open(&out, &budget).expect("opens");
        for level in 1..=2 {
            dense = coarser(&dense);
            dense.check(&volume.level(level).expect("built"), dense.spec.grid.domain);
        }
        let report = verify(&out, &budget).expect("verifies");
        assert!(report.is_intact(), "{:?}", report.problems);
    }

    #[test]
    fn rounding_and_votes() {
        let one = |sample: SampleType, kind: Kind, values: &[f64]| {
            let mut raw = vec![0; values.len() * sample.bytes()];
            for (bytes, &v) in raw.chunks_mut(sample.bytes()).zip(values) {
                sample.put(v, bytes);
            }
            let mut out = vec![0; sample.bytes()];
            reduce(sample, kind, &raw, [values.len(), 1, 1], &mut out, 1);
            sample.get(&out)
        };
        use Kind::{Density, Label};
        assert_eq!(one(SampleType::U8, Density, &[1.0, 2.0]), 2.0);
        assert_eq!(one(SampleType::U8, Density, &[2.0, 3.0]), 2.0);
        assert_eq!(one(SampleType::I8, Density, &[-1.0, -2.0]), -2.0);
        assert_eq!(one(SampleType::I8, Density, &[-127.0, -128.0]), -128.0);
        let top = f64::from(u32::MAX);
        assert_eq!(one(SampleType::U32, Density, &[top, top]), top);
        assert_eq!(one(SampleType::U32, Label, &[9.0, 4.0]), 4.0);
        assert_eq!(one(SampleType::I8, Label, &[-3.0, 4.0]), -3.0);
        assert!(one(SampleType::F32, Density, &[-0.0, -0.0]).is_sign_negative());
        assert!(one(SampleType::F32, Density, &[f64::NAN, 1.0]).is_nan());
        assert_eq!(
            one(SampleType::F32, Density, &[3e38, 3e38]),
            f64::from(3e38f32)
        );
        let places = VolumeSpec::new(Grid::new(Box3::new([-3, 4, 0], [6, 9, 1])), SampleType::U8);
        let coarse = places.coarser();
        assert_eq!(coarse.grid.domain, Box3::new([-2, 2, 0], [3, 5, 1]));
        assert_eq!(
            coarse.grid.index_to_world.apply([-2.0, 2.0, 0.0]),
            [-2.5, 4.5, 0.5]
        );
        assert_eq!(
            coarse.grid.index_to_world.apply([0.0, 3.0, 0.0]),
            [1.5, 6.5, 0.5]
        );
    }
}
