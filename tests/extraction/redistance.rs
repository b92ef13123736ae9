//! Redistancing against brute force: the distance of every sample to every triangle of the surface.

use super::mesh_of;
use crate::support::fields::{Content, random};
use crate::support::rng::Rng;
use brickmarch::field::Dense;
use brickmarch::iso::{Boundary, Extract};
use brickmarch::redistance::Redistanced;
use brickmarch::{Affine, Box3, Budget, Field, Grid, Inside, Samples};

type Point = [f64; 3];

fn minus(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Point, b: Point) -> Point {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// By the normal where the foot lies inside of all three sides, else by the sides.
fn distance(p: Point, t: [Point; 3]) -> f64 {
    let normal = cross(minus(t[1], t[0]), minus(t[2], t[0]));
    let sides = [(0, 1), (1, 2), (2, 0)].map(|(a, b)| (t[a], t[b]));
    let within = |(a, b): (Point, Point)| dot(cross(minus(b, a), minus(p, a)), normal) >= 0.0;
    if dot(normal, normal) > 0.0 && sides.into_iter().all(within) {
        return (dot(minus(p, t[0]), normal) / dot(normal, normal).sqrt()).abs();
    }
    let to_side = |(a, b): (Point, Point)| {
        let way = minus(b, a);
        let t = (dot(minus(p, a), way) / dot(way, way).max(1e-300)).clamp(0.0, 1.0);
        let foot = [0, 1, 2].map(|i| a[i] + t * way[i]);
        let rest = minus(p, foot);
        dot(rest, rest).sqrt()
    };
    sides.into_iter().map(to_side).fold(f64::INFINITY, f64::min)
}

fn values_of(field: &dyn Field, region: Box3) -> Vec<f32> {
    let mut values = vec![0.0; region.count() as usize];
    let mut out = Samples::dense(&mut values, region);
    field.read(region, &mut out).expect("readable");
    values
}

#[test]
fn distances_are_those_to_the_dense_surface_by_brute_force() {
    let mut rng = Rng::new(21);
    let domain = Box3::new([-3, 5, 0], [9, 18, 11]);
    let budget = Budget::mib(256);
    for (round, content) in [
        Content::Smooth,
        Content::Noise,
        Content::Plateaus,
        Content::Smooth,
    ]
    .into_iter()
    .enumerate()
    {
        let map = match round {
            0 => Affine::from_spacing([1.0; 3], [0.0; 3]),
            // Turned, mirrored and of three spacings.
            _ => Affine::from_columns(
                [[0.5, 0.1, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.1, -1.4]],
                [3.0, -2.0, 7.0],
            ),
        };
        let grid = Grid {
            index_to_world: map,
            ..Grid::new(domain)
        };
        let values = random(content, domain, &mut rng);
        let field = Dense::new(grid, values.clone()).expect("counts");
        let side = [Inside::Above, Inside::Below][round % 2];
        let options = Extract {
            iso: content.iso(),
            inside: Some(side),
            boundary: Boundary::Cut,
            ..Extract::default()
        };
        let (mesh, _) = mesh_of(&field, &options, &budget).expect("a surface");
        let band = 2.3;
        let near = Redistanced::new(&field, content.iso(), Some(side), band, &budget);
        let near = near.expect("a band");
        let found = values_of(&near, domain);
        let mut beyond = 0;
        for (n, &value) in found.iter().enumerate() {
            let [nx, ny] = [12, 13];
            let at = [n % nx, n / nx % ny, n / (nx * ny)];
            let p = map.apply([0, 1, 2].map(|a| f64::from(domain.min[a]) + at[a] as f64));
            let corner = |v: u32| mesh.positions[v as usize].map(f64::from);
            let all = mesh.triangles.iter().map(|t| distance(p, t.map(corner)));
            let wanted = all.fold(band, f64::min);
            let wanted = if side.contains(values[n], content.iso()) {
                -wanted
            } else {
                wanted
            };
            beyond += usize::from(wanted.abs() == band);
            assert!(
                (f64::from(value) - wanted).abs() < 1e-5,
                "{content:?}: {value}, brute force {wanted}, at {at:?}"
            );
        }
        assert!(beyond < found.len(), "{content:?}: the band holds samples");
        // Any piece has the same bits, and lies in its range.
        for _ in 0..30 {
            let low = [0, 1, 2].map(|a| domain.min[a] + rng.below(6) as i32);
            let piece = Box3::new(low, low.map(|v| v + 1 + rng.below(4) as i32)).intersect(&domain);
            let range = near.range(piece).expect("readable");
            for (n, &value) in values_of(&near, piece).iter().enumerate() {
                let size = piece.size().map(|n| n as usize);
                let at = [n % size[0], n / size[0] % size[1], n / (size[0] * size[1])];
                let at = [0, 1, 2].map(|a| piece.min[a] + at[a] as i32);
                assert_eq!(value.to_bits(), found[domain.offset_of(at)].to_bits());
                assert!(range.min <= value && value <= range.max);
            }
        }
    }
}

#[test]
fn a_density_of_any_scale_becomes_a_distance_of_slope_one() {
    let domain = Box3::from_size([40; 3]);
    let values = (0..64_000).map(|n| {
        let d: f32 = [n % 40, n / 40 % 40, n / 1600]
            .map(|c| (c as f32 - 19.3).powi(2))
            .iter()
            .sum();
        (-d / 60.0).exp() * 1000.0
    });
    let field = Dense::new(Grid::new(domain), values.collect()).expect("counts");
    let iso = (-144.0f32 / 60.0).exp() * 1000.0;
    let budget = Budget::mib(64);
    let near = Redistanced::new(&field, iso, Some(Inside::Above), 4.0, &budget).expect("a band");
    let found = values_of(&near, domain);
    let value = |p: [i32; 3]| f64::from(found[domain.offset_of(p)]);
    let (mut compared, mut worst) = (0, 0.0f64);
    for n in 0..38 * 38 * 38 {
        let p = [1 + n % 38, 1 + n / 38 % 38, 1 + n / (38 * 38)];
        let real = p
            .map(|c| (f64::from(c) - 19.3).powi(2))
            .iter()
            .sum::<f64>()
            .sqrt()
            - 12.0;
        // The interpolated density errs by h^2 f'' / 8 f' = 0.04 along an edge, and triangles cut the
        // ball by up to 0.02.
        assert!(
            (value(p) - real.clamp(-4.0, 4.0)).abs() < 0.06,
            "{} {real}",
            value(p)
        );
        if real.abs() < 2.9 {
            let slope = [0, 1, 2].map(|a| {
                let (mut q, mut r) = (p, p);
                q[a] -= 1;
                r[a] += 1;
                0.5 * (value(r) - value(q))
            });
            worst = worst.max((slope.iter().map(|s| s * s).sum::<f64>().sqrt() - 1.0).abs());
            compared += 1;
        }
    }
    assert!(
        compared > 5000 && worst < 0.05,
        "{compared} compared, off by {worst}"
    );
}

#[test]
fn bands_that_make_no_sense_are_refused() {
    let budget = Budget::mib(64);
    let field = |size| {
        let domain = Box3::from_size(size);
        Dense::new(Grid::new(domain), vec![0.0; domain.count() as usize]).expect("counts")
    };
    for (size, band, words) in [
        ([4, 4, 4], 0.0, "above 0"),
        ([4, 4, 4], -1.0, "above 0"),
        ([4, 4, 4], f64::NAN, "above 0"),
        ([4, 4, 4], 65.0, "64 samples"),
        ([4, 1, 4], 1.0, "two samples"),
    ] {
        let field = field(size);
        let made = Redistanced::new(&field, 0.0, None, band, &budget);
        let error = made.err().expect("refused").to_string();
        assert!(error.contains(words), "{error}");
    }
}
