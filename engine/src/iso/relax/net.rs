//! The vertices of a tile and how they move.

use super::super::block::{Block, BlockSamples, Style};
use super::super::vertices::{Edge, Placed};
use super::surface::{FINE, Place, Surface, UNIT, dot, moved, scaled, sum, whole};
use crate::lattice::Box3;
use crate::mesh::{EdgeKey, Piece};
use crate::sample::Inside;

/// Share of the way to the middle of its neighbours that a vertex goes in a pass.
const STEP: f32 = 0.7;

/// No vertex ends farther than this from where it began, along any axis, in units of a place: a
/// little less than half a cell, so that triangles with a cell between them never meet.
const REACH: i32 = (1 << (FINE - 1)) - 1;

/// Distance from the surface, in cells, at which a vertex is taken to lie on it.
const ON_SURFACE: f32 = 1.0 / 65536.0;

/// What a vertex may do. Bits 0 to 2: it stays in a plane across that axis, a border.
pub(super) mod kind {
    /// Shift of the bits of axes whose border is the upper one.
    pub(in super::super) const HIGH: u32 = 3;
    /// On a cap: in its plane it goes anywhere.
    pub(in super::super) const FLAT: u8 = 1 << 6;
    /// It stays where it is.
    pub(in super::super) const FIXED: u8 = 1 << 7;
}

/// The vertices of a tile.
#[derive(Debug, Default)]
pub(super) struct Net {
    pub(super) start: Vec<Place>,
    pub(super) now: Vec<Place>,
    next: Vec<Place>,
    /// Unit normals out of the solid, in the metric of the world.
    pub(super) normals: Vec<[f32; 3]>,
    pub(super) start_normals: Vec<[f32; 3]>,
    pub(super) kinds: Vec<u8>,
    /// How many cells beyond the tile proper.
    pub(super) rings: Vec<u8>,
    /// Vertices of cells that more than one sheet may pass, and of sheets less than a cell apart.
    pub(super) close: Vec<bool>,
    /// By how much the coordinates change at most when they are written, in units of a place.
    pub(super) rounding: f64,
    sums: Vec<[i32; 4]>,
}

impl Net {
    /// Bytes for `vertices` of a tile, all arrays of this module together.
    pub(super) const VERTEX_BYTES: usize = 3 * 12 + 2 * 12 + 3 + 16 + 6;

    /// Takes over the vertices of a tile that was just emitted, with positions inside cells in
    /// coordinates of the cell. `tile` are its cells without rings, `known` the samples that exist.
    pub(super) fn start(
        &mut self,
        block: &Block,
        samples: &BlockSamples,
        piece: &Piece,
        style: &Style,
        tile: &Box3,
        known: &Box3,
    ) {
        let count = piece.positions.len();
        self.start.clear();
        self.kinds.clear();
        self.rings.clear();
        let finite = all_finite(samples, known);
        let placed = Placed { samples, style };
        let mut add = |key: EdgeKey, place: Place| {
            self.start.push(place);
            self.kinds.push(kind_of(key, samples, known, finite));
            self.rings.push(ring_of(key, tile));
        };
        for &code in &block.edges {
            let (edge, t, _) = placed.crossing(code);
            let Edge { point, axis } = edge;
            // One more sample on every side.
            let mut place = point.map(|v| (v as i32 + 1) << FINE);
            place[axis] += whole(t);
            let key = EdgeKey {
                point: edge.lattice(samples.origin),
                axis: axis as u8,
            };
            add(key, place);
        }
        for v in block.edges.len()..count {
            let key = piece.keys[v];
            let place = std::array::from_fn(|a| {
                let cell = key.point[a] - samples.origin[a] + 1;
                (cell << FINE) + whole(piece.positions[v][a])
            });
            add(key, place);
        }
        self.now.clone_from(&self.start);
        self.next.clone_from(&self.start);
        self.sums.resize(count, [0; 4]);
        self.mark_close(block, samples);
    }

    fn mark_close(&mut self, block: &Block, samples: &BlockSamples) {
        self.close.clear();
        self.close.resize(self.start.len(), false);
        let ny = samples.size[1];
        block.each_cell(|row, x, mask| {
            if !PARTED[mask] {
                return;
            }
            for axis in 0..3usize {
                let step = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
                let (b, c) = (step[(axis + 1) % 3], step[(axis + 2) % 3]);
                for corner in 0..4 {
                    let at = |a: usize| {
                        [x as usize, row % ny, row / ny][a]
                            + (corner & 1) * b[a]
                            + (corner >> 1) * c[a]
                    };
                    let row = at(1) + ny * at(2);
                    let x = at(0) as u32;
                    if block.crossed[axis][row] >> x & 1 == 1 {
                        self.close[block.vertex(axis, x, row) as usize] = true;
                    }
                }
            }
        });
        self.close[block.edges.len()..].fill(true);
        self.mark_thin(block, ny);
    }

