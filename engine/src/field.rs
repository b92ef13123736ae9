//! Where samples come from: anything that gives samples for a box and a conservative value range
//! for a box. Queries and the mesher know only this trait.

use crate::error::{Error, Result};
use crate::lattice::{Box3, Grid};
use crate::sample::Kind;

mod pin;
pub use pin::Pin;
pub(crate) use pin::{SamplesAt, WithSamples};

/// Smallest and largest value in a box, NaN aside, and whether there may be a NaN.
///
/// A range is *conservative*: it may be wider than the truth, never narrower. -0 counts as below +0,
/// so that a range of one value says all bits of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Not larger than any value; `+inf` when there is none.
    pub min: f32,
    /// Not smaller than any value; `-inf` when there is none.
    pub max: f32,
    /// Whether a sample may be NaN.
    pub has_nan: bool,
}

impl Range {
    /// The range of nothing.
    pub const EMPTY: Range = Range {
        min: f32::INFINITY,
        max: f32::NEG_INFINITY,
        has_nan: false,
    };

    /// The range that says nothing.
    pub const UNKNOWN: Range = Range {
        min: f32::NEG_INFINITY,
        max: f32::INFINITY,
        has_nan: true,
    };

    /// The range of one value.
    pub fn of(value: f32) -> Range {
        let mut range = Range::EMPTY;
        range.add(value);
        range
    }

    /// The range of all `values`.
    pub fn of_slice(values: &[f32]) -> Range {
        let mut range = Range::EMPTY;
        values.iter().for_each(|&v| range.add(v));
        range
    }

    /// Includes `value`.
    #[inline]
    pub fn add(&mut self, value: f32) {
        if value.is_nan() {
            self.has_nan = true;
            return;
        }
        // -0 below +0.
        if value.total_cmp(&self.min).is_lt() {
            self.min = value;
        }
        if value.total_cmp(&self.max).is_gt() {
            self.max = value;
        }
    }

    /// The range of both.
    #[must_use]
    pub fn union(self, other: Range) -> Range {
        let low = |a: f32, b: f32| if b.total_cmp(&a).is_lt() { b } else { a };
        let high = |a: f32, b: f32| if b.total_cmp(&a).is_gt() { b } else { a };
        Range {
            min: low(self.min, other.min),
            max: high(self.max, other.max),
            has_nan: self.has_nan || other.has_nan,
        }
    }
}

/// A dense block that receives samples: `values[i + row * j + slice * k]`, `i` fastest.
#[derive(Debug)]
pub struct Samples<'a> {
    /// The receiving array.
    pub values: &'a mut [f32],
    /// Distance between rows (j to j + 1).
    pub row: usize,
    /// Distance between slices (k to k + 1).
    pub slice: usize,
}

impl<'a> Samples<'a> {
    /// A block without gaps for `region`.
    pub fn dense(values: &'a mut [f32], region: Box3) -> Self {
        let [nx, ny, _] = region.size().map(|n| n as usize);
        Self {
            values,
            row: nx,
            slice: nx * ny,
        }
    }

    /// Row `j`, `k` of a region that is `nx` wide.
    #[inline]
    pub fn row_mut(&mut self, j: usize, k: usize, nx: usize) -> &mut [f32] {
        let start = j * self.row + k * self.slice;
        &mut self.values[start..start + nx]
    }
}

/// Anything that gives samples for a box and a conservative value range for a box.
pub trait Field: Sync {
    /// Domain and place in the world.
    fn grid(&self) -> &Grid;

    /// What the samples mean.
    fn kind(&self) -> Kind {
        Kind::Density
    }

    /// Edge of the blocks that are cheap to read, a power of two from 8 to 32; blocks are anchored
    /// at `grid().domain.min`.
    fn block_edge(&self) -> u32 {
        32
    }

    /// Writes the samples of `region`, which lies inside the domain, to `out`.
    ///
    /// # Errors
    /// What the source of the samples reports; the content of `out` is then unspecified.
    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()>;

    /// A conservative range of the samples in `region` (the part of it inside the domain).
    ///
    /// # Errors
    /// What the source of the samples reports.
    fn range(&self, region: Box3) -> Result<Range>;

