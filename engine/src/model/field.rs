//! A model as a field: pruned evaluation brick by brick, ranges, attributes.

use super::build::default_attribute;
use super::graph::{Graph, Id};
use super::interval::Interval;
use super::planes::PLANE;
use super::shape::{Convention, Shape};
use super::tape::{BATCH, Room, Tape};
use crate::error::{Error, Result};
use crate::field::{Field, Range, Samples};
use crate::lattice::{Affine, Box3, Grid, Units};
use crate::sample::Kind;
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Edges of the cells, in lattice points, for which pruned tapes are kept.
const CELLS: [i32; 2] = [512, 128];

/// Tapes shorter than this are pruned from the whole each time.
const SHORT: usize = 48;

/// Most operations in the pruned tapes that are kept: 16 MiB.
const MAX_KEPT: usize = 1 << 20;

/// Up to this many points along an axis a range that holds the isovalue is looked at more closely.
const CLOSE: u32 = 80;

/// A shape over a lattice. Values are evaluated in double precision and rounded once.
///
/// # Memory
/// At most 16 MiB of pruned tapes, and about 1 MiB in each thread that reads.
pub struct Model {
    grid: Grid,
    convention: Convention,
    band: Option<f64>,
    pub(super) tape: Arc<Tape>,
    attributes: Vec<(String, Tape)>,
    kept: Mutex<Kept>,
    samples: AtomicU64,
    blocks: AtomicU64,
}

#[derive(Default)]
struct Kept {
    tapes: HashMap<(usize, [i32; 3]), Arc<Tape>>,
    operations: usize,
}

/// What was evaluated so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evaluated {
    /// Samples whose value was computed.
    pub samples: u64,
    /// Regions that were read, each a brick of a volume or a block of a surface.
    pub regions: u64,
}

impl Model {
    /// `shape` over `grid`, whose map to the world may only move and scale.
    ///
    /// # Errors
    /// When a number in the tree makes no sense, conventions are mixed, or the grid is turned.
    pub fn new(shape: &Shape, grid: Grid) -> Result<Model> {
        grid.index_to_world.validate()?;
        let rows = grid.index_to_world.rows;
        let straight = (0..3).all(|r| (0..3).all(|c| (r == c) == (rows[r][c] != 0.0)));
        if grid.domain.is_empty() || !straight || (0..3).any(|a| rows[a][a] < 0.0) {
            return Err(Error::bad_input(
                "a model needs a lattice with samples, along the axes of the world: give it a positive spacing and an origin",
            ));
        }
        let names = shape.attribute_names();
        let mut graph = Graph::default();
        let point = graph.axes();
        let built = shape.build(&mut graph, point, &names)?;
        let tape = |id: Id| Tape::new(&graph, id);
        let pairs = names.into_iter().zip(&built.attributes);
        Ok(Model {
            grid,
            convention: built.convention,
            band: None,
            tape: Arc::new(tape(built.value)),
            attributes: pairs.map(|(name, &id)| (name, tape(id))).collect(),
            kept: Mutex::default(),
            samples: AtomicU64::new(0),
            blocks: AtomicU64::new(0),
        })
    }

    /// The lattice of `resolution` cells along the longest axis of a world box, a sample at its
    /// lowest corner.
    ///
    /// # Errors
    /// When the box is empty, or the lattice is beyond 2^24 samples along an axis.
    pub fn lattice(bounds: [[f64; 3]; 2], voxel: f64, units: Units) -> Result<Grid> {
        let [low, high] = bounds;
        super::build::finite("bounds", bounds.as_flattened())?;
        super::build::positive("voxel", &[voxel])?;
        let mut size = [0i32; 3];
        for a in 0..3 {
            let cells = ((high[a] - low[a]) / voxel - 1e-6).ceil();
            if cells.is_nan() || cells < 1.0 {
                return Err(Error::bad_input(format!(
                    "bounds {low:?} to {high:?}: they are empty: give a largest corner above the smallest one"
                )));
            }
            if cells > f64::from(1 << 24) {
                return Err(Error::new(
                    crate::error::ErrorKind::LimitExceeded,
                    format!("{cells} voxels along an axis: make the voxel larger"),
                ));
            }
            size[a] = cells as i32 + 1;
        }
        Ok(Grid {
            domain: Box3::from_size(size),
            index_to_world: Affine::from_spacing([voxel; 3], low),
            units,
        })
    }

    /// Keeps only a band around the surface: a distance is cut to `-width..width` (in world units),
    /// so that all else is constant.
    ///
    /// # Errors
    /// When the values are no distance, or the width is not above zero.
    pub fn narrow(mut self, width: f64) -> Result<Model> {
        super::build::positive("band", &[width])?;
        if self.convention != Convention::Distance {
            return Err(Error::bad_input(format!(
                "a narrow band needs a distance, not a {}: convert a level with convert = \"distance\" and its slope",
                self.convention.name()
            )));
        }
        self.band = Some(width);
        Ok(self)
    }

