//! Every label of a volume as a surface of its own, in one pass over the samples.
//!
//! Blocks are read once. Each label in a block is cut into triangles as its mask; its vertices are
//! numbered by a numbering of its own, in the order of the blocks. So the mesh of a label has the
//! bytes that meshing its mask alone gives.

use super::block::{Block, BlockOutput, BlockSamples, Style, TRIANGLES_SLACK};
use super::blocks::{Blocks, Candidates};
use super::dispatch::Level;
use super::extract::Boundary;
use super::label_mask::{LabelBlock, Masks, OneLabel, SMOOTH_MAX};
use super::numbering::Numbering;
use super::place::Placement;
use super::relax::{MAX_RELAX_PASSES, Relaxer, tile_of};
use super::sweep::{Limits, piece_bytes, usual_piece_bytes};
use crate::budget::{Budget, Permit};
use crate::error::{Error, ErrorKind, Result};
use crate::field::{Field, Labels, Range, Samples};
use crate::lattice::{Affine, Box3, Grid};
use crate::mesh::{LabelSink, Layout, Piece, Totals};
use crate::sample::{Inside, Kind};
use std::collections::HashMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Options of [`extract_labels`].
#[derive(Clone, Debug, Default)]
pub struct ExtractLabels {
    /// Which labels; all but 0 when `None`.
    pub labels: Option<Vec<u32>>,
    /// Passes, 4 at most, of the kernel 1/4, 1/2, 1/4 along each axis over the mask of each label
    /// before it is meshed. Beyond the border of the domain the mask goes on as at the border.
    pub smooth: u8,
    /// See [`Extract::relax`](super::Extract::relax).
    pub relax: u8,
    /// See [`Extract::region`](super::Extract::region).
    pub region: Option<Box3>,
    /// See [`Extract::boundary`](super::Extract::boundary).
    pub boundary: Boundary,
    /// See [`Extract::normals`](super::Extract::normals).
    pub normals: bool,
    /// See [`Extract::keys`](super::Extract::keys).
    pub keys: bool,
    /// See [`Extract::index_space`](super::Extract::index_space).
    pub index_space: bool,
    /// Whether a label without a surface is a result rather than an error.
    pub allow_empty: bool,
}

/// What [`extract_labels`] did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LabelStats {
    /// The labels that were met, or asked for, in order, and the sizes of their meshes.
    pub labels: Vec<(u32, Totals)>,
    /// Cells that the surfaces cross, each counted once for every label.
    pub active_cells: u64,
    /// Blocks whose samples were looked at.
    pub blocks_visited: u64,
    /// Blocks decoded from storage while this ran.
    pub blocks_decoded: u64,
    /// Most bytes that the fronts took at one time.
    pub front_bytes_max: u64,
}

/// Meshes every wanted label: for each the surface at 0.5 of its mask, 1 where a sample has the
/// label and 0 elsewhere, exactly as [`extract`](super::extract) meshes that mask alone. The result
/// does not depend on the budget.
///
/// # Errors
/// `EmptySurface` when a label that was asked for has no surface in the region, or there is no
/// label at all; `BadInput` for a region outside the domain, or too many passes;
/// `BudgetExceeded` when the fronts of all labels do not fit; and what source and sink report.
///
/// # Memory
/// Proportional to the number of labels (256 B each) and their fronts, never to the volume or the
/// meshes.
pub fn extract_labels(
    source: &dyn Labels,
    options: &ExtractLabels,
    budget: &Budget,
    sink: &mut dyn LabelSink,
) -> Result<LabelStats> {
    if options.smooth > SMOOTH_MAX {
        return Err(Error::bad_input(format!(
            "{} passes of label smoothing; {SMOOTH_MAX} are the most",
            options.smooth
        )));
    }
    if options.relax > MAX_RELAX_PASSES {
        return Err(Error::bad_input(format!(
            "{} passes of relaxation: {MAX_RELAX_PASSES} are the most",
            options.relax
        )));
    }
    let grid = source.grid();
    let masks = masks(options);
    let union = AnyLabel {
        source,
        masks: &masks,
    };
    let blocks = Blocks::new(&union, options.region, options.boundary)?;
    let map = if options.index_space {
        Affine::IDENTITY
    } else {
        grid.index_to_world
    };
    let style = Style {
        iso: 0.5,
        inside: Inside::Above,
        placement: Placement::new(map, grid.domain)?,
        normals: options.normals,
        // Who moves vertices knows them by key.
        keys: options.keys || options.relax > 0,
        relax: options.relax,
        level: Level::detect(),
    };
    let limits = Limits::new(&blocks, &style, budget)?;
    let share = usual_piece_bytes(&style);
    let _shares = budget.take(
        limits.threads as u64
            * (share + masks.scratch_bytes(blocks.edge) + masks.tile_bytes(options.relax)),
        "pieces of the meshes",
    )?;
    let decoded = source.blocks_decoded();
    sink.begin(Layout {
        normals: options.normals,
        keys: options.keys,
    })?;
    let sweep = Sweep {
        source,
        blocks,
        style,
        masks: &masks,
        keys: options.keys,
        budget,
        share,
        blocks_a_ticket: limits.blocks,
        candidates: Mutex::new((Candidates::new(&union, blocks, style.iso, style.inside), 0)),
        state: Mutex::new(State {
            turn: 0,
            error: None,
            labels: HashMap::new(),
            stats: LabelStats::default(),
            front_bytes: 0,
            front: budget.take(0, "the fronts of the labels")?,
            sink,
        }),
        changed: Condvar::new(),
    };
    std::thread::scope(|scope| {
        for _ in 1..limits.threads {
            scope.spawn(|| sweep.work());
        }
        sweep.work();
    });
    let state = sweep.state.into_inner().expect("no thread panicked");
    if let Some(error) = state.error {
        return Err(error);
    }
    let mut stats = state.stats;
    stats.blocks_decoded = source.blocks_decoded() - decoded;
    let found = state.labels.into_iter().map(|(label, n)| (label, n.totals));
    stats.labels = found.collect();
    stats.labels.sort_unstable_by_key(|&(label, _)| label);
    complete(&mut stats.labels, options, source)?;
    Ok(stats)
}

