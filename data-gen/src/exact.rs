//! Known answers: area, volume and topology of the scenes from formulas.

use crate::distance::{TORUS, TWO_BALLS};
use crate::fields::{SceneName, scale_of};
use crate::gyroid_exact;
use serde::Serialize;
use std::f64::consts::PI;

/// What is known about the surface of a scene at its isovalue, in voxels.
///
/// The surface is that of the formula inside the box from the first to the last lattice point.
/// A mesh of samples comes nearer to `area` and `volume` with the square of the resolution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Exact {
    /// Area of the surface inside the box; where the solid leaves the box, the cap is not counted.
    pub area: f64,
    /// Area of the part of the faces of the box that is inside the solid: the caps.
    pub cap_area: f64,
    /// Volume of the solid inside the box.
    pub volume: f64,
    /// Bound of the relative error of the three numbers above.
    pub relative_error: f64,
    /// Connected pieces of the closed surface, where a formula tells.
    pub components: Option<u64>,
    /// Handles of all pieces together, where a formula tells.
    pub genus: Option<u64>,
    /// Euler characteristic of the closed surface, where a formula tells.
    pub euler: Option<i64>,
}

impl Exact {
    /// The answers for scene `name` on a lattice of `size`; `None` where no formula tells.
    pub fn of(name: SceneName, size: [u32; 3]) -> Option<Exact> {
        let n = f64::from(scale_of(size));
        match name {
            SceneName::Sphere | SceneName::LevelSetSphere => Some(spheres(&[0.4 * n])),
            SceneName::TwoSpheres => Some(spheres(&TWO_BALLS.map(|(_, radius)| radius * n))),
            SceneName::Torus => Some(torus(TORUS.0 * n, TORUS.1 * n)),
            SceneName::Gyroid => gyroid_exact::positive_part(size),
            SceneName::LevelSetGyroid => gyroid_exact::negative_part(size),
            SceneName::Noise | SceneName::Ct => None,
        }
        .filter(|_| fits(name, size))
    }
}

/// Whether the surface stays clear of the border of the box, or is cut by it as the formula says.
fn fits(name: SceneName, size: [u32; 3]) -> bool {
    let n = f64::from(scale_of(size));
    // The widest of the closed scenes needs 0.42 n on each side of the centre.
    matches!(name, SceneName::Gyroid | SceneName::LevelSetGyroid) || n >= 8.0
}

fn closed(area: f64, volume: f64, components: u64, genus: u64) -> Exact {
    Exact {
        area,
        cap_area: 0.0,
        volume,
        relative_error: 1e-15,
        components: Some(components),
        genus: Some(genus),
        euler: Some(2 * components as i64 - 2 * genus as i64),
    }
}

fn spheres(radii: &[f64]) -> Exact {
    let area = radii.iter().map(|r| 4.0 * PI * r * r).sum();
    let volume = radii.iter().map(|r| 4.0 / 3.0 * PI * r * r * r).sum();
    closed(area, volume, radii.len() as u64, 0)
}

fn torus(ring: f64, tube: f64) -> Exact {
    let area = 4.0 * PI * PI * ring * tube;
    let volume = 2.0 * PI * PI * ring * tube * tube;
    closed(area, volume, 1, 1)
}