    /// What the values mean.
    pub fn convention(&self) -> Convention {
        self.convention
    }

    /// Number of operations of the whole tree.
    pub fn operations(&self) -> usize {
        self.tape.len()
    }

    /// What was evaluated so far.
    pub fn evaluated(&self) -> Evaluated {
        Evaluated {
            samples: self.samples.load(Ordering::Relaxed),
            regions: self.blocks.load(Ordering::Relaxed),
        }
    }

    /// Value at a world point, in double precision and without the band.
    ///
    /// # Errors
    /// What sampled data reports.
    pub fn value(&self, point: [f64; 3]) -> Result<f64> {
        let mut out = [0.0];
        let [x, y, z] = point.map(|c| [c]);
        self.values([&x, &y, &z], &mut out)?;
        Ok(out[0])
    }

    /// Values at world points, given by their coordinates along each axis: as many as `out` takes.
    ///
    /// # Errors
    /// When there are fewer coordinates; what sampled data reports.
    pub fn values(&self, points: [&[f64]; 3], out: &mut [f64]) -> Result<()> {
        if points.iter().any(|p| p.len() < out.len()) {
            return Err(Error::bad_input(format!(
                "{} values of fewer points",
                out.len()
            )));
        }
        let mut room = ROOM.take();
        self.tape.values(points, out, &mut room)?;
        ROOM.replace(room);
        Ok(())
    }

    /// Gradient at a world point; at a crease the middle of those beside it.
    ///
    /// # Errors
    /// What sampled data reports.
    pub fn gradient(&self, point: [f64; 3]) -> Result<[f64; 3]> {
        let slopes = self
            .tape
            .slopes(point.map(Interval::point), &mut Room::default())?;
        Ok(slopes.d.map(Interval::middle))
    }

    /// A conservative range over a world box, smallest and largest; nothing known where a value may
    /// not be a number.
    ///
    /// # Errors
    /// What sampled data reports.
    pub fn world_range(&self, low: [f64; 3], high: [f64; 3]) -> Result<Range> {
        let cube = [0, 1, 2].map(|a| Interval::new(low[a], high[a]));
        let room = &mut Room::default();
        self.tape.range(cube, room)?;
        let tight = self.tape.tight_range(cube, room)?;
        Ok(self.rounded(tight))
    }

    /// Names of the attributes.
    pub fn attribute_names(&self) -> impl Iterator<Item = &str> {
        self.attributes.iter().map(|(name, _)| name.as_str())
    }

    /// Values of an attribute at world points; a default one where the model has none of this name.
    ///
    /// # Errors
    /// What sampled data reports.
    pub fn attribute(&self, name: &str, points: &[[f32; 3]]) -> Result<Vec<f32>> {
        let Some(tape) = self.attribute_tape(name) else {
            return Ok(vec![default_attribute(name) as f32; points.len()]);
        };
        let mut room = Room::default();
        let mut out = Vec::with_capacity(points.len());
        for part in points.chunks(BATCH) {
            let [x, y, z] = [0, 1, 2].map(|a| {
                let column = part.iter().map(|p| f64::from(p[a]));
                column.collect::<Vec<f64>>()
            });
            let mut values = vec![0.0; part.len()];
            tape.values([&x, &y, &z], &mut values, &mut room)?;
            out.extend(values.into_iter().map(|v| v as f32));
        }
        Ok(out)
    }

    /// Colours at world points, from the attributes `red`, `green` and `blue` (0 to 1).
    ///
    /// # Errors
    /// What sampled data reports.
    pub fn colors(&self, points: &[[f32; 3]]) -> Result<Vec<[u8; 3]>> {
        let mut out = vec![[0; 3]; points.len()];
        for (channel, name) in ["red", "green", "blue"].into_iter().enumerate() {
            let values = self.attribute(name, points)?;
            for (color, value) in out.iter_mut().zip(values) {
                color[channel] = (255.0 * value).round().clamp(0.0, 255.0) as u8;
            }
        }
        Ok(out)
    }

    /// World coordinate of an index; the same operations wherever it is asked from.
    pub(super) fn world(&self, axis: usize, index: i32) -> f64 {
        let row = self.grid.index_to_world.rows[axis];
        row[3] + row[axis] * f64::from(index)
    }

    /// Operations of an attribute, if the model has it.
    pub(super) fn attribute_tape(&self, name: &str) -> Option<&Tape> {
        let mut all = self.attributes.iter();
        all.find(|(n, _)| n == name).map(|(_, tape)| tape)
    }

    /// Whether the surface, or for a narrow band what is within it, may be in `region`.
    pub(super) fn may_cross(&self, region: Box3) -> Result<bool> {
        let range = self.range(region)?;
        let iso = self.convention.iso();
        Ok(range.has_nan
            || if self.band.is_some() {
                range.min < range.max
            } else {
                range.min <= iso && iso <= range.max
            })
    }

