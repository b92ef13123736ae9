//! All labels in one pass against the mask of each label, meshed alone.

use super::dense;
use crate::support::rng::Rng;
use brickmarch::field::Labels;
use brickmarch::iso::{Boundary, Extract, ExtractLabels, LabelStats, extract, extract_labels};
use brickmarch::mesh::{Collect, LabelSink, LabelSpool, Layout, MeshSink, Piece, Totals};
use brickmarch::{Affine, Box3, Budget, ErrorKind, Grid, Kind, Mesh, Result};
use std::collections::{BTreeMap, BTreeSet};

/// Labels in memory.
struct Array {
    grid: Grid,
    edge: u32,
    values: Vec<u32>,
}

impl Labels for Array {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    fn block_edge(&self) -> u32 {
        self.edge
    }

    fn read(&self, region: Box3, out: &mut [u32]) -> Result<()> {
        assert!(self.grid.domain.contains_box(&region), "reads outside");
        for (n, out) in out.iter_mut().enumerate() {
            *out = self.values[self.grid.domain.offset_of(point(region, n))];
        }
        Ok(())
    }

    fn range(&self, region: Box3) -> Result<Option<[u32; 2]>> {
        let region = region.intersect(&self.grid.domain);
        let at = |n| self.values[self.grid.domain.offset_of(point(region, n))];
        let all = (0..region.count() as usize).map(at);
        Ok(all.fold(None, |range: Option<[u32; 2]>, v| {
            Some(range.map_or([v, v], |[low, high]| [low.min(v), high.max(v)]))
        }))
    }
}

fn point(region: Box3, n: usize) -> [i32; 3] {
    let [nx, ny, _] = region.size().map(|n| n as usize);
    let at = [n % nx, n / nx % ny, n / nx / ny];
    std::array::from_fn(|a| region.min[a] + at[a] as i32)
}

#[derive(Clone, Copy, Debug)]
enum Kinds {
    /// Every sample for itself.
    Noise,
    /// The nearest of some seeds, so that many meet in an edge.
    Cells,
    /// One label nearly everywhere.
    Islands,
    /// No two samples alike: as many labels as samples.
    Different,
}

fn array(kinds: Kinds, domain: Box3, edge: u32, rng: &mut Rng) -> Array {
    // Ids that a single cannot tell apart.
    let ids = [0, 1, 2, 7, 16_777_216, 16_777_217, u32::MAX - 1, u32::MAX];
    let seeds: Vec<([f64; 3], u32)> = (0..14)
        .map(|_| {
            let size = domain.size();
            let at = std::array::from_fn(|a| {
                f64::from(domain.min[a]) + f64::from(rng.below(size[a].into()) as u32)
            });
            (at, rng.pick(&ids))
        })
        .collect();
    let count = domain.count() as usize;
    let mut value = |n: usize| match kinds {
        Kinds::Noise => rng.pick(&ids),
        Kinds::Different => n as u32 + 1,
        Kinds::Islands => match rng.chance(500) {
            true => rng.pick(&ids),
            false => 7,
        },
        Kinds::Cells => {
            let p = point(domain, n);
            let far =
                |at: &[f64; 3]| -> f64 { (0..3).map(|a| (f64::from(p[a]) - at[a]).powi(2)).sum() };
            let nearest = seeds.iter().min_by(|a, b| far(&a.0).total_cmp(&far(&b.0)));
            nearest.expect("some").1
        }
    };
    let values = (0..count).map(&mut value).collect();
    let columns = [[0.5, 0.0, 0.1], [0.0, -1.0, 0.0], [0.0, 0.2, 2.0]];
    Array {
        grid: Grid {
            index_to_world: Affine::from_columns(columns, [3.0, -40.0, 7.0]),
            ..Grid::new(domain)
        },
        edge,
        values,
    }
}

/// The mask of a label, smoothed by the rule in plain words: each pass replaces every sample by a
/// quarter of both neighbours and a half of itself, along x, then y, then z.
fn mask(array: &Array, label: u32, passes: u8) -> Vec<f32> {
    let domain = array.grid.domain;
    let of = |v: &u32| f64::from(u8::from(*v == label));
    let mut values: Vec<f64> = array.values.iter().map(of).collect();
    for _ in 0..passes {
        for axis in 0..3 {
            let old = values.clone();
            for (n, value) in values.iter_mut().enumerate() {
                let p = point(domain, n);
                let beside = |step: i32| {
                    let mut q = p;
                    q[axis] = (p[axis] + step).clamp(domain.min[axis], domain.max[axis] - 1);
                    old[domain.offset_of(q)]
                };
                *value = beside(-1) / 4.0 + beside(0) / 2.0 + beside(1) / 4.0;
            }
        }
    }
    values.into_iter().map(|v| v as f32).collect()
}

