//! Rays through a field: the first crossing of an isovalue, the largest value, the integral.

use super::cubic::Cubic;
use super::cursor::Cursor;
use super::parts::each_part_of;
use super::reach::pass;
use super::stream::check_region;
use crate::budget::{Budget, Permit};
use crate::error::{Error, Result};
use crate::field::{Field, Range};
use crate::lattice::{Box3, Grid};
use std::ops::ControlFlow;

/// Part of the budget that the ranges of blocks may take.
const SHARE: u64 = 16;
/// Rays that one thread takes at a time.
const PART: usize = 256;

/// Points `origin + t * direction` for `t` from 0 on, in index space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts.
    pub origin: [f64; 3],
    /// One step of `t`; of any length but zero.
    pub direction: [f64; 3],
}

impl Ray {
    /// The ray with the same `t` whose origin and direction are given in the world.
    ///
    /// # Errors
    /// When the map of the grid cannot be turned around.
    pub fn from_world(self, grid: &Grid) -> Result<Ray> {
        let map = grid.index_to_world.inverse()?;
        let d = self.direction;
        Ok(Ray {
            origin: map.apply(self.origin),
            direction: map.rows.map(|r| r[0] * d[0] + r[1] * d[1] + r[2] * d[2]),
        })
    }

    /// The point at `t`.
    #[inline]
    pub fn at(&self, t: f64) -> [f64; 3] {
        std::array::from_fn(|a| self.origin[a] + t * self.direction[a])
    }
}

/// Where a ray crosses an isovalue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Parameter of the ray.
    pub t: f64,
    /// Whether the values rise: it comes from below, and is above (`value >= iso`) from here on.
    pub rising: bool,
}

/// The largest value along a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Parameter of the first place that has it.
    pub t: f64,
    /// The value.
    pub value: f64,
}

/// The integral of the values along a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Integral {
    /// Values times steps of `t`.
    pub sum: f64,
    /// Steps of `t` that the ray is in cells with values; cells with a NaN are left out.
    pub length: f64,
}

/// Casts rays through a region of a field. The values are those of the trilinear interpolant; a cell
/// with a corner that is NaN holds nothing, and rays pass through it.
///
/// ```
/// use brickmarch::{Box3, Budget, Grid, field::Dense, query::{Cursor, Ray, Rays}};
/// let grid = Grid::new(Box3::from_size([3, 2, 2]));
/// let field = Dense::new(grid, (0..12).map(|n| (n % 3) as f32).collect()).unwrap();
/// let budget = Budget::mib(4);
/// let rays = Rays::new(&field, grid.domain, &budget).unwrap();
/// let ray = Ray { origin: [-1.0, 0.5, 0.5], direction: [1.0, 0.0, 0.0] };
/// let mut cursor = Cursor::new(&field, &budget).unwrap();
/// let crossing = rays.first_crossing(&mut cursor, &ray, 1.5, 0.0).unwrap().unwrap();
/// assert_eq!((crossing.t, crossing.rising), (2.5, true));
/// ```
///
/// # Memory
/// 12 bytes for each block of the region; larger blocks are taken where that is more than a sixteenth
/// of the budget.
pub struct Rays<'a> {
    field: &'a dyn Field,
    region: Box3,
    /// Blocks of cells: edge, number along each axis, range of the samples of each.
    edge: u64,
    count: [u64; 3],
    ranges: Vec<Range>,
    _permit: Permit,
}

/// What to do with a block.
enum Look {
    Skip,
    Cells,
    Stop,
}

/// A cell that a ray passes.
struct Passed {
    cubic: Cubic,
    start: f64,
}

