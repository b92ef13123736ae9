//! Extraction as a whole, on small fields.

use super::extract::extract_from;
use super::{Boundary, Extract, extract};
use crate::field::Dense;
use crate::mesh::{Collect, Count, EdgeKey, Layout, MeshSink, Piece, Totals};
use crate::{Affine, Box3, Budget, ErrorKind, Grid, Inside, Kind, Mesh, Result};
use std::collections::{BTreeSet, HashMap};

/// xorshift64*, fixed.
struct Rng(u64);

impl Rng {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }
}

fn dense(domain: Box3, edge: u32, mut value: impl FnMut([i32; 3]) -> f32) -> Dense {
    let mut values = Vec::new();
    for k in domain.min[2]..domain.max[2] {
        for j in domain.min[1]..domain.max[1] {
            for i in domain.min[0]..domain.max[0] {
                values.push(value([i, j, k]));
            }
        }
    }
    let mut field = Dense::new(Grid::new(domain), values).expect("right count");
    field.block_edge = edge;
    field
}

fn run(field: &Dense, options: &Extract, threads: usize) -> Mesh {
    let mut sink = Collect::default();
    extract(
        field,
        options,
        &Budget::mib(64).with_threads(threads),
        &mut sink,
    )
    .expect("meshes");
    sink.into_mesh()
}

/// Counts of edges by how often their triangles use them; panics where a mesh is not an oriented
/// 2-manifold. Returns the number of border edges.
fn assert_manifold(mesh: &Mesh) -> usize {
    let mut sides: HashMap<(u32, u32), u32> = HashMap::new();
    for t in &mesh.triangles {
        for k in 0..3 {
            let side = (t[k], t[(k + 1) % 3]);
            assert_ne!(side.0, side.1);
            let n = sides.entry(side).or_default();
            *n += 1;
            assert_eq!(*n, 1, "side {side:?} twice in one direction");
        }
        let p = t.map(|v| mesh.positions[v as usize].map(f64::from));
        let (u, v): ([f64; 3], [f64; 3]) = (
            std::array::from_fn(|a| p[1][a] - p[0][a]),
            std::array::from_fn(|a| p[2][a] - p[0][a]),
        );
        let n = [
            u[1] * v[2] - u[2] * v[1],
            u[2] * v[0] - u[0] * v[2],
            u[0] * v[1] - u[1] * v[0],
        ];
        assert!(n.iter().any(|&c| c != 0.0), "degenerate triangle {p:?}");
    }
    // One fan per vertex: the sides opposite a vertex form one path or cycle.
    let mut fans: HashMap<u32, Vec<(u32, u32)>> = HashMap::new();
    for t in &mesh.triangles {
        for k in 0..3 {
            fans.entry(t[k])
                .or_default()
                .push((t[(k + 1) % 3], t[(k + 2) % 3]));
        }
    }
    assert_eq!(fans.len(), mesh.positions.len(), "every vertex is used");
    for (v, fan) in fans {
        let next: HashMap<u32, u32> = fan.iter().copied().collect();
        let ends: BTreeSet<u32> = fan.iter().map(|f| f.1).collect();
        let start = fan
            .iter()
            .map(|f| f.0)
            .find(|a| !ends.contains(a))
            .unwrap_or(fan[0].0);
        let (mut at, mut length) = (start, 0);
        while let Some(&to) = next.get(&at) {
            length += 1;
            at = to;
            if at == start {
                break;
            }
        }
        assert_eq!(length, fan.len(), "vertex {v} has several fans");
    }
    sides
        .keys()
        .filter(|&&(a, b)| !sides.contains_key(&(b, a)))
        .count()
}

fn volume(mesh: &Mesh) -> f64 {
    let corner = |v: u32| mesh.positions[v as usize].map(f64::from);
    mesh.triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(corner);
            (a[0] * (b[1] * c[2] - b[2] * c[1])
                + a[1] * (b[2] * c[0] - b[0] * c[2])
                + a[2] * (b[0] * c[1] - b[1] * c[0]))
                / 6.0
        })
        .sum()
}

/// Triangles by key, turned so that the smallest key comes first.
fn keyed(mesh: &Mesh) -> BTreeSet<[EdgeKey; 3]> {
    let turn = |t: [EdgeKey; 3]| {
        let least = (0..3).min_by_key(|&k| t[k]).expect("three");
        [t[least], t[(least + 1) % 3], t[(least + 2) % 3]]
    };
    mesh.triangles
        .iter()
        .map(|t| turn(t.map(|v| mesh.keys[v as usize])))
        .collect()
}

