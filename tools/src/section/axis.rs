//! A section across an axis of the lattice: its samples as they are.

use super::{Sheet, paper};
use brickmarch::{Box3, Budget, Error, Field, Grid, Result, Samples};

/// The axes to the right and down (or up) of a slice across `axis`.
fn sides(axis: usize) -> [usize; 2] {
    [[1, 2], [0, 2], [0, 1]][axis]
}

/// The samples of the slice `index` across `axis` of `region`.
///
/// # Errors
/// When the slice is not in the region.
pub(crate) fn plane(region: Box3, axis: usize, index: i32) -> Result<Box3> {
    if index < region.min[axis] || index >= region.max[axis] {
        return Err(Error::bad_input(format!(
            "slice {} = {index} is outside of {}..{}",
            ["x", "y", "z"][axis],
            region.min[axis],
            region.max[axis]
        )));
    }
    let mut plane = region;
    plane.min[axis] = index;
    plane.max[axis] = index + 1;
    Ok(plane)
}

/// Size of the picture of a plane across `axis`, by the spacing of the samples; `scale` pixels a sample along
/// the finer axis.
///
/// # Errors
/// When it has a side that is too long.
pub(crate) fn pixels(grid: &Grid, plane: Box3, axis: usize, scale: f64) -> Result<[u32; 2]> {
    let spacing = grid.index_to_world.spacing();
    let sides = sides(axis);
    let fine = spacing[sides[0]].min(spacing[sides[1]]);
    paper(sides.map(|a| f64::from(plane.size()[a]) * spacing[a] / fine * scale))
}

/// Reads a plane that [`plane`] gave.
///
/// # Errors
/// When it does not fit the budget, and what the field reports.
///
/// # Memory
/// 8 bytes a sample.
pub(crate) fn sheet(
    field: &dyn Field,
    plane: Box3,
    axis: usize,
    scale: f64,
    budget: &Budget,
) -> Result<Sheet> {
    let samples = plane.count();
    let permit = budget.take(
        samples.saturating_mul(8),
        "the slice (a smaller --roi takes less)",
    )?;
    let pixels = pixels(field.grid(), plane, axis, scale)?;
    let mut values = vec![0f32; samples as usize];
    read_by_blocks(field, plane, &mut values, budget)?;
    let size = sides(axis).map(|a| plane.size()[a] as usize);
    let right = sides(axis)[0];
    let width = field.grid().index_to_world.spacing()[right] * size[0] as f64;
    Ok(Sheet {
        values,
        size,
        pixels,
        up: axis != 2,
        unit: width / f64::from(pixels[0]),
        cover: None,
        _permit: permit,
    })
}

/// Reads the plane block by block, so that a large one can be stopped.
fn read_by_blocks(field: &dyn Field, plane: Box3, out: &mut [f32], budget: &Budget) -> Result<()> {
    let edge = field.block_edge() as i32;
    let row = plane.size()[0] as usize;
    let slice = row * plane.size()[1] as usize;
    let origin = field.grid().domain.min;
    // Strips along x: a block row at a time.
    let next =
        |at: i32, a: usize| (origin[a] + ((at - origin[a]) / edge + 1) * edge).min(plane.max[a]);
    let mut k = plane.min[2];
    while k < plane.max[2] {
        let mut j = plane.min[1];
        while j < plane.max[1] {
            budget.check_cancelled()?;
            let strip = Box3::new([plane.min[0], j, k], [plane.max[0], next(j, 1), next(k, 2)]);
            let start = plane.offset_of(strip.min);
            let mut samples = Samples {
                values: &mut out[start..],
                row,
                slice,
            };
            field.read(strip, &mut samples)?;
            j = strip.max[1];
        }
        k = next(k, 2);
    }
    Ok(())
}