impl<'a> Rays<'a> {
    /// Prepares for rays through `region`: reads the ranges of its blocks, and no sample.
    ///
    /// # Errors
    /// When `region` is not inside the domain, what the field reports, `Cancelled`, `BudgetExceeded`.
    pub fn new(field: &'a dyn Field, region: Box3, budget: &Budget) -> Result<Self> {
        check_region(field, region)?;
        // Blocks start with those of the field, so that a block needs one brick and its neighbours.
        let domain = field.grid().domain;
        let low = domain.local(region.min).map(u64::from);
        let high = domain.local(region.max).map(u64::from);
        let mut edge = u64::from(field.block_edge());
        let each = size_of::<Range>() as u64;
        let (count, bytes) = loop {
            let count: [u64; 3] = std::array::from_fn(|a| {
                (high[a] - 1).saturating_sub(1).max(low[a]) / edge - low[a] / edge + 1
            });
            let bytes = count.iter().fold(each, |n, &c| n.saturating_mul(c));
            if bytes <= (budget.memory_bytes() / SHARE).max(each) {
                break (count, bytes);
            }
            edge *= 2;
        };
        let permit = budget.take(bytes, "the ranges of the blocks that rays pass")?;
        let mut rays = Self {
            field,
            region,
            edge,
            count,
            ranges: vec![Range::EMPTY; (bytes / each) as usize],
            _permit: permit,
        };
        let mut ranges = std::mem::take(&mut rays.ranges);
        each_part_of(&mut ranges, PART, budget, field, |_, first, part| {
            for (n, range) in part.iter_mut().enumerate() {
                let n = (first + n) as u64;
                let [nx, ny, _] = rays.count;
                let seen = rays.cells_of([n % nx, n / nx % ny, n / nx / ny]).grow(0, 1);
                *range = field.range(seen.intersect(&region))?;
            }
            Ok(())
        })?;
        rays.ranges = ranges;
        Ok(rays)
    }