fn alone(array: &Array, label: u32, options: &ExtractLabels) -> Mesh {
    let domain = array.grid.domain;
    let mut field = dense(domain, mask(array, label, options.smooth), array.edge);
    field.kind = Kind::Mask;
    let field = Placed(field, array.grid);
    let options = Extract {
        iso: 0.5,
        region: options.region,
        boundary: options.boundary,
        normals: options.normals,
        keys: options.keys,
        index_space: options.index_space,
        allow_empty: true,
        relax: options.relax,
        ..Extract::default()
    };
    let mut sink = Collect::default();
    extract(&field, &options, &Budget::mib(256), &mut sink).expect("meshes");
    sink.into_mesh()
}

/// A dense field somewhere else in the world.
struct Placed(brickmarch::field::Dense, Grid);

impl brickmarch::Field for Placed {
    fn grid(&self) -> &Grid {
        &self.1
    }
    fn kind(&self) -> Kind {
        self.0.kind
    }
    fn block_edge(&self) -> u32 {
        self.0.block_edge
    }
    fn read(&self, region: Box3, out: &mut brickmarch::Samples<'_>) -> Result<()> {
        self.0.read(region, out)
    }
    fn range(&self, region: Box3) -> Result<brickmarch::Range> {
        self.0.range(region)
    }
}

fn together(
    array: &Array,
    options: &ExtractLabels,
    budget: &Budget,
) -> Result<(BTreeMap<u32, Mesh>, LabelStats)> {
    let most = Totals {
        vertices: u64::MAX,
        triangles: u64::MAX,
    };
    let mut spool = LabelSpool::new(tempfile::tempfile().expect("a scratch file"), most);
    let stats = extract_labels(array, options, budget, &mut spool)?;
    spool.flush().expect("written");
    let mut meshes = BTreeMap::new();
    for &(label, totals) in &stats.labels {
        let mut sink = Collect::default();
        sink.begin(spool.layout()).expect("begun");
        spool.replay(label, &sink).expect("read");
        let mesh = sink.into_mesh();
        assert_eq!(mesh.positions.len() as u64, totals.vertices);
        assert_eq!(mesh.triangles.len() as u64, totals.triangles);
        meshes.insert(label, mesh);
    }
    Ok((meshes, stats))
}

/// Random options, the same for a run of the test.
fn options(rng: &mut Rng, domain: Box3) -> ExtractLabels {
    let middle = Box3 {
        min: domain.min.map(|v| v + 3),
        max: domain.max.map(|v| v - 5),
    };
    ExtractLabels {
        smooth: rng.pick(&[0, 0, 1, 2, 4]),
        relax: rng.pick(&[0, 0, 0, 1, 3]),
        region: rng.pick(&[None, None, Some(middle)]),
        boundary: rng.pick(&[Boundary::Cap, Boundary::Cut, Boundary::Tile]),
        normals: rng.pick(&[false, true]),
        keys: rng.pick(&[false, true]),
        index_space: rng.pick(&[false, true]),
        allow_empty: true,
        ..ExtractLabels::default()
    }
}

#[test]
fn every_label_has_the_mesh_of_its_mask_alone() {
    let mut rng = Rng::new(501);
    let mut compared = 0;
    for round in 0..24 {
        let domain = Box3::new([-5, 2, 100], [24, 37, 131]);
        let kinds = rng.pick(&[Kinds::Noise, Kinds::Cells, Kinds::Cells, Kinds::Islands]);
        let edge = rng.pick(&[8, 16, 32]);
        let array = array(kinds, domain, edge, &mut rng);
        let options = options(&mut rng, domain);
        let what = format!("{round}: {kinds:?} by {edge}, {options:?}");
        let memory = if options.relax > 0 {
            [96, 256]
        } else {
            [24, 64]
        };
        let budget = Budget::mib(rng.pick(&memory)).with_threads(rng.pick(&[1, 2, 4]));
        let (meshes, _) = together(&array, &options, &budget).expect(&what);
        let labels: BTreeSet<u32> = array.values.iter().copied().filter(|&l| l != 0).collect();
        assert!(meshes.keys().all(|l| labels.contains(l)), "{what}");
        for &label in &labels {
            let want = alone(&array, label, &options);
            let ours = meshes.get(&label).cloned().unwrap_or_default();
            assert!(ours == want, "{what}: label {label}");
            compared += usize::from(!want.triangles.is_empty());
        }
        assert_eq!(budget.used_bytes(), 0);
    }
    assert!(compared > 100, "{compared} meshes only");
}

