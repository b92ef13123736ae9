//! Relaxation: better triangles, the same mesh otherwise, on the same surface, from any pieces.

use super::tiles::{join, keyed};
use super::{dense, mesh_of};
use crate::support::crossing::crossing_pairs;
use crate::support::fields::{Content, random, sampled};
use crate::support::report::figure;
use crate::support::rng::Rng;
use brickmarch::field::Dense;
use brickmarch::iso::{Boundary, Extract};
use brickmarch::mesh::{PERCENTILES, Shapes, check, measure};
use brickmarch::{Affine, Box3, Budget, Inside, Kind, Mesh};

fn shapes(mesh: &Mesh) -> Shapes {
    brickmarch::mesh::shapes(mesh, &Budget::mib(4)).expect("finite")
}

/// The least angle in degrees, or the percentile of one of `PERCENTILES`.
fn angle(shapes: &Shapes, percent: u32) -> f64 {
    let spread = &shapes.min_angle_deg;
    match PERCENTILES.iter().position(|&p| p == percent) {
        Some(i) => spread.percentiles[i],
        None => spread.least,
    }
}

/// The plain and the relaxed mesh.
fn both(field: &Dense, options: &Extract) -> [Mesh; 2] {
    [0, 3].map(|relax| {
        let options = Extract {
            relax,
            ..options.clone()
        };
        mesh_of(field, &options, &Budget::mib(512))
            .expect("meshed")
            .0
    })
}

fn distance(domain: Box3, centre: [f64; 3], radius: f64) -> Dense {
    let values = crate::support::fields::sphere(domain, centre, radius);
    let mut field = dense(domain, values, 16);
    field.kind = Kind::Distance;
    field
}

fn gyroid(n: i32, periods: f64) -> Dense {
    let values = sampled(Box3::from_size([n; 3]), |p| {
        let [x, y, z] = p.map(|v| v * std::f64::consts::TAU * periods / f64::from(n));
        x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()
    });
    dense(Box3::from_size([n; 3]), values, 32)
}

/// The trilinear interpolant less the isovalue in units of the range of the samples, written
/// without a thought of the engine.
fn residual(field: &Dense, domain: Box3, iso: f32, at: [f32; 3]) -> f64 {
    let [nx, ny, _] = domain.size().map(|n| n as usize);
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for &v in field.values() {
        low = low.min(f64::from(v));
        high = high.max(f64::from(v));
    }
    let mut value = -f64::from(iso);
    let cell: [i32; 3] = std::array::from_fn(|a| {
        (at[a].floor() as i32).clamp(domain.min[a], domain.max[a] - 2) - domain.min[a]
    });
    for corner in 0..8usize {
        let mut weight = 1.0;
        let mut index = 0;
        for (a, step) in [(0, 1), (1, nx), (2, nx * ny)] {
            let bit = corner >> a & 1;
            let t = f64::from(at[a]) - f64::from(cell[a] + domain.min[a]);
            weight *= if bit == 1 { t } else { 1.0 - t };
            index += (cell[a] as usize + bit) * step;
        }
        value += weight * f64::from(field.values()[index]);
    }
    value.abs() / (high - low)
}

/// What holds for every relaxed mesh: numbers and triangles are the same, no vertex moves more
/// than half a cell, what moves away from the border lies on the surface, no vertex has a narrower
/// triangle than the narrowest that a neighbour had, unless its angle is 20 degrees or more.
fn check_laws(field: &Dense, domain: Box3, iso: f32, [plain, relaxed]: &[Mesh; 2], what: &str) {
    assert!(plain.triangles == relaxed.triangles, "{what}: triangles");
    assert!(plain.keys == relaxed.keys, "{what}: keys");
    let mut moved = 0;
    let mut worst = 0.0f64;
    for (v, (p, q)) in plain.positions.iter().zip(&relaxed.positions).enumerate() {
        if p == q {
            continue;
        }
        moved += 1;
        // Half a cell, and a rounding of the position.
        let far = (0..3).all(|a| (p[a] - q[a]).abs() <= 0.5 + 1e-5);
        assert!(far, "{what}: vertex {v} moved from {p:?} to {q:?}");
        let inner =
            (0..3).all(|a| q[a] >= domain.min[a] as f32 && q[a] <= (domain.max[a] - 1) as f32);
        if inner {
            worst = worst.max(residual(field, domain, iso, *q));
        }
    }
    assert!(moved * 2 > plain.positions.len(), "{what}: {moved} moved");
    assert!(worst < 1e-4, "{what}: {worst:e} of the range off");
}

