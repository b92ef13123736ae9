//! The examination of a mesh that is not in memory.
//!
//! The triangles are read in order, three times. What stands around a vertex, and what is near in
//! space, is brought together on disk: triangles are put into buckets, by ranges of vertices and by
//! cells of a grid, that are then taken one by one. Every answer is the one that
//! [`check`](super::check), [`shapes`](super::shapes) and [`crossings`](super::crossings) give for the mesh in
//! memory.

use super::Mesh;
use super::around::{Around, Counts, scratch_bytes};
use super::boxes::{Bounds, NOTHING, TREE_BYTES, bounds_of, union};
use super::buckets::Buckets;
use super::check::{Found, Report};
use super::crossings::{Cells, Crossings, crossings_among};
use super::joined::{root, unite};
use super::measure::{self, BLOCK, Sums, is_finite};
use super::shapes::{ShapeCount, Shapes};
use super::slots::Slots;
use crate::budget::{Budget, Permit};
use crate::error::{Error, ErrorKind, Result};
use std::fs::File;

/// A mesh that is read in parts.
pub trait MeshSource: Sync {
    /// Number of vertices, 2^32 at most.
    fn vertices(&self) -> u64;

    /// Number of triangles.
    fn triangles(&self) -> u64;

    /// Fills `out` with the positions of the vertices from `first` on.
    ///
    /// # Errors
    /// When they cannot be read.
    fn read_positions(&self, first: u64, out: &mut [[f32; 3]]) -> Result<()>;

    /// Fills `out` with the triangles from `first` on.
    ///
    /// # Errors
    /// When they cannot be read, or a triangle is none.
    fn read_triangles(&self, first: u64, out: &mut [[u32; 3]]) -> Result<()>;
}

impl MeshSource for Mesh {
    fn vertices(&self) -> u64 {
        self.positions.len() as u64
    }

    fn triangles(&self) -> u64 {
        self.triangles.len() as u64
    }

    fn read_positions(&self, first: u64, out: &mut [[f32; 3]]) -> Result<()> {
        out.copy_from_slice(&self.positions[first as usize..][..out.len()]);
        Ok(())
    }

    fn read_triangles(&self, first: u64, out: &mut [[u32; 3]]) -> Result<()> {
        out.copy_from_slice(&self.triangles[first as usize..][..out.len()]);
        Ok(())
    }
}

/// What [`examine`] finds.
#[derive(Clone, Debug, PartialEq)]
pub struct Examined {
    /// See [`check`](super::check).
    pub report: Report,
    /// See [`shapes`](super::shapes).
    pub shapes: Shapes,
    /// See [`crossings`](super::crossings); nothing when none were asked for.
    pub crossings: Option<Crossings>,
}

