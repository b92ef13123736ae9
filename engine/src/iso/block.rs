//! One block of cells: from samples to vertices and triangles.
//!
//! Rows of samples become bit masks of "inside". Crossed lattice edges are XORs of neighbouring
//! masks, active cells are ORs and ANDs of four; samples are touched again only where a bit is set.
//! The number of a vertex is a rank: the vertices of the rows before, plus the bits below it.
//! (Rows as units of work: Schroeder, Maynard and Geveci 2015, "Flying Edges".)
//!
//! Samples outside the region that is meshed are NaN, and NaN is outside: that closes the solid
//! with a cap, and nothing else in here knows of borders.

use super::ambiguity::joined_faces;
use super::cube::{OTHER, corner, edge_axis, edge_origin};
use super::place::Placement;
use super::table::{CENTRE, TABLE};
use crate::mesh::{EdgeKey, Piece};
use crate::sample::Inside;

/// Samples of a block: `size` points from lattice point `origin`, and one more on every side when
/// normals are wanted.
#[derive(Debug, Default)]
pub(super) struct BlockSamples {
    /// Lattice point of sample (0, 0, 0).
    pub(super) origin: [i32; 3],
    /// Points per axis; one more than the cells.
    pub(super) size: [usize; 3],
    /// The array.
    pub(super) values: Vec<f32>,
    /// Offset of sample (0, 0, 0).
    pub(super) first: usize,
    /// Distance of samples along each axis: 1, row, slice.
    pub(super) step: [usize; 3],
}

/// Most points of a block along x: masks are 64 bits.
pub(super) const MAX_POINTS: usize = 64;

/// Masks and numbers of one block; kept between blocks to save the allocation.
#[derive(Debug, Default)]
pub(super) struct Block {
    inside: Vec<u64>,
    /// Crossed edges per row and axis.
    crossed: Vec<[u64; 3]>,
    /// Number of the first vertex per row and axis.
    base: Vec<[u32; 3]>,
    /// Cells that the surface crosses: place and mask of the corners.
    active: Vec<([u8; 3], u8)>,
    /// Vertices on lattice edges.
    pub(super) edge_vertices: usize,
    /// Upper bound of all vertices.
    pub(super) vertices_max: usize,
    /// Upper bound of the triangles.
    pub(super) triangles_max: usize,
}

/// What a finished block tells its neighbours and the counters.
#[derive(Debug, Default)]
pub(super) struct BlockOutput {
    /// Per axis the vertices on the low face, by local number, in the order of the face.
    pub(super) low: [Vec<u32>; 3],
    /// The same for the high face.
    pub(super) high: [Vec<u32>; 3],
    /// Local number of the first vertex of this block.
    pub(super) first: u32,
    /// Vertices of this block.
    pub(super) count: u32,
    pub(super) active_cells: u64,
    pub(super) ambiguous_faces: u64,
    pub(super) interior_vertices: u64,
}

/// How a block is meshed; the same for all blocks of a run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Style {
    pub(super) iso: f32,
    pub(super) inside: Inside,
    pub(super) placement: Placement,
    pub(super) normals: bool,
    pub(super) keys: bool,
}

impl BlockOutput {
    /// Empties the lists and zeroes the counters.
    pub(super) fn reset(&mut self) {
        self.low
            .iter_mut()
            .chain(&mut self.high)
            .for_each(Vec::clear);
        (
            self.active_cells,
            self.ambiguous_faces,
            self.interior_vertices,
        ) = (0, 0, 0);
    }
}

#[inline(always)]
const fn below(x: u32) -> u64 {
    (1 << x) - 1
}

impl Block {
    /// Finds the crossed edges and active cells. False when there are none.
    pub(super) fn scan(&mut self, samples: &BlockSamples, style: &Style) -> bool {
        let [nx, ny, nz] = samples.size;
        assert!(nx < MAX_POINTS, "a row of a block fits in a mask");
        self.sign_masks(samples, style);
        let rows = ny * nz;
        let all = below(nx as u32);
        if self.inside.iter().all(|&m| m == 0) || self.inside.iter().all(|&m| m == all) {
            return false;
        }
        self.crossed.clear();
        self.crossed.resize(rows, [0; 3]);
        self.base.clear();
        self.base.resize(rows, [0; 3]);
        let mut count = 0;
        for z in 0..nz {
            for y in 0..ny {
                let r = y + ny * z;
                let m = self.inside[r];
                let x_edges = (m ^ m >> 1) & below(nx as u32 - 1);
                let y_edges = if y + 1 < ny {
                    m ^ self.inside[r + 1]
                } else {
                    0
                };
                let z_edges = if z + 1 < nz {
                    m ^ self.inside[r + ny]
                } else {
                    0
                };
                self.crossed[r] = [x_edges, y_edges, z_edges];
                for axis in 0..3 {
                    self.base[r][axis] = count;
                    count += self.crossed[r][axis].count_ones();
                }
            }
        }
        self.edge_vertices = count as usize;
        self.find_active_cells(samples.size);
        self.edge_vertices > 0
    }