    /// Where one sample alone lies between two vertices of a line of the lattice.
    fn mark_thin(&mut self, block: &Block, ny: usize) {
        for (axis, rows) in block.crossed.iter().enumerate() {
            let (step, far) = ([0, 1, ny][axis], u32::from(axis == 0));
            for (row, &here) in rows.iter().enumerate() {
                let next = row + step;
                let beyond = match axis {
                    0 => here >> 1,
                    1 if next % ny == 0 => 0,
                    _ => rows.get(next).copied().unwrap_or(0),
                };
                let mut thin = here & beyond;
                while thin != 0 {
                    let x = thin.trailing_zeros();
                    thin &= thin - 1;
                    for v in [
                        block.vertex(axis, x, row),
                        block.vertex(axis, x + far, next),
                    ] {
                        self.close[v as usize] = true;
                    }
                }
            }
        }
    }

    /// Whether there are vertices of close sheets up to `rings` cells beyond the tile.
    pub(super) fn is_close_within(&self, rings: u8) -> bool {
        let near = self.rings.iter().zip(&self.close);
        near.into_iter()
            .any(|(&ring, &close)| close && ring <= rings)
    }

    /// The normals at the start.
    #[inline(always)]
    pub(super) fn find_normals(&mut self, surface: &Surface<'_>, inside: Inside, rings: u8) {
        let out = if inside == Inside::Above { -1.0 } else { 1.0 };
        self.normals.clear();
        for (v, &place) in self.start.iter().enumerate() {
            let kind = self.kinds[v];
            let mut normal = [0.0; 3];
            if self.rings[v] > rings {
            } else if kind & kind::FLAT != 0 {
                // A cap faces along the edges of its vertices, which lie beside their sample.
                let axis = (0..3)
                    .find(|&a| self.start[v][a] & ((1 << FINE) - 1) != 0)
                    .unwrap_or(0);
                let mut g = [0.0; 3];
                g[axis] = if kind >> (kind::HIGH as usize + axis) & 1 == 1 {
                    1.0
                } else {
                    -1.0
                };
                normal = unit(surface.metric.gradient(g));
            } else if let Some((_, g)) = surface.at(place, low(kind)) {
                normal = unit(scaled(surface.metric.gradient(g), out));
            }
            self.normals.push(normal);
        }
        self.start_normals.clone_from(&self.normals);
    }

    /// One step of every vertex that is at most `rings` cells beyond the tile.
    #[inline(always)]
    pub(super) fn pass(
        &mut self,
        surface: &Surface<'_>,
        inside: Inside,
        triangles: &[[u32; 3]],
        rings: u8,
    ) {
        let out = if inside == Inside::Above { -1.0 } else { 1.0 };
        self.sums.fill([0; 4]);
        for &t in triangles {
            let [a, b, c] = t.map(|v| self.now[v as usize]);
            // All whole numbers: the order of the triangles does not matter.
            for (v, p, q) in [(t[0], b, c), (t[1], c, a), (t[2], a, b)] {
                let s = &mut self.sums[v as usize];
                for k in 0..3 {
                    s[k] = s[k].wrapping_add(p[k]).wrapping_add(q[k]);
                }
                s[3] += 2;
            }
        }
        for v in 0..self.now.len() {
            if self.rings[v] > rings || self.kinds[v] & kind::FIXED != 0 || self.sums[v][3] == 0 {
                continue;
            }
            let [x, y, z, n] = self.sums[v];
            let p = self.now[v];
            let to = |a: usize, s: i32| s.wrapping_sub(n.wrapping_mul(p[a])) as f32;
            let share = STEP / (n as f32 * UNIT);
            let way = [to(0, x) * share, to(1, y) * share, to(2, z) * share];
            let found = match self.kinds[v] {
                0 => free(surface, p, self.normals[v], way, self.start[v]),
                kind if kind & kind::FLAT != 0 => {
                    let q = moved(p, masked(way, kind));
                    within(q, self.start[v]).then_some((q, None))
                }
                kind => along_border(surface, p, kind, way, self.start[v]),
            };
            if let Some((q, gradient)) = found {
                self.next[v] = q;
                if let Some(g) = gradient {
                    self.normals[v] = unit(scaled(g, out));
                }
            }
        }
        self.now.clone_from(&self.next);
    }