/// Examines a mesh of any size. `most_crossings` is that of [`crossings`](super::crossings); 0 leaves
/// them out. `scratch` are three empty files that nobody else uses.
///
/// The result does not depend on the budget.
///
/// # Errors
/// When a triangle names a vertex that the mesh does not have; `BudgetExceeded`, with a remedy, when
/// so many triangles are at one vertex or in one place that they do not fit; `Cancelled`; what the
/// source reports.
///
/// # Memory
/// A quarter of the free budget for the positions that are in use, a half for buckets, 12 B for every
/// component of 16384 triangles in order (one a triangle where they are in no order), 24 B for every 4096 triangles. A mesh whose triangles
/// name vertices from everywhere is read slowly. On disk: up to 48 B a triangle, up to some 40 B a
/// triangle for crossings, 8 B a vertex.
pub fn examine(
    source: &dyn MeshSource,
    most_crossings: u64,
    scratch: [File; 3],
    budget: &Budget,
) -> Result<Examined> {
    if source.vertices() > 1 << 32 {
        return Err(Error::new(
            ErrorKind::LimitExceeded,
            format!(
                "{} vertices; a mesh of 2^32 can be checked",
                source.vertices()
            ),
        ));
    }
    let [slots, around, near] = scratch;
    let _small = budget.take(SMALL_BYTES, "checking the mesh")?;
    let quarter = budget.free_bytes() / 4;
    let (nonfinite, bounds) = look_at_positions(source, budget)?;
    let (components, ranges) = join_and_count(source, Slots::new(slots), quarter, budget)?;
    let _share = budget.take(3 * quarter, "checking the mesh")?;
    let whole = bounds.unwrap_or(NOTHING);
    let cells = Cells::new(whole, source.triangles(), most_crossings);
    let mut looked = Looked::new(source, &ranges, around, quarter);
    looked.run(source, (most_crossings > 0).then_some(&cells), budget)?;
    let (counts, used) = count_around(&ranges, looked.buckets, quarter, budget)?;
    let crossings = match most_crossings {
        0 => None,
        _ => {
            let groups = Groups::new(&cells, &looked.in_cells, quarter);
            let mut found = meetings(source, &cells, &groups, near, quarter, whole, budget)?;
            found.checked_triangles = looked.begins;
            Some(found)
        }
    };
    let found = Found {
        vertices: source.vertices(),
        triangles: source.triangles(),
        used,
        nonfinite,
        bounds,
        components,
        counts,
        sums: measure::total(&looked.sums),
    };
    Ok(Examined {
        report: found.report(),
        shapes: looked.shapes.shapes(),
        crossings,
    })
}

/// Covers chunks, histograms and the numbers of cells.
const SMALL_BYTES: u64 = 6 << 20;

/// Triangles that are read at one time; a multiple of the block of sums.
const CHUNK: u64 = 4 * BLOCK as u64;

/// Calls `each` with the triangles, many at a time, all of them with vertices that exist.
fn each_chunk(
    source: &dyn MeshSource,
    budget: &Budget,
    mut each: impl FnMut(&[[u32; 3]]) -> Result<()>,
) -> Result<()> {
    let mut chunk = Vec::new();
    let mut first = 0;
    while first < source.triangles() {
        budget.check_cancelled()?;
        let count = CHUNK.min(source.triangles() - first);
        chunk.resize(count as usize, [0; 3]);
        source.read_triangles(first, &mut chunk)?;
        let lost = |t: &[u32; 3]| t.iter().any(|&v| u64::from(v) >= source.vertices());
        if let Some(t) = chunk.iter().position(lost) {
            return Err(Error::bad_input(format!(
                "triangle {} names vertices {:?} of a mesh with {}",
                first + t as u64,
                chunk[t],
                source.vertices()
            )));
        }
        each(&chunk)?;
        first += count;
    }
    Ok(())
}

/// Vertices that are not finite, and the bounds of the others.
fn look_at_positions(source: &dyn MeshSource, budget: &Budget) -> Result<(u64, Option<Bounds>)> {
    let (mut nonfinite, mut bounds) = (0, NOTHING);
    let mut chunk = Vec::new();
    let mut first = 0;
    while first < source.vertices() {
        budget.check_cancelled()?;
        let count = CHUNK.min(source.vertices() - first);
        chunk.resize(count as usize, [0.0; 3]);
        source.read_positions(first, &mut chunk)?;
        for p in &chunk {
            match is_finite(p) {
                true => bounds = union(bounds, [*p, *p]),
                false => nonfinite += 1,
            }
        }
        first += count;
    }
    let some = nonfinite < source.vertices();
    Ok((nonfinite, some.then_some(bounds)))
}

// ---- components, and how the vertices are cut into ranges

/// Ranges of vertices whose triangles fit into memory together.
struct Ranges {
    /// Vertices of a fine range.
    step: u64,
    /// The range of each fine range.
    of: Vec<u32>,
    /// Where each range begins, and the end of the last.
    starts: Vec<u64>,
    /// Bytes that each range takes.
    bytes: Vec<u64>,
}