    fn sign_masks(&mut self, samples: &BlockSamples, style: &Style) {
        let [nx, ny, nz] = samples.size;
        self.inside.clear();
        for z in 0..nz {
            for y in 0..ny {
                let start = samples.first + y * samples.step[1] + z * samples.step[2];
                let row = &samples.values[start..start + nx];
                let mask = match style.inside {
                    Inside::Above => row_mask(row, |v| Inside::Above.contains(v, style.iso)),
                    Inside::Below => row_mask(row, |v| Inside::Below.contains(v, style.iso)),
                };
                self.inside.push(mask);
            }
        }
    }

    fn find_active_cells(&mut self, size: [usize; 3]) {
        let [nx, ny, nz] = size;
        let table = &*TABLE;
        self.active.clear();
        let (mut triangles, mut centres) = (0, 0);
        for z in 0..nz - 1 {
            for y in 0..ny - 1 {
                let r = y + ny * z;
                let m = [
                    self.inside[r],
                    self.inside[r + 1],
                    self.inside[r + ny],
                    self.inside[r + ny + 1],
                ];
                let any = m[0] | m[1] | m[2] | m[3];
                let every = m[0] & m[1] & m[2] & m[3];
                let mut cells = (any | any >> 1) & !(every & every >> 1) & below(nx as u32 - 1);
                while cells != 0 {
                    let x = cells.trailing_zeros();
                    cells &= cells - 1;
                    let pair = |i: usize| ((m[i] >> x & 3) as u8) << (2 * i);
                    let mask = pair(0) | pair(1) | pair(2) | pair(3);
                    let (t, c) = table.most[mask as usize];
                    triangles += usize::from(t);
                    centres += usize::from(c);
                    self.active.push(([x as u8, y as u8, z as u8], mask));
                }
            }
        }
        self.triangles_max = triangles;
        self.vertices_max = self.edge_vertices + centres;
    }

    /// Local number of the vertex on the edge along `axis` from point (x, y, z).
    #[inline(always)]
    fn vertex(&self, axis: usize, x: u32, row: usize) -> u32 {
        self.base[row][axis] + (self.crossed[row][axis] & below(x)).count_ones()
    }

    /// Appends vertices and triangles to `piece`. `borrowed[a]` says that the low face of axis `a`
    /// belongs to an earlier block.
    pub(super) fn emit(
        &self,
        samples: &BlockSamples,
        style: &Style,
        borrowed: [bool; 3],
        piece: &mut Piece,
        out: &mut BlockOutput,
    ) {
        out.first = piece.positions.len() as u32;
        self.emit_vertices(samples, style, borrowed, piece);
        self.emit_triangles(samples, style, piece, out);
        out.count = piece.positions.len() as u32 - out.first;
        out.active_cells = self.active.len() as u64;
        for axis in 0..3 {
            self.face(samples.size, axis, 0, out.first, &mut out.low[axis]);
            self.face(
                samples.size,
                axis,
                samples.size[axis] - 1,
                out.first,
                &mut out.high[axis],
            );
            if !borrowed[axis] {
                out.low[axis].clear();
            }
        }
    }

    fn emit_vertices(
        &self,
        samples: &BlockSamples,
        style: &Style,
        borrowed: [bool; 3],
        piece: &mut Piece,
    ) {
        let ny = samples.size[1];
        for (r, rows) in self.crossed.iter().enumerate() {
            let (y, z) = (r % ny, r / ny);
            let start = samples.first + y * samples.step[1] + z * samples.step[2];
            for (axis, &row) in rows.iter().enumerate() {
                let mut edges = row;
                while edges != 0 {
                    let x = edges.trailing_zeros() as usize;
                    edges &= edges - 1;
                    let at = [x, y, z];
                    let point: [i32; 3] = std::array::from_fn(|a| samples.origin[a] + at[a] as i32);
                    let low = start + x;
                    let (a, b) = (
                        samples.values[low],
                        samples.values[low + samples.step[axis]],
                    );
                    let t = style.placement.along(a, b, style.iso);
                    let local = piece.positions.len() as u32;
                    if !OTHER[axis].iter().any(|&o| borrowed[o] && at[o] == 0) {
                        piece.own.push(local);
                    }
                    piece
                        .positions
                        .push(style.placement.on_edge(point, axis, t));
                    if style.normals {
                        piece.normals.push(style.placement.edge_normal(
                            samples,
                            low,
                            axis,
                            t,
                            style.inside,
                        ));
                    }
                    if style.keys {
                        piece.keys.push(EdgeKey {
                            point,
                            axis: axis as u8,
                        });
                    }
                }
            }
        }
    }