/// Blocks whose samples [`extract_labels`] will look at.
///
/// # Errors
/// Those of the source and of a region outside the domain.
pub fn label_blocks(source: &dyn Labels, options: &ExtractLabels) -> Result<u64> {
    let masks = masks(options);
    let union = AnyLabel {
        source,
        masks: &masks,
    };
    let blocks = Blocks::new(&union, options.region, options.boundary)?;
    let mut candidates = Candidates::new(&union, blocks, 0.5, Inside::Above);
    let mut count = 0;
    while candidates.next()?.is_some() {
        count += 1;
    }
    Ok(count)
}

fn masks(options: &ExtractLabels) -> Masks {
    let wanted = options.labels.clone().map(|mut list| {
        list.sort_unstable();
        list.dedup();
        list
    });
    Masks {
        wanted,
        smooth: options.smooth.min(SMOOTH_MAX),
        normals: options.normals,
    }
}

/// Adds the labels without a surface, or says that there are some.
fn complete(
    found: &mut Vec<(u32, Totals)>,
    options: &ExtractLabels,
    source: &dyn Labels,
) -> Result<()> {
    let wanted = options.labels.as_deref().unwrap_or_default();
    let missing: Vec<u32> = wanted
        .iter()
        .copied()
        .filter(|label| found.binary_search_by_key(label, |&(l, _)| l).is_err())
        .collect();
    let nothing = found.is_empty() && missing.is_empty();
    if !options.allow_empty && (nothing || !missing.is_empty()) {
        let region = options.region.unwrap_or(source.grid().domain);
        let names: Vec<String> = missing.iter().take(8).map(u32::to_string).collect();
        let what = match names.len() {
            0 => "any label but 0".to_string(),
            1 => format!("label {}", names[0]),
            _ => format!(
                "{} labels ({}{})",
                missing.len(),
                names.join(", "),
                if missing.len() > names.len() {
                    ", ..."
                } else {
                    ""
                }
            ),
        };
        let between = match source.range(region)? {
            Some([low, high]) => format!("the samples in {region} lie in {low} to {high}"),
            None => format!("{region} holds no sample"),
        };
        return Err(Error::new(
            ErrorKind::EmptySurface,
            format!(
                "no surface of {what}: {between}; name other labels, or allow an empty mesh (--allow-empty)"
            ),
        ));
    }
    found.extend(missing.into_iter().map(|label| (label, Totals::default())));
    found.sort_unstable_by_key(|&(label, _)| label);
    found.dedup_by_key(|(label, _)| *label);
    Ok(())
}

/// Where some wanted label is and is not: the field by whose range blocks are left out.
struct AnyLabel<'a> {
    source: &'a dyn Labels,
    masks: &'a Masks,
}

impl Field for AnyLabel<'_> {
    fn grid(&self) -> &Grid {
        self.source.grid()
    }

    fn kind(&self) -> Kind {
        Kind::Mask
    }

    fn block_edge(&self) -> u32 {
        self.source.block_edge()
    }

    fn read(&self, _region: Box3, _out: &mut Samples<'_>) -> Result<()> {
        Err(Error::bad_input("a union of labels has ranges only"))
    }

    fn range(&self, region: Box3) -> Result<Range> {
        let reach = i32::from(self.masks.smooth);
        let Some([low, high]) = self.source.range(region.grow(reach, reach))? else {
            return Ok(Range::EMPTY);
        };
        let mut range = Range::EMPTY;
        if self.masks.wants_between(low, high) {
            range.add(1.0);
        }
        if low != high || range == Range::EMPTY {
            range.add(0.0);
        }
        Ok(range)
    }
}