#[test]
fn a_sphere_has_no_slivers() {
    let domain = Box3::from_size([64; 3]);
    let field = distance(domain, [31.37, 31.61, 31.53], 24.3);
    let options = Extract {
        inside: Some(Inside::Below),
        index_space: true,
        normals: true,
        ..Extract::default()
    };
    let meshes = both(&field, &options);
    check_laws(&field, domain, 0.0, &meshes, "sphere");
    let [before, after] = meshes.each_ref().map(shapes);
    figure(&format!(
        "sphere 64: least angle {:.2} -> {:.2}, 1st percentile {:.1} -> {:.1}, median {:.1} -> {:.1}",
        angle(&before, 0),
        angle(&after, 0),
        angle(&before, 1),
        angle(&after, 1),
        angle(&before, 50),
        angle(&after, 50)
    ));
    assert!(angle(&before, 1) < 1.5);
    assert!(angle(&after, 0) >= 20.0 && angle(&after, 1) >= 26.0 && angle(&after, 50) >= 42.0);
    let [_, mesh] = meshes;
    assert_eq!(crossing_pairs(&mesh.positions, &mesh.triangles), 0);
    // Still this sphere: normals point from its middle, the volume is as near as before.
    for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
        let out = [p[0] - 31.37, p[1] - 31.61, p[2] - 31.53];
        let cosine = (0..3).map(|a| out[a] * n[a]).sum::<f32>() / 24.3;
        assert!(cosine > 0.999, "{p:?} {n:?}");
    }
    let exact = 4.0 / 3.0 * std::f64::consts::PI * 24.3f64.powi(3);
    assert!((measure::volume(&mesh) / exact - 1.0).abs() < 4e-3);
}

#[test]
fn a_gyroid_has_few_slivers_open_and_capped() {
    let field = gyroid(64, 2.0);
    let domain = Box3::from_size([64; 3]);
    for boundary in [Boundary::Cut, Boundary::Cap] {
        let options = Extract {
            index_space: true,
            boundary,
            ..Extract::default()
        };
        let meshes = both(&field, &options);
        check_laws(&field, domain, 0.0, &meshes, "gyroid");
        let [before, after] = meshes.each_ref().map(shapes);
        figure(&format!(
            "gyroid 64 {boundary:?}: 1st percentile {:.1} -> {:.1}, median {:.1} -> {:.1}",
            angle(&before, 1),
            angle(&after, 1),
            angle(&before, 50),
            angle(&after, 50)
        ));
        assert!(angle(&after, 1) >= 20.0 && angle(&after, 50) >= 42.0);
        assert_eq!(
            crossing_pairs(&meshes[1].positions, &meshes[1].triangles),
            0
        );
        let report = check(&meshes[1], &Budget::mib(64)).expect("checked");
        assert_eq!(report.is_sound(), boundary == Boundary::Cap, "{report:?}");
    }
}

