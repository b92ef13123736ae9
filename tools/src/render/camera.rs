//! Where the eye is: perspective or parallel projection, fitted to a set of points.

use glam::DVec3;

/// Direction to look from, in degrees, with world z up. Azimuth 0 looks along +y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct View {
    /// Turns the eye about z, counter-clockwise seen from above.
    pub azimuth_deg: f64,
    /// Lifts the eye above the xy plane.
    pub elevation_deg: f64,
}

impl Default for View {
    fn default() -> Self {
        Self {
            azimuth_deg: 30.0,
            elevation_deg: 25.0,
        }
    }
}

impl View {
    /// Unit vector from the scene to the eye.
    pub(crate) fn toward_eye(self) -> DVec3 {
        let (az, el) = (
            self.azimuth_deg.to_radians(),
            self.elevation_deg.to_radians(),
        );
        DVec3::new(az.sin() * el.cos(), -az.cos() * el.cos(), el.sin())
    }
}

/// What must be in the picture: corners of boxes in the world.
#[derive(Clone, Debug, Default)]
pub(crate) struct WorldBox {
    /// Any points whose hull holds the surface.
    pub corners: Vec<DVec3>,
}

/// Projects the world to pixels and to a depth from 0 (near) to 1 (far).
#[derive(Clone, Debug)]
pub(crate) struct Camera {
    right: DVec3,
    up: DVec3,
    back: DVec3,
    /// Eye for a perspective, any point of the near plane otherwise.
    eye: DVec3,
    perspective: bool,
    /// Pixels per unit of the image plane, and the pixel of the optical axis.
    scale: f64,
    centre: [f64; 2],
    /// Depth is linear on the screen, so that triangles may interpolate it: linear in the distance
    /// for a parallel projection, in its inverse for a perspective. Value at depth 0, and the step
    /// to depth 1.
    depth_start: f64,
    depth_span: f64,
}

impl Camera {
    /// The camera that sees all of `what` from `toward_eye` in `width` x `height` pixels with a
    /// free border of `margin` (part of the size).
    pub(crate) fn fit(
        what: &WorldBox,
        toward_eye: DVec3,
        perspective: bool,
        width: f64,
        height: f64,
        margin: f64,
    ) -> Camera {
        let back = toward_eye.normalize();
        let helper = if back.z.abs() > 0.999 {
            DVec3::Y
        } else {
            DVec3::Z
        };
        let right = helper.cross(back).normalize();
        let up = back.cross(right);
        let count = what.corners.len().max(1) as f64;
        let middle = what.corners.iter().copied().sum::<DVec3>() / count;
        let radius = what
            .corners
            .iter()
            .map(|p| (*p - middle).length())
            .fold(0.0, f64::max)
            .max(1e-9);
        // 3.6 radii away is a mild perspective (about 32 degrees across).
        let eye = middle + back * (3.6 * radius);
        let mut camera = Camera {
            right,
            up,
            back,
            eye,
            perspective,
            scale: 1.0,
            centre: [0.0; 2],
            depth_start: 1.0,
            depth_span: 1.0,
        };
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let (mut near, mut far) = (f64::INFINITY, f64::NEG_INFINITY);
        for &corner in &what.corners {
            let [x, y, _] = camera.project(corner);
            let distance = (camera.eye - corner).dot(back);
            for (axis, v) in [x, y].into_iter().enumerate() {
                low[axis] = low[axis].min(v);
                high[axis] = high[axis].max(v);
            }
            near = near.min(distance);
            far = far.max(distance);
        }
        if what.corners.is_empty() {
            (low, high, near, far) = ([-1.0; 2], [1.0; 2], 1.0, 2.0);
        }
        let free = 1.0 - 2.0 * margin;
        let size = [0, 1].map(|a| (high[a] - low[a]).max(1e-12));
        camera.scale = (width * free / size[0]).min(height * free / size[1]);
        camera.centre = [
            width / 2.0 - camera.scale * (low[0] + high[0]) / 2.0,
            height / 2.0 - camera.scale * (low[1] + high[1]) / 2.0,
        ];
        let slack = 1e-3 * radius;
        let [start, end] = [near - slack, far + slack].map(|distance| camera.depth_of(distance));
        camera.depth_start = start;
        camera.depth_span = end - start;
        camera
    }

