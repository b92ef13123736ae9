//! An attribute of a model as a field: the colour, or any named number, of the solid at each sample.

use super::build::default_attribute;
use super::field::{Model, ROOM};
use super::interval::Interval;
use super::planes::PLANE;
use crate::error::{Error, Result};
use crate::field::{Field, Range, Samples};
use crate::lattice::{Box3, Grid};
use crate::sample::Kind;

/// Samples around a region that still count as near: those that a cell across its border reads.
const AROUND: i32 = 2;

/// An attribute at every sample of regions that the surface of the model, or its band, comes near
/// to; the value of a part without the attribute everywhere else.
///
/// Where the winner of a boolean changes far from the surface, and in the middle of a wide blend, nobody
/// asks for a colour: those regions would make the work grow with the volume. Which regions are near is
/// decided for each region that is asked for. Meant for writing a volume brick by brick.
pub struct AttributeField<'a> {
    model: &'a Model,
    name: String,
    /// Colours are bytes from 0 to 255.
    is_byte: bool,
    everywhere: bool,
}

impl<'a> AttributeField<'a> {
    /// The attribute as it is, in f32.
    pub fn new(model: &'a Model, name: &str) -> AttributeField<'a> {
        AttributeField {
            model,
            name: name.to_string(),
            is_byte: false,
            everywhere: false,
        }
    }

    /// One of `red`, `green` and `blue`, from 0 to 255 as in [`Model::colors`].
    ///
    /// # Errors
    /// When it is none of the three.
    pub fn color(model: &'a Model, name: &str) -> Result<AttributeField<'a>> {
        if !["red", "green", "blue"].contains(&name) {
            return Err(Error::bad_input(format!(
                "'{name}' is no colour: ask for red, green or blue"
            )));
        }
        Ok(AttributeField {
            is_byte: true,
            ..AttributeField::new(model, name)
        })
    }

    /// At every sample, near the surface or not.
    pub fn everywhere(mut self) -> AttributeField<'a> {
        self.everywhere = true;
        self
    }

    /// Value where nothing is near, and of parts that do not say another.
    pub fn background(&self) -> f32 {
        self.sample(default_attribute(&self.name))
    }

    fn sample(&self, value: f64) -> f32 {
        let value = value as f32 + 0.0;
        if self.is_byte {
            (255.0 * value).round().clamp(0.0, 255.0)
        } else {
            value
        }
    }

    fn is_near(&self, region: Box3) -> Result<bool> {
        if self.everywhere {
            return Ok(true);
        }
        let around = region
            .grow(AROUND, AROUND)
            .intersect(&self.model.grid().domain);
        self.model.may_cross(around)
    }
}

impl Field for AttributeField<'_> {
    fn grid(&self) -> &Grid {
        self.model.grid()
    }

    fn kind(&self) -> Kind {
        Kind::Density
    }

    fn block_edge(&self) -> u32 {
        self.model.block_edge()
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()> {
        let [nx, ny, nz] = region.size().map(|n| n as usize);
        let tape = self.model.attribute_tape(&self.name);
        let (Some(tape), true) = (tape, self.is_near(region)?) else {
            for k in 0..nz {
                for j in 0..ny {
                    out.row_mut(j, k, nx).fill(self.background());
                }
            }
            return Ok(());
        };
        let mut room = ROOM.take();
        tape.range(self.model.cube(region), &mut room)?;
        let pruned = tape.prune(&room);
        let tape = pruned.as_ref().unwrap_or(tape);
        let along = |a: usize| -> Vec<f64> {
            (region.min[a]..region.max[a])
                .map(|i| self.model.world(a, i))
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
        let region = region.intersect(&self.model.grid().domain);
        if region.is_empty() {
            return Ok(Range::EMPTY);
        }
        let default = Range::of(self.background());
        let Some(tape) = self.model.attribute_tape(&self.name) else {
            return Ok(default);
        };
        if !self.is_near(region)? {
            return Ok(default);
        }
        let mut room = ROOM.take();
        let range: Interval = tape.range(self.model.cube(region), &mut room)?;
        ROOM.replace(room);
        if range.is_none() {
            return Ok(Range::UNKNOWN);
        }
        let own = Range {
            min: self.sample(range.lo),
            max: self.sample(range.hi),
            has_nan: range.nan,
        };
        // A part of a near region may itself be far.
        Ok(if self.everywhere {
            own
        } else {
            own.union(default)
        })
    }
}
