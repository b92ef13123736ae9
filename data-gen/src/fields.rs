//! The scenes: scalar fields at the points of a lattice, with conservative ranges.
//!
//! A scene is defined by formula at the integer points of `0..size`. The scale of everything in it
//! is `n`, the shortest side, so that one scene at two sizes is one shape at two resolutions.
//! Values depend on nothing but name, size and point: they are equal on every machine.

use crate::distance::{Ball, Torus, TwoBalls};
use crate::exact::Exact;
use crate::gyroid::Gyroid;
use crate::noise::Noise;
use crate::phantom::Phantom;
use serde::Serialize;
use std::fmt;
use std::str::FromStr;

/// Half-width of the narrow band of a level set, in voxels; values beyond it are this far.
pub const BAND: f32 = 3.0;

/// Periods of the gyroid along the shortest side.
pub const GYROID_PERIODS: u32 = 8;

/// Longest side of a scene.
pub const SIZE_MAX: u32 = 1 << 20;

/// What the samples mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Meaning {
    /// Inside is where the value is not below the isovalue.
    Density,
    /// Signed distance in voxels, negative inside.
    Distance,
}

/// Type of a stored sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Sample {
    /// 32-bit floating point.
    F32,
    /// 16-bit signed integer.
    I16,
}

/// Which side of the isovalue is inside. A value equal to it is above; NaN is outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// Inside is `value >= iso`.
    Above,
    /// Inside is `value < iso`.
    Below,
}

impl Side {
    /// Whether a sample is inside.
    #[inline]
    pub fn contains(self, value: f32, iso: f32) -> bool {
        match self {
            Side::Above => value >= iso,
            Side::Below => value < iso,
        }
    }
}

/// Names of the scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SceneName {
    /// Distance to a sphere of radius 0.4 n about the centre of the domain.
    Sphere,
    /// `sin x cos y + sin y cos z + sin z cos x`, 8 periods along the shortest side.
    Gyroid,
    /// Distance to a torus about the z axis, radii 0.3 n and 0.12 n.
    Torus,
    /// Distance to two disjoint spheres of radii 0.18 n and 0.2 n.
    TwoSpheres,
    /// Three octaves of smooth noise with 24, 48 and 96 cells along the shortest side.
    Noise,
    /// A chest as a CT scanner would see it, in Hounsfield units, with noise in every voxel.
    Ct,
    /// The sphere as a narrow band of half-width 3, clamped beyond.
    LevelSetSphere,
    /// The gyroid divided by the length of its gradient, as a narrow band of half-width 3.
    LevelSetGyroid,
}

impl SceneName {
    /// Every scene.
    pub const ALL: [SceneName; 8] = [
        SceneName::Sphere,
        SceneName::Gyroid,
        SceneName::Torus,
        SceneName::TwoSpheres,
        SceneName::Noise,
        SceneName::Ct,
        SceneName::LevelSetSphere,
        SceneName::LevelSetGyroid,
    ];

    /// Name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            SceneName::Sphere => "sphere",
            SceneName::Gyroid => "gyroid",
            SceneName::Torus => "torus",
            SceneName::TwoSpheres => "two-spheres",
            SceneName::Noise => "noise",
            SceneName::Ct => "ct",
            SceneName::LevelSetSphere => "level-set-sphere",
            SceneName::LevelSetGyroid => "level-set-gyroid",
        }
    }

    /// What the samples mean.
    pub const fn meaning(self) -> Meaning {
        match self {
            SceneName::Gyroid | SceneName::Noise | SceneName::Ct => Meaning::Density,
            _ => Meaning::Distance,
        }
    }

    /// Type that holds the samples without loss.
    pub const fn sample(self) -> Sample {
        match self {
            SceneName::Ct => Sample::I16,
            _ => Sample::F32,
        }
    }

    /// The isovalue whose surface is worth looking at: 0, and bone for the scan.
    pub const fn iso(self) -> f32 {
        match self {
            SceneName::Ct => 250.0,
            _ => 0.0,
        }
    }

    /// What the samples are outside everything: far, air.
    pub const fn background(self) -> f32 {
        match self {
            SceneName::LevelSetSphere | SceneName::LevelSetGyroid => BAND,
            SceneName::Ct => -1000.0,
            _ => 0.0,
        }
    }
}

impl fmt::Display for SceneName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for SceneName {
    type Err = SceneError;

    fn from_str(text: &str) -> Result<Self, SceneError> {
        let found = Self::ALL.into_iter().find(|s| s.name() == text);
        found.ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            SceneError(format!("'{text}' is not a scene: use one of {names}"))
        })
    }
}

