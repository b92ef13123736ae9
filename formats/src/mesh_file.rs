//! Mesh files by extension.

use crate::aside;
use crate::loaded::{Input, Loaded};
use crate::mesh_stream::{Encode, Stream};
use crate::{obj::Obj, obj_read::read_obj};
use crate::{ply::Ply, ply_read::ply_in_place, ply_read::read_ply};
use crate::{stl::Stl, stl_read::read_stl};
use brickmarch::mesh::{MeshSink, MeshSource, Totals};
use brickmarch::{Budget, Error, ErrorKind, Result};
use std::fs::File;
use std::path::Path;

/// Mesh formats, by their extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Format {
    Ply,
    Stl,
    Obj,
}

impl Format {
    /// The format that the extension of `path` names, in any case of letters.
    pub(crate) fn of(path: &Path) -> Result<Self> {
        let extension = path
            .extension()
            .map(|e| e.to_string_lossy().to_ascii_lowercase());
        match extension.as_deref() {
            Some("ply") => Ok(Self::Ply),
            Some("stl") => Ok(Self::Stl),
            Some("obj") => Ok(Self::Obj),
            _ => Err(Error::new(
                ErrorKind::Unsupported,
                format!(
                    "{}: the extension names no mesh format; known are .ply, .stl and .obj",
                    path.display()
                ),
            )),
        }
    }
}

/// A sink that writes the mesh file `path`: binary PLY, binary STL or OBJ by its extension.
///
/// The file is written aside in the same folder and gets its name in `finish`; a sink that is
/// dropped before leaves nothing. The bytes do not depend on the order of the pieces. Without
/// `overwrite` an existing file is refused. PLY takes normals and keys, OBJ normals, STL neither.
///
/// # Errors
/// When the extension is unknown, the file exists, or the folder cannot be written.
///
/// # Memory
/// At most 1 MiB a writing thread, 3 MiB at the end. On disk: the file, and until the end half of its triangles once more.
pub fn create_mesh_sink(path: &Path, overwrite: bool) -> Result<Box<dyn MeshSink>> {
    Ok(match Format::of(path)? {
        Format::Ply => Box::new(Stream::create(Ply::default(), path, overwrite)?),
        Format::Stl => Box::new(Stream::create(Stl, path, overwrite)?),
        Format::Obj => Box::new(Stream::create(Obj::default(), path, overwrite)?),
    })
}

/// The same for a mesh whose pieces carry colours.
///
/// # Errors
/// When the format has no colours (all but PLY); those of [`create_mesh_sink`].
pub fn create_colored_mesh_sink(path: &Path, overwrite: bool) -> Result<Box<dyn MeshSink>> {
    match Format::of(path)? {
        Format::Ply => Ok(Box::new(Stream::create(
            Ply::with_colors(),
            path,
            overwrite,
        )?)),
        _ => Err(Error::new(
            ErrorKind::Unsupported,
            format!(
                "{}: only PLY carries colours: give the file a name that ends in .ply",
                path.display()
            ),
        )),
    }
}

/// The same for the meshes of many labels in one file: every face has a `label`.
///
/// # Errors
/// When the format has no labels (all but PLY); those of [`create_mesh_sink`].
pub fn create_labelled_mesh_sink(path: &Path, overwrite: bool) -> Result<Box<dyn MeshSink>> {
    match Format::of(path)? {
        Format::Ply => Ok(Box::new(Stream::create(
            Ply::with_labels(),
            path,
            overwrite,
        )?)),
        _ => Err(Error::new(
            ErrorKind::Unsupported,
            format!(
                "{}: only PLY holds the meshes of several labels: end the name in .ply, or write {{label}} into it \
                 for a file per label",
                path.display()
            ),
        )),
    }
}

/// A nameless file in the folder of `beside`, gone when closed.
///
/// # Errors
/// When the folder cannot be written.
pub fn scratch_file(beside: &Path) -> Result<File> {
    aside::scratch_beside(beside)
}

/// Most vertices and triangles that the format named by the extension of `path` can hold.
///
/// # Errors
/// When the extension names no mesh format.
pub fn mesh_capacity(path: &Path) -> Result<Totals> {
    Ok(match Format::of(path)? {
        Format::Ply => Ply::default().capacity(),
        Format::Stl => Stl.capacity(),
        Format::Obj => Obj::default().capacity(),
    })
}

/// The mesh file `path` to be read in parts where it is, whatever its size; nothing when its format
/// or layout does not allow that. Binary PLY with triangles does, as this program writes it.
///
/// # Errors
/// When the file cannot be read or its header breaks a rule.
pub fn mesh_in_place(path: &Path, budget: &Budget) -> Result<Option<Box<dyn MeshSource>>> {
    match Format::of(path)? {
        Format::Ply => ply_in_place(Input::open(path, budget)?),
        Format::Stl | Format::Obj => Ok(None),
    }
}

/// Reads the mesh file `path`: PLY, STL or OBJ by its extension.
///
/// Polygons become fans of triangles. Equal corners of STL become one vertex; the vertices of PLY
/// and OBJ are those of the file. Normals and keys come from PLY only. Double positions are rounded
/// to f32.
///
/// # Errors
/// When the file cannot be read, breaks a rule of its format, or names a vertex that does not exist;
/// `Truncated` when it is shorter than its counts promise; `BudgetExceeded` before the memory is
/// allocated. Positions that are not finite are no error here; `check` counts them.
///
/// # Memory
/// 12 B a vertex (more with normals and keys) and 12 B a triangle from PLY; while reading, 108 B a triangle from STL and some 500 B a
/// triangle from OBJ with polygons, groups or textures. All under permits of `budget`; what the mesh takes stays in the result.
pub fn read_mesh(path: &Path, budget: &Budget) -> Result<Loaded> {
    let format = Format::of(path)?;
    let input = Input::open(path, budget)?;
    match format {
        Format::Ply => read_ply(input),
        Format::Stl => read_stl(input),
        Format::Obj => read_obj(input),
    }
}