    /// Back to the start with vertex `v`.
    pub(super) fn refuse(&mut self, v: usize) {
        self.now[v] = self.start[v];
        self.normals[v] = self.start_normals[v];
    }
}

fn within(q: Place, start: Place) -> bool {
    (0..3).all(|a| q[a].wrapping_sub(start[a]).wrapping_abs() <= REACH)
}

fn masked(mut d: [f32; 3], kind: u8) -> [f32; 3] {
    for (a, v) in d.iter_mut().enumerate() {
        if kind >> a & 1 == 1 {
            *v = 0.0;
        }
    }
    d
}

fn low(kind: u8) -> [i32; 3] {
    std::array::from_fn(|a| i32::from(kind >> (kind::HIGH as usize + a) & 1))
}

fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = dot(v, v).sqrt();
    if length.is_finite() && length > 0.0 {
        scaled(v, 1.0 / length)
    } else {
        [0.0; 3]
    }
}

/// A new place, and the gradient in the world there.
type Found = Option<(Place, Option<[f32; 3]>)>;

/// In the tangent plane, then back onto the surface; a shorter way where that fails.
#[inline(always)]
fn free(surface: &Surface<'_>, p: Place, normal: [f32; 3], way: [f32; 3], start: Place) -> Found {
    let metric = &surface.metric;
    let world = metric.world(way);
    let tangent = sum(world, scaled(normal, -dot(world, normal)));
    let mut way = metric.cells(tangent);
    for _ in 0..3 {
        let mut q = moved(p, way);
        for _ in 0..5 {
            // Asked first: what lies farther may not be in this tile.
            if !within(q, start) {
                break;
            }
            let Some((value, by_cells)) = surface.at(q, [0; 3]) else {
                break;
            };
            let g = metric.gradient(by_cells);
            let square = dot(g, g);
            let off = value / square;
            if value * off <= ON_SURFACE * ON_SURFACE {
                return Some((q, Some(g)));
            }
            let back = metric.cells(scaled(g, -off));
            // Not so far that it would be another sheet; not a number ends here too.
            let far = dot(back, back);
            if far.is_nan() || far > 1.0 {
                break;
            }
            q = moved(q, back);
        }
        way = scaled(way, 0.5);
    }
    None
}

/// Along the curve in which the surface meets a border.
#[cold]
fn along_border(surface: &Surface<'_>, p: Place, kind: u8, way: [f32; 3], start: Place) -> Found {
    let frozen = (0..3)
        .filter(|a| kind >> a & 1 == 1)
        .collect::<Vec<usize>>();
    let &[a] = &frozen[..] else {
        return None;
    };
    let (b, c) = ((a + 1) % 3, (a + 2) % 3);
    let metric = &surface.metric;
    let (_, g) = surface.at(p, low(kind))?;
    let mut along = [0.0; 3];
    (along[b], along[c]) = (-g[c], g[b]);
    let (world, tangent) = (metric.world(masked(way, kind)), metric.world(along));
    let mut way = scaled(along, dot(world, tangent) / dot(tangent, tangent));
    for _ in 0..3 {
        let mut q = moved(p, way);
        for _ in 0..5 {
            // Asked first: what lies farther may not be in this tile.
            if !within(q, start) {
                break;
            }
            let Some((value, by_cells)) = surface.at(q, low(kind)) else {
                break;
            };
            let g = masked(by_cells, kind);
            let off = value / dot(g, g);
            if value * off <= ON_SURFACE * ON_SURFACE {
                return Some((q, Some(metric.gradient(by_cells))));
            }
            let back = scaled(g, -off);
            let far = dot(back, back);
            if far.is_nan() || far > 1.0 {
                break;
            }
            q = moved(q, back);
        }
        way = scaled(way, 0.5);
    }
    None
}

/// Cells beyond `tile` that the vertex is.
fn ring_of(key: EdgeKey, tile: &Box3) -> u8 {
    let beyond = |a: usize| {
        let far = i32::from(usize::from(key.axis) == a || key.axis >= 3);
        (tile.min[a] - key.point[a]).max(key.point[a] + far - tile.max[a])
    };
    beyond(0).max(beyond(1)).max(beyond(2)).clamp(0, 255) as u8
}