    pub(super) fn cube(&self, region: Box3) -> [Interval; 3] {
        [0, 1, 2].map(|a| {
            Interval::new(
                self.world(a, region.min[a]),
                self.world(a, region.max[a] - 1),
            )
        })
    }

    /// Rounds, and cuts to the band, as samples are.
    #[inline(always)]
    fn sample(&self, value: f64) -> f32 {
        let value = value as f32 + 0.0;
        match self.band {
            Some(band) => {
                let band = band as f32;
                if value > band {
                    band
                } else if value < -band {
                    -band
                } else {
                    value
                }
            }
            None => value,
        }
    }

    fn rounded(&self, range: Interval) -> Range {
        if range.is_none() {
            return Range {
                has_nan: true,
                ..Range::EMPTY
            };
        }
        Range {
            min: self.sample(range.lo),
            max: self.sample(range.hi),
            has_nan: range.nan,
        }
    }

    /// A tape that holds in `region`: pruned for the smallest kept cell around it.
    fn tape_for(&self, region: Box3, room: &mut Room) -> Result<Arc<Tape>> {
        let mut tape = self.tape.clone();
        for (level, edge) in CELLS.into_iter().enumerate() {
            if tape.len() < SHORT {
                break;
            }
            let name = region.min.map(|v| v.div_euclid(edge));
            // A little more than the cell, since blocks need samples beside their own.
            let low = name.map(|n| n.saturating_mul(edge));
            let cell = Box3::new(low, low.map(|v| v.saturating_add(edge))).grow(4, 36);
            if !cell.contains_box(&region) {
                break;
            }
            let known = {
                let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
                kept.tapes.get(&(level, name)).cloned()
            };
            tape = match known {
                Some(known) => known,
                None => {
                    tape.range(self.cube(cell), room)?;
                    let pruned = tape.prune(room).map_or_else(|| tape.clone(), Arc::new);
                    self.keep((level, name), &pruned);
                    pruned
                }
            };
        }
        Ok(tape)
    }

    fn keep(&self, name: (usize, [i32; 3]), tape: &Arc<Tape>) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.operations + tape.len() > MAX_KEPT {
            *kept = Kept::default();
        }
        kept.operations += tape.len();
        kept.tapes.insert(name, tape.clone());
    }

    /// What is wanted to be known of a range: whether it holds the surface, or leaves the band.
    fn is_settled(&self, range: Interval) -> bool {
        if range.nan {
            return true;
        }
        let iso = f64::from(self.convention.iso());
        match self.band {
            Some(band) => range.lo >= band || range.hi <= -band,
            None => range.lo > iso || range.hi < iso,
        }
    }
}

thread_local! {
    /// Room of this thread; holds no result from one call to the next.
    pub(super) static ROOM: std::cell::RefCell<Room> = std::cell::RefCell::default();
}

impl Field for Model {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    fn kind(&self) -> Kind {
        self.convention.kind()
    }

    fn block_edge(&self) -> u32 {
        16
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()> {
        let nx = region.size()[0] as usize;
        // A model whose leaf is a model would find the room taken: it then makes its own.
        let mut room = ROOM.take();
        let tape = self.tape_for(region, &mut room)?;
        tape.range(self.cube(region), &mut room)?;
        let pruned = tape.prune(&room);
        let tape = pruned.as_ref().unwrap_or(&tape);
        self.samples.fetch_add(region.count(), Ordering::Relaxed);
        self.blocks.fetch_add(1, Ordering::Relaxed);
        let along = |a: usize| -> Vec<f64> {
            (region.min[a]..region.max[a])
                .map(|i| self.world(a, i))
                .collect()
        };
        let [xs, ys, zs] = [0, 1, 2].map(along);
        for first in (0..nx).step_by(PLANE) {
            let xs = &xs[first..(first + PLANE).min(nx)];
            let planes = &mut room.planes;
            tape.block([xs, &ys, &zs], planes, |row, k, values| {
                for (j, values) in values.chunks(xs.len()).enumerate() {
                    let target = &mut out.row_mut(row + j, k, nx)[first..];
                    for (o, &v) in target.iter_mut().zip(values) {
                        *o = self.sample(v);
                    }
                }
            })?;
        }
        ROOM.replace(room);
        Ok(())
    }

    fn range(&self, region: Box3) -> Result<Range> {
        let region = region.intersect(&self.grid.domain);
        if region.is_empty() {
            return Ok(Range::EMPTY);
        }
        let mut room = ROOM.take();
        let tape = self.tape_for(region, &mut room)?;
        let cube = self.cube(region);
        let mut range = tape.range(cube, &mut room)?;
        let small = region.size().into_iter().all(|n| n <= CLOSE);
        if small && !self.is_settled(range) {
            range = tape.tight_range(cube, &mut room)?;
        }
        ROOM.replace(room);
        Ok(self.rounded(range))
    }
}
