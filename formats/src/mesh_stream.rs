//! The sink behind every mesh format: records of fixed size at computed places.
//!
//! Every format here has a header of known size, then one record a vertex, then one record a
//! triangle, all of fixed size. So a piece knows where its records go, threads write without
//! waiting for each other, and the bytes do not depend on the order of the pieces. The number of
//! vertices is known only at the end; until then triangles wait in a nameless scratch file in the
//! same folder, in half of the room (`waiting.rs`), which is given back while they are written.

use crate::aside::{Aside, write_all_at};
use crate::waiting::{RECORD_TRIANGLES, Waiting};
use brickmarch::mesh::{Layout, MeshSink, Piece, Totals};
use brickmarch::{Error, ErrorKind, Result};
use std::fs::File;
use std::ops::Range;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes that one write call carries at most, which bounds the buffer of a thread.
const BLOCK_BYTES: usize = 1 << 20;

/// Sizes in bytes of the parts of a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Shape {
    /// The header.
    pub(crate) header: u64,
    /// Record of a vertex; 0 in formats without vertices.
    pub(crate) vertex: usize,
    /// Record of a triangle.
    pub(crate) triangle: usize,
}

/// What a format adds to the stream.
pub(crate) trait Encode: Send + Sync {
    /// Most vertices and triangles that the format can hold.
    fn capacity(&self) -> Totals;

    /// Fixes the layout and with it the sizes.
    ///
    /// # Errors
    /// When the format cannot hold it.
    fn begin(&mut self, layout: Layout) -> Result<Shape>;

    /// Fills `out` with the records of `piece.own[range]`.
    fn vertices(&self, piece: &Piece, range: Range<usize>, out: &mut [u8]);

    /// Fills `out` with the records of `piece.triangles[range]`.
    fn triangles(&self, piece: &Piece, range: Range<usize>, out: &mut [u8]);

    /// The header of a finished file, `Shape::header` bytes.
    fn header(&self, totals: Totals) -> Vec<u8>;
}

/// A mesh file in the making.
pub(crate) struct Stream<E> {
    encode: E,
    shape: Shape,
    output: Option<Output>,
    vertices: AtomicU64,
    triangles: AtomicU64,
    /// Buffers of threads that are not writing now.
    buffers: Mutex<Vec<Vec<u8>>>,
}

struct Output {
    aside: Aside,
    /// Triangles until the number of vertices is known.
    waiting: Option<Waiting>,
}

impl<E: Encode> Stream<E> {
    pub(crate) fn create(encode: E, path: &Path, overwrite: bool) -> Result<Self> {
        let aside = Aside::create(path, overwrite)?;
        Ok(Self {
            encode,
            shape: Shape::default(),
            output: Some(Output {
                aside,
                waiting: None,
            }),
            vertices: AtomicU64::new(0),
            triangles: AtomicU64::new(0),
            buffers: Mutex::default(),
        })
    }

    /// Writes the triangles of `piece` to their place behind `base`.
    fn write_triangles(
        &self,
        file: &File,
        base: u64,
        piece: &Piece,
        buffer: &mut Vec<u8>,
    ) -> std::io::Result<()> {
        let size = self.shape.triangle;
        let offset = place(base, piece.first_triangle, size)?;
        let encode = |range: Range<usize>, out: &mut [u8]| self.encode.triangles(piece, range, out);
        write_records(file, buffer, piece.triangles.len(), size, offset, encode)
    }

    fn check_room(&self, piece: &Piece, path: &Path) -> Result<()> {
        let capacity = self.encode.capacity();
        let beyond = |first: u64, count: usize, most: u64| {
            first.checked_add(count as u64).is_none_or(|end| end > most)
        };
        let foreign = || piece.ids.iter().any(|&id| id >= capacity.vertices);
        if beyond(piece.first_vertex, piece.own.len(), capacity.vertices)
            || (capacity.vertices != u64::MAX && foreign())
        {
            return Err(full(path, capacity.vertices, "vertices"));
        }
        if beyond(
            piece.first_triangle,
            piece.triangles.len(),
            capacity.triangles,
        ) {
            return Err(full(path, capacity.triangles, "triangles"));
        }
        Ok(())
    }
}

fn full(path: &Path, most: u64, what: &str) -> Error {
    Error::new(
        ErrorKind::LimitExceeded,
        format!(
            "{}: this format holds at most {most} {what}: take another format or mesh a smaller region",
            path.display()
        ),
    )
}

