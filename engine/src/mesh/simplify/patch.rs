//! A patch of surface with fewer triangles, its border fixed.
//!
//! The result is examined and measured; the vertices around what is wrong are locked, and it is made
//! again. What cannot be mended stays as it was.

use super::collapse::collapse;
use super::near::{Near, Search, distance, mean_side};
use super::sound::{Fans, find_faults};
use crate::mesh::measure::is_finite;

/// What a patch should become.
#[derive(Clone, Copy, Debug)]
pub(super) struct Want {
    /// Not fewer triangles than so many, beside those at the border.
    pub(super) triangles: usize,
    /// Not farther than this from what it was; infinite when it does not matter.
    pub(super) error: f64,
}

/// What a patch became.
pub(super) struct Made {
    /// Triangles over the same vertices.
    pub(super) triangles: Vec<[u32; 3]>,
    /// Vertices on the border, whose triangles are as they were.
    pub(super) border: Vec<bool>,
    /// Greatest distance that was measured.
    pub(super) distance: f64,
    /// Whether it stays as it was although it should not.
    pub(super) given_up: bool,
}

/// Bytes a triangle of a patch that is simplified, all in all.
pub(super) const TRIANGLE_BYTES: u64 = 480;

/// How often it is tried.
const ATTEMPTS: u32 = 8;

/// Spacing of the points on the new triangles at which distances are measured, in mean sides of the
/// old ones.
const SPACING: f64 = 1.5;

/// Share of the error up to which vertices may be off; points between them are measured afterwards.
const MARGIN: f64 = 0.8;

/// Simplifies `triangles`. All triangles at a border vertex, one without a closed ring of triangles,
/// stay: so patches that are simplified apart fit together, and no two of them make the same edge.
pub(super) fn simplify(positions: &[[f32; 3]], triangles: &[[u32; 3]], want: Want) -> Made {
    let fans = Fans::new(triangles, positions.len());
    let mut made = Made {
        triangles: triangles.to_vec(),
        border: (0..positions.len()).map(|v| !fans.is_ring(v)).collect(),
        distance: 0.0,
        given_up: false,
    };
    drop(fans);
    let finite = positions.iter().all(is_finite);
    if triangles.len() <= want.triangles || !finite {
        return made;
    }
    let mut locked = made.border.clone();
    for t in triangles {
        if t.iter().any(|&v| made.border[v as usize]) {
            t.iter().for_each(|&v| locked[v as usize] = true);
        }
    }
    let stay = |t: &&[u32; 3]| t.iter().all(|&v| locked[v as usize]);
    let stay = triangles.iter().filter(stay).count();
    // Triangles that cannot go are not made up for by the others.
    let free = (triangles.len() - stay) as f64 * want.triangles as f64 / triangles.len() as f64;
    let target = stay + free as usize;
    let spacing = SPACING * mean_side(positions, triangles);
    for attempt in 0..ATTEMPTS {
        let after = collapse(positions, triangles, &locked, target, MARGIN * want.error);
        if after.len() == triangles.len() {
            return made;
        }
        let mut faulty = vec![false; positions.len()];
        let broken = find_faults(positions, triangles, &after, &made.border, &mut faulty);
        let (distance, far) = distance(positions, [triangles, &after], spacing, want.error);
        if !broken && distance <= want.error {
            (made.triangles, made.distance) = (after, distance);
            return made;
        }
        blame(positions, triangles, &far, &mut faulty);
        widen(triangles, &mut faulty, attempt / 2);
        locked.iter_mut().zip(&faulty).for_each(|(l, f)| *l |= f);
    }
    made.given_up = true;
    made
}

/// Marks the corners of the triangles that points which are now too far away are nearest to.
fn blame(positions: &[[f32; 3]], triangles: &[[u32; 3]], far: &[[f32; 3]], faulty: &mut [bool]) {
    if far.is_empty() {
        return;
    }
    let (near, mut search) = (Near::new(positions, triangles), Search::default());
    for &p in far {
        let (_, n) = near.nearest(p, 0.0, &mut search);
        for &v in &triangles[n as usize] {
            faulty[v as usize] = true;
        }
    }
}

/// Marks the neighbours of what is marked, ring by ring.
fn widen(triangles: &[[u32; 3]], marked: &mut [bool], rings: u32) {
    for _ in 0..rings {
        let seed = marked.to_vec();
        for t in triangles {
            if t.iter().any(|&v| seed[v as usize]) {
                t.iter().for_each(|&v| marked[v as usize] = true);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::Budget;
    use crate::mesh::test_meshes::torus;
    use crate::mesh::{Mesh, check};

    #[test]
    fn a_torus_stays_a_torus() {
        let mesh = torus(2.0, 0.7, 200, 90);
        for (share, error) in [(10, f64::INFINITY), (100, f64::INFINITY), (1000, 0.01)] {
            let want = Want {
                triangles: mesh.triangles.len() / share,
                error,
            };
            let made = simplify(&mesh.positions, &mesh.triangles, want);
            assert!(!made.given_up && made.distance <= error && made.distance > 0.0);
            assert!(!made.border.contains(&true));
            let simple = Mesh {
                triangles: made.triangles,
                ..mesh.clone()
            };
            let report = check(&simple, &Budget::mib(16)).expect("checked");
            assert!(report.is_sound() && report.genus == Some(1), "{report:?}");
            assert!(report.triangles < mesh.triangles.len() as u64 / 8);
        }
    }

    #[test]
    fn triangles_at_a_border_stay() {
        let mesh = torus(2.0, 0.7, 60, 40);
        let half: Vec<[u32; 3]> = mesh.triangles[..mesh.triangles.len() / 2].to_vec();
        let want = Want {
            triangles: 0,
            error: f64::INFINITY,
        };
        let made = simplify(&mesh.positions, &half, want);
        assert!(made.triangles.len() < half.len() / 2);
        let at_border = |list: &[[u32; 3]]| {
            let touches = |t: &&[u32; 3]| t.iter().any(|&v| made.border[v as usize]);
            let turned = |t: &[u32; 3]| {
                let first = (0..3).min_by_key(|&i| t[i]).expect("three");
                [t[first], t[(first + 1) % 3], t[(first + 2) % 3]]
            };
            let mut found: Vec<_> = list.iter().filter(touches).map(turned).collect();
            found.sort_unstable();
            found
        };
        assert!(!at_border(&half).is_empty());
        assert_eq!(at_border(&half), at_border(&made.triangles));
    }

    #[test]
    fn what_is_not_finite_stays() {
        let mut mesh = torus(2.0, 0.7, 30, 20);
        mesh.positions[17][1] = f32::NAN;
        let want = Want {
            triangles: 10,
            error: f64::INFINITY,
        };
        let made = simplify(&mesh.positions, &mesh.triangles, want);
        assert_eq!(made.triangles, mesh.triangles);
    }
}