#[test]
fn rough_fields_keep_the_laws_and_do_not_cross() {
    let mut rng = Rng::new(71);
    let domain = Box3::new([-5, 3, 100], [25, 30, 128]);
    for content in [Content::Smooth, Content::Noise, Content::Bytes] {
        let field = dense(domain, random(content, domain, &mut rng), 16);
        let options = Extract {
            iso: content.iso(),
            inside: Some(Inside::Above),
            index_space: true,
            ..Extract::default()
        };
        let meshes = both(&field, &options);
        if content != Content::Bytes {
            check_laws(
                &field,
                domain,
                content.iso(),
                &meshes,
                &format!("{content:?}"),
            );
        }
        let crossing = meshes
            .each_ref()
            .map(|m| crossing_pairs(&m.positions, &m.triangles));
        assert_eq!(crossing, [0, 0], "{content:?}");
        let [before, after] = meshes.each_ref().map(shapes);
        figure(&format!(
            "{content:?}: 1st percentile {:.1} -> {:.1}, median {:.1} -> {:.1}",
            angle(&before, 1),
            angle(&after, 1),
            angle(&before, 50),
            angle(&after, 50)
        ));
        assert!(angle(&after, 5) > angle(&before, 5), "{content:?}");
        let report = check(&meshes[1], &Budget::mib(64)).expect("checked");
        assert!(report.is_sound(), "{content:?}: {report:?}");
    }
}

/// Tissue of nearly the isovalue in noise, in whole numbers, as scans have it.
#[test]
fn noisy_scans_do_not_cross() {
    let mut rng = Rng::new(74);
    // So far from the origin that rounding moves vertices by a 30,000th of a cell.
    let domain = Box3::new([400, -30, 7], [444, 14, 51]);
    let mut triangles = 0;
    for round in 0..6 {
        let mut values = sampled(domain, |p| {
            let [x, y, z] = p.map(|v| v / 7.0 + f64::from(round));
            31.0 + 9.0 * (x.sin() * y.cos() + z.sin())
        });
        for value in &mut values {
            *value = (*value + 6.0 * (rng.signed() + rng.signed())).round();
        }
        let field = dense(domain, values, 32);
        let options = Extract {
            iso: 31.5,
            inside: Some(Inside::Above),
            ..Extract::default()
        };
        let meshes = both(&field, &options);
        let crossing = meshes
            .each_ref()
            .map(|m| crossing_pairs(&m.positions, &m.triangles));
        assert_eq!(crossing, [0, 0], "{round}");
        triangles += meshes[1].triangles.len();
    }
    figure(&format!("noisy scans: {triangles} triangles, none cross"));
    assert!(triangles > 100_000, "{triangles}");
}

/// Values that have no order with the others: vertices beside them stay, nothing breaks.
#[test]
fn fields_with_holes_and_infinities_stay_sound() {
    let mut rng = Rng::new(72);
    let domain = Box3::from_size([21, 22, 23]);
    for content in [
        Content::Nan,
        Content::Infinite,
        Content::Extreme,
        Content::Plateaus,
    ] {
        let field = dense(domain, random(content, domain, &mut rng), 8);
        let options = Extract {
            iso: content.iso(),
            inside: Some(Inside::Above),
            index_space: true,
            ..Extract::default()
        };
        let [plain, relaxed] = both(&field, &options);
        assert!(plain.triangles == relaxed.triangles, "{content:?}");
        let report = check(&relaxed, &Budget::mib(64)).expect("checked");
        assert!(report.is_sound(), "{content:?}: {report:?}");
    }
}