/// A scene that cannot be made, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SceneError(pub(crate) String);

impl fmt::Display for SceneError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for SceneError {}

/// A scalar field at the lattice points `0..size`.
///
/// # Memory
/// Tables of at most 128 bytes per point of the longest side.
#[derive(Clone, Debug)]
pub struct Scene {
    name: SceneName,
    size: [u32; 3],
    shape: Shape,
    /// Samples are `round(value * scale)` in the range of `i16`.
    scale: Option<f32>,
}

#[derive(Clone, Debug)]
enum Shape {
    Ball(Ball),
    BallBand(Ball),
    TwoBalls(TwoBalls),
    Torus(Torus),
    Gyroid(Gyroid),
    GyroidBand(Gyroid),
    Noise(Noise),
    Phantom(Phantom),
}

impl Scene {
    /// The scene on an `n` by `n` by `n` lattice.
    ///
    /// # Errors
    /// When `n` is below 2 or above [`SIZE_MAX`].
    pub fn new(name: SceneName, n: u32) -> Result<Self, SceneError> {
        Self::with_size(name, [n; 3])
    }

    /// The scene on a lattice of `size`; its scale is the shortest side.
    ///
    /// # Errors
    /// When a side is below 2 or above [`SIZE_MAX`].
    pub fn with_size(name: SceneName, size: [u32; 3]) -> Result<Self, SceneError> {
        if let Some(&bad) = size.iter().find(|&&s| !(2..=SIZE_MAX).contains(&s)) {
            return Err(SceneError(format!(
                "a side of {bad} points is not possible: give 2 to {SIZE_MAX}"
            )));
        }
        let shape = match name {
            SceneName::Sphere => Shape::Ball(Ball::scene(size)),
            SceneName::LevelSetSphere => Shape::BallBand(Ball::scene(size)),
            SceneName::TwoSpheres => Shape::TwoBalls(TwoBalls::scene(size)),
            SceneName::Torus => Shape::Torus(Torus::scene(size)),
            SceneName::Gyroid => Shape::Gyroid(Gyroid::scene(size)),
            SceneName::LevelSetGyroid => Shape::GyroidBand(Gyroid::scene(size)),
            SceneName::Noise => Shape::Noise(Noise::scene(size)),
            SceneName::Ct => Shape::Phantom(Phantom::scene(size)),
        };
        Ok(Self {
            name,
            size,
            shape,
            scale: None,
        })
    }

    /// The same scene in 16-bit integers: `round(value * scale)`, ties to even, saturating.
    /// The isovalue scales with it; so does what a distance means.
    #[must_use]
    pub fn quantized(mut self, scale: f32) -> Self {
        self.scale = Some(scale);
        self
    }

    /// Name of the scene.
    pub fn name(&self) -> SceneName {
        self.name
    }

    /// Points per axis.
    pub fn size(&self) -> [u32; 3] {
        self.size
    }

    /// The scale of the scene: its shortest side.
    pub fn n(&self) -> u32 {
        scale_of(self.size)
    }

    /// What the samples mean.
    pub fn meaning(&self) -> Meaning {
        self.name.meaning()
    }

    /// Type that holds the samples without loss.
    pub fn sample(&self) -> Sample {
        match self.scale {
            Some(_) => Sample::I16,
            None => self.name.sample(),
        }
    }

    /// The isovalue worth looking at.
    pub fn iso(&self) -> f32 {
        self.name.iso() * self.scale.unwrap_or(1.0)
    }

    /// The side that is inside.
    pub fn inside(&self) -> Side {
        match self.meaning() {
            Meaning::Density => Side::Above,
            Meaning::Distance => Side::Below,
        }
    }

    /// What a sample is where there is nothing.
    pub fn background(&self) -> f32 {
        self.stored(self.name.background())
    }

    /// Known answers for the surface at [`iso`](Self::iso), where there are any.
    pub fn exact(&self) -> Option<Exact> {
        Exact::of(self.name, self.size)
    }

    /// The sample at a point.
    ///
    /// # Panics
    /// When the point is outside the domain.
    pub fn value(&self, i: u32, j: u32, k: u32) -> f32 {
        self.check([i, j, k], 1);
        let [i, j, k] = [i, j, k].map(|v| v as usize);
        self.stored(match &self.shape {
            Shape::Ball(ball) => ball.value(i, j, k),
            Shape::BallBand(ball) => clamp_band(ball.value(i, j, k)),
            Shape::TwoBalls(two) => two.value(i, j, k),
            Shape::Torus(torus) => torus.value(i, j, k),
            Shape::Gyroid(gyroid) => gyroid.value(i, j, k),
            Shape::GyroidBand(gyroid) => gyroid.band_value(i, j, k),
            Shape::Noise(noise) => noise.value(i, j, k),
            Shape::Phantom(phantom) => phantom.value(i, j, k),
        })
    }

