//! Some components of a mesh that passes, whatever its size.
//!
//! A component of the mesh is made of components of its pieces. Those are found piece by piece and
//! are the nodes of a graph; a vertex that a piece borrows joins a node to the one that the vertex
//! belongs to. So memory holds a node for every component of every piece; pieces, the node of every
//! vertex and the borrowed vertices wait on disk. What is kept is numbered anew in the old order,
//! so that the result does not depend on how the mesh was cut into pieces.

use super::joined::{root, unite};
use super::scratch::{read_at, write_at};
use super::slots::Slots;
use super::spool::Spool;
use super::{Layout, MeshSink, Piece, Totals};
use crate::budget::{Budget, Permit};
use crate::error::{Error, ErrorKind, Result};
use std::fs::File;
use std::sync::Mutex;

/// Which components are kept. Parts are of one component where they have a vertex in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Which {
    /// The component with the most triangles (1), the second (2), and so on; among equals the one
    /// with the lowest vertex number first.
    Largest(u64),
    /// All with at least this many triangles.
    AtLeast(u64),
}

/// What was found and kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Kept {
    /// Components of the whole mesh.
    pub found: u64,
    /// Components that were passed on.
    pub kept: u64,
    /// Vertices and triangles that were passed on.
    pub totals: Totals,
}

/// Passes some components of a mesh on to another sink, when the mesh is finished.
///
/// # Memory
/// 44 B for every component of every piece, under permit, and a few pieces. On disk: the mesh, and
/// 8 B a vertex.
pub struct Components<'a> {
    which: Which,
    /// Whether a mesh without triangles may be the result.
    allow_empty: bool,
    inner: &'a mut dyn MeshSink,
    budget: &'a Budget,
    slots: Slots,
    state: Mutex<State>,
    kept: Kept,
}

#[derive(Debug)]
struct State {
    pieces: Vec<Entry>,
    nodes: Nodes,
    /// The pieces, linked to the first of their nodes.
    spool: Spool,
    /// Borrowed vertices that are not joined yet, and the nodes that borrow them.
    borrowed: Vec<(u64, u32)>,
    /// Batches of `borrowed` on disk: where they begin and how many they are.
    batches: Vec<(u64, u32)>,
    links: File,
    links_end: u64,
    /// Covers `pieces`, `nodes`, `borrowed` and `batches`.
    permit: Permit,
    /// Whether a piece uses a vertex of a later one.
    forward: bool,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    first_vertex: u64,
    first_triangle: u64,
    offset: u64,
}

/// A component of a piece; the root of a set of them stands for a component of the mesh.
#[derive(Clone, Copy, Debug, Default)]
struct Node {
    triangles: u64,
    /// Lowest number of a vertex.
    lowest: u64,
}

/// Nodes in parts of fixed size, which never move.
#[derive(Debug, Default)]
struct Nodes {
    parts: Vec<Vec<Node>>,
    parents: Vec<u32>,
}

const PART_NODES: usize = 1 << 14;
/// Bytes of a node, its parent (in a list that moves when it grows), its entries among roots and
/// chosen, and its mark.
const NODE_BYTES: u64 = 44;
/// Bytes of an entry of the list of pieces, which doubles when it grows.
const ENTRY_BYTES: u64 = 72;
/// Borrowed vertices that are kept in memory before they go to disk.
const BATCH: usize = 1 << 16;
/// With what they become on their way, and the buffer of the spool.
const BATCH_BYTES: u64 = (BATCH as u64) * 48 + (4 << 20);

impl Nodes {
    fn len(&self) -> usize {
        self.parents.len()
    }

    fn push(&mut self, node: Node) {
        if self.parents.len().is_multiple_of(PART_NODES) {
            self.parts.push(Vec::with_capacity(PART_NODES));
        }
        let number = self.parents.len() as u32;
        self.parents.push(number);
        self.parts.last_mut().expect("just made").push(node);
    }

    fn at(&mut self, n: u32) -> &mut Node {
        &mut self.parts[n as usize / PART_NODES][n as usize % PART_NODES]
    }
}

/// The components of one piece.
#[derive(Debug, Default)]
struct Local {
    /// Component of each local vertex.
    of: Vec<u32>,
    nodes: Vec<Node>,
    parents: Vec<u32>,
}

