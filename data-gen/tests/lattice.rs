//! Counts of the sampled scenes against brute force, formulas and each other.

use brickmarch_data_gen::lattice::lattice_euler_of;
use brickmarch_data_gen::{Rng, Scene, SceneName, Side, lattice_euler};

fn scene(name: SceneName, n: u32) -> Scene {
    Scene::new(name, n).expect("a size in the limits")
}

/// Samples with a layer of outside around.
fn padded(samples: &[f32], size: [u32; 3]) -> (Vec<f32>, [u32; 3]) {
    let wide = size.map(|s| s + 2);
    let mut out = vec![-1.0; wide.iter().map(|&s| s as usize).product()];
    for (n, &v) in samples.iter().enumerate() {
        let n = n as u32;
        let p = [n % size[0], n / size[0] % size[1], n / size[0] / size[1]];
        let at = (p[0] + 1) + wide[0] * ((p[1] + 1) + wide[1] * (p[2] + 1));
        out[at as usize] = v;
    }
    (out, wide)
}

/// Edges crossed, squares mixed and ambiguous, cells active and diagonal, one by one.
fn brute_counts(samples: &[f32], size: [u32; 3]) -> [u64; 5] {
    let inside = |p: [u32; 3]| samples[(p[0] + size[0] * (p[1] + size[1] * p[2])) as usize] >= 0.0;
    let mut found = [0; 5];
    for n in 0..samples.len() as u32 {
        let p = [n % size[0], n / size[0] % size[1], n / size[0] / size[1]];
        let step = |p: [u32; 3], a: usize| std::array::from_fn(|b| p[b] + u32::from(a == b));
        let fits = |a: usize| p[a] + 1 < size[a];
        for a in (0..3).filter(|&a| fits(a)) {
            found[0] += u64::from(inside(p) != inside(step(p, a)));
            let b = (a + 1) % 3;
            if fits(b) {
                let c = [p, step(p, a), step(step(p, a), b), step(p, b)].map(inside);
                let count = c.iter().filter(|&&v| v).count();
                found[1] += u64::from(count % 4 != 0);
                found[2] += u64::from(count == 2 && c[0] == c[2]);
            }
        }
        if (0..3).all(fits) {
            let corner = |c: usize| inside(std::array::from_fn(|a| p[a] + (c >> a & 1) as u32));
            let mask = (0..8).fold(0u8, |m, c| m | u8::from(corner(c)) << c);
            found[3] += u64::from(mask != 0 && mask != 255);
            let diagonals = [0x81, 0x42, 0x24, 0x18];
            found[4] += u64::from(diagonals.contains(&mask) || diagonals.contains(&!mask));
        }
    }
    found
}

/// Components of `side`, by flood.
fn brute_components(samples: &[f32], size: [u32; 3], side: bool) -> u64 {
    let mut open: Vec<bool> = samples.iter().map(|&v| (v >= 0.0) == side).collect();
    let strides = [1, size[0] as usize, (size[0] * size[1]) as usize];
    let mut count = 0;
    for start in 0..open.len() {
        if !open[start] {
            continue;
        }
        count += 1;
        let mut stack = vec![start];
        open[start] = false;
        while let Some(at) = stack.pop() {
            for a in 0..3 {
                let place = at / strides[a] % size[a] as usize;
                let mut go = |to: usize| {
                    if std::mem::take(&mut open[to]) {
                        stack.push(to);
                    }
                };
                if place > 0 {
                    go(at - strides[a]);
                }
                if place + 1 < size[a] as usize {
                    go(at + strides[a]);
                }
            }
        }
    }
    count
}

#[test]
fn counts_equal_brute_force_on_random_samples() {
    let mut rng = Rng::new(2);
    for size in [
        [2, 2, 2],
        [5, 4, 3],
        [63, 3, 4],
        [64, 4, 3],
        [65, 3, 3],
        [130, 5, 6],
        [9, 9, 9],
    ] {
        for share in [0.05, 0.3, 0.5, 0.7, 0.95] {
            let count: u32 = size.iter().product();
            let samples: Vec<f32> = (0..count)
                .map(|_| if rng.unit() < share { 1.0 } else { -1.0 })
                .collect();
            let found = lattice_euler_of(&samples, size, 0.0, Side::Above);
            let (wide, wide_size) = padded(&samples, size);
            for (counts, samples, size) in [
                (found.cut, &samples, size),
                (found.capped, &wide, wide_size),
            ] {
                let five = [
                    counts.crossed_edges,
                    counts.mixed_faces,
                    counts.ambiguous_faces,
                    counts.active_cells,
                    counts.diagonal_cells,
                ];
                assert_eq!(five, brute_counts(samples, size), "{size:?} {share}");
            }
            assert_eq!(
                found.inside_components,
                brute_components(&samples, size, true)
            );
            assert_eq!(
                found.outside_components,
                brute_components(&samples, size, false)
            );
            let outside_capped = brute_components(&wide, wide_size, false);
            assert_eq!(found.outside_components_capped, outside_capped);
        }
    }
}

