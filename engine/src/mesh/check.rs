//! Is a mesh closed, two-manifold and consistently oriented, and what is its topology?
//!
//! Every question about edges and fans is answered at a vertex from the triangles around it. So the
//! vertices are cut into ranges, and for each range one pass over the triangles lists what stands
//! around its vertices. Ranges are independent: they run in parallel when memory allows, and one
//! after the other in little memory when it does not.

use super::Mesh;
use super::around::{Around, Counts, scratch_bytes};
use super::crew::on_threads;
use super::joined::unite;
use super::measure::{self, Sums};
use crate::budget::{Budget, human_bytes};
use crate::error::{Error, ErrorKind, Result};
use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Most triangles that [`check`] takes: corners are numbered with one bit to spare.
const MOST_TRIANGLES: usize = (1 << 31) / 3;

/// Most ranges, and so passes over the triangles, before the memory is called too small.
const MOST_RANGES: u64 = 256;

/// What [`check`] finds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Number of vertices, used or not.
    pub vertices: u64,
    /// Number of triangles.
    pub triangles: u64,
    /// Number of different edges.
    pub edges: u64,
    /// Whether every edge has more than one triangle.
    pub closed: bool,
    /// Edges of one triangle.
    pub border_edges: u64,
    /// Edges of three or more triangles.
    pub nonmanifold_edges: u64,
    /// Edges of two triangles that run along them in the same direction.
    pub misoriented_edges: u64,
    /// Fans beyond one at each vertex. A fan is a set of triangles around a vertex, joined by edges
    /// of exactly two triangles.
    pub nonmanifold_vertices: u64,
    /// Triangles that name a vertex twice, or whose area is exactly zero.
    pub degenerate_triangles: u64,
    /// Vertices that no triangle names.
    pub unused_vertices: u64,
    /// Vertices with a coordinate that is infinite or not a number.
    pub nonfinite_vertices: u64,
    /// Parts that have no vertex in common.
    pub components: u64,
    /// Used vertices minus edges plus triangles.
    pub euler: i64,
    /// Handles of all components together, when the mesh is a closed oriented two-manifold.
    pub genus: Option<u64>,
    /// Area in square world units; NaN when a triangle has a corner that is not finite.
    pub area: f64,
    /// Volume in cubic world units, positive when triangles face outward; meaningful when closed.
    pub volume: f64,
    /// Lowest and highest coordinates of the finite vertices.
    pub bounds: Option<[[f32; 3]; 2]>,
}

impl Report {
    /// Whether no edge has more than two triangles and no vertex more than one fan.
    pub fn is_manifold(&self) -> bool {
        self.nonmanifold_edges == 0 && self.nonmanifold_vertices == 0
    }

    /// Whether neighbouring triangles agree on the side that is outside.
    pub fn is_oriented(&self) -> bool {
        self.misoriented_edges == 0
    }

    /// Whether the mesh is a closed, consistently oriented two-manifold of finite triangles with an
    /// area.
    pub fn is_sound(&self) -> bool {
        self.closed
            && self.is_manifold()
            && self.is_oriented()
            && self.degenerate_triangles == 0
            && self.nonfinite_vertices == 0
    }
}

/// Examines `mesh`. Vertices are equal when their numbers are, never by position.
///
/// The result does not depend on the threads or the memory of `budget`.
///
/// # Errors
/// When a triangle names a vertex that the mesh does not have; `LimitExceeded` beyond 715,827,882
/// triangles; `BudgetExceeded` when the memory would force more than 256 passes; `Cancelled`.
///
/// # Memory
/// 8 B a vertex, and up to 12 B a triangle and 4 B a vertex more for speed; not the mesh itself.
pub fn check(mesh: &Mesh, budget: &Budget) -> Result<Report> {
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    if triangles > MOST_TRIANGLES {
        return Err(Error::new(
            ErrorKind::LimitExceeded,
            format!("a mesh of {triangles} triangles; {MOST_TRIANGLES} can be checked"),
        ));
    }
    refuse_lost(mesh)?;
    let mut permit = budget.take(8 * vertices as u64, "checking the mesh")?;
    let (parents, (degrees, sums)) = join(
        budget.threads(),
        || joined_vertices(mesh),
        || (degrees(mesh), measure::sums(mesh)),
    );
    budget.check_cancelled()?;
    let is_part = |v: &usize| degrees[*v] > 0 && parents[*v] as usize == *v;
    let components = (0..vertices).filter(is_part).count() as u64;
    drop(parents);
    permit.try_resize(4 * vertices as u64);
    let counts = count_around_all(mesh, &degrees, budget)?;
    let used = degrees.iter().filter(|&&d| d > 0).count() as u64;
    let nonfinite = mesh.positions.iter().filter(|p| !measure::is_finite(p));
    let found = Found {
        vertices: vertices as u64,
        triangles: triangles as u64,
        used,
        nonfinite: nonfinite.count() as u64,
        bounds: measure::bounds(mesh),
        components,
        counts,
        sums,
    };
    Ok(found.report())
}

