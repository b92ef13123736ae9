//! What a mesh of the sampled scene must have: counts of crossed edges, faces and cells, Euler
//! characteristics and components, found without any mesh.
//!
//! The samples are read once, row by row; two slices of bits are kept.
//!
//! # When a mesh must have exactly these numbers
//! - *Always*: every crossed lattice edge carries one vertex. So a mesh has
//!   [`Counts::crossed_edges`] vertices on lattice edges; vertices inside cells come on top.
//!   A capped mesh is that of the lattice with one more layer of samples outside: of
//!   [`Topology::capped`].
//! - When [`Topology::is_unambiguous`]: in each cell the inside corners are connected along edges of
//!   the cell, and so are the outside corners. Then there is one sheet per active cell, whatever
//!   table or decider is used, with one side per mixed face. So the mesh has the Euler
//!   characteristic [`Counts::mesh_euler`], the components [`Topology::mesh_components`], and,
//!   where polygons are cut into triangles without further vertices, [`Counts::triangles`]. The
//!   solid is then also that of 6-connected voxels: `mesh_euler` of the capped lattice is twice
//!   [`Counts::solid_euler`], an identity that holds two independent counts against each other.

use crate::fields::{Scene, Side};
use crate::runs::Components;
use serde::Serialize;

/// Counts over a lattice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Lattice edges with one end inside: vertices of the mesh.
    pub crossed_edges: u64,
    /// Unit squares with corners on both sides.
    pub mixed_faces: u64,
    /// Those of them that lie in the border of the lattice.
    pub mixed_border_faces: u64,
    /// Unit squares whose diagonals differ: inside, outside, inside, outside.
    pub ambiguous_faces: u64,
    /// Cells with corners on both sides.
    pub active_cells: u64,
    /// Cells with two opposite corners on one side and the six others on the other side.
    pub diagonal_cells: u64,
    /// Points inside.
    pub inside_points: u64,
    /// Edges with both ends inside.
    pub inside_edges: u64,
    /// Unit squares with four corners inside.
    pub inside_faces: u64,
    /// Cells with eight corners inside.
    pub inside_cells: u64,
}

impl Counts {
    /// Euler characteristic of the mesh, when the topology is unambiguous.
    pub fn mesh_euler(&self) -> i64 {
        self.crossed_edges as i64 - self.mixed_faces as i64 + self.active_cells as i64
    }

    /// Euler characteristic of the solid made of the points inside and the edges, squares and
    /// cells between them: 6-connected voxels.
    pub fn solid_euler(&self) -> i64 {
        self.inside_points as i64 - self.inside_edges as i64 + self.inside_faces as i64
            - self.inside_cells as i64
    }

    /// Triangles of the mesh, when the topology is unambiguous and no vertex lies inside a cell.
    pub fn triangles(&self) -> u64 {
        2 * self.mixed_faces - self.mixed_border_faces - 2 * self.active_cells
    }
}

/// Counts and components of a sampled scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Topology {
    /// Of the lattice as it is: a mesh that is cut at the border.
    pub cut: Counts,
    /// Of the lattice with one more layer of outside points: a mesh that is capped.
    pub capped: Counts,
    /// 6-connected pieces of the inside.
    pub inside_components: u64,
    /// 6-connected pieces of the outside.
    pub outside_components: u64,
    /// The same with the layer around, which joins all that reach the border.
    pub outside_components_capped: u64,
}

impl Topology {
    /// Whether every way to resolve a cell agrees, so that the mesh must have this topology.
    pub fn is_unambiguous(&self) -> bool {
        // The layer around adds cells and faces of its own, which have to agree as well.
        self.capped.ambiguous_faces == 0 && self.capped.diagonal_cells == 0
    }

    /// Connected pieces of the cut mesh and of the capped mesh, when unambiguous: in a box every
    /// piece of surface separates, so pieces are one fewer than the regions they separate.
    pub fn mesh_components(&self) -> (u64, u64) {
        let pieces = |outside: u64| (self.inside_components + outside).saturating_sub(1);
        (
            pieces(self.outside_components),
            pieces(self.outside_components_capped),
        )
    }

    /// Handles of all pieces of the capped mesh together, when unambiguous.
    pub fn genus(&self) -> i64 {
        self.mesh_components().1 as i64 - self.capped.mesh_euler() / 2
    }
}

