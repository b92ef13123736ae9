//! How good the triangles of a mesh are: smallest angles and radius ratios.

use super::Mesh;
use super::crew::on_threads;
use super::measure::is_finite;
use crate::budget::Budget;
use crate::error::Result;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The percentiles of [`Spread`].
pub const PERCENTILES: [u32; 6] = [1, 5, 25, 50, 75, 95];

/// Triangles whose smallest angle is below this are slivers.
pub const SLIVER_DEG: f64 = 10.0;

/// Bins of a histogram; its highest value is the last.
const BINS: usize = 6000;

/// The least of many numbers and how they are spread.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    /// The least, exactly; 0 when there are none.
    pub least: f64,
    /// The [`PERCENTILES`], each rounded down to a 6000th of the highest possible value.
    pub percentiles: [f64; 6],
}

/// What [`shapes`] finds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shapes {
    /// Smallest angle of each triangle, in degrees, 60 at most.
    pub min_angle_deg: Spread,
    /// Twice the radius of the inscribed circle over that of the circumscribed one, 1 at most.
    pub radius_ratio: Spread,
    /// Triangles with an angle below [`SLIVER_DEG`], those without area among them.
    pub slivers: u64,
    /// Triangles that were looked at: those with finite corners.
    pub measured: u64,
}

/// Measures the triangles of `mesh`. Triangles without area have angle and ratio 0; those with a
/// corner that is not finite are left out.
///
/// # Errors
/// When a triangle names a vertex that the mesh does not have; `Cancelled`.
///
/// # Memory
/// 100 KB a thread.
pub fn shapes(mesh: &Mesh, budget: &Budget) -> Result<Shapes> {
    super::check::refuse_lost(mesh)?;
    const CHUNK: usize = 1 << 16;
    let next = AtomicUsize::new(0);
    let total = Mutex::new(ShapeCount::default());
    let work = || -> Result<()> {
        let mut count = ShapeCount::default();
        loop {
            let start = next.fetch_add(1, Ordering::Relaxed) * CHUNK;
            let Some(rest) = mesh.triangles.get(start..).filter(|r| !r.is_empty()) else {
                break;
            };
            budget.check_cancelled()?;
            for t in &rest[..rest.len().min(CHUNK)] {
                count.add(&t.map(|v| mesh.positions[v as usize]));
            }
        }
        total.lock().expect("no worker panicked").join(&count);
        Ok(())
    };
    on_threads(budget.threads(), work)?;
    Ok(total.into_inner().expect("no worker panicked").shapes())
}