    /// The samples `i0..i0 + out.len()` of row `j`, `k`, each equal to [`value`](Self::value) bit
    /// for bit.
    ///
    /// # Panics
    /// When the row part is not inside the domain.
    pub fn fill_row(&self, j: u32, k: u32, i0: u32, out: &mut [f32]) {
        self.check([i0, j, k], out.len());
        let [i0, j, k] = [i0, j, k].map(|v| v as usize);
        match &self.shape {
            Shape::Ball(ball) => ball.fill_row(j, k, i0, out),
            Shape::BallBand(ball) => {
                ball.fill_row(j, k, i0, out);
                out.iter_mut().for_each(|v| *v = clamp_band(*v));
            }
            Shape::TwoBalls(two) => two.fill_row(j, k, i0, out),
            Shape::Torus(torus) => torus.fill_row(j, k, i0, out),
            Shape::Gyroid(gyroid) => gyroid.fill_row(j, k, i0, out),
            Shape::GyroidBand(gyroid) => gyroid.fill_band_row(j, k, i0, out),
            Shape::Noise(noise) => noise.fill_row(j, k, i0, out),
            Shape::Phantom(phantom) => phantom.fill_row(j, k, i0, out),
        }
        if let Some(scale) = self.scale {
            out.iter_mut().for_each(|v| *v = to_i16_value(*v * scale));
        }
    }

    /// A lowest and a highest value, never narrower than the samples of the half-open box
    /// `min..max`, or rather of its part inside the domain. `(inf, -inf)` when that is empty.
    pub fn range(&self, min: [i32; 3], max: [i32; 3]) -> (f32, f32) {
        let size = self.size;
        let low: [usize; 3] = std::array::from_fn(|a| min[a].max(0) as usize);
        let end: [usize; 3] =
            std::array::from_fn(|a| i64::from(max[a]).clamp(0, i64::from(size[a])) as usize);
        if (0..3).any(|a| end[a] <= low[a]) {
            return (f32::INFINITY, f32::NEG_INFINITY);
        }
        let high = end.map(|v| v - 1);
        let (lo, hi) = match &self.shape {
            Shape::Ball(ball) => ball.range(low, high),
            Shape::BallBand(ball) => {
                let (lo, hi) = ball.range(low, high);
                (clamp_band(lo), clamp_band(hi))
            }
            Shape::TwoBalls(two) => two.range(low, high),
            Shape::Torus(torus) => torus.range(low, high),
            Shape::Gyroid(gyroid) => gyroid.range(low, high),
            Shape::GyroidBand(gyroid) => gyroid.band_range(low, high),
            Shape::Noise(noise) => noise.range(low, high),
            Shape::Phantom(phantom) => phantom.range(low, high),
        };
        // Rounding is monotonic, so the ends go where the samples go.
        let (a, b) = (self.stored(lo), self.stored(hi));
        (a.min(b), a.max(b))
    }

    fn stored(&self, value: f32) -> f32 {
        match self.scale {
            Some(scale) => to_i16_value(value * scale),
            None => value,
        }
    }

    fn check(&self, point: [u32; 3], length: usize) {
        let end = u64::from(point[0]) + length as u64;
        let inside =
            end <= u64::from(self.size[0]) && point[1] < self.size[1] && point[2] < self.size[2];
        assert!(
            inside,
            "{length} samples from {point:?} are not inside a domain of {:?}",
            self.size
        );
    }
}

/// The scale of a scene of `size`.
pub(crate) fn scale_of(size: [u32; 3]) -> u32 {
    size[0].min(size[1]).min(size[2])
}

#[inline]
fn clamp_band(value: f32) -> f32 {
    value.clamp(-BAND, BAND)
}

/// `value` rounded to an integer, ties to even, within the range of `i16`.
///
/// Adding and subtracting 1.5 * 2^23 leaves no fraction bits: unlike a call of `round` this is two
/// vector instructions everywhere.
#[inline]
pub(crate) fn to_i16_value(value: f32) -> f32 {
    const SHIFT: f32 = 12_582_912.0;
    (value.clamp(-32768.0, 32767.0) + SHIFT) - SHIFT
}
