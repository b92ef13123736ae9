//! Area, volume and bounds of a mesh.
//!
//! Sums run in f64 over blocks of fixed size whose results are added in pairs, so they are the same
//! on every machine and do not lose digits on large meshes.

use super::Mesh;

/// Triangles whose values are added one after the other.
pub(super) const BLOCK: usize = 1 << 12;

/// Area of all triangles, in square world units. NaN when a corner is not finite.
///
/// # Panics
/// When a triangle names a vertex that the mesh does not have.
pub fn area(mesh: &Mesh) -> f64 {
    sums(mesh).area
}

/// Signed volume inside the mesh, in cubic world units; positive when triangles wind
/// counter-clockwise seen from outside. NaN when a corner is not finite.
///
/// Of an open mesh it is the volume of the cone over the surface from the origin.
///
/// # Panics
/// When a triangle names a vertex that the mesh does not have.
pub fn volume(mesh: &Mesh) -> f64 {
    sums(mesh).volume
}

/// Lowest and highest coordinates of the vertices that are finite, or nothing without one.
pub fn bounds(mesh: &Mesh) -> Option<[[f32; 3]; 2]> {
    let mut finite = mesh.positions.iter().filter(|p| is_finite(p));
    let &first = finite.next()?;
    Some(finite.fold([first; 2], |[mut low, mut high], point| {
        for axis in 0..3 {
            low[axis] = low[axis].min(point[axis]);
            high[axis] = high[axis].max(point[axis]);
        }
        [low, high]
    }))
}

/// What one pass over the triangles gives.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    pub(super) area: f64,
    pub(super) volume: f64,
    /// Triangles that name a vertex twice or whose area is exactly zero.
    pub(super) degenerate: u64,
}

pub(super) fn is_finite(point: &[f32; 3]) -> bool {
    point.iter().all(|x| x.is_finite())
}

pub(super) fn sums(mesh: &Mesh) -> Sums {
    let blocks: Vec<Sums> = mesh
        .triangles
        .chunks(BLOCK)
        .map(|block| block_sums(mesh, block))
        .collect();
    total(&blocks)
}

/// The sums of the whole from those of its blocks.
pub(super) fn total(blocks: &[Sums]) -> Sums {
    let mut total = pairwise(blocks);
    total.volume /= 6.0;
    total.area /= 2.0;
    total
}

fn pairwise(parts: &[Sums]) -> Sums {
    match parts {
        [] => Sums::default(),
        [one] => *one,
        _ => {
            let (left, right) = parts.split_at(parts.len().div_ceil(2));
            let (left, right) = (pairwise(left), pairwise(right));
            Sums {
                area: left.area + right.area,
                volume: left.volume + right.volume,
                degenerate: left.degenerate + right.degenerate,
            }
        }
    }
}

fn block_sums(mesh: &Mesh, block: &[[u32; 3]]) -> Sums {
    let mut sums = Sums::default();
    for corners in block {
        sums.add(corners, corners.map(|v| mesh.positions[v as usize]));
    }
    sums
}

impl Sums {
    /// Adds twice the area and six times the volume of a triangle.
    pub(super) fn add(&mut self, corners: &[u32; 3], points: [[f32; 3]; 3]) {
        let [a, b, c] = points.map(|p| p.map(f64::from));
        let u = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
        let v = [c[0] - a[0], c[1] - a[1], c[2] - a[2]];
        let cross = [
            u[1] * v[2] - u[2] * v[1],
            u[2] * v[0] - u[0] * v[2],
            u[0] * v[1] - u[1] * v[0],
        ];
        let dot = |p: [f64; 3], q: [f64; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
        self.area += dot(cross, cross).sqrt();
        self.volume += dot(a, cross);
        let [i, j, k] = *corners;
        if i == j || j == k || k == i || cross == [0.0; 3] {
            self.degenerate += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_meshes::{cube, torus};
    use std::f64::consts::PI;

    #[test]
    fn a_cube_has_its_area_and_volume() {
        let mesh = cube([10.0, -4.0, 2.0], 3.0);
        assert_eq!(area(&mesh), 54.0);
        assert!((volume(&mesh) - 27.0).abs() < 1e-12);
        assert_eq!(bounds(&mesh), Some([[10.0, -4.0, 2.0], [13.0, -1.0, 5.0]]));
    }

    #[test]
    fn a_torus_comes_near_the_formula() {
        let mesh = torus(2.0, 0.5, 400, 200);
        let (exact_area, exact_volume) = (4.0 * PI * PI * 2.0 * 0.5, 2.0 * PI * PI * 2.0 * 0.25);
        assert!((area(&mesh) / exact_area - 1.0).abs() < 3e-4);
        assert!((volume(&mesh) / exact_volume - 1.0).abs() < 3e-4);
    }

    #[test]
    fn turning_the_triangles_turns_the_sign() {
        let mut mesh = cube([0.0; 3], 2.0);
        for t in &mut mesh.triangles {
            t.swap(1, 2);
        }
        assert_eq!(volume(&mesh), -8.0);
        assert_eq!(area(&mesh), 24.0);
    }

    #[test]
    fn nothing_and_not_finite() {
        let mut mesh = Mesh::default();
        assert_eq!(
            (area(&mesh), volume(&mesh), bounds(&mesh)),
            (0.0, 0.0, None)
        );
        mesh.positions = vec![[f32::NAN, 0.0, 0.0], [1.0, f32::INFINITY, 0.0]];
        assert_eq!(bounds(&mesh), None);
        mesh.positions.push([1.0, 2.0, 3.0]);
        assert_eq!(bounds(&mesh), Some([[1.0, 2.0, 3.0]; 2]));
        mesh.triangles.push([0, 1, 2]);
        assert!(area(&mesh).is_nan());
    }
}
