//! Rows equal values bit for bit; ranges are never narrower than the samples, and not vacuous.

use brickmarch_data_gen::{Rng, Scene, SceneName};

fn scenes(size: [u32; 3]) -> Vec<Scene> {
    let plain = |name| Scene::with_size(name, size).expect("a size in the limits");
    let mut all: Vec<Scene> = SceneName::ALL.into_iter().map(plain).collect();
    all.push(plain(SceneName::Gyroid).quantized(1000.0));
    all.push(plain(SceneName::Torus).quantized(-16.0));
    all
}

/// A random half-open stretch of `0..size`, short ones as likely as long ones.
fn stretch(size: u32, rng: &mut Rng) -> (u32, u32) {
    let longest = 1u64 << rng.below(u64::from(size.ilog2()) + 1);
    let length = 1 + rng.below(longest.min(u64::from(size))) as u32;
    let start = rng.below(u64::from(size - length) + 1) as u32;
    (start, start + length)
}

#[test]
fn rows_equal_values() {
    for size in [[70, 40, 33], [129, 131, 137], [2, 3, 2]] {
        for scene in scenes(size) {
            let mut rng = Rng::new(11);
            for _ in 0..300 {
                let (i0, i1) = stretch(size[0], &mut rng);
                let (j, _) = stretch(size[1], &mut rng);
                let (k, _) = stretch(size[2], &mut rng);
                let mut row = vec![f32::NAN; (i1 - i0) as usize];
                scene.fill_row(j, k, i0, &mut row);
                for (i, value) in (i0..).zip(&row) {
                    let single = scene.value(i, j, k);
                    assert_eq!(
                        value.to_bits(),
                        single.to_bits(),
                        "{} {i},{j},{k}",
                        scene.name()
                    );
                }
            }
        }
    }
}

/// Smallest and largest sample of a box.
fn truth(scene: &Scene, min: [u32; 3], max: [u32; 3], row: &mut [f32]) -> (f32, f32) {
    let mut found = (f32::INFINITY, f32::NEG_INFINITY);
    let row = &mut row[..(max[0] - min[0]) as usize];
    for k in min[2]..max[2] {
        for j in min[1]..max[1] {
            scene.fill_row(j, k, min[0], row);
            found = row.iter().fold(found, |f, &v| (f.0.min(v), f.1.max(v)));
        }
    }
    found
}

#[test]
fn ranges_hold_on_random_boxes() {
    // 100,000 boxes per size over all scenes, and 100,000 for each of the two harder ones below.
    for size in [[64, 61, 70], [300, 257, 256]] {
        for scene in scenes(size) {
            check_boxes(&scene, 10_000);
        }
    }
}

#[test]
fn ranges_hold_on_many_boxes_of_gyroid_and_scan() {
    for name in [SceneName::Gyroid, SceneName::LevelSetGyroid, SceneName::Ct] {
        let scene = Scene::new(name, 128).expect("a size in the limits");
        check_boxes(&scene, 100_000);
    }
}

fn check_boxes(scene: &Scene, boxes: usize) {
    let size = scene.size();
    let mut rng = Rng::new(77);
    let mut row = vec![0.0; size[0] as usize];
    let mut looked_at = 0u64;
    for _ in 0..boxes {
        let sides = size.map(|s| stretch(s, &mut rng));
        let (min, max) = (sides.map(|s| s.0), sides.map(|s| s.1));
        let count: u64 = sides.iter().map(|s| u64::from(s.1 - s.0)).product();
        // Large boxes are checked on a random part of them.
        let mut part = (min, max);
        if count > 512 {
            for a in 0..3 {
                let length = (max[a] - min[a]).min(8);
                part.0[a] = min[a] + rng.below(u64::from(max[a] - min[a] - length) + 1) as u32;
                part.1[a] = part.0[a] + length;
            }
        }
        let (lo, hi) = scene.range(min.map(|v| v as i32), max.map(|v| v as i32));
        let (low, high) = truth(scene, part.0, part.1, &mut row);
        assert!(
            lo <= low && high <= hi,
            "{} {min:?}..{max:?}: {low}..{high} is not in {lo}..{hi}",
            scene.name()
        );
        looked_at += 1;
    }
    assert_eq!(looked_at, boxes as u64);
}

