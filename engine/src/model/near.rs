//! A field near its surface: where no sample around is on the other side, one value stands for all.

use crate::error::Result;
use crate::field::{Field, Range, Samples};
use crate::lattice::{Box3, Grid};
use crate::sample::{Inside, Kind};

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
}

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
        }
    }

    /// Value of regions that are outside.
    pub fn outside(&self) -> f32 {
        self.outside
    }

    fn far(&self, region: Box3) -> Result<Option<f32>> {
        let around = region.grow(2, 2).intersect(&self.field.grid().domain);
        let range = self.field.range(around)?;
        if range.has_nan || range.min > range.max {
            return Ok(None);
        }
        let side = self.field.kind().inside();
        let [low, high] = [range.min, range.max].map(|v| side.contains(v, self.iso));
        Ok(match (low, high) {
            (true, true) => Some(self.inside),
            (false, false) => Some(self.outside),
            _ => None,
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
        let Some(value) = self.far(region)? else {
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
        match self.far(region)? {
            Some(value) => Ok(Range::of(value)),
            None => Ok(self
                .field
                .range(region)?
                .union(Range::of(self.inside))
                .union(Range::of(self.outside))),
        }
    }
}
