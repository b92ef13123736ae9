//! Triangles of a mesh that go through each other.

use super::Mesh;
use super::boxes::{Bounds, Boxes, NOTHING, TREE_BYTES, bounds_of, touch};
use super::crew::on_threads;
use super::measure::{self, is_finite};
use super::meet::{Meeting, meet};
use crate::budget::Budget;
use crate::error::Result;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What [`crossings`] finds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Crossings {
    /// Pairs of triangles of different planes with a point inside of both.
    pub crossing_pairs: u64,
    /// Pairs of triangles of one plane with an area in common.
    pub overlapping_pairs: u64,
    /// Triangles whose pairs were looked at: all with finite corners, or a share of them.
    pub checked_triangles: u64,
}

/// Counts the pairs of triangles of `mesh` that have a point inside of both; what touches at
/// corners or edges does not count. Exact for any finite coordinates. Triangles without area, or
/// with a corner that is not finite, meet nothing.
///
/// With more than `most` triangles only pairs in some cells of a grid over the mesh are looked at,
/// about as many as `most` triangles have; which, is decided by the number of the cell.
///
/// The result does not depend on the budget.
///
/// # Errors
/// When a triangle names a vertex that the mesh does not have, `BudgetExceeded`, `Cancelled`.
///
/// # Memory
/// 25 B a triangle that is looked at, not the mesh itself.
pub fn crossings(mesh: &Mesh, most: u64, budget: &Budget) -> Result<Crossings> {
    super::check::refuse_lost(mesh)?;
    let count = mesh.triangles.len() as u64;
    let corners = |n: u32| {
        let [a, b, c] = mesh.triangles[n as usize];
        let at = |v: u32| mesh.positions[v as usize];
        [at(a), at(b), at(c)]
    };
    let finite = |n: &u32| corners(*n).iter().all(is_finite);
    let all = (0..count as u32).filter(finite);
    let whole = measure::bounds(mesh).unwrap_or(NOTHING);
    let cells = Cells::new(whole, count, most);
    let asked = all.filter(|&n| cells.asked_near(&bounds_of(&corners(n))));
    let bytes = TREE_BYTES * asked.clone().count() as u64;
    let _permit = budget.take(bytes, "looking for crossings")?;
    let mut found = crossings_among(asked, corners, |p| cells.asked(cells.of(p)), whole, budget)?;
    let all = (0..count as u32).filter(finite);
    let begins = all.filter(|&n| cells.asked(cells.of(bounds_of(&corners(n))[0])));
    found.checked_triangles = begins.count() as u64;
    Ok(found)
}

/// A grid over a mesh, by which it is looked at in parts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cells {
    low: [f64; 3],
    /// Cells per unit of length.
    scale: [f64; 3],
    /// Cells per axis.
    pub(super) edge: u32,
    /// One cell in so many is looked at.
    share: u64,
}

/// Triangles of a cell, if they were evenly spread over a volume.
const CELL_TRIANGLES: f64 = 50.0;

impl Cells {
    /// The grid over `count` triangles in `whole`, of which about `most` are to be looked at.
    pub(super) fn new(whole: Bounds, count: u64, most: u64) -> Self {
        let edge = (count as f64 / CELL_TRIANGLES)
            .cbrt()
            .ceil()
            .clamp(1.0, 64.0);
        let wide = |a: usize| f64::from(whole[1][a]) - f64::from(whole[0][a]);
        Self {
            low: whole[0].map(f64::from),
            scale: [0, 1, 2].map(|a| if wide(a) > 0.0 { edge / wide(a) } else { 0.0 }),
            edge: edge as u32,
            share: count.div_ceil(most.max(1)).max(1),
        }
    }

    /// The cell of a point.
    pub(super) fn of(&self, point: [f32; 3]) -> [u32; 3] {
        [0, 1, 2].map(|a| {
            let at = (f64::from(point[a]) - self.low[a]) * self.scale[a];
            (at as u32).min(self.edge - 1)
        })
    }

    /// All cells that a box meets.
    pub(super) fn of_box(&self, bounds: &Bounds) -> impl Iterator<Item = [u32; 3]> + use<> {
        let (low, high) = (self.of(bounds[0]), self.of(bounds[1]));
        (low[2]..=high[2]).flat_map(move |z| {
            (low[1]..=high[1]).flat_map(move |y| (low[0]..=high[0]).map(move |x| [x, y, z]))
        })
    }

