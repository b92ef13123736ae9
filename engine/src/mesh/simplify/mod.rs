//! Fewer triangles, for meshes of any size.
//!
//! A mesh is cut into patches that are simplified apart, with their borders fixed: first into its
//! pieces, while they pass, then into cubes of space, and where they are not simplified as one, into
//! others. What was a border is then inside of a patch. In between the mesh waits on disk. Pieces and
//! cubes depend on the mesh alone, so the result does not depend on the budget.

mod collapse;
mod near;
mod patch;
mod sound;

use self::patch::{Made, TRIANGLE_BYTES, Want, simplify};
use super::spool::Spool;
use super::{Layout, MeshSink, Piece, Totals};
use crate::budget::{Budget, Permit, human_bytes};
use crate::error::{Error, ErrorKind, Result};
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::sync::{Condvar, Mutex};

/// How far a mesh is simplified.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// As far as it stays this near to what it was, in the units of its positions.
    Error(f64),
    /// To this share of its triangles, above 0 and below 1.
    Ratio(f64),
}

/// Options of [`Simplified`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Simplify {
    /// How far.
    pub goal: Goal,
    /// Edge of the cubes of space, in the units of the positions: some 30 cells of the lattice.
    pub cube: f64,
    /// A corner of one of the cubes, not on the border of pieces.
    pub corner: [f64; 3],
}

/// What simplification did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Simplification {
    /// What came in.
    pub before: Totals,
    /// What went out.
    pub after: Totals,
    /// No point of either mesh is farther from the other, as measured: at every vertex of the mesh
    /// that came in, and at points on the triangles that went out, 1.5 mean sides of the former
    /// triangles apart. The sum of what was measured in both steps.
    pub distance: f64,
    /// Patches that stayed as they were because what they became was not sound or too far away.
    pub given_up: u64,
}

/// Simplifies a mesh and passes it on to another sink, when it is finished. Vertices that stay keep
/// position, normal and key. Every component keeps its genus and its border, to the vertex; the
/// mesh is 2-manifold where it was.
///
/// # Memory
/// 480 B for every triangle of a piece, by each thread that writes; then for every one of some 120,000
/// triangles by each of as many threads as fit. 40 B for every cube of every piece and 56 B for every
/// vertex between cubes. On disk: the mesh after the first step.
pub struct Simplified<'a> {
    options: Simplify,
    inner: &'a mut dyn MeshSink,
    budget: &'a Budget,
    /// For what was simplified in cubes once.
    again: Waiting,
    state: Mutex<State>,
    room: Room<'a>,
    result: Simplification,
}

#[derive(Debug)]
struct State {
    waiting: Waiting,
    distance: f64,
    given_up: u64,
}

/// A mesh on disk, by cubes.
#[derive(Debug)]
struct Waiting {
    spool: Spool,
    parts: Vec<Part>,
    /// Covers `parts`.
    permit: Permit,
}

/// What a piece has in a cube.
#[derive(Clone, Copy, Debug)]
struct Part {
    cube: [i32; 3],
    /// Number of the piece, which no two have in common.
    piece: u64,
    /// In the spool.
    offset: u64,
    /// Triangles that came in, by the share that is left.
    before: u64,
    after: u64,
}

const PART_BYTES: u64 = 2 * size_of::<Part>() as u64;
/// Buffers of the spool.
const SPOOL_BYTES: u64 = 4 << 20;
/// Bytes of a vertex between cubes, in a table that doubles.
const SHARED_BYTES: u64 = 56;
/// Part of the share asked for that every patch aims at: those with much border do not get there, and the
/// mesh as a whole should.
const AIM: f64 = 0.95;
/// Triangles that are simplified together, where a cube does not have more.
const TOGETHER: u64 = 120_000;

impl<'a> Simplified<'a> {
    /// A simplification into `inner` by way of `scratch`, files that are empty and used by nobody else.
    ///
    /// # Errors
    /// `BadInput` for a goal that is none, `BudgetExceeded`.
    pub fn new(
        options: Simplify,
        scratch: [File; 2],
        budget: &'a Budget,
        inner: &'a mut dyn MeshSink,
    ) -> Result<Self> {
        let (good, what) = match options.goal {
            Goal::Error(e) => (e > 0.0 && e.is_finite(), "an error above 0"),
            Goal::Ratio(r) => (r > 0.0 && r < 1.0, "a share between 0 and 1"),
        };
        let cube = options.cube > 0.0 && options.cube.is_finite();
        if !good || !cube || !options.corner.iter().all(|v| v.is_finite()) {
            return Err(Error::bad_input(format!("to simplify takes {what}")));
        }
        let [first, again] = scratch;
        Ok(Self {
            options,
            inner,
            budget,
            again: Waiting::new(again, budget)?,
            state: Mutex::new(State {
                waiting: Waiting::new(first, budget)?,
                distance: 0.0,
                given_up: 0,
            }),
            room: Room {
                budget,
                busy: Mutex::new(0),
                changed: Condvar::new(),
            },
            result: Simplification::default(),
        })
    }

