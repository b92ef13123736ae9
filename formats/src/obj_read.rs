//! OBJ into a mesh in memory: positions and faces, everything else is passed over.
//!
//! Files of nothing but triangles, such as ours, are read directly, in the memory of the mesh. All
//! others go through a parser crate, which takes ten times as much. It starts a new mesh at every
//! group and material, which would cut a closed surface along them, and forgets vertices that no
//! face uses. So it gets only `v` and `f` lines, checked and reduced to positions, and before them
//! polygons that name every vertex once in order; the triangles of those are dropped again.

use crate::lines::{Rewrite, next_line};
use crate::loaded::{Input, Loaded};
use brickmarch::{Error, ErrorKind, Mesh, Result};
use std::io::{BufReader, Seek, Write};

/// Corners of the polygons that name every vertex.
const ROLL: u64 = 64;

/// What the first pass counts.
#[derive(Default)]
struct Counts {
    vertices: u64,
    faces: u64,
    corners: u64,
    /// Whether there is a line that is more than a plain vertex, normal or triangle.
    rich: bool,
}

pub(crate) fn read_obj(mut input: Input) -> Result<Loaded> {
    let counts = count(&input)?;
    let vertices = input.vertex_count(counts.vertices)?;
    input.file.rewind().map_err(|e| input.io(e))?;
    if counts.rich {
        read_rich(&input, &counts, vertices)
    } else {
        read_plain(&input, &counts, vertices)
    }
}

fn read_plain(input: &Input, counts: &Counts, vertices: usize) -> Result<Loaded> {
    let permit = input.take(12 * (counts.vertices + counts.faces) + (1 << 16))?;
    let mut mesh = Mesh::default();
    mesh.positions.reserve_exact(vertices);
    mesh.triangles.reserve_exact(counts.faces as usize);
    let mut source = BufReader::with_capacity(1 << 16, &input.file);
    let (mut line, mut number) = (Vec::new(), 0);
    loop {
        let count = next_line(&mut source, &mut line).map_err(|e| input.io(e))?;
        if count == 0 {
            break;
        }
        let failed = |what: String| input.damaged(format_args!("line {}: {what}", number + 1));
        let text = std::str::from_utf8(&line).unwrap_or("#");
        let mut words = text.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let mut point = [0.0; 3];
                for (value, word) in point.iter_mut().zip(words) {
                    *value = coordinate(word).map_err(failed)?;
                }
                mesh.positions.push(point);
            }
            Some("f") => {
                let mut triangle = [0; 3];
                for (corner, word) in triangle.iter_mut().zip(words) {
                    let seen = mesh.positions.len() as u64;
                    let found = corner_number(word, seen, counts.vertices).map_err(failed)?;
                    *corner = (found - 1) as u32;
                }
                mesh.triangles.push(triangle);
            }
            _ => {}
        }
        if number % 65_536 == 0 {
            input.budget.check_cancelled()?;
        }
        number += count;
        let beyond = mesh.positions.len() > vertices || mesh.triangles.len() as u64 > counts.faces;
        if beyond {
            return Err(changed(input));
        }
    }
    if mesh.positions.len() != vertices || mesh.triangles.len() as u64 != counts.faces {
        return Err(changed(input));
    }
    Ok(Loaded::new(mesh, permit))
}

fn read_rich(input: &Input, counts: &Counts, vertices: usize) -> Result<Loaded> {
    if counts.vertices > 1 << 31 {
        return Err(input.error(
            ErrorKind::LimitExceeded,
            "more than 2^31 vertices cannot be read from OBJ with polygons; use PLY",
        ));
    }
    let mut permit = input.take(bytes(counts))?;
    let mut seen = 0;
    let rewrite = |line: Option<(u64, &str)>, out: &mut Vec<u8>| {
        let Some((number, text)) = line else {
            return Ok(());
        };
        let failed = |what: String| input.damaged(format_args!("line {number}: {what}"));
        if number == 1 {
            name_every_vertex(counts.vertices, out);
        }
        let mut words = text.split_whitespace();
        match words.next() {
            Some("v") => {
                seen += 1;
                put_vertex(words, out).map_err(failed)
            }
            Some("f") => put_face(words, seen, counts.vertices, out).map_err(failed),
            _ => Ok(()),
        }
    };
    let source = BufReader::with_capacity(1 << 16, &input.file);
    let mut source = BufReader::new(Rewrite::new(source, rewrite));
    let options = tobj::LoadOptions {
        triangulate: true,
        single_index: false,
        ..tobj::LoadOptions::default()
    };
    let result = tobj::load_obj_buf(&mut source, &options, |_| {
        Err(tobj::LoadError::OpenFileFailed)
    });
    if let Some(failure) = source.into_inner().failure {
        return Err(failure);
    }
    let (models, _) = result.map_err(|e| input.damaged(e))?;
    let parsed = models
        .into_iter()
        .next()
        .map(|model| model.mesh)
        .unwrap_or_default();
    let roll = 3 * roll_triangles(counts.vertices) as usize;
    let (positions, _) = parsed.positions.as_chunks::<3>();
    let (triangles, _) = parsed.indices[roll.min(parsed.indices.len())..].as_chunks::<3>();
    if positions.len() != vertices {
        return Err(changed(input));
    }
    let mesh = Mesh {
        positions: positions.to_vec(),
        triangles: triangles.to_vec(),
        ..Mesh::default()
    };
    drop(parsed);
    permit.try_resize(12 * (mesh.positions.len() + mesh.triangles.len()) as u64);
    Ok(Loaded::new(mesh, permit))
}

