//! Isolines of a raster: against marching squares written anew, against the surface on the plane, and
//! against circles.

use super::{dense, mesh_of};
use crate::support::fields::{Content, random, sphere};
use crate::support::rng::Rng;
use brickmarch::iso::{Boundary, Extract, Isolines, Raster, isolines};
use brickmarch::{Box3, Budget, ErrorKind, Inside};
use std::collections::{BTreeMap, BTreeSet};

type Segment = [[u32; 2]; 2];

fn bits(p: [f64; 2]) -> [u32; 2] {
    p.map(|v| (v as f32).to_bits())
}

/// Segments in their direction. Checks that lines are as long as they can be.
fn segments(lines: &Isolines) -> BTreeSet<Segment> {
    let mut all = BTreeSet::new();
    let mut ends = BTreeSet::new();
    for line in lines.iter() {
        let points: Vec<[u32; 2]> = line.points.iter().map(|&p| bits(p)).collect();
        assert!(points.len() > if line.closed { 2 } else { 1 });
        for pair in points.windows(2) {
            assert!(all.insert([pair[0], pair[1]]), "a segment stands twice");
        }
        let (first, last) = (points[0], points[points.len() - 1]);
        if line.closed {
            assert!(all.insert([last, first]), "a segment stands twice");
        } else {
            assert!(ends.insert(first) && ends.insert(last), "two lines meet");
        }
    }
    all
}

/// Marching squares without ties of directions or numbers: the saddle's value itself decides. Exact where the
/// samples are small whole numbers or halves.
fn naive(values: &[f32], [w, h]: [usize; 2], iso: f32) -> BTreeSet<Segment> {
    let at = |x: usize, y: usize| f64::from(values[x + y * w]) - f64::from(iso);
    let mut all = BTreeSet::new();
    for (x, y) in (0..h - 1).flat_map(|y| (0..w - 1).map(move |x| (x, y))) {
        let corners = [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)];
        let v = corners.map(|(x, y)| at(x, y));
        let mut crossed = Vec::new();
        for n in 0..4 {
            let (a, b) = (n.min((n + 1) % 4), n.max((n + 1) % 4));
            if (v[a] >= 0.0) != (v[b] >= 0.0) {
                let [(p, low), (q, high)] = if corners[a] < corners[b] {
                    [(corners[a], v[a]), (corners[b], v[b])]
                } else {
                    [(corners[b], v[b]), (corners[a], v[a])]
                };
                let t = (-low as f32 / (high - low) as f32).clamp(0.001, 0.999);
                let between = |p: usize, q: usize| {
                    if p == q {
                        p as f64
                    } else {
                        p as f64 + f64::from(t)
                    }
                };
                crossed.push(bits([between(p.0, q.0), between(p.1, q.1)]));
            }
        }
        let pairs: &[[usize; 2]] = match crossed.len() {
            0 => &[],
            2 => &[[0, 1]],
            _ => {
                let saddle = (v[0] * v[2] - v[1] * v[3]) / (v[0] + v[2] - v[1] - v[3]);
                // The first and the last edge meet at corner 0, the first two at corner 1.
                if (saddle >= 0.0) == (v[0] >= 0.0) {
                    &[[0, 1], [2, 3]]
                } else {
                    &[[3, 0], [1, 2]]
                }
            }
        };
        for &[a, b] in pairs {
            let (a, b) = (crossed[a], crossed[b]);
            all.insert([a.min(b), a.max(b)]);
        }
    }
    all
}

fn lines_of(values: &[f32], size: [usize; 2], iso: f32, inside: Inside) -> Isolines {
    let raster = Raster {
        values,
        size,
        squares: &|_, _| true,
    };
    isolines(&raster, iso, inside, &Budget::mib(16)).expect("isolines")
}

#[test]
fn segments_are_those_of_marching_squares() {
    let mut rng = Rng::new(71);
    for content in [Content::Bytes, Content::Plateaus] {
        for _ in 0..40 {
            let size = [2 + rng.below(30) as usize, 2 + rng.below(30) as usize];
            let domain = Box3::from_size([size[0] as i32, size[1] as i32, 1]);
            let values = random(content, domain, &mut rng);
            let lines = lines_of(&values, size, content.iso(), Inside::Above);
            let found: BTreeSet<Segment> = segments(&lines)
                .into_iter()
                .map(|[a, b]| [a.min(b), a.max(b)])
                .collect();
            assert_eq!(found, naive(&values, size, content.iso()));
            // What is open ends at the border.
            for line in lines.iter().filter(|l| !l.closed) {
                for p in [line.points[0], line.points[line.points.len() - 1]] {
                    let border = (0..2).any(|a| p[a] == 0.0 || p[a] == (size[a] - 1) as f64);
                    assert!(border, "{p:?} in {size:?}");
                }
            }
        }
    }
}

