//! Values and gradients at single points, near each other or not: a cursor keeps the blocks that it
//! used last.

use super::weights::{cubic, trilinear, trilinear_gradient, weigh};
use crate::budget::{Budget, Permit};
use crate::error::{ErrorKind, Result};
use crate::field::{Field, Pin};
use crate::lattice::Box3;
use crate::sample::Inside;

/// How values between lattice points are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// The nearest sample; halves go up.
    Nearest,
    /// Linear along each axis of the cell, in single precision.
    #[default]
    Trilinear,
    /// Cubic along each axis (Catmull and Rom), through the samples, with continuous gradients; beyond
    /// the border the outermost sample goes on.
    Tricubic,
}

/// Reads a field at points, one after another.
///
/// ```
/// use brickmarch::{Box3, Budget, Grid, field::Dense, query::{Cursor, Method}};
/// let field = Dense::new(Grid::new(Box3::from_size([2, 2, 1])), vec![0.0, 1.0, 2.0, 3.0]).unwrap();
/// let mut cursor = Cursor::new(&field, &Budget::mib(4)).unwrap();
/// assert_eq!(cursor.value([0.5, 0.5, 0.0], Method::Trilinear).unwrap(), Some(1.5));
/// assert_eq!(cursor.value([1.5, 0.0, 0.0], Method::Trilinear).unwrap(), None);
/// ```
///
/// # Memory
/// Eight blocks: the cells along a border of blocks lie in up to eight of them.
pub struct Cursor<'a> {
    field: &'a dyn Field,
    domain: Box3,
    /// Blocks are told apart by the parity of their place, so that neighbours never replace each other.
    pins: [Option<Pin>; 8],
    shift: u32,
    _permit: Permit,
}

impl<'a> Cursor<'a> {
    /// A cursor that has not read anything.
    ///
    /// # Errors
    /// `BudgetExceeded`.
    pub fn new(field: &'a dyn Field, budget: &Budget) -> Result<Self> {
        let edge = u64::from(field.block_edge());
        Ok(Self {
            field,
            domain: field.grid().domain,
            pins: Default::default(),
            shift: field.block_edge().trailing_zeros(),
            _permit: budget.take(8 * edge * edge * edge * 4, "a cursor")?,
        })
    }

