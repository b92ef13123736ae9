//! The z-buffer that is a mesh sink.
//!
//! A pixel is one 64-bit word: depth above, normal below. Writing is `min`, so pieces may come from
//! any thread in any order and the picture is the same; equal depths are decided by the normal.

use super::camera::{Camera, WorldBox};
use super::shade::{KEY_LIGHT, Look};
use brickmarch::mesh::{Layout, Piece, Totals};
use brickmarch::{Budget, MeshSink, Permit, Result};
use glam::{DVec3, Vec3};
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

/// Samples per pixel and axis.
pub(super) const SUPER: usize = 2;
/// Subdivisions of a pixel for vertex positions; edges are then exact in integers.
const FIXED: f64 = 256.0;
/// Width and height of the depth picture that the key light sees.
const LIGHT_EDGE: usize = 1024;
/// A pixel that shows nothing.
pub(super) const EMPTY: u64 = u64::MAX;

/// Draws what it is given; see [`shade`](super::shade) for what becomes of it.
///
/// # Memory
/// 32 bytes a pixel of the picture and 4 MiB for the shadow, under permit.
pub(crate) struct Raster {
    pub(super) look: Look,
    pub(super) camera: Camera,
    pub(super) size: [usize; 2],
    pub(super) pixels: Vec<AtomicU64>,
    pub(super) light: Camera,
    pub(super) light_depth: Vec<AtomicU32>,
    _permit: Permit,
}

impl Raster {
    /// Memory that drawing and shading take at most.
    #[cfg(feature = "serve")]
    pub(crate) fn memory_bytes(look: &Look) -> u64 {
        let pixels = u64::from(look.width) * u64::from(look.height);
        let fine = pixels * (SUPER * SUPER) as u64;
        fine * 9 + pixels * 3 + (LIGHT_EDGE * LIGHT_EDGE * 4) as u64
    }

    /// A picture of what lies in `bounds`.
    ///
    /// # Errors
    /// `BudgetExceeded` when the picture does not fit.
    pub(crate) fn new(look: &Look, bounds: &WorldBox, budget: &Budget) -> Result<Raster> {
        let size = [look.width as usize * SUPER, look.height as usize * SUPER];
        let count = size[0] * size[1];
        let light_count = LIGHT_EDGE * LIGHT_EDGE;
        let permit = budget.take((count * 8 + light_count * 4) as u64, "the picture")?;
        let [w, h] = size.map(|v| v as f64);
        let camera = Camera::fit(
            bounds,
            look.view.toward_eye(),
            !look.parallel,
            w,
            h,
            look.margin,
        );
        let edge = LIGHT_EDGE as f64;
        let toward_light = camera.turn_back(KEY_LIGHT.normalize());
        let light = Camera::fit(bounds, toward_light, false, edge, edge, 0.01);
        Ok(Raster {
            look: look.clone(),
            camera,
            size,
            pixels: (0..count).map(|_| AtomicU64::new(EMPTY)).collect(),
            light,
            light_depth: (0..light_count).map(|_| AtomicU32::new(u32::MAX)).collect(),
            _permit: permit,
        })
    }

    /// The position of sample `x`, `y` in camera space and its normal, where something is seen.
    #[inline]
    pub(super) fn sample(&self, x: usize, y: usize) -> Option<(DVec3, Vec3)> {
        let word = self.pixels[x + y * self.size[0]].load(Ordering::Relaxed);
        (word != EMPTY).then(|| {
            let depth = f64::from((word >> 32) as u32) / f64::from(u32::MAX);
            let position = self.camera.unproject(x as f64 + 0.5, y as f64 + 0.5, depth);
            (position, unpack_normal(word as u32))
        })
    }

    /// The position of sample `x`, `y` in camera space, where something is seen.
    #[inline]
    pub(super) fn position(&self, x: usize, y: usize) -> Option<DVec3> {
        let word = self.pixels[x + y * self.size[0]].load(Ordering::Relaxed);
        (word != EMPTY).then(|| {
            let depth = f64::from((word >> 32) as u32) * (1.0 / f64::from(u32::MAX));
            self.camera.unproject(x as f64 + 0.5, y as f64 + 0.5, depth)
        })
    }

    /// Shows a world point with its normal, on the eye's side, where sample `x`, `y` shows nothing nearer.
    pub(super) fn put(&self, x: usize, y: usize, world: DVec3, normal: DVec3) {
        let depth = fixed_depth(self.camera.project(world)[2]);
        let normal = self.camera.turn(normal).as_vec3();
        let word = u64::from(depth) << 32 | u64::from(pack_normal(normal));
        self.pixels[x + y * self.size[0]].fetch_min(word, Ordering::Relaxed);
    }

    /// Width and height of the picture that the light sees.
    pub(super) fn light_edge(&self) -> usize {
        LIGHT_EDGE
    }

