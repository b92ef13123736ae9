//! All surfaces: every block that the surface may cross, in Morton order, on several threads.
//!
//! Blocks are scanned and cut into triangles in parallel. Numbers are given out in the order of
//! the blocks, by whichever thread completes the next one; writing is parallel again. Pieces are a
//! fixed pool, so memory is bounded, and a thread that cannot go on numbering writes instead.

use super::block::{Block, BlockOutput, BlockSamples, Style, TRIANGLES_SLACK};
use super::blocks::{Blocks, Candidates};
use super::extract::Stats;
use super::numbering::Numbering;
use super::relax::Relaxer;
use crate::budget::{Budget, Permit, human_bytes};
use crate::error::{Error, ErrorKind, Result};
use crate::field::Field;
use crate::mesh::{Count, EdgeKey, MeshSink, Piece, Totals};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// A piece in the making: what a ticket becomes.
#[derive(Default)]
struct Batch {
    piece: Piece,
    blocks: Vec<([i32; 3], BlockOutput)>,
    spare: Vec<BlockOutput>,
    /// Blocks looked at, crossed or not.
    visited: u64,
    /// Covers what a block needs beyond the usual size of a piece.
    extra: Option<Permit>,
}

/// Takes a piece without numbers, its blocks and how many were looked at.
pub(super) type Keep<'a> =
    &'a mut (dyn FnMut(&Piece, &[([i32; 3], BlockOutput)], u64) -> Result<()> + Send);

/// Everything the threads share, under one short lock.
struct State<'k> {
    numbering: Numbering,
    /// Takes batches in their order when only a part of the mesh is made; none gets numbers then.
    keep: Option<Keep<'k>>,
    stats: Stats,
    /// Finished batches that wait for their turn to be numbered.
    waiting: BTreeMap<u64, Batch>,
    /// Numbered batches that wait to be written.
    numbered: Vec<Batch>,
    /// Threads that write now.
    writing: usize,
    free: Vec<Batch>,
    /// Ticket to be numbered next.
    turn: u64,
    tickets: u64,
    exhausted: bool,
    error: Option<Error>,
    /// Covers the faces of the front.
    front: Permit,
}

struct Sweep<'a, 'k> {
    field: &'a dyn Field,
    blocks: Blocks,
    style: Style,
    budget: &'a Budget,
    sink: &'a dyn MeshSink,
    limits: Limits,
    candidates: Mutex<Candidates<'a>>,
    state: Mutex<State<'k>>,
    changed: Condvar,
    /// Whether batches are given away as they are, so that they must not depend on time.
    fixed: bool,
    /// Blocks and triangles of the tickets that are done, to guess the size of the next.
    done: [AtomicU64; 2],
}

/// Sizes that follow from the budget.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    pub(super) threads: usize,
    /// Threads that write at one time while there is other work.
    writers: usize,
    batches: usize,
    /// Blocks a ticket, at least.
    pub(super) blocks: usize,
}

/// Triangles of a ticket, about: the larger the batches, the fewer waits and writes, but what a ticket
/// makes should stay in the cache of its processor until it is written.
const TICKET_TRIANGLES: u64 = 24 << 10;

/// Vertices and triangles of a piece. A block of 32^3 cells of white noise fills it; a block beyond
/// that is meshed alone, under a permit of its own, when it is its turn.
const PIECE_VERTICES: usize = 49_152;
const PIECE_TRIANGLES: usize = 98_304;

/// Bytes of a piece with its usual room.
pub(super) fn usual_piece_bytes(style: &Style) -> u64 {
    piece_bytes(style, PIECE_VERTICES, PIECE_TRIANGLES)
}

pub(super) fn piece_bytes(style: &Style, vertices: usize, triangles: usize) -> u64 {
    let vertex = 12
        + 8
        + 4
        + if style.normals { 12 } else { 0 }
        + if style.relax > 0 { 12 } else { 0 }
        + if style.keys { size_of::<EdgeKey>() } else { 0 };
    (vertices * vertex + triangles * 12) as u64
}

impl Limits {
    /// Pieces take at most a third of the budget; threads are fewer where that is not enough.
    pub(super) fn new(blocks: &Blocks, style: &Style, budget: &Budget) -> Result<Self> {
        let piece = usual_piece_bytes(style);
        let fits = (budget.memory_bytes() / 3 / piece) as usize;
        if fits == 0 {
            let needs = human_bytes(3 * piece);
            return Err(Error::new(
                ErrorKind::BudgetExceeded,
                format!("meshing needs a memory budget of at least {needs}: give more with --mem"),
            ));
        }
        let threads = budget.threads().min(fits);
        Ok(Self {
            threads,
            writers: threads.div_ceil(3),
            batches: (2 * threads).min(fits),
            blocks: (65536 / blocks.edge.pow(3)).max(1) as usize,
        })
    }
}

