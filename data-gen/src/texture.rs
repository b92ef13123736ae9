//! Solid textures: wood and marble as functions of space, so that a cut shows what is inside (Perlin 1985, "An
//! image synthesizer"; Peachey 1985, "Solid texturing of complex surfaces").
//!
//! Both are made of gradient noise (Perlin 2002, "Improving noise"): at each lattice point one of twelve
//! directions, here by a hash of the point instead of a table, and between them the fifth degree step, so that it
//! has two continuous derivatives and is 0 at lattice points.

use crate::rng::hash_point;
use std::fmt;
use std::str::FromStr;

/// Which texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Texture {
    /// Rings around an axis along z, with fibres.
    Wood,
    /// Veins across x, folded.
    Marble,
}

impl Texture {
    /// All of them.
    pub const ALL: [Texture; 2] = [Texture::Wood, Texture::Marble];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Texture::Wood => "wood",
            Texture::Marble => "marble",
        }
    }
}

impl fmt::Display for Texture {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Texture {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Texture::ALL.into_iter().find(|t| t.name() == text);
        found.ok_or_else(|| format!("'{text}' is no texture: use wood or marble"))
    }
}

/// Streams of the hash: of noise number `n` the `STREAM + n`-th.
const STREAM: u64 = 101;
/// Noises of a texture.
const NOISES: usize = 5;

/// Tells the colours of a texture at points, fastest where they follow each other.
#[derive(Clone, Debug)]
pub struct Painter {
    texture: Texture,
    noises: [Noise; NOISES],
}

impl Painter {
    /// A painter that has not painted.
    pub fn new(texture: Texture) -> Painter {
        Painter {
            texture,
            noises: std::array::from_fn(|n| Noise::new(STREAM + n as u64)),
        }
    }

    /// Red, green and blue, from 0 to 255, at a point; rings and veins are about 1 apart.
    pub fn colour(&mut self, p: [f64; 3]) -> [f64; 3] {
        match self.texture {
            Texture::Wood => self.wood(p),
            Texture::Marble => self.marble(p),
        }
    }

    fn wood(&mut self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        const EARLY: [f64; 3] = [214.0, 170.0, 112.0];
        const LATE: [f64; 3] = [126.0, 76.0, 38.0];
        let [bend_x, bend_y, fibre, ..] = &mut self.noises;
        // Trunks are not round, and lean a little.
        let slow = [0.35 * x, 0.35 * y, 0.12 * z];
        let bent = [
            x + 0.08 * z + 0.5 * bend_x.at(slow),
            y - 0.05 * z + 0.5 * bend_y.at(slow),
        ];
        let ring = (bent[0] * bent[0] + bent[1] * bent[1]).sqrt();
        let part = ring - ring.floor();
        // A ring darkens slowly towards its end in autumn, and begins anew at once, but not infinitely fast.
        let late = part * part * part * (1.0 - smooth((part - 0.93) / 0.07));
        let fibre = fibre.at([10.0 * x, 10.0 * y, 0.7 * z]);
        mix(EARLY, LATE, 0.85 * late + 0.16 * fibre + 0.08)
    }

    fn marble(&mut self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        const STONE: [f64; 3] = [236.0, 233.0, 226.0];
        const VEIN: [f64; 3] = [70.0, 78.0, 92.0];
        let [shade, octaves @ ..] = &mut self.noises;
        let (mut folds, mut part, mut rate) = (0.0, 1.0, 0.3);
        for noise in octaves {
            folds += part * noise.at([rate * x, rate * y, rate * z]).abs();
            (part, rate) = (0.5 * part, 2.0 * rate);
        }
        // Veins where this is whole, 1 in the middle and 0 half way between.
        let place = 0.7 * x + 0.3 * z + 2.2 * folds;
        let near = 1.0 - 2.0 * (place - place.round()).abs();
        let vein = near * near * near * near * near;
        let shade = shade.at([0.8 * x, 0.8 * y, 0.8 * z]);
        mix(STONE, VEIN, 0.9 * vein + 0.12 * shade + 0.1)
    }
}

/// From `a` to `b`, where `t` goes from 0 to 1.
fn mix(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    let t = t.clamp(0.0, 1.0);
    std::array::from_fn(|c| a[c] + (b[c] - a[c]) * t)
}

/// From 0 to 1 with two continuous derivatives.
fn smooth(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}

/// Gradient noise between -1 and 1, of features of size 1. Only sums and products, so that it is the same on every
/// machine.
#[derive(Clone, Debug)]
pub struct Noise {
    stream: u64,
    /// The cube of lattice points that was used last, and the directions at its corners.
    cube: [i64; 3],
    directions: [[f64; 3]; 8],
}

impl Noise {
    /// The noise of a stream of the hash.
    pub fn new(stream: u64) -> Noise {
        let mut noise = Noise {
            stream,
            cube: [0; 3],
            directions: [[0.0; 3]; 8],
        };
        noise.turn_to([0; 3]);
        noise
    }

