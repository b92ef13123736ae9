//! Scenes through the engine: the field reads what the scene says, and meshes have the counts, the
//! topology, the area and the volume that were found without the engine.

use brickmarch::iso::{Boundary, Extract, extract};
use brickmarch::mesh::{Collect, Report, check};
use brickmarch::{Box3, Budget, Field, Samples};
use brickmarch_data_gen::{Counts, Scene, SceneField, SceneName, lattice_euler};

fn field(name: SceneName, n: u32) -> SceneField {
    SceneField::new(Scene::new(name, n).expect("a size in the limits"))
}

#[test]
fn regions_read_with_any_stride() {
    for name in SceneName::ALL {
        let field = field(name, 50);
        let region = Box3::new([3, 7, 11], [20, 9, 15]);
        let (row, slice) = (23, 23 * 4);
        let mut values = vec![f32::NAN; slice * 4];
        let mut out = Samples {
            values: &mut values,
            row,
            slice,
        };
        field.read(region, &mut out).expect("reads");
        let range = field.range(region).expect("a range");
        for (n, &value) in values.iter().enumerate() {
            let at = [n % row, n / row % 4, n / slice].map(|v| v as i32);
            let point: [i32; 3] = std::array::from_fn(|a| region.min[a] + at[a]);
            if region.contains(point) {
                let [i, j, k] = point.map(|v| v as u32);
                assert_eq!(value, field.scene().value(i, j, k));
                assert!(range.min <= value && value <= range.max);
            } else {
                assert!(value.is_nan(), "a sample outside of the region was written");
            }
        }
    }
}

/// What the checker says of a mesh of the scene.
fn mesh(field: &SceneField, boundary: Boundary) -> (Report, u64, u64) {
    let options = Extract {
        iso: field.scene().iso(),
        boundary,
        ..Extract::default()
    };
    let budget = Budget::mib(512);
    let mut sink = Collect::default();
    let stats = extract(field, &options, &budget, &mut sink).expect("a surface");
    let on_edges = stats.vertices - stats.interior_vertices;
    let report = check(&sink.into_mesh(), &budget).expect("a report");
    (report, on_edges, stats.triangles)
}

#[test]
fn meshes_have_the_counts_of_the_lattice() {
    for name in SceneName::ALL {
        let field = field(name, 96);
        let scene = field.scene();
        let found = lattice_euler(scene, scene.iso(), scene.inside());
        let sides: [(Boundary, &Counts, u64); 2] = [
            (Boundary::Cut, &found.cut, found.mesh_components().0),
            (Boundary::Cap, &found.capped, found.mesh_components().1),
        ];
        for (boundary, counts, components) in sides {
            let (report, on_edges, triangles) = mesh(&field, boundary);
            assert_eq!(on_edges, counts.crossed_edges, "{name} {boundary:?}");
            if found.is_unambiguous() {
                assert_eq!(report.euler, counts.mesh_euler(), "{name} {boundary:?}");
                assert_eq!(triangles, counts.triangles(), "{name} {boundary:?}");
                assert_eq!(report.components, components, "{name} {boundary:?}");
            }
        }
        let doubtful = matches!(name, SceneName::Noise | SceneName::Ct);
        assert_eq!(found.is_unambiguous(), !doubtful, "{name}");
    }
}

#[test]
fn area_and_volume_near_the_exact_ones() {
    // The error falls with the square of the resolution: at twice the size a quarter, give or take.
    for name in [
        SceneName::Sphere,
        SceneName::Torus,
        SceneName::TwoSpheres,
        SceneName::Gyroid,
        SceneName::LevelSetGyroid,
    ] {
        let errors = [96, 192].map(|n| {
            let field = field(name, n);
            let exact = field.scene().exact().expect("a formula");
            let area = mesh(&field, Boundary::Cut).0.area;
            let volume = mesh(&field, Boundary::Cap).0.volume;
            [area / exact.area - 1.0, volume / exact.volume - 1.0]
        });
        // The two sides of a gyroid are alike, so errors of its volume cancel at any resolution.
        for ((coarse, fine), floor) in errors[0].into_iter().zip(errors[1]).zip([1e-5, 2e-4]) {
            assert!(coarse.abs() < 0.02, "{name} {errors:?}");
            assert!(
                fine.abs() < 0.35 * coarse.abs() + floor,
                "{name} {errors:?}"
            );
        }
    }
}
