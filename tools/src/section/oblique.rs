//! A section in any direction: where it lies, and its values.
//!
//! The frame is in the world, so that pixels are square there. One looks along `right x down`, which is the
//! normal that was given.

use super::{Sheet, paper};
use brickmarch::query::{Method, Plane, sample_plane};
use brickmarch::{Box3, Budget, Error, Field, Grid, Result};
use glam::DVec3;

/// A sine below which directions count as one.
const PARALLEL: f64 = 1e-6;
/// Parts of a step by which rounding may move a position.
const ROUNDING: f64 = 1e-9;

/// A plane through a point, as one looks at it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Frame {
    pub through: DVec3,
    /// Unit vectors.
    pub right: DVec3,
    pub up: DVec3,
}

impl Frame {
    /// The plane across `normal`, the direction in which one looks. What is up is `up` as far as it lies in the
    /// plane: z if nothing is said, and -y where one looks along z, as for slices across z.
    ///
    /// # Errors
    /// When the vectors name no plane.
    pub(crate) fn across(normal: DVec3, up: Option<DVec3>, through: DVec3) -> Result<Frame> {
        let look = normal.try_normalize().ok_or_else(|| {
            Error::bad_input("--normal 0,0,0 is no direction: give the direction in which to look")
        })?;
        let wanted = match up {
            Some(up) => up.try_normalize().ok_or_else(|| {
                Error::bad_input("--up 0,0,0 is no direction: give what is up in the picture")
            })?,
            None if look.cross(DVec3::Z).length() < PARALLEL => DVec3::NEG_Y,
            None => DVec3::Z,
        };
        let right = look.cross(wanted);
        if right.length() < PARALLEL {
            return Err(Error::bad_input(
                "--up is along the normal: give a direction that lies in the plane, or leave it out",
            ));
        }
        let right = right.normalize();
        Ok(Frame {
            through,
            right,
            up: right.cross(look),
        })
    }

    /// The plane through three points: the second is to the right of the first, the third above them.
    ///
    /// # Errors
    /// When they lie on a line.
    pub(crate) fn through(points: [DVec3; 3]) -> Result<Frame> {
        let [a, b] = [points[1] - points[0], points[2] - points[0]];
        let normal = b.cross(a);
        // Not larger is also where something is not a number.
        if normal.length() <= PARALLEL * a.length() * b.length() {
            return Err(Error::bad_input(
                "the three points of --through lie on a line: give three corners of a triangle",
            ));
        }
        let right = a.normalize();
        Ok(Frame {
            through: points[0],
            right,
            up: right.cross(normal.normalize()),
        })
    }

    /// Where the plane meets the samples of `region`: lowest and highest place to the right and up.
    fn extent(&self, grid: &Grid, region: Box3) -> Result<[[f64; 2]; 2]> {
        let corner = |n: usize| {
            let index = std::array::from_fn(|a| {
                f64::from(match n >> a & 1 {
                    0 => region.min[a],
                    _ => region.max[a] - 1,
                })
            });
            DVec3::from(grid.index_to_world.apply(index)) - self.through
        };
        let corners: [DVec3; 8] = std::array::from_fn(corner);
        let far = corners.iter().fold(0.0, |far: f64, c| far.max(c.length()));
        let look = self.up.cross(self.right);
        let before = |p: DVec3| look.dot(p);
        let mut extent = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        let mut add = |p: DVec3| {
            for (ends, at) in extent.iter_mut().zip([self.right.dot(p), self.up.dot(p)]) {
                *ends = [ends[0].min(at), ends[1].max(at)];
            }
        };
        for n in 0..8 {
            let d = before(corners[n]);
            if d.abs() <= ROUNDING * far {
                add(corners[n]);
            }
            for axis in (0..3).filter(|a| n >> a & 1 == 0) {
                let (other, e) = (corners[n | 1 << axis], before(corners[n | 1 << axis]));
                if (d < 0.0) != (e < 0.0) {
                    add(corners[n].lerp(other, d / (d - e)));
                }
            }
        }
        if extent[0][0] > extent[0][1] {
            let [low, high] = [0, 7].map(|n| (corners[n] + self.through).to_array());
            return Err(Error::bad_input(format!(
                "the plane does not meet the samples, which reach from {low:?} to {high:?} in the world: move it"
            )));
        }
        Ok(extent)
    }
}