/// Smallest angle in degrees and radius ratio of a triangle with finite corners.
pub(super) fn shape(corners: &[[f32; 3]; 3]) -> [f64; 2] {
    let [a, b, c] = corners.map(|p| p.map(f64::from));
    let sub = |p: [f64; 3], q: [f64; 3]| [p[0] - q[0], p[1] - q[1], p[2] - q[2]];
    let dot = |p: [f64; 3], q: [f64; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
    // The edge against each corner.
    let edges = [sub(c, b), sub(a, c), sub(b, a)];
    let squares = edges.map(|e| dot(e, e));
    let [u, v, _] = edges;
    let cross = [
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    ];
    let square = dot(cross, cross);
    if square == 0.0 {
        return [0.0; 2];
    }
    // The smallest angle is the one against the shortest edge.
    let shortest = (0..3)
        .min_by(|&i, &j| squares[i].total_cmp(&squares[j]))
        .expect("three edges");
    let (p, q) = (edges[(shortest + 1) % 3], edges[(shortest + 2) % 3]);
    let angle = square.sqrt().atan2(-dot(p, q)).to_degrees();
    let [x, y, z] = squares.map(f64::sqrt);
    let ratio = 4.0 * square / ((x + y + z) * x * y * z);
    [angle.min(60.0), ratio.min(1.0)]
}

/// Counts triangles one by one, in any order, for [`Shapes`].
///
/// # Memory
/// 96 KB.
#[derive(Clone, Debug)]
pub struct ShapeCount {
    angles: Vec<u64>,
    ratios: Vec<u64>,
    least: [f64; 2],
    slivers: u64,
    measured: u64,
}

impl Default for ShapeCount {
    fn default() -> Self {
        Self {
            angles: vec![0; BINS + 1],
            ratios: vec![0; BINS + 1],
            least: [f64::INFINITY; 2],
            slivers: 0,
            measured: 0,
        }
    }
}

impl ShapeCount {
    /// Counts a triangle, unless a corner is not finite.
    pub fn add(&mut self, corners: &[[f32; 3]; 3]) {
        if !corners.iter().all(is_finite) {
            return;
        }
        let [angle, ratio] = shape(corners);
        self.angles[(angle / 60.0 * BINS as f64) as usize] += 1;
        self.ratios[(ratio * BINS as f64) as usize] += 1;
        self.least = [self.least[0].min(angle), self.least[1].min(ratio)];
        self.slivers += u64::from(angle < SLIVER_DEG);
        self.measured += 1;
    }

    /// Adds what `other` counted.
    pub fn join(&mut self, other: &Self) {
        for (mine, theirs) in [
            (&mut self.angles, &other.angles),
            (&mut self.ratios, &other.ratios),
        ] {
            mine.iter_mut().zip(theirs).for_each(|(a, b)| *a += b);
        }
        self.least = [0, 1].map(|i| self.least[i].min(other.least[i]));
        self.slivers += other.slivers;
        self.measured += other.measured;
    }

    /// The shapes of all that were counted.
    pub fn shapes(&self) -> Shapes {
        let spread = |bins: &[u64], least: f64, highest: f64| {
            if self.measured == 0 {
                return Spread::default();
            }
            let percentile = |p: u32| {
                // The number of those that are lower.
                let rank = (u128::from(self.measured - 1) * u128::from(p) / 100) as u64;
                let mut below = 0;
                let bin = bins.iter().position(|&n| {
                    below += n;
                    below > rank
                });
                bin.expect("all were counted") as f64 * highest / BINS as f64
            };
            Spread {
                least,
                percentiles: PERCENTILES.map(percentile),
            }
        };
        Shapes {
            min_angle_deg: spread(&self.angles, self.least[0], 60.0),
            radius_ratio: spread(&self.ratios, self.least[1], 1.0),
            slivers: self.slivers,
            measured: self.measured,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_meshes::torus;

    #[test]
    fn known_triangles() {
        let near = |corners: [[f32; 3]; 3], angle: f64, ratio: f64| {
            for turn in 0..3 {
                let turned = [0, 1, 2].map(|k| corners[(k + turn) % 3]);
                let [a, r] = shape(&turned);
                assert!(
                    (a - angle).abs() < 1e-5 && (r - ratio).abs() < 1e-6,
                    "{a} {r}"
                );
            }
        };
        let root = 3f32.sqrt();
        near([[0.0; 3], [2.0, 0.0, 0.0], [1.0, root, 0.0]], 60.0, 1.0);
        // Right and isosceles: r = (2 - sqrt 2) / 2, R = sqrt 2 / 2.
        near(
            [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
            45.0,
            2.0 * (2.0 - 2f64.sqrt()) / 2f64.sqrt(),
        );
        near(
            [[0.0; 3], [2.0, 0.0, 0.0], [0.0, 2.0 * root, 0.0]],
            30.0,
            2.0 * (root as f64 - 1.0) / 2.0,
        );
        // An angle of nearly 180 degrees.
        let [a, r] = shape(&[[0.0; 3], [2.0, 0.0, 0.0], [1.0, 1e-3, 0.0]]);
        assert!((a - 1e-3f64.atan().to_degrees()).abs() < 1e-6 && r > 0.0 && r < 1e-5);
        assert_eq!(shape(&[[1.0; 3], [2.0; 3], [3.0; 3]]), [0.0; 2]);
        assert_eq!(shape(&[[1.0; 3], [1.0; 3], [3.0; 3]]), [0.0; 2]);
    }

    #[test]
    fn percentiles_are_those_of_the_sorted_list() {
        let mut mesh = torus(2.0, 0.7, 300, 90);
        for (i, p) in mesh.positions.iter_mut().enumerate() {
            p[2] += 0.4 * ((i * 7919 % 1000) as f32 / 1000.0);
        }
        let all: Vec<[f64; 2]> = mesh
            .triangles
            .iter()
            .map(|t| shape(&t.map(|v| mesh.positions[v as usize])))
            .collect();
        // Left out: not finite. Counted with 0: no area.
        mesh.positions.push([f32::NAN; 3]);
        mesh.triangles.push([0, 1, mesh.positions.len() as u32 - 1]);
        mesh.triangles.push([5, 5, 9]);
        for threads in [1, 3] {
            let budget = Budget::mib(8).with_threads(threads);
            let found = shapes(&mesh, &budget).expect("fits");
            assert_eq!(found.measured, all.len() as u64 + 1);
            for (i, spread, highest) in
                [(0, found.min_angle_deg, 60.0), (1, found.radius_ratio, 1.0)]
            {
                let mut sorted: Vec<f64> = all.iter().map(|s| s[i]).collect();
                sorted.push(0.0);
                sorted.sort_by(f64::total_cmp);
                assert_eq!(spread.least, 0.0);
                for (p, value) in PERCENTILES.into_iter().zip(spread.percentiles) {
                    let exact = sorted[(sorted.len() - 1) * p as usize / 100];
                    let off = exact - value;
                    assert!(
                        (-1e-9..highest / 6000.0 + 1e-9).contains(&off),
                        "{p}: {off}"
                    );
                }
            }
            let slivers = all.iter().filter(|s| s[0] < SLIVER_DEG).count() as u64 + 1;
            assert_eq!(found.slivers, slivers);
            assert!(slivers > 1);
        }
        let none = shapes(&Mesh::default(), &Budget::mib(1)).expect("nothing");
        assert_eq!(none, Shapes::default());
    }
}
