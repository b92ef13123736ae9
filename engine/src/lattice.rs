//! The lattice: half-open integer boxes, the map from index to world, Morton order.
//!
//! Samples sit at integer points `[i, j, k]`, `i` fastest in memory. Coordinates are signed 32-bit,
//! counts are 64-bit.

use crate::error::{Error, Result};
use glam::{DMat3, DVec3};
use std::fmt;
use std::str::FromStr;

/// Half-open integer box `min..max` of lattice points.
///
/// ```
/// use brickmarch::Box3;
/// let region: Box3 = "0:10,-5:5,2:3".parse().unwrap();
/// assert_eq!(region.size(), [10, 10, 1]);
/// assert_eq!(region.count(), 100);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Box3 {
    /// Smallest point inside.
    pub min: [i32; 3],
    /// First point outside, per axis.
    pub max: [i32; 3],
}

impl Box3 {
    /// The box `min..max`.
    pub const fn new(min: [i32; 3], max: [i32; 3]) -> Self {
        Self { min, max }
    }

    /// The box `0..size`.
    pub const fn from_size(size: [i32; 3]) -> Self {
        Self {
            min: [0; 3],
            max: size,
        }
    }

    /// Points per axis, zero where the box is empty.
    pub fn size(&self) -> [u32; 3] {
        std::array::from_fn(|a| {
            (i64::from(self.max[a]) - i64::from(self.min[a])).clamp(0, i64::from(u32::MAX)) as u32
        })
    }

    /// Number of points, saturating at `u64::MAX`.
    pub fn count(&self) -> u64 {
        self.size()
            .into_iter()
            .fold(1u64, |n, s| n.saturating_mul(u64::from(s)))
    }

    /// Whether no point is inside.
    pub fn is_empty(&self) -> bool {
        (0..3).any(|a| self.max[a] <= self.min[a])
    }

    /// Whether `point` is inside.
    pub fn contains(&self, point: [i32; 3]) -> bool {
        (0..3).all(|a| self.min[a] <= point[a] && point[a] < self.max[a])
    }

    /// Whether every point of `other` is inside.
    pub fn contains_box(&self, other: &Box3) -> bool {
        other.is_empty()
            || (0..3).all(|a| self.min[a] <= other.min[a] && other.max[a] <= self.max[a])
    }

    /// The common part, possibly empty.
    #[must_use]
    pub fn intersect(&self, other: &Box3) -> Box3 {
        Box3 {
            min: std::array::from_fn(|a| self.min[a].max(other.min[a])),
            max: std::array::from_fn(|a| self.max[a].min(other.max[a])),
        }
    }

    /// The box grown by `low` points downwards and `high` points upwards on every axis.
    #[must_use]
    pub fn grow(&self, low: i32, high: i32) -> Box3 {
        Box3 {
            min: self.min.map(|v| v - low),
            max: self.max.map(|v| v + high),
        }
    }

    /// Steps from the smallest point to `point`, which lies in the box or at its end. Boxes may span
    /// more than half of the integers: the difference is taken without a sign.
    pub fn local(&self, point: [i32; 3]) -> [u32; 3] {
        std::array::from_fn(|a| point[a].wrapping_sub(self.min[a]) as u32)
    }

    /// Offset of `point` in a dense array of this box, `i` fastest.
    pub fn offset_of(&self, point: [i32; 3]) -> usize {
        let size = self.size();
        let local = self.local(point).map(|v| v as usize);
        local[0] + size[0] as usize * (local[1] + size[1] as usize * local[2])
    }
}

impl fmt::Display for Box3 {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c] = [0, 1, 2].map(|i| format!("{}:{}", self.min[i], self.max[i]));
        write!(f, "{a},{b},{c}")
    }
}

