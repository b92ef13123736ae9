//! Pictures of a field without a mesh: a ray for each sample of the picture.

use super::camera::Camera;
use super::raster::Raster;
use brickmarch::query::{Cursor, Method, Ray, Rays};
use brickmarch::{Affine, Box3, Budget, Field, Inside, Range, Result};
use glam::DVec3;
use std::ops::ControlFlow;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Edge of the squares of a picture that one thread draws at a time: neighbours share bricks.
const SQUARE: usize = 32;
/// Steps of a ray that are read together.
const TOGETHER: usize = 32;
/// Opacity beyond which nothing behind is seen.
const OPAQUE: f32 = 0.995;

/// The surface to be seen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface {
    pub iso: f32,
    pub inside: Inside,
}

impl Camera {
    /// The ray through a place of the picture, in index space: `t` from 0 (near) to 1 (far).
    pub(super) fn ray(&self, x: f64, y: f64, back: &Affine) -> Ray {
        let [near, far] = [0.0, 1.0].map(|d| self.to_world(self.unproject(x, y, d)).to_array());
        let (origin, end) = (back.apply(near), back.apply(far));
        Ray {
            origin,
            direction: std::array::from_fn(|a| end[a] - origin[a]),
        }
    }
}

impl Raster {
    /// Draws the surface as its rays find it: the first place of each that is inside. Where a ray enters
    /// the samples inside, the cut is seen.
    ///
    /// # Errors
    /// What the field reports, `Cancelled`.
    pub(crate) fn cast(&self, rays: &Rays<'_>, surface: Surface, budget: &Budget) -> Result<()> {
        let map = rays.field().grid().index_to_world;
        let back = map.inverse()?;
        let slopes = map.gradient_rows();
        let domain = rays.field().grid().domain;
        squares(rays.field(), self.size, budget, |cursor, x, y| {
            let ray = self.camera.ray(x as f64 + 0.5, y as f64 + 0.5, &back);
            let Some((t, cut)) = first_inside(rays, cursor, &ray, surface)? else {
                return Ok(());
            };
            let place = ray.at(t);
            let normal = match cut {
                Some(axis) => DVec3::from_array(std::array::from_fn(|r| slopes[r][axis])),
                None => {
                    let g = cursor.gradient(hold(domain, place), Method::Tricubic)?;
                    let g = g.unwrap_or_default().map(f64::from);
                    DVec3::from_array(slopes.map(|r| r[0] * g[0] + r[1] * g[1] + r[2] * g[2]))
                }
            };
            let world = DVec3::from_array(map.apply(place));
            let toward = DVec3::from_array(map.apply(ray.origin)) - world;
            let normal = normal.normalize_or(toward.normalize_or(DVec3::Z));
            let normal = if normal.dot(toward) < 0.0 {
                -normal
            } else {
                normal
            };
            self.put(x, y, world, normal);
            Ok(())
        })?;
        let edge = self.light_edge();
        squares(rays.field(), [edge; 2], budget, |cursor, x, y| {
            let ray = self.light.ray(x as f64 + 0.5, y as f64 + 0.5, &back);
            if let Some((t, _)) = first_inside(rays, cursor, &ray, surface)? {
                self.put_light(x, y, DVec3::from_array(map.apply(ray.at(t))));
            }
            Ok(())
        })?;
        Ok(())
    }
}

/// A point that is outside of the samples by rounding only, moved in.
fn hold(domain: Box3, p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|a| p[a].clamp(f64::from(domain.min[a]), f64::from(domain.max[a]) - 1.0))
}

/// The parameter at which a ray is first inside, and the axis of the border where it is so on entering.
fn first_inside(
    rays: &Rays<'_>,
    cursor: &mut Cursor<'_>,
    ray: &Ray,
    surface: Surface,
) -> Result<Option<(f64, Option<usize>)>> {
    let Some([start, _]) = rays.span(ray, 0.0) else {
        return Ok(None);
    };
    let place = hold(rays.field().grid().domain, ray.at(start));
    if cursor.is_inside(place, surface.iso, surface.inside)? {
        // The axis whose border it has just passed.
        let part = rays.region();
        let gap = |a: usize| {
            let low = (place[a] - f64::from(part.min[a])).abs();
            low.min((place[a] - f64::from(part.max[a]) + 1.0).abs())
        };
        let axis = (0..3).min_by(|&a, &b| gap(a).total_cmp(&gap(b)));
        return Ok(Some((start, axis)));
    }
    let found = rays.first_crossing(cursor, ray, surface.iso, start)?;
    Ok(found.map(|crossing| (crossing.t, None)))
}

/// How a density becomes light.
pub(crate) struct Fog<'a> {
    /// Values that are clear, and of full strength.
    pub window: (f64, f64),
    /// Part of the light that one step of the lattice at full strength takes away.
    pub opacity: f64,
    /// Linear colour of a strength from 0 to 1.
    pub colour: &'a (dyn Fn(f32) -> [f32; 3] + Sync),
}

