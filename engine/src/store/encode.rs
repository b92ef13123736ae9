//! Bricks of samples into sealed records, in batches, by one thread each.

use super::codec::{Encoder, pack_bits};
use super::layout::RECORD_HEADER;
use super::record::{Head, RecordKind, Ref, seal};
use super::value::{KeyRange, bits_of_raw, scan};
use super::writer::VolumeWriter;
use crate::budget::Permit;
use crate::lattice::morton_encode;
use crate::sample::SampleType;

/// What came out of one brick.
pub(crate) enum Encoded {
    /// Bits of the one value of all samples.
    Constant(u32),
    /// Sealed record in the output of the encoder, relative offset.
    Brick(Ref, KeyRange),
}

/// A batch of encoded bricks in the order of the file.
#[derive(Default)]
pub(crate) struct Batch {
    /// Number of the volume.
    pub(crate) volume: usize,
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

impl BrickEncoder {
    pub(crate) fn new(volume: usize, permit: Permit) -> Self {
        Self {
            encoder: Encoder::default(),
            padded: Vec::new(),
            packed: Vec::new(),
            batch: Batch {
                volume,
                ..Batch::default()
            },
            _permit: permit,
        }
    }

    /// Appends the brick of whole `raw` samples to the batch.
    pub(crate) fn encode(&mut self, writer: &VolumeWriter, brick: [u32; 3], raw: &[u8]) {
        let volume = self.batch.volume;
        let spec = &writer.parts[volume].spec;
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
            self.batch.bricks.push((brick, Encoded::Constant(bits)));
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
            .encode(spec.sample, spec.brick_edge, bytes, writer.choice, out);
        let head = Head {
            codec,
            decoded: bytes.len() as u32,
            key: morton_encode(brick),
            ..Head::new(RecordKind::Brick, writer.log.generation(), volume as u16)
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
