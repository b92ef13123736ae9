//! The samples of another field as a function of space: trilinear between them, the nearest one
//! beyond their border.

use super::graph::{Graph, Id};
use super::interval::Interval;
use super::oracle::Oracle;
use crate::error::{Error, Result};
use crate::field::{Field, Samples};
use crate::lattice::{Affine, Box3};
use std::sync::Arc;

/// Most samples that are read for one batch of points.
const MAX_READ: u64 = 1 << 18;

/// Up to this many samples a range is that of the values, beyond it that which the field knows.
const MAX_EXACT: u64 = 1 << 15;

/// A field to be used as a shape.
#[derive(Clone)]
pub struct Sampled {
    field: Arc<dyn Field + Send + Sync>,
    name: String,
    world_to_index: Affine,
}

impl std::fmt::Debug for Sampled {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.name, self.field.grid().domain)
    }
}

impl Sampled {
    /// The samples of `field`; `name` is for messages.
    ///
    /// # Errors
    /// When the field is empty, or its map to the world cannot be turned around.
    pub fn new(field: Arc<dyn Field + Send + Sync>, name: &str) -> Result<Sampled> {
        let grid = field.grid();
        if grid.domain.is_empty() {
            return Err(Error::bad_input(format!("{name}: it has no samples")));
        }
        let world_to_index = grid.index_to_world.inverse()?;
        Ok(Sampled {
            field,
            name: name.to_string(),
            world_to_index,
        })
    }

    /// World box of the samples.
    pub fn bounds(&self) -> [[f64; 3]; 2] {
        let (low, high) = self.ends();
        let map = self.field.grid().index_to_world;
        let corners = (0..8).map(|c| {
            map.apply(std::array::from_fn(|a| {
                if c >> a & 1 == 0 { low[a] } else { high[a] }
            }))
        });
        corners.fold(
            [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]],
            |[lo, hi], p| {
                [
                    [0, 1, 2].map(|a| lo[a].min(p[a])),
                    [0, 1, 2].map(|a| hi[a].max(p[a])),
                ]
            },
        )
    }

    /// First and last lattice point.
    pub(super) fn ends(&self) -> ([f64; 3], [f64; 3]) {
        let domain = self.field.grid().domain;
        (
            domain.min.map(f64::from),
            domain.max.map(|v| f64::from(v) - 1.0),
        )
    }

    pub(super) fn spacing(&self) -> [f64; 3] {
        self.field.grid().index_to_world.spacing()
    }

    /// Index of a world point.
    pub(super) fn to_index(&self, g: &mut Graph, p: [Id; 3]) -> [Id; 3] {
        self.world_to_index.rows.map(|[x, y, z, one]| {
            let sum = g.linear(p, [x, y, z]);
            g.add_value(sum, one)
        })
    }

    /// Index of a world point, kept inside of the samples.
    #[inline(always)]
    fn index_of(&self, x: f64, y: f64, z: f64, a: usize) -> f64 {
        let row = &self.world_to_index.rows[a];
        let domain = self.field.grid().domain;
        let (low, high) = (f64::from(domain.min[a]), f64::from(domain.max[a]) - 1.0);
        (row[0] * x + row[1] * y + row[2] * z + row[3]).clamp(low, high)
    }

    /// Indices that a box of world points may have, not kept inside of the samples; nothing where it
    /// has no usable ends. A little more than they are, for what rounding may do to an index.
    fn indices(&self, cube: [Interval; 3]) -> Option<[Interval; 3]> {
        if cube.iter().any(|i| i.nan || i.magnitude() > 1e15) {
            return None;
        }
        Some(self.world_to_index.rows.map(|row| {
            let sum = (0..3).fold(Interval::point(row[3]), |sum, b| {
                sum.add(cube[b].mul(Interval::point(row[b])))
            });
            let slack = 1e-9 * (1.0 + sum.magnitude());
            Interval::new(sum.lo - slack, sum.hi + slack)
        }))
    }

    /// Lattice points of the cells that hold these indices.
    fn reach(&self, indices: [Interval; 3]) -> Box3 {
        let domain = self.field.grid().domain;
        let mut out = domain;
        for a in 0..3 {
            let last = f64::from(domain.max[a]) - 1.0;
            let clamp = |v: f64| v.clamp(f64::from(domain.min[a]), last);
            out.min[a] = clamp(indices[a].lo.floor()) as i32;
            out.max[a] = clamp(indices[a].hi.floor() + 1.0) as i32 + 1;
            // At the last sample the cell before it is used.
            out.min[a] = out.min[a].min((domain.max[a] - 2).max(domain.min[a]));
            // Before the first one the cell behind it.
            out.max[a] = out.max[a].max((out.min[a] + 2).min(domain.max[a]));
        }
        out
    }

    fn block(&self, region: Box3) -> Result<Block> {
        let mut values = vec![0.0; region.count() as usize];
        self.field
            .read(region, &mut Samples::dense(&mut values, region))?;
        let domain = self.field.grid().domain;
        let size = region.size().map(|n| n as usize);
        let strides = [1, size[0], size[0] * size[1]];
        Ok(Block {
            values,
            region,
            last_cell: [0, 1, 2].map(|a| (domain.max[a] - 2).max(domain.min[a])),
            step: [0, 1, 2].map(|a| {
                let single = domain.max[a] - domain.min[a] == 1;
                if single { 0 } else { strides[a] }
            }),
            strides,
        })
    }

    /// The part of the field that a box of indices covers, when it is small enough to be looked at
    /// sample by sample.
    fn part(&self, indices: [Interval; 3], region: Box3) -> Result<Option<Part>> {
        if region.count() > MAX_EXACT {
            return Ok(None);
        }
        let found = self.field.range(region)?;
        if found.has_nan || !found.min.is_finite() || !found.max.is_finite() {
            return Ok(None);
        }
        let values = self.block(region)?.values;
        Ok(Some(Part {
            values: values.into_iter().map(f64::from).collect(),
            size: region.size().map(|n| n as usize),
            ends: [0, 1, 2].map(|a| {
                // In the first cell and in the last one, which may be the same.
                let (first, last) = (f64::from(region.min[a]), f64::from(region.max[a]) - 2.0);
                [indices[a].lo - first, indices[a].hi - last].map(|t| t.clamp(0.0, 1.0))
            }),
            largest: f64::from(found.min.abs().max(found.max.abs())),
        }))
    }
}

