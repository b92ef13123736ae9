//! Any field with a surface as the distance to it, in a narrow band: what offsets, shells and smooth
//! blends of a scan need.
//!
//! Exact: the distance of a sample is that to the nearest triangle of the surface that
//! [`iso::extract`](crate::iso::extract) makes, negative inside. Each region looks at the triangles
//! around it only, so memory does not grow with the field, and a sample has the same bits whatever
//! region it is read with.

use crate::budget::Budget;
use crate::error::{Error, Result};
use crate::field::{Field, Range, Samples};
use crate::iso::{Boundary, Extract, extract};
use crate::lattice::{Affine, Box3, Grid};
use crate::mesh::{Collect, Mesh};
use crate::sample::{Inside, Kind};

/// What the surface of one region may take.
const REGION_BYTES: u64 = 16 << 20;

/// Widest band, in samples along an axis: a region looks at this many samples around it.
const MAX_REACH: f64 = 64.0;

/// Distance to the surface `field == iso`, cut to `-band..band` in world units.
///
/// A sample without a value counts as outside. Beyond the domain there is no surface: a solid that
/// leaves the domain is open there.
pub struct Redistanced<'a> {
    field: &'a dyn Field,
    options: Extract,
    band: f64,
    to_index: Affine,
    /// How far the band reaches along each axis, in samples.
    reach: [f64; 3],
    budget: Budget,
}

impl<'a> Redistanced<'a> {
    /// The distance to `field == iso`; `inside` says which side is negative (that of the kind of the
    /// field when it is nothing).
    ///
    /// ```
    /// use brickmarch::redistance::Redistanced;
    /// use brickmarch::{Box3, Budget, Field, Grid, Inside, Samples, field::Dense};
    /// let domain = Box3::from_size([20; 3]);
    /// let square = |n: i32| [n % 20, n / 20 % 20, n / 400].map(|c| (c as f32 - 9.5).powi(2));
    /// let values = (0..8000).map(|n| square(n).iter().sum()).collect();
    /// let square = Dense::new(Grid::new(domain), values).unwrap();
    /// let budget = Budget::mib(64);
    /// let field = Redistanced::new(&square, 36.0, Some(Inside::Below), 3.0, &budget).unwrap();
    /// let mut value = [0.0];
    /// let at = Box3::new([17, 9, 9], [18, 10, 10]);
    /// field.read(at, &mut Samples::dense(&mut value, at)).unwrap();
    /// let wanted = (7.5f32.powi(2) + 0.5).sqrt() - 6.0;
    /// assert!((value[0] - wanted).abs() < 0.05);
    /// ```
    ///
    /// # Errors
    /// A band that is not above zero, or reaches beyond 64 samples; a field without cells.
    ///
    /// # Memory
    /// Each region that is read takes 16 MiB of `budget` while it is read.
    pub fn new(
        field: &'a dyn Field,
        iso: f32,
        inside: Option<Inside>,
        band: f64,
        budget: &Budget,
    ) -> Result<Redistanced<'a>> {
        let grid = field.grid();
        if grid.domain.size().into_iter().any(|n| n < 2) {
            return Err(Error::bad_input(format!(
                "the domain {} has no cells, so no surface: give at least two samples along each axis",
                grid.domain
            )));
        }
        let to_index = grid.index_to_world.inverse()?;
        let reach = to_index
            .rows
            .map(|[x, y, z, _]| band * (x * x + y * y + z * z).sqrt());
        if !(band > 0.0 && reach.iter().all(|r| *r <= MAX_REACH)) {
            return Err(Error::bad_input(format!(
                "a band of {band}: give one above 0 that reaches over at most {MAX_REACH} samples"
            )));
        }
        let inside = inside.unwrap_or_else(|| field.kind().inside());
        Ok(Redistanced {
            field,
            options: Extract {
                iso,
                inside: Some(inside),
                boundary: Boundary::Cut,
                allow_empty: true,
                ..Extract::default()
            },
            band,
            to_index,
            reach,
            budget: budget.clone(),
        })
    }

    fn inside(&self) -> Inside {
        self.options.inside.unwrap_or(Inside::Below)
    }

    /// The region and all that the band reaches from it.
    fn around(&self, region: Box3) -> Box3 {
        let mut out = region;
        for a in 0..3 {
            let more = self.reach[a].ceil() as i32 + 1;
            out.min[a] = out.min[a].saturating_sub(more);
            out.max[a] = out.max[a].saturating_add(more);
        }
        out.intersect(&self.field.grid().domain)
    }

    /// The one value of a region that the surface is far from.
    fn far(&self, region: Box3) -> Result<Option<f32>> {
        let range = self.field.range(self.around(region))?;
        if range.has_nan || range.min > range.max {
            return Ok(None);
        }
        let [low, high] =
            [range.min, range.max].map(|v| self.inside().contains(v, self.options.iso));
        let band = self.band as f32;
        Ok((low == high).then_some(if low { -band } else { band }))
    }

    fn surface(&self, region: Box3) -> Result<Mesh> {
        let own = Budget::bytes(REGION_BYTES).with_threads(1);
        let options = Extract {
            region: Some(self.around(region)),
            ..self.options.clone()
        };
        let mut sink = Collect::default();
        extract(self.field, &options, &own, &mut sink)?;
        Ok(sink.into_mesh())
    }

    /// Lowers the squares of distances around one triangle.
    fn scatter(&self, corners: [[f64; 3]; 3], region: Box3, squares: &mut [f64]) {
        let index = corners.map(|p| self.to_index.apply(p));
        let mut near = region;
        for a in 0..3 {
            let ends = index.map(|p| p[a]);
            let low = ends.into_iter().fold(f64::INFINITY, f64::min) - self.reach[a] - 1e-6;
            let high = ends.into_iter().fold(f64::NEG_INFINITY, f64::max) + self.reach[a] + 1e-6;
            near.min[a] = near.min[a].max(low.ceil() as i32);
            near.max[a] = near.max[a].min(high.floor() as i32 + 1);
        }
        let map = self.field.grid().index_to_world;
        for k in near.min[2]..near.max[2] {
            for j in near.min[1]..near.max[1] {
                for i in near.min[0]..near.max[0] {
                    let p = map.apply([i, j, k].map(f64::from));
                    let square = distance_square(p, &corners);
                    let slot = &mut squares[region.offset_of([i, j, k])];
                    if square < *slot {
                        *slot = square;
                    }
                }
            }
        }
    }
}

