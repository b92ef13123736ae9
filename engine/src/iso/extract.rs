//! Entry point of extraction: options, statistics.

use super::block::Style;
use super::blocks::Blocks;
use super::dispatch::Level;
use super::place::Placement;
use super::relax::MAX_RELAX_PASSES;
use super::sweep::sweep;
use super::walker::walk;
use crate::budget::Budget;
use crate::error::{Error, ErrorKind, Result};
use crate::field::Field;
use crate::lattice::{Affine, Box3};
use crate::mesh::{Layout, MeshSink, Totals};
use crate::sample::Inside;

/// What happens where the surface leaves the meshed region.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Boundary {
    /// The solid is closed by a cap along the outermost samples: the mesh is always closed.
    #[default]
    Cap,
    /// The surface is left open.
    Cut,
    /// Capped at the border of the domain, open at the border of the region: pieces of several
    /// regions join by key into the capped mesh of the whole.
    Tile,
}

/// Options of [`extract`].
#[derive(Clone, Debug)]
pub struct Extract {
    /// The isovalue. `value >= iso` is above.
    pub iso: f32,
    /// Which side is inside; by kind of the field when `None`.
    pub inside: Option<Inside>,
    /// Only the cells whose lowest corner lies in this box; the whole domain when `None`.
    pub region: Option<Box3>,
    /// What happens at the border.
    pub boundary: Boundary,
    /// Only the surfaces through these cells (by their lowest corner); all when empty.
    pub seeds: Vec<[i32; 3]>,
    /// Whether vertices carry unit normals from the gradient of the field.
    pub normals: bool,
    /// Whether vertices carry the key of their lattice edge.
    pub keys: bool,
    /// Positions in index space instead of world space.
    pub index_space: bool,
    /// Passes of relaxation, up to [`MAX_RELAX_PASSES`](super::MAX_RELAX_PASSES): vertices slide along the surface
    /// for better angles, at most half a cell along each axis of the lattice. Three are enough.
    pub relax: u8,
    /// Whether an empty mesh is a result rather than an error.
    pub allow_empty: bool,
}

impl Default for Extract {
    fn default() -> Self {
        Self {
            iso: 0.0,
            inside: None,
            region: None,
            boundary: Boundary::Cap,
            seeds: Vec::new(),
            normals: false,
            keys: false,
            index_space: false,
            relax: 0,
            allow_empty: false,
        }
    }
}

/// What extraction did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stats {
    /// Vertices of the mesh.
    pub vertices: u64,
    /// Triangles of the mesh.
    pub triangles: u64,
    /// Vertices inside cells (the others lie on lattice edges).
    pub interior_vertices: u64,
    /// Cells that the surface crosses, as far as they were met.
    pub active_cells: u64,
    /// Faces of cells whose corners alternate, as decided.
    pub ambiguous_faces: u64,
    /// Blocks whose samples were looked at.
    pub blocks_visited: u64,
    /// Blocks decoded from storage while this ran.
    pub blocks_decoded: u64,
    /// Most bytes that the front took at one time.
    pub front_bytes_max: u64,
}

/// Meshes the surface `field == iso`. Vertices are in world units; triangles wind
/// counter-clockwise seen from outside. The result does not depend on the budget.
///
/// # Errors
/// `EmptySurface` when nothing crosses the isovalue (the message gives the range), `BadInput` for a
/// seed cell that the surface does not cross or a region outside the domain, and what the field
/// and the sink report.
///
/// # Memory
/// Proportional to the front (blocks met but not finished), never to the volume or the mesh.
pub fn extract(
    field: &dyn Field,
    options: &Extract,
    budget: &Budget,
    sink: &mut dyn MeshSink,
) -> Result<Stats> {
    extract_from(Totals::default(), field, options, budget, sink)
}

/// [`extract`] with the numbers of vertices and triangles going on from `first`.
pub(super) fn extract_from(
    first: Totals,
    field: &dyn Field,
    options: &Extract,
    budget: &Budget,
    sink: &mut dyn MeshSink,
) -> Result<Stats> {
    let (blocks, style) = prepare(field, options)?;
    let walking = !options.seeds.is_empty();
    let decoded = field.blocks_decoded();
    sink.begin(Layout {
        normals: options.normals,
        keys: options.keys,
    })?;
    let (mut stats, totals) = if walking {
        walk(field, blocks, style, &options.seeds, first, budget, sink)?
    } else {
        sweep(field, blocks, style, first, budget, sink)?
    };
    if totals == first && !options.allow_empty {
        return Err(empty(field, options, style.inside)?);
    }
    sink.finish(totals)?;
    stats.vertices = totals.vertices - first.vertices;
    stats.triangles = totals.triangles - first.triangles;
    stats.blocks_decoded = field.blocks_decoded() - decoded;
    Ok(stats)
}

/// The blocks and the style that the options ask for.
pub(super) fn prepare(field: &dyn Field, options: &Extract) -> Result<(Blocks, Style)> {
    if options.iso.is_nan() {
        return Err(Error::bad_input("the isovalue is not a number"));
    }
    if options.relax > MAX_RELAX_PASSES {
        return Err(Error::bad_input(format!(
            "{} passes of relaxation: {MAX_RELAX_PASSES} are the most",
            options.relax
        )));
    }
    let grid = field.grid();
    let map = if options.index_space {
        Affine::IDENTITY
    } else {
        grid.index_to_world
    };
    let blocks = Blocks::new(field, options.region, options.boundary)?;
    let style = Style {
        iso: options.iso,
        inside: options.inside.unwrap_or(field.kind().inside()),
        placement: Placement::new(map, grid.domain)?,
        normals: options.normals,
        // The walker knows its vertices by key, and so does who moves them.
        keys: options.keys || !options.seeds.is_empty() || options.relax > 0,
        relax: options.relax,
        level: Level::detect(),
    };
    Ok((blocks, style))
}

fn empty(field: &dyn Field, options: &Extract, inside: Inside) -> Result<Error> {
    let region = options.region.unwrap_or(field.grid().domain);
    let range = field.range(region)?;
    let side = match inside {
        Inside::Above => "above",
        Inside::Below => "below",
    };
    Ok(Error::new(
        ErrorKind::EmptySurface,
        format!(
            "no surface at isovalue {} (inside is {side}): the values in {region} lie in {} to {}; choose an \
             isovalue between them, or allow an empty mesh (--allow-empty)",
            options.iso, range.min, range.max
        ),
    ))
}