/// A label in a block, cut into triangles.
struct Part {
    label: u32,
    at: [i32; 3],
    piece: Piece,
    out: BlockOutput,
}

/// What the threads share. Only the one whose turn it is numbers and writes.
struct State<'a> {
    turn: u64,
    error: Option<Error>,
    labels: HashMap<u32, Numbering>,
    stats: LabelStats,
    front_bytes: u64,
    /// Covers the fronts and the list of labels.
    front: Permit,
    sink: &'a mut dyn LabelSink,
}

struct Sweep<'a> {
    source: &'a dyn Labels,
    blocks: Blocks,
    style: Style,
    masks: &'a Masks,
    /// Whether keys are written.
    keys: bool,
    budget: &'a Budget,
    /// Bytes of parts that a thread may hold before it writes them.
    share: u64,
    blocks_a_ticket: usize,
    /// The next blocks, and the number of their ticket.
    candidates: Mutex<(Candidates<'a>, u64)>,
    state: Mutex<State<'a>>,
    changed: Condvar,
}

/// What a thread has cut and not yet written.
#[derive(Default)]
struct Held<'a> {
    relaxer: Option<Relaxer<'a>>,
    parts: Vec<Part>,
    bytes: u64,
    visited: u64,
    /// Samples that nobody needs once the blocks before were gathered too.
    done_with: Vec<Box3>,
    /// Covers what a part needs beyond the share.
    extra: Option<Permit>,
}

/// Bytes of the entries of a label in maps, half of whose places may be empty.
const LABEL_BYTES: u64 = 256;

/// Bytes of a part beside its arrays.
const PART_BYTES: u64 = 512;

impl<'a> Sweep<'a> {
    fn work(&self) {
        let _alarm = Alarm(self);
        if let Err(error) = self.run() {
            self.lock().error.get_or_insert(error);
            self.changed.notify_all();
        }
    }

    fn lock(&self) -> MutexGuard<'_, State<'a>> {
        self.state.lock().expect("no thread panicked")
    }

    fn run(&self) -> Result<()> {
        let mut todo = Vec::new();
        let mut labels = LabelBlock::default();
        let mut block = Block::default();
        let mut samples = BlockSamples::default();
        let mut held = Held {
            relaxer: Relaxer::new(self.source.grid(), self.blocks, self.style, self.budget),
            ..Held::default()
        };
        while let Some(ticket) = self.draw(&mut todo)? {
            for &at in &todo {
                self.budget.check_cancelled()?;
                let cells = self.blocks.cells_of(at, 0);
                labels.gather(self.source, &self.blocks, cells, self.masks)?;
                let far = self.masks.normals || self.masks.smooth > 0;
                // Moving vertices reads around the block again.
                if held.relaxer.is_none() {
                    held.done_with.push(self.blocks.done_with(cells, far));
                }
                self.budget.progress().add(1);
                held.visited += 1;
                for n in 0..labels.found.len() {
                    let domain = self.source.grid().domain;
                    labels.mask(n, &self.blocks, domain, self.masks, &mut samples);
                    if block.scan(&samples, &self.style) {
                        self.make_room(&block, ticket, &mut held)?;
                        let label = labels.found[n].0;
                        held.parts.push(self.cut(label, at, &mut block, &samples));
                    }
                }
            }
            self.write(ticket, &mut held, true)?;
        }
        Ok(())
    }

    /// The next run of blocks and its ticket.
    fn draw(&self, todo: &mut Vec<[i32; 3]>) -> Result<Option<u64>> {
        if self.lock().error.is_some() {
            return Ok(None);
        }
        let mut guard = self.candidates.lock().expect("no thread panicked");
        let (candidates, tickets) = &mut *guard;
        todo.clear();
        while todo.len() < self.blocks_a_ticket {
            match candidates.next()? {
                Some(at) => todo.push(at),
                None => break,
            }
        }
        if todo.is_empty() {
            return Ok(None);
        }
        *tickets += 1;
        Ok(Some(*tickets - 1))
    }

    /// Makes room for the part that `block` will become.
    fn make_room(&self, block: &Block, ticket: u64, held: &mut Held<'_>) -> Result<()> {
        let (vertices, triangles) = (block.vertices_max, block.triangles_max + TRIANGLES_SLACK);
        // The lists of both faces of three axes hold a vertex three times at most.
        let bytes =
            PART_BYTES + piece_bytes(&self.style, vertices, triangles) + 12 * vertices as u64;
        if held.bytes + bytes > self.share {
            self.write(ticket, held, false)?;
        }
        if bytes > self.share {
            held.extra = Some(
                self.budget
                    .take(bytes - self.share, "a block of dense surface")?,
            );
        }
        held.bytes += bytes;
        Ok(())
    }