impl Local {
    fn find(&mut self, piece: &Piece) {
        self.parents.clear();
        self.parents.extend(0..piece.positions.len() as u32);
        for &[a, b, c] in &piece.triangles {
            let low = unite(&mut self.parents, a, b).0;
            unite(&mut self.parents, low, c);
        }
        // A vertex may stand in a piece again, borrowed by a block from another one of the piece.
        for (v, &id) in (0u32..).zip(&piece.ids) {
            if is_own(piece, id) {
                let first = piece.own[(id - piece.first_vertex) as usize];
                unite(&mut self.parents, v, first);
            }
        }
        self.of.clear();
        self.nodes.clear();
        // Roots are the lowest of their set, so they come before the others.
        for v in 0..piece.positions.len() {
            let parent = self.parents[v] as usize;
            if parent == v {
                self.of.push(self.nodes.len() as u32);
                self.nodes.push(Node {
                    lowest: u64::MAX,
                    ..Node::default()
                });
            } else {
                self.of.push(self.of[parent]);
            }
            let node = &mut self.nodes[self.of[v] as usize];
            node.lowest = node.lowest.min(piece.ids[v]);
        }
        for t in &piece.triangles {
            self.nodes[self.of[t[0] as usize] as usize].triangles += 1;
        }
    }
}

/// Bytes that one piece takes beside itself while its components are found.
fn local_bytes(piece: &Piece) -> u64 {
    // Component, parent and slot of a vertex, as number and as bytes; nodes of noise.
    64 * piece.positions.len() as u64
}

fn is_own(piece: &Piece, id: u64) -> bool {
    (piece.first_vertex..piece.first_vertex + piece.own.len() as u64).contains(&id)
}

impl<'a> Components<'a> {
    /// Passes the components `which` of the mesh to come on to `inner`. `scratch` are three empty
    /// files that nobody else uses.
    ///
    /// # Errors
    /// When the budget has no room.
    pub fn new(
        which: Which,
        allow_empty: bool,
        scratch: [File; 3],
        budget: &'a Budget,
        inner: &'a mut dyn MeshSink,
    ) -> Result<Self> {
        let [pieces, slots, links] = scratch;
        Ok(Self {
            which,
            allow_empty,
            inner,
            budget,
            slots: Slots::new(slots),
            state: Mutex::new(State {
                pieces: Vec::new(),
                nodes: Nodes::default(),
                spool: Spool::new(pieces),
                borrowed: Vec::new(),
                batches: Vec::new(),
                links,
                links_end: 0,
                permit: budget.take(BATCH_BYTES, "the components of the mesh")?,
                forward: false,
            }),
            kept: Kept::default(),
        })
    }

    /// What was found and kept, after `finish`.
    pub fn kept(&self) -> Kept {
        self.kept
    }
}

impl State {
    /// Adds a piece and its components; gives the number of the first.
    fn add(&mut self, piece: &Piece, local: &Local, budget: &Budget) -> Result<u32> {
        let base = self.nodes.len();
        let count = base + local.nodes.len();
        if count > u32::MAX as usize {
            return Err(Error::new(
                ErrorKind::LimitExceeded,
                "more than 4,294,967,295 components of pieces: mesh a smaller region",
            ));
        }
        let parts = count.div_ceil(PART_NODES) * PART_NODES;
        let bytes = BATCH_BYTES
            + NODE_BYTES * parts as u64
            + ENTRY_BYTES * (self.pieces.len() + 1 + self.batches.len()) as u64;
        if bytes > self.permit.bytes() && !self.permit.try_resize(bytes) {
            let more = bytes - self.permit.bytes();
            budget
                .take(more, "the components of the mesh")
                .map_err(|e| e.context(format!("{count} components of pieces so far")))?;
        }
        self.nodes.parents.reserve(local.nodes.len());
        local.nodes.iter().for_each(|&node| self.nodes.push(node));
        let offset = self.spool.append(base as u64, piece)?;
        self.pieces.push(Entry {
            first_vertex: piece.first_vertex,
            first_triangle: piece.first_triangle,
            offset,
        });
        let end = piece.first_vertex + piece.own.len() as u64;
        for (v, &id) in piece.ids.iter().enumerate() {
            if !is_own(piece, id) {
                self.forward |= id >= end;
                self.borrowed.push((id, base as u32 + local.of[v]));
                if self.borrowed.len() == BATCH {
                    self.spill()?;
                }
            }
        }
        Ok(base as u32)
    }

