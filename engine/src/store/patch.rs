//! Copies what a brick has of a region into the rows of a dense block.

use super::codec::bit_at;
use super::value::bits_of_raw;
use crate::sample::SampleType;

/// The samples that a brick has of a region.
pub(super) struct Patch<'a> {
    /// Place in the region.
    pub(super) to: [usize; 3],
    /// Samples per axis.
    pub(super) size: [usize; 3],
    /// Place in the brick.
    pub(super) from: [usize; 3],
    /// Samples per edge of the brick.
    pub(super) edge: usize,
    pub(super) samples: Stored<'a>,
}

/// The samples of a brick.
#[derive(Clone, Copy)]
pub(super) enum Stored<'a> {
    /// Native little-endian samples.
    Raw(&'a [u8]),
    /// Packed bits.
    Bits(&'a [u8]),
    /// One value, as bits.
    Constant(u32),
}

impl Patch<'_> {
    /// Puts the samples, converted from their bytes by `convert`, to their rows in `out`.
    #[inline(always)]
    pub(super) fn put<T: Copy, const W: usize>(
        &self,
        out: &mut [T],
        [row, slice]: [usize; 2],
        convert: impl Fn([u8; W]) -> T,
    ) {
        let ([i, j, k], [nx, ny, nz], e) = (self.to, self.size, self.edge);
        let start = self.from[0] + e * (self.from[1] + e * self.from[2]);
        if let Stored::Raw(raw) = self.samples {
            let raw = raw.as_chunks::<W>().0;
            for z in 0..nz {
                let from = raw[start + e * e * z..].chunks(e);
                let to = out[i + j * row + (k + z) * slice..].chunks_mut(row);
                let rows = to.zip(from).take(ny);
                match nx {
                    // One sample of each row, as of the neighbour along x.
                    1 => rows.for_each(|(to, from)| to[0] = convert(from[0])),
                    // Whole arrays of the usual length: a handful of vector moves.
                    16 => rows.for_each(|(to, from)| {
                        let to: &mut [T; 16] = to.first_chunk_mut().expect("the row has room");
                        let from: &[_; 16] = from.first_chunk().expect("a row of the brick");
                        *to = std::array::from_fn(|x| convert(from[x]));
                    }),
                    _ => rows.for_each(|(to, from)| {
                        let both = to[..nx].iter_mut().zip(&from[..nx]);
                        both.for_each(|(to, from)| *to = convert(*from));
                    }),
                }
            }
            return;
        }
        for z in 0..nz {
            for y in 0..ny {
                let values = &mut out[i + (j + y) * row + (k + z) * slice..][..nx];
                let at = start + e * (y + e * z);
                match self.samples {
                    Stored::Constant(bits) => {
                        let bytes = bits.to_le_bytes();
                        let bytes = bytes.first_chunk().expect("samples have at most 4 bytes");
                        values.fill(convert(*bytes));
                    }
                    Stored::Bits(packed) => {
                        let mut bytes = [0; W];
                        for (x, value) in values.iter_mut().enumerate() {
                            bytes[0] = bit_at(packed, at + x);
                            *value = convert(bytes);
                        }
                    }
                    Stored::Raw(_) => unreachable!("copied above"),
                }
            }
        }
    }

    /// [`put`](Self::put) of the bits of each sample, for conversions that depend on the type.
    pub(super) fn put_bits<T: Copy>(
        &self,
        sample: SampleType,
        out: &mut [T],
        step: [usize; 2],
        convert: impl Fn(u32) -> T,
    ) {
        match sample.bytes() {
            1 => self.put(out, step, |b: [u8; 1]| convert(bits_of_raw(sample, &b))),
            2 => self.put(out, step, |b: [u8; 2]| convert(bits_of_raw(sample, &b))),
            _ => self.put(out, step, |b: [u8; 4]| convert(bits_of_raw(sample, &b))),
        }
    }
}