impl Ranges {
    /// Puts fine ranges together so that each takes at most `bytes`, where possible.
    fn new(corners: &[u64], step: u64, vertices: u64, bytes: u64) -> Self {
        let (mut of, mut starts) = (Vec::with_capacity(corners.len()), vec![0]);
        let mut sums = vec![0];
        for (i, &count) in corners.iter().enumerate() {
            let more = around_bytes(step, count);
            let sum = *sums.last().expect("one at least");
            if sum > 0 && sum + more > bytes {
                starts.push(i as u64 * step);
                sums.push(0);
            }
            *sums.last_mut().expect("one at least") += more;
            of.push(starts.len() as u32 - 1);
        }
        starts.push(vertices);
        Self {
            step,
            of,
            starts,
            bytes: sums,
        }
    }

    fn of(&self, vertex: u32) -> u32 {
        self.of[(u64::from(vertex) / self.step) as usize]
    }

    fn count(&self) -> usize {
        self.starts.len() - 1
    }
}

/// Bytes of a range: its triangles, a list of them at each vertex, ends and degrees.
fn around_bytes(vertices: u64, corners: u64) -> u64 {
    16 * corners + 8 * vertices
}

/// Most fine ranges.
const FINE: u64 = 1 << 16;

/// Counts components, and cuts the vertices into ranges of at most `bytes`.
///
/// The components of a chunk of triangles are nodes. The slot of a vertex holds the node, from 1,
/// in which it was met first; where it is met again, the nodes are joined.
fn join_and_count(
    source: &dyn MeshSource,
    slots: Slots,
    bytes: u64,
    budget: &Budget,
) -> Result<(u64, Ranges)> {
    slots.clear(source.vertices())?;
    let step = source.vertices().div_ceil(FINE).max(1);
    let mut corners = vec![0; source.vertices().div_ceil(step) as usize];
    let mut nodes: Vec<u32> = Vec::new();
    let mut permit = budget.take(0, "the components of the mesh")?;
    let (mut ids, mut parents, mut of) = (Vec::new(), Vec::new(), Vec::new());
    each_chunk(source, budget, |chunk| {
        ids.clear();
        ids.extend_from_slice(chunk.as_flattened());
        for &v in &ids {
            corners[(u64::from(v) / step) as usize] += 1;
        }
        ids.sort_unstable();
        ids.dedup();
        parents.clear();
        parents.extend(0..ids.len() as u32);
        let local = |v: &u32| ids.binary_search(v).expect("listed") as u32;
        for t in chunk {
            let [a, b, c] = t.each_ref().map(local);
            let low = unite(&mut parents, a, b).0;
            unite(&mut parents, low, c);
        }
        of.clear();
        let base = nodes.len() as u32;
        let mut count = 0;
        for v in 0..ids.len() {
            let parent = parents[v] as usize;
            if parent == v {
                of.push(base + count);
                count += 1;
            } else {
                // Roots are the lowest of their set.
                of.push(of[parent]);
            }
        }
        cover(&mut permit, nodes.len() + count as usize, budget)?;
        nodes.extend(base..base + count);
        slots.update(&ids, |n, slot| match *slot {
            0 => *slot = u64::from(of[n]) + 1,
            known => {
                unite(&mut nodes, known as u32 - 1, of[n]);
            }
        })
    })?;
    let roots = (0..nodes.len() as u32).filter(|&n| root(&mut nodes, n) == n);
    let components = roots.count() as u64;
    Ok((
        components,
        Ranges::new(&corners, step, source.vertices(), bytes),
    ))
}

/// Lets `permit` cover a list of `nodes`, which doubles when it grows.
fn cover(permit: &mut Permit, nodes: usize, budget: &Budget) -> Result<()> {
    if nodes > u32::MAX as usize - 1 {
        return Err(Error::new(
            ErrorKind::LimitExceeded,
            "more than 4,294,967,294 components of parts of the mesh",
        ));
    }
    let bytes = 12 * nodes.next_power_of_two() as u64;
    if bytes > permit.bytes() && !permit.try_resize(bytes) {
        budget.take(bytes - permit.bytes(), "the components of the mesh")?;
    }
    Ok(())
}

