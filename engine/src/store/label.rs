//! The labels of a volume: one of them as a mask, or all as numbers.

use super::value::{bits_of, bits_of_key, f64_of, key_of};
use super::volume::Volume;
use crate::error::{Error, ErrorKind, Result};
use crate::field::{Field, Labels, Range, Samples};
use crate::lattice::{Box3, Grid};
use crate::sample::{Kind, SampleType};

/// 1 where the samples of a volume equal an id, else 0; see [`Volume::label`].
pub struct LabelField<'a> {
    volume: &'a Volume,
    /// Bits of the id; `None` when the type cannot hold it, so that nothing equals it.
    bits: Option<u32>,
}

impl<'a> LabelField<'a> {
    pub(super) fn new(volume: &'a Volume, id: u32) -> Self {
        let sample = volume.spec().sample;
        let bits = bits_of(sample, f64::from(id));
        let exact = f64_of(sample, bits) == f64::from(id);
        Self {
            volume,
            bits: exact.then_some(bits),
        }
    }
}

impl Field for LabelField<'_> {
    fn grid(&self) -> &Grid {
        self.volume.grid()
    }

    fn kind(&self) -> Kind {
        Kind::Mask
    }

    fn block_edge(&self) -> u32 {
        self.volume.block_edge()
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()> {
        let sample = self.volume.spec().sample;
        let (row, slice) = (out.row, out.slice);
        // Equal bits, except that -0 equals 0.
        let wanted = |bits: u32| -> f32 {
            let bits = if sample == SampleType::F32 && bits == 0x8000_0000 {
                0
            } else {
                bits
            };
            f32::from(u8::from(Some(bits) == self.bits))
        };
        self.volume.gather(region, |patch| {
            patch.put_bits(sample, out.values, [row, slice], wanted);
        })
    }

    /// Looks at the range of each node, not at their union, so that a label between two others does
    /// not seem to be where it is not.
    fn range(&self, region: Box3) -> Result<Range> {
        let sample = self.volume.spec().sample;
        let Some(bits) = self.bits else {
            return Ok(Range::of(0.0));
        };
        // -0 sorts below 0.
        let key = key_of(sample, bits);
        let low_key = if sample == SampleType::F32 && bits == 0 {
            key - 1
        } else {
            key
        };
        let mut union = Range::EMPTY;
        self.volume.visit_ranges(region, &mut |range, leaf, _| {
            if union.min < union.max {
                return false;
            }
            if range.is_empty() && !range.has_nan {
                return false;
            }
            let none = range.high < low_key || key < range.low || range.is_empty();
            let all = !range.has_nan && low_key <= range.low && range.high <= key;
            match (none, all) {
                (true, _) => union.add(0.0),
                (_, true) => union.add(1.0),
                _ if leaf => {
                    union = union.union(Range {
                        min: 0.0,
                        max: 1.0,
                        has_nan: false,
                    })
                }
                _ => return true,
            }
            false
        })?;
        Ok(union)
    }

    fn forget(&self, region: Box3) {
        self.volume.forget(region);
    }

    fn blocks_decoded(&self) -> u64 {
        self.volume.blocks_decoded()
    }
}

/// The samples of a volume as segment numbers; see [`Volume::labels`].
pub struct LabelNumbers<'a> {
    volume: &'a Volume,
}

impl<'a> LabelNumbers<'a> {
    pub(super) fn new(volume: &'a Volume) -> Result<Self> {
        let sample = volume.spec().sample;
        if sample == SampleType::F32 {
            return Err(Error::new(
                ErrorKind::Unsupported,
                "samples of type f32 are no segment numbers: import them as an integer type, or mesh one value \
                 with --label",
            ));
        }
        let lowest = volume.range(volume.grid().domain)?.min;
        if lowest < 0.0 {
            return Err(Error::bad_input(format!(
                "segment numbers start at 0, and the lowest sample is {lowest}: mesh one segment with --label"
            )));
        }
        Ok(Self { volume })
    }
}

impl Labels for LabelNumbers<'_> {
    fn grid(&self) -> &Grid {
        self.volume.grid()
    }

    fn block_edge(&self) -> u32 {
        self.volume.block_edge()
    }

    fn read(&self, region: Box3, out: &mut [u32]) -> Result<()> {
        let sample = self.volume.spec().sample;
        let [nx, ny, _] = region.size().map(|n| n as usize);
        // No sample is negative: bits are numbers.
        self.volume.gather(region, |patch| {
            patch.put_bits(sample, out, [nx, nx * ny], |bits| bits);
        })
    }

    fn range(&self, region: Box3) -> Result<Option<[u32; 2]>> {
        let sample = self.volume.spec().sample;
        let range = self.volume.key_range(region)?;
        let number = |key| bits_of_key(sample, key);
        Ok((!range.is_empty()).then(|| [number(range.low), number(range.high)]))
    }

    fn forget(&self, region: Box3) {
        self.volume.forget(region);
    }

    fn blocks_decoded(&self) -> u64 {
        self.volume.blocks_decoded()
    }
}
