//! From a region on the command line to a box of samples.

use crate::args::Region;
use brickmarch::{Box3, Error, Grid, Result};

/// The box of samples that `region` asks for; the whole domain when it asks for nothing.
///
/// # Errors
/// When it does not lie in the domain.
pub(super) fn resolve(region: &Region, grid: &Grid) -> Result<Option<Box3>> {
    if let Some(roi) = region.roi {
        if !grid.domain.contains_box(&roi) {
            return Err(Error::bad_input(format!(
                "--roi {roi} is not inside the domain {}",
                grid.domain
            )));
        }
        return Ok(Some(roi));
    }
    region
        .roi_world
        .map(|world| from_world(world, grid))
        .transpose()
}

/// Samples whose world position may lie in `world`: the box in index space of its eight corners.
fn from_world(world: [[f64; 2]; 3], grid: &Grid) -> Result<Box3> {
    let back = grid.index_to_world.inverse()?;
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for corner in 0..8 {
        let index = back.apply(std::array::from_fn(|a| world[a][corner >> a & 1]));
        for a in 0..3 {
            low[a] = low[a].min(index[a]);
            high[a] = high[a].max(index[a]);
        }
    }
    // The slack takes up the rounding of the matrix: a sample on the border is in.
    let slack = 1e-6;
    let asked = Box3 {
        min: low.map(|v| (v - slack).ceil() as i32),
        max: high.map(|v| ((v + slack).floor() as i32).saturating_add(1)),
    };
    let found = asked.intersect(&grid.domain);
    if found.is_empty() {
        let map = grid.index_to_world;
        let first = map.apply(grid.domain.min.map(f64::from));
        let last = map.apply(grid.domain.max.map(|v| f64::from(v - 1)));
        return Err(Error::bad_input(format!(
            "--roi-world holds no sample: the volume reaches from {first:?} to {last:?}"
        )));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use brickmarch::Affine;

    #[test]
    fn a_world_region_follows_the_matrix() {
        let grid = Grid {
            index_to_world: Affine::from_spacing([0.5, -1.0, 2.0], [10.0, 0.0, 0.0]),
            ..Grid::new(Box3::from_size([20, 20, 20]))
        };
        let found = from_world([[11.0, 13.0], [-3.0, -1.0], [0.0, 100.0]], &grid).expect("inside");
        assert_eq!(found, Box3::new([2, 1, 0], [7, 4, 20]));
        assert!(from_world([[0.0, 1.0], [0.0, 1.0], [0.0, 1.0]], &grid).is_err());
    }
}
