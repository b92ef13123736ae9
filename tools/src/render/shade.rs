//! From depths and normals to a picture: key light with shadow, fill, rim, sky, and the darkening of
//! hollows, all in camera space, so that every object is lit as in a studio.

use super::camera::View;
use super::raster::{Raster, SUPER};
use crate::picture::Picture;
use brickmarch::{Budget, Result};
use glam::{DVec3, Vec3};
use std::sync::atomic::Ordering;

/// Towards the key light in camera space (right, up, toward the eye).
pub(super) const KEY_LIGHT: DVec3 = DVec3::new(-0.75, 0.70, 0.50);
const FILL_LIGHT: Vec3 = Vec3::new(0.85, 0.15, 0.5);
const RIM_LIGHT: Vec3 = Vec3::new(0.35, 0.55, -0.75);
/// Samples of the neighbourhood that decide how hollow a place is.
const HOLLOW_SAMPLES: usize = 24;
/// Samples of the light's depth picture that decide how shadowed a place is.
const SHADOW_SAMPLES: usize = 10;
/// Side of the pattern by which neighbouring samples turn their neighbourhoods.
const PATTERN: usize = 4;

/// How a picture looks.
#[derive(Clone, Debug)]
pub(crate) struct Look {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Direction of the eye.
    pub view: View,
    /// Parallel projection instead of perspective.
    pub parallel: bool,
    /// Free border, as part of the size.
    pub margin: f64,
    /// Colour of the surface, sRGB.
    pub colour: [u8; 3],
    /// Whether hollows are darker.
    pub occlusion: bool,
}

impl Default for Look {
    fn default() -> Self {
        Self {
            width: 1200,
            height: 900,
            view: View::default(),
            parallel: false,
            margin: 0.05,
            colour: [232, 217, 190],
            occlusion: true,
        }
    }
}

/// Colours of world points.
pub(crate) type Paint<'a> = &'a (dyn Fn(&[[f32; 3]]) -> Vec<[u8; 3]> + Sync);

impl Raster {
    /// Shades what was drawn.
    ///
    /// # Errors
    /// `BudgetExceeded` when the picture does not fit; `Cancelled`.
    pub(crate) fn picture(&self, budget: &Budget) -> Result<Picture> {
        self.painted(None, budget)
    }