    /// Holds the samples of the block around `point`, which lies in the domain, for somebody who wants
    /// single ones of them.
    ///
    /// # Errors
    /// What the source of the samples reports.
    ///
    /// # Memory
    /// At most a block of `block_edge` samples as f32, for which the caller has a permit; volumes
    /// hold the brick in their cache instead.
    fn pin(&self, point: [i32; 3]) -> Result<Pin> {
        let (domain, edge) = (self.grid().domain, self.block_edge());
        let low = domain.local(point).map(|v| v / edge * edge);
        let min: [i32; 3] = std::array::from_fn(|a| domain.min[a].wrapping_add_unsigned(low[a]));
        let max = min.map(|v| v.saturating_add_unsigned(edge));
        let region = Box3::new(min, max).intersect(&domain);
        let mut values = vec![0.0; region.count() as usize];
        self.read(region, &mut Samples::dense(&mut values, region))?;
        Ok(Pin::values(region, values))
    }

    /// Tells the source that `region` will not be read again soon. A hint.
    fn forget(&self, _region: Box3) {}

    /// How many blocks were decoded from storage so far, where the field keeps count.
    fn blocks_decoded(&self) -> u64 {
        0
    }
}

/// Anything that gives segment numbers for a box: where [`Field`] gives single precision, these are
/// exact up to 2^32.
pub trait Labels: Sync {
    /// Domain and place in the world.
    fn grid(&self) -> &Grid;

    /// See [`Field::block_edge`].
    fn block_edge(&self) -> u32;

    /// Writes the labels of `region`, which lies inside the domain, to `out`, without gaps, `i`
    /// fastest.
    ///
    /// # Errors
    /// What the source reports; the content of `out` is then unspecified.
    fn read(&self, region: Box3, out: &mut [u32]) -> Result<()>;

    /// A conservative lowest and highest label in `region` (the part of it inside the domain);
    /// nothing when that part is empty.
    ///
    /// # Errors
    /// What the source reports.
    fn range(&self, region: Box3) -> Result<Option<[u32; 2]>>;

    /// See [`Field::forget`].
    fn forget(&self, _region: Box3) {}

    /// See [`Field::blocks_decoded`].
    fn blocks_decoded(&self) -> u64 {
        0
    }
}

/// A dense array in memory as a field.
///
/// ```
/// use brickmarch::{Box3, Field, Grid, field::Dense};
/// let field = Dense::new(Grid::new(Box3::from_size([2, 2, 1])), vec![0.0, 1.0, 2.0, 3.0]).unwrap();
/// assert_eq!(field.range(Box3::from_size([2, 1, 1])).unwrap().max, 1.0);
/// ```
#[derive(Clone, Debug)]
pub struct Dense {
    grid: Grid,
    values: Vec<f32>,
    /// What the samples mean.
    pub kind: Kind,
    /// See [`Field::block_edge`].
    pub block_edge: u32,
}

impl Dense {
    /// `values` in lattice order, `i` fastest.
    ///
    /// # Errors
    /// When the number of values is not the number of lattice points.
    pub fn new(grid: Grid, values: Vec<f32>) -> Result<Self> {
        if grid.domain.count() != values.len() as u64 {
            return Err(Error::bad_input(format!(
                "{} values for a domain {} of {} samples",
                values.len(),
                grid.domain,
                grid.domain.count()
            )));
        }
        Ok(Self {
            grid,
            values,
            kind: Kind::Density,
            block_edge: 32,
        })
    }

    /// The values in lattice order.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    fn row(&self, i: i32, j: i32, k: i32, nx: usize) -> &[f32] {
        let start = self.grid.domain.offset_of([i, j, k]);
        &self.values[start..start + nx]
    }
}

impl Field for Dense {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    fn kind(&self) -> Kind {
        self.kind
    }