fn changed(input: &Input) -> Error {
    input.error(ErrorKind::Io, "changed while it was read")
}

fn count(input: &Input) -> Result<Counts> {
    let mut counts = Counts::default();
    let mut source = BufReader::with_capacity(1 << 16, &input.file);
    let mut line = Vec::new();
    let mut lines = 0_u64;
    while next_line(&mut source, &mut line).map_err(|e| input.io(e))? > 0 {
        lines += 1;
        if lines.is_multiple_of(65_536) {
            input.budget.check_cancelled()?;
        }
        let mut words = line
            .split(|b| b.is_ascii_whitespace())
            .filter(|w| !w.is_empty());
        let word = words.next();
        if word.is_none_or(|w| w.starts_with(b"#")) {
            continue;
        }
        let further = words.count() as u64;
        match word {
            Some(b"v") => counts.vertices += 1,
            Some(b"f") => {
                counts.faces += 1;
                counts.corners += further;
            }
            Some(b"vn") => {}
            _ => counts.rich = true,
        }
        counts.rich |= further != 3 || !line.is_ascii();
    }
    Ok(counts)
}

/// Upper bound of what the parser and the result take. Lists that double are counted three times.
fn bytes(counts: &Counts) -> u64 {
    let faces = counts.faces + counts.vertices / ROLL + 1;
    let triangles = counts.corners.saturating_sub(2 * counts.faces);
    let lists = 3 * (2 * 12 * counts.vertices + 104 * faces + 12 * (triangles + counts.vertices));
    let polygons = 24 * (counts.vertices + counts.corners) + 12 * counts.vertices;
    let map = 64 * counts.vertices;
    let result = 12 * (counts.vertices + triangles);
    lists + polygons + map + result + (1 << 20)
}

/// Triangles of the polygons that name every vertex.
fn roll_triangles(vertices: u64) -> u64 {
    let rest = vertices % ROLL;
    let last = if rest == 0 { 0 } else { rest.max(3) - 2 };
    vertices / ROLL * (ROLL - 2) + last
}

fn name_every_vertex(vertices: u64, out: &mut Vec<u8>) {
    for first in (1..=vertices).step_by(ROLL as usize) {
        let last = vertices.min(first + ROLL - 1);
        out.push(b'f');
        for v in first..=last.max(first + 2) {
            put(out, format_args!(" {}", v.min(last)));
        }
        out.push(b'\n');
    }
}

fn put(out: &mut Vec<u8>, text: std::fmt::Arguments<'_>) {
    out.write_fmt(text).expect("memory takes every write");
}

/// Three coordinates, and a weight when it is the only further number; colours are dropped.
fn put_vertex<'a>(words: impl Iterator<Item = &'a str>, out: &mut Vec<u8>) -> Result<(), String> {
    out.push(b'v');
    let words: Vec<&str> = words.take(8).collect();
    let kept = if words.len() == 4 { 4 } else { 3 };
    if words.len() < 3 {
        return Err("a vertex with fewer than three coordinates".to_owned());
    }
    for (i, word) in words[..kept].iter().enumerate() {
        if coordinate(word)? == 0.0 && i == 3 {
            return Err("a vertex of weight zero".to_owned());
        }
        put(out, format_args!(" {word}"));
    }
    out.push(b'\n');
    Ok(())
}

/// The numbers of the positions, counted from 1; negative ones count back from the last.
fn put_face<'a>(
    words: impl Iterator<Item = &'a str>,
    seen: u64,
    vertices: u64,
    out: &mut Vec<u8>,
) -> Result<(), String> {
    out.push(b'f');
    let mut corners = 0;
    for word in words {
        if word.starts_with('#') {
            break;
        }
        let absolute = corner_number(word, seen, vertices)?;
        put(out, format_args!(" {absolute}"));
        corners += 1;
    }
    if corners < 3 {
        return Err(format!("a face with {corners} corners"));
    }
    out.push(b'\n');
    Ok(())
}

fn coordinate(word: &str) -> Result<f32, String> {
    word.parse()
        .map_err(|_| format!("{word:?} is no coordinate"))
}

/// The vertex that a corner names, counted from 1.
fn corner_number(word: &str, seen: u64, vertices: u64) -> Result<u64, String> {
    let text = word.split('/').next().unwrap_or_default();
    let number: i64 = text
        .parse()
        .map_err(|_| format!("{word:?} is no corner of a face"))?;
    let absolute = if number < 0 {
        (seen as i64).saturating_add(number).saturating_add(1)
    } else {
        number
    };
    if absolute < 1 || absolute as u64 > vertices {
        return Err(format!("vertex {number} of {vertices} does not exist"));
    }
    Ok(absolute as u64)
}