    /// Whether pairs that begin in a cell are looked at.
    pub(super) fn asked(&self, cell: [u32; 3]) -> bool {
        // Spread, so that those of a share form no plane.
        let mixed = self.number(cell).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32;
        mixed.is_multiple_of(self.share)
    }

    /// Whether pairs with a triangle in this box may be looked at.
    pub(super) fn asked_near(&self, bounds: &Bounds) -> bool {
        self.share == 1 || self.of_box(bounds).any(|cell| self.asked(cell))
    }

    /// The number of a cell in the order of [`of_box`](Self::of_box).
    pub(super) fn number(&self, [x, y, z]: [u32; 3]) -> u64 {
        let edge = u64::from(self.edge);
        u64::from(x) + edge * (u64::from(y) + edge * u64::from(z))
    }
}

/// Groups that a thread takes at one time.
const RUN: usize = 64;

/// Counts the pairs among the triangles `numbers`, which have finite corners in `whole`. `counts`
/// says whether a pair counts whose boxes have this lowest point in common.
pub(super) fn crossings_among(
    numbers: impl Iterator<Item = u32>,
    corners: impl Fn(u32) -> [[f32; 3]; 3] + Sync,
    counts: impl Fn([f32; 3]) -> bool + Sync,
    whole: Bounds,
    budget: &Budget,
) -> Result<Crossings> {
    let boxes = Boxes::new(numbers, &corners, whole);
    budget.check_cancelled()?;
    let runs = boxes.groups().div_ceil(RUN);
    let next = AtomicUsize::new(0);
    let total = Mutex::new(Crossings::default());
    let work = || -> Result<()> {
        let mut stack = Vec::new();
        let mut found = Crossings::default();
        loop {
            let run = next.fetch_add(1, Ordering::Relaxed);
            if run >= runs {
                break;
            }
            budget.check_cancelled()?;
            for g in run * RUN..boxes.groups().min((run + 1) * RUN) {
                let own = boxes.group(g);
                boxes.neighbours(g, &mut stack, |other| {
                    let theirs = boxes.group(other);
                    pairs(own, theirs, g == other, &corners, &counts, &mut found);
                });
            }
        }
        let mut total = total.lock().expect("no worker panicked");
        total.crossing_pairs += found.crossing_pairs;
        total.overlapping_pairs += found.overlapping_pairs;
        Ok(())
    };
    on_threads(budget.threads(), work)?;
    Ok(total.into_inner().expect("no worker panicked"))
}