    fn block_edge(&self) -> u32 {
        self.block_edge
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()> {
        let [nx, ny, nz] = region.size().map(|n| n as usize);
        for k in 0..nz {
            for j in 0..ny {
                let [x, y, z] = region.min;
                out.row_mut(j, k, nx)
                    .copy_from_slice(self.row(x, y + j as i32, z + k as i32, nx));
            }
        }
        Ok(())
    }

    fn range(&self, region: Box3) -> Result<Range> {
        let region = region.intersect(&self.grid.domain);
        let mut range = Range::EMPTY;
        if region.is_empty() {
            return Ok(range);
        }
        for k in region.min[2]..region.max[2] {
            for j in region.min[1]..region.max[1] {
                let row = self.row(region.min[0], j, k, region.size()[0] as usize);
                range = range.union(Range::of_slice(row));
            }
        }
        Ok(range)
    }
}

/// A function of the lattice point as a field. Without a range function nothing can be skipped.
pub struct FromFn<F, R> {
    grid: Grid,
    value: F,
    range: R,
    /// What the samples mean.
    pub kind: Kind,
}

impl<F, R> FromFn<F, R>
where
    F: Fn([i32; 3]) -> f32 + Sync,
    R: Fn(Box3) -> Range + Sync,
{
    /// `value` gives the sample at a point, `range` a conservative range over a box
    /// (`|_| Range::UNKNOWN` is always right, and skips nothing).
    pub fn new(grid: Grid, kind: Kind, value: F, range: R) -> Self {
        Self {
            grid,
            value,
            range,
            kind,
        }
    }
}

impl<F, R> Field for FromFn<F, R>
where
    F: Fn([i32; 3]) -> f32 + Sync,
    R: Fn(Box3) -> Range + Sync,
{
    fn grid(&self) -> &Grid {
        &self.grid
    }

    fn kind(&self) -> Kind {
        self.kind
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()> {
        let [nx, ny, nz] = region.size().map(|n| n as usize);
        let [x, y, z] = region.min;
        for k in 0..nz {
            for j in 0..ny {
                for (i, value) in out.row_mut(j, k, nx).iter_mut().enumerate() {
                    *value = (self.value)([x + i as i32, y + j as i32, z + k as i32]);
                }
            }
        }
        Ok(())
    }

    fn range(&self, region: Box3) -> Result<Range> {
        Ok((self.range)(region.intersect(&self.grid.domain)))
    }
}

/// The part of a field inside a box.
pub struct Crop<'a> {
    inner: &'a dyn Field,
    grid: Grid,
}

impl<'a> Crop<'a> {
    /// # Errors
    /// When `region` is not inside the domain of `field`.
    pub fn new(field: &'a dyn Field, region: Box3) -> Result<Self> {
        let grid = Grid {
            domain: region,
            ..*field.grid()
        };
        if region.is_empty() || !field.grid().domain.contains_box(&region) {
            return Err(Error::bad_input(format!(
                "region {region} is not inside the domain {}",
                field.grid().domain
            )));
        }
        Ok(Self { inner: field, grid })
    }
}

impl Field for Crop<'_> {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    fn kind(&self) -> Kind {
        self.inner.kind()
    }

    fn block_edge(&self) -> u32 {
        self.inner.block_edge()
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()> {
        self.inner.read(region, out)
    }

    fn range(&self, region: Box3) -> Result<Range> {
        self.inner.range(region.intersect(&self.grid.domain))
    }

    fn blocks_decoded(&self) -> u64 {
        self.inner.blocks_decoded()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crop_reads_the_same_samples() {
        let domain = Box3::new([-2, 1, 5], [4, 5, 8]);
        let f = |p: [i32; 3]| (p[0] + 10 * p[1] + 100 * p[2]) as f32;
        let field = FromFn::new(Grid::new(domain), Kind::Density, f, |_| Range::UNKNOWN);
        let region = Box3::new([0, 2, 6], [3, 4, 8]);
        let crop = Crop::new(&field, region).expect("inside");
        let mut values = vec![0.0; region.count() as usize];
        crop.read(region, &mut Samples::dense(&mut values, region))
            .expect("reads");
        assert_eq!(values[0], f(region.min));
        assert_eq!(values[values.len() - 1], f([2, 3, 7]));
        assert!(Crop::new(&field, domain.grow(1, 0)).is_err());
    }

    #[test]
    fn ranges_ignore_nan_but_say_so() {
        let range = Range::of_slice(&[1.0, f32::NAN, -2.0]);
        assert_eq!((range.min, range.max, range.has_nan), (-2.0, 1.0, true));
        assert_eq!(Range::of_slice(&[]), Range::EMPTY);
    }
}
