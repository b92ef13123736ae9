//! Is a simplified patch still the same surface: 2-manifold, with the border and the topology it had?

use crate::mesh::joined::{root, unite};

/// The triangles around each vertex.
pub(super) struct Fans {
    /// Where the entries of each vertex begin; one more than there are vertices.
    first: Vec<u32>,
    /// The other two corners of each triangle at a vertex, in its orientation.
    pairs: Vec<(u32, u32)>,
}

impl Fans {
    /// The fans of `triangles` over `vertices` vertices.
    pub(super) fn new(triangles: &[[u32; 3]], vertices: usize) -> Self {
        let mut first = vec![0; vertices + 1];
        for &v in triangles.as_flattened() {
            first[v as usize + 1] += 1;
        }
        for v in 0..vertices {
            first[v + 1] += first[v];
        }
        let mut next = first.clone();
        let mut pairs = vec![(0, 0); triangles.len() * 3];
        for &[a, b, c] in triangles {
            for (at, from, to) in [(a, b, c), (b, c, a), (c, a, b)] {
                pairs[next[at as usize] as usize] = (from, to);
                next[at as usize] += 1;
            }
        }
        // Whoever leaves a corner is found by its number.
        for v in 0..vertices {
            pairs[first[v] as usize..first[v + 1] as usize].sort_unstable();
        }
        Self { first, pairs }
    }

    pub(super) fn of(&self, v: usize) -> &[(u32, u32)] {
        &self.pairs[self.first[v] as usize..self.first[v + 1] as usize]
    }

    /// Whether the triangles at `v` form one closed ring of at least three.
    pub(super) fn is_ring(&self, v: usize) -> bool {
        let pairs = self.of(v);
        if pairs.len() < 3 || pairs.windows(2).any(|p| p[0].0 == p[1].0) {
            return false;
        }
        let start = pairs[0].0;
        let mut at = start;
        for step in 1..=pairs.len() {
            let Ok(found) = pairs.binary_search_by_key(&at, |p| p.0) else {
                return false;
            };
            at = pairs[found].1;
            if at == start {
                return step == pairs.len();
            }
        }
        false
    }
}

/// The set of connected triangles that each vertex belongs to, by its lowest vertex.
fn components(triangles: &[[u32; 3]], vertices: usize) -> Vec<u32> {
    let mut parents: Vec<u32> = (0..vertices as u32).collect();
    for &[a, b, c] in triangles {
        unite(&mut parents, a, b);
        unite(&mut parents, a, c);
    }
    for v in 0..vertices as u32 {
        parents[v as usize] = root(&mut parents, v);
    }
    parents
}

/// Marks in `faulty` the vertices around which `after`, a simplification of `before`, is not sound:
///
/// - those without one closed ring of triangles, unless they are on the border (`fixed`, whose
///   triangles do not change);
/// - the corners of triangles without area;
/// - all of a component that vanished, fell apart, or has another Euler characteristic.
///
/// True when there is any. Where there is none, every component is the surface it was: its border is
/// the same, it is 2-manifold and oriented, and its Euler characteristic tells its genus.
pub(super) fn find_faults(
    positions: &[[f32; 3]],
    before: &[[u32; 3]],
    after: &[[u32; 3]],
    fixed: &[bool],
    faulty: &mut [bool],
) -> bool {
    let vertices = positions.len();
    let fans = Fans::new(after, vertices);
    let mut any = false;
    for v in 0..vertices {
        if !fixed[v] && !fans.of(v).is_empty() && !fans.is_ring(v) {
            faulty[v] = true;
            any = true;
        }
    }
    for t in after {
        if !has_area(t.map(|v| positions[v as usize])) {
            t.iter().for_each(|&v| faulty[v as usize] = true);
            any = true;
        }
    }
    if any {
        return true;
    }
    // Per component twice the vertices less the triangles, which is twice the Euler characteristic
    // less the edges of the border; and the components that it became.
    let was = components(before, vertices);
    let is = components(after, vertices);
    let mut balance = vec![(0i64, 0u32); vertices];
    let mut used = vec![false; vertices];
    for &v in before.as_flattened() {
        if !std::mem::replace(&mut used[v as usize], true) {
            balance[was[v as usize] as usize].0 += 2;
        }
    }
    for t in before {
        balance[was[t[0] as usize] as usize].0 -= 1;
    }
    for v in 0..vertices {
        if !fans.of(v).is_empty() {
            let of = &mut balance[was[v] as usize];
            of.0 -= 2;
            of.1 += u32::from(is[v] == v as u32);
        }
    }
    for t in after {
        balance[was[t[0] as usize] as usize].0 += 1;
    }
    for v in 0..vertices {
        let (off, pieces) = balance[was[v] as usize];
        if used[v] && (off != 0 || pieces != 1) {
            faulty[v] = true;
            any = true;
        }
    }
    any
}