#[test]
fn lines_are_the_border_of_the_surface_that_is_cut_there() {
    let mut rng = Rng::new(72);
    let domain = Box3::new([-3, 4, 7], [16, 21, 9]);
    let mut compared = 0;
    for content in Content::ALL {
        for inside in [Inside::Above, Inside::Below] {
            let values = random(content, domain, &mut rng);
            let slice = &values[..values.len() / 2];
            let field = dense(domain, values.clone(), 8);
            let options = Extract {
                iso: content.iso(),
                inside: Some(inside),
                boundary: Boundary::Cut,
                ..Extract::default()
            };
            let (mesh, _) = mesh_of(&field, &options, &Budget::mib(64)).expect("a mesh");
            let mut sides: BTreeMap<[u32; 2], i32> = BTreeMap::new();
            for t in &mesh.triangles {
                for n in 0..3 {
                    let (a, b) = (t[n], t[(n + 1) % 3]);
                    *sides.entry([a.min(b), a.max(b)]).or_default() += if a < b { 1 } else { -1 };
                }
            }
            let on_plane = |v: u32| {
                let key = mesh.keys[v as usize];
                key.point[2] == 7 && key.axis < 2
            };
            let place = |v: u32| {
                let [x, y, _] = mesh.positions[v as usize];
                [x.to_bits(), y.to_bits()]
            };
            let border: BTreeSet<Segment> = sides
                .into_iter()
                .filter(|&([a, b], n)| n != 0 && on_plane(a) && on_plane(b))
                .map(|([a, b], n)| if n > 0 { [a, b] } else { [b, a] })
                .map(|ends| ends.map(place))
                .collect();
            let lines = lines_of(slice, [19, 17], content.iso(), inside);
            let found: BTreeSet<Segment> = lines
                .iter()
                .flat_map(|line| {
                    let n = line.points.len();
                    let last = if line.closed { n } else { n - 1 };
                    (0..last).map(move |i| [line.points[i], line.points[(i + 1) % n]])
                })
                .map(|ends| ends.map(|[x, y]| bits([x - 3.0, y + 4.0])))
                .collect();
            assert_eq!(found, border, "{content:?} {inside:?}");
            compared += found.len();
        }
    }
    assert!(compared > 1500, "{compared}");
}

#[test]
fn a_sphere_has_circles_with_an_error_of_second_order() {
    let mut errors = Vec::new();
    for n in [24, 48, 96] {
        let h = 1.0 / f64::from(n);
        let domain = Box3::new([0, 0, n / 2], [n, n, n / 2 + 1]);
        let (centre, radius) = ([0.47, 0.52, 0.44].map(|c| c / h), 0.31 / h);
        let values = sphere(domain, centre, radius);
        let lines = lines_of(&values, [n as usize; 2], 0.0, Inside::Below);
        let all: Vec<_> = lines.iter().collect();
        assert_eq!(all.len(), 1);
        assert!(all[0].closed);
        let ring = (radius.powi(2) - (f64::from(n / 2) - centre[2]).powi(2)).sqrt();
        let off = all[0].points.iter().map(|p| {
            let away = (p[0] - centre[0]).hypot(p[1] - centre[1]);
            (away - ring).abs() * h
        });
        errors.push(off.fold(0.0, f64::max));
        // The inside is on the left: the area is positive.
        let p = all[0].points;
        let area = (0..p.len()).map(|i| {
            let (a, b) = (p[i], p[(i + 1) % p.len()]);
            0.5 * (a[0] * b[1] - a[1] * b[0])
        });
        let ratio = area.sum::<f64>() / (std::f64::consts::PI * ring * ring);
        assert!((ratio - 1.0).abs() < 8.0 * h * h / 0.09, "{n}: {ratio}");
    }
    assert!(errors[2] < 1.0 / (96.0f64 * 96.0), "{errors:?}");
    assert!(errors[0] / errors[2] > 10.0, "{errors:?}");
}

#[test]
fn squares_that_are_left_out_end_lines_and_bad_sizes_are_refused() {
    let values: Vec<f32> = (0..100).map(|n| (n / 10) as f32).collect();
    let raster = Raster {
        values: &values,
        size: [10, 10],
        squares: &|x, _| x != 4,
    };
    let lines = isolines(&raster, 3.5, Inside::Above, &Budget::mib(1)).expect("lines");
    let found: Vec<_> = lines.iter().map(|l| (l.points.len(), l.closed)).collect();
    assert_eq!(found, [(5, false), (5, false)]);
    let wrong = Raster {
        size: [10, 11],
        ..raster
    };
    let error = isolines(&wrong, 3.5, Inside::Above, &Budget::mib(1)).expect_err("refused");
    assert_eq!(error.kind(), ErrorKind::BadInput);
    // One segment more than the memory holds.
    let noise: Vec<f32> = (0..90_000).map(|n| (n % 2) as f32).collect();
    let raster = Raster {
        values: &noise,
        size: [300, 300],
        squares: &|_, _| true,
    };
    let error = isolines(&raster, 0.5, Inside::Above, &Budget::mib(1)).expect_err("refused");
    assert_eq!(error.kind(), ErrorKind::BudgetExceeded);
}