/// Linear colour, and opacity, of each sample of a picture: densities laid one behind the other, from
/// the front (Levoy 1988), in steps of half a cell. Blocks that are clear are passed at once.
///
/// # Errors
/// What the field reports, `Cancelled`.
///
/// # Memory
/// 16 bytes for each sample of the picture.
pub(crate) fn fog(
    rays: &Rays<'_>,
    raster: &Raster,
    fog: &Fog<'_>,
    budget: &Budget,
) -> Result<Vec<[f32; 4]>> {
    let back = rays.field().grid().index_to_world.inverse()?;
    let span = fog.window.1 - fog.window.0;
    let domain = rays.field().grid().domain;
    squares(rays.field(), raster.size, budget, |cursor, x, y| {
        let ray = raster.camera.ray(x as f64 + 0.5, y as f64 + 0.5, &back);
        let length = ray.direction.iter().map(|d| d * d).sum::<f64>().sqrt();
        let step = 0.5 / length;
        let [mut r, mut g, mut b, mut alpha] = [0f32; 4];
        let walked = rays.blocks(&ray, 0.0, |range: &Range, start, end| {
            if range.max.is_nan() || f64::from(range.max) <= fog.window.0 {
                return ControlFlow::Continue(());
            }
            // Steps are counted from the start of the ray, so that blocks leave no seams.
            let first = (start / step).ceil();
            let count = ((end / step).ceil() - first).max(0.0) as usize;
            let mut values = [0.0; TOGETHER];
            for done in (0..count).step_by(TOGETHER) {
                let values = &mut values[..(count - done).min(TOGETHER)];
                let place = |n: usize| hold(domain, ray.at((first + (done + n) as f64) * step));
                if let Err(e) = cursor.trilinear(place, f32::NAN, values) {
                    return ControlFlow::Break(Err(e));
                }
                for &mut value in values {
                    let strength = ((f64::from(value) - fog.window.0) / span).clamp(0.0, 1.0);
                    if strength > 0.0 {
                        let taken = (1.0 - (1.0 - fog.opacity * strength).sqrt()) as f32;
                        let here = taken * (1.0 - alpha);
                        let c = (fog.colour)(strength as f32);
                        (r, g, b) = (r + here * c[0], g + here * c[1], b + here * c[2]);
                        alpha += here;
                        if alpha > OPAQUE {
                            return ControlFlow::Break(Ok(()));
                        }
                    }
                }
            }
            ControlFlow::Continue(())
        });
        if let ControlFlow::Break(ended) = walked {
            ended?;
        }
        Ok([r, g, b, alpha])
    })
}

/// The largest value along the ray of each sample of a picture; NaN where it meets none.
///
/// # Errors
/// What the field reports, `Cancelled`.
///
/// # Memory
/// 4 bytes for each sample of the picture.
pub(crate) fn highest(rays: &Rays<'_>, raster: &Raster, budget: &Budget) -> Result<Vec<f32>> {
    let back = rays.field().grid().index_to_world.inverse()?;
    squares(rays.field(), raster.size, budget, |cursor, x, y| {
        let ray = raster.camera.ray(x as f64 + 0.5, y as f64 + 0.5, &back);
        let peak = rays.maximum(cursor, &ray)?;
        Ok(peak.map_or(f32::NAN, |peak| peak.value as f32))
    })
}

/// What `draw` gives for every sample of a picture, row after row; found square by square on the threads
/// of the budget.
fn squares<T: Copy + Default + Send>(
    field: &dyn Field,
    size: [usize; 2],
    budget: &Budget,
    draw: impl Fn(&mut Cursor<'_>, usize, usize) -> Result<T> + Sync,
) -> Result<Vec<T>> {
    let across = size[0].div_ceil(SQUARE);
    let count = across * size[1].div_ceil(SQUARE);
    let next = AtomicUsize::new(0);
    let failed = Mutex::new(None);
    let all = Mutex::new(vec![T::default(); size[0] * size[1]]);
    budget.progress().start(count as u64);
    let work = |cursor: &mut Cursor<'_>| -> Result<()> {
        let mut square = Vec::with_capacity(SQUARE * SQUARE);
        loop {
            let n = next.fetch_add(1, Ordering::Relaxed);
            if n >= count {
                return Ok(());
            }
            budget.check_cancelled()?;
            let (left, top) = (n % across * SQUARE, n / across * SQUARE);
            let (right, bottom) = ((left + SQUARE).min(size[0]), (top + SQUARE).min(size[1]));
            square.clear();
            for y in top..bottom {
                for x in left..right {
                    square.push(draw(cursor, x, y)?);
                }
            }
            let mut all = all.lock().expect("no holder panics");
            for (row, y) in square.chunks(right - left).zip(top..) {
                all[y * size[0] + left..][..row.len()].copy_from_slice(row);
            }
            drop(all);
            budget.progress().add(1);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..budget.threads() {
            let (work, failed, next) = (&work, &failed, &next);
            scope.spawn(move || {
                if let Err(e) = Cursor::new(field, budget).and_then(|mut c| work(&mut c)) {
                    next.store(count, Ordering::Relaxed);
                    failed.lock().expect("no holder panics").get_or_insert(e);
                }
            });
        }
    });
    match failed.into_inner().expect("no holder panics") {
        Some(e) => Err(e),
        None => Ok(all.into_inner().expect("no holder panics")),
    }
}