    /// The field.
    pub fn field(&self) -> &'a dyn Field {
        self.field
    }

    /// Lowest corner of block 0, from that of the domain on.
    fn first_block(&self) -> [u64; 3] {
        let low = self.field.grid().domain.local(self.region.min);
        low.map(|v| u64::from(v) / self.edge)
    }

    /// Cells of a block that belong to the region.
    fn cells_of(&self, block: [u64; 3]) -> Box3 {
        let (domain, first) = (self.field.grid().domain, self.first_block());
        let point = |a: usize, n: u64| {
            let at = i64::from(domain.min[a]) + ((first[a] + n) * self.edge) as i64;
            at.clamp(
                i64::from(self.region.min[a]),
                i64::from(self.region.max[a]) - 1,
            ) as i32
        };
        let min: [i32; 3] = std::array::from_fn(|a| point(a, block[a]));
        let max: [i32; 3] = std::array::from_fn(|a| point(a, block[a] + 1));
        // An axis of one sample has one flat layer of cells.
        Box3::new(min, std::array::from_fn(|a| max[a].max(min[a] + 1)))
    }

    /// The parameters from `from` on between which a ray is within the samples of the region.
    pub fn span(&self, ray: &Ray, from: f64) -> Option<[f64; 2]> {
        let (mut start, mut end) = (from, f64::INFINITY);
        for a in 0..3 {
            let (o, d) = (ray.origin[a], ray.direction[a]);
            let low = f64::from(self.region.min[a]);
            let high = f64::from(self.region.max[a]) - 1.0;
            if !(o.is_finite() && d.is_finite()) {
                return None;
            }
            if d == 0.0 {
                if o < low || o > high {
                    return None;
                }
                continue;
            }
            let (near, far) = ((low - o) / d, (high - o) / d);
            start = start.max(near.min(far));
            end = end.min(near.max(far));
        }
        (start <= end && end.is_finite()).then_some([start, end])
    }

    /// Walks along a ray: `look(range, start, end)` at each block, `cell` at the cells of those that
    /// were asked for.
    fn walk(
        &self,
        cursor: &mut Cursor<'_>,
        ray: &Ray,
        span: [f64; 2],
        walker: &mut dyn Walker,
    ) -> Result<()> {
        let walked = self.pass_blocks(ray, span, |block, range, start, end| {
            match walker.look(range, start, end) {
                Look::Skip => return ControlFlow::Continue(()),
                Look::Stop => return ControlFlow::Break(Ok(())),
                Look::Cells => {}
            }
            let cells = self.cells_of(block);
            let limits = [
                cells.min.map(i64::from),
                cells.max.map(|v| i64::from(v) - 1),
            ];
            pass(
                ray,
                [start, end],
                [0.0; 3],
                1.0,
                limits,
                |cell, start, end| {
                    let cell = cell.map(|v| v as i32);
                    let corners = match cursor.cell(cell) {
                        Ok(corners) => corners,
                        Err(e) => return ControlFlow::Break(Err(e)),
                    };
                    if !walker.near(&corners) {
                        return ControlFlow::Continue(());
                    }
                    let place = ray.at(start);
                    let local = std::array::from_fn(|a| place[a] - f64::from(cell[a]));
                    let passed = Passed {
                        cubic: Cubic::new(corners, local, ray.direction, end - start),
                        start,
                    };
                    match walker.cell(&passed) {
                        true => ControlFlow::Break(Ok(())),
                        false => ControlFlow::Continue(()),
                    }
                },
            )
        });
        match walked {
            ControlFlow::Break(ended) => ended,
            ControlFlow::Continue(()) => Ok(()),
        }
    }

    /// The samples that rays see.
    pub fn region(&self) -> &Box3 {
        &self.region
    }

    /// Passes the blocks along a ray from `t = from` on, in order: `visit(range, start, end)`, until it
    /// breaks. The parts join without a gap.
    pub fn blocks<B>(
        &self,
        ray: &Ray,
        from: f64,
        mut visit: impl FnMut(&Range, f64, f64) -> ControlFlow<B>,
    ) -> ControlFlow<B> {
        match self.span(ray, from) {
            Some(span) => {
                self.pass_blocks(ray, span, |_, range, start, end| visit(range, start, end))
            }
            None => ControlFlow::Continue(()),
        }
    }

    fn pass_blocks<B>(
        &self,
        ray: &Ray,
        span: [f64; 2],
        mut visit: impl FnMut([u64; 3], &Range, f64, f64) -> ControlFlow<B>,
    ) -> ControlFlow<B> {
        let (domain, first) = (self.field.grid().domain, self.first_block());
        let origin: [f64; 3] =
            std::array::from_fn(|a| f64::from(domain.min[a]) + (first[a] * self.edge) as f64);
        let last = self.count.map(|n| n as i64 - 1);
        let edge = self.edge as f64;
        pass(ray, span, origin, edge, [[0; 3], last], |at, start, end| {
            let block = at.map(|v| v as u64);
            let n = block[0] + self.count[0] * (block[1] + self.count[1] * block[2]);
            visit(block, &self.ranges[n as usize], start, end)
        })
    }

    /// The first crossing of `iso` from `t = from` on, at the root of the cubic that the trilinear
    /// interpolant is along the ray. Where the ray enters the samples is no crossing.
    ///
    /// # Errors
    /// What the field reports.
    pub fn first_crossing(
        &self,
        cursor: &mut Cursor<'_>,
        ray: &Ray,
        iso: f32,
        from: f64,
    ) -> Result<Option<Crossing>> {
        let Some(span) = self.span(ray, from) else {
            return Ok(None);
        };
        let mut search = Search {
            iso,
            above: None,
            found: None,
        };
        self.walk(cursor, ray, span, &mut search)?;
        Ok(search.found)
    }

    /// The largest value along the ray from `t = 0` on; nothing where it meets no value.
    ///
    /// # Errors
    /// What the field reports.
    pub fn maximum(&self, cursor: &mut Cursor<'_>, ray: &Ray) -> Result<Option<Peak>> {
        let Some(span) = self.span(ray, 0.0) else {
            return Ok(None);
        };
        let mut climb = Climb(None);
        self.walk(cursor, ray, span, &mut climb)?;
        Ok(climb.0)
    }

    /// The integral along the ray from `t = 0` on.
    ///
    /// # Errors
    /// What the field reports.
    pub fn integral(&self, cursor: &mut Cursor<'_>, ray: &Ray) -> Result<Integral> {
        let Some(span) = self.span(ray, 0.0) else {
            return Ok(Integral::default());
        };
        let mut sum = Sum(Integral::default());
        self.walk(cursor, ray, span, &mut sum)?;
        Ok(sum.0)
    }

    /// Casts many rays on the threads of the budget: `cast(cursor, ray)` gives the answer of each.
    ///
    /// # Errors
    /// An `out` of another length, those of `cast`, `Cancelled`.
    ///
    /// # Memory
    /// A cursor a thread.
    pub fn cast<T: Send>(
        &self,
        rays: &[Ray],
        out: &mut [T],
        budget: &Budget,
        cast: impl Fn(&mut Cursor<'_>, &Ray) -> Result<T> + Sync,
    ) -> Result<()> {
        if rays.len() != out.len() {
            return Err(Error::bad_input(format!(
                "room for {} answers to {} rays",
                out.len(),
                rays.len()
            )));
        }
        each_part_of(out, PART, budget, self.field, |cursor, first, part| {
            for (answer, ray) in part.iter_mut().zip(&rays[first..]) {
                *answer = cast(cursor, ray)?;
            }
            Ok(())
        })
    }
}