/// Encodes `count` records of `size` bytes block by block and writes them from `offset` on.
fn write_records(
    file: &File,
    buffer: &mut Vec<u8>,
    count: usize,
    size: usize,
    mut offset: u64,
    encode: impl Fn(Range<usize>, &mut [u8]),
) -> std::io::Result<()> {
    let block = (BLOCK_BYTES / size).max(1);
    for start in (0..count).step_by(block) {
        let end = count.min(start + block);
        let bytes = (end - start) * size;
        if buffer.len() < bytes {
            buffer.resize(bytes, 0);
        }
        encode(start..end, &mut buffer[..bytes]);
        write_all_at(file, &buffer[..bytes], offset)?;
        offset += bytes as u64;
    }
    Ok(())
}

/// Where record `first` of a part that starts at `base` is.
fn place(base: u64, first: u64, size: usize) -> std::io::Result<u64> {
    first
        .checked_mul(size as u64)
        .and_then(|bytes| bytes.checked_add(base))
        .ok_or_else(|| std::io::ErrorKind::FileTooLarge.into())
}

impl<E: Encode> MeshSink for Stream<E> {
    fn capacity(&self) -> Totals {
        self.encode.capacity()
    }

    fn begin(&mut self, layout: Layout) -> Result<()> {
        let output = self.output.as_mut().ok_or_else(finished)?;
        self.shape = self
            .encode
            .begin(layout)
            .map_err(|e| e.context(output.aside.path().display()))?;
        if self.shape.vertex > 0 {
            output.waiting = Some(Waiting::new(output.aside.scratch()?));
        }
        Ok(())
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        let output = self.output.as_ref().ok_or_else(finished)?;
        let (main, path) = (output.aside.file(), output.aside.path());
        assert!(self.shape.triangle > 0, "begin comes before write");
        self.check_room(piece, path)?;
        let pooled = self.buffers.lock().expect("no writer panicked").pop();
        let mut buffer = pooled.unwrap_or_default();
        if self.shape.vertex > 0 {
            place(self.shape.header, piece.first_vertex, self.shape.vertex)
                .and_then(|offset| {
                    write_records(
                        main,
                        &mut buffer,
                        piece.own.len(),
                        self.shape.vertex,
                        offset,
                        |range, out| self.encode.vertices(piece, range, out),
                    )
                })
                .map_err(|e| Error::io(path, "writing vertices", e))?;
        }
        match &output.waiting {
            Some(waiting) => (0..piece.triangles.len())
                .step_by(RECORD_TRIANGLES)
                .try_for_each(|start| {
                    let end = piece.triangles.len().min(start + RECORD_TRIANGLES);
                    waiting.put(piece, start..end, &mut buffer)
                }),
            None => self.write_triangles(main, self.shape.header, piece, &mut buffer),
        }
        .map_err(|e| Error::io(path, "writing triangles", e))?;
        self.buffers
            .lock()
            .expect("no writer panicked")
            .push(buffer);
        // Counted after the write: a piece that failed is missing from the sum, so that `finish`
        // refuses even when the caller did not listen.
        self.vertices
            .fetch_add(piece.own.len() as u64, Ordering::Relaxed);
        self.triangles
            .fetch_add(piece.triangles.len() as u64, Ordering::Relaxed);
        Ok(())
    }

    fn finish(&mut self, totals: Totals) -> Result<()> {
        let Output { aside, waiting } = self.output.take().ok_or_else(finished)?;
        let path = aside.path();
        let written = Totals {
            vertices: *self.vertices.get_mut(),
            triangles: *self.triangles.get_mut(),
        };
        if written != totals {
            return Err(Error::new(
                ErrorKind::Io,
                format!(
                    "{}: not kept, because parts are missing: {} of {} vertices and {} of {} triangles were written",
                    path.display(),
                    written.vertices,
                    totals.vertices,
                    written.triangles,
                    totals.triangles
                ),
            ));
        }
        let header = self.encode.header(totals);
        assert_eq!(header.len() as u64, self.shape.header, "size of the header");
        write_all_at(aside.file(), &header, 0)
            .map_err(|e| Error::io(path, "writing the header", e))?;
        if let Some(waiting) = waiting {
            // As many threads as have written.
            let threads = self.buffers.get_mut().expect("no writer panicked").len();
            let base = place(self.shape.header, totals.vertices, self.shape.vertex);
            base.and_then(|base| {
                // Whole at once fails early where a file cannot be so large.
                let end = place(base, totals.triangles, self.shape.triangle)?;
                aside.file().set_len(end)?;
                waiting.drain(threads, |piece| {
                    let pooled = self.buffers.lock().expect("no writer panicked").pop();
                    let mut buffer = pooled.unwrap_or_default();
                    let result = self.write_triangles(aside.file(), base, piece, &mut buffer);
                    self.buffers
                        .lock()
                        .expect("no writer panicked")
                        .push(buffer);
                    result
                })
            })
            .map_err(|e| Error::io(path, "writing the triangles behind the vertices", e))?;
        }
        aside.commit()
    }
}