/// Which pixels of a plane lie in a box of samples.
pub(crate) struct Cover {
    plane: Plane,
    region: Box3,
}

impl Cover {
    pub(super) fn has(&self, x: usize, y: usize) -> bool {
        let at = self.plane.at(x, y);
        (0..3).all(|a| {
            f64::from(self.region.min[a]) <= at[a] && at[a] <= f64::from(self.region.max[a] - 1)
        })
    }
}

/// The pixels of a plane that meet the samples of `region`, `scale` of them in the finest step of the lattice; and
/// the length of one.
///
/// # Errors
/// When the plane does not meet the region, or the picture is too large.
fn raster(frame: &Frame, grid: &Grid, region: Box3, scale: f64) -> Result<(Plane, f64)> {
    let [across, along] = frame.extent(grid, region)?;
    let fine = grid.index_to_world.spacing().into_iter();
    let step = fine.fold(f64::INFINITY, f64::min) / scale;
    let count = |ends: [f64; 2]| ((ends[1] - ends[0]) / step + 1e-6).floor() + 1.0;
    let size = paper([count(across), count(along)])?;
    let first = frame.through + frame.right * across[0] + frame.up * along[1];
    let plane = Plane {
        first: first.to_array(),
        right: (frame.right * step).to_array(),
        down: (frame.up * -step).to_array(),
        size,
    };
    let plane = plane.from_world(grid)?;
    // Along the lattice a plane is to pass through the samples, not beside them by the rounding of its turning.
    let whole = |v: f64, to: f64| {
        let near = (v * to).round() / to;
        if (v - near).abs() < ROUNDING { near } else { v }
    };
    let plane = Plane {
        first: plane.first.map(|v| whole(v, 1.0)),
        right: plane.right.map(|v| whole(v, scale)),
        down: plane.down.map(|v| whole(v, scale)),
        size,
    };
    Ok((plane, step))
}

