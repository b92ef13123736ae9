//! A mesh made in parts, on any machine and in any order, and joined to the bytes of a single run.
//!
//! The blocks of a mesh have an order; a part is a run of them. It keeps for every block its vertices,
//! its triangles, and which of its vertices lie on its faces. Global numbers are given when all parts
//! are there, block by block as ever, so joined parts cannot differ from a mesh made at once.

mod file;

use self::file::{Head, PartReader, PartWriter, Record};
use super::block::BlockOutput;
use super::blocks::Candidates;
use super::extract::{Extract, Stats, prepare};
use super::numbering::Numbering;
use super::sweep::sweep_some;
use crate::budget::Budget;
use crate::error::{Error, ErrorKind, Result};
use crate::field::Field;
use crate::mesh::{Layout, MeshSink, Piece};
use std::io::{Read, Write};
use std::path::Path;

/// Which part of how many.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// From 1.
    pub number: u32,
    /// How many there are.
    pub of: u32,
}

impl Part {
    /// The blocks of this part among `all`, half-open.
    fn range(self, all: u64) -> (u64, u64) {
        let at = |n: u32| (u128::from(all) * u128::from(n) / u128::from(self.of)) as u64;
        (at(self.number - 1), at(self.number))
    }
}

/// Meshes one part of a surface and writes it to `out`; [`join_parts`] makes the mesh. Parts have
/// equal numbers of blocks that the surface may cross. `name` is for messages.
///
/// # Errors
/// `BadInput` for options that cannot be cut in parts (seeds) and a part that is none; what
/// [`extract`](super::extract()) reports, but no `EmptySurface`.
///
/// # Memory
/// As [`extract`](super::extract()).
pub fn extract_part(
    field: &dyn Field,
    options: &Extract,
    part: Part,
    budget: &Budget,
    out: &mut (dyn Write + Send),
    name: &Path,
) -> Result<Stats> {
    if part.number == 0 || part.number > part.of || part.of > 1 << 20 {
        return Err(Error::bad_input(format!(
            "part {} of {}: number from 1 to the count, at most 2^20 of them",
            part.number, part.of
        )));
    }
    if !options.seeds.is_empty() {
        return Err(Error::bad_input(
            "a surface found from seeds is one march and cannot be made in parts: leave the seeds out",
        ));
    }
    let (blocks, style) = prepare(field, options)?;
    let inside = style.inside;
    let mut all = 0;
    let mut candidates = Candidates::new(field, blocks, options.iso, inside);
    while candidates.next()?.is_some() {
        all += 1;
        if all % 1024 == 0 {
            budget.check_cancelled()?;
        }
    }
    let head = Head {
        question: question(field, options, style.inside as u32),
        part,
        layout: Layout {
            normals: options.normals,
            keys: options.keys,
        },
        end: blocks.range.max,
    };
    let mut writer = PartWriter::begin(out, name, &head)?;
    let decoded = field.blocks_decoded();
    let (from, to) = part.range(all);
    let candidates = Candidates::new(field, blocks, options.iso, inside).only(from, to);
    let mut keep = |piece: &Piece, blocks: &[([i32; 3], BlockOutput)], visited: u64| {
        writer.put(piece, blocks, visited)
    };
    let (mut stats, totals) = sweep_some(candidates, style, budget, &mut keep)?;
    writer.finish()?;
    stats.vertices = totals.vertices;
    stats.triangles = totals.triangles;
    stats.blocks_decoded = field.blocks_decoded() - decoded;
    Ok(stats)
}

/// Which part a file is, by its head.
///
/// # Errors
/// `Damaged` when it is no part of a mesh.
pub fn part_of(name: &Path, mut source: &mut dyn Read) -> Result<Part> {
    let source = &mut source;
    Ok(PartReader { source, name }.head()?.part)
}