/// Meshes every surface of `field`.
pub(super) fn sweep(
    field: &dyn Field,
    blocks: Blocks,
    style: Style,
    first: Totals,
    budget: &Budget,
    sink: &dyn MeshSink,
) -> Result<(Stats, Totals)> {
    let candidates = Candidates::new(field, blocks, style.iso, style.inside);
    march(candidates, style, first, budget, sink, None)
}

/// Meshes some of the blocks and gives them to `keep` in their order, without global numbers.
pub(super) fn sweep_some(
    candidates: Candidates<'_>,
    style: Style,
    budget: &Budget,
    keep: Keep<'_>,
) -> Result<(Stats, Totals)> {
    let nothing = Count::default();
    march(
        candidates,
        style,
        Totals::default(),
        budget,
        &nothing,
        Some(keep),
    )
}

fn march(
    candidates: Candidates<'_>,
    style: Style,
    first: Totals,
    budget: &Budget,
    sink: &dyn MeshSink,
    keep: Option<Keep<'_>>,
) -> Result<(Stats, Totals)> {
    let (field, blocks) = (candidates.field, candidates.blocks);
    let limits = Limits::new(&blocks, &style, budget)?;
    let keep_batches = keep.is_some();
    let piece = usual_piece_bytes(&style);
    let scratch = 4 * (blocks.edge as u64 + 5).pow(3) * 2;
    let _pieces = budget.take(
        limits.batches as u64 * piece + limits.threads as u64 * scratch,
        "pieces of the mesh",
    )?;
    let sweep = Sweep {
        field,
        blocks,
        style,
        budget,
        sink,
        limits,
        candidates: Mutex::new(candidates),
        state: Mutex::new(State {
            numbering: Numbering::from(first),
            keep,
            stats: Stats::default(),
            waiting: BTreeMap::new(),
            numbered: Vec::new(),
            writing: 0,
            free: (0..limits.batches).map(|_| Batch::new(&style)).collect(),
            turn: 0,
            tickets: 0,
            exhausted: false,
            error: None,
            front: budget.take(0, "the front")?,
        }),
        changed: Condvar::new(),
        fixed: keep_batches,
        done: Default::default(),
    };
    std::thread::scope(|scope| {
        for _ in 1..limits.threads {
            scope.spawn(|| sweep.work());
        }
        sweep.work();
    });
    let mut state = sweep.state.into_inner().expect("no thread panicked");
    if let Some(error) = state.error.take() {
        return Err(error);
    }
    state.stats.front_bytes_max = state.numbering.front_bytes_max;
    Ok((state.stats, state.numbering.totals))
}

