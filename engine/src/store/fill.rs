//! Every brick of a source into a volume: descends an octree by what the source knows to be
//! constant, and makes bricks side by side.

use super::crew::{BATCH_EDGE, Crew, threads_for};
use super::encode::Encoded;
use super::spec::VolumeSpec;
use super::writer::VolumeWriter;
use crate::budget::Budget;
use crate::error::Result;
use crate::lattice::{Box3, morton_decode};
use std::sync::{Mutex, PoisonError};

/// Where bricks come from.
pub(super) trait Bricks: Sync {
    /// The bits of every sample of `region`, where it is known that they are the same.
    fn constant(&self, spec: &VolumeSpec, region: Box3) -> Result<Option<u32>>;

    /// Writes the samples of `region`, one brick cut to the domain, to the lower corner of `raw`.
    fn brick(&self, spec: &VolumeSpec, region: Box3, raw: &mut [u8], room: &mut Room)
    -> Result<()>;

    /// Working space of one thread.
    fn room(&self, spec: &VolumeSpec) -> Room;

    /// Bytes of it.
    fn room_bytes(&self, spec: &VolumeSpec) -> u64;
}

/// Working space for making one brick.
pub(super) struct Room {
    pub(super) values: Vec<f32>,
    pub(super) raw: Vec<u8>,
}

/// Puts every brick of `source` into a volume of `writer`, in Morton order.
pub(super) fn fill_with(
    source: &dyn Bricks,
    writer: &VolumeWriter,
    volume: usize,
    budget: &Budget,
) -> Result<()> {
    let spec = &writer.parts[volume].spec;
    let bricks = spec.bricks();
    let unit = (BATCH_EDGE / spec.brick_edge).max(1).ilog2() as u8;
    let unit_bricks = 8u64.pow(unit.into());
    let raw_bytes = u64::from(spec.brick_edge).pow(3) * spec.sample.bytes() as u64;
    let own_bytes = raw_bytes + source.room_bytes(spec);
    let per_thread = own_bytes + writer.encoder_charge(volume, unit_bricks);
    let threads = threads_for(budget, per_thread);
    budget
        .progress()
        .start(bricks.into_iter().map(u64::from).product());
    let descent = Mutex::new(Descent {
        stack: vec![([0; 3], 3 * spec.root_level())],
        ticket: 0,
    });
    let crew = Crew::default();
    let work = || -> Result<()> {
        let mut encoder = writer.new_encoder(volume, unit_bricks)?;
        let _permit = budget.take(own_bytes, "making a brick")?;
        let mut room = source.room(spec);
        let mut raw = vec![0u8; raw_bytes as usize];
        loop {
            budget.check_cancelled()?;
            if crew.has_failed() {
                return Ok(());
            }
            let next = descent
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .next(source, writer, volume, unit, budget)?;
            let Some((ticket, min)) = next else {
                return Ok(());
            };
            encoder.batch.clear();
            for n in 0..unit_bricks {
                let step = morton_decode(n);
                let brick: [u32; 3] = std::array::from_fn(|a| min[a] + step[a]);
                if (0..3).any(|a| brick[a] >= bricks[a]) {
                    continue;
                }
                budget.progress().add(1);
                let region = spec.brick_box(brick);
                if let Some(bits) = source.constant(spec, region)? {
                    encoder.batch.bricks.push((brick, Encoded::Constant(bits)));
                    continue;
                }
                source.brick(spec, region, &mut raw, &mut room)?;
                encoder.encode(writer, brick, &raw);
            }
            crew.append(ticket, writer, &encoder)?;
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| crew.run(work));
        }
    });
    crew.finish()
}

/// What is left of the octree, in Morton order from the top of the stack.
struct Descent {
    stack: Vec<([u32; 3], u8)>,
    ticket: u64,
}

impl Descent {
    /// The next cube of level `unit` that is not known to be constant, with its ticket. Larger
    /// constant cubes are put on the way.
    fn next(
        &mut self,
        source: &dyn Bricks,
        writer: &VolumeWriter,
        volume: usize,
        unit: u8,
        budget: &Budget,
    ) -> Result<Option<(u64, [u32; 3])>> {
        let spec = &writer.parts[volume].spec;
        let bricks = spec.bricks();
        while let Some((min, level)) = self.stack.pop() {
            if (0..3).any(|a| min[a] >= bricks[a]) {
                continue;
            }
            if level <= unit {
                self.ticket += 1;
                return Ok(Some((self.ticket - 1, min)));
            }
            budget.check_cancelled()?;
            let edge = 1u32 << level;
            if let Some(bits) = source.constant(spec, spec.node_box(min, edge))? {
                writer.put_constant_bits(volume, min, level, bits)?;
                budget.progress().add(
                    (0..3)
                        .map(|a| u64::from((bricks[a] - min[a]).min(edge)))
                        .product(),
                );
                continue;
            }
            for n in (0..8).rev() {
                let step = morton_decode(n);
                self.stack.push((
                    std::array::from_fn(|a| min[a] + step[a] * (edge / 2)),
                    level - 1,
                ));
            }
        }
        Ok(None)
    }
}
