//! The march from seed cells: one connected surface, block by block, and nothing else.
//!
//! In each block the triangles fall into *sheets*: parts that are connected inside the block. The
//! walker emits the sheets that it reaches and goes on to every block that shares a vertex with
//! one. Since triangles follow the arcs on the faces of the cells, sheets of one component are
//! linked by shared vertices, and separate surfaces that pass through the same block or even the
//! same cell stay apart.
//!
//! What is remembered is the front: vertices on block faces that some block around them has yet to
//! emit. A vertex lies on a lattice edge, each of the two or four blocks around that edge has
//! exactly one sheet through it, so a bit per block is enough, and when all are cleared the vertex
//! is forgotten. A block can be met several times; it is never emitted twice. Blocks are taken
//! from the front in Morton order, so that they are still in the cache when their turn comes.

use super::block::{Block, BlockOutput, BlockSamples, Style};
use super::blocks::Blocks;
use super::cube::OTHER;
use super::extract::Stats;
use super::relax::Relaxer;
use crate::budget::{Budget, Permit};
use crate::error::{Error, Result};
use crate::field::Field;
use crate::lattice::{Box3, morton_encode};
use crate::mesh::{EdgeKey, MeshSink, Piece, Totals};
use std::collections::{BTreeMap, HashMap};

/// A vertex on the front: its number, and which of the blocks around its edge have yet to emit it.
struct FrontVertex {
    id: u64,
    waiting: u8,
}

struct Walker<'a> {
    field: &'a dyn Field,
    blocks: Blocks,
    style: Style,
    budget: &'a Budget,
    front: HashMap<EdgeKey, FrontVertex>,
    /// Blocks to be visited, by Morton code, with the seed cells in them.
    pending: BTreeMap<u64, ([i32; 3], Vec<[i32; 3]>)>,
    totals: Totals,
    stats: Stats,
    memory: Permit,
}

/// Bytes of an entry of the front with the overhead of its map.
const FRONT_ENTRY_BYTES: u64 = 64;

/// Meshes the surfaces through `seeds`.
pub(super) fn walk(
    field: &dyn Field,
    blocks: Blocks,
    style: Style,
    seeds: &[[i32; 3]],
    first: Totals,
    budget: &Budget,
    sink: &dyn MeshSink,
) -> Result<(Stats, Totals)> {
    let mut walker = Walker {
        field,
        blocks,
        style,
        budget,
        front: HashMap::new(),
        pending: BTreeMap::new(),
        totals: first,
        stats: Stats::default(),
        memory: budget.take(0, "the front")?,
    };
    for &seed in seeds {
        walker.plant(seed)?;
    }
    let mut scratch = Scratch {
        relaxer: Relaxer::new(field.grid(), blocks, style, budget),
        ..Scratch::default()
    };
    while let Some((_, (at, seeds))) = walker.pending.pop_first() {
        budget.check_cancelled()?;
        walker.visit(at, &seeds, &mut scratch)?;
        walker.account()?;
        if !scratch.piece.triangles.is_empty() {
            sink.write(&scratch.piece)?;
        }
        budget.progress().add(1);
    }
    debug_assert!(
        walker.front.is_empty(),
        "every vertex of the front was met from all sides"
    );
    Ok((walker.stats, walker.totals))
}

#[derive(Default)]
struct Scratch<'a> {
    samples: BlockSamples,
    block: Block,
    piece: Piece,
    output: BlockOutput,
    sheets: Sheets,
    wanted: Vec<bool>,
    relaxer: Option<Relaxer<'a>>,
    memory: Option<Permit>,
}