/// Samples around the points of one call.
struct Block {
    values: Vec<f32>,
    region: Box3,
    last_cell: [i32; 3],
    /// From a sample to the next one along each axis; 0 where there is only one.
    step: [usize; 3],
    strides: [usize; 3],
}

#[inline(always)]
fn along(t: f64, a: f64, b: f64) -> f64 {
    a * (1.0 - t) + b * t
}

impl Block {
    /// Corners of the cell of an index, and the place in it.
    #[inline(always)]
    fn cell(&self, p: [f64; 3]) -> ([f64; 8], [f64; 3]) {
        let (mut first, mut t) = (0, [0.0; 3]);
        for a in 0..3 {
            // An index is not below the region, where to cut is to round down; nor is a cell.
            let cell = (p[a].floor() as i32).min(self.last_cell[a]);
            t[a] = p[a] - f64::from(cell);
            first += (cell - self.region.min[a]) as usize * self.strides[a];
        }
        let [x, y, z] = self.step;
        let v = |at: usize| f64::from(self.values[first + at]);
        let corners = [
            v(0),
            v(x),
            v(y),
            v(x + y),
            v(z),
            v(x + z),
            v(y + z),
            v(x + y + z),
        ];
        (corners, t)
    }

    #[inline(always)]
    fn value(&self, p: [f64; 3]) -> f64 {
        let (c, t) = self.cell(p);
        let low = along(t[1], along(t[0], c[0], c[1]), along(t[0], c[2], c[3]));
        let high = along(t[1], along(t[0], c[4], c[5]), along(t[0], c[6], c[7]));
        along(t[2], low, high)
    }