/// What is looked for along a ray.
trait Walker {
    fn look(&mut self, range: &Range, start: f64, end: f64) -> Look;
    /// Whether a cell with these corners matters; it may take note of it instead.
    fn near(&mut self, corners: &[f32; 8]) -> bool;
    /// Whether that was all.
    fn cell(&mut self, passed: &Passed) -> bool;
}

/// The side of `iso` that all of a range is on.
fn side(range: &Range, iso: f32) -> Option<bool> {
    if range.has_nan || range.min > range.max {
        return None;
    }
    match (range.min >= iso, range.max >= iso) {
        (true, _) => Some(true),
        (_, false) => Some(false),
        _ => None,
    }
}

struct Search {
    iso: f32,
    /// The side that the ray is on; unknown at its start and behind cells without values.
    above: Option<bool>,
    found: Option<Crossing>,
}

impl Walker for Search {
    fn look(&mut self, range: &Range, start: f64, _: f64) -> Look {
        let Some(above) = side(range, self.iso) else {
            return Look::Cells;
        };
        // Between two cells the interpolant does not jump, but for rounding.
        if self.above.is_some_and(|was| was != above) {
            self.found = Some(Crossing {
                t: start,
                rising: above,
            });
            return Look::Stop;
        }
        self.above = Some(above);
        Look::Skip
    }

    fn near(&mut self, corners: &[f32; 8]) -> bool {
        let above = corners.iter().filter(|&&v| v >= self.iso).count();
        let below = corners.iter().filter(|&&v| v < self.iso).count();
        if above + below < 8 {
            self.above = None;
            return false;
        }
        !(above == 0 && self.above == Some(false) || below == 0 && self.above == Some(true))
    }

    fn cell(&mut self, passed: &Passed) -> bool {
        let iso = f64::from(self.iso);
        let above = *self.above.get_or_insert(passed.cubic.at(0.0) >= iso);
        if let Some(s) = passed.cubic.leaves(iso, above) {
            self.found = Some(Crossing {
                t: passed.start + s,
                rising: !above,
            });
        }
        self.found.is_some()
    }
}

struct Climb(Option<Peak>);

impl Climb {
    fn is_higher(&self, value: f32) -> bool {
        self.0.is_none_or(|peak| f64::from(value) > peak.value)
    }
}

impl Walker for Climb {
    fn look(&mut self, range: &Range, _: f64, _: f64) -> Look {
        if range.min <= range.max && self.is_higher(range.max) {
            Look::Cells
        } else {
            Look::Skip
        }
    }

    fn near(&mut self, corners: &[f32; 8]) -> bool {
        !corners.iter().any(|v| v.is_nan()) && corners.iter().any(|&v| self.is_higher(v))
    }

    fn cell(&mut self, passed: &Passed) -> bool {
        let (s, value) = passed.cubic.highest();
        if self.0.is_none_or(|peak| value > peak.value) {
            self.0 = Some(Peak {
                t: passed.start + s,
                value,
            });
        }
        false
    }
}

struct Sum(Integral);

impl Walker for Sum {
    fn look(&mut self, range: &Range, start: f64, end: f64) -> Look {
        if range.has_nan || range.min != range.max {
            return Look::Cells;
        }
        self.0.sum += f64::from(range.min) * (end - start);
        self.0.length += end - start;
        Look::Skip
    }

    fn near(&mut self, corners: &[f32; 8]) -> bool {
        !corners.iter().any(|v| v.is_nan())
    }

    fn cell(&mut self, passed: &Passed) -> bool {
        self.0.sum += passed.cubic.integral();
        self.0.length += passed.cubic.length();
        false
    }
}