#[test]
fn tiles_threads_and_blocks_do_not_change_a_vertex() {
    let mut rng = Rng::new(73);
    let domain = Box3::new([-3, 5, 0], [48, 29, 31]);
    for content in [Content::Smooth, Content::Noise, Content::Nan] {
        let values = random(content, domain, &mut rng);
        let options = |region, boundary| Extract {
            iso: content.iso(),
            inside: Some(Inside::Above),
            region,
            boundary,
            relax: 2,
            ..Extract::default()
        };
        let whole = keyed(
            &dense(domain, values.clone(), 32),
            &options(None, Boundary::Cap),
        );
        for edge in [8, 16] {
            let field = dense(domain, values.clone(), edge);
            assert!(
                keyed(&field, &options(None, Boundary::Cap)) == whole,
                "{content:?}: blocks of {edge}"
            );
        }
        let field = dense(domain, values, 16);
        for axis in 0..3 {
            let at = rng.between(domain.min[axis] + 1, domain.max[axis]);
            let (mut low, mut high) = (domain, domain);
            low.max[axis] = at;
            high.min[axis] = at;
            let halves = [low, high].map(|r| keyed(&field, &options(Some(r), Boundary::Tile)));
            assert!(
                join(halves) == whole,
                "{content:?}: cut at {at} on axis {axis}"
            );
        }
    }
}

#[test]
fn seeds_give_the_vertices_of_the_whole() {
    let domain = Box3::from_size([70, 40, 40]);
    let field = distance(domain, [30.2, 19.6, 20.1], 15.3);
    let options = |seeds| Extract {
        seeds,
        relax: 3,
        ..Extract::default()
    };
    let whole = keyed(&field, &options(Vec::new()));
    assert!(keyed(&field, &options(vec![[45, 19, 20]])) == whole);
}

/// Angles are those of the world, whatever the map: spacing, shear, mirror.
#[test]
fn angles_are_those_of_the_world() {
    let maps = [
        [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 2.5, 0.0],
        ],
        [
            [-0.4, 0.0, 0.0, 9.0],
            [0.0, 0.4, 0.1, 0.0],
            [0.0, 0.0, 0.5, -7.0],
        ],
    ];
    for rows in maps {
        let map = Affine { rows };
        let domain = Box3::from_size([40; 3]);
        let middle = map.apply([19.6, 20.3, 19.9]);
        let radius = 13.0 * map.spacing()[0];
        let values = sampled(domain, |p| {
            let q = map.apply(p);
            (0..3)
                .map(|a| (q[a] - middle[a]).powi(2))
                .sum::<f64>()
                .sqrt()
                - radius
        });
        let mut grid = brickmarch::Grid::new(domain);
        grid.index_to_world = map;
        let mut field = Dense::new(grid, values).expect("sizes match");
        (field.kind, field.block_edge) = (Kind::Distance, 16);
        let [plain, relaxed] = both(&field, &Extract::default());
        assert!(plain.triangles == relaxed.triangles);
        let [before, after] = [&plain, &relaxed].map(shapes);
        figure(&format!(
            "sphere in {rows:?}: 1st percentile {:.1} -> {:.1}",
            angle(&before, 1),
            angle(&after, 1)
        ));
        assert!(angle(&after, 1) >= 20.0);
        let report = check(&relaxed, &Budget::mib(64)).expect("checked");
        assert!(report.is_sound() && report.volume > 0.0, "{report:?}");
        for p in &relaxed.positions {
            let q: f64 = (0..3).map(|a| (f64::from(p[a]) - middle[a]).powi(2)).sum();
            // The interpolant of a distance is within an eighth of spacing squared over radius.
            assert!((q.sqrt() - radius).abs() < 0.05 * radius);
        }
    }
}

#[test]
fn too_many_passes_and_too_little_memory_are_said() {
    let domain = Box3::from_size([40; 3]);
    let field = dense(domain, random(Content::Noise, domain, &mut Rng::new(3)), 16);
    let options = |relax| Extract {
        relax,
        ..Extract::default()
    };
    let error = mesh_of(&field, &options(6), &Budget::mib(64)).expect_err("too many");
    assert_eq!(error.kind(), brickmarch::ErrorKind::BadInput, "{error}");
    let tight = Budget::mib(16).with_threads(1);
    let error = mesh_of(&field, &options(3), &tight).expect_err("white noise is dense");
    assert_eq!(error.kind(), brickmarch::ErrorKind::BudgetExceeded);
    assert!(error.to_string().contains("--mem"), "{error}");
}