    fn spill(&mut self) -> Result<()> {
        let mut bytes = Vec::with_capacity(12 * self.borrowed.len());
        for (id, node) in &self.borrowed {
            bytes.extend(id.to_le_bytes());
            bytes.extend(node.to_le_bytes());
        }
        write_at(&self.links, &bytes, self.links_end)?;
        self.batches
            .push((self.links_end, self.borrowed.len() as u32));
        self.links_end += bytes.len() as u64;
        self.borrowed.clear();
        Ok(())
    }

    /// Joins the nodes that share vertices.
    fn join(&mut self, slots: &Slots) -> Result<()> {
        self.spill()?;
        let mut bytes = Vec::new();
        for &(at, count) in &self.batches {
            bytes.resize(12 * count as usize, 0);
            read_at(&self.links, &mut bytes, at)?;
            let records = bytes.as_chunks::<12>().0;
            let long = |b: &[u8; 12]| u64::from_le_bytes(b[..8].try_into().expect("8 bytes"));
            let short = |b: &[u8; 12]| u32::from_le_bytes(b[8..].try_into().expect("4 bytes"));
            let ids: Vec<u64> = records.iter().map(long).collect();
            let parents = &mut self.nodes.parents;
            slots.read(&ids, |n, node| {
                unite(parents, short(&records[n]), node as u32);
            })?;
        }
        Ok(())
    }

    /// Sums over the nodes of each component; all roots.
    fn sum(&mut self) -> Vec<u32> {
        let count = self.nodes.len() as u32;
        // Roots are the lowest of their set.
        for n in 0..count {
            let low = root(&mut self.nodes.parents, n);
            if low == n {
                continue;
            }
            let node = *self.nodes.at(n);
            let sum = self.nodes.at(low);
            sum.triangles += node.triangles;
            sum.lowest = sum.lowest.min(node.lowest);
        }
        // Vertices that no triangle names are no component.
        (0..count)
            .filter(|&n| self.nodes.parents[n as usize] == n && self.nodes.at(n).triangles > 0)
            .collect()
    }
}

/// The roots of what stays.
fn choose(which: Which, state: &mut State, roots: &mut [u32]) -> Vec<u32> {
    let nodes = &mut state.nodes;
    match which {
        Which::AtLeast(least) => {
            let stays = |&&root: &&u32| nodes.at(root).triangles >= least;
            roots.iter().filter(stays).copied().collect()
        }
        Which::Largest(n) => {
            roots.sort_unstable_by_key(|&root| {
                let node = nodes.at(root);
                (std::cmp::Reverse(node.triangles), node.lowest)
            });
            let place = n.checked_sub(1).and_then(|n| usize::try_from(n).ok());
            let root = place.and_then(|n| roots.get(n));
            root.copied().into_iter().collect()
        }
    }
}

impl MeshSink for Components<'_> {
    fn begin(&mut self, layout: Layout) -> Result<()> {
        let state = self.state.get_mut().expect("no writer panicked");
        state.spool.begin(layout);
        self.inner.begin(layout)
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        let _permit = self
            .budget
            .take(local_bytes(piece), "the components of a piece")?;
        let mut local = Local::default();
        local.find(piece);
        let base = {
            let mut state = self.state.lock().expect("no writer panicked");
            state.add(piece, &local, self.budget)?
        };
        let slot = |&v: &u32| u64::from(base + local.of[v as usize]);
        let slots: Vec<u64> = piece.own.iter().map(slot).collect();
        self.slots
            .write(piece.first_vertex, &slots, &mut Vec::new())
    }

    fn finish(&mut self, _totals: Totals) -> Result<()> {
        let state = self.state.get_mut().expect("no writer panicked");
        state.spool.flush()?;
        state.join(&self.slots)?;
        let mut roots = state.sum();
        let chosen = choose(self.which, state, &mut roots);
        self.kept.found = roots.len() as u64;
        self.kept.kept = chosen.len() as u64;
        if chosen.is_empty() && !self.allow_empty {
            return Err(nothing(self.which, state, &roots));
        }
        let mut marks = vec![false; state.nodes.len()];
        chosen.iter().for_each(|&root| marks[root as usize] = true);
        for n in 0..marks.len() {
            // Roots are the lowest of their set.
            marks[n] = marks[root(&mut state.nodes.parents, n as u32) as usize];
        }
        state
            .pieces
            .sort_unstable_by_key(|e| (e.first_vertex, e.first_triangle));
        let pass = Pass {
            state,
            slots: &self.slots,
            marks: &marks,
            budget: self.budget,
        };
        if state.forward {
            pass.run(true, None)?;
            self.kept.totals = pass.run(false, Some(&*self.inner))?;
        } else {
            self.kept.totals = pass.run(true, Some(&*self.inner))?;
        }
        self.inner.finish(self.kept.totals)
    }
}