impl Walker<'_> {
    /// Checks a seed cell and puts its block on the front.
    fn plant(&mut self, seed: [i32; 3]) -> Result<()> {
        let Style { iso, inside, .. } = self.style;
        if !self.blocks.cells.contains(seed) {
            return Err(Error::bad_input(format!(
                "seed {seed:?} is outside the cells {} of the region",
                self.blocks.cells
            )));
        }
        let mut samples = BlockSamples::default();
        let cell = Box3::new(seed, seed.map(|v| v + 1));
        self.blocks.gather(self.field, cell, 0, &mut samples)?;
        let values = &samples.values[..8];
        let within = values.iter().filter(|&&v| inside.contains(v, iso)).count();
        if within == 0 || within == 8 {
            let low = values.iter().copied().fold(f32::NAN, f32::min);
            let high = values.iter().copied().fold(f32::NAN, f32::max);
            return Err(Error::bad_input(format!(
                "seed {},{},{}: the surface at isovalue {iso} does not cross this cell, its samples lie in {low} to \
                 {high}; give the lowest corner of a cell that it crosses",
                seed[0], seed[1], seed[2]
            )));
        }
        let at = self.blocks.block_of(seed);
        let entry = self
            .pending
            .entry(code(at))
            .or_insert_with(|| (at, Vec::new()));
        entry.1.push(seed);
        Ok(())
    }

    /// Emits the sheets of a block that the front or a seed touches.
    fn visit(&mut self, at: [i32; 3], seeds: &[[i32; 3]], s: &mut Scratch<'_>) -> Result<()> {
        let cells = self.blocks.cells_of(at, 0);
        self.blocks.gather(
            self.field,
            cells,
            usize::from(self.style.normals),
            &mut s.samples,
        )?;
        self.stats.blocks_visited += 1;
        s.piece = Piece::default();
        if !s.block.scan(&s.samples, &self.style) {
            return Ok(());
        }
        s.memory = None;
        let bytes = 64 * s.block.vertices_max + 12 * s.block.triangles_max;
        s.memory = Some(self.budget.take(bytes as u64, "one block of the march")?);
        s.output.reset();
        s.block.emit(
            &s.samples,
            &self.style,
            [false; 3],
            &mut s.piece,
            &mut s.output,
        );
        if let Some(relaxer) = &mut s.relaxer {
            let range = 0..s.piece.positions.len();
            relaxer.relax((self.field, 0), at, &mut s.piece, range)?;
        }
        s.sheets.of(&s.piece);

        s.wanted.clear();
        s.wanted.resize(s.piece.positions.len(), false);
        for v in 0..s.piece.positions.len() {
            let key = s.piece.keys[v];
            let reached = self.reaches(at, key) || seeds.iter().any(|&cell| on_cell(key, cell));
            if reached {
                let root = s.sheets.root(v as u32);
                s.wanted[root as usize] = true;
            }
        }
        self.take_sheets(at, s);
        Ok(())
    }

    /// Whether the vertex waits on the front for block `at`.
    fn reaches(&self, at: [i32; 3], key: EdgeKey) -> bool {
        let around = self.around(key);
        around.len() > 1
            && self.front.get(&key).is_some_and(|vertex| {
                around
                    .iter()
                    .any(|(bit, block)| *block == at && vertex.waiting >> bit & 1 == 1)
            })
    }

    /// Keeps the wanted sheets of the piece, numbers their vertices and moves the front.
    fn take_sheets(&mut self, at: [i32; 3], s: &mut Scratch<'_>) {
        let piece = &mut s.piece;
        let sheets = &mut s.sheets;
        let wanted = &s.wanted;
        piece
            .triangles
            .retain(|t| wanted[sheets.root(t[0]) as usize]);
        piece.first_vertex = self.totals.vertices;
        piece.first_triangle = self.totals.triangles;
        piece.own.clear();
        piece.ids.clear();
        for v in 0..piece.positions.len() as u32 {
            let id = if wanted[sheets.root(v) as usize] {
                let next = piece.first_vertex + piece.own.len() as u64;
                let id = self.number(at, piece.keys[v as usize], next);
                if id == next {
                    piece.own.push(v);
                }
                id
            } else {
                // Of another surface: no triangle of the piece uses it, and sinks may look at it.
                0
            };
            piece.ids.push(id);
        }
        self.stats.interior_vertices += piece
            .own
            .iter()
            .filter(|&&v| piece.keys[v as usize].axis >= 3)
            .count() as u64;
        self.totals.vertices += piece.own.len() as u64;
        self.totals.triangles += piece.triangles.len() as u64;
        self.stats.active_cells += s.output.active_cells;
        self.stats.ambiguous_faces += s.output.ambiguous_faces;
    }

    /// The number of a vertex that block `at` emits: `next` unless the front has one.
    fn number(&mut self, at: [i32; 3], key: EdgeKey, next: u64) -> u64 {
        let around = self.around(key);
        if around.len() < 2 {
            return next;
        }
        let everybody = around.iter().fold(0, |bits, (bit, _)| bits | 1 << bit);
        let vertex = self.front.entry(key).or_insert(FrontVertex {
            id: next,
            waiting: everybody,
        });
        let id = vertex.id;
        for (bit, block) in around.iter() {
            if *block == at {
                vertex.waiting &= !(1 << bit);
            } else if vertex.waiting >> bit & 1 == 1 {
                self.pending
                    .entry(code(*block))
                    .or_insert_with(|| (*block, Vec::new()));
            }
        }
        if vertex.waiting == 0 {
            self.front.remove(&key);
        }
        id
    }

    /// The blocks whose cells touch the lattice edge of `key`, each with its bit.
    fn around(&self, key: EdgeKey) -> Around {
        let mut around = Around::default();
        if key.axis >= 3 {
            return around;
        }
        let [b, c] = OTHER[usize::from(key.axis)];
        for bit in 0..4u8 {
            let mut cell = key.point;
            cell[b] -= i32::from(bit & 1 == 0);
            cell[c] -= i32::from(bit >> 1 & 1 == 0);
            if self.blocks.cells.contains(cell) {
                let block = self.blocks.block_of(cell);
                if !around.iter().any(|(_, known)| *known == block) {
                    around.push(bit, block);
                }
            }
        }
        around
    }

    fn account(&mut self) -> Result<()> {
        let bytes = FRONT_ENTRY_BYTES * (self.front.len() + 2 * self.pending.len()) as u64;
        self.stats.front_bytes_max = self.stats.front_bytes_max.max(bytes);
        if !self.memory.try_resize(bytes) {
            self.budget
                .take(bytes - self.memory.bytes(), "the front of the march")?;
        }
        Ok(())
    }
}