#[test]
fn only_those_asked_for_and_also_the_background() {
    let mut rng = Rng::new(502);
    let domain = Box3::from_size([20, 20, 20]);
    let array = array(Kinds::Noise, domain, 8, &mut rng);
    let options = ExtractLabels {
        labels: Some(vec![u32::MAX, 0, 2, 2]),
        ..ExtractLabels::default()
    };
    let (meshes, _) = together(&array, &options, &Budget::mib(64)).expect("they occur");
    let keys: Vec<u32> = meshes.keys().copied().collect();
    assert_eq!(keys, [0, 2, u32::MAX]);
    for (label, mesh) in meshes {
        assert!(mesh == alone(&array, label, &options), "{label}");
    }
    for (list, named) in [
        (vec![2, 3], "label 3"),
        (vec![3, 4, 5], "3 labels (3, 4, 5)"),
    ] {
        let missing = ExtractLabels {
            labels: Some(list),
            ..ExtractLabels::default()
        };
        let error = together(&array, &missing, &Budget::mib(64))
            .map(|(m, _)| m.len())
            .expect_err("no such label");
        assert_eq!(error.kind(), ErrorKind::EmptySurface);
        assert!(error.to_string().contains(named), "{error}");
    }
}

#[test]
fn as_many_labels_as_samples_fit_or_are_refused() {
    let mut rng = Rng::new(503);
    let domain = Box3::from_size([40, 24, 24]);
    let array = array(Kinds::Different, domain, 32, &mut rng);
    let options = ExtractLabels::default();
    let (meshes, stats) = together(&array, &options, &Budget::mib(64)).expect("fits");
    assert_eq!(meshes.len() as u64, domain.count());
    // A lone sample is an octahedron.
    assert!(
        meshes
            .values()
            .all(|m| m.positions.len() == 6 && m.triangles.len() == 8)
    );
    assert!(stats.front_bytes_max >= 256 * domain.count());
    // The pieces fit, the list of labels does not.
    let budget = Budget::mib(9).with_threads(1);
    let error = together(&array, &options, &budget)
        .map(|(meshes, _)| meshes.len())
        .expect_err("23,040 labels in little memory");
    assert_eq!(error.kind(), ErrorKind::BudgetExceeded);
    assert!(error.to_string().contains("--mem"), "{error}");
    assert!(error.to_string().contains("labels so far"), "{error}");
    assert_eq!(budget.used_bytes(), 0);
}

#[test]
fn mistakes_are_refused() {
    let mut rng = Rng::new(504);
    let array = array(Kinds::Noise, Box3::from_size([9, 9, 9]), 8, &mut rng);
    let with = |change: fn(&mut ExtractLabels)| {
        let mut options = ExtractLabels::default();
        change(&mut options);
        together(&array, &options, &Budget::mib(64))
            .map(|(meshes, _)| meshes.len())
            .expect_err("refused")
            .kind()
    };
    assert_eq!(with(|o| o.smooth = 5), ErrorKind::BadInput);
    let outside = |o: &mut ExtractLabels| o.region = Some(Box3::from_size([10, 9, 9]));
    assert_eq!(with(outside), ErrorKind::BadInput);
    let cancelled = Budget::mib(64);
    cancelled.cancel_token().cancel();
    let error = together(&array, &ExtractLabels::default(), &cancelled)
        .map(|(m, _)| m.len())
        .expect_err("stopped");
    assert_eq!(error.kind(), ErrorKind::Cancelled);
}

/// A receiver that fails stops the march with its error, on any number of threads.
#[test]
fn a_sink_that_fails_is_heard() {
    struct Full(u32);
    impl LabelSink for Full {
        fn begin(&mut self, _layout: Layout) -> Result<()> {
            Ok(())
        }
        fn write(&mut self, _label: u32, _piece: &Piece) -> Result<()> {
            self.0 += 1;
            match self.0 < 20 {
                true => Ok(()),
                false => Err(brickmarch::Error::new(ErrorKind::Io, "the disk is full")),
            }
        }
    }
    let mut rng = Rng::new(505);
    let array = array(Kinds::Cells, Box3::from_size([60, 60, 40]), 8, &mut rng);
    for threads in [1, 2, 8] {
        let budget = Budget::mib(64).with_threads(threads);
        let error = extract_labels(&array, &ExtractLabels::default(), &budget, &mut Full(0))
            .expect_err("full");
        assert_eq!(error.to_string(), "the disk is full");
        assert_eq!(budget.used_bytes(), 0);
    }
}