// ---- what each triangle is by itself, and where it belongs

/// Positions that a block of the cache holds.
const NEAR: u64 = 512;

/// Positions in use, block by block.
struct Positions<'a> {
    source: &'a dyn MeshSource,
    /// The block in each place, and its positions.
    blocks: Vec<u64>,
    values: Vec<[f32; 3]>,
}

impl<'a> Positions<'a> {
    fn new(source: &'a dyn MeshSource, bytes: u64) -> Self {
        let all = source.vertices().div_ceil(NEAR).max(1);
        let places = (bytes / (12 * NEAR + 8)).clamp(4, all.max(4)) as usize;
        Self {
            source,
            blocks: vec![u64::MAX; places],
            values: vec![[0.0; 3]; places * NEAR as usize],
        }
    }

    fn at(&mut self, vertex: u32) -> Result<[f32; 3]> {
        let block = u64::from(vertex) / NEAR;
        let place = (block % self.blocks.len() as u64) as usize;
        let values = &mut self.values[place * NEAR as usize..][..NEAR as usize];
        if self.blocks[place] != block {
            let first = block * NEAR;
            let count = NEAR.min(self.source.vertices() - first) as usize;
            self.blocks[place] = u64::MAX;
            self.source.read_positions(first, &mut values[..count])?;
            self.blocks[place] = block;
        }
        Ok(values[(u64::from(vertex) % NEAR) as usize])
    }

    fn of(&mut self, [a, b, c]: [u32; 3]) -> Result<[[f32; 3]; 3]> {
        Ok([self.at(a)?, self.at(b)?, self.at(c)?])
    }
}

/// The results of a pass over all triangles with their corners.
struct Looked<'a> {
    ranges: &'a Ranges,
    cache_bytes: u64,
    sums: Vec<Sums>,
    shapes: ShapeCount,
    /// Triangles, in the bucket of each range of vertices that they touch.
    buckets: Buckets<12>,
    /// Triangles that meet each cell.
    in_cells: Vec<u32>,
    /// Triangles that begin in a cell that is looked at.
    begins: u64,
}

impl<'a> Looked<'a> {
    fn new(source: &dyn MeshSource, ranges: &'a Ranges, file: File, bytes: u64) -> Self {
        let blocks = source.triangles().div_ceil(BLOCK as u64) as usize;
        Self {
            ranges,
            cache_bytes: bytes,
            sums: Vec::with_capacity(blocks),
            shapes: ShapeCount::default(),
            buckets: Buckets::new(file, ranges.count(), bytes / 2),
            in_cells: Vec::new(),
            begins: 0,
        }
    }

    /// `cells` for what is looked at for crossings.
    fn run(
        &mut self,
        source: &dyn MeshSource,
        cells: Option<&Cells>,
        budget: &Budget,
    ) -> Result<()> {
        let mut positions = Positions::new(source, self.cache_bytes);
        self.in_cells = vec![0; cells.map_or(0, |c| c.edge as usize).pow(3)];
        each_chunk(source, budget, |chunk| {
            for block in chunk.chunks(BLOCK) {
                let mut sums = Sums::default();
                for t in block {
                    let corners = positions.of(*t)?;
                    sums.add(t, corners);
                    self.shapes.add(&corners);
                    if let Some(cells) = cells {
                        self.count_cells(cells, &corners);
                    }
                    self.put_around(t)?;
                }
                self.sums.push(sums);
            }
            Ok(())
        })
    }