    /// Slopes in index space.
    fn slopes(&self, p: [f64; 3]) -> [f64; 3] {
        let (c, t) = self.cell(p);
        let x: [f64; 4] = std::array::from_fn(|i| along(t[0], c[2 * i], c[2 * i + 1]));
        let y = [along(t[1], x[0], x[1]), along(t[1], x[2], x[3])];
        let dx: [f64; 4] = std::array::from_fn(|i| c[2 * i + 1] - c[2 * i]);
        [
            along(t[2], along(t[1], dx[0], dx[1]), along(t[1], dx[2], dx[3])),
            along(t[2], x[1] - x[0], x[3] - x[2]),
            y[1] - y[0],
        ]
    }
}

/// Samples of the cells that a box of indices meets, and where the box begins in the first and ends
/// in the last of them. Between samples values are linear along each axis, so the extremes over the
/// box are at its corners and where it meets the lattice.
#[derive(Clone)]
struct Part {
    values: Vec<f64>,
    size: [usize; 3],
    ends: [[f64; 2]; 3],
    largest: f64,
}

impl Part {
    /// Puts the values at the ends of the box in the place of the samples beyond them.
    fn cut(&mut self, axis: usize) {
        let n = self.size[axis];
        if n < 2 {
            return;
        }
        let stride: usize = self.size[..axis].iter().product();
        let [t, u] = self.ends[axis];
        for group in self.values.chunks_exact_mut(stride * n) {
            for i in 0..stride {
                let at = |k: usize| i + k * stride;
                let low = along(t, group[at(0)], group[at(1)]);
                let high = along(u, group[at(n - 2)], group[at(n - 1)]);
                group[at(0)] = low;
                group[at(n - 1)] = high;
            }
        }
    }

    /// Differences between neighbours along an axis in the place of values; none where there is one
    /// sample only.
    fn differences(&mut self, axis: usize) {
        let n = self.size[axis];
        if n < 2 {
            self.values = vec![0.0];
            return;
        }
        let stride: usize = self.size[..axis].iter().product();
        let mut out = Vec::with_capacity(self.values.len());
        for group in self.values.chunks_exact(stride * n) {
            let (low, high) = (&group[..stride * (n - 1)], &group[stride..]);
            out.extend(low.iter().zip(high).map(|(a, b)| b - a));
        }
        self.values = out;
    }

    /// The extremes of what is there, and room for the rounding of interpolations.
    fn range(&self) -> Interval {
        let room = 1e-14 * self.largest + 1e-300;
        let (lo, hi) = self
            .values
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), &v| {
                (lo.min(v), hi.max(v))
            });
        Interval::new(lo - room, hi + room)
    }
}

impl Oracle for Sampled {
    fn values(&self, p: [&[f64]; 3], out: &mut [f64]) -> Result<()> {
        let ends = |v: &[f64]| {
            let mut ends = Interval::new(f64::INFINITY, f64::NEG_INFINITY);
            for &v in v {
                ends.lo = ends.lo.min(v);
                ends.hi = ends.hi.max(v);
                ends.nan |= !v.is_finite();
            }
            ends
        };
        let region = self.indices(p.map(ends)).map(|i| self.reach(i));
        let n = out.len();
        match region {
            Some(region) if region.count() <= MAX_READ || n == 1 => {
                let block = self.block(region)?;
                let [x, y, z] = p.map(|c| &c[..n]);
                for (i, o) in out.iter_mut().enumerate() {
                    let (x, y, z) = (x[i], y[i], z[i]);
                    let of = |a| self.index_of(x, y, z, a);
                    *o = block.value([of(0), of(1), of(2)]);
                }
            }
            None if n == 1 => out[0] = f64::NAN,
            _ => {
                let (low, high) = out.split_at_mut(n / 2);
                self.values(p.map(|c| &c[..n / 2]), low)?;
                self.values(p.map(|c| &c[n / 2..]), high)?;
            }
        }
        Ok(())
    }