impl FromStr for Box3 {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let bad = || {
            Error::bad_input(format!(
                "'{text}' is not a region: write x0:x1,y0:y1,z0:z1 with x0 < x1 and so on"
            ))
        };
        let mut region = Box3 {
            min: [0; 3],
            max: [0; 3],
        };
        let parts: Vec<&str> = text.split(',').collect();
        if parts.len() != 3 {
            return Err(bad());
        }
        for (axis, part) in parts.iter().enumerate() {
            let (low, high) = part.trim().split_once(':').ok_or_else(bad)?;
            region.min[axis] = low.trim().parse().map_err(|_| bad())?;
            region.max[axis] = high.trim().parse().map_err(|_| bad())?;
        }
        if region.is_empty() {
            Err(bad())
        } else {
            Ok(region)
        }
    }
}

/// Affine map from index space to world space: three rows of `[x, y, z, 1]` weights.
///
/// ```
/// use brickmarch::Affine;
/// let map = Affine::from_spacing([0.5, 0.5, 2.0], [10.0, 0.0, 0.0]);
/// assert_eq!(map.apply([2.0, 2.0, 2.0]), [11.0, 1.0, 4.0]);
/// assert!(!map.is_left_handed());
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine {
    /// `world[r] = rows[r][0] * i + rows[r][1] * j + rows[r][2] * k + rows[r][3]`.
    pub rows: [[f64; 4]; 3],
}

impl Affine {
    /// World is index space.
    pub const IDENTITY: Affine = Affine {
        rows: [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ],
    };

    /// Axis-aligned map with `spacing` world units per step and `origin` at index zero.
    pub fn from_spacing(spacing: [f64; 3], origin: [f64; 3]) -> Self {
        let mut rows = [[0.0; 4]; 3];
        for a in 0..3 {
            rows[a][a] = spacing[a];
            rows[a][3] = origin[a];
        }
        Self { rows }
    }

    /// Map with `columns[a]` the world step of index axis `a`, and `origin` at index zero.
    pub fn from_columns(columns: [[f64; 3]; 3], origin: [f64; 3]) -> Self {
        let row = |r: usize| [columns[0][r], columns[1][r], columns[2][r], origin[r]];
        Self {
            rows: [row(0), row(1), row(2)],
        }
    }

    /// World position of an index position.
    pub fn apply(&self, index: [f64; 3]) -> [f64; 3] {
        self.rows
            .map(|r| r[0] * index[0] + r[1] * index[1] + r[2] * index[2] + r[3])
    }

    fn linear(&self) -> DMat3 {
        let column = |a: usize| DVec3::new(self.rows[0][a], self.rows[1][a], self.rows[2][a]);
        DMat3::from_cols(column(0), column(1), column(2))
    }

    /// Volume of one cell with its sign; negative when the map mirrors.
    pub fn determinant(&self) -> f64 {
        self.linear().determinant()
    }

    /// Whether the map mirrors, so that triangle winding must be turned.
    pub fn is_left_handed(&self) -> bool {
        self.determinant() < 0.0
    }

    /// Length in world units of one step along each index axis.
    pub fn spacing(&self) -> [f64; 3] {
        let m = self.linear();
        [m.x_axis.length(), m.y_axis.length(), m.z_axis.length()]
    }

    /// Rows of the inverse transpose of the linear part: what turns index gradients to world gradients.
    pub fn gradient_rows(&self) -> [[f64; 3]; 3] {
        let m = self.linear().inverse().transpose();
        [
            m.row(0).to_array(),
            m.row(1).to_array(),
            m.row(2).to_array(),
        ]
    }

    /// The map from world to index.
    ///
    /// # Errors
    /// When the map is not finite or flattens space.
    pub fn inverse(&self) -> Result<Affine> {
        self.validate()?;
        let m = self.linear().inverse();
        let origin = m * -DVec3::new(self.rows[0][3], self.rows[1][3], self.rows[2][3]);
        let columns = [
            m.x_axis.to_array(),
            m.y_axis.to_array(),
            m.z_axis.to_array(),
        ];
        Ok(Affine::from_columns(columns, origin.to_array()))
    }

    /// # Errors
    /// When an entry is not finite, or the determinant is zero or not finite.
    pub fn validate(&self) -> Result<()> {
        let determinant = self.determinant();
        let finite = self.rows.iter().flatten().all(|v| v.is_finite());
        if !finite || !determinant.is_normal() {
            return Err(Error::bad_input(format!(
                "the index-to-world matrix {:?} is not finite or flattens space (determinant {determinant})",
                self.rows
            )));
        }
        Ok(())
    }
}