fn noise(seed: u64, domain: Box3, edge: u32, levels: u64) -> Dense {
    let mut rng = Rng(seed);
    dense(domain, edge, |_| match rng.below(40) {
        0 => f32::NAN,
        1 => f32::INFINITY,
        2 => f32::NEG_INFINITY,
        _ => rng.below(levels) as f32 / (levels - 1) as f32 * 4.0 - 2.0,
    })
}

#[test]
fn noise_of_every_kind_is_closed_and_manifold() {
    for (seed, (size, edge, levels)) in [
        ([9, 10, 11], 8, 5),
        ([17, 16, 8], 8, 1 << 20),
        ([33, 20, 18], 16, 3),
        ([1, 9, 9], 8, 9),
        ([40, 33, 34], 32, 1 << 20),
    ]
    .into_iter()
    .enumerate()
    {
        let domain = Box3::new([-3, 5, 0], std::array::from_fn(|a| [-3, 5, 0][a] + size[a]));
        let field = noise(seed as u64 + 1, domain, edge, levels);
        for inside in [Inside::Above, Inside::Below] {
            let options = Extract {
                inside: Some(inside),
                normals: true,
                ..Extract::default()
            };
            let mesh = run(&field, &options, 2);
            assert_eq!(assert_manifold(&mesh), 0, "closed");
            assert!(volume(&mesh) > 0.0, "outward");
            assert_eq!(mesh.normals.len(), mesh.positions.len());
            let open = run(
                &field,
                &Extract {
                    boundary: Boundary::Cut,
                    allow_empty: true,
                    ..options
                },
                1,
            );
            assert_manifold(&open);
        }
    }
}

#[test]
fn same_mesh_for_any_threads_and_any_blocks_by_key() {
    let domain = Box3::from_size([37, 41, 35]);
    let options = Extract {
        keys: true,
        normals: true,
        ..Extract::default()
    };
    let meshes: Vec<Mesh> = [8, 16, 32]
        .map(|edge| run(&noise(7, domain, edge, 4), &options, 1))
        .into();
    for (mesh, edge) in meshes.iter().zip([8, 16, 32]) {
        for threads in [2, 8] {
            assert_eq!(mesh, &run(&noise(7, domain, edge, 4), &options, threads));
        }
        assert_eq!(keyed(mesh), keyed(&meshes[0]));
    }
}

#[test]
fn tiles_join_by_key() {
    let domain = Box3::from_size([37, 25, 30]);
    let field = noise(3, domain, 8, 6);
    let options = Extract {
        keys: true,
        ..Extract::default()
    };
    let whole = run(&field, &options, 2);
    let mut joined = BTreeSet::new();
    let mut positions: HashMap<EdgeKey, [f32; 3]> = HashMap::new();
    let cuts = [0, 13, 16, 37];
    for x in cuts.windows(2) {
        let region = Box3::new([x[0], 0, 0], [x[1], 25, 30]);
        let options = Extract {
            region: Some(region),
            boundary: Boundary::Tile,
            ..options.clone()
        };
        let mesh = run(&field, &options, 2);
        assert_manifold(&mesh);
        for (key, p) in mesh.keys.iter().zip(&mesh.positions) {
            assert_eq!(
                positions.entry(*key).or_insert(*p),
                p,
                "same bits from both sides"
            );
        }
        for t in keyed(&mesh) {
            assert!(joined.insert(t), "no triangle twice");
        }
    }
    assert_eq!(joined, keyed(&whole));
    assert_eq!(positions.len(), whole.positions.len());
    let middle = Box3::new([4, 5, 6], [20, 21, 22]);
    let boxed = run(
        &field,
        &Extract {
            region: Some(middle),
            ..options
        },
        2,
    );
    assert_eq!(
        assert_manifold(&boxed),
        0,
        "a region is capped all around by default"
    );
}

fn spheres(p: [i32; 3]) -> f32 {
    let ball = |c: [f32; 3], r: f32| {
        (0..3)
            .map(|a| (p[a] as f32 - c[a]).powi(2))
            .sum::<f32>()
            .sqrt()
            - r
    };
    ball([20.0, 20.0, 20.0], 12.3).min(ball([55.0, 30.0, 24.0], 9.1))
}