    /// The same; `paint` gives the colours of world points.
    ///
    /// # Errors
    /// When the memory is not there, or the budget was cancelled.
    pub(crate) fn painted(&self, paint: Option<Paint<'_>>, budget: &Budget) -> Result<Picture> {
        let w = self.look.width as usize;
        let [fine_w, fine_h] = self.size;
        let _permit = budget.take(self.shading_bytes(), "shading the picture")?;
        let scale = self.light_units();
        // A spiral, denser towards the middle, so that fine and coarse hollows both show.
        let around = spirals(HOLLOW_SAMPLES, 5.0, 1.8);
        let soft = spirals(SHADOW_SAMPLES, 4.236, 0.5);
        let mut open = vec![0u8; fine_w * fine_h];
        each_row(&mut open, fine_w, budget, |y, row| {
            for (x, value) in row.iter_mut().enumerate() {
                *value = (self.openness(x, y, scale, &around) * 255.0 + 0.5) as u8;
            }
        })?;
        let mut picture = Picture::rgb(self.look.width, self.look.height);
        each_row(&mut picture.bytes, w * 3, budget, |y, row| {
            let colours = paint.map(|paint| self.paint_row(y, paint));
            for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
                let mut sum = Vec3::ZERO;
                for sub in 0..SUPER * SUPER {
                    let (sx, sy) = (x * SUPER + sub % SUPER, y * SUPER + sub / SUPER);
                    let own = colours
                        .as_ref()
                        .map_or(self.look.colour, |c| c[sx + (sub / SUPER) * fine_w]);
                    sum += self.colour(sx, sy, own, &open, scale, &soft);
                }
                pixel.copy_from_slice(&to_srgb(sum / (SUPER * SUPER) as f32));
            }
        })?;
        Ok(picture)
    }

    /// Memory that shading takes at most.
    pub(crate) fn shading_bytes(&self) -> u64 {
        let pixels = u64::from(self.look.width) * u64::from(self.look.height);
        pixels * (3 + (SUPER * SUPER) as u64)
    }

    /// The background behind `samples(place)`, linear colour times opacity, and opacity.
    ///
    /// # Errors
    /// When the memory is not there, or the budget was cancelled.
    pub(crate) fn behind(
        &self,
        samples: impl Fn(usize) -> [f32; 4] + Sync,
        budget: &Budget,
    ) -> Result<Picture> {
        let (w, h) = (self.look.width as usize, self.look.height as usize);
        let _permit = budget.take((w * h * 3) as u64, "shading the picture")?;
        let mut picture = Picture::rgb(self.look.width, self.look.height);
        each_row(&mut picture.bytes, w * 3, budget, |y, row| {
            for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
                let mut sum = Vec3::ZERO;
                for sub in 0..SUPER * SUPER {
                    let (sx, sy) = (x * SUPER + sub % SUPER, y * SUPER + sub / SUPER);
                    let [r, g, b, alpha] = samples(sx + sy * self.size[0]);
                    sum += Vec3::new(r, g, b) + self.background(sx, sy) * (1.0 - alpha);
                }
                pixel.copy_from_slice(&to_srgb(sum / (SUPER * SUPER) as f32));
            }
        })?;
        Ok(picture)
    }

    /// Colours of the samples of one row of pixels; that of the look where nothing is seen.
    fn paint_row(&self, y: usize, paint: Paint<'_>) -> Vec<[u8; 3]> {
        let mut colours = vec![self.look.colour; self.size[0] * SUPER];
        let mut seen = Vec::new();
        let mut points = Vec::new();
        for at in 0..colours.len() {
            let (sx, sy) = (at % self.size[0], y * SUPER + at / self.size[0]);
            if let Some(position) = self.position(sx, sy) {
                seen.push(at);
                points.push(self.camera.to_world(position).as_vec3().to_array());
            }
        }
        for (at, colour) in seen.into_iter().zip(paint(&points)) {
            colours[at] = colour;
        }
        colours
    }

    /// Size of the scene in world units: what "large" and "small" mean for shadows and hollows.
    fn light_units(&self) -> f64 {
        let middle = self.camera.unproject(0.0, 0.0, 0.5);
        self.size[0].min(self.size[1]) as f64 / self.camera.pixels_per_unit(middle)
    }

    /// From 0 (deep in a hollow) to 1 (open), by looking around in the depth picture.
    fn openness(&self, x: usize, y: usize, scene: f64, around: &[Spiral]) -> f32 {
        let (true, Some((position, normal))) = (self.look.occlusion, self.sample(x, y)) else {
            return 1.0;
        };
        let normal = normal.as_dvec3();
        let reach = 0.11 * scene;
        let reach_px = reach * self.camera.pixels_per_unit(position);
        let [w, h] = self.size.map(|v| v as f64);
        let mut hidden = 0.0;
        for [dx, dy] in &around[pattern(x, y)] {
            // At least the next sample but one: this one is no neighbour.
            let step = |d: f64| d * reach_px + d.signum() * 1.5;
            let (u, v) = (x as f64 + step(*dx), y as f64 + step(*dy));
            if u < 0.0 || v < 0.0 || u >= w || v >= h {
                continue;
            }
            if let Some(other) = self.position(u as usize, v as usize) {
                let offset = other - position;
                let length = offset.length().max(1e-12);
                let near = (1.0 - length / reach).max(0.0);
                hidden += (offset.dot(normal) / length - 0.1).max(0.0) * near.sqrt();
            }
        }
        (1.0 - 3.6 * hidden / HOLLOW_SAMPLES as f64).clamp(0.0, 1.0) as f32
    }

    /// How much of the key light arrives, softened over a few cells of its depth picture.
    fn lit(&self, position: DVec3, normal: DVec3, scene: f64, around: &Spiral) -> f32 {
        let edge = (self.light_depth.len() as f64).sqrt();
        let start = self.camera.to_world(position + normal * (0.004 * scene));
        let [x, y, depth] = self.light.project(start);
        let limit = (depth.clamp(0.0, 1.0) * f64::from(u32::MAX)) as u32;
        let limit = limit.saturating_sub(u32::MAX / 1500);
        let radius = 0.0045 * edge;
        let free = |d: &&[f64; 2]| {
            let (u, v) = (x + radius * d[0], y + radius * d[1]);
            let outside = u < 0.0 || v < 0.0 || u >= edge || v >= edge;
            outside || {
                let at = u as usize + v as usize * edge as usize;
                self.light_depth[at].load(Ordering::Relaxed) >= limit
            }
        };
        around.iter().filter(free).count() as f32 / around.len() as f32
    }

    /// Linear colour of one sample.
    fn colour(
        &self,
        x: usize,
        y: usize,
        own: [u8; 3],
        open: &[u8],
        scene: f64,
        soft: &[Spiral],
    ) -> Vec3 {
        let Some((position, normal)) = self.sample(x, y) else {
            return self.background(x, y);
        };
        let eye = self.camera.to_eye(position).as_vec3();
        let hollow = self.smooth_openness(x, y, open);
        let lit = self.lit(position, normal.as_dvec3(), scene, &soft[pattern(x, y)]);
        let albedo = from_srgb(own);
        let key = KEY_LIGHT.normalize().as_vec3();
        let (fill, rim) = (FILL_LIGHT.normalize(), RIM_LIGHT.normalize());
        let wrapped = ((normal.dot(key) + 0.1) / 1.1).max(0.0);
        // Light that bounces in a hollow takes the colour of the surface.
        let ambient = bounced(albedo, hollow);
        let sky = Vec3::new(0.26, 0.29, 0.34) * (0.5 + 0.5 * normal.y)
            + Vec3::new(0.16, 0.14, 0.12) * (0.5 - 0.5 * normal.y);
        let mut light = sky * ambient;
        light += Vec3::new(1.08, 1.01, 0.91) * (wrapped * lit * (0.3 + 0.7 * hollow));
        light += Vec3::new(0.20, 0.22, 0.26) * (normal.dot(fill).max(0.0) * hollow);
        let mut colour = albedo * light;
        let half = (key + eye).normalize_or(key);
        colour += Vec3::splat(0.10 * normal.dot(half).max(0.0).powi(40) * lit * hollow);
        let grazing = (1.0 - normal.dot(eye).max(0.0)).powi(3);
        let behind = (normal.dot(rim) + 0.35).max(0.0);
        colour += Vec3::new(0.20, 0.23, 0.26) * (grazing * behind * hollow * hollow);
        // Light that passes 1 bends over instead of clipping.
        colour.map(|v| {
            if v > 0.7 {
                0.7 + 0.3 * (1.0 - (-(v - 0.7) / 0.3).exp())
            } else {
                v
            }
        })
    }

    /// The openness averaged over one turn of the pattern, on the same surface only.
    fn smooth_openness(&self, x: usize, y: usize, open: &[u8]) -> f32 {
        let [w, h] = self.size;
        let depth = |x: usize, y: usize| {
            f64::from((self.pixels[x + y * w].load(Ordering::Relaxed) >> 32) as u32)
        };
        let here = depth(x, y);
        let (mut sum, mut count) = (0u32, 0u32);
        for v in y.saturating_sub(1)..(y + PATTERN - 1).min(h) {
            for u in x.saturating_sub(1)..(x + PATTERN - 1).min(w) {
                if (depth(u, v) - here).abs() < 0.02 * f64::from(u32::MAX) {
                    sum += u32::from(open[u + v * w]);
                    count += 1;
                }
            }
        }
        sum as f32 / (255 * count.max(1)) as f32
    }

    /// Neutral, lighter above the middle, with a hint of a vignette.
    fn background(&self, x: usize, y: usize) -> Vec3 {
        let [w, h] = self.size.map(|v| v as f32);
        let (u, v) = (x as f32 / w - 0.5, y as f32 / h - 0.40);
        let fall = (u * u * 0.7 + v * v * 1.4).min(1.0);
        Vec3::new(0.68, 0.70, 0.73) * (1.0 - 0.95 * fall)
    }

    /// Samples that show the surface.
    #[cfg(test)]
    pub(super) fn covered(&self) -> usize {
        let seen = |p: &&std::sync::atomic::AtomicU64| {
            p.load(Ordering::Relaxed) != crate::render::raster::EMPTY
        };
        self.pixels.iter().filter(seen).count()
    }
}