    fn turn_to(&mut self, cube: [i64; 3]) {
        self.cube = cube;
        for (corner, direction) in self.directions.iter_mut().enumerate() {
            let [i, j, k] = [0, 1, 2].map(|a| (cube[a] + (corner >> a & 1) as i64) as u32);
            // The upper half of the bits, times 12: a number below 12.
            let half = hash_point(self.stream, i, j, k) >> 32;
            *direction = edge_direction(((half * 12) >> 32) as usize);
        }
    }

    /// The noise at a point.
    pub fn at(&mut self, p: [f64; 3]) -> f64 {
        // Rounding down by way of whole numbers takes a fraction of the time of the function for it.
        let cube = p.map(|v| v as i64 - i64::from((v as i64) as f64 > v));
        if cube != self.cube {
            self.turn_to(cube);
        }
        let low: [f64; 3] = std::array::from_fn(|a| p[a] - cube[a] as f64);
        let step = low.map(smooth);
        let value = |corner: usize| {
            let away = |a: usize| low[a] - (corner >> a & 1) as f64;
            let [x, y, z] = self.directions[corner];
            x * away(0) + y * away(1) + z * away(2)
        };
        let between = |a: f64, b: f64, axis: usize| a + (b - a) * step[axis];
        let row = |corner: usize| between(value(corner), value(corner + 1), 0);
        let side = |corner: usize| between(row(corner), row(corner + 2), 1);
        between(side(0), side(4), 2).clamp(-1.0, 1.0)
    }
}

/// One of the twelve directions from the middle of a cube to its edges.
fn edge_direction(edge: usize) -> [f64; 3] {
    let axes = [[0, 1], [0, 2], [1, 2]][edge / 4];
    let mut direction = [0.0; 3];
    for (bit, axis) in axes.into_iter().enumerate() {
        direction[axis] = if edge >> bit & 1 == 0 { 1.0 } else { -1.0 };
    }
    direction
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;

    fn colour(texture: Texture, p: [f64; 3]) -> [f64; 3] {
        Painter::new(texture).colour(p)
    }

    #[test]
    fn noise_is_zero_at_lattice_points_smooth_and_bounded() {
        let mut rng = Rng::new(9);
        let mut other = Noise::new(3);
        let mut noise = |p: [f64; 3]| other.at(p);
        let mut at = || [0; 3].map(|_| 40.0 * (rng.unit() - 0.5));
        let (mut least, mut most, mut sum) = (0.0f64, 0.0f64, 0.0);
        for _ in 0..20_000 {
            let p = at();
            assert_eq!(noise(p.map(f64::round)), 0.0);
            let v = noise(p);
            // Whatever was asked before.
            assert_eq!(Noise::new(3).at(p), v);
            (least, most, sum) = (least.min(v), most.max(v), sum + v);
            // Slopes on both sides of a lattice plane are the same.
            let h = 1e-6;
            let mut slope =
                |x: f64| (noise([x + h, p[1], p[2]]) - noise([x - h, p[1], p[2]])) / (2.0 * h);
            let plane = p[0].round();
            assert!((slope(plane - 2.0 * h) - slope(plane + 2.0 * h)).abs() < 1e-4);
        }
        assert!(
            least < -0.7 && most > 0.7 && least > -1.0 && most < 1.0,
            "{least} {most}"
        );
        assert!((sum / 20_000.0).abs() < 0.02);
        assert_ne!(Noise::new(3).at([0.5; 3]), Noise::new(4).at([0.5; 3]));
    }

    #[test]
    fn numbers_never_change() {
        let found = Noise::new(1).at([1.25, -2.5, 7.75]);
        assert_eq!(found.to_bits(), NOISE_BITS, "{found}");
        let whole = |t: Texture| colour(t, [1.3, 0.4, -2.2]).map(|v| v.round() as u8);
        assert_eq!(Texture::ALL.map(whole), COLOURS);
    }

    const NOISE_BITS: u64 = 13_818_894_873_576_603_648;
    const COLOURS: [[u8; 3]; 2] = [[199, 154, 99], [217, 215, 210]];

    #[test]
    fn wood_has_rings_around_its_axis_and_marble_veins() {
        // Along a ray from the axis a ring is dark once a unit.
        let dark = |t: Texture, p: [f64; 3]| colour(t, p)[0] < 165.0;
        let changes = |t: Texture, way: &dyn Fn(f64) -> [f64; 3]| {
            let all: Vec<bool> = (0..4000)
                .map(|n| dark(t, way(f64::from(n) * 0.005)))
                .collect();
            all.windows(2).filter(|w| !w[0] && w[1]).count()
        };
        let out = changes(Texture::Wood, &|s| [s * 0.6, s * 0.8, 0.3]);
        assert!((15..=30).contains(&out), "{out} rings over 20 units");
        let along = changes(Texture::Wood, &|s| [3.3, 0.2, s]);
        assert!(along < out, "{along} along the axis");
        let across = changes(Texture::Marble, &|s| [s, 0.1, 0.2]);
        assert!((10..=60).contains(&across), "{across} veins over 20 units");
        for t in Texture::ALL {
            for n in 0..5000 {
                let p = [0.37, 0.11, 0.53].map(|f| f * f64::from(n));
                assert!(colour(t, p).iter().all(|v| (0.0..=255.0).contains(v)));
            }
        }
    }
}
