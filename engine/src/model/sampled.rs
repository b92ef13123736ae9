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

    /// The oracle takes world points, so that a shape may ask for its value alone.
    fn index_of(&self, p: [f64; 3]) -> [f64; 3] {
        let (low, high) = self.ends();
        let index = self.world_to_index.apply(p);
        [0, 1, 2].map(|a| index[a].clamp(low[a], high[a]))
    }

    /// Lattice points around a box of world points.
    fn reach(&self, cube: [Interval; 3]) -> Option<Box3> {
        if cube.iter().any(|i| i.nan || i.magnitude() > 1e15) {
            return None;
        }
        let domain = self.field.grid().domain;
        let mut out = domain;
        for a in 0..3 {
            let row = self.world_to_index.rows[a];
            let mut sum = Interval::point(row[3]);
            for b in 0..3 {
                sum = sum.add(cube[b].mul(Interval::point(row[b])));
            }
            let last = f64::from(domain.max[a]) - 1.0;
            let clamp = |v: f64| v.clamp(f64::from(domain.min[a]), last);
            // A little more, for what rounding may do to an index.
            let slack = 1e-9 * (1.0 + sum.magnitude());
            out.min[a] = clamp((sum.lo - slack).floor()) as i32;
            out.max[a] = clamp((sum.hi + slack).floor() + 1.0) as i32 + 1;
            // At the last sample the cell before it is used.
            out.min[a] = out.min[a].min((domain.max[a] - 2).max(domain.min[a]));
            // Before the first one the cell behind it.
            out.max[a] = out.max[a].max((out.min[a] + 2).min(domain.max[a]));
        }
        Some(out)
    }

    fn block(&self, region: Box3) -> Result<Vec<f32>> {
        let mut values = vec![0.0; region.count() as usize];
        self.field
            .read(region, &mut Samples::dense(&mut values, region))?;
        Ok(values)
    }

    /// Value and slopes in index space from a block that holds the cell of `p`.
    fn cell(&self, p: [f64; 3], region: Box3, values: &[f32]) -> (f64, [f64; 3]) {
        let domain = self.field.grid().domain;
        let mut at = [0i32; 3];
        let mut t = [0.0; 3];
        let mut step = [0usize; 3];
        let size = region.size().map(|n| n as usize);
        let strides = [1, size[0], size[0] * size[1]];
        for a in 0..3 {
            let last_cell = (domain.max[a] - 2).max(domain.min[a]);
            at[a] = (p[a].floor() as i32).clamp(domain.min[a], last_cell);
            t[a] = p[a] - f64::from(at[a]);
            if domain.max[a] - domain.min[a] > 1 {
                step[a] = strides[a];
            }
        }
        let first = region.offset_of(at);
        let corner: [f64; 8] = std::array::from_fn(|c| {
            let shift: usize = (0..3).map(|a| (c >> a & 1) * step[a]).sum();
            f64::from(values[first + shift])
        });
        let along = |t: f64, a: f64, b: f64| a * (1.0 - t) + b * t;
        let x: [f64; 4] = std::array::from_fn(|i| along(t[0], corner[2 * i], corner[2 * i + 1]));
        let y = [along(t[1], x[0], x[1]), along(t[1], x[2], x[3])];
        let dx: [f64; 4] = std::array::from_fn(|i| corner[2 * i + 1] - corner[2 * i]);
        let slopes = [
            along(t[2], along(t[1], dx[0], dx[1]), along(t[1], dx[2], dx[3])),
            along(t[2], x[1] - x[0], x[3] - x[2]),
            y[1] - y[0],
        ];
        (along(t[2], y[0], y[1]), slopes)
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
        let region = self.reach(p.map(ends));
        let n = out.len();
        match region {
            Some(region) if region.count() <= MAX_READ || n == 1 => {
                let values = self.block(region)?;
                for (i, o) in out.iter_mut().enumerate() {
                    let index = self.index_of(p.map(|c| c[i]));
                    *o = self.cell(index, region, &values).0;
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
        let Some(region) = self.reach(cube) else {
            return Ok(Interval::ANY);
        };
        if cube.iter().all(|i| i.lo == i.hi) {
            let index = self.index_of(cube.map(|i| i.lo));
            return Ok(Interval::point(
                self.cell(index, region, &self.block(region)?).0,
            ));
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
        if cube.iter().all(|i| i.lo == i.hi) {
            let world = cube.map(|i| i.lo);
            let (low, high) = self.ends();
            let raw = self.world_to_index.apply(world);
            let Some(region) = self.reach(cube) else {
                return Ok([Interval::REAL; 3]);
            };
            let slopes = self
                .cell(self.index_of(world), region, &self.block(region)?)
                .1;
            // Beyond the border the nearest sample stands: flat.
            return Ok(to_world([0, 1, 2].map(|a| {
                let inside = low[a] < high[a] && raw[a] >= low[a] && raw[a] <= high[a];
                Interval::point(if inside { slopes[a] } else { 0.0 })
            })));
        }
        let range = self.range(cube)?;
        let most = range.hi - range.lo;
        if range.nan || !most.is_finite() {
            return Ok([Interval::REAL; 3]);
        }
        // Neighbours differ by no more than the samples around do.
        Ok(to_world([Interval::new(-most, most); 3]))
    }
}
