//! A solid texture as fields of the engine, one for each channel.

use crate::texture::{Painter, Texture};
use brickmarch::store::VolumeSpec;
use brickmarch::{Box3, Field, Grid, Range, Result, SampleType, Samples};

/// Red, green or blue of a [`Texture`] on a grid.
#[derive(Clone, Debug)]
pub struct TextureField {
    texture: Texture,
    grid: Grid,
    channel: usize,
    /// World position of the point that the texture has at its origin, and the distance of rings.
    centre: [f64; 3],
    period: f64,
}

impl TextureField {
    /// The three channels; the texture has its origin at `centre` and its rings or veins `period` apart, both in
    /// world units.
    pub fn channels(
        texture: Texture,
        grid: Grid,
        centre: [f64; 3],
        period: f64,
    ) -> [TextureField; 3] {
        std::array::from_fn(|channel| TextureField {
            texture,
            grid,
            channel,
            centre,
            period,
        })
    }

    /// Lowest and highest world coordinates of the samples of a grid.
    pub fn bounds(grid: &Grid) -> [[f64; 3]; 2] {
        let corner = |n: usize| {
            let end =
                |a: usize| f64::from([grid.domain.min[a], grid.domain.max[a] - 1][n >> a & 1]);
            grid.index_to_world.apply([end(0), end(1), end(2)])
        };
        let mut bounds = [corner(0); 2];
        for p in (1..8).map(corner) {
            for a in 0..3 {
                bounds[0][a] = bounds[0][a].min(p[a]);
                bounds[1][a] = bounds[1][a].max(p[a]);
            }
        }
        bounds
    }

    /// What a volume of it is: bytes, called `color.r`, `color.g` or `color.b`.
    pub fn volume_spec(&self) -> VolumeSpec {
        VolumeSpec {
            name: format!("color.{}", ["r", "g", "b"][self.channel]),
            history: format!(
                "brickmarch-data-gen: {} around {:?}, period {}",
                self.texture, self.centre, self.period
            ),
            ..VolumeSpec::new(self.grid, SampleType::U8)
        }
    }
}

impl Field for TextureField {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    fn read(&self, region: Box3, out: &mut Samples<'_>) -> Result<()> {
        let [nx, ny, nz] = region.size().map(|n| n as usize);
        let mut painter = Painter::new(self.texture);
        for dk in 0..nz {
            for dj in 0..ny {
                let row = out.row_mut(dj, dk, nx);
                for (di, value) in row.iter_mut().enumerate() {
                    let step = [di as i32, dj as i32, dk as i32];
                    let index = std::array::from_fn(|a| f64::from(region.min[a] + step[a]));
                    let world = self.grid.index_to_world.apply(index);
                    let p = std::array::from_fn(|a| (world[a] - self.centre[a]) / self.period);
                    *value = painter.colour(p)[self.channel].round() as f32;
                }
            }
        }
        Ok(())
    }

    fn range(&self, _region: Box3) -> Result<Range> {
        Ok(Range {
            min: 0.0,
            max: 255.0,
            has_nan: false,
        })
    }
}