impl<'k> Sweep<'_, 'k> {
    fn work(&self) {
        let _alarm = Alarm(self);
        if let Err(error) = self.run() {
            let mut state = self.lock();
            state.error.get_or_insert(error);
            self.changed.notify_all();
        }
    }

    fn lock(&self) -> MutexGuard<'_, State<'k>> {
        self.state.lock().expect("no thread panicked")
    }

    fn run(&self) -> Result<()> {
        let mut block = Block::default();
        let mut samples = BlockSamples::default();
        let mut relaxer = Relaxer::new(self.field.grid(), self.blocks, self.style, self.budget);
        let mut todo = Vec::new();
        let mut state = self.lock();
        loop {
            if state.error.is_some() {
                return Ok(());
            }
            // Writers of one file wait for each other in the kernel: others rather go on meshing.
            let may_write =
                state.writing < self.limits.writers || state.exhausted || state.free.is_empty();
            if may_write && let Some(batch) = state.numbered.pop() {
                state.writing += 1;
                drop(state);
                self.write(batch)?;
                state = self.lock();
            } else if !state.exhausted && !state.free.is_empty() {
                let mut batch = state.free.pop().expect("not empty");
                drop(state);
                let ticket = self.draw(&mut todo)?;
                let Some(ticket) = ticket else {
                    state = self.lock();
                    state.exhausted = true;
                    state.free.push(batch);
                    self.changed.notify_all();
                    continue;
                };
                for &at in &todo {
                    self.budget.check_cancelled()?;
                    let room = (&mut block, &mut samples, relaxer.as_mut());
                    batch = self.mesh_block(at, ticket, room, batch)?;
                }
                self.done[0].fetch_add(todo.len() as u64, Relaxed);
                self.done[1].fetch_add(batch.piece.triangles.len() as u64, Relaxed);
                state = self.lock();
                state.waiting.insert(ticket, batch);
                self.number_waiting(&mut state)?;
                self.changed.notify_all();
            } else if state.exhausted && state.turn == state.tickets && state.numbered.is_empty() {
                self.changed.notify_all();
                return Ok(());
            } else {
                state = self.changed.wait(state).expect("no thread panicked");
            }
        }
    }

    /// The next run of blocks and its ticket.
    fn draw(&self, todo: &mut Vec<[i32; 3]>) -> Result<Option<u64>> {
        let mut candidates = self.candidates.lock().expect("no thread panicked");
        todo.clear();
        let most = self.ticket_blocks();
        while todo.len() < most {
            match candidates.next()? {
                Some(at) => todo.push(at),
                None => break,
            }
        }
        if todo.is_empty() {
            return Ok(None);
        }
        let mut state = self.lock();
        let ticket = state.tickets;
        state.tickets += 1;
        Ok(Some(ticket))
    }

    /// How many blocks the next ticket has. No output depends on it.
    fn ticket_blocks(&self) -> usize {
        let least = self.limits.blocks;
        let [blocks, triangles] = [0, 1].map(|i| self.done[i].load(Relaxed));
        if self.fixed || blocks < 8 * least as u64 {
            return least;
        }
        let wanted = TICKET_TRIANGLES * blocks / triangles.max(1);
        (wanted as usize).clamp(least, 4 * least)
    }

    fn mesh_block(
        &self,
        at: [i32; 3],
        ticket: u64,
        (block, samples, relaxer): (&mut Block, &mut BlockSamples, Option<&mut Relaxer<'_>>),
        mut batch: Batch,
    ) -> Result<Batch> {
        let cells = self.blocks.cells_of(at, 0);
        self.blocks
            .gather(self.field, cells, usize::from(self.style.normals), samples)?;
        // Relaxing reads around the block again.
        if relaxer.is_none() {
            self.field
                .forget(self.blocks.done_with(cells, self.style.normals));
        }
        self.budget.progress().add(1);
        batch.visited += 1;
        if !block.scan(samples, &self.style) {
            return Ok(batch);
        }
        let vertices = batch.piece.positions.len() + block.vertices_max;
        let triangles = batch.piece.triangles.len() + block.triangles_max;
        if vertices > PIECE_VERTICES || triangles > PIECE_TRIANGLES {
            batch = self.flush(ticket, batch)?;
            batch.make_room(block, &self.style, self.budget)?;
        }
        let borrowed = std::array::from_fn(|a| at[a] > self.blocks.range.min[a]);
        let mut out = batch.spare.pop().unwrap_or_default();
        block.emit(samples, &self.style, borrowed, &mut batch.piece, &mut out);
        if let Some(relaxer) = relaxer {
            let range = out.first as usize..(out.first + out.count) as usize;
            relaxer.relax((self.field, 0), at, &mut batch.piece, range)?;
        }
        batch.blocks.push((at, out));
        Ok(batch)
    }

    /// Numbers and writes a full batch in the middle of its ticket, once it is its turn.
    fn flush(&self, ticket: u64, mut batch: Batch) -> Result<Batch> {
        let mut state = self.lock();
        while state.turn != ticket {
            if state.error.is_some() {
                return Err(Error::new(ErrorKind::Cancelled, "stopped by another error"));
            }
            state = self.changed.wait(state).expect("no thread panicked");
        }
        self.number(&mut state, &mut batch)?;
        drop(state);
        self.sink.write(&batch.piece)?;
        batch.reset();
        Ok(batch)
    }

    fn number_waiting(&self, state: &mut State<'k>) -> Result<()> {
        loop {
            let turn = state.turn;
            let Some(mut batch) = state.waiting.remove(&turn) else {
                return Ok(());
            };
            self.number(state, &mut batch)?;
            state.turn += 1;
            state.numbered.push(batch);
        }
    }

    fn number(&self, state: &mut State<'k>, batch: &mut Batch) -> Result<()> {
        let Batch { piece, blocks, .. } = batch;
        if let Some(keep) = &mut state.keep {
            keep(piece, blocks, batch.visited)?;
        } else {
            state.numbering.start(piece);
        }
        for (at, out) in blocks.iter() {
            if state.keep.is_none() {
                let end = self.blocks.range.max;
                state.numbering.pass(end, *at, out, piece)?;
            }
            state.stats.active_cells += out.active_cells;
            state.stats.ambiguous_faces += out.ambiguous_faces;
            state.stats.interior_vertices += out.interior_vertices;
        }
        state.numbering.end(piece);
        state.stats.blocks_visited += batch.visited;
        let capacity = self.sink.capacity();
        let totals = state.numbering.totals;
        if totals.vertices > capacity.vertices || totals.triangles > capacity.triangles {
            return Err(Error::new(
                ErrorKind::LimitExceeded,
                format!(
                    "the mesh has more than {} vertices or {} triangles, which the output format cannot hold: \
                     choose another format or a smaller region",
                    capacity.vertices, capacity.triangles
                ),
            ));
        }
        if !state.front.try_resize(state.numbering.front_bytes()) {
            self.budget
                .take(state.numbering.front_bytes(), "the front of the march")?;
        }
        Ok(())
    }

    fn write(&self, mut batch: Batch) -> Result<()> {
        if !batch.piece.triangles.is_empty() {
            self.sink.write(&batch.piece)?;
        }
        batch.reset();
        let mut state = self.lock();
        state.free.push(batch);
        state.writing -= 1;
        drop(state);
        self.changed.notify_all();
        Ok(())
    }
}

