//! Mesh files by extension.

use crate::mesh_stream::Stream;
use crate::{obj::Obj, ply::Ply, stl::Stl};
use brickmarch::mesh::MeshSink;
use brickmarch::{Error, ErrorKind, Result};
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
/// At most 1 MiB a writing thread. On disk: the file, and until the end its triangles once more.
pub fn create_mesh_sink(path: &Path, overwrite: bool) -> Result<Box<dyn MeshSink>> {
    Ok(match Format::of(path)? {
        Format::Ply => Box::new(Stream::create(Ply::default(), path, overwrite)?),
        Format::Stl => Box::new(Stream::create(Stl, path, overwrite)?),
        Format::Obj => Box::new(Stream::create(Obj::default(), path, overwrite)?),
    })
}
