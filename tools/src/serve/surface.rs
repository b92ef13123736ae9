//! Surfaces: meshes as files, and pictures of them.

use super::query::{Query, number};
use super::refusal::Refusal;
use super::shelf::Shown;
use crate::args::InsideMode;
use crate::cmd::mesh::crossed_blocks;
use crate::parse;
use crate::picture::Picture;
use crate::render::{Look, Raster, View, crossing_bounds};
use brickmarch::iso::{Extract, extract};
use brickmarch::mesh::{Layout, Piece, Totals};
use brickmarch::{
    Box3, Budget, CancelToken, Error, ErrorKind, Field, Inside, Kind, MeshSink, Result,
};
use std::path::Path;

/// Samples that one surface may make us look at.
const SAMPLES_MAX: u64 = 1 << 28;
/// Largest picture, in pixels.
const PIXELS_MAX: u32 = 1 << 20;

/// Which surface.
pub(super) struct Surface {
    iso: Option<f32>,
    label: Option<u32>,
    inside: Option<Inside>,
}

impl Surface {
    pub(super) fn of(query: &Query) -> Result<Surface, Refusal> {
        let surface = Surface {
            iso: query.get("iso", parse::isovalue)?,
            label: query.get("label", number)?,
            inside: query.word::<InsideMode>("inside")?.map(|mode| match mode {
                InsideMode::Above => Inside::Above,
                InsideMode::Below => Inside::Below,
            }),
        };
        if surface.iso.is_some() == surface.label.is_some() {
            return Err(Refusal::bad("give either iso or label"));
        }
        Ok(surface)
    }

    /// Calls `work` with the field and the options that make the surface.
    fn of_field<T>(
        &self,
        shown: &Shown,
        region: Option<Box3>,
        budget: &Budget,
        work: impl FnOnce(&dyn Field, &Extract) -> Result<T>,
    ) -> Result<T, Refusal> {
        let volume = &shown.volume;
        let label;
        let (field, iso): (&dyn Field, f32) = match (self.label, self.iso) {
            (Some(id), _) => {
                label = volume.label(id);
                (&label, 0.5)
            }
            (None, iso) if volume.kind() != Kind::Label => (volume, iso.unwrap_or(0.0)),
            _ => {
                return Err(Refusal::bad(
                    "this is a label volume: give label instead of iso",
                ));
            }
        };
        let options = Extract {
            iso,
            inside: self.inside,
            region,
            ..Extract::default()
        };
        let domain = field.grid().domain;
        let blocks = crossed_blocks(field, region.unwrap_or(domain), iso, budget)?;
        if blocks.saturating_mul(u64::from(field.block_edge()).pow(3)) > SAMPLES_MAX {
            return Err(Refusal::large(
                "the surface is too large for one answer: take a coarser level, or a region",
            ));
        }
        work(field, &options).map_err(|e| match e.kind() {
            // Nobody else uses this share: coming again would not help.
            ErrorKind::BudgetExceeded => Refusal::large(format!("{e}, or take a coarser level")),
            _ => Refusal::from(e),
        })
    }

    /// Writes the mesh to `path`.
    ///
    /// # Errors
    /// 413 when it would have more than `bytes_max` bytes.
    pub(super) fn mesh(
        &self,
        shown: &Shown,
        region: Option<Box3>,
        path: &Path,
        bytes_max: u64,
        budget: &Budget,
    ) -> Result<(), Refusal> {
        self.of_field(shown, region, budget, |field, options| {
            let mut sink = Capped {
                file: brickmarch_formats::create_mesh_sink(path, false)?,
                // A triangle of PLY takes 13 bytes and half a vertex, one of STL 50.
                triangles_max: bytes_max
                    / match path.extension() {
                        Some(e) if e == "stl" => 50,
                        _ => 19,
                    },
            };
            extract(field, options, budget, &mut sink)?;
            Ok(())
        })
    }

    /// Draws it.
    pub(super) fn picture(
        &self,
        shown: &Shown,
        look: &Look,
        budget: &Budget,
    ) -> Result<Picture, Refusal> {
        self.of_field(shown, None, budget, |field, options| {
            let inside = options.inside.unwrap_or(field.kind().inside());
            let bounds = crossing_bounds(field, field.grid().domain, options.iso, inside)?;
            let mut raster = Raster::new(look, &bounds, budget)?;
            let options = Extract {
                normals: true,
                ..options.clone()
            };
            extract(field, &options, budget, &mut raster)?;
            raster.picture(budget)
        })
    }
}

/// What a preview looks like.
pub(super) fn look(query: &Query) -> Result<Look, Refusal> {
    let [width, height] = query.get("size", parse::pixels)?.unwrap_or([480, 400]);
    if width * height > PIXELS_MAX {
        return Err(Refusal::large(format!(
            "a preview has at most {PIXELS_MAX} pixels"
        )));
    }
    let view = query.get("view", parse::view)?.unwrap_or([30.0, 25.0]);
    Ok(Look {
        width,
        height,
        view: View {
            azimuth_deg: view[0],
            elevation_deg: view[1],
        },
        colour: query
            .get("colour", parse::colour)?
            .unwrap_or(Look::default().colour),
        ..Look::default()
    })
}

/// Memory that a surface gets while it is made: for a picture of this look, and for meshing.
///
/// # Errors
/// 413 when the picture alone would take too much of `all`.
pub(super) fn memory(look: Option<&Look>, all: u64) -> Result<u64, Refusal> {
    let picture = look.map_or(0, Raster::memory_bytes);
    let share = (picture + all / 8).max(all / 4);
    if share > all / 8 * 3 {
        return Err(Refusal::large(
            "a picture of this size takes too much of the memory: ask for a smaller one",
        ));
    }
    Ok(share)
}

/// Cancels the work of a client that has gone.
pub(super) struct CancelOnDrop(pub(super) CancelToken);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.cancel();
    }
}

/// A mesh file that does not grow beyond a limit.
struct Capped {
    file: Box<dyn MeshSink>,
    triangles_max: u64,
}

impl MeshSink for Capped {
    fn capacity(&self) -> Totals {
        self.file.capacity()
    }

    fn begin(&mut self, layout: Layout) -> Result<()> {
        self.file.begin(layout)
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        if piece.first_triangle + piece.triangles.len() as u64 > self.triangles_max {
            return Err(Error::new(
                ErrorKind::LimitExceeded,
                "the mesh is larger than --max-region-bytes allows: take a coarser level, or a region",
            ));
        }
        self.file.write(piece)
    }

    fn finish(&mut self, totals: Totals) -> Result<()> {
        self.file.finish(totals)
    }
}
