//! One block of cells: from samples to vertices and triangles.
//!
//! Rows of samples become bit masks of "inside". Crossed lattice edges are XORs of neighbouring
//! masks, active cells are ORs and ANDs of four; samples are touched again only where a bit is set.
//! The number of a vertex is a rank: the vertices of the rows before, plus the bits below it.
//! (Rows as units of work: Schroeder, Maynard and Geveci 2015, "Flying Edges".)
//!
//! Samples outside the region that is meshed are NaN, and NaN is outside: that closes the solid
//! with a cap, and nothing else in here knows of borders.

use super::ambiguity::offsets;
use super::cube::{OTHER, corner};
use super::dispatch::Level;
use super::inner::Cell;
use super::interior::decide;
use super::place::Placement;
use super::table::TABLE;
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
    /// Rows of cells that the surface crosses: y, z, and a bit per cell.
    active: Vec<(u8, u8, u64)>,
    /// Numbers in the table of the active cells whose mask does not tell the case, in order.
    decided: Vec<u16>,
    /// Vertices on lattice edges.
    pub(super) edge_vertices: usize,
    /// All vertices.
    pub(super) vertices_max: usize,
    /// All triangles.
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
    /// Instructions to use.
    pub(super) level: Level,
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
        style.level.scan(self, samples, style)
    }

    /// [`scan`](Self::scan), given what turns a row of samples to a mask.
    #[inline(always)]
    pub(super) fn scan_with(
        &mut self,
        samples: &BlockSamples,
        style: &Style,
        row_mask: impl Fn(&[f32], f32, Inside) -> u64,
    ) -> bool {
        let [nx, ny, nz] = samples.size;
        assert!(nx < MAX_POINTS, "a row of a block fits in a mask");
        self.inside.clear();
        for z in 0..nz {
            for y in 0..ny {
                let start = samples.first + y * samples.step[1] + z * samples.step[2];
                self.inside.push(row_mask(
                    &samples.values[start..start + nx],
                    style.iso,
                    style.inside,
                ));
            }
        }
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
        self.find_active_cells(samples, style);
        self.edge_vertices > 0
    }

    #[inline(always)]
    fn find_active_cells(&mut self, samples: &BlockSamples, style: &Style) {
        let [nx, ny, nz] = samples.size;
        let table = &*TABLE;
        self.active.clear();
        self.decided.clear();
        let (mut triangles, mut interior) = (0, 0);
        for z in 0..nz - 1 {
            for y in 0..ny - 1 {
                let m = self.four_rows(y + ny * z, ny);
                let any = m[0] | m[1] | m[2] | m[3];
                let every = m[0] & m[1] & m[2] & m[3];
                let mut cells = (any | any >> 1) & !(every & every >> 1) & below(nx as u32 - 1);
                if cells == 0 {
                    continue;
                }
                self.active.push((y as u8, z as u8, cells));
                while cells != 0 {
                    let x = cells.trailing_zeros();
                    cells &= cells - 1;
                    let mask = cell_mask(&m, x);
                    triangles += usize::from(table.plain_triangles[mask]);
                    if table.undecided[mask] != 0 {
                        let values = corner_values(samples, [x as usize, y, z]);
                        let number = decide(&values, mask as u8, style.iso, style.inside);
                        let (t, v) = table.size(number);
                        triangles += t;
                        interior += v;
                        self.decided.push(number);
                    }
                }
            }
        }
        self.triangles_max = triangles;
        self.vertices_max = self.edge_vertices + interior;
    }

    /// Inside masks of the four rows of points around a row of cells.
    #[inline(always)]
    fn four_rows(&self, row: usize, ny: usize) -> [u64; 4] {
        [
            self.inside[row],
            self.inside[row + 1],
            self.inside[row + ny],
            self.inside[row + ny + 1],
        ]
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
        style.level.emit(self, samples, style, borrowed, piece, out);
    }

    /// [`emit`](Self::emit), to be compiled for several processors.
    #[inline(always)]
    pub(super) fn emit_all(
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
        out.active_cells = self
            .active
            .iter()
            .map(|row| u64::from(row.2.count_ones()))
            .sum();
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

    #[inline(always)]
    fn emit_vertices(
        &self,
        samples: &BlockSamples,
        style: &Style,
        borrowed: [bool; 3],
        piece: &mut Piece,
    ) {
        let ny = samples.size[1];
        let first = piece.positions.len();
        let last = first + self.edge_vertices;
        piece.positions.resize(last, [0.0; 3]);
        piece
            .normals
            .resize(if style.normals { last } else { 0 }, [0.0; 3]);
        piece.keys.resize(
            if style.keys { last } else { 0 },
            EdgeKey {
                point: [0; 3],
                axis: 0,
            },
        );
        let mut local = first;
        for (r, rows) in self.crossed.iter().enumerate() {
            if rows[0] | rows[1] | rows[2] == 0 {
                continue;
            }
            let (y, z) = (r % ny, r / ny);
            let start = samples.first + y * samples.step[1] + z * samples.step[2];
            let [i, j, k] = samples.origin;
            let point = [i, j + y as i32, k + z as i32];
            let world = style.placement.row(point[1], point[2]);
            for (axis, &row) in rows.iter().enumerate() {
                let begin = local;
                let mut edges = row;
                while edges != 0 {
                    let x = edges.trailing_zeros() as usize;
                    edges &= edges - 1;
                    let point = [point[0] + x as i32, point[1], point[2]];
                    let low = start + x;
                    let (a, b) = (
                        samples.values[low],
                        samples.values[low + samples.step[axis]],
                    );
                    let t = style.placement.along(a, b, style.iso);
                    piece.positions[local] = style.placement.on_edge(world, point[0], axis, t);
                    if style.normals {
                        piece.normals[local] =
                            style
                                .placement
                                .edge_normal(samples, low, axis, t, style.inside);
                    }
                    if style.keys {
                        piece.keys[local] = EdgeKey {
                            point,
                            axis: axis as u8,
                        };
                    }
                    local += 1;
                }
                // Edges in a borrowed face have a number already.
                let whole_row =
                    (axis != 1 && borrowed[1] && y == 0) || (axis != 2 && borrowed[2] && z == 0);
                let first_bit = axis != 0 && borrowed[0] && row & 1 == 1;
                if !whole_row {
                    piece
                        .own
                        .extend((begin + usize::from(first_bit)) as u32..local as u32);
                }
            }
        }
    }

    #[inline(always)]
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
        let before = piece.triangles.len();
        piece.triangles.resize(before + self.triangles_max, [0; 3]);
        let mut written = before;
        let mut decided = self.decided.iter();
        for &(y, z, mut cells) in &self.active {
            let row = usize::from(y) + ny * usize::from(z);
            let inside = self.four_rows(row, ny);
            let numbers = RowNumbers::new(self, row, ny, first);
            while cells != 0 {
                let x = cells.trailing_zeros();
                cells &= cells - 1;
                let mask = cell_mask(&inside, x);
                let ids = numbers.of_cell(x);
                let entry = if table.undecided[mask] == 0 {
                    table.plain(mask)
                } else {
                    out.ambiguous_faces += u64::from(table.ambiguous[mask].count_ones());
                    let number = *decided.next().expect("scanned");
                    match table.case(number) {
                        Ok(entry) if entry.centre().is_empty() => entry,
                        _ => {
                            let cell = [x as usize, y.into(), z.into()];
                            let from = piece.positions.len();
                            written =
                                emit_inner(samples, style, cell, number, &ids, piece, written);
                            out.interior_vertices += (piece.positions.len() - from) as u64;
                            continue;
                        }
                    }
                };
                for t in entry.triangles() {
                    let id = |k: usize| ids[usize::from(t[k] & 15)];
                    piece.triangles[written] = [id(0), id(1), id(2)];
                    written += 1;
                }
            }
        }
        piece.triangles.truncate(written);
        if style.placement.mirrored {
            piece.triangles[before..]
                .iter_mut()
                .for_each(|t| t.swap(1, 2));
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

/// Corner mask of cell `x` of a row.
#[inline(always)]
fn cell_mask(rows: &[u64; 4], x: u32) -> usize {
    let pair = |i: usize| ((rows[i] >> x & 3) as usize) << (2 * i);
    pair(0) | pair(1) | pair(2) | pair(3)
}

/// What numbers the vertices around a row of cells: crossed edges and first number, of the four
/// rows of x edges, and of the two rows each of y and z edges.
struct RowNumbers([(u64, u32); 8]);

impl RowNumbers {
    #[inline(always)]
    fn new(block: &Block, row: usize, ny: usize, first: u32) -> Self {
        let of =
            |row: usize, axis: usize| (block.crossed[row][axis], first + block.base[row][axis]);
        Self([
            of(row, 0),
            of(row + 1, 0),
            of(row + ny, 0),
            of(row + ny + 1, 0),
            of(row, 1),
            of(row + ny, 1),
            of(row, 2),
            of(row + 1, 2),
        ])
    }

    /// Numbers of the twelve edges of cell `x`, by the numbering of the cube; those of edges that
    /// are not crossed mean nothing.
    #[inline(always)]
    fn of_cell(&self, x: u32) -> [u32; 16] {
        let low = below(x);
        // A plain loop: array::map is not inlined into code for newer instructions.
        let mut rank = [0u32; 8];
        for (rank, (crossed, base)) in rank.iter_mut().zip(&self.0) {
            *rank = base + (crossed & low).count_ones();
        }
        // The edge at x + 1 follows the one at x where that is crossed.
        let next = |i: usize| rank[i] + (self.0[i].0 >> x & 1) as u32;
        [
            rank[0],
            rank[1],
            rank[2],
            rank[3], // x: rows (y, z), (y+1, z), (y, z+1), (y+1, z+1)
            rank[4],
            next(4),
            rank[5],
            next(5), // y: (x, z), (x+1, z), (x, z+1), (x+1, z+1)
            rank[6],
            next(6),
            rank[7],
            next(7), // z: (x, y), (x+1, y), (x, y+1), (x+1, y+1)
            0,
            0,
            0,
            0,
        ]
    }
}

fn corner_values(samples: &BlockSamples, cell: [usize; 3]) -> [f32; 8] {
    std::array::from_fn(|c| {
        let p = corner(c);
        let at = (0..3)
            .map(|a| (cell[a] + p[a]) * samples.step[a])
            .sum::<usize>();
        samples.values[samples.first + at]
    })
}

/// The vertices and triangles of a cell that has vertices inside.
#[cold]
#[inline(never)]
fn emit_inner(
    samples: &BlockSamples,
    style: &Style,
    cell: [usize; 3],
    number: u16,
    edges: &[u32; 16],
    piece: &mut Piece,
    mut written: usize,
) -> usize {
    let values = corner_values(samples, cell);
    let frame = Cell {
        values: &values,
        offsets: offsets(&values, style.iso, style.inside),
        iso: style.iso,
        placement: &style.placement,
    };
    let mut points = Vec::new();
    let triangles = match TABLE.case(number) {
        Ok(entry) => {
            points.push(frame.centre(entry.centre()));
            entry.triangles()
        }
        Err(tunnel) => {
            frame.waist(tunnel, &mut points);
            &tunnel.triangles
        }
    };
    let first = piece.positions.len() as u32;
    let point = std::array::from_fn(|a| samples.origin[a] + cell[a] as i32);
    for (axis, at) in (3..).zip(points) {
        piece.own.push(piece.positions.len() as u32);
        piece.positions.push(style.placement.in_cell(point, at));
        if style.normals {
            let gradient = frame.interpolate(at).1;
            let normal = style.placement.normal(gradient, style.inside);
            piece.normals.push(normal.unwrap_or([0.0, 0.0, 1.0]));
        }
        if style.keys {
            piece.keys.push(EdgeKey { point, axis });
        }
    }
    for t in triangles {
        piece.triangles[written] = t.map(|v| match v {
            0..12 => edges[usize::from(v)],
            _ => first + u32::from(v) - 12,
        });
        written += 1;
    }
    written
}