    /// The field that is read.
    pub fn field(&self) -> &'a dyn Field {
        self.field
    }

    /// The block that holds `p`, a point of the domain.
    #[inline]
    fn pin(&mut self, p: [i32; 3]) -> Result<&Pin> {
        let [i, j, k] = self.domain.local(p).map(|v| (v >> self.shift & 1) as usize);
        let slot = i + 2 * j + 4 * k;
        if !self.pins[slot]
            .as_ref()
            .is_some_and(|pin| pin.region().contains(p))
        {
            self.pins[slot] = None;
            self.pins[slot] = Some(self.load(p)?);
        }
        Ok(self.pins[slot].as_ref().expect("set above"))
    }

    #[cold]
    fn load(&mut self, p: [i32; 3]) -> Result<Pin> {
        match self.field.pin(p) {
            // What this cursor holds itself may be what is in the way.
            Err(e) if e.kind() == ErrorKind::BudgetExceeded => {
                self.pins = Default::default();
                self.field.pin(p)
            }
            other => other,
        }
    }

    /// The sample at a point of the domain.
    ///
    /// # Errors
    /// What the field reports.
    #[inline]
    pub fn sample(&mut self, p: [i32; 3]) -> Result<f32> {
        Ok(self.pin(p)?.get(p))
    }

    /// Corners of the cell whose lowest corner is `p`, x lowest; `p` lies in the domain, and corners
    /// beyond its end repeat the last sample.
    ///
    /// # Errors
    /// What the field reports.
    #[inline]
    pub fn cell(&mut self, p: [i32; 3]) -> Result<[f32; 8]> {
        let pin = self.pin(p)?;
        let end = pin.region().max;
        if (0..3).all(|a| p[a] + 1 < end[a]) {
            return Ok(pin.cell(p));
        }
        let last = self.domain.max.map(|v| v - 1);
        let mut out = [0.0; 8];
        for (c, value) in out.iter_mut().enumerate() {
            let corner = std::array::from_fn(|a| (p[a] + (c >> a & 1) as i32).min(last[a]));
            *value = self.sample(corner)?;
        }
        Ok(out)
    }

    /// Lattice point at or below an index position; `None` outside of the samples, and for NaN.
    #[inline]
    fn base(&self, index: [f64; 3]) -> Option<[i32; 3]> {
        let inside = |a: usize| {
            f64::from(self.domain.min[a]) <= index[a]
                && index[a] <= f64::from(self.domain.max[a]) - 1.0
        };
        (inside(0) && inside(1) && inside(2)).then(|| index.map(|v| v.floor() as i32))
    }

    /// Value at an index position; `None` outside of the first and last samples.
    ///
    /// # Errors
    /// What the field reports.
    #[inline]
    pub fn value(&mut self, index: [f64; 3], method: Method) -> Result<Option<f32>> {
        let Some(base) = self.base(index) else {
            return Ok(None);
        };
        Ok(Some(match method {
            Method::Nearest => {
                let last = self.domain.max.map(|v| v - 1);
                let near = std::array::from_fn(|a| ((index[a] + 0.5).floor() as i32).min(last[a]));
                self.sample(near)?
            }
            Method::Trilinear => {
                let t = std::array::from_fn(|a| (index[a] - f64::from(base[a])) as f32);
                trilinear(self.cell(base)?, t)
            }
            Method::Tricubic => {
                let values = self.around(base)?;
                let [x, y, z] = [0, 1, 2].map(|a| cubic(index[a] - f64::from(base[a])).0);
                weigh(&values, [&x, &y, &z]) as f32
            }
        }))
    }

    /// Gradient of the interpolant per index step; `None` outside of the first and last samples. On a
    /// lattice plane, where the trilinear one jumps, it is that of the cell above; along an axis of a
    /// single sample it is 0. [`Method::Nearest`] has the gradient of the trilinear interpolant.
    ///
    /// # Errors
    /// What the field reports.
    pub fn gradient(&mut self, index: [f64; 3], method: Method) -> Result<Option<[f32; 3]>> {
        let Some(mut base) = self.base(index) else {
            return Ok(None);
        };
        for a in 0..3 {
            base[a] = base[a].min(self.domain.max[a] - 2).max(self.domain.min[a]);
        }
        let t: [f64; 3] = std::array::from_fn(|a| index[a] - f64::from(base[a]));
        if method != Method::Tricubic {
            return Ok(Some(trilinear_gradient(self.cell(base)?, t)));
        }
        let values = self.around(base)?;
        let [x, y, z] = t.map(cubic);
        Ok(Some([
            weigh(&values, [&x.1, &y.0, &z.0]) as f32,
            weigh(&values, [&x.0, &y.1, &z.0]) as f32,
            weigh(&values, [&x.0, &y.0, &z.1]) as f32,
        ]))
    }

    /// The 4 x 4 x 4 samples around a cell, the outermost ones repeated beyond the border.
    fn around(&mut self, base: [i32; 3]) -> Result<[f32; 64]> {
        let domain = self.domain;
        let mut out = [0.0; 64];
        for (n, value) in out.iter_mut().enumerate() {
            let step = [n % 4, n / 4 % 4, n / 16];
            let p = std::array::from_fn(|a| {
                (base[a].saturating_add(step[a] as i32 - 1)).clamp(domain.min[a], domain.max[a] - 1)
            });
            *value = self.sample(p)?;
        }
        Ok(out)
    }

    /// Whether an index position is in the object: by the trilinear value, and never outside of the
    /// samples.
    ///
    /// # Errors
    /// What the field reports.
    pub fn is_inside(&mut self, index: [f64; 3], iso: f32, inside: Inside) -> Result<bool> {
        let value = self.value(index, Method::Trilinear)?;
        Ok(value.is_some_and(|v| inside.contains(v, iso)))
    }
}