    /// A world point that the light sees at `x`, `y` of its picture.
    pub(super) fn put_light(&self, x: usize, y: usize, world: DVec3) {
        let depth = fixed_depth(self.light.project(world)[2]);
        self.light_depth[x + y * LIGHT_EDGE].fetch_min(depth, Ordering::Relaxed);
    }

    fn draw(&self, piece: &Piece) {
        let spots = |camera: &Camera| -> Vec<Spot> {
            let spot = |p: &[f32; 3]| Spot::new(camera.project(Vec3::from(*p).as_dvec3()));
            piece.positions.iter().map(spot).collect()
        };
        let seen = spots(&self.camera);
        let nearer = |at: usize, depth: u32| {
            self.pixels[at].load(Ordering::Relaxed) >> 32 < u64::from(depth)
        };
        if !is_hidden(&seen, self.size, nearer) {
            for corners in &piece.triangles {
                let [a, b, c] = corners.map(|v| v as usize);
                cover(
                    [seen[a], seen[b], seen[c]],
                    self.size,
                    |at, depth, weights, front| {
                        let cell = &self.pixels[at];
                        if u64::from(depth) > cell.load(Ordering::Relaxed) >> 32 {
                            return;
                        }
                        let normal = self.normal(piece, [a, b, c], weights, front);
                        let word = u64::from(depth) << 32 | u64::from(pack_normal(normal));
                        cell.fetch_min(word, Ordering::Relaxed);
                    },
                );
            }
        }
        let lit = spots(&self.light);
        let size = [LIGHT_EDGE; 2];
        let nearer = |at: usize, depth: u32| self.light_depth[at].load(Ordering::Relaxed) < depth;
        if !is_hidden(&lit, size, nearer) {
            for corners in &piece.triangles {
                let [a, b, c] = corners.map(|v| lit[v as usize]);
                cover([a, b, c], size, |at, depth, _, _| {
                    let cell = &self.light_depth[at];
                    if depth < cell.load(Ordering::Relaxed) {
                        cell.fetch_min(depth, Ordering::Relaxed);
                    }
                });
            }
        }
    }

    /// Normal in camera space, turned to the eye's side of the triangle.
    fn normal(&self, piece: &Piece, corners: [usize; 3], weights: [f32; 3], front: bool) -> Vec3 {
        let [a, b, c] = corners.map(|v| Vec3::from(piece.positions[v]));
        let face = (b - a).cross(c - a).normalize_or(Vec3::Z);
        let mut world = face;
        if !piece.normals.is_empty() {
            world = Vec3::ZERO;
            for (corner, weight) in corners.into_iter().zip(weights) {
                let smooth = Vec3::from(piece.normals[corner]);
                // At the rim of a cap the gradient says nothing about the cap.
                let fits = smooth.dot(face) > 0.35;
                world += weight * if fits { smooth } else { face };
            }
            world = world.normalize_or(face);
        }
        let normal = self.camera.turn(world.as_dvec3()).as_vec3();
        if front { normal } else { -normal }
    }
}

impl MeshSink for Raster {
    fn begin(&mut self, _layout: Layout) -> Result<()> {
        Ok(())
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        self.draw(piece);
        Ok(())
    }

    fn finish(&mut self, _totals: Totals) -> Result<()> {
        Ok(())
    }
}

/// A projected vertex: fixed-point pixels and depth.
#[derive(Clone, Copy)]
struct Spot {
    x: i64,
    y: i64,
    depth: f64,
}

impl Spot {
    fn new([x, y, depth]: [f64; 3]) -> Spot {
        // Far outside of any picture, but no overflow in products of two differences.
        let fixed = |v: f64| (v * FIXED).clamp(-1e8, 1e8) as i64;
        Spot {
            x: fixed(x),
            y: fixed(y),
            depth,
        }
    }
}

/// First and last sample whose centre lies between two fixed-point positions.
#[inline]
fn centres(low: i64, high: i64, limit: usize) -> (i64, i64) {
    let (half, step) = ((FIXED / 2.0) as i64, FIXED as i64);
    let (low, high) = (low.max(0), high.min(limit as i64 * step - 1));
    (
        (low + half - 1).div_euclid(step),
        (high - half).div_euclid(step),
    )
}

/// Whether every sample that the spots can touch shows something nearer than all of them. Most
/// pieces of a large mesh are behind others, and need not be drawn at all.
fn is_hidden(spots: &[Spot], size: [usize; 2], nearer: impl Fn(usize, u32) -> bool) -> bool {
    let (mut low, mut high, mut depth) = ([i64::MAX; 2], [i64::MIN; 2], f64::INFINITY);
    for spot in spots {
        for (axis, v) in [spot.x, spot.y].into_iter().enumerate() {
            low[axis] = low[axis].min(v);
            high[axis] = high[axis].max(v);
        }
        depth = depth.min(spot.depth);
    }
    let (x0, x1) = centres(low[0], high[0], size[0]);
    let (y0, y1) = centres(low[1], high[1], size[1]);
    // Interpolation may round below the nearest corner, by far less than this.
    let depth = fixed_depth(depth - 1e-9);
    (y0..=y1).all(|y| (x0..=x1).all(|x| nearer(x as usize + y as usize * size[0], depth)))
}

