//! Shapes with known answers: counts exactly, area and volume with the square of the resolution.

use crate::support::report::figure;
use brickmarch::iso::{Extract, extract};
use brickmarch::mesh::{Collect, Report, check};
use brickmarch::{Budget, Mesh};
use brickmarch_data_gen::{Exact, Scene, SceneField, SceneName, lattice_euler};

fn mesh(scene: Scene) -> Mesh {
    let options = Extract {
        iso: scene.iso(),
        ..Extract::default()
    };
    let mut sink = Collect::default();
    let budget = Budget::mib(64);
    extract(&SceneField::new(scene), &options, &budget, &mut sink).expect("there is a surface");
    sink.into_mesh()
}

/// Meshes the scene, compares what must be equal exactly, and gives the rest.
fn counted(name: SceneName, n: u32) -> (Report, Exact) {
    let scene = Scene::new(name, n).expect("a good size");
    let lattice = lattice_euler(&scene, scene.iso(), scene.inside());
    let exact = scene.exact().expect("a formula tells");
    let mesh = mesh(scene);
    let report = check(&mesh, &Budget::mib(4096)).expect("fits");
    let what = format!("{name} {n}: {report:?} {lattice:?}");
    assert!(report.is_sound() && report.unused_vertices == 0, "{what}");
    if lattice.is_unambiguous() {
        assert_eq!(report.vertices, lattice.capped.crossed_edges, "{what}");
        assert_eq!(report.triangles, lattice.capped.triangles(), "{what}");
        assert_eq!(report.euler, lattice.capped.mesh_euler(), "{what}");
        assert_eq!(report.components, lattice.mesh_components().1, "{what}");
    } else {
        // Vertices inside cells may come on top.
        assert!(report.vertices >= lattice.capped.crossed_edges, "{what}");
    }
    assert!(
        exact.euler.is_none_or(|e| e == report.euler),
        "{what} {exact:?}"
    );
    assert!(
        exact.components.is_none_or(|c| c == report.components),
        "{what} {exact:?}"
    );
    assert!(
        exact.genus.is_none_or(|g| Some(g) == report.genus),
        "{what} {exact:?}"
    );
    (report, exact)
}

fn errors(report: &Report, exact: &Exact) -> [f64; 2] {
    let area = exact.area + exact.cap_area;
    [report.area / area - 1.0, report.volume / exact.volume - 1.0].map(f64::abs)
}

fn sizes() -> &'static [u32] {
    if cfg!(debug_assertions) {
        &[32, 64]
    } else {
        &[64, 128, 256]
    }
}

#[test]
fn closed_shapes_have_their_counts_and_converge() {
    for name in [
        SceneName::Sphere,
        SceneName::Torus,
        SceneName::TwoSpheres,
        SceneName::LevelSetSphere,
    ] {
        let mut before: Option<[f64; 2]> = None;
        for &n in sizes() {
            let (report, exact) = counted(name, n);
            let now = errors(&report, &exact);
            if let Some(before) = before {
                for (b, n) in before.into_iter().zip(now) {
                    let rate = b / n;
                    assert!(
                        (3.3..4.8).contains(&rate),
                        "{name}: {before:?} then {now:?}, should fall by four"
                    );
                }
            }
            before = Some(now);
            figure(&format!(
                "{name} {n}: {} vertices = crossed edges; area off by {:.2e}, volume by {:.2e}",
                report.vertices, now[0], now[1]
            ));
        }
    }
}

#[test]
fn the_gyroid_has_its_counts_area_and_volume() {
    // Below 96 the formula does not hold.
    for &n in if cfg!(debug_assertions) {
        &[96][..]
    } else {
        &[128, 256]
    } {
        let (report, exact) = counted(SceneName::Gyroid, n);
        let [area, volume] = errors(&report, &exact);
        figure(&format!(
            "gyroid {n}: {} vertices, genus {}; area off by {area:.2e}, volume by {volume:.2e}",
            report.vertices,
            report.genus.unwrap_or(0)
        ));
        // Eight periods: the wavelength is n / 8 samples.
        let bound = 12.0 / f64::from(n).powi(2) * 16.0;
        assert!(
            area < bound && volume < bound,
            "gyroid {n}: {area} {volume}, bound {bound}"
        );
    }
}