impl Field for Redistanced<'_> {
    fn grid(&self) -> &Grid {
        self.field.grid()
    }

    fn kind(&self) -> Kind {
        Kind::Distance
    }

    fn block_edge(&self) -> u32 {
        self.field.block_edge()
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()> {
        let [nx, ny, nz] = region.size().map(|n| n as usize);
        let far = self.far(region)?;
        let mut values = vec![0.0; region.count() as usize];
        if let Some(far) = far {
            values.fill(far);
        } else {
            let _permit = self.budget.take(REGION_BYTES, "redistancing a region")?;
            self.field
                .read(region, &mut Samples::dense(&mut values, region))?;
            let mut squares = vec![self.band * self.band; values.len()];
            let mesh = self.surface(region)?;
            for triangle in &mesh.triangles {
                let corners = triangle.map(|v| mesh.positions[v as usize].map(f64::from));
                self.scatter(corners, region, &mut squares);
            }
            let side = self.inside();
            for (value, square) in values.iter_mut().zip(squares) {
                let distance = square.sqrt() as f32;
                let is_inside = side.contains(*value, self.options.iso);
                *value = if is_inside { -distance } else { distance };
            }
        }
        for k in 0..nz {
            for j in 0..ny {
                let row = (k * ny + j) * nx;
                out.row_mut(j, k, nx)
                    .copy_from_slice(&values[row..row + nx]);
            }
        }
        Ok(())
    }

    fn range(&self, region: Box3) -> Result<Range> {
        let region = region.intersect(&self.grid().domain);
        if region.is_empty() {
            return Ok(Range::EMPTY);
        }
        let band = self.band as f32;
        Ok(match self.far(region)? {
            Some(value) => Range::of(value),
            None => Range::of(-band).union(Range::of(band)),
        })
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Square of the distance from a point to a triangle: by the region of the plane that the foot lies
/// in (Ericson, "Real-Time Collision Detection", 5.1.5, 2005); degenerate triangles by their sides.
fn distance_square(p: [f64; 3], [a, b, c]: &[[f64; 3]; 3]) -> f64 {
    let (ab, ac, ap) = (minus(*b, *a), minus(*c, *a), minus(p, *a));
    let (bb, bc, cc) = (dot(ab, ab), dot(ab, ac), dot(ac, ac));
    let (bp, cp) = (dot(ab, ap), dot(ac, ap));
    let area = bb * cc - bc * bc;
    if area > 1e-24 * bb * cc {
        let (v, w) = ((cc * bp - bc * cp) / area, (bb * cp - bc * bp) / area);
        if v >= 0.0 && w >= 0.0 && v + w <= 1.0 {
            let foot = std::array::from_fn(|i| ap[i] - v * ab[i] - w * ac[i]);
            return dot(foot, foot);
        }
    }
    let side = |from: &[f64; 3], to: &[f64; 3]| {
        let (way, fp) = (minus(*to, *from), minus(p, *from));
        let length = dot(way, way);
        let t = if length > 0.0 {
            (dot(fp, way) / length).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let rest: [f64; 3] = std::array::from_fn(|i| fp[i] - t * way[i]);
        dot(rest, rest)
    };
    side(a, b).min(side(b, c)).min(side(c, a))
}
