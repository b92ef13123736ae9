//! The samples of one block, held so that single ones are quick to read.

use crate::lattice::Box3;
use crate::sample::SampleType;

/// Bytes that stay where they are as long as this is held.
pub(crate) type HeldBytes = Box<dyn AsRef<[u8]> + Send + Sync>;

/// The samples of a box of lattice points. What a volume gives stays in its cache, undecoded further,
/// as long as the pin is held.
pub struct Pin {
    region: Box3,
    /// Lattice point of the first sample of the array, and steps from row to row and slice to slice.
    first: [i32; 3],
    row: usize,
    slice: usize,
    samples: Held,
}

enum Held {
    Constant(f32),
    Values(Vec<f32>),
    Packed(HeldBytes),
    Native(HeldBytes, SampleType),
}

impl Pin {
    /// `value` at every point of `region`.
    pub fn constant(region: Box3, value: f32) -> Pin {
        Pin::held(region, region.min, [0, 0], Held::Constant(value))
    }

    /// `values` of `region`, `i` fastest.
    ///
    /// # Panics
    /// When there are not as many values as points.
    pub fn values(region: Box3, values: Vec<f32>) -> Pin {
        assert_eq!(
            region.count(),
            values.len() as u64,
            "a value for each point"
        );
        let [nx, ny, _] = region.size().map(|n| n as usize);
        Pin::held(region, region.min, [nx, nx * ny], Held::Values(values))
    }

    /// The part `region` of a brick of `edge` samples from `first` on; bits are packed.
    pub(crate) fn native(
        region: Box3,
        first: [i32; 3],
        edge: usize,
        sample: SampleType,
        bytes: HeldBytes,
    ) -> Pin {
        let held = match sample {
            SampleType::Bit => Held::Packed(bytes),
            _ => Held::Native(bytes, sample),
        };
        Pin::held(region, first, [edge, edge * edge], held)
    }

    fn held(region: Box3, first: [i32; 3], [row, slice]: [usize; 2], samples: Held) -> Pin {
        Pin {
            region,
            first,
            row,
            slice,
            samples,
        }
    }

    /// The points that are held.
    #[inline]
    pub fn region(&self) -> &Box3 {
        &self.region
    }

    #[inline]
    fn offset(&self, p: [i32; 3]) -> usize {
        let [i, j, k] = [0, 1, 2].map(|a| p[a].wrapping_sub(self.first[a]) as u32 as usize);
        i + j * self.row + k * self.slice
    }

    /// The sample at a point of the region.
    #[inline]
    pub fn get(&self, p: [i32; 3]) -> f32 {
        let at = self.offset(p);
        match &self.samples {
            Held::Constant(value) => *value,
            Held::Values(values) => values[at],
            Held::Packed(bytes) => f32::from(bytes.as_ref().as_ref()[at / 8] >> (at % 8) & 1),
            Held::Native(bytes, sample) => {
                let bytes = bytes.as_ref().as_ref();
                let width = sample.bytes();
                let mut raw = [0; 4];
                raw[..width].copy_from_slice(&bytes[at * width..][..width]);
                native(*sample, raw)
            }
        }
    }

    /// The eight samples from `p` on, in the order of the corners of a cell (x lowest); `p` and the
    /// point beyond it on every axis lie in the region.
    #[inline]
    pub fn cell(&self, p: [i32; 3]) -> [f32; 8] {
        let start = self.offset(p);
        let at = |c: usize| start + (c & 1) + (c >> 1 & 1) * self.row + (c >> 2) * self.slice;
        match &self.samples {
            Held::Constant(value) => [*value; 8],
            Held::Values(values) => std::array::from_fn(|c| values[at(c)]),
            Held::Packed(_) => std::array::from_fn(|c| {
                self.get(std::array::from_fn(|a| p[a] + (c >> a & 1) as i32))
            }),
            Held::Native(bytes, sample) => {
                let bytes = bytes.as_ref().as_ref();
                match sample.bytes() {
                    1 => std::array::from_fn(|c| native(*sample, [bytes[at(c)], 0, 0, 0])),
                    2 => {
                        let pairs = bytes.as_chunks::<2>().0;
                        std::array::from_fn(|c| {
                            let [a, b] = pairs[at(c)];
                            native(*sample, [a, b, 0, 0])
                        })
                    }
                    _ => {
                        let fours = bytes.as_chunks::<4>().0;
                        std::array::from_fn(|c| native(*sample, fours[at(c)]))
                    }
                }
            }
        }
    }
}

/// The value of a sample whose bytes are the first of `raw`.
#[inline(always)]
fn native(sample: SampleType, raw: [u8; 4]) -> f32 {
    let two = [raw[0], raw[1]];
    match sample {
        SampleType::Bit | SampleType::U8 => f32::from(raw[0]),
        SampleType::I8 => f32::from(raw[0] as i8),
        SampleType::U16 => f32::from(u16::from_le_bytes(two)),
        SampleType::I16 => f32::from(i16::from_le_bytes(two)),
        SampleType::U32 => u32::from_le_bytes(raw) as f32,
        SampleType::I32 => i32::from_le_bytes(raw) as f32,
        SampleType::F32 => f32::from_le_bytes(raw),
    }
}