/// # Errors
/// When a triangle names a vertex that the mesh does not have.
pub(super) fn refuse_lost(mesh: &Mesh) -> Result<()> {
    let vertices = mesh.positions.len();
    let lost = |t: &[u32; 3]| t.iter().any(|&v| v as usize >= vertices);
    match mesh.triangles.iter().position(lost) {
        None => Ok(()),
        Some(t) => Err(Error::bad_input(format!(
            "triangle {t} names vertices {:?} of a mesh with {vertices}",
            mesh.triangles[t]
        ))),
    }
}

/// What a report is made of.
pub(super) struct Found {
    pub(super) vertices: u64,
    pub(super) triangles: u64,
    /// Vertices of triangles.
    pub(super) used: u64,
    pub(super) nonfinite: u64,
    pub(super) bounds: Option<[[f32; 3]; 2]>,
    pub(super) components: u64,
    pub(super) counts: Counts,
    pub(super) sums: Sums,
}

impl Found {
    pub(super) fn report(self) -> Report {
        let Found { counts, sums, .. } = self;
        let mut report = Report {
            vertices: self.vertices,
            triangles: self.triangles,
            edges: counts.edges,
            closed: counts.border == 0,
            border_edges: counts.border,
            nonmanifold_edges: counts.crowded,
            misoriented_edges: counts.misoriented,
            nonmanifold_vertices: counts.extra_fans,
            degenerate_triangles: sums.degenerate,
            unused_vertices: self.vertices - self.used,
            nonfinite_vertices: self.nonfinite,
            components: self.components,
            euler: self.used as i64 - counts.edges as i64 + self.triangles as i64,
            genus: None,
            area: sums.area,
            volume: sums.volume,
            bounds: self.bounds,
        };
        if report.closed && report.is_manifold() && report.is_oriented() {
            // Every component has euler 2 - 2 genus.
            report.genus = u64::try_from(self.components as i64 - report.euler / 2).ok();
        }
        report
    }
}