/// Offsets within the unit circle.
type Spiral = Vec<[f64; 2]>;

/// A spiral of `count` offsets for each place of the pattern; distances grow as `t^power`.
fn spirals(count: usize, turns: f64, power: f64) -> Vec<Spiral> {
    let places = PATTERN * PATTERN;
    let spiral = |place: usize| {
        // Neighbours in the pattern are far apart in the order.
        let turn = (place * 7 % places) as f64 / places as f64;
        let offset = |i: usize| {
            let t = (i as f64 + 0.3 + 0.6 * turn) / count as f64;
            let (sin, cos) = (std::f64::consts::TAU * (t * turns + turn)).sin_cos();
            [t.powf(power) * cos, t.powf(power) * sin]
        };
        (0..count).map(offset).collect()
    };
    (0..places).map(spiral).collect()
}

/// The place of a sample in the pattern.
fn pattern(x: usize, y: usize) -> usize {
    x % PATTERN + PATTERN * (y % PATTERN)
}

/// What reaches a hollow after some bounces: darker, and more so where the surface is dark
/// (the fit of Jimenez et al., "Practical real-time strategies for accurate indirect occlusion").
fn bounced(albedo: Vec3, open: f32) -> Vec3 {
    let a = 2.0404 * albedo - 0.3324;
    let b = -4.7951 * albedo + 0.6417;
    let c = 2.7552 * albedo + 0.6903;
    let x = Vec3::splat(open);
    x.max(((x * a + b) * x + c) * x)
}