#[test]
fn border_faces_and_triangles_of_small_solids() {
    // One voxel inside a 3^3 lattice: six crossed edges, eight cells with a triangle each.
    let mut samples = vec![-1.0; 27];
    samples[13] = 1.0;
    let found = lattice_euler_of(&samples, [3; 3], 0.0, Side::Above);
    assert_eq!(found.cut, {
        let mut same = found.capped;
        same.mixed_border_faces = 0;
        same
    });
    assert_eq!((found.cut.crossed_edges, found.cut.active_cells), (6, 8));
    assert_eq!((found.cut.triangles(), found.cut.mesh_euler()), (8, 2));
    // A corner voxel of a 2^3 lattice: cut, one triangle with three border sides.
    samples = vec![-1.0; 8];
    samples[0] = 1.0;
    let found = lattice_euler_of(&samples, [2; 3], 0.0, Side::Above);
    assert_eq!(
        (found.cut.crossed_edges, found.cut.mixed_border_faces),
        (3, 3)
    );
    assert_eq!((found.cut.triangles(), found.capped.triangles()), (1, 8));
    // All inside: no surface when cut, a box when capped; all outside: nothing.
    let full = lattice_euler_of(&[1.0; 8], [2; 3], 0.0, Side::Above);
    assert_eq!((full.cut.triangles(), full.mesh_components()), (0, (0, 1)));
    assert_eq!(
        (full.capped.crossed_edges, full.capped.mesh_euler()),
        (24, 2)
    );
    let none = lattice_euler_of(&[1.0; 8], [2; 3], 0.0, Side::Below);
    assert_eq!(
        (none.capped.crossed_edges, none.mesh_components()),
        (0, (0, 0))
    );
}

#[test]
fn not_a_number_is_outside_both_ways() {
    for side in [Side::Above, Side::Below] {
        let found = lattice_euler_of(&[f32::NAN; 8], [2; 3], 0.0, side);
        assert_eq!(found.capped.inside_points, 0);
    }
}

#[test]
fn closed_scenes_have_the_topology_of_their_formulas() {
    for name in [
        SceneName::Sphere,
        SceneName::LevelSetSphere,
        SceneName::Torus,
        SceneName::TwoSpheres,
    ] {
        for n in [40, 65, 128] {
            let scene = scene(name, n);
            let exact = scene.exact().expect("a closed scene");
            let found = lattice_euler(&scene, scene.iso(), scene.inside());
            assert!(found.is_unambiguous(), "{name} {n}");
            assert_eq!(Some(found.capped.mesh_euler()), exact.euler);
            assert_eq!(2 * found.capped.solid_euler(), found.capped.mesh_euler());
            assert_eq!(found.cut.crossed_edges, found.capped.crossed_edges);
            assert_eq!(Some(found.mesh_components().1), exact.components);
            assert_eq!(Some(found.genus() as u64), exact.genus);
            // Closed triangle meshes have 2 V - F = 2 chi.
            let counts = found.capped;
            let twice = 2 * counts.crossed_edges as i64 - counts.triangles() as i64;
            assert_eq!(twice, 2 * counts.mesh_euler());
        }
    }
}

#[test]
fn gyroid_counts_agree_with_each_other() {
    for n in [96, 128, 200, 256] {
        for name in [SceneName::Gyroid, SceneName::LevelSetGyroid] {
            let scene = scene(name, n);
            let found = lattice_euler(&scene, 0.0, scene.inside());
            assert!(found.is_unambiguous(), "{name} {n}: {found:?}");
            assert_eq!(2 * found.capped.solid_euler(), found.capped.mesh_euler());
            assert_eq!(found.inside_components, 1, "the solid is one piece");
            // Every inside point of a border face has one crossed edge more: none elsewhere.
            assert!(found.capped.crossed_edges > found.cut.crossed_edges);
        }
        // The two solids share their surface but for samples that are zero.
        let above = lattice_euler(&scene(SceneName::Gyroid, n), 0.0, Side::Above);
        let below = lattice_euler(&scene(SceneName::Gyroid, n), 0.0, Side::Below);
        assert_eq!(above.cut.crossed_edges, below.cut.crossed_edges);
        assert_eq!(above.inside_components, below.outside_components);
        let all = u64::from(n).pow(3);
        assert_eq!(above.cut.inside_points + below.cut.inside_points, all);
    }
}

#[test]
fn sampled_volume_nears_the_exact_volume() {
    // Points inside count the volume with an error that falls faster than the surface grows.
    for name in [SceneName::Sphere, SceneName::Torus, SceneName::TwoSpheres] {
        let scene = scene(name, 160);
        let exact = scene.exact().expect("a closed scene").volume;
        let found = lattice_euler(&scene, 0.0, scene.inside());
        let counted = found.cut.inside_points as f64;
        assert!(
            (counted / exact - 1.0).abs() < 1e-3,
            "{name}: {counted} {exact}"
        );
    }
}