/// At most four blocks, without an allocation.
#[derive(Default)]
struct Around {
    blocks: [(u8, [i32; 3]); 4],
    count: usize,
}

impl Around {
    fn push(&mut self, bit: u8, block: [i32; 3]) {
        self.blocks[self.count] = (bit, block);
        self.count += 1;
    }

    fn iter(&self) -> std::slice::Iter<'_, (u8, [i32; 3])> {
        self.blocks[..self.count].iter()
    }

    fn len(&self) -> usize {
        self.count
    }
}

fn code(at: [i32; 3]) -> u64 {
    // Block coordinates are not negative: blocks are anchored at the first sample.
    morton_encode(at.map(|v| v as u32))
}

/// Whether the vertex belongs to `cell`.
pub(super) fn on_cell(key: EdgeKey, cell: [i32; 3]) -> bool {
    if key.axis >= 3 {
        return key.point == cell;
    }
    let along = usize::from(key.axis);
    (0..3).all(|a| {
        let ahead = key.point[a] - cell[a];
        ahead == 0 || (a != along && ahead == 1)
    })
}

/// Sheets of a block: vertices joined by triangles (union-find with path halving).
#[derive(Default)]
struct Sheets(Vec<u32>);

impl Sheets {
    fn of(&mut self, piece: &Piece) {
        self.0.clear();
        self.0.extend(0..piece.positions.len() as u32);
        for t in &piece.triangles {
            let first = self.root(t[0]);
            for &v in &t[1..] {
                let other = self.root(v);
                let first = self.root(first);
                // The smaller number is the root, whatever the order of the triangles.
                self.0[first.max(other) as usize] = first.min(other);
            }
        }
    }

    fn root(&mut self, mut v: u32) -> u32 {
        while self.0[v as usize] != v {
            let above = self.0[self.0[v as usize] as usize];
            self.0[v as usize] = above;
            v = above;
        }
        v
    }
}

#[cfg(test)]
mod tests {
    use super::super::cube::corner;
    use super::*;

    #[test]
    fn a_vertex_belongs_to_the_four_cells_around_its_edge() {
        let key = EdgeKey {
            point: [5, 5, 5],
            axis: 1,
        };
        let cells = (0..27).map(|n| [4 + n % 3, 4 + n / 3 % 3, 4 + n / 9]);
        let around: Vec<_> = cells.filter(|&cell| on_cell(key, cell)).collect();
        assert_eq!(around, [[4, 5, 4], [5, 5, 4], [4, 5, 5], [5, 5, 5]]);
        for cell in around {
            assert!((0..8).any(|c| (0..3).all(|a| cell[a] + corner(c)[a] as i32 == key.point[a])));
        }
    }
}
