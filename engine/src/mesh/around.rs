//! What stands around the vertices of a range.

use super::joined::unite;
use std::ops::Range;

/// What is counted at the vertices.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    pub(super) edges: u64,
    pub(super) border: u64,
    pub(super) crowded: u64,
    pub(super) misoriented: u64,
    pub(super) extra_fans: u64,
}

impl Counts {
    pub(super) fn add(&mut self, other: Self) {
        self.edges += other.edges;
        self.border += other.border;
        self.crowded += other.crowded;
        self.misoriented += other.misoriented;
        self.extra_fans += other.extra_fans;
    }
}

/// Bytes to examine one vertex with the given number of corners, beside the list of its range.
pub(super) fn scratch_bytes(degree: u32) -> u64 {
    u64::from(degree) * (2 * 8 + 4)
}

/// Buffers of a worker.
#[derive(Default)]
pub(super) struct Around {
    /// Where the triangles of each vertex of the range end in `triangles`.
    ends: Vec<u32>,
    /// Triangles around the vertices of the range, in order; twice where a vertex occurs twice.
    triangles: Vec<u32>,
    /// Edges at one vertex, one entry a triangle: the other end, then the corner, then whether the
    /// triangle runs along it away from the vertex.
    edges: Vec<u64>,
    /// Corners of one vertex that are in the same fan.
    fans: Vec<u32>,
}

impl Around {
    /// Looks at the vertices of `range`. `triangles` are all with one of them, and maybe others;
    /// `degrees` says for each vertex of the range how many corners are at it.
    pub(super) fn count(
        &mut self,
        triangles: &[[u32; 3]],
        degrees: &[u32],
        range: Range<usize>,
    ) -> Counts {
        self.list(triangles, degrees, range.start);
        let mut counts = Counts::default();
        let mut start = 0;
        for v in range.clone() {
            let end = self.ends[v - range.start] as usize;
            if end > start {
                self.count_at(triangles, v as u32, start..end, &mut counts);
            }
            start = end;
        }
        counts
    }

    fn list(&mut self, triangles: &[[u32; 3]], degrees: &[u32], first: usize) {
        self.ends.clear();
        let mut corners = 0;
        // Starts for now; filling moves each to its end.
        self.ends.extend(degrees.iter().map(|&d| {
            let start = corners;
            corners += d;
            start
        }));
        self.triangles.clear();
        self.triangles.resize(corners as usize, 0);
        for (t, triangle) in triangles.iter().enumerate() {
            for &v in triangle {
                let local = (v as usize).wrapping_sub(first);
                if let Some(place) = self.ends.get_mut(local) {
                    self.triangles[*place as usize] = t as u32;
                    *place += 1;
                }
            }
        }
    }

    fn count_at(
        &mut self,
        triangles: &[[u32; 3]],
        v: u32,
        list: Range<usize>,
        counts: &mut Counts,
    ) {
        let list = &self.triangles[list];
        self.edges.clear();
        for (corner, &t) in list.iter().enumerate() {
            if corner > 0 && list[corner - 1] == t {
                // A triangle that names the vertex again; its edges are listed already.
                continue;
            }
            let [a, b, c] = triangles[t as usize];
            for (from, to) in [(a, b), (b, c), (c, a)] {
                let (other, away) = if from == v {
                    (to, 1)
                } else if to == v {
                    (from, 0)
                } else {
                    continue;
                };
                self.edges
                    .push(u64::from(other) << 32 | (corner as u64) << 1 | away);
            }
        }
        self.edges.sort_unstable();
        self.fans.clear();
        self.fans.extend(0..list.len() as u32);
        let mut fans = list.len() as u64;
        for edge in self.edges.chunk_by(|a, b| a >> 32 == b >> 32) {
            // Each edge is counted at its lower end.
            if (edge[0] >> 32) as u32 >= v {
                counts.edges += 1;
                match edge {
                    [_] => counts.border += 1,
                    [a, b] => counts.misoriented += u64::from((a ^ b) & 1 == 0),
                    _ => counts.crowded += 1,
                }
            }
            if let [a, b] = edge {
                let corner = |entry: &u64| *entry as u32 >> 1;
                let (_, apart) = unite(&mut self.fans, corner(a), corner(b));
                fans -= u64::from(apart);
            }
        }
        counts.extra_fans += fans - 1;
    }
}