/// Reads the plane of a frame.
///
/// # Errors
/// When it does not meet `region` or does not fit the budget, and what the field reports.
///
/// # Memory
/// 8 bytes a pixel.
pub(crate) fn sheet(
    field: &dyn Field,
    frame: &Frame,
    region: Box3,
    scale: f64,
    method: Method,
    budget: &Budget,
) -> Result<Sheet> {
    let (plane, unit) = raster(frame, field.grid(), region, scale)?;
    let size = plane.size.map(|n| n as usize);
    let permit = budget.take(
        size[0] as u64 * size[1] as u64 * 8,
        "the slice (a smaller --scale or --roi takes less)",
    )?;
    let mut values = vec![f32::NAN; size[0] * size[1]];
    sample_plane(field, &plane, method, f32::NAN, &mut values, budget)?;
    let cover = Cover { plane, region };
    // Of what lies in the volume but not in the region, nothing counts.
    for (n, value) in values.iter_mut().enumerate() {
        if !cover.has(n % size[0], n / size[0]) {
            *value = f32::NAN;
        }
    }
    Ok(Sheet {
        values,
        size,
        pixels: plane.size,
        up: false,
        unit,
        cover: Some(cover),
        _permit: permit,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use brickmarch::{Affine, field::Dense};

    fn volume() -> Dense {
        let domain = Box3::new([-2, 3, 0], [9, 12, 7]);
        let values = (0..domain.count()).map(|n| (n * n % 1009) as f32).collect();
        let grid = Grid {
            index_to_world: Affine::from_spacing([0.3; 3], [10.0, -4.0, 2.0]),
            ..Grid::new(domain)
        };
        Dense::new(grid, values).expect("counts")
    }

    #[test]
    fn planes_across_an_axis_show_the_samples_of_the_slice() {
        let field = volume();
        let domain = field.grid().domain;
        let budget = Budget::mib(8);
        for (normal, axis, index) in [(DVec3::NEG_X, 0, 4), (DVec3::Y, 1, 5), (DVec3::Z, 2, 6)] {
            let mut at = [0.0; 3];
            at[axis] = f64::from(index);
            let through = DVec3::from(field.grid().index_to_world.apply(at));
            let frame = Frame::across(normal, None, through).expect("a plane");
            let found = sheet(&field, &frame, domain, 1.0, Method::Trilinear, &budget);
            let found = found.expect("a sheet");
            let plane = crate::section::axis::plane(domain, axis, index).expect("inside");
            let same = crate::section::axis::sheet(&field, plane, axis, 1.0, &budget);
            let same = same.expect("a sheet");
            assert_eq!((found.size, found.pixels), (same.size, same.pixels));
            assert!((found.unit - same.unit).abs() < 1e-12);
            let map = crate::args::MapName::Viridis;
            let [a, b] = [&found, &same].map(|s| s.paint(map, (0.0, 1009.0), &budget));
            let (a, b) = (a.expect("painted"), b.expect("painted"));
            assert!(a.bytes == b.bytes, "axis {axis}");
        }
    }

    #[test]
    fn three_points_and_a_normal_name_the_same_plane() {
        let (p, right, up) = (DVec3::new(1.0, 2.0, 3.0), DVec3::X, DVec3::Z);
        let by_points = Frame::through([p, p + 5.0 * right, p + 2.0 * right + 3.0 * up]);
        let by_normal = Frame::across(DVec3::Y * 7.0, None, p);
        let (a, b) = (by_points.expect("a plane"), by_normal.expect("a plane"));
        assert!((a.right - b.right).length() < 1e-15 && (a.up - b.up).length() < 1e-15);
        assert!(Frame::through([p, p + right, p + 2.0 * right]).is_err());
        assert!(Frame::across(DVec3::ZERO, None, p).is_err());
        assert!(Frame::across(DVec3::Y, Some(DVec3::Y), p).is_err());
    }

    #[test]
    fn beyond_the_samples_is_paper_and_values_are_the_interpolant() {
        let field = volume();
        let domain = field.grid().domain;
        let budget = Budget::mib(8);
        let middle = DVec3::from(field.grid().index_to_world.apply([3.0, 7.0, 3.0]));
        let frame = Frame::across(DVec3::new(1.0, 2.0, 0.7), None, middle).expect("a plane");
        let found = sheet(&field, &frame, domain, 3.0, Method::Trilinear, &budget);
        let found = found.expect("a sheet");
        let cover = found.cover.as_ref().expect("has one");
        let mut cursor = brickmarch::query::Cursor::new(&field, &budget).expect("memory");
        let (mut there, mut not) = (0, 0);
        for (n, &value) in found.values.iter().enumerate() {
            let (x, y) = (n % found.size[0], n / found.size[0]);
            let world = frame.through
                + (DVec3::from(field.grid().index_to_world.apply(cover.plane.at(x, y)))
                    - frame.through);
            assert!(DVec3::new(1.0, 2.0, 0.7).dot(world - middle).abs() < 1e-9);
            let oracle = cursor
                .value(cover.plane.at(x, y), Method::Trilinear)
                .expect("read");
            assert_eq!(oracle.is_some(), cover.has(x, y));
            match oracle {
                Some(v) => assert_eq!(v.to_bits(), value.to_bits()),
                None => assert!(value.is_nan()),
            }
            if oracle.is_some() {
                there += 1
            } else {
                not += 1
            }
        }
        assert!(there > 300 && not > 50, "{there} {not}");
        let far = Frame::across(DVec3::X, None, DVec3::ZERO).expect("a plane");
        assert!(sheet(&field, &far, domain, 1.0, Method::Nearest, &budget).is_err());
    }
}