    /// What was done, after `finish`.
    pub fn result(&self) -> Simplification {
        self.result
    }

    /// What the first step wants of `triangles`: some room is left for the second.
    fn first_want(&self, triangles: usize) -> Want {
        match self.options.goal {
            Goal::Error(e) => Want {
                triangles: 0,
                error: e / 4.0,
            },
            Goal::Ratio(r) => Want {
                triangles: (triangles as f64 * (2.0 * r + 0.1)).ceil() as usize,
                error: f64::INFINITY,
            },
        }
    }
}

impl MeshSink for Simplified<'_> {
    fn begin(&mut self, layout: Layout) -> Result<()> {
        let state = self.state.get_mut().expect("no writer panicked");
        state.waiting.spool.begin(layout);
        self.again.spool.begin(layout);
        self.inner.begin(layout)
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        if !piece.colors.is_empty() || piece.label.is_some() {
            return Err(Error::new(
                ErrorKind::Unsupported,
                "a mesh with colours or labels is not simplified",
            ));
        }
        let count = piece.triangles.len();
        let _room = self.room.enter(count as u64 * TRIANGLE_BYTES)?;
        let made = simplify(&piece.positions, &piece.triangles, self.first_want(count));
        let mut state = self.state.lock().expect("no writer panicked");
        state.distance = state.distance.max(made.distance);
        state.given_up += u64::from(made.given_up);
        let number = piece.first_triangle;
        let waiting = &mut state.waiting;
        waiting.put(
            &self.options,
            piece,
            &made.triangles,
            (number, count as u64),
        )
    }

    fn finish(&mut self, totals: Totals) -> Result<()> {
        let state = self.state.get_mut().expect("no writer panicked");
        let mut step = Step {
            goal: match self.options.goal {
                Goal::Error(e) => Goal::Error((e - state.distance) / 2.0),
                Goal::Ratio(r) => Goal::Ratio(1.25 * r),
            },
            budget: self.budget,
            distance: 0.0,
            given_up: state.given_up,
            numbers: HashMap::new(),
            permit: self.budget.take(0, "vertices between cubes")?,
            after: Totals::default(),
        };
        let mut used = state.distance;
        let mut waiting = &mut state.waiting;
        waiting.sort()?;
        if group(&waiting.parts).len() > 1 {
            // Once more, by other cubes.
            let mut options = self.options;
            options.corner = options.corner.map(|v| v + 0.5 * options.cube);
            let again = &mut self.again;
            let mut number = 0;
            step.run(waiting, &mut |_, piece, made, before| {
                number += 1;
                again.put(&options, &piece, &made.triangles, (number, before))
            })?;
            used += step.distance;
            waiting.parts = Vec::new();
            again.sort()?;
            waiting = again;
        }
        step.goal = match self.options.goal {
            Goal::Error(e) => Goal::Error(e - used),
            Goal::Ratio(r) => Goal::Ratio(AIM * r),
        };
        step.distance = 0.0;
        let inner = &*self.inner;
        step.run(waiting, &mut |step, piece, made, _| {
            step.write(&piece, &made, inner)
        })?;
        self.result = Simplification {
            before: totals,
            after: step.after,
            distance: used + step.distance,
            given_up: step.given_up,
        };
        self.inner.finish(step.after)
    }
}

impl Waiting {
    fn new(scratch: File, budget: &Budget) -> Result<Self> {
        Ok(Self {
            spool: Spool::new(scratch),
            parts: Vec::new(),
            permit: budget.take(SPOOL_BYTES, "simplifying")?,
        })
    }

    /// Keeps some triangles of `piece`, of which there were `before`, by cubes.
    fn put(
        &mut self,
        options: &Simplify,
        piece: &Piece,
        triangles: &[[u32; 3]],
        (number, before): (u64, u64),
    ) -> Result<()> {
        let mut cubes: BTreeMap<[i32; 3], Vec<[u32; 3]>> = BTreeMap::new();
        for t in triangles {
            let corners = t.map(|v| piece.positions[v as usize]);
            let cube = std::array::from_fn(|a| {
                let middle = corners.iter().map(|p| f64::from(p[a])).sum::<f64>() / 3.0;
                ((middle - options.corner[a]) / options.cube).floor() as i32
            });
            cubes.entry(cube).or_default().push(*t);
        }
        let mut part = Piece::default();
        let (all, mut seen) = (triangles.len() as u128, 0);
        let share = |seen: u128| (u128::from(before) * seen / all) as u64;
        for (cube, here) in cubes {
            pick(piece, &here, &mut part);
            let offset = self.spool.append(0, &part)?;
            let after = here.len() as u64;
            self.parts.push(Part {
                cube,
                piece: number,
                offset,
                before: share(seen + u128::from(after)) - share(seen),
                after,
            });
            seen += u128::from(after);
        }
        let bytes = SPOOL_BYTES + self.parts.len() as u64 * PART_BYTES;
        if self.permit.bytes() < bytes && !self.permit.try_resize(bytes + (1 << 18)) {
            return Err(Error::new(
                ErrorKind::BudgetExceeded,
                "the parts of a mesh that is simplified do not fit: give more with --mem",
            ));
        }
        Ok(())
    }