    fn range(&self, cube: [Interval; 3]) -> Result<Interval> {
        let Some(indices) = self.indices(cube) else {
            return Ok(Interval::ANY);
        };
        let region = self.reach(indices);
        if cube.iter().all(|i| i.lo == i.hi) {
            let [x, y, z] = cube.map(|i| i.lo);
            let index = [0, 1, 2].map(|a| self.index_of(x, y, z, a));
            return Ok(Interval::point(self.block(region)?.value(index)));
        }
        if let Some(mut part) = self.part(indices, region)? {
            (0..3).for_each(|axis| part.cut(axis));
            return Ok(part.range());
        }
        let found = self.field.range(region)?;
        if found.min > found.max {
            return Ok(Interval::ANY);
        }
        let out = Interval {
            lo: f64::from(found.min),
            hi: f64::from(found.max),
            nan: found.has_nan || found.min.is_infinite() || found.max.is_infinite(),
        };
        // Interpolation between equal corners still rounds.
        Ok(out.widened())
    }

    fn slopes(&self, cube: [Interval; 3]) -> Result<[Interval; 3]> {
        let rows = self.world_to_index.rows;
        let to_world = |d: [Interval; 3]| {
            [0, 1, 2].map(|b| {
                (0..3).fold(Interval::ZERO, |sum, a| {
                    sum.add(d[a].mul(Interval::point(rows[a][b])))
                })
            })
        };
        let Some(indices) = self.indices(cube) else {
            return Ok([Interval::REAL; 3]);
        };
        let region = self.reach(indices);
        let (low, high) = self.ends();
        if cube.iter().all(|i| i.lo == i.hi) {
            let world = cube.map(|i| i.lo);
            let raw = self.world_to_index.apply(world);
            let [x, y, z] = world;
            let index = [0, 1, 2].map(|a| self.index_of(x, y, z, a));
            let slopes = self.block(region)?.slopes(index);
            // Beyond the border the nearest sample stands: flat.
            return Ok(to_world([0, 1, 2].map(|a| {
                let inside = low[a] < high[a] && raw[a] >= low[a] && raw[a] <= high[a];
                Interval::point(if inside { slopes[a] } else { 0.0 })
            })));
        }
        let Some(part) = self.part(indices, region)? else {
            let range = self.range(cube)?;
            let most = range.hi - range.lo;
            if range.nan || !most.is_finite() {
                return Ok([Interval::REAL; 3]);
            }
            // Neighbours differ by no more than the samples around do.
            return Ok(to_world([Interval::new(-most, most); 3]));
        };
        let mut d = [Interval::ZERO; 3];
        for (axis, d) in d.iter_mut().enumerate() {
            let mut own = part.clone();
            own.differences(axis);
            let width = own.size[axis].max(2) - 1;
            own.size[axis] = width;
            (0..3).filter(|&a| a != axis).for_each(|a| own.cut(a));
            *d = own.range();
            let leaves = indices[axis].lo < low[axis] || indices[axis].hi > high[axis];
            if leaves {
                *d = d.hull(Interval::ZERO);
            }
        }
        Ok(to_world(d))
    }

    fn rounding(&self, cube: [Interval; 3]) -> Result<f64> {
        let Some(indices) = self.indices(cube) else {
            return Ok(f64::INFINITY);
        };
        let found = self.field.range(self.reach(indices))?;
        if found.has_nan || found.min > found.max {
            return Ok(f64::INFINITY);
        }
        let [low, high] = [found.min, found.max].map(f64::from);
        // An index is a sum of four products.
        let sums = self.world_to_index.rows.map(|row| {
            let parts = (0..3).map(|b| row[b].abs() * cube[b].magnitude());
            parts.sum::<f64>() + row[3].abs()
        });
        let steps = 1.0 + sums.iter().sum::<f64>();
        Ok(1e-14 * (low.abs().max(high.abs()) + (high - low) * steps))
    }
}
