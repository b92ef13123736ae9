//! Where the surface can be: the box of the blocks that may hold an inside sample.

use super::camera::WorldBox;
use brickmarch::{Box3, Field, Inside, Range, Result};
use glam::DVec3;

/// World corners of a box of blocks that holds every inside sample of `region`, and so its surface
/// and its caps; of the whole region when there is none. Found by halving and by range.
///
/// # Errors
/// What the field reports.
pub(crate) fn crossing_bounds(
    field: &dyn Field,
    region: Box3,
    iso: f32,
    inside: Inside,
) -> Result<WorldBox> {
    let may_hold = |range: Range| match inside {
        Inside::Above => range.max >= iso,
        Inside::Below => range.min < iso,
    };
    let mut found = None;
    descend(field, region, &may_hold, &mut found)?;
    // The surface leaves an inside sample by less than one step.
    let bounds = found.map_or(region, |f: Box3| f.grow(1, 1).intersect(&region));
    let map = field.grid().index_to_world;
    let corners = (0..8)
        .map(|c| {
            let index = std::array::from_fn(|a| {
                let highest = bounds.max[a] - 1;
                f64::from(if c >> a & 1 == 0 {
                    bounds.min[a]
                } else {
                    highest
                })
            });
            DVec3::from_array(map.apply(index))
        })
        .collect();
    Ok(WorldBox { corners })
}

fn descend(
    field: &dyn Field,
    part: Box3,
    may_hold: &dyn Fn(Range) -> bool,
    found: &mut Option<Box3>,
) -> Result<()> {
    if part.is_empty()
        || found.is_some_and(|f| f.contains_box(&part))
        || !may_hold(field.range(part)?)
    {
        return Ok(());
    }
    let size = part.size();
    let axis = (0..3).max_by_key(|&a| size[a]).expect("three axes");
    if size[axis] <= field.block_edge() {
        *found = Some(match *found {
            None => part,
            Some(f) => Box3 {
                min: std::array::from_fn(|a| f.min[a].min(part.min[a])),
                max: std::array::from_fn(|a| f.max[a].max(part.max[a])),
            },
        });
        return Ok(());
    }
    let (mut low, mut high) = (part, part);
    low.max[axis] = part.min[axis] + (size[axis] / 2) as i32;
    high.min[axis] = low.max[axis];
    descend(field, low, may_hold, found)?;
    descend(field, high, may_hold, found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use brickmarch::{Grid, field::Dense};

    #[test]
    fn the_box_holds_the_inside_and_little_more() {
        let domain = Box3::from_size([100, 100, 100]);
        let mut values = vec![0.0; 1_000_000];
        values[domain.offset_of([40, 50, 60])] = 1.0;
        let field = Dense::new(Grid::new(domain), values).expect("counts");
        let corners = crossing_bounds(&field, domain, 0.5, Inside::Above)
            .expect("reads")
            .corners;
        let (low, high) = (corners[0], corners[7]);
        assert!(low.cmple(DVec3::new(39.0, 49.0, 59.0)).all());
        assert!(high.cmpge(DVec3::new(41.0, 51.0, 61.0)).all());
        assert!((high - low).max_element() <= 34.0);
    }
}