#[inline]
fn fixed_depth(depth: f64) -> u32 {
    (depth.clamp(0.0, 1.0) * f64::from(u32::MAX)) as u32
}

/// Calls `pixel(offset, depth, weights, front)` for each sample whose centre the triangle covers,
/// its edges included, so that neighbours leave no gap.
#[inline]
fn cover(
    mut spots: [Spot; 3],
    size: [usize; 2],
    mut pixel: impl FnMut(usize, u32, [f32; 3], bool),
) {
    let (half, step) = ((FIXED / 2.0) as i64, FIXED as i64);
    let range = |a: i64, b: i64, c: i64, limit| centres(a.min(b).min(c), a.max(b).max(c), limit);
    let [a, b, c] = spots;
    let (x0, x1) = range(a.x, b.x, c.x, size[0]);
    let (y0, y1) = range(a.y, b.y, c.y, size[1]);
    if x1 < x0 || y1 < y0 {
        return;
    }
    let edge = |p: Spot, q: Spot, x: i64, y: i64| (q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x);
    let area = edge(spots[0], spots[1], spots[2].x, spots[2].y);
    if area == 0 {
        return;
    }
    // y points down: counter-clockwise in the world is negative here.
    let front = area < 0;
    if front {
        spots.swap(1, 2);
    }
    let [a, b, c] = spots;
    let inverse = 1.0 / area.abs() as f64;
    for y in y0..=y1 {
        for x in x0..=x1 {
            let (px, py) = (x * step + half, y * step + half);
            let w = [edge(b, c, px, py), edge(c, a, px, py), edge(a, b, px, py)];
            if w.iter().any(|&v| v < 0) {
                continue;
            }
            let w = w.map(|v| v as f64 * inverse);
            let depth = w[0] * a.depth + w[1] * b.depth + w[2] * c.depth;
            let depth = fixed_depth(depth);
            let mut weights = w.map(|v| v as f32);
            if front {
                weights.swap(1, 2);
            }
            pixel(x as usize + y as usize * size[0], depth, weights, front);
        }
    }
}

/// A unit vector in 32 bits: the octahedron unfolded to a square.
fn pack_normal(n: Vec3) -> u32 {
    let n = n / (n.x.abs() + n.y.abs() + n.z.abs());
    let (mut u, mut v) = (n.x, n.y);
    if n.z < 0.0 {
        (u, v) = (
            (1.0 - n.y.abs()) * n.x.signum(),
            (1.0 - n.x.abs()) * n.y.signum(),
        );
    }
    let bits = |t: f32| ((t * 0.5 + 0.5) * 65535.0 + 0.5) as u32;
    bits(u) << 16 | bits(v)
}

fn unpack_normal(word: u32) -> Vec3 {
    let part = |bits: u32| bits as f32 / 65535.0 * 2.0 - 1.0;
    let (u, v) = (part(word >> 16), part(word & 0xffff));
    let mut n = Vec3::new(u, v, 1.0 - u.abs() - v.abs());
    if n.z < 0.0 {
        n = Vec3::new(
            (1.0 - v.abs()) * u.signum(),
            (1.0 - u.abs()) * v.signum(),
            n.z,
        );
    }
    n.normalize_or(Vec3::Z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_round_trip() {
        for i in 0..1000 {
            let t = i as f32 * 0.7;
            let n = Vec3::new(t.sin(), (t * 1.3).cos(), (t * 0.37).sin()).normalize_or(Vec3::X);
            assert!((unpack_normal(pack_normal(n)) - n).length() < 1e-3, "{n}");
        }
    }

    #[test]
    fn two_triangles_cover_a_square_without_gap() {
        let spot = |x: f64, y: f64| Spot::new([x, y, 0.5]);
        let corners = [
            spot(2.3, 1.1),
            spot(17.9, 3.2),
            spot(15.2, 18.8),
            spot(1.7, 14.4),
        ];
        let mut hits = vec![0; 400];
        for t in [[0, 1, 2], [0, 2, 3]] {
            cover(t.map(|i: usize| corners[i]), [20, 20], |at, _, w, front| {
                assert!((w.iter().sum::<f32>() - 1.0).abs() < 1e-6);
                assert!(!front, "clockwise in the world");
                hits[at] += 1;
            });
        }
        let inside = |x: f64, y: f64| {
            (0..4).all(|i| {
                let (p, q) = (corners[i], corners[(i + 1) % 4]);
                let (x, y) = (x * FIXED, y * FIXED);
                (q.x - p.x) as f64 * (y - p.y as f64) >= (q.y - p.y) as f64 * (x - p.x as f64)
            })
        };
        for (at, &hit) in hits.iter().enumerate() {
            let (x, y) = ((at % 20) as f64 + 0.5, (at / 20) as f64 + 0.5);
            assert_eq!(hit > 0, inside(x, y), "{x} {y}");
        }
    }
}