#[test]
fn ranges_are_cut_to_the_domain() {
    for scene in scenes([40, 50, 60]) {
        let all = scene.range([0; 3], [40, 50, 60]);
        assert_eq!(scene.range([i32::MIN; 3], [i32::MAX; 3]), all);
        let nothing = (f32::INFINITY, f32::NEG_INFINITY);
        assert_eq!(scene.range([5, 5, 5], [5, 9, 9]), nothing);
        assert_eq!(scene.range([40, 0, 0], [50, 9, 9]), nothing);
        assert_eq!(scene.range([-9, -9, -9], [0, 9, 9]), nothing);
        let (lo, hi) = scene.range([39, 49, 59], [i32::MAX; 3]);
        assert!(lo <= scene.value(39, 49, 59) && scene.value(39, 49, 59) <= hi);
    }
}

/// Blocks that hold the isovalue by range, and by samples.
fn crossed_blocks(scene: &Scene, edge: u32) -> (u64, u64) {
    let size = scene.size();
    let iso = scene.iso();
    let mut row = vec![0.0; size[0] as usize];
    let mut counts = (0, 0);
    for k in (0..size[2]).step_by(edge as usize) {
        for j in (0..size[1]).step_by(edge as usize) {
            for i in (0..size[0]).step_by(edge as usize) {
                // With one more layer, as cells reach over.
                let min = [i, j, k];
                let max = std::array::from_fn(|a| (min[a] + edge + 1).min(size[a]));
                let holds = |(lo, hi): (f32, f32)| u64::from(lo < iso && iso <= hi);
                counts.0 += holds(scene.range(min.map(|v| v as i32), max.map(|v| v as i32)));
                counts.1 += holds(truth(scene, min, max, &mut row));
            }
        }
    }
    counts
}

#[test]
fn ranges_are_tight() {
    // Most blocks that a range does not exclude are really crossed: work follows the surface.
    let allowed = [
        (SceneName::Sphere, 256, 16, 1.05),
        (SceneName::LevelSetSphere, 256, 16, 1.05),
        (SceneName::Torus, 256, 16, 1.05),
        (SceneName::TwoSpheres, 256, 16, 1.05),
        (SceneName::Gyroid, 512, 16, 1.15),
        (SceneName::LevelSetGyroid, 512, 16, 1.15),
        (SceneName::Gyroid, 512, 8, 1.15),
        (SceneName::Noise, 512, 16, 1.25),
        (SceneName::Ct, 256, 16, 1.6),
    ];
    for (name, n, edge, factor) in allowed {
        let scene = Scene::new(name, n).expect("a size in the limits");
        let (by_range, by_samples) = crossed_blocks(&scene, edge);
        let all = u64::from(n / edge).pow(3);
        assert!(by_samples > 0 && by_range >= by_samples);
        assert!(
            by_range as f64 <= factor * by_samples as f64,
            "{name}: {by_range} of {all} blocks by range, {by_samples} crossed"
        );
    }
}

#[test]
fn values_never_change() {
    // One value each, so that no release moves a scene unseen. Exact bits: they are the same on
    // every machine.
    let at = |name| Scene::new(name, 100).expect("a size").value(31, 47, 72);
    let found = SceneName::ALL.map(|name| at(name).to_bits());
    let expected = EXPECTED.map(f32::to_bits);
    assert_eq!(found, expected, "{:?}", SceneName::ALL.map(at));
}

const EXPECTED: [f32; 8] = [
    -10.763892, 0.93536013, 13.192473, 16.698307, 0.01996687, -819.0, -3.0, 1.7423002,
];

#[test]
fn impossible_sizes_are_refused() {
    for n in [0, 1, u32::MAX] {
        let error = Scene::new(SceneName::Sphere, n).expect_err("not possible");
        assert!(error.to_string().contains(&n.to_string()));
    }
    assert!(
        "sphear"
            .parse::<SceneName>()
            .expect_err("no such")
            .to_string()
            .contains("two-spheres")
    );
}
