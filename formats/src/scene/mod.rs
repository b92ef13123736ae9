//! Scene files: implicit models as TOML text. `docs/scenes.md` says what a scene may contain.

mod keys;
mod leaves;
mod letters;
mod part;
mod scope;
mod shapes;
#[cfg(test)]
mod tests;
mod value;

use brickmarch::model::{Model, Shape};
use brickmarch::{Budget, Error, Grid, Result, Units};
use std::path::Path;

/// A scene: what is solid, and where to look.
#[derive(Clone, Debug)]
pub struct Scene {
    /// What the scene calls itself.
    pub title: String,
    /// The solid.
    pub shape: Shape,
    /// Smallest and largest corner of the part of the world that the scene is in.
    pub bounds: [[f64; 3]; 2],
    /// Unit of lengths.
    pub units: Units,
    /// Cells along the longest edge when nobody says otherwise.
    pub resolution: Option<u32>,
}

impl Scene {
    /// Reads a scene file, the files that it includes and the headers of its data files.
    ///
    /// # Errors
    /// Names file, line and key, and says what to do.
    ///
    /// # Memory
    /// The text of the scene (at most 16 MiB a file); data files that are no volumes are
    /// turned into a temporary volume and read in pieces through `budget`.
    pub fn read(path: &Path, budget: &Budget) -> Result<Scene> {
        scope::read(path, budget)
    }

    /// The lattice with `resolution` cells along the longest edge of the bounds.
    ///
    /// # Errors
    /// When the bounds are empty.
    pub fn lattice(&self, resolution: u32) -> Result<Grid> {
        let [low, high] = self.bounds;
        let longest = (0..3).fold(0.0f64, |m, a| m.max(high[a] - low[a]));
        if resolution == 0 {
            return Err(Error::bad_input("resolution 0: give at least 1"));
        }
        Model::lattice(self.bounds, longest / f64::from(resolution), self.units)
    }
}