/// Counts of a scene at an isovalue.
///
/// # Memory
/// About `size[0] * size[1]` bits times eight, and 24 bytes per run of equal side in two slices.
pub fn lattice_euler(scene: &Scene, iso: f32, inside: Side) -> Topology {
    let mut row = vec![0f32; scene.size()[0] as usize];
    count_bits(scene.size(), |j, k, bits| {
        scene.fill_row(j, k, 0, &mut row);
        pack(&row, bits, |v| inside.contains(v, iso));
    })
}

/// Counts of any samples in lattice order, `i` fastest.
///
/// # Panics
/// When the number of samples is not that of `size`.
pub fn lattice_euler_of(samples: &[f32], size: [u32; 3], iso: f32, inside: Side) -> Topology {
    let [nx, ny, nz] = size.map(|s| s as usize);
    assert_eq!(samples.len(), nx * ny * nz, "samples of a {size:?} lattice");
    count_bits(size, |j, k, bits| {
        let start = (j as usize + ny * k as usize) * nx;
        pack(&samples[start..start + nx], bits, |v| {
            inside.contains(v, iso)
        });
    })
}

fn pack(row: &[f32], bits: &mut [u64], is_inside: impl Fn(f32) -> bool) {
    for (word, values) in bits.iter_mut().zip(row.chunks(64)) {
        *word = values
            .iter()
            .enumerate()
            .fold(0, |w, (b, &v)| w | u64::from(is_inside(v)) << b);
    }
}

/// `fill(j, k, bits)` writes one row of the inside, lowest bit first.
fn count_bits(size: [u32; 3], mut fill: impl FnMut(u32, u32, &mut [u64])) -> Topology {
    let padded = size.map(|s| s + 2);
    let mut cut = Slices::new(size);
    let mut capped = Slices::new(padded);
    let mut components = Components::new(size);
    let mut slice = vec![0u64; cut.words * size[1] as usize];
    let empty = vec![0u64; capped.words * padded[1] as usize];
    let mut wide = empty.clone();
    capped.push(&empty);
    for k in 0..size[2] {
        for (j, bits) in slice.chunks_mut(cut.words).enumerate() {
            fill(j as u32, k, bits);
        }
        cut.push(&slice);
        components.push(&slice, cut.words);
        for (j, bits) in slice.chunks(cut.words).enumerate() {
            let start = (j + 1) * capped.words;
            shift_in(bits, &mut wide[start..start + capped.words]);
        }
        capped.push(&wide);
    }
    capped.push(&empty);
    let found = components.finish();
    Topology {
        cut: cut.finish(),
        capped: capped.finish(),
        inside_components: found.inside,
        outside_components: found.outside,
        outside_components_capped: found.outside_inner + 1,
    }
}

/// Copies a row one place to the right.
fn shift_in(bits: &[u64], wide: &mut [u64]) {
    let mut carry = 0;
    for (n, word) in wide.iter_mut().enumerate() {
        let bits = bits.get(n).copied().unwrap_or(0);
        *word = bits << 1 | carry;
        carry = bits >> 63;
    }
}

/// Counts slice by slice.
struct Slices {
    size: [u32; 3],
    words: usize,
    /// Bits of a row that have a point, and a next point along x.
    points: Vec<u64>,
    pairs: Vec<u64>,
    before: Vec<u64>,
    slices: u32,
    counts: Counts,
}

/// Four corners of 64 squares, in cyclic order.
type Corners = [u64; 4];

impl Slices {
    fn new(size: [u32; 3]) -> Self {
        let words = size[0].div_ceil(64) as usize;
        let mask = |count: u32| {
            (0..words as u32)
                .map(|w| match count.saturating_sub(w * 64) {
                    0 => 0,
                    left if left >= 64 => u64::MAX,
                    left => (1 << left) - 1,
                })
                .collect()
        };
        Self {
            size,
            words,
            points: mask(size[0]),
            pairs: mask(size[0] - 1),
            before: Vec::new(),
            slices: 0,
            counts: Counts::default(),
        }
    }

    fn push(&mut self, slice: &[u64]) {
        let rows = self.size[1] as usize;
        let end_slice = self.slices == 0 || self.slices + 1 == self.size[2];
        for j in 0..rows {
            self.in_slice(slice, j, end_slice);
            if self.slices > 0 {
                self.between_slices(slice, j);
            }
        }
        self.before.clear();
        self.before.extend_from_slice(slice);
        self.slices += 1;
    }

    fn finish(self) -> Counts {
        assert_eq!(self.slices, self.size[2], "every slice was pushed");
        self.counts
    }