    /// Ends the writing, and puts the parts in the order of their cubes.
    fn sort(&mut self) -> Result<()> {
        self.spool.flush()?;
        let low = self.parts.iter().fold([i32::MAX; 3], |low, p| {
            [0, 1, 2].map(|a| low[a].min(p.cube[a]))
        });
        let place = |p: &Part| curve([0, 1, 2].map(|a| p.cube[a].wrapping_sub(low[a]) as u32));
        self.parts.sort_by_cached_key(|p| (place(p), p.piece));
        Ok(())
    }
}

/// Neighbouring cubes in groups of at most [`TOGETHER`] triangles, or of one cube.
fn group(parts: &[Part]) -> Vec<&[Part]> {
    let mut groups = Vec::new();
    let (mut start, mut many) = (0, 0);
    let mut at = 0;
    for cube in parts.chunk_by(|a, b| a.cube == b.cube) {
        let here: u64 = cube.iter().map(|p| p.after).sum();
        if many > 0 && many + here > TOGETHER {
            groups.push(&parts[start..at]);
            (start, many) = (at, 0);
        }
        many += here;
        at += cube.len();
    }
    if start < at {
        groups.push(&parts[start..at]);
    }
    groups
}

/// A step in cubes.
struct Step<'a> {
    goal: Goal,
    budget: &'a Budget,
    distance: f64,
    given_up: u64,
    /// New numbers of vertices between groups, by their old ones.
    numbers: HashMap<u64, u64>,
    /// Covers `numbers`.
    permit: Permit,
    after: Totals,
}

/// Takes a group, what it became, and how many triangles had come in.
type Done<'d, 'a> = &'d mut dyn FnMut(&mut Step<'a>, Piece, Made, u64) -> Result<()>;

impl<'a> Step<'a> {
    /// Simplifies groups of cubes, some at a time, and hands them on in their order.
    fn run(&mut self, waiting: &Waiting, done: Done<'_, 'a>) -> Result<()> {
        let groups = group(&waiting.parts);
        let mut rest = &groups[..];
        while let Some(first) = rest.first() {
            self.budget.check_cancelled()?;
            let bytes = |g: &&[Part]| g.iter().map(|p| p.after).sum::<u64>() * TRIANGLE_BYTES;
            let mut room = self.budget.take(bytes(first), "simplifying")?;
            let mut count = 1;
            while count < self.budget.threads().min(rest.len()) {
                if !room.try_resize(room.bytes() + bytes(&rest[count])) {
                    break;
                }
                count += 1;
            }
            let (now, later) = rest.split_at(count);
            rest = later;
            let (this, spool) = (&*self, &waiting.spool);
            let made: Vec<Result<(Piece, Made)>> = std::thread::scope(|scope| {
                let others: Vec<_> = now[1..]
                    .iter()
                    .map(|g| scope.spawn(|| this.simplify(spool, g)))
                    .collect();
                let first = this.simplify(spool, now[0]);
                let others = others.into_iter().map(|other| match other.join() {
                    Ok(made) => made,
                    Err(panic) => std::panic::resume_unwind(panic),
                });
                std::iter::once(first).chain(others).collect()
            });
            for (made, parts) in made.into_iter().zip(now) {
                let (piece, made) = made?;
                self.distance = self.distance.max(made.distance);
                self.given_up += u64::from(made.given_up);
                if !made.triangles.is_empty() {
                    done(self, piece, made, parts.iter().map(|p| p.before).sum())?;
                }
            }
        }
        Ok(())
    }

    /// The mesh of a group, and what it becomes.
    fn simplify(&self, spool: &Spool, parts: &[Part]) -> Result<(Piece, Made)> {
        let piece = gather(spool, parts)?;
        let before: u64 = parts.iter().map(|p| p.before).sum();
        let want = match self.goal {
            Goal::Error(e) => Want {
                triangles: 0,
                error: e,
            },
            Goal::Ratio(r) => Want {
                triangles: (before as f64 * r).ceil() as usize,
                error: f64::INFINITY,
            },
        };
        let made = simplify(&piece.positions, &piece.triangles, want);
        Ok((piece, made))
    }