    /// Pixel position (y down) and depth of a world position.
    #[inline]
    pub(crate) fn project(&self, world: DVec3) -> [f64; 3] {
        let offset = world - self.eye;
        let distance = -offset.dot(self.back);
        let linear = self.depth_of(distance);
        let zoom = if self.perspective {
            self.scale * linear
        } else {
            self.scale
        };
        let depth = (linear - self.depth_start) / self.depth_span;
        [
            self.centre[0] + zoom * offset.dot(self.right),
            self.centre[1] - zoom * offset.dot(self.up),
            depth,
        ]
    }

    /// Position in camera space (right, up, back; the eye at the origin) of a pixel and a depth.
    #[inline]
    pub(crate) fn unproject(&self, x: f64, y: f64, depth: f64) -> DVec3 {
        let linear = self.depth_start + depth * self.depth_span;
        let distance = self.depth_of(linear);
        let unit = if self.perspective {
            distance / self.scale
        } else {
            1.0 / self.scale
        };
        DVec3::new(
            (x - self.centre[0]) * unit,
            (self.centre[1] - y) * unit,
            -distance,
        )
    }

    /// From a distance to what depth is linear in, and back.
    #[inline]
    fn depth_of(&self, distance: f64) -> f64 {
        if self.perspective {
            1.0 / distance
        } else {
            distance
        }
    }

    /// A direction of the world in camera space.
    pub(crate) fn turn(&self, world: DVec3) -> DVec3 {
        DVec3::new(
            world.dot(self.right),
            world.dot(self.up),
            world.dot(self.back),
        )
    }

    /// A direction of camera space in the world.
    pub(crate) fn turn_back(&self, camera: DVec3) -> DVec3 {
        self.right * camera.x + self.up * camera.y + self.back * camera.z
    }

    /// The world position of a position in camera space.
    pub(crate) fn to_world(&self, camera: DVec3) -> DVec3 {
        self.eye + self.turn_back(camera)
    }

    /// Unit vector toward the eye at a position in camera space.
    pub(crate) fn to_eye(&self, camera: DVec3) -> DVec3 {
        if self.perspective {
            -camera.normalize()
        } else {
            DVec3::Z
        }
    }

    /// Pixels that one world unit takes at a position in camera space.
    pub(crate) fn pixels_per_unit(&self, camera: DVec3) -> f64 {
        if self.perspective {
            self.scale / -camera.z
        } else {
            self.scale
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube() -> WorldBox {
        WorldBox {
            corners: (0..8)
                .map(|c| DVec3::new(f64::from(c & 1), f64::from(c >> 1 & 1), f64::from(c >> 2)))
                .collect(),
        }
    }

    #[test]
    fn everything_is_in_the_picture_and_comes_back() {
        for perspective in [false, true] {
            for azimuth_deg in [0.0, 30.0, 145.0] {
                for elevation_deg in [-90.0, -20.0, 0.0, 35.0, 90.0] {
                    let view = View {
                        azimuth_deg,
                        elevation_deg,
                    };
                    let camera =
                        Camera::fit(&cube(), view.toward_eye(), perspective, 400.0, 300.0, 0.05);
                    for p in cube().corners {
                        let [x, y, depth] = camera.project(p);
                        assert!((19.9..380.1).contains(&x) && (14.9..285.1).contains(&y));
                        assert!((0.0..=1.0).contains(&depth));
                        let back = camera.to_world(camera.unproject(x, y, depth));
                        assert!((back - p).length() < 1e-9, "{back} {p}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_front_view_has_x_to_the_right_and_z_up() {
        let view = View {
            azimuth_deg: 0.0,
            elevation_deg: 0.0,
        };
        let camera = Camera::fit(&cube(), view.toward_eye(), false, 100.0, 100.0, 0.1);
        let [x0, y0, d0] = camera.project(DVec3::ZERO);
        let [x1, y1, _] = camera.project(DVec3::new(1.0, 0.0, 1.0));
        assert!(x1 > x0 && y1 < y0);
        assert!(camera.project(DVec3::Y)[2] > d0, "+y is away from the eye");
    }
}
