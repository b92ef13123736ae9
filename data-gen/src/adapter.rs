//! A scene as a field of the engine: the only part of this library that knows the engine.

use crate::fields::{Meaning, Sample, Scene, SceneName};
use brickmarch::store::VolumeSpec;
use brickmarch::{Affine, Box3, Field, Grid, Kind, Range, Result, SampleType, Samples, Units};

/// A [`Scene`] that the engine can read.
///
/// ```
/// use brickmarch::{Box3, Field};
/// use brickmarch_data_gen::{Scene, SceneField, SceneName};
/// let field = SceneField::new(Scene::new(SceneName::Sphere, 64).unwrap());
/// let corner = field.range(Box3::from_size([8, 8, 8])).unwrap();
/// assert!(corner.min > 0.0);
/// ```
#[derive(Clone, Debug)]
pub struct SceneField {
    scene: Scene,
    grid: Grid,
    /// See [`Field::block_edge`].
    pub block_edge: u32,
}

impl SceneField {
    /// The scene with its first point at index zero. World is index space, but for the scan, whose
    /// shortest side is 400 mm.
    pub fn new(scene: Scene) -> Self {
        let mut grid = Grid::new(Box3::from_size(scene.size().map(|s| s as i32)));
        if scene.name() == SceneName::Ct {
            let spacing = 400.0 / f64::from(scene.n());
            grid.index_to_world = Affine::from_spacing([spacing; 3], [0.0; 3]);
            grid.units = Units::Millimetre;
        }
        Self {
            scene,
            grid,
            block_edge: 32,
        }
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// What a volume file of the scene is.
    pub fn volume_spec(&self) -> VolumeSpec {
        let name = self.scene.name().name();
        let [x, y, z] = self.scene.size();
        VolumeSpec {
            kind: self.kind(),
            background: f64::from(self.scene.background()),
            history: format!("brickmarch-data-gen: {name}, {x} x {y} x {z}"),
            name: name.to_owned(),
            ..VolumeSpec::new(self.grid, self.sample_type())
        }
    }

    /// Type that stores the samples without loss.
    pub fn sample_type(&self) -> SampleType {
        match self.scene.sample() {
            Sample::F32 => SampleType::F32,
            Sample::I16 => SampleType::I16,
        }
    }
}

impl Field for SceneField {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    fn kind(&self) -> Kind {
        match self.scene.meaning() {
            Meaning::Density => Kind::Density,
            Meaning::Distance => Kind::Distance,
        }
    }

    fn block_edge(&self) -> u32 {
        self.block_edge
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()> {
        let [nx, ny, nz] = region.size();
        let [i, j, k] = region.min.map(|v| v as u32);
        for dk in 0..nz {
            for dj in 0..ny {
                let row = out.row_mut(dj as usize, dk as usize, nx as usize);
                self.scene.fill_row(j + dj, k + dk, i, row);
            }
        }
        Ok(())
    }

    fn range(&self, region: Box3) -> Result<Range> {
        let (min, max) = self.scene.range(region.min, region.max);
        Ok(Range {
            min,
            max,
            has_nan: false,
        })
    }
}