/// Whether a triangle has an area, as `check` sees it.
pub(super) fn has_area([a, b, c]: [[f32; 3]; 3]) -> bool {
    let from_a = |p: [f32; 3], i: usize| f64::from(p[i]) - f64::from(a[i]);
    (0..3).any(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        from_a(b, j) * from_a(c, k) - from_a(b, k) * from_a(c, j) != 0.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_meshes::{cube, torus};

    fn faults(positions: &[[f32; 3]], before: &[[u32; 3]], after: &[[u32; 3]]) -> usize {
        let fans = Fans::new(before, positions.len());
        let fixed: Vec<bool> = (0..positions.len()).map(|v| !fans.is_ring(v)).collect();
        let mut faulty = vec![false; positions.len()];
        let any = find_faults(positions, before, after, &fixed, &mut faulty);
        let count = faulty.iter().filter(|f| **f).count();
        assert_eq!(any, count > 0);
        count
    }

    #[test]
    fn what_breaks_a_surface_is_found() {
        let mesh = torus(2.0, 0.7, 12, 9);
        let (p, t) = (&mesh.positions, &mesh.triangles);
        assert_eq!(faults(p, t, t), 0);
        // A triangle is missing, turned, twice.
        assert_eq!(faults(p, t, &t[1..]), 3);
        let mut turned = t.clone();
        turned[5].swap(0, 1);
        assert_eq!(faults(p, t, &turned), 3);
        let mut twice = t.clone();
        twice.push(t[7]);
        assert_eq!(faults(p, t, &twice), 3);
        // Nothing is left; another surface is left.
        assert_eq!(faults(p, t, &[]), p.len());
        let tetrahedron = [[0, 1, 14], [0, 14, 30], [0, 30, 1], [1, 30, 14]];
        assert_eq!(faults(p, t, &tetrahedron), p.len());
        // Two triangles back to back, and triangles without area.
        let solid = cube([0.0; 3], 1.0);
        let (p, t) = (&solid.positions, &solid.triangles);
        assert_eq!(faults(p, t, &[[0, 1, 2], [0, 2, 1]]), 3);
        let mut flat = p.clone();
        flat[3] = flat[1];
        assert!(faults(&flat, t, t) >= 3);
    }

    #[test]
    fn two_components_do_not_make_up_for_each_other() {
        // A sphere vanishes (-2) and a torus becomes a sphere (+2).
        let ring = torus(2.0, 0.7, 12, 9);
        let mut p = ring.positions.clone();
        let base = p.len() as u32;
        let solid = cube([9.0; 3], 1.0);
        p.extend(&solid.positions);
        let mut before = ring.triangles.clone();
        before.extend(solid.triangles.iter().map(|t| t.map(|v| v + base)));
        let after = [[0, 1, 14], [0, 14, 30], [0, 30, 1], [1, 30, 14]];
        assert_eq!(faults(&p, &before, &after), p.len());
    }
}