    /// Points, edges and squares of row `j` in its slice.
    fn in_slice(&mut self, slice: &[u64], j: usize, end_slice: bool) {
        let here = &slice[j * self.words..][..self.words];
        let next = slice.get((j + 1) * self.words..(j + 2) * self.words);
        for w in 0..self.words {
            let a = here[w];
            let b = shifted(here, w);
            self.counts.inside_points += ones(a);
            self.edge(a, b, self.pairs[w]);
            if let Some(next) = next {
                let (d, c) = (next[w], shifted(next, w));
                self.edge(a, d, self.points[w]);
                let mixed = self.face([a, b, c, d], self.pairs[w]);
                if end_slice {
                    self.counts.mixed_border_faces += ones(mixed);
                }
            }
        }
    }

    /// Edges, squares and cells between row `j` of the last slice and of this one.
    fn between_slices(&mut self, slice: &[u64], j: usize) {
        let words = self.words;
        let last = self.size[1] as usize - 1;
        for w in 0..words {
            let row = |bits: &[u64], j: usize| {
                let row = &bits[j * words..][..words];
                (row[w], shifted(row, w))
            };
            let (a, ax) = row(&self.before, j);
            let (b, bx) = row(slice, j);
            let (points, pairs) = (self.points[w], self.pairs[w]);
            let next = (j < last).then(|| (row(&self.before, j + 1), row(slice, j + 1)));
            self.edge(a, b, points);
            let mixed = self.face([a, ax, bx, b], pairs);
            if j == 0 || j == last {
                self.counts.mixed_border_faces += ones(mixed);
            }
            if let Some(((c, cx), (d, dx))) = next {
                let mixed = self.face([a, c, d, b], points);
                let end = (self.size[0] - 1) as usize;
                let first = if w == 0 { mixed & 1 } else { 0 };
                let final_bit = if w == end / 64 {
                    mixed >> (end % 64) & 1
                } else {
                    0
                };
                self.counts.mixed_border_faces += first + final_bit;
                self.cell([[a, ax], [c, cx], [b, bx], [d, dx]], pairs);
            }
        }
    }

    fn edge(&mut self, a: u64, b: u64, valid: u64) {
        self.counts.crossed_edges += ones((a ^ b) & valid);
        self.counts.inside_edges += ones(a & b & valid);
    }

    /// Counts 64 squares and returns those with corners on both sides.
    fn face(&mut self, [a, b, c, d]: Corners, valid: u64) -> u64 {
        let all = a & b & c & d & valid;
        let mixed = (a | b | c | d) & valid & !all;
        self.counts.inside_faces += ones(all);
        if mixed != 0 {
            self.counts.mixed_faces += ones(mixed);
            self.counts.ambiguous_faces += ones(!(a ^ c) & !(b ^ d) & (a ^ b) & valid);
        }
        mixed
    }

    /// Counts 64 cells given by four rows along x, each with its shifted self; rows 0 and 3, and
    /// rows 1 and 2, lie diagonally across.
    fn cell(&mut self, rows: [[u64; 2]; 4], valid: u64) {
        let and = |v: [u64; 2]| v[0] & v[1];
        let or = |v: [u64; 2]| v[0] | v[1];
        let all = rows.map(and).into_iter().fold(valid, |x, y| x & y);
        let mixed = rows.map(or).into_iter().fold(0, |x, y| x | y) & valid & !all;
        self.counts.inside_cells += ones(all);
        if mixed == 0 {
            return;
        }
        self.counts.active_cells += ones(mixed);
        for (row, across) in [(0, 3), (1, 2), (2, 1), (3, 0)] {
            // The diagonal from the low end of `row` to the high end of `across`.
            let mut both = u64::MAX;
            let mut neither = u64::MAX;
            for (n, &[low, high]) in rows.iter().enumerate() {
                let low_in = if n == row { low } else { !low };
                let high_in = if n == across { high } else { !high };
                both &= low_in & high_in;
                neither &= !low_in & !high_in;
            }
            self.counts.diagonal_cells += ones((both | neither) & valid);
        }
    }
}

/// Row word `w` moved one place down, with the first bit of the next word.
#[inline]
fn shifted(row: &[u64], w: usize) -> u64 {
    row[w] >> 1 | row.get(w + 1).copied().unwrap_or(0) << 63
}

#[inline]
fn ones(bits: u64) -> u64 {
    u64::from(bits.count_ones())
}