    /// Numbers what a group became and hands it on.
    fn write(&mut self, piece: &Piece, made: &Made, sink: &dyn MeshSink) -> Result<()> {
        let mut out = Piece::default();
        let used = pick(piece, &made.triangles, &mut out);
        out.first_vertex = self.after.vertices;
        out.first_triangle = self.after.triangles;
        for (i, v) in used.into_iter().enumerate() {
            let next = self.after.vertices;
            let number = if made.border[v as usize] {
                *self.numbers.entry(piece.ids[v as usize]).or_insert(next)
            } else {
                next
            };
            out.ids[i] = number;
            if number == next {
                self.after.vertices += 1;
                out.own.push(i as u32);
            }
        }
        self.after.triangles += out.triangles.len() as u64;
        let bytes = self.numbers.capacity() as u64 * SHARED_BYTES / 2;
        if !self.permit.try_resize(bytes) {
            self.budget.take(bytes, "vertices between cubes")?;
        }
        let capacity = sink.capacity();
        if self.after.vertices > capacity.vertices || self.after.triangles > capacity.triangles {
            return Err(Error::new(
                ErrorKind::LimitExceeded,
                "the simplified mesh is larger than the output format can hold: choose another format",
            ));
        }
        sink.write(&out)
    }
}

/// Joins parts by the numbers of their vertices.
fn gather(spool: &Spool, parts: &[Part]) -> Result<Piece> {
    let (mut part, mut buffer) = (Piece::default(), Vec::new());
    let mut piece = Piece::default();
    let mut local: HashMap<u64, u32> = HashMap::new();
    let mut numbers = Vec::new();
    for p in parts {
        spool.read(p.offset, &mut part, &mut buffer)?;
        numbers.clear();
        for (v, &id) in part.ids.iter().enumerate() {
            numbers.push(*local.entry(id).or_insert_with(|| {
                piece.ids.push(id);
                piece.positions.push(part.positions[v]);
                piece.normals.extend(part.normals.get(v));
                piece.keys.extend(part.keys.get(v));
                piece.ids.len() as u32 - 1
            }));
        }
        let triangles = part.triangles.iter();
        piece
            .triangles
            .extend(triangles.map(|t| t.map(|v| numbers[v as usize])));
    }
    Ok(piece)
}

/// Makes `out` of some triangles of `from`, with the vertices that they use in the order of their
/// first use; gives their places in `from`.
fn pick(from: &Piece, triangles: &[[u32; 3]], out: &mut Piece) -> Vec<u32> {
    let mut local = vec![u32::MAX; from.positions.len()];
    let mut used = Vec::new();
    out.triangles.clear();
    for t in triangles {
        out.triangles.push(t.map(|v| {
            let place = &mut local[v as usize];
            if *place == u32::MAX {
                *place = used.len() as u32;
                used.push(v);
            }
            *place
        }));
    }
    fn take<T: Copy>(from: &[T], used: &[u32], out: &mut Vec<T>) {
        out.clear();
        if !from.is_empty() {
            out.extend(used.iter().map(|&v| from[v as usize]));
        }
    }
    take(&from.positions, &used, &mut out.positions);
    take(&from.normals, &used, &mut out.normals);
    take(&from.keys, &used, &mut out.keys);
    take(&from.ids, &used, &mut out.ids);
    used
}

/// Interleaves the bits of three numbers.
fn curve(place: [u32; 3]) -> u128 {
    (0..32).fold(0, |all, bit| {
        let here = (0..3).fold(0, |h, a| h | u128::from(place[a] >> bit & 1) << a);
        all | here << (3 * bit)
    })
}

/// Memory for pieces on several threads: who finds none waits for the others.
struct Room<'a> {
    budget: &'a Budget,
    busy: Mutex<usize>,
    changed: Condvar,
}

struct Place<'a, 'b> {
    room: &'a Room<'b>,
    permit: Option<Permit>,
}

impl<'b> Room<'b> {
    fn enter(&self, bytes: u64) -> Result<Place<'_, 'b>> {
        let mut busy = self.busy.lock().expect("no writer panicked");
        loop {
            self.budget.check_cancelled()?;
            if let Some(permit) = self.budget.try_take(bytes) {
                *busy += 1;
                let permit = Some(permit);
                return Ok(Place { room: self, permit });
            }
            if *busy == 0 {
                return Err(Error::new(
                    ErrorKind::BudgetExceeded,
                    format!(
                        "simplifying a piece needs {} and {} are free: give more with --mem",
                        human_bytes(bytes),
                        human_bytes(self.budget.free_bytes())
                    ),
                ));
            }
            busy = self.changed.wait(busy).expect("no writer panicked");
        }
    }
}

impl Drop for Place<'_, '_> {
    fn drop(&mut self) {
        self.permit = None;
        if let Ok(mut busy) = self.room.busy.lock() {
            *busy -= 1;
        }
        self.room.changed.notify_all();
    }
}