#[test]
fn a_seed_finds_its_component_and_no_other() {
    let mut field = dense(Box3::from_size([80, 50, 50]), 8, spheres);
    field.kind = Kind::Distance;
    let all = run(
        &field,
        &Extract {
            keys: true,
            ..Extract::default()
        },
        2,
    );
    let one = |seed| {
        run(
            &field,
            &Extract {
                keys: true,
                seeds: vec![seed],
                ..Extract::default()
            },
            2,
        )
    };
    let (a, b) = (one([32, 20, 20]), one([55, 39, 24]));
    assert_eq!(assert_manifold(&a) + assert_manifold(&b), 0);
    assert_eq!(a.triangles.len() + b.triangles.len(), all.triangles.len());
    let mut union = keyed(&a);
    union.extend(keyed(&b));
    assert_eq!(union, keyed(&all));
    let exact = 4.0 / 3.0 * std::f64::consts::PI * 12.3f64.powi(3);
    assert!((volume(&a) / exact - 1.0).abs() < 0.01);
    let both = run(
        &field,
        &Extract {
            keys: true,
            seeds: vec![[32, 20, 20], [55, 39, 24], [20, 32, 20]],
            ..Extract::default()
        },
        1,
    );
    assert_eq!(keyed(&both), keyed(&all));
}

/// Counts, and looks at the number of every local vertex, as file sinks may.
#[derive(Default)]
struct LooksAtAll(Count);

impl MeshSink for LooksAtAll {
    fn begin(&mut self, layout: Layout) -> Result<()> {
        self.0.begin(layout)
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        let end = piece.first_vertex + piece.own.len() as u64;
        assert!(
            piece.ids.iter().all(|&id| id < end),
            "a number that no vertex has"
        );
        Ok(())
    }

    fn finish(&mut self, totals: Totals) -> Result<()> {
        self.0.finish(totals)
    }
}

#[test]
fn pieces_of_one_of_many_surfaces_hold_numbers_that_exist() {
    // Two shells in one block: the walk along one leaves the vertices of the other alone.
    let mut field = dense(Box3::from_size([24, 24, 24]), 16, |p| {
        let r = p
            .map(|v| (v as f32 - 11.3).powi(2))
            .iter()
            .sum::<f32>()
            .sqrt();
        ((r - 7.0).abs() - 1.2).max(0.0) - (r - 3.0).clamp(-0.5, 0.0) - 0.2
    });
    field.kind = Kind::Distance;
    let options = Extract {
        seeds: vec![[19, 11, 11]],
        ..Extract::default()
    };
    let mut sink = LooksAtAll::default();
    extract(&field, &options, &Budget::mib(64), &mut sink).expect("meshes");
    assert!(sink.0.totals.triangles > 0);
}

#[test]
fn walking_noise_component_by_component_gives_the_whole() {
    let domain = Box3::from_size([20, 19, 18]);
    let field = noise(11, domain, 8, 7);
    let whole = run(
        &field,
        &Extract {
            keys: true,
            ..Extract::default()
        },
        2,
    );
    let mut left = keyed(&whole);
    let mut walks = 0;
    while let Some(t) = left.first().copied() {
        // A cell of this triangle: the walker takes all sheets of the seed cell.
        let cells = (0..27).map(|n| [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1]);
        let cell = cells
            .map(|d: [i32; 3]| std::array::from_fn(|a| t[0].point[a] + d[a]))
            .find(|&cell| t.iter().all(|&key| super::walker::on_cell(key, cell)))
            .expect("the corners of a triangle share a cell");
        let mesh = run(
            &field,
            &Extract {
                keys: true,
                seeds: vec![cell],
                ..Extract::default()
            },
            1,
        );
        assert_eq!(assert_manifold(&mesh), 0);
        let found = keyed(&mesh);
        assert!(found.contains(&t));
        for t in found {
            left.remove(&t);
        }
        walks += 1;
    }
    assert!(walks > 3, "noise has several components");
}

#[test]
fn mirrored_and_stretched_worlds_face_outwards() {
    let mut field = dense(Box3::from_size([80, 50, 50]), 16, spheres);
    field.kind = Kind::Distance;
    let plain = volume(&run(&field, &Extract::default(), 2));
    for map in [
        Affine::from_spacing([-0.5, 0.7, 3.0], [9.0, -4.0, 100.0]),
        Affine::from_columns(
            [[0.0, 2.0, 0.0], [0.5, 0.0, 0.1], [0.0, 0.0, 3.0]],
            [1.0, 2.0, 3.0],
        ),
    ] {
        let grid = Grid {
            index_to_world: map,
            ..Grid::new(Box3::from_size([80, 50, 50]))
        };
        let mut moved = Dense::new(grid, field.values().to_vec()).expect("same size");
        moved.kind = Kind::Distance;
        let mesh = run(
            &moved,
            &Extract {
                normals: true,
                ..Extract::default()
            },
            2,
        );
        assert_eq!(assert_manifold(&mesh), 0);
        let ratio = volume(&mesh) / (plain * map.determinant().abs());
        assert!((ratio - 1.0).abs() < 1e-4, "{ratio}");
        // Normals agree with the winding.
        for t in &mesh.triangles {
            let p = t.map(|v| mesh.positions[v as usize]);
            let (u, v): ([f32; 3], [f32; 3]) = (
                std::array::from_fn(|a| p[1][a] - p[0][a]),
                std::array::from_fn(|a| p[2][a] - p[0][a]),
            );
            let n = [
                u[1] * v[2] - u[2] * v[1],
                u[2] * v[0] - u[0] * v[2],
                u[0] * v[1] - u[1] * v[0],
            ];
            let length = n.iter().map(|c| c * c).sum::<f32>().sqrt();
            let normal = mesh.normals[t[0] as usize];
            let cosine = (0..3).map(|a| n[a] * normal[a]).sum::<f32>() / length;
            assert!(cosine > 0.5, "{cosine}");
        }
    }
}

