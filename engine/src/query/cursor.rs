//! Values and gradients at single points, near each other or not: a cursor keeps the blocks that it
//! used last.

use super::weights::{cubic, trilinear, trilinear_gradient, weigh};
use crate::budget::{Budget, Permit};
use crate::error::{ErrorKind, Result};
use crate::field::{Field, Pin, SamplesAt, WithSamples};
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
        self.cell_across(p, end)
    }

    /// The same where the cell reaches beyond the block that ends at `end`.
    fn cell_across(&mut self, p: [i32; 3], end: [i32; 3]) -> Result<[f32; 8]> {
        // Bits of the axes along which corners lie in the next block, and of those along which they lie in
        // the same; none of both at the end of the domain.
        let (mut across, mut within) = (0, 0);
        for a in 0..3 {
            if p[a] + 1 < end[a] {
                within |= 1 << a;
            } else if p[a] + 1 < self.domain.max[a] {
                across |= 1 << a;
            }
        }
        let mut out = [0.0; 8];
        // Block by block: not all of them need to be held together.
        let mut block = 0;
        loop {
            let bit = |a: usize| (block >> a & 1) as i32;
            let first = [p[0] + bit(0), p[1] + bit(1), p[2] + bit(2)];
            let pin = self.pin(first)?;
            pin.with_samples(Corners {
                first: pin.offset(first),
                steps: pin.steps(),
                across,
                within,
                block,
                out: &mut out,
            });
            // The next number with bits of `across` only.
            block = block.wrapping_sub(across) & across;
            if block == 0 {
                return Ok(out);
            }
        }
    }

    /// Lattice point at or below an index position; `None` outside of the samples, and for NaN.
    #[inline]
    fn base(&self, index: [f64; 3]) -> Option<[i32; 3]> {
        let inside = |a: usize| {
            f64::from(self.domain.min[a]) <= index[a]
                && index[a] <= f64::from(self.domain.max[a]) - 1.0
        };
        (inside(0) && inside(1) && inside(2)).then(|| index.map(floor))
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

    /// Trilinear values at `place(0)`, `place(1)` and so on, index positions, for each of `out`; `outside`
    /// outside of the first and last samples. Faster where neighbours share a block. The bits are those of [`value`](Self::value).
    ///
    /// # Errors
    /// What the field reports.
    #[inline]
    pub fn trilinear(
        &mut self,
        place: impl Fn(usize) -> [f64; 3],
        outside: f32,
        out: &mut [f32],
    ) -> Result<()> {
        let mut n = 0;
        while n < out.len() {
            let index = place(n);
            let Some(base) = self.base(index) else {
                out[n] = outside;
                n += 1;
                continue;
            };
            let pin = self.pin(base)?;
            let within = Within {
                pin,
                place: |i| place(n + i),
                out: &mut out[n..],
            };
            match pin.with_samples(within) {
                // A cell between blocks.
                0 => {
                    let t = std::array::from_fn(|a| (index[a] - f64::from(base[a])) as f32);
                    out[n] = trilinear(self.cell(base)?, t);
                    n += 1;
                }
                done => n += done,
            }
        }
        Ok(())
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

/// Those corners of a cell that lie in one of its blocks.
struct Corners<'a> {
    /// Place of the lowest of them.
    first: usize,
    steps: [usize; 2],
    across: usize,
    within: usize,
    block: usize,
    out: &'a mut [f32; 8],
}

impl WithSamples for Corners<'_> {
    type Out = ();

    #[inline]
    fn run(self, samples: impl SamplesAt) {
        let [row, slice] = self.steps;
        for (c, value) in self.out.iter_mut().enumerate() {
            if c & self.across == self.block {
                let step = |a: usize| c >> a & self.within >> a & 1;
                *value = samples.at(self.first + step(0) + step(1) * row + step(2) * slice);
            }
        }
    }
}

/// Trilinear values at points in one block, up to the first whose cell does not lie wholly in it.
struct Within<'a, P> {
    pin: &'a Pin,
    place: P,
    out: &'a mut [f32],
}

impl<P: Fn(usize) -> [f64; 3]> WithSamples for Within<'_, P> {
    type Out = usize;

    #[inline]
    fn run(self, samples: impl SamplesAt) -> usize {
        let region = self.pin.region();
        let low = region.min.map(f64::from);
        let end = region.max.map(|v| f64::from(v) - 1.0);
        let [row, slice] = self.pin.steps();
        for (n, value) in self.out.iter_mut().enumerate() {
            let p = (self.place)(n);
            if !(0..3).all(|a| low[a] <= p[a] && p[a] < end[a]) {
                return n;
            }
            let base = [floor(p[0]), floor(p[1]), floor(p[2])];
            let t = [0, 1, 2].map(|a| (p[a] - f64::from(base[a])) as f32);
            let at = self.pin.offset(base);
            let [a, b] = samples.pair(at);
            let [c, d] = samples.pair(at + row);
            let [e, f] = samples.pair(at + slice);
            let [g, h] = samples.pair(at + slice + row);
            *value = trilinear([a, b, c, d, e, f, g, h], t);
        }
        self.out.len()
    }
}

/// The whole number at or below `v`, which lies in the range of those: `f64::floor` is a call on processors
/// without an instruction for it.
#[inline(always)]
fn floor(v: f64) -> i32 {
    let whole = v as i32;
    whole - i32::from(f64::from(whole) > v)
}