/// A pass over all pieces in order.
struct Pass<'a> {
    state: &'a State,
    slots: &'a Slots,
    marks: &'a [bool],
    budget: &'a Budget,
}

impl Pass<'_> {
    /// Gives the vertices that stay their new numbers if `number`, and writes what stays to `sink`.
    fn run(&self, number: bool, sink: Option<&dyn MeshSink>) -> Result<Totals> {
        let mut done = Totals::default();
        let (mut piece, mut buffer) = (Piece::default(), Vec::new());
        let (mut local, mut slots, mut out) = (Local::default(), Vec::new(), Piece::default());
        for entry in &self.state.pieces {
            self.budget.check_cancelled()?;
            let base = self
                .state
                .spool
                .read(entry.offset, &mut piece, &mut buffer)? as usize;
            local.find(&piece);
            if !self.marks[base..][..local.nodes.len()].contains(&true) {
                continue;
            }
            let stays = |v: u32| self.marks[base + local.of[v as usize] as usize];
            let first = done;
            slots.clear();
            for &v in &piece.own {
                slots.push(if stays(v) { done.vertices } else { u64::MAX });
                done.vertices += u64::from(stays(v));
            }
            if number {
                self.slots.write(piece.first_vertex, &slots, &mut buffer)?;
            }
            done.triangles += piece.triangles.iter().filter(|t| stays(t[0])).count() as u64;
            if let Some(sink) = sink {
                cut_out(&piece, stays, first, &mut out);
                self.number_borrowed(&piece, &slots, &mut out)?;
                sink.write(&out)?;
            }
        }
        Ok(done)
    }

    /// Turns the old numbers in `out` into new ones.
    fn number_borrowed(&self, piece: &Piece, slots: &[u64], out: &mut Piece) -> Result<()> {
        let mut places = Vec::new();
        let mut which = Vec::new();
        for (v, id) in out.ids.iter_mut().enumerate() {
            if is_own(piece, *id) {
                *id = slots[(*id - piece.first_vertex) as usize];
            } else {
                places.push(*id);
                which.push(v);
            }
        }
        self.slots.read(&places, |n, number| {
            out.ids[which[n]] = number;
        })
    }
}

/// What stays of a piece, still with the old numbers of its vertices.
fn cut_out(piece: &Piece, stays: impl Fn(u32) -> bool, first: Totals, out: &mut Piece) {
    out.first_vertex = first.vertices;
    out.first_triangle = first.triangles;
    let all = 0..piece.positions.len() as u32;
    let mut place = Vec::with_capacity(all.len());
    let mut count = 0;
    for v in all.clone() {
        place.push(count);
        count += u32::from(stays(v));
    }
    fn pick<T: Copy>(from: &[T], stays: impl Fn(u32) -> bool, to: &mut Vec<T>) {
        to.clear();
        let kept = (0u32..).zip(from).filter(|&(v, _)| stays(v));
        to.extend(kept.map(|(_, &value)| value));
    }
    pick(&piece.positions, &stays, &mut out.positions);
    pick(&piece.normals, &stays, &mut out.normals);
    pick(&piece.keys, &stays, &mut out.keys);
    pick(&piece.ids, &stays, &mut out.ids);
    out.own.clear();
    let own = piece.own.iter().filter(|&&v| stays(v));
    out.own.extend(own.map(|&v| place[v as usize]));
    out.triangles.clear();
    let triangles = piece.triangles.iter().filter(|t| stays(t[0]));
    out.triangles
        .extend(triangles.map(|t| t.map(|v| place[v as usize])));
}

fn nothing(which: Which, state: &mut State, roots: &[u32]) -> Error {
    let most = roots.iter().map(|&r| state.nodes.at(r).triangles).max();
    let asked = match which {
        Which::Largest(n) => format!("component {n} was asked for (--component)"),
        Which::AtLeast(n) => format!("no component has {n} triangles (--min-triangles)"),
    };
    Error::new(
        ErrorKind::EmptySurface,
        format!(
            "{asked}: the surface has {}, the largest of {} triangles",
            match roots.len() {
                1 => "1 component".to_string(),
                n => format!("{n} components"),
            },
            most.unwrap_or(0)
        ),
    )
}