    fn emit_triangles(
        &self,
        samples: &BlockSamples,
        style: &Style,
        piece: &mut Piece,
        out: &mut BlockOutput,
    ) {
        let table = &*TABLE;
        let ny = samples.size[1];
        let first = out.first;
        for &([x, y, z], mask) in &self.active {
            let row = usize::from(y) + ny * usize::from(z);
            let faces = table.ambiguous[mask as usize];
            let joined = if faces == 0 {
                0
            } else {
                out.ambiguous_faces += u64::from(faces.count_ones());
                let values = corner_values(samples, [x, y, z]);
                joined_faces(&values, faces, style.iso, style.inside)
            };
            let entry = table.entry(mask, joined);
            let x = u32::from(x);
            let mut ids = [0u32; 16];
            for (e, id) in ids[..12].iter_mut().enumerate() {
                let [dx, dy, dz] = edge_origin(e);
                *id = first + self.vertex(edge_axis(e), x + dx as u32, row + dy + ny * dz);
            }
            for (k, ring) in entry.centres.iter().enumerate() {
                let ring = ring.iter().map(|&e| ids[usize::from(e)]);
                ids[usize::from(CENTRE) + k] = push_centre(
                    samples.origin,
                    [x, y.into(), z.into()],
                    k,
                    ring,
                    style,
                    piece,
                );
                out.interior_vertices += 1;
            }
            for t in &entry.triangles {
                let t = t.map(|v| ids[usize::from(v)]);
                piece.triangles.push(if style.placement.mirrored {
                    [t[0], t[2], t[1]]
                } else {
                    t
                });
            }
        }
    }

    /// Vertices on the plane `at` of `axis`, in an order that both blocks of the plane agree on.
    fn face(&self, size: [usize; 3], axis: usize, at: usize, first: u32, out: &mut Vec<u32>) {
        out.clear();
        let [_, ny, nz] = size;
        let (ys, zs) = match axis {
            0 => (0..ny, 0..nz),
            1 => (at..at + 1, 0..nz),
            _ => (0..ny, at..at + 1),
        };
        let bits = if axis == 0 { 1 << at } else { u64::MAX };
        for z in zs {
            for y in ys.clone() {
                let row = y + ny * z;
                for along in OTHER[axis] {
                    let mut edges = self.crossed[row][along] & bits;
                    while edges != 0 {
                        let x = edges.trailing_zeros();
                        edges &= edges - 1;
                        out.push(first + self.vertex(along, x, row));
                    }
                }
            }
        }
    }
}

/// Mask of a row, in runs of eight so that the compiler can keep a run in one register.
#[inline(always)]
fn row_mask(row: &[f32], inside: impl Fn(f32) -> bool) -> u64 {
    let mut mask = 0;
    let (runs, rest) = row.as_chunks::<8>();
    for (i, run) in runs.iter().enumerate() {
        let mut bits = 0u64;
        for (k, &v) in run.iter().enumerate() {
            bits |= u64::from(inside(v)) << k;
        }
        mask |= bits << (8 * i);
    }
    for (k, &v) in rest.iter().enumerate() {
        mask |= u64::from(inside(v)) << (8 * runs.len() + k);
    }
    mask
}

fn corner_values(samples: &BlockSamples, cell: [u8; 3]) -> [f32; 8] {
    std::array::from_fn(|c| {
        let p = corner(c);
        let at = (0..3)
            .map(|a| (usize::from(cell[a]) + p[a]) * samples.step[a])
            .sum::<usize>();
        samples.values[samples.first + at]
    })
}

/// A vertex inside a cell, in the middle of its loop.
fn push_centre(
    origin: [i32; 3],
    cell: [u32; 3],
    loop_number: usize,
    ring: impl Iterator<Item = u32>,
    style: &Style,
    piece: &mut Piece,
) -> u32 {
    let (mut position, mut normal, mut n) = ([0f64; 3], [0f32; 3], 0f64);
    for v in ring {
        let p = piece.positions[v as usize];
        (0..3).for_each(|a| position[a] += f64::from(p[a]));
        if style.normals {
            let q = piece.normals[v as usize];
            (0..3).for_each(|a| normal[a] += q[a]);
        }
        n += 1.0;
    }
    let local = piece.positions.len() as u32;
    piece.own.push(local);
    piece.positions.push(position.map(|v| (v / n) as f32));
    if style.normals {
        piece
            .normals
            .push(super::place::unit(normal.map(f64::from)).unwrap_or([0.0, 0.0, 1.0]));
    }
    if style.keys {
        let point = std::array::from_fn(|a| origin[a] + cell[a] as i32);
        piece.keys.push(EdgeKey {
            point,
            axis: 3 + loop_number as u8,
        });
    }
    local
}