/// Tells the other threads when one panics, so that none waits for it.
struct Alarm<'a, 'b, 'k>(&'a Sweep<'b, 'k>);

impl Drop for Alarm<'_, '_, '_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let mut state = self.0.state.lock().unwrap_or_else(PoisonError::into_inner);
            state
                .error
                .get_or_insert_with(|| Error::new(ErrorKind::Cancelled, "a thread panicked"));
            self.0.changed.notify_all();
        }
    }
}

impl Batch {
    /// An empty batch with its buffers reserved; memory is used as it is touched.
    fn new(style: &Style) -> Self {
        let mut batch = Batch::default();
        let piece = &mut batch.piece;
        piece.positions.reserve_exact(PIECE_VERTICES);
        piece
            .unmoved
            .reserve_exact(if style.relax > 0 { PIECE_VERTICES } else { 0 });
        piece.ids.reserve_exact(PIECE_VERTICES);
        piece.own.reserve_exact(PIECE_VERTICES);
        piece
            .normals
            .reserve_exact(if style.normals { PIECE_VERTICES } else { 0 });
        piece
            .keys
            .reserve_exact(if style.keys { PIECE_VERTICES } else { 0 });
        piece
            .triangles
            .reserve_exact(PIECE_TRIANGLES + TRIANGLES_SLACK);
        batch
    }

    /// Makes an empty batch large enough for `block`.
    fn make_room(&mut self, block: &Block, style: &Style, budget: &Budget) -> Result<()> {
        let usual = usual_piece_bytes(style);
        let vertices = block.vertices_max.max(PIECE_VERTICES);
        let triangles = block.triangles_max.max(PIECE_TRIANGLES);
        let extra = piece_bytes(style, vertices, triangles) - usual;
        if extra == 0 {
            return Ok(());
        }
        self.extra = Some(budget.take(extra, "a block of dense surface")?);
        let piece = &mut self.piece;
        piece.positions.reserve_exact(vertices);
        piece
            .unmoved
            .reserve_exact(if style.relax > 0 { vertices } else { 0 });
        piece.ids.reserve_exact(vertices);
        piece.own.reserve_exact(vertices);
        piece
            .normals
            .reserve_exact(if style.normals { vertices } else { 0 });
        piece
            .keys
            .reserve_exact(if style.keys { vertices } else { 0 });
        piece.triangles.reserve_exact(triangles + TRIANGLES_SLACK);
        Ok(())
    }

    fn reset(&mut self) {
        let piece = &mut self.piece;
        piece.positions.clear();
        piece.unmoved.clear();
        piece.normals.clear();
        piece.keys.clear();
        piece.ids.clear();
        piece.own.clear();
        piece.triangles.clear();
        if self.extra.is_some() {
            piece.positions.shrink_to(PIECE_VERTICES);
            piece.unmoved.shrink_to(PIECE_VERTICES);
            piece.normals.shrink_to(PIECE_VERTICES);
            piece.keys.shrink_to(PIECE_VERTICES);
            piece.ids.shrink_to(PIECE_VERTICES);
            piece.own.shrink_to(PIECE_VERTICES);
            piece.triangles.shrink_to(PIECE_TRIANGLES + TRIANGLES_SLACK);
            self.extra = None;
        }
        self.visited = 0;
        self.spare.extend(self.blocks.drain(..).map(|(_, out)| out));
        self.spare.iter_mut().for_each(BlockOutput::reset);
    }
}
