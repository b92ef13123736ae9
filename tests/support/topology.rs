//! An independent judgement of a triangle mesh: closed, 2-manifold, oriented, not degenerate, and
//! its numbers. Written without the engine's own checker, which is tested against it.

use std::collections::HashMap;

/// Union-find over numbers.
#[derive(Debug)]
pub(crate) struct Sets(Vec<u32>);

impl Sets {
    pub(crate) fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }

    pub(crate) fn root(&mut self, mut v: u32) -> u32 {
        while self.0[v as usize] != v {
            self.0[v as usize] = self.0[self.0[v as usize] as usize];
            v = self.0[v as usize];
        }
        v
    }

    pub(crate) fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a as usize] = b;
    }

    pub(crate) fn count(&mut self) -> usize {
        (0..self.0.len() as u32)
            .filter(|&v| self.root(v) == v)
            .count()
    }
}

/// What there is to know.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Verdict {
    pub(crate) vertices: u64,
    pub(crate) triangles: u64,
    pub(crate) border_edges: u64,
    pub(crate) nonmanifold_edges: u64,
    /// Edges of two triangles that run the same way in both.
    pub(crate) misoriented_edges: u64,
    /// Fans beyond one at each vertex.
    pub(crate) nonmanifold_vertices: u64,
    /// Triangles with a repeated corner or without area.
    pub(crate) degenerate: u64,
    pub(crate) unused_vertices: u64,
    pub(crate) components: u64,
    pub(crate) euler: i64,
    pub(crate) area: f64,
    /// Positive when triangles wind counter-clockwise seen from outside.
    pub(crate) volume: f64,
}

impl Verdict {
    /// Nothing wrong except, perhaps, an open border.
    pub(crate) fn is_manifold(&self) -> bool {
        self.nonmanifold_edges
            + self.misoriented_edges
            + self.nonmanifold_vertices
            + self.degenerate
            + self.unused_vertices
            == 0
    }

    pub(crate) fn is_closed(&self) -> bool {
        self.border_edges == 0
    }
}

/// Judges a mesh as it is indexed.
pub(crate) fn judge(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Verdict {
    // Per undirected edge: triangles that run it upwards and downwards.
    let mut edges: HashMap<(u32, u32), [u64; 2]> = HashMap::new();
    let mut used = vec![false; positions.len()];
    let mut sets = Sets::new(positions.len());
    let mut verdict = Verdict {
        vertices: positions.len() as u64,
        triangles: triangles.len() as u64,
        ..Verdict::default()
    };
    for &[a, b, c] in triangles {
        for (p, q) in [(a, b), (b, c), (c, a)] {
            used[p as usize] = true;
            sets.join(p, q);
            edges.entry((p.min(q), p.max(q))).or_default()[usize::from(p > q)] += 1;
        }
        let [pa, pb, pc] = [a, b, c].map(|v| positions[v as usize].map(f64::from));
        let cross = cross(sub(pb, pa), sub(pc, pa));
        verdict.degenerate += u64::from(a == b || b == c || c == a || cross == [0.0; 3]);
        verdict.area += 0.5 * dot(cross, cross).sqrt();
        verdict.volume += dot(pa, cross) / 6.0;
    }
    for &[up, down] in edges.values() {
        verdict.border_edges += u64::from(up + down == 1);
        verdict.nonmanifold_edges += u64::from(up + down > 2);
        verdict.misoriented_edges += u64::from(up + down == 2 && up != down);
    }
    verdict.unused_vertices = used.iter().filter(|&&u| !u).count() as u64;
    verdict.components = sets.count() as u64 - verdict.unused_vertices;
    verdict.euler = (verdict.vertices - verdict.unused_vertices) as i64 - edges.len() as i64
        + triangles.len() as i64;
    verdict.nonmanifold_vertices = extra_fans(triangles, &edges);
    verdict
}

/// Fans beyond one at each vertex; triangles belong to one fan when an edge of exactly two
/// triangles joins them.
fn extra_fans(triangles: &[[u32; 3]], edges: &HashMap<(u32, u32), [u64; 2]>) -> u64 {
    // Corners of triangles by vertex: (vertex, corner), where corner 3 t + i is vertex i of t.
    let mut corners: Vec<(u32, u32)> = (0..)
        .zip(triangles.iter().flatten())
        .map(|(c, &v)| (v, c))
        .collect();
    corners.sort_unstable();
    let mut extra = 0;
    for around in corners.chunk_by(|a, b| a.0 == b.0) {
        let mut fans = Sets::new(around.len());
        for (i, &(v, a)) in (0..).zip(around) {
            for (j, &(_, b)) in (0..i).zip(around) {
                let ends = |c: u32| {
                    triangles[c as usize / 3]
                        .into_iter()
                        .filter(move |&w| w != v)
                };
                let shared = ends(a).find(|w| ends(b).any(|o| o == *w && counts_two(edges, v, o)));
                if a / 3 != b / 3 && shared.is_some() {
                    fans.join(i, j);
                }
            }
        }
        extra += fans.count() as u64 - 1;
    }
    extra
}

fn counts_two(edges: &HashMap<(u32, u32), [u64; 2]>, a: u32, b: u32) -> bool {
    edges
        .get(&(a.min(b), a.max(b)))
        .is_some_and(|[up, down]| up + down == 2)
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    const TETRA: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    const CORNERS: [[f32; 3]; 4] = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    #[test]
    fn a_tetrahedron_is_good_and_its_wrecks_are_not() {
        let good = judge(&CORNERS, &TETRA);
        assert!(good.is_manifold() && good.is_closed());
        assert_eq!((good.components, good.euler), (1, 2));
        assert!((good.volume - 1.0 / 6.0).abs() < 1e-12);

        let open = judge(&CORNERS, &TETRA[..3]);
        assert_eq!((open.border_edges, open.euler), (3, 1));

        let mut turned = TETRA;
        turned[0].swap(0, 1);
        assert_eq!(judge(&CORNERS, &turned).misoriented_edges, 3);

        // Two tetrahedra that share vertex 0 only.
        let mut positions = CORNERS.to_vec();
        positions.extend(CORNERS[1..].iter().map(|p| p.map(|v| -v)));
        let mut pair = TETRA.to_vec();
        pair.extend(TETRA.map(|t| t.map(|v| if v == 0 { 0 } else { v + 3 })));
        let pinched = judge(&positions, &pair);
        assert_eq!(
            (pinched.nonmanifold_vertices, pinched.nonmanifold_edges),
            (1, 0)
        );

        let mut flat = CORNERS;
        flat[3] = [0.5, 0.0, 0.0];
        assert_eq!(judge(&flat, &TETRA).degenerate, 1);
    }
}