/// Joins all parts of a mesh, given in their order, into `sink`. The names are for messages.
///
/// # Errors
/// `BadInput` for parts of different meshes, missing or twice; `Damaged` for a part that is not whole;
/// `EmptySurface` when there is no triangle, unless `allow_empty`; what the sink reports.
///
/// # Memory
/// One record of a part, some MiB, and the front.
pub fn join_parts(
    parts: &mut [(&Path, &mut dyn Read)],
    allow_empty: bool,
    budget: &Budget,
    sink: &mut dyn MeshSink,
) -> Result<Stats> {
    let mut join = Join {
        numbering: Numbering::default(),
        stats: Stats::default(),
        record: Record::default(),
    };
    let mut payload = Vec::new();
    let mut first: Option<Head> = None;
    let count = parts.len() as u32;
    for (n, (name, source)) in parts.iter_mut().enumerate() {
        let name: &Path = name;
        let mut source = PartReader { source, name };
        let head = source.head()?;
        if head.part.of != count || head.part.number != n as u32 + 1 {
            return Err(Error::bad_input(format!(
                "{}: is part {} of {}: give every part once, {count} were given",
                name.display(),
                head.part.number,
                head.part.of
            )));
        }
        match &first {
            None => sink.begin(head.layout)?,
            Some(first) if first.same_mesh(&head) => {}
            Some(_) => {
                return Err(Error::bad_input(format!(
                    "{}: is a part of another mesh, by isovalue, region, options or volume",
                    name.display()
                )));
            }
        }
        let mut records = 1;
        while let Some(_permit) = source.record(&mut payload, budget)? {
            budget.check_cancelled()?;
            join.record
                .read(&payload, head.layout)
                .and_then(|()| join.take(head.end, sink))
                .map_err(|e| e.context(name.display()))?;
            records += 1;
        }
        source.end(records)?;
        first.get_or_insert(head);
    }
    let Some(_) = first else {
        return Err(Error::bad_input("no parts were given"));
    };
    let totals = join.numbering.totals;
    if totals.triangles == 0 && !allow_empty {
        return Err(Error::new(
            ErrorKind::EmptySurface,
            "the parts hold no triangle: nothing crosses the isovalue; allow an empty mesh (--allow-empty)",
        ));
    }
    sink.finish(totals)?;
    join.stats.vertices = totals.vertices;
    join.stats.triangles = totals.triangles;
    join.stats.front_bytes_max = join.numbering.front_bytes_max;
    Ok(join.stats)
}

/// What a mesh depends on, as one number.
fn question(field: &dyn Field, options: &Extract, inside: u32) -> u32 {
    let grid = field.grid();
    let mut bytes = Vec::new();
    let region = options.region.unwrap_or(grid.domain);
    for point in [grid.domain.min, grid.domain.max, region.min, region.max] {
        bytes.extend(point.iter().flat_map(|v| v.to_le_bytes()));
    }
    for v in grid.index_to_world.rows.iter().flatten() {
        bytes.extend(v.to_le_bytes());
    }
    bytes.extend(options.iso.to_le_bytes());
    bytes.extend([
        inside as u8,
        options.boundary as u8,
        options.index_space.into(),
        field.block_edge().min(255) as u8,
        options.relax,
    ]);
    crc32c::crc32c(&bytes)
}

/// The joined mesh so far.
struct Join {
    numbering: Numbering,
    stats: Stats,
    record: Record,
}

impl Join {
    /// Numbers the blocks of the record and hands its piece on.
    fn take(&mut self, end: [i32; 3], sink: &mut dyn MeshSink) -> Result<()> {
        let Record {
            piece,
            blocks,
            visited,
        } = &mut self.record;
        self.stats.blocks_visited += *visited;
        self.numbering.start(piece);
        for (at, out) in blocks.iter() {
            self.numbering.pass(end, *at, out, piece)?;
            self.stats.active_cells += out.active_cells;
            self.stats.ambiguous_faces += out.ambiguous_faces;
            self.stats.interior_vertices += out.interior_vertices;
        }
        if piece.ids.contains(&u64::MAX) {
            return Err(file::not_what_it_says());
        }
        self.numbering.end(piece);
        let (totals, capacity) = (self.numbering.totals, sink.capacity());
        if totals.vertices > capacity.vertices || totals.triangles > capacity.triangles {
            return Err(Error::new(
                ErrorKind::LimitExceeded,
                "the mesh is larger than the output format can hold: choose another format",
            ));
        }
        if piece.triangles.is_empty() && piece.own.is_empty() {
            return Ok(());
        }
        sink.write(piece)
    }
}