fn finished() -> Error {
    Error::bad_input("the mesh file is finished already")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh_file::create_mesh_sink;
    use brickmarch::Mesh;
    use brickmarch::mesh::{EdgeKey, feed, pieces};

    /// A bent sheet of `n` by `n` squares with normals and keys.
    fn sheet(n: u32) -> Mesh {
        let mut mesh = Mesh::default();
        for y in 0..=n {
            for x in 0..=n {
                let height = ((x * 7 + y * 13) % 11) as f32 * 0.1;
                mesh.positions.push([x as f32 / 3.0, y as f32, height]);
                mesh.normals.push([0.6, 0.0, 0.8]);
                mesh.keys.push(EdgeKey {
                    point: [x as i32, -(y as i32), 70_000],
                    axis: (x % 4) as u8,
                });
            }
        }
        for y in 0..n {
            for x in 0..n {
                let a = y * (n + 1) + x;
                let (b, c, d) = (a + 1, a + n + 2, a + n + 1);
                mesh.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        mesh
    }

    fn totals(mesh: &Mesh) -> Totals {
        Totals {
            vertices: mesh.positions.len() as u64,
            triangles: mesh.triangles.len() as u64,
        }
    }

    fn folder() -> tempfile::TempDir {
        tempfile::tempdir().expect("a temporary folder")
    }

    fn files(folder: &Path) -> usize {
        std::fs::read_dir(folder).expect("the folder").count()
    }

    #[test]
    fn same_bytes_for_any_order_and_threads() {
        let dir = folder();
        for (name, normals, keys) in [
            ("a.ply", false, false),
            ("b.ply", true, false),
            ("c.ply", true, true),
            ("d.stl", false, false),
            ("e.obj", false, false),
            ("f.obj", true, false),
        ] {
            let mut mesh = sheet(60);
            if !normals {
                mesh.normals.clear();
            }
            if !keys {
                mesh.keys.clear();
            }
            let whole = dir.path().join(name);
            let mut sink = create_mesh_sink(&whole, false).expect("made");
            feed(&mesh, &mut *sink, usize::MAX).expect("fed");

            let parts = dir.path().join(format!("parts-{name}"));
            let mut sink = create_mesh_sink(&parts, false).expect("made");
            sink.begin(Layout { normals, keys }).expect("begun");
            let pieces: Vec<Piece> = pieces(&mesh, 97).collect();
            let (odd, even): (Vec<_>, Vec<_>) = (0..pieces.len()).rev().partition(|i| i % 2 == 1);
            std::thread::scope(|scope| {
                for list in [odd, even] {
                    let (sink, pieces) = (&*sink, &pieces);
                    scope.spawn(move || {
                        for i in list {
                            sink.write(&pieces[i]).expect("written");
                        }
                    });
                }
            });
            sink.finish(totals(&mesh)).expect("finished");
            assert!(
                std::fs::read(&whole).expect("read") == std::fs::read(&parts).expect("read"),
                "{name}: bytes depend on the order"
            );
        }
    }

    #[test]
    fn a_block_limit_does_not_show_in_the_file() {
        // 3 x 60,000 triangles are more than one block of every record size.
        let mut mesh = sheet(300);
        mesh.normals.clear();
        mesh.keys.clear();
        let dir = folder();
        for extension in ["ply", "stl", "obj"] {
            for (i, size) in [usize::MAX, 1000].into_iter().enumerate() {
                let path = dir.path().join(format!("{i}.{extension}"));
                let mut sink = create_mesh_sink(&path, false).expect("made");
                feed(&mesh, &mut *sink, size).expect("fed");
            }
            let all = |i| std::fs::read(dir.path().join(format!("{i}.{extension}"))).expect("read");
            assert!(all(0) == all(1), "{extension}");
        }
    }

    #[test]
    fn sizes_are_those_of_the_formats() {
        let mut mesh = sheet(5);
        mesh.normals.clear();
        mesh.keys.clear();
        let dir = folder();
        let length = |name: &str| {
            let path = dir.path().join(name);
            let mut sink = create_mesh_sink(&path, false).expect("made");
            feed(&mesh, &mut *sink, 7).expect("fed");
            std::fs::metadata(&path).expect("there").len()
        };
        assert_eq!(length("a.stl"), 84 + 50 * 50);
        assert_eq!((length("a.ply") - 36 * 12 - 50 * 13) % 16, 0);
        assert_eq!(length("a.obj"), 13 + 36 * 50 + 50 * 41);
    }

    #[test]
    fn an_empty_mesh_is_a_file_too() {
        let dir = folder();
        for extension in ["ply", "stl", "obj"] {
            let path = dir.path().join(format!("empty.{extension}"));
            let mut sink = create_mesh_sink(&path, false).expect("made");
            feed(&Mesh::default(), &mut *sink, 10).expect("fed");
            assert!(path.exists());
        }
    }

    #[test]
    fn dropping_leaves_no_file() {
        let dir = folder();
        let mesh = sheet(4);
        let mut sink = create_mesh_sink(&dir.path().join("x.ply"), false).expect("made");
        sink.begin(Layout::default()).expect("begun");
        for piece in pieces(&mesh, 5) {
            sink.write(&piece).expect("written");
        }
        assert_eq!(files(dir.path()), 1, "the file in the making");
        drop(sink);
        assert_eq!(files(dir.path()), 0);
    }

    #[test]
    fn a_missing_piece_is_an_error_and_leaves_no_file() {
        let dir = folder();
        let mesh = sheet(4);
        let mut sink = create_mesh_sink(&dir.path().join("x.ply"), false).expect("made");
        sink.begin(Layout::default()).expect("begun");
        for piece in pieces(&mesh, 5).skip(1) {
            sink.write(&piece).expect("written");
        }
        let error = sink.finish(totals(&mesh)).expect_err("incomplete");
        assert!(error.to_string().contains("missing"), "{error}");
        assert_eq!(files(dir.path()), 0);
        assert!(sink.finish(totals(&mesh)).is_err(), "finished once only");
    }

    #[test]
    fn an_existing_file_is_kept_without_overwrite() {
        let dir = folder();
        let path = dir.path().join("x.ply");
        std::fs::write(&path, "precious").expect("written");
        let Err(error) = create_mesh_sink(&path, false) else {
            panic!("an existing file was accepted");
        };
        assert_eq!(error.kind(), ErrorKind::BadInput);
        assert!(error.to_string().contains("--overwrite"), "{error}");
        let mesh = sheet(2);
        let mut sink = create_mesh_sink(&path, true).expect("made");
        assert_eq!(std::fs::read(&path).expect("read"), b"precious");
        feed(&mesh, &mut *sink, 3).expect("fed");
        assert!(std::fs::read(&path).expect("read").starts_with(b"ply\n"));
        assert_eq!(files(dir.path()), 1);
    }

    #[test]
    fn a_file_that_appears_meanwhile_is_kept() {
        let dir = folder();
        let path = dir.path().join("x.ply");
        let mut sink = create_mesh_sink(&path, false).expect("made");
        std::fs::write(&path, "precious").expect("written");
        assert!(feed(&sheet(2), &mut *sink, 3).is_err());
        assert_eq!(std::fs::read(&path).expect("read"), b"precious");
        assert_eq!(files(dir.path()), 1);
    }

    #[test]
    fn bad_paths_are_named() {
        let dir = folder();
        std::fs::create_dir(dir.path().join("folder.ply")).expect("made");
        for (path, part) in [
            ("x.vrml", ".ply, .stl and .obj"),
            ("ply", ".ply, .stl and .obj"),
            ("missing/x.ply", "folder"),
            ("folder.ply", "not a regular file"),
        ] {
            let path = dir.path().join(path);
            let Err(error) = create_mesh_sink(&path, true) else {
                panic!("{} was accepted", path.display());
            };
            let text = error.to_string();
            assert!(text.contains(part), "{text}");
            assert!(text.starts_with(&path.display().to_string()), "{text}");
        }
    }

    #[test]
    fn what_a_format_cannot_hold_is_refused() {
        let dir = folder();
        for (name, normals, keys) in [
            ("x.stl", true, false),
            ("x.stl", false, true),
            ("x.obj", true, true),
        ] {
            let mut sink = create_mesh_sink(&dir.path().join(name), false).expect("made");
            let error = sink
                .begin(Layout { normals, keys })
                .expect_err("cannot hold");
            assert_eq!(error.kind(), ErrorKind::Unsupported);
        }
        // Counts past the limit, at the place where the first one is met.
        let far = |first_vertex, first_triangle| Piece {
            first_vertex,
            first_triangle,
            positions: vec![[0.0; 3]],
            ids: vec![first_vertex],
            own: vec![0],
            triangles: vec![[0; 3]],
            ..Piece::default()
        };
        for (name, piece) in [
            ("x.stl", far(0, u64::from(u32::MAX))),
            ("x.ply", far(1 << 32, 0)),
            ("x.ply", far(u64::MAX, 0)),
            ("x.obj", far(10_u64.pow(12), 0)),
        ] {
            let mut sink = create_mesh_sink(&dir.path().join(name), false).expect("made");
            sink.begin(Layout::default()).expect("begun");
            let error = sink.write(&piece).expect_err("too many");
            assert_eq!(error.kind(), ErrorKind::LimitExceeded, "{error}");
            assert!(error.to_string().contains(name), "{error}");
        }
    }

    /// The last vertex that PLY can number and a triangle far behind it, in sparse files.
    #[test]
    #[cfg(unix)]
    #[expect(clippy::print_stderr, reason = "a skipped test says so")]
    fn far_records_stand_where_they_belong() {
        use std::os::unix::fs::FileExt;
        let dir = folder();
        let mut stream =
            Stream::create(crate::ply::Ply::default(), &dir.path().join("x.ply"), false)
                .expect("made");
        stream.begin(Layout::default()).expect("begun");
        let last = (1_u64 << 32) - 1;
        let piece = Piece {
            first_vertex: last,
            first_triangle: 1 << 36,
            positions: vec![[1.0, 2.0, 3.0]],
            ids: vec![last],
            own: vec![0],
            triangles: vec![[0; 3]],
            ..Piece::default()
        };
        match stream.write(&piece) {
            Ok(()) => {}
            Err(e) if e.to_string().contains("too large") => {
                eprintln!("SKIPPED: the file system allows no file of 900 GB: {e}");
                return;
            }
            Err(e) => panic!("{e}"),
        }
        let output = stream.output.as_ref().expect("not finished");
        let mut record = [0; 12];
        output
            .aside
            .file()
            .read_exact_at(&mut record, stream.shape.header + last * 12)
            .expect("there");
        assert_eq!(record[4..8], 2.0_f32.to_le_bytes());
        let (base, mut record) = (stream.shape.header + (last + 1) * 12, [0; 13]);
        let file = output.aside.file();
        let waiting = output.waiting.as_ref().expect("PLY has one");
        waiting
            .drain(1, |piece| {
                stream.write_triangles(file, base, piece, &mut Vec::new())
            })
            .expect("written");
        file.read_exact_at(&mut record, base + (1 << 36) * 13)
            .expect("there");
        assert_eq!(
            record,
            [
                3, 255, 255, 255, 255, 255, 255, 255, 255, 255, 255, 255, 255
            ]
        );
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_full_disk_is_reported_with_the_name_and_leaves_no_file() {
        let dir = folder();
        let path = dir.path().join("x.ply");
        let mesh = sheet(4);
        let full = || {
            std::fs::OpenOptions::new()
                .write(true)
                .open("/dev/full")
                .expect("the full device")
        };
        let mut stream = Stream::create(crate::ply::Ply::default(), &path, false).expect("made");
        stream.begin(Layout::default()).expect("begun");
        stream.output.as_mut().expect("open").waiting = Some(Waiting::new(full()));
        let piece = pieces(&mesh, usize::MAX).next().expect("one piece");
        let error = stream.write(&piece).expect_err("no space");
        assert_eq!(error.kind(), ErrorKind::Io);
        let text = error.to_string();
        assert!(text.starts_with(&path.display().to_string()), "{text}");
        assert!(text.contains("No space left"), "{text}");
        assert!(
            stream.finish(totals(&mesh)).is_err(),
            "an error is not forgotten"
        );
        assert_eq!(files(dir.path()), 0);
    }
}