fn kind_of(key: EdgeKey, samples: &BlockSamples, known: &Box3, finite: bool) -> u8 {
    let mut kind = 0;
    let along = usize::from(key.axis);
    for a in 0..3 {
        let (first, last) = (known.min[a], known.max[a] - 1);
        let at = key.point[a];
        if a == along && (at < first || at >= last) {
            // From the last sample to where nothing is known.
            let high = u8::from(at >= last);
            kind |= kind::FLAT | 1 << a | high << (kind::HIGH as usize + a);
        } else if a != along && key.axis < 3 && (at == first || at == last) {
            kind |= 1 << a;
            kind |= u8::from(at == last && at != first) << (kind::HIGH as usize + a);
        } else if key.axis >= 3 && (at < first || at >= last) {
            kind |= kind::FIXED;
        }
    }
    let border = kind & 7;
    let stuck = border == 7 || (border.count_ones() > 1 && kind & kind::FLAT == 0);
    if stuck || (!finite && !finite_around(key, samples, known)) {
        kind |= kind::FIXED;
    }
    kind
}

fn all_finite(samples: &BlockSamples, known: &Box3) -> bool {
    rows(samples, &everything(samples).intersect(known)).all(|row| {
        // What is not finite gives NaN, which stays.
        row.iter().fold(0.0, |sum: f32, v| sum + v * 0.0) == 0.0
    })
}

/// Whether the samples of the cells around a vertex are finite, as far as they are known.
#[cold]
fn finite_around(key: EdgeKey, samples: &BlockSamples, known: &Box3) -> bool {
    let low = |a: usize| i32::from(key.axis < 3 && usize::from(key.axis) != a);
    let near = Box3::new(
        std::array::from_fn(|a| key.point[a] - low(a)),
        std::array::from_fn(|a| key.point[a] + 2),
    );
    let near = near.intersect(known).intersect(&everything(samples));
    rows(samples, &near).all(|row| row.iter().all(|v| v.is_finite()))
}

/// The lattice points of all samples, with the one more on every side.
fn everything(samples: &BlockSamples) -> Box3 {
    Box3::new(
        samples.origin.map(|v| v - 1),
        std::array::from_fn(|a| samples.origin[a] + samples.size[a] as i32 + 1),
    )
}

fn rows<'a>(samples: &'a BlockSamples, part: &Box3) -> impl Iterator<Item = &'a [f32]> {
    let from = |a: usize, at: i32| (at - samples.origin[a] + 1) as usize;
    let part = if part.is_empty() {
        Box3::from_size([0; 3])
    } else {
        *part
    };
    (part.min[2]..part.max[2]).flat_map(move |z| {
        (part.min[1]..part.max[1]).map(move |y| {
            let start =
                from(0, part.min[0]) + from(1, y) * samples.step[1] + from(2, z) * samples.step[2];
            &samples.values[start..start + part.size()[0] as usize]
        })
    })
}

/// Whether the corners inside, or those outside, of a cell with these signs are not all joined
/// by edges of the cell: the surface may pass it more than once.
static PARTED: [bool; 256] = {
    let mut table = [false; 256];
    let mut mask = 0;
    while mask < 256 {
        table[mask] = parts(mask) > 1 || parts(255 - mask) > 1;
        mask += 1;
    }
    table
};

/// Sets of corners in `mask` that edges of the cube join.
const fn parts(mask: usize) -> usize {
    let (mut left, mut count) = (mask, 0);
    while left != 0 {
        count += 1;
        let mut part = left & left.wrapping_neg();
        loop {
            // One step along x, y and z.
            let wider = part
                | (part & 0x55) << 1
                | (part & 0xaa) >> 1
                | (part & 0x33) << 2
                | (part & 0xcc) >> 2
                | (part & 0x0f) << 4
                | (part & 0xf0) >> 4;
            if wider & mask == part {
                break;
            }
            part = wider & mask;
        }
        left &= !part;
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_with_two_parts_are_known() {
        assert!(!PARTED[0b0000_0001] && !PARTED[0b0000_1111] && !PARTED[0b0001_0111]);
        assert!(PARTED[0b1000_0001] && PARTED[0b0000_1001] && PARTED[0b0110_1001]);
        // Two opposite corners outside.
        assert!(PARTED[0b0111_1110]);
        assert!((0..256).all(|m| PARTED[m] == PARTED[255 - m]));
    }

    #[test]
    fn rings_are_counted_from_the_tile() {
        let tile = Box3::new([4, 4, 4], [8, 8, 8]);
        let ring = |point, axis| ring_of(EdgeKey { point, axis }, &tile);
        assert_eq!(ring([4, 8, 4], 0), 0);
        assert_eq!(ring([8, 8, 4], 0), 1);
        assert_eq!(ring([3, 4, 4], 0), 1);
        assert_eq!(ring([4, 9, 1], 0), 3);
        assert_eq!(ring([7, 7, 7], 3), 0);
        assert_eq!(ring([8, 7, 7], 3), 1);
    }
}