#[test]
fn nonsense_is_refused_in_words() {
    let mut field = dense(Box3::from_size([20, 20, 20]), 8, spheres);
    field.kind = Kind::Distance;
    let fails = |options: Extract| {
        extract(&field, &options, &Budget::mib(64), &mut Collect::default()).expect_err("refused")
    };
    assert_eq!(
        fails(Extract {
            iso: -100.0,
            ..Extract::default()
        })
        .kind(),
        ErrorKind::EmptySurface
    );
    assert_eq!(
        fails(Extract {
            iso: f32::NAN,
            ..Extract::default()
        })
        .kind(),
        ErrorKind::BadInput
    );
    for seed in [[5, 5, 5], [100, 0, 0]] {
        let error = fails(Extract {
            iso: 0.5,
            boundary: Boundary::Cut,
            seeds: vec![seed],
            ..Extract::default()
        });
        assert_eq!(error.kind(), ErrorKind::BadInput);
    }
    let outside = Box3::new([0, 0, 10], [10, 10, 30]);
    assert_eq!(
        fails(Extract {
            region: Some(outside),
            ..Extract::default()
        })
        .kind(),
        ErrorKind::BadInput
    );
    let small = extract(
        &field,
        &Extract::default(),
        &Budget::mib(1),
        &mut Collect::default(),
    );
    assert_eq!(
        small.expect_err("too small").kind(),
        ErrorKind::BudgetExceeded
    );
}

/// Takes numbers that begin at `first` and hands them on from 0.
struct Renumber {
    first: Totals,
    inner: Collect,
}

impl MeshSink for Renumber {
    fn begin(&mut self, layout: Layout) -> Result<()> {
        self.inner.begin(layout)
    }

    fn write(&self, piece: &Piece) -> Result<()> {
        let mut piece = piece.clone();
        piece.first_vertex -= self.first.vertices;
        piece.first_triangle -= self.first.triangles;
        for t in 0..piece.triangles.len() {
            let ids = piece.triangle_ids(t);
            assert!(ids.iter().all(|&id| id >= self.first.vertices), "{ids:?}");
        }
        // Local vertices that no triangle uses have any number.
        for id in &mut piece.ids {
            *id = id.saturating_sub(self.first.vertices);
        }
        self.inner.write(&piece)
    }

    fn finish(&mut self, totals: Totals) -> Result<()> {
        self.inner.finish(Totals {
            vertices: totals.vertices - self.first.vertices,
            triangles: totals.triangles - self.first.triangles,
        })
    }
}

#[test]
fn numbers_of_vertices_cross_2_to_the_31_and_32() {
    let field = dense(Box3::from_size([40, 40, 40]), 8, |p| {
        p.map(|v| (v as f32 - 19.7).powi(2)).iter().sum::<f32>() - 200.0
    });
    for seeds in [vec![], vec![[5, 19, 19]]] {
        let options = Extract {
            seeds,
            normals: true,
            ..Extract::default()
        };
        let plain = run(&field, &options, 1);
        let count = plain.positions.len() as u64;
        assert!(count > 1000);
        for bits in [31, 32, 40] {
            for threads in [1, 2] {
                // The limit lies in the middle of the mesh, on faces between blocks too.
                let first = Totals {
                    vertices: (1 << bits) - count / 2,
                    triangles: (1 << bits) - count,
                };
                let inner = Collect::default();
                let mut sink = Renumber { first, inner };
                let budget = Budget::mib(64).with_threads(threads);
                let stats = extract_from(first, &field, &options, &budget, &mut sink);
                assert_eq!(stats.expect("meshes").vertices, count);
                assert_eq!(sink.inner.into_mesh(), plain, "2^{bits}, {threads} threads");
            }
        }
    }
}
