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

    /// Steps in the array from row to row and from slice to slice.
    #[inline]
    pub(crate) fn steps(&self) -> [usize; 2] {
        [self.row, self.slice]
    }

    /// Place of a point of the region in the array.
    #[inline]
    pub(crate) fn offset(&self, p: [i32; 3]) -> usize {
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
                match sample.bytes() {
                    1 => native(*sample, [bytes[at], 0, 0, 0]),
                    2 => {
                        let [a, b] = bytes.as_chunks::<2>().0[at];
                        native(*sample, [a, b, 0, 0])
                    }
                    _ => native(*sample, bytes.as_chunks::<4>().0[at]),
                }
            }
        }
    }

    /// Does `work` with the samples.
    #[inline]
    pub(crate) fn with_samples<W: WithSamples>(&self, work: W) -> W::Out {
        match &self.samples {
            Held::Constant(value) => work.run(Same(*value)),
            Held::Values(values) => work.run(Array(values, |v| v)),
            Held::Packed(bytes) => work.run(Bits(bytes.as_ref().as_ref())),
            Held::Native(bytes, sample) => {
                let bytes = bytes.as_ref().as_ref();
                let twos = bytes.as_chunks::<2>().0;
                let fours = bytes.as_chunks::<4>().0;
                match sample {
                    SampleType::Bit | SampleType::U8 => work.run(Array(bytes, f32::from)),
                    SampleType::I8 => work.run(Array(bytes, |b| f32::from(b as i8))),
                    SampleType::U16 => work.run(Array(twos, |b| f32::from(u16::from_le_bytes(b)))),
                    SampleType::I16 => work.run(Array(twos, |b| f32::from(i16::from_le_bytes(b)))),
                    SampleType::U32 => work.run(Array(fours, |b| u32::from_le_bytes(b) as f32)),
                    SampleType::I32 => work.run(Array(fours, |b| i32::from_le_bytes(b) as f32)),
                    SampleType::F32 => work.run(Array(fours, f32::from_le_bytes)),
                }
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

/// Work on many samples of a block, compiled for each way in which they are held.
pub(crate) trait WithSamples {
    /// What comes of it.
    type Out;

    fn run(self, samples: impl SamplesAt) -> Self::Out;
}

/// Samples by their place in the array of a block.
pub(crate) trait SamplesAt {
    fn at(&self, n: usize) -> f32;

    /// The sample at a place and the next one.
    #[inline(always)]
    fn pair(&self, n: usize) -> [f32; 2] {
        [self.at(n), self.at(n + 1)]
    }
}

struct Same(f32);

impl SamplesAt for Same {
    #[inline(always)]
    fn at(&self, _: usize) -> f32 {
        self.0
    }
}

struct Bits<'a>(&'a [u8]);

impl SamplesAt for Bits<'_> {
    #[inline(always)]
    fn at(&self, n: usize) -> f32 {
        f32::from(self.0[n / 8] >> (n % 8) & 1)
    }
}

struct Array<'a, T, F>(&'a [T], F);

impl<T: Copy, F: Fn(T) -> f32> SamplesAt for Array<'_, T, F> {
    #[inline(always)]
    fn at(&self, n: usize) -> f32 {
        (self.1)(self.0[n])
    }

    /// Their bounds are checked once.
    #[inline(always)]
    fn pair(&self, n: usize) -> [f32; 2] {
        let two = &self.0[n..n + 2];
        [(self.1)(two[0]), (self.1)(two[1])]
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