    fn count_cells(&mut self, cells: &Cells, corners: &[[f32; 3]; 3]) {
        if !corners.iter().all(is_finite) {
            return;
        }
        let bounds = bounds_of(corners);
        self.begins += u64::from(cells.asked(cells.of(bounds[0])));
        for cell in cells.of_box(&bounds) {
            let count = &mut self.in_cells[cells.number(cell) as usize];
            *count = count.saturating_add(1);
        }
    }

    fn put_around(&mut self, t: &[u32; 3]) -> Result<()> {
        let [a, b, c] = t.each_ref().map(|&v| self.ranges.of(v));
        let mut record = [0; 12];
        for (bytes, v) in record.as_chunks_mut::<4>().0.iter_mut().zip(t) {
            *bytes = v.to_le_bytes();
        }
        self.buckets.add(a as usize, &record)?;
        if b != a {
            self.buckets.add(b as usize, &record)?;
        }
        if c != a && c != b {
            self.buckets.add(c as usize, &record)?;
        }
        Ok(())
    }
}

/// Counts edges and fans range by range; also the vertices of triangles.
fn count_around(
    ranges: &Ranges,
    mut buckets: Buckets<12>,
    covered: u64,
    budget: &Budget,
) -> Result<(Counts, u64)> {
    let (mut counts, mut used) = (Counts::default(), 0);
    let mut around = Around::default();
    for n in 0..ranges.count() {
        budget.check_cancelled()?;
        let range = ranges.starts[n] as usize..ranges.starts[n + 1] as usize;
        let triangles_count = buckets.records(n);
        // More only where a range could not be cut.
        let more = ranges.bytes[n].saturating_sub(covered);
        let _permit = budget.take(more, "the triangles around a range of vertices")?;
        let mut triangles = Vec::with_capacity(triangles_count as usize);
        buckets.take(n, |record| {
            let v = record.as_chunks::<4>().0;
            triangles.push([v[0], v[1], v[2]].map(u32::from_le_bytes));
        })?;
        let mut degrees = vec![0u32; range.len()];
        for &v in triangles.as_flattened() {
            if let Some(degree) = degrees.get_mut((v as usize).wrapping_sub(range.start)) {
                *degree += 1;
            }
        }
        let largest = degrees.iter().copied().max().unwrap_or(0);
        let _scratch = budget.take(scratch_bytes(largest), "the triangles around a vertex")?;
        counts.add(around.count(&triangles, &degrees, range));
        used += degrees.iter().filter(|&&d| d > 0).count() as u64;
    }
    Ok((counts, used))
}

// ---- crossings

/// Cells put together into groups whose triangles fit into memory.
struct Groups {
    /// The group of each cell.
    of: Vec<u32>,
    count: usize,
}

/// Bytes of a triangle while its group is looked at.
const MEETING_BYTES: u64 = 36 + TREE_BYTES;

impl Groups {
    fn new(cells: &Cells, in_cells: &[u32], bytes: u64) -> Self {
        let most = (bytes / MEETING_BYTES).max(1);
        let (mut of, mut group, mut sum) = (Vec::with_capacity(in_cells.len()), 0, 0);
        for (n, &count) in in_cells.iter().enumerate() {
            let edge = cells.edge as usize;
            let cell = [n % edge, n / edge % edge, n / edge / edge].map(|v| v as u32);
            let count = if cells.asked(cell) {
                u64::from(count)
            } else {
                0
            };
            if sum > 0 && sum + count > most {
                group += 1;
                sum = 0;
            }
            sum += count;
            of.push(group);
        }
        Self {
            of,
            count: group as usize + 1,
        }
    }
}