/// Length unit of world coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Units {
    #[default]
    Unknown,
    Millimetre,
    Micrometre,
    Metre,
    Nanometre,
}

impl Units {
    /// Short name as used on the command line: `none`, `mm`, `um`, `m`, `nm`.
    pub fn name(self) -> &'static str {
        match self {
            Units::Unknown => "none",
            Units::Millimetre => "mm",
            Units::Micrometre => "um",
            Units::Metre => "m",
            Units::Nanometre => "nm",
        }
    }
}

/// Where the samples are: the domain, and its place in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// All lattice points that carry a sample.
    pub domain: Box3,
    /// Index to world.
    pub index_to_world: Affine,
    /// Unit of the world coordinates.
    pub units: Units,
}

impl Grid {
    /// A grid of `domain` whose world is index space.
    pub fn new(domain: Box3) -> Self {
        Self {
            domain,
            index_to_world: Affine::IDENTITY,
            units: Units::Unknown,
        }
    }
}

/// Interleaves the low 21 bits of three coordinates, x lowest (Morton 1966).
pub fn morton_encode(p: [u32; 3]) -> u64 {
    fn spread(v: u32) -> u64 {
        let mut v = u64::from(v) & 0x1f_ffff;
        v = (v | v << 32) & 0x1f_0000_0000_ffff;
        v = (v | v << 16) & 0x1f_0000_ff00_00ff;
        v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
        v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
        (v | v << 2) & 0x1249_2492_4924_9249
    }
    spread(p[0]) | spread(p[1]) << 1 | spread(p[2]) << 2
}

/// Inverse of [`morton_encode`].
pub fn morton_decode(code: u64) -> [u32; 3] {
    fn compact(v: u64) -> u32 {
        let mut v = v & 0x1249_2492_4924_9249;
        v = (v ^ v >> 2) & 0x10c3_0c30_c30c_30c3;
        v = (v ^ v >> 4) & 0x100f_00f0_0f00_f00f;
        v = (v ^ v >> 8) & 0x1f_0000_ff00_00ff;
        v = (v ^ v >> 16) & 0x1f_0000_0000_ffff;
        (v ^ v >> 32) as u32 & 0x1f_ffff
    }
    [compact(code), compact(code >> 1), compact(code >> 2)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn morton_round_trip() {
        for p in [
            [0, 0, 0],
            [1, 2, 3],
            [0x1f_ffff, 0, 0x1f_ffff],
            [123_456, 999_999, 77],
        ] {
            assert_eq!(morton_decode(morton_encode(p)), p);
        }
        assert_eq!(morton_encode([1, 0, 0]), 1);
        assert_eq!(morton_encode([0, 1, 0]), 2);
        assert_eq!(morton_encode([0, 0, 1]), 4);
    }

    #[test]
    fn affine_inverse_round_trip() {
        let map = Affine::from_columns(
            [[0.0, 2.0, 0.0], [-0.5, 0.0, 0.1], [0.0, 0.0, 3.0]],
            [1.0, -2.0, 5.0],
        );
        let back = map.inverse().expect("regular");
        let p = back.apply(map.apply([3.0, -7.0, 11.0]));
        for (got, want) in p.iter().zip([3.0, -7.0, 11.0]) {
            assert!((got - want).abs() < 1e-12);
        }
        assert!(
            Affine::from_spacing([1.0, 0.0, 1.0], [0.0; 3])
                .validate()
                .is_err()
        );
        assert!(Affine::from_spacing([1.0, -1.0, 1.0], [0.0; 3]).is_left_handed());
    }

    #[test]
    fn regions_parse_or_say_how() {
        assert!("0:1,0:1".parse::<Box3>().is_err());
        assert!("3:3,0:1,0:1".parse::<Box3>().is_err());
        let region = Box3::new([-3, 0, 9], [4, 5, 10]);
        assert_eq!(
            region.to_string().parse::<Box3>().expect("own output"),
            region
        );
    }
}
