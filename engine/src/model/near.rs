//! A field near its surface: where no sample around is on the other side, one value stands for all.

use crate::error::Result;
use crate::field::{Field, Range, Samples};
use crate::lattice::{Box3, Grid};
use crate::sample::{Inside, Kind};
use std::sync::{Mutex, PoisonError};

/// Samples of regions that the surface may come near to, as they are; `inside` or `outside` for
/// all samples of other regions.
///
/// For values without a scale, which cannot be cut to a band. What is near is decided for each
/// region that is asked for, with two samples around it, so every crossed edge and the gradient at
/// it are exact. Meant for writing a volume brick by brick.
pub struct NearSurface<'a> {
    field: &'a dyn Field,
    iso: f32,
    /// Value of regions that are inside.
    inside: f32,
    /// Value of regions that are outside.
    outside: f32,
    /// What was found out last, by a hash of the region: a brick is asked for its range and then read.
    last: Vec<Mutex<Option<(Box3, Nearness)>>>,
}

/// What is known of a region and the samples around it.
#[derive(Clone, Copy)]
enum Nearness {
    /// No surface: one value for all.
    Far(f32),
    /// All values are in this range.
    Near(Range),
}

/// Places for what was found out last: many times the threads there may be.
const LAST: usize = 64;

impl<'a> NearSurface<'a> {
    /// `far` is how much the values away from the surface differ from `iso`.
    pub fn new(field: &'a dyn Field, iso: f32, far: f32) -> NearSurface<'a> {
        let sign = match field.kind().inside() {
            Inside::Above => 1.0,
            Inside::Below => -1.0,
        };
        NearSurface {
            field,
            iso,
            inside: iso + sign * far,
            outside: iso - sign * far,
            last: (0..LAST).map(|_| Mutex::default()).collect(),
        }
    }

    /// Value of regions that are outside.
    pub fn outside(&self) -> f32 {
        self.outside
    }

    fn nearness(&self, region: Box3) -> Result<Nearness> {
        let [x, y, z] = region.min.map(|v| (v >> 3) as usize);
        let place = &self.last[(x ^ y.rotate_left(2) ^ z.rotate_left(4)) % LAST];
        let last = *place.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((known, found)) = last
            && known == region
        {
            return Ok(found);
        }
        let found = self.find(region)?;
        *place.lock().unwrap_or_else(PoisonError::into_inner) = Some((region, found));
        Ok(found)
    }

    fn find(&self, region: Box3) -> Result<Nearness> {
        let around = region.grow(2, 2).intersect(&self.field.grid().domain);
        let range = self.field.range(around)?;
        if range.has_nan || range.min > range.max {
            return Ok(Nearness::Near(range));
        }
        let side = self.field.kind().inside();
        let [low, high] = [range.min, range.max].map(|v| side.contains(v, self.iso));
        Ok(match (low, high) {
            (true, true) => Nearness::Far(self.inside),
            (false, false) => Nearness::Far(self.outside),
            _ => Nearness::Near(range),
        })
    }
}

impl Field for NearSurface<'_> {
    fn grid(&self) -> &Grid {
        self.field.grid()
    }

    fn kind(&self) -> Kind {
        self.field.kind()
    }

    fn block_edge(&self) -> u32 {
        self.field.block_edge()
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()> {
        let Nearness::Far(value) = self.nearness(region)? else {
            return self.field.read(region, out);
        };
        let [nx, ny, nz] = region.size().map(|n| n as usize);
        for k in 0..nz {
            for j in 0..ny {
                out.row_mut(j, k, nx).fill(value);
            }
        }
        Ok(())
    }

    fn range(&self, region: Box3) -> Result<Range> {
        Ok(match self.nearness(region)? {
            Nearness::Far(value) => Range::of(value),
            Nearness::Near(range) => range
                .union(Range::of(self.inside))
                .union(Range::of(self.outside)),
        })
    }
}