/// Runs both, at the same time when there are two threads.
fn join<A: Send, B>(threads: usize, a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B) -> (A, B) {
    if threads < 2 {
        return (a(), b());
    }
    std::thread::scope(|scope| {
        let a = scope.spawn(a);
        let b = b();
        match a.join() {
            Ok(a) => (a, b),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}

/// How many corners of triangles are at each vertex.
fn degrees(mesh: &Mesh) -> Vec<u32> {
    let mut degrees = vec![0; mesh.positions.len()];
    for &v in mesh.triangles.iter().flatten() {
        degrees[v as usize] += 1;
    }
    degrees
}

/// For each vertex another one of its component; for one vertex of each component itself.
fn joined_vertices(mesh: &Mesh) -> Vec<u32> {
    let mut parents: Vec<u32> = (0..mesh.positions.len()).map(|v| v as u32).collect();
    for &[a, b, c] in &mesh.triangles {
        let root = unite(&mut parents, a, b).0;
        unite(&mut parents, root, c);
    }
    parents
}

/// Bytes of the list of a range.
fn list_bytes(vertices: usize, corners: u64) -> u64 {
    4 * (vertices as u64 + corners)
}

/// Cuts the vertices into ranges whose lists take at most `bytes` where possible.
fn cut(degrees: &[u32], bytes: u64) -> Vec<Range<usize>> {
    let mut ranges = Vec::new();
    let (mut start, mut corners) = (0, 0);
    for (v, &degree) in degrees.iter().enumerate() {
        let grown = corners + u64::from(degree);
        if v > start && list_bytes(v + 1 - start, grown) > bytes {
            ranges.push(start..v);
            (start, corners) = (v, 0);
        }
        corners += u64::from(degree);
    }
    if start < degrees.len() {
        ranges.push(start..degrees.len());
    }
    ranges
}

fn count_around_all(mesh: &Mesh, degrees: &[u32], budget: &Budget) -> Result<Counts> {
    let corners = 3 * mesh.triangles.len() as u64;
    let whole = list_bytes(degrees.len(), corners);
    let largest = degrees.iter().copied().max().unwrap_or(0);
    let scratch = scratch_bytes(largest);
    // One worker a thread; fewer, and then smaller ranges, when the memory does not suffice.
    let least = (whole / MOST_RANGES).max(list_bytes(1, u64::from(largest)));
    let mut workers = budget.threads() as u64;
    let free = budget.free_bytes();
    while workers > 1 && workers * (least + scratch) > free {
        workers -= 1;
    }
    let share = (free / workers).saturating_sub(scratch);
    let bytes = whole.div_ceil(workers).min(share).max(least);
    let _permit = budget
        .take(workers * (bytes + scratch), "checking the mesh")
        .map_err(|e| {
            e.context(format!(
                "a mesh of {} triangles is checked fastest with {} beside the mesh itself",
                mesh.triangles.len(),
                human_bytes(whole + scratch + 8 * degrees.len() as u64)
            ))
        })?;
    let ranges = cut(degrees, bytes);
    let next = AtomicUsize::new(0);
    let total = Mutex::new(Counts::default());
    let work = || -> Result<()> {
        let mut around = Around::default();
        while let Some(range) = ranges.get(next.fetch_add(1, Ordering::Relaxed)) {
            budget.check_cancelled()?;
            let counts = around.count(&mesh.triangles, &degrees[range.clone()], range.clone());
            total.lock().expect("no worker panicked").add(counts);
        }
        Ok(())
    };
    on_threads(workers as usize, work)?;
    Ok(total.into_inner().expect("no worker panicked"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::test_meshes::{both, cube, pinch, tetrahedron, torus};

    fn examine(mesh: &Mesh) -> Report {
        let report = check(mesh, &Budget::mib(64).with_threads(2)).expect("checked");
        let alone = check(mesh, &Budget::mib(64).with_threads(1)).expect("checked");
        assert_eq!(format!("{report:?}"), format!("{alone:?}"), "threads show");
        report
    }

    #[test]
    fn closed_shapes_are_sound() {
        for (mesh, euler, genus, volume) in [
            (tetrahedron(), 2, 0, 1.0 / 6.0),
            (cube([1.0; 3], 2.0), 2, 0, 8.0),
            (torus(2.0, 1.0, 3, 3), 0, 1, f64::NAN),
            (torus(3.0, 1.0, 40, 17), 0, 1, f64::NAN),
        ] {
            let report = examine(&mesh);
            assert!(report.is_sound(), "{report:?}");
            assert_eq!((report.euler, report.genus), (euler, Some(genus)));
            assert_eq!((report.components, report.unused_vertices), (1, 0));
            assert_eq!(report.edges * 2, report.triangles * 3);
            assert!(volume.is_nan() || (report.volume - volume).abs() < 1e-12);
            assert!(report.volume > 0.0);
        }
    }

    #[test]
    fn genus_adds_up_over_components() {
        let mut mesh = cube([9.0; 3], 1.0);
        for _ in 0..3 {
            mesh = both(mesh, &torus(2.0, 0.5, 9, 6));
        }
        let report = examine(&mesh);
        assert_eq!((report.components, report.genus), (4, Some(3)));
        assert_eq!(report.euler, 2);
    }

    #[test]
    fn no_triangle_is_closed_and_empty() {
        let report = examine(&Mesh::default());
        assert!(report.is_sound());
        assert_eq!(
            (report.components, report.euler, report.genus),
            (0, 0, Some(0))
        );
        let mut points = tetrahedron();
        points.triangles.clear();
        assert_eq!(examine(&points).unused_vertices, 4);
    }

    #[test]
    fn a_hole_has_a_border() {
        let mut mesh = cube([0.0; 3], 1.0);
        mesh.triangles.pop();
        let report = examine(&mesh);
        assert!(!report.closed && !report.is_sound());
        assert_eq!((report.border_edges, report.genus), (3, None));
        assert!(report.is_manifold() && report.is_oriented());
    }

    #[test]
    fn a_turned_triangle_is_misoriented() {
        let mut mesh = tetrahedron();
        mesh.triangles[2].swap(0, 1);
        let report = examine(&mesh);
        assert_eq!(report.misoriented_edges, 3);
        assert!(report.closed && report.is_manifold() && !report.is_sound());
        assert_eq!(report.genus, None);
    }

    #[test]
    fn a_third_triangle_at_an_edge_is_not_manifold() {
        let mut mesh = tetrahedron();
        mesh.positions.push([2.0, 2.0, 2.0]);
        mesh.triangles.push([0, 1, 4]);
        let report = examine(&mesh);
        assert_eq!((report.nonmanifold_edges, report.border_edges), (1, 2));
        // The fans at both ends of the edge fall apart into the flap and the rest.
        assert_eq!(report.nonmanifold_vertices, 2);
    }

    #[test]
    fn two_cubes_at_one_vertex_are_two_fans() {
        let mesh = both(cube([0.0; 3], 1.0), &cube([1.0; 3], 1.0));
        let report = examine(&pinch(mesh, 8, 7));
        assert_eq!(report.nonmanifold_vertices, 1);
        assert_eq!((report.components, report.unused_vertices), (1, 1));
        assert!(report.closed && report.nonmanifold_edges == 0 && !report.is_sound());
        assert_eq!(report.genus, None);
    }

    #[test]
    fn two_cubes_at_one_edge_share_four_triangles() {
        let mut mesh = both(cube([0.0; 3], 1.0), &cube([1.0, 1.0, 0.0], 1.0));
        mesh = pinch(pinch(mesh, 8, 3), 12, 7);
        let report = examine(&mesh);
        assert_eq!(report.nonmanifold_edges, 1);
        assert_eq!(report.unused_vertices, 2);
        assert!(!report.is_manifold());
    }

    #[test]
    fn degenerate_triangles_are_counted() {
        let mut mesh = tetrahedron();
        mesh.positions.push([2.0, 0.0, 0.0]);
        mesh.triangles.push([0, 1, 4]); // on a line
        mesh.triangles.push([2, 2, 3]); // a vertex twice
        mesh.triangles.push([3, 3, 3]);
        let report = examine(&mesh);
        assert_eq!(report.degenerate_triangles, 3);
        assert!(!report.is_sound());
    }

    #[test]
    fn a_needle_is_not_degenerate() {
        let mut mesh = tetrahedron();
        for p in &mut mesh.positions {
            p[0] *= 1e-30;
        }
        assert_eq!(examine(&mesh).degenerate_triangles, 0);
    }

    #[test]
    fn unused_and_not_finite_vertices_are_counted() {
        let mut mesh = tetrahedron();
        mesh.positions.insert(0, [f32::NAN, 0.0, 0.0]);
        mesh.positions.push([0.0, f32::INFINITY, 0.0]);
        for corner in mesh.triangles.iter_mut().flatten() {
            *corner += 1;
        }
        let report = examine(&mesh);
        assert_eq!((report.unused_vertices, report.nonfinite_vertices), (2, 2));
        assert_eq!(report.bounds, Some([[0.0; 3], [1.0; 3]]));
        assert!(report.closed && !report.is_sound());
        assert!((report.volume - 1.0 / 6.0).abs() < 1e-12);
    }

    #[test]
    fn a_lost_vertex_is_an_error() {
        let mut mesh = tetrahedron();
        mesh.triangles[1][2] = 4;
        let error = check(&mesh, &Budget::mib(1)).expect_err("no such vertex");
        assert_eq!(error.kind(), ErrorKind::BadInput);
        assert!(error.to_string().contains("triangle 1"), "{error}");
    }

    #[test]
    fn little_memory_gives_the_same_report() {
        let mesh = both(torus(3.0, 1.0, 100, 70), &torus(5.0, 1.0, 30, 11));
        let roomy = Budget::mib(64).with_threads(1);
        let expected = check(&mesh, &roomy).expect("checked");
        let vertices = mesh.positions.len() as u64;
        let tight = Budget::bytes(vertices * 8 + 500).with_threads(3);
        assert_eq!(check(&mesh, &tight).expect("checked"), expected);
        assert!(tight.peak_bytes() < roomy.peak_bytes() / 2);
        assert_eq!(tight.used_bytes(), 0);
        let poor = Budget::bytes(vertices * 7);
        let error = check(&mesh, &poor).expect_err("too little");
        assert_eq!(error.kind(), ErrorKind::BudgetExceeded);
        assert_eq!(poor.used_bytes(), 0);
    }

    #[test]
    fn a_vertex_with_very_many_triangles() {
        // A double cone over a polygon of 20,000 corners.
        let n = 20_000;
        let mut mesh = Mesh::default();
        for i in 0..n {
            let angle = f64::from(i) / f64::from(n) * std::f64::consts::TAU;
            mesh.positions
                .push([angle.cos() as f32, angle.sin() as f32, 0.0]);
        }
        mesh.positions.extend([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]);
        for i in 0..n {
            let j = (i + 1) % n;
            mesh.triangles.extend([[i, j, n], [j, i, n + 1]]);
        }
        assert!(examine(&mesh).is_sound());
        // The tips of two as one vertex: two fans there.
        let first_of_second = mesh.positions.len() as u32;
        let twice = both(mesh.clone(), &mesh);
        let report = examine(&pinch(twice, first_of_second + n, n));
        assert_eq!(report.nonmanifold_vertices, 1);
    }

    #[test]
    fn cancelling_stops() {
        let budget = Budget::mib(1);
        budget.cancel_token().cancel();
        let error = check(&tetrahedron(), &budget).expect_err("cancelled");
        assert_eq!(error.kind(), ErrorKind::Cancelled);
    }
}