/// Counts the pairs that meet, group by group.
fn meetings(
    source: &dyn MeshSource,
    cells: &Cells,
    groups: &Groups,
    file: File,
    bytes: u64,
    whole: Bounds,
    budget: &Budget,
) -> Result<Crossings> {
    let mut buckets = Buckets::<36>::new(file, groups.count, bytes / 2);
    let mut positions = Positions::new(source, bytes / 2);
    each_chunk(source, budget, |chunk| {
        for t in chunk {
            let corners = positions.of(*t)?;
            if !corners.iter().all(is_finite) {
                continue;
            }
            let mut record = [0; 36];
            for (bytes, v) in record
                .as_chunks_mut::<4>()
                .0
                .iter_mut()
                .zip(corners.as_flattened())
            {
                *bytes = v.to_le_bytes();
            }
            let mut last = u32::MAX;
            for cell in cells.of_box(&bounds_of(&corners)) {
                // Cells come in ascending order, and so do their groups.
                let group = groups.of[cells.number(cell) as usize];
                if cells.asked(cell) && group != last {
                    buckets.add(group as usize, &record)?;
                    last = group;
                }
            }
        }
        Ok(())
    })?;
    drop(positions);
    let mut total = Crossings::default();
    for group in 0..groups.count {
        budget.check_cancelled()?;
        let count = buckets.records(group);
        let more = (count * MEETING_BYTES).saturating_sub(bytes);
        let _permit = budget.take(more, "the triangles in one place of the mesh")?;
        let mut corners = Vec::with_capacity(count as usize);
        buckets.take(group, |record| {
            let v = record.as_chunks::<4>().0;
            let float = |i: usize| f32::from_le_bytes(v[i]);
            corners.push([0, 3, 6].map(|i| [float(i), float(i + 1), float(i + 2)]));
        })?;
        let ours = |p: [f32; 3]| {
            let cell = cells.of(p);
            cells.asked(cell) && groups.of[cells.number(cell) as usize] as usize == group
        };
        let numbers = 0..corners.len() as u32;
        let found = crossings_among(numbers, |n| corners[n as usize], ours, whole, budget)?;
        total.crossing_pairs += found.crossing_pairs;
        total.overlapping_pairs += found.overlapping_pairs;
    }
    Ok(total)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_meshes::{both, cube, pinch, tetrahedron, torus};
    use crate::mesh::{check, crossings, shapes};

    fn scratch() -> [File; 3] {
        [(); 3].map(|()| tempfile::tempfile().expect("a scratch file"))
    }

    fn assert_same(mesh: &Mesh, what: &str) {
        assert_same_in(mesh, what, 7);
    }

    fn assert_same_in(mesh: &Mesh, what: &str, least_mib: u64) {
        let wide = Budget::mib(256);
        let report = check(mesh, &wide).expect("fits");
        let shapes = shapes(mesh, &wide).expect("fits");
        for most in [u64::MAX, mesh.triangles.len() as u64 / 5 + 1, 0] {
            let crossings = (most > 0).then(|| crossings(mesh, most, &wide).expect("fits"));
            for (mib, threads) in [(least_mib, 1), (least_mib + 2, 2), (64, 2)] {
                let budget = Budget::mib(mib).with_threads(threads);
                let found = examine(mesh, most, scratch(), &budget)
                    .unwrap_or_else(|e| panic!("{what}: {mib} MiB: {e}"));
                let same = |a: f64, b: f64| a == b || a.is_nan() && b.is_nan();
                assert!(same(found.report.area, report.area), "{what}: area");
                assert!(same(found.report.volume, report.volume), "{what}: volume");
                let plain = |r: &Report| Report {
                    area: 0.0,
                    volume: 0.0,
                    ..r.clone()
                };
                assert_eq!(plain(&found.report), plain(&report), "{what}: {mib} MiB");
                assert_eq!(found.shapes, shapes, "{what}: {mib} MiB");
                assert_eq!(found.crossings, crossings, "{what}: {mib} MiB, {most}");
                assert_eq!(budget.used_bytes(), 0, "{what}");
            }
        }
    }

    /// The vertices in another order, and the triangles too.
    fn shuffled(mesh: &Mesh, seed: u64) -> Mesh {
        let mut state = seed;
        let mut dice = move |n: usize| {
            state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
            (state >> 33) as usize % n
        };
        let mut mesh = mesh.clone();
        let count = mesh.positions.len();
        let mut place: Vec<u32> = (0..count as u32).collect();
        for i in (1..count).rev() {
            place.swap(i, dice(i + 1));
        }
        let old = mesh.positions.clone();
        for (i, &to) in place.iter().enumerate() {
            mesh.positions[to as usize] = old[i];
        }
        for t in mesh.triangles.as_flattened_mut() {
            *t = place[*t as usize];
        }
        for i in (1..mesh.triangles.len()).rev() {
            mesh.triangles.swap(i, dice(i + 1));
        }
        mesh
    }

    #[test]
    fn small_meshes_of_every_kind() {
        assert_same(&Mesh::default(), "nothing");
        assert_same(&tetrahedron(), "tetrahedron");
        assert_same(&cube([1.0; 3], 2.0), "cube");
        let two = both(tetrahedron(), &cube([3.0; 3], 1.0));
        assert_same(&pinch(two, 4, 0), "pinch");
        let mut open = cube([0.0; 3], 1.0);
        open.triangles.pop();
        open.triangles[0].swap(0, 1);
        open.triangles.push([3, 3, 5]);
        open.triangles.push([0, 1, 7]);
        open.triangles.push([0, 1, 7]);
        open.positions.push([f32::NAN; 3]);
        assert_same(&open, "wreck");
        open.triangles.push([0, 1, 8]);
        assert_same(&open, "not finite");
        let points = Mesh {
            positions: vec![[1.0; 3]; 3],
            ..Mesh::default()
        };
        assert_same(&points, "points");
    }

    #[test]
    fn meshes_beyond_the_memory_of_a_part() {
        let ring = torus(2.0, 0.5, 200, 120);
        let mut other = torus(1.7, 0.6, 150, 65);
        other.positions.iter_mut().for_each(|p| p[2] += 0.05);
        let mut two = both(ring, &other);
        assert_same(&two, "two rings");
        // Triangles in no order are as many components of their chunks.
        assert_same_in(&shuffled(&two, 3), "two rings, shuffled", 16);
        // Holes, a turned triangle, a fin, a vertex that is not finite, one that nobody uses.
        for t in (0..two.triangles.len()).step_by(2973) {
            two.triangles[t].swap(1, 2);
            two.triangles[t + 5] = two.triangles[t + 6];
            two.triangles.swap_remove(t + 20);
        }
        two.positions[777] = [f32::INFINITY; 3];
        two.positions.push([0.0; 3]);
        assert_same(&two, "wrecked rings");
        assert_same_in(&shuffled(&two, 4), "wrecked rings, shuffled", 16);
    }

    #[test]
    fn a_hub_that_does_not_fit_and_a_lost_vertex_are_said() {
        let mut fan = Mesh::default();
        let count = 300_000;
        fan.positions = (0..count + 2)
            .map(|i| [i as f32, 1.0, (i % 7) as f32])
            .collect();
        fan.triangles = (1..count).map(|i| [0, i, i + 1]).collect();
        let budget = Budget::mib(8).with_threads(1);
        let error = examine(&fan, 0, scratch(), &budget).expect_err("a hub");
        assert_eq!(error.kind(), ErrorKind::BudgetExceeded);
        assert!(error.to_string().contains("--mem"), "{error}");
        assert_same_report(&fan);
        fan.triangles[70_000][1] = count + 2;
        let error = examine(&fan, 0, scratch(), &Budget::mib(64)).expect_err("lost");
        assert!(
            error.to_string().contains("triangle 70000 names"),
            "{error}"
        );
    }

    fn assert_same_report(mesh: &Mesh) {
        let budget = Budget::mib(64);
        let found = examine(mesh, 0, scratch(), &budget).expect("fits");
        assert_eq!(found.report, check(mesh, &budget).expect("fits"));
    }
}
