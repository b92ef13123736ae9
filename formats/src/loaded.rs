//! A mesh read from a file, with the memory it is allowed to take.

use brickmarch::{Budget, Error, ErrorKind, Mesh, Permit, Result};
use std::fs::File;
use std::ops::Deref;
use std::path::Path;

/// A mesh in memory that holds its share of the budget it was read under.
#[derive(Debug)]
pub struct Loaded {
    mesh: Mesh,
    permit: Permit,
}

impl Loaded {
    /// Takes over `mesh` and cuts `permit` to what the mesh needs.
    pub(crate) fn new(mut mesh: Mesh, mut permit: Permit) -> Self {
        mesh.positions.shrink_to_fit();
        mesh.normals.shrink_to_fit();
        mesh.keys.shrink_to_fit();
        mesh.triangles.shrink_to_fit();
        let needed = bytes(&mesh);
        if needed < permit.bytes() {
            permit.try_resize(needed);
        }
        Self { mesh, permit }
    }

    /// The mesh and its share of the budget, to be kept as long as the mesh.
    pub fn into_parts(self) -> (Mesh, Permit) {
        (self.mesh, self.permit)
    }
}

impl Deref for Loaded {
    type Target = Mesh;

    fn deref(&self) -> &Mesh {
        &self.mesh
    }
}

fn bytes(mesh: &Mesh) -> u64 {
    (size_of_val(&*mesh.positions)
        + size_of_val(&*mesh.normals)
        + size_of_val(&*mesh.keys)
        + size_of_val(&*mesh.triangles)) as u64
}

/// An opened input file.
pub(crate) struct Input<'a> {
    pub(crate) path: &'a Path,
    pub(crate) file: File,
    pub(crate) length: u64,
    pub(crate) budget: &'a Budget,
}

impl<'a> Input<'a> {
    pub(crate) fn open(path: &'a Path, budget: &'a Budget) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io(path, "opening", e))?;
        let about = file
            .metadata()
            .map_err(|e| Error::io(path, "asking for its length", e))?;
        if !about.is_file() {
            return Err(Error::bad_input(format!(
                "{}: is not a regular file",
                path.display()
            )));
        }
        Ok(Self {
            path,
            file,
            length: about.len(),
            budget,
        })
    }

    /// Reserves `bytes` to read this file.
    pub(crate) fn take(&self, bytes: u64) -> Result<Permit> {
        self.budget
            .take(bytes, "reading the mesh")
            .map_err(|e| e.context(self.path.display()))
    }

    /// An error of this file.
    pub(crate) fn error(&self, kind: ErrorKind, message: impl std::fmt::Display) -> Error {
        Error::new(kind, format!("{}: {message}", self.path.display()))
    }

    /// The file breaks a rule of its format.
    pub(crate) fn damaged(&self, message: impl std::fmt::Display) -> Error {
        self.error(ErrorKind::Damaged, message)
    }

    /// The file ends before what it promises.
    pub(crate) fn truncated(&self, message: impl std::fmt::Display) -> Error {
        self.error(ErrorKind::Truncated, message)
    }

    /// An operating system error while reading.
    pub(crate) fn io(&self, source: std::io::Error) -> Error {
        Error::io(self.path, "reading", source)
    }

    /// The number of vertices as the mesh in memory can number them.
    pub(crate) fn vertex_count(&self, count: u64) -> Result<usize> {
        if count > 1 << 32 {
            return Err(self.error(
                ErrorKind::LimitExceeded,
                format_args!("{count} vertices; a mesh in memory holds at most 2^32"),
            ));
        }
        usize::try_from(count).map_err(|_| {
            self.error(
                ErrorKind::LimitExceeded,
                "more vertices than this machine can address",
            )
        })
    }
}

/// Pushes onto `list`; when it must grow, reserves memory for it first.
pub(crate) fn push<T>(
    list: &mut Vec<T>,
    item: T,
    permit: &mut Permit,
    input: &Input,
) -> Result<()> {
    if list.len() == list.capacity() {
        // While the list moves, both places exist.
        let more = (list.len() / 2).max(1024);
        let bytes = ((list.len() + more) * size_of::<T>()) as u64;
        let before = permit.bytes();
        if !permit.try_resize(before + bytes) {
            return Err(input.take(bytes).err().unwrap_or_else(|| {
                input.error(
                    ErrorKind::BudgetExceeded,
                    "the mesh does not fit the budget",
                )
            }));
        }
        list.reserve_exact(more);
        permit.try_resize(before + (more * size_of::<T>()) as u64);
    }
    list.push(item);
    Ok(())
}
