//! One brick of a volume, held in the cache while single samples of it are asked for.

use super::cache;
use super::damage::stand_in;
use super::page::Slot;
use super::spare::Brick;
use super::value::f32_of;
use super::volume::Volume;
use crate::error::Result;
use crate::field::Pin;

struct Bytes(cache::Ref<Brick>);

impl AsRef<[u8]> for Bytes {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

impl Volume {
    /// The brick that holds `point`, which lies in the domain.
    pub(super) fn pin_brick(&self, point: [i32; 3]) -> Result<Pin> {
        let (spec, rules) = (&self.spec, &self.rules);
        let edge = spec.brick_edge;
        let brick = spec.grid.domain.local(point).map(|v| v / edge);
        let region = spec.brick_box(brick).intersect(&spec.grid.domain);
        let constant = |bits| Pin::constant(region, f32_of(spec.sample, bits));
        Ok(match self.locate(brick, &mut None)? {
            (Slot::Background, _) => constant(rules.background),
            (Slot::Tile(bits), _) => constant(bits),
            (Slot::Child(reference), range) => match self.brick(brick, reference) {
                Ok(bytes) => Pin::native(
                    region,
                    region.min,
                    edge as usize,
                    spec.sample,
                    Box::new(Bytes(bytes)),
                ),
                Err(e) => {
                    self.damage.substitute(e, region)?;
                    constant(stand_in(rules, range))
                }
            },
        })
    }
}