/// Counts the pairs of one triangle of each list, or of two of one.
fn pairs(
    own: &[u32],
    other: &[u32],
    same: bool,
    corners: &impl Fn(u32) -> [[f32; 3]; 3],
    counts: &impl Fn([f32; 3]) -> bool,
    found: &mut Crossings,
) {
    let mut theirs: [([[f32; 3]; 3], Bounds); 8] = [([[0.0; 3]; 3], NOTHING); 8];
    for (slot, &n) in theirs.iter_mut().zip(other) {
        let t = corners(n);
        *slot = (t, bounds_of(&t));
    }
    for (i, &n) in own.iter().enumerate() {
        let s = corners(n);
        let bounds = bounds_of(&s);
        let from = if same { i + 1 } else { 0 };
        for (t, other) in theirs[..other.len()].iter().skip(from) {
            if !touch(&bounds, other) {
                continue;
            }
            let meeting = meet(&s, t);
            if meeting == Meeting::Apart {
                continue;
            }
            let begin = [0, 1, 2].map(|a| bounds[0][a].max(other[0][a]));
            if counts(begin) {
                match meeting {
                    Meeting::Overlapping => found.overlapping_pairs += 1,
                    _ => found.crossing_pairs += 1,
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_meshes::{both, cube, torus};

    fn brute(mesh: &Mesh) -> [u64; 2] {
        let corners = |t: &[u32; 3]| t.map(|v| mesh.positions[v as usize]);
        let mut found = [0; 2];
        for (i, s) in mesh.triangles.iter().enumerate() {
            for t in &mesh.triangles[..i] {
                let (s, t) = (corners(s), corners(t));
                if s.iter().chain(&t).all(is_finite) {
                    match meet(&s, &t) {
                        Meeting::Apart => {}
                        Meeting::Crossing => found[0] += 1,
                        Meeting::Overlapping => found[1] += 1,
                    }
                }
            }
        }
        found
    }

    fn examine(mesh: &Mesh, threads: usize) -> Crossings {
        let budget = Budget::mib(64).with_threads(threads);
        crossings(mesh, u64::MAX, &budget).expect("fits")
    }

    /// Triangles of all sizes, some of them huge, some without area, some not finite.
    fn soup(count: u32, seed: u64) -> Mesh {
        let mut state = seed;
        let mut dice = move || {
            state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        let mut mesh = Mesh::default();
        for n in 0..count {
            let size = [0.01, 0.05, 0.3, 3.0][(n % 4) as usize];
            let middle = [dice(), dice(), dice()];
            for _ in 0..3 {
                let p = middle.map(|v| v + size * (dice() - 0.5));
                mesh.positions.push(p);
            }
            mesh.triangles.push([3 * n, 3 * n + 1, 3 * n + 2]);
        }
        mesh.triangles[0] = [0, 1, 1];
        mesh.positions[5][1] = f32::NAN;
        mesh.positions[40][0] = f32::INFINITY;
        mesh
    }

    #[test]
    fn all_pairs_of_a_soup_are_found_once() {
        for (count, seed) in [(16, 1), (100, 2), (700, 3), (1500, 4)] {
            let mesh = soup(count, seed);
            let want = brute(&mesh);
            for threads in [1, 3] {
                let found = examine(&mesh, threads);
                assert_eq!([found.crossing_pairs, found.overlapping_pairs], want);
                assert_eq!(found.checked_triangles, u64::from(count) - 2);
            }
            assert!(count < 100 || want[0] > 100, "{want:?}");
        }
    }

    #[test]
    fn closed_surfaces_do_not_meet_themselves_and_shifted_copies_do() {
        let ring = torus(2.0, 0.5, 40, 20);
        assert_eq!(brute(&ring), [0, 0]);
        let alone = examine(&ring, 2);
        assert_eq!((alone.crossing_pairs, alone.overlapping_pairs), (0, 0));
        assert_eq!(alone.checked_triangles, ring.triangles.len() as u64);
        let mut moved = ring.clone();
        moved.positions.iter_mut().for_each(|p| p[0] += 0.1);
        let two = both(ring.clone(), &moved);
        let found = examine(&two, 2);
        assert!(found.crossing_pairs > 50);
        assert_eq!(found.crossing_pairs, brute(&two)[0]);
        // On itself every triangle lies on its copy.
        let twice = examine(&both(ring.clone(), &ring), 1);
        assert!(twice.overlapping_pairs >= ring.triangles.len() as u64);
        // A cube on a cube has the diagonals of a face in common or crossed.
        let stacked = both(cube([0.0; 3], 1.0), &cube([0.0, 0.0, 1.0], 1.0));
        let found = examine(&stacked, 1);
        assert_eq!(
            [found.crossing_pairs, found.overlapping_pairs],
            brute(&stacked)
        );
        assert!(found.overlapping_pairs >= 2 && found.crossing_pairs == 0);
    }

    #[test]
    fn a_sample_finds_a_share_and_says_so() {
        let mesh = soup(6000, 5);
        let all = examine(&mesh, 2);
        let some = crossings(&mesh, 1500, &Budget::mib(64)).expect("fits");
        assert!(some.checked_triangles < all.checked_triangles / 2);
        assert!(some.checked_triangles > 600, "{some:?}");
        assert!(some.crossing_pairs < all.crossing_pairs && some.crossing_pairs > 0);
        assert_eq!(crossings(&mesh, 6000, &Budget::mib(64)).expect("fits"), all);
        let nothing = crossings(&Mesh::default(), 0, &Budget::mib(1)).expect("nothing");
        assert_eq!(nothing, Crossings::default());
        let lost = Mesh {
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        assert!(crossings(&lost, 1, &Budget::mib(1)).is_err());
        assert!(crossings(&mesh, 6000, &Budget::bytes(1000)).is_err());
    }
}