/// Fills the rows of `out` on the threads of the budget; a row depends on its number only.
fn each_row(
    out: &mut [u8],
    row_bytes: usize,
    budget: &Budget,
    fill: impl Fn(usize, &mut [u8]) + Sync,
) -> Result<()> {
    let rows = std::sync::Mutex::new(out.chunks_exact_mut(row_bytes).enumerate());
    std::thread::scope(|scope| {
        for _ in 0..budget.threads() {
            scope.spawn(|| {
                while !budget.cancel_token().is_cancelled() {
                    let next = rows.lock().expect("no painter panicked").next();
                    let Some((y, row)) = next else { break };
                    fill(y, row);
                }
            });
        }
    });
    budget.check_cancelled()
}

pub(crate) fn from_srgb(colour: [u8; 3]) -> Vec3 {
    Vec3::from(colour.map(|v| (f32::from(v) / 255.0).powf(2.2)))
}

fn to_srgb(linear: Vec3) -> [u8; 3] {
    linear.to_array().map(|v| {
        let v = v.clamp(0.0, 1.0);
        let s = if v < 0.003_130_8 {
            v * 12.92
        } else {
            1.055 * v.powf(1.0 / 2.4) - 0.055
        };
        (s * 255.0 + 0.5) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::WorldBox;
    use brickmarch::MeshSink;
    use brickmarch::mesh::{Layout, Piece, Totals};

    /// A sphere of radius 1 as two pieces.
    fn sphere() -> [Piece; 2] {
        let point = |i: u32, j: u32| {
            let (a, b) = (
                f64::from(i) / 64.0 * std::f64::consts::TAU,
                f64::from(j) / 32.0 * std::f64::consts::PI,
            );
            [
                (a.cos() * b.sin()) as f32,
                (a.sin() * b.sin()) as f32,
                b.cos() as f32,
            ]
        };
        let half = |from: u32, to: u32| {
            let mut piece = Piece::default();
            for j in from..to {
                for i in 0..64 {
                    let base = piece.positions.len() as u32;
                    for (di, dj) in [(0, 0), (0, 1), (1, 1), (1, 0)] {
                        piece.positions.push(point(i + di, j + dj));
                    }
                    piece
                        .triangles
                        .extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
                }
            }
            piece.normals = piece.positions.clone();
            piece
        };
        [half(0, 16), half(16, 32)]
    }

    fn draw(order: [usize; 2], threads: usize) -> (usize, Vec<u8>) {
        let corners = (0..8)
            .map(|c| DVec3::from([0, 1, 2].map(|a| f64::from((c >> a & 1) * 2 - 1))))
            .collect();
        let look = Look {
            width: 80,
            height: 60,
            ..Look::default()
        };
        let budget = Budget::mib(64).with_threads(threads);
        let mut raster = Raster::new(&look, &WorldBox { corners }, &budget).expect("fits");
        let pieces = sphere();
        raster.begin(Layout::default()).expect("any layout");
        for i in order {
            raster.write(&pieces[i]).expect("draws");
        }
        raster.finish(Totals::default()).expect("ends");
        let picture = raster.picture(&budget).expect("shades");
        (raster.covered(), picture.bytes)
    }

    #[test]
    fn the_order_of_pieces_and_threads_does_not_show() {
        let (covered, bytes) = draw([0, 1], 1);
        assert_eq!(draw([1, 0], 2), (covered, bytes.clone()));
        // A ball in its box, seen from outside: between a fifth and three quarters of the picture.
        let part = covered as f64 / f64::from(80 * 60 * 4);
        assert!((0.2..0.75).contains(&part), "{part}");
        // Lit from above left.
        let luma = |x: usize, y: usize| u32::from(bytes[(x + 80 * y) * 3 + 1]);
        assert!(luma(34, 22) > luma(48, 42) + 40);
    }
}
