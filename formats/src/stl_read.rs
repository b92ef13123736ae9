//! STL, binary and text, into an indexed mesh: equal corners become one vertex.
//!
//! The parser crate reads the triangles; what goes to it is arranged before, because it takes any
//! binary file whose title begins with "solid" for text, and stops after the first of several
//! solids of a text.

use crate::lines::Rewrite;
use crate::loaded::{Input, Loaded, push};
use brickmarch::{ErrorKind, Mesh, Permit, Result};
use std::io::{BufReader, Read, Seek, SeekFrom};

const HEADER_BYTES: u64 = 84;
const TRIANGLE_BYTES: u64 = 50;

/// Bytes that a triangle takes while vertices are joined.
const WORK_BYTES: u64 = 3 * (size_of::<Corner>() as u64 + 4 + 4 + 12);

/// Bits of the position, number of the corner.
type Corner = ([u32; 3], u32);

pub(crate) fn read_stl(mut input: Input) -> Result<Loaded> {
    let mut head = Vec::new();
    (&mut input.file)
        .take(HEADER_BYTES)
        .read_to_end(&mut head)
        .and_then(|_| input.file.rewind())
        .map_err(|e| input.io(e))?;
    let count = head
        .get(80..84)
        .map(|bytes| u64::from(u32::from_le_bytes(bytes.try_into().expect("four bytes"))));
    let exact = |count: u64| HEADER_BYTES + count * TRIANGLE_BYTES == input.length;
    let named = head.trim_ascii_start().len() >= 5
        && head.trim_ascii_start()[..5].eq_ignore_ascii_case(b"solid");
    if named && !count.is_some_and(exact) {
        read_text(&input)
    } else {
        match count {
            Some(count) => read_binary(&input, count),
            None => Err(input.truncated("shorter than the header of an STL file")),
        }
    }
}

fn read_binary(input: &Input, count: u64) -> Result<Loaded> {
    let needed = HEADER_BYTES + count * TRIANGLE_BYTES;
    if needed > input.length {
        return Err(input.truncated(format_args!(
            "{count} triangles take {needed} bytes; the file has {}",
            input.length
        )));
    }
    if input.length - needed >= TRIANGLE_BYTES {
        // A wrong count, as a writer leaves it that stopped before it knew.
        return Err(input.damaged(format_args!(
            "the header counts {count} triangles; there are {} bytes more",
            input.length - needed
        )));
    }
    let permit = input.take(count * WORK_BYTES)?;
    let mut corners = Vec::new();
    corners.reserve_exact(3 * count as usize);
    let mut source = Untitled {
        source: BufReader::with_capacity(1 << 16, &input.file),
        position: 0,
    };
    let triangles = stl_io::create_stl_reader(&mut source).map_err(|e| input.io(e))?;
    for triangle in triangles {
        let triangle = triangle.map_err(|e| input.io(e))?;
        for vertex in triangle.vertices {
            add_corner(input, &mut corners, vertex.0, None)?;
        }
    }
    weld(input, corners, permit)
}

fn read_text(input: &Input) -> Result<Loaded> {
    let mut permit = input.take(1 << 16)?;
    let mut corners = Vec::new();
    let mut open = false;
    // One solid for all of them, in lower case.
    let rewrite = |line: Option<(u64, &str)>, out: &mut Vec<u8>| {
        let Some((number, text)) = line else {
            if open {
                return Err(input.truncated("the text ends inside a solid"));
            }
            out.extend(b"endsolid\n");
            return Ok(());
        };
        if number == 1 {
            open = false;
            out.extend(b"solid all\n");
        }
        let text = text.trim().to_ascii_lowercase();
        match text.split_whitespace().next() {
            Some("solid") => open = true,
            Some("endsolid") => open = false,
            None => {}
            Some(_) => {
                out.extend(text.as_bytes());
                out.push(b'\n');
            }
        }
        Ok(())
    };
    let mut source = Rewrite::new(BufReader::with_capacity(1 << 16, &input.file), rewrite);
    let result = text_corners(input, &mut source, &mut corners, &mut permit);
    if let Some(failure) = source.failure.take() {
        return Err(failure);
    }
    result?;
    let triangles = corners.len() as u64 / 3;
    if !permit.try_resize(triangles * WORK_BYTES) {
        drop(permit);
        permit = input.take(triangles * WORK_BYTES)?;
    }
    corners.shrink_to_fit();
    weld(input, corners, permit)
}

fn text_corners<S: Read + Seek>(
    input: &Input,
    source: &mut S,
    corners: &mut Vec<Corner>,
    permit: &mut Permit,
) -> Result<()> {
    let failed = |e: std::io::Error| match e.kind() {
        std::io::ErrorKind::InvalidData => input.damaged(e),
        std::io::ErrorKind::UnexpectedEof => input.truncated(e),
        _ => input.io(e),
    };
    for triangle in stl_io::create_stl_reader(source).map_err(failed)? {
        for vertex in triangle.map_err(failed)?.vertices {
            add_corner(input, corners, vertex.0, Some(permit))?;
        }
    }
    Ok(())
}

fn add_corner(
    input: &Input,
    corners: &mut Vec<Corner>,
    position: [f32; 3],
    permit: Option<&mut Permit>,
) -> Result<()> {
    let number = u32::try_from(corners.len()).map_err(|_| {
        input.error(
            ErrorKind::LimitExceeded,
            "more than 2^32 corners cannot be joined in memory",
        )
    })?;
    // Adding zero makes the two zeros one.
    let corner = (position.map(|x| (x + 0.0).to_bits()), number);
    match permit {
        Some(permit) => push(corners, corner, permit, input)?,
        None => corners.push(corner),
    }
    Ok(())
}

/// Joins corners at the same position, bit for bit, numbered by their first appearance.
fn weld(input: &Input, mut corners: Vec<Corner>, permit: Permit) -> Result<Loaded> {
    input.budget.check_cancelled()?;
    corners.sort_unstable();
    let mut mesh = Mesh {
        triangles: vec![[0; 3]; corners.len() / 3],
        ..Mesh::default()
    };
    let flat = mesh.triangles.as_flattened_mut();
    let mut groups = 0;
    for group in corners.chunk_by(|a, b| a.0 == b.0) {
        for &(_, corner) in group {
            flat[corner as usize] = groups;
        }
        groups += 1;
    }
    let mut numbers = vec![u32::MAX; groups as usize];
    let mut next = 0;
    for corner in flat {
        let number = &mut numbers[*corner as usize];
        if *number == u32::MAX {
            *number = next;
            next += 1;
        }
        *corner = *number;
    }
    mesh.positions = vec![[0.0; 3]; groups as usize];
    for (group, &number) in corners.chunk_by(|a, b| a.0 == b.0).zip(&numbers) {
        mesh.positions[number as usize] = group[0].0.map(f32::from_bits);
    }
    drop((corners, numbers));
    Ok(Loaded::new(mesh, permit))
}

/// A binary file whose title reads as spaces.
struct Untitled<R> {
    source: R,
    position: u64,
}

impl<R: Read> Read for Untitled<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.source.read(buffer)?;
        let title = 80_u64.saturating_sub(self.position).min(count as u64);
        buffer[..title as usize].fill(b' ');
        self.position += count as u64;
        Ok(count)
    }
}

impl<R: Seek> Seek for Untitled<R> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.position = self.source.seek(to)?;
        Ok(self.position)
    }
}