    fn cut(&self, label: u32, at: [i32; 3], block: &mut Block, samples: &BlockSamples) -> Part {
        let (vertices, triangles) = (block.vertices_max, block.triangles_max + TRIANGLES_SLACK);
        let mut piece = Piece {
            positions: Vec::with_capacity(vertices),
            ids: Vec::with_capacity(vertices),
            own: Vec::with_capacity(vertices),
            triangles: Vec::with_capacity(triangles),
            ..Piece::default()
        };
        if self.style.normals {
            piece.normals.reserve_exact(vertices);
        }
        if self.style.keys {
            piece.keys.reserve_exact(vertices);
        }
        if self.style.relax > 0 {
            piece.unmoved.reserve_exact(vertices);
        }
        let borrowed = std::array::from_fn(|a| at[a] > self.blocks.range.min[a]);
        let mut out = BlockOutput::default();
        block.emit(samples, &self.style, borrowed, &mut piece, &mut out);
        Part {
            label,
            at,
            piece,
            out,
        }
    }

    /// Moves the vertices of what is held, label by label: a tile has many blocks.
    fn relax(&self, held: &mut Held<'_>) -> Result<()> {
        let Some(relaxer) = &mut held.relaxer else {
            return Ok(());
        };
        let tile = |part: &Part| (part.label, tile_of(part.at, self.blocks.edge));
        let mut order: Vec<usize> = (0..held.parts.len()).collect();
        order.sort_by_key(|&n| tile(&held.parts[n]));
        for n in order {
            self.budget.check_cancelled()?;
            let Part {
                label, at, piece, ..
            } = &mut held.parts[n];
            let field = OneLabel {
                source: self.source,
                label: *label,
                masks: self.masks,
            };
            let all = 0..piece.positions.len();
            relaxer.relax((&field, *label), *at, piece, all)?;
            piece.unmoved = Vec::new();
            if !self.keys {
                piece.keys = Vec::new();
            }
        }
        Ok(())
    }

    /// Numbers and writes what is held, once it is the turn of `ticket`; `last` ends the turn.
    fn write(&self, ticket: u64, held: &mut Held<'_>, last: bool) -> Result<()> {
        self.relax(held)?;
        let mut state = self.lock();
        while state.turn != ticket {
            if state.error.is_some() {
                return Err(Error::new(ErrorKind::Cancelled, "stopped by another error"));
            }
            state = self.changed.wait(state).expect("no thread panicked");
        }
        let state = &mut *state;
        for part in held.parts.drain(..) {
            self.write_part(state, part)?;
        }
        state.stats.blocks_visited += std::mem::take(&mut held.visited);
        held.bytes = 0;
        held.extra = None;
        if last {
            // All tickets before this one have ended.
            held.done_with.drain(..).for_each(|b| self.source.forget(b));
            state.turn += 1;
            self.changed.notify_all();
        }
        Ok(())
    }

    fn write_part(&self, state: &mut State<'_>, mut part: Part) -> Result<()> {
        let numbering = state.labels.entry(part.label).or_default();
        let before = numbering.front_bytes();
        numbering.start(&mut part.piece);
        numbering.pass(self.blocks.range.max, part.at, &part.out, &mut part.piece)?;
        numbering.end(&part.piece);
        state.front_bytes = state.front_bytes + numbering.front_bytes() - before;
        let totals = numbering.totals;
        let capacity = state.sink.capacity();
        if totals.vertices > capacity.vertices || totals.triangles > capacity.triangles {
            return Err(Error::new(
                ErrorKind::LimitExceeded,
                format!(
                    "the mesh of label {} has more than {} vertices or {} triangles, which the output format \
                     cannot hold: choose another format or a smaller region",
                    part.label, capacity.vertices, capacity.triangles
                ),
            ));
        }
        let bytes = state.front_bytes + LABEL_BYTES * state.labels.len() as u64;
        state.stats.front_bytes_max = state.stats.front_bytes_max.max(bytes);
        if !state.front.try_resize(bytes) {
            let count = state.labels.len();
            self.budget
                .take(bytes - state.front.bytes(), "the fronts of the labels")
                .map_err(|e| {
                    e.context(format!(
                        "{count} labels so far, all meshed in one pass; fewer at one time need less (--labels 1,2,5)"
                    ))
                })?;
        }
        state.stats.active_cells += part.out.active_cells;
        if part.piece.triangles.is_empty() {
            return Ok(());
        }
        state.sink.write(part.label, &part.piece)
    }
}

/// Tells the other threads when one panics, so that none waits for it.
struct Alarm<'a, 'b>(&'a Sweep<'b>);

impl Drop for Alarm<'_, '_> {
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
