//! Seeds: only what the seed is connected to comes out.

use super::compare::assert_same_surface;
use super::{dense, mesh_of};
use crate::support::fields::{Content, random, sampled};
use crate::support::naive::Question;
use crate::support::rng::Rng;
use brickmarch::iso::Extract;
use brickmarch::{Box3, Budget, ErrorKind, Inside};

const CENTRES: [[f64; 3]; 2] = [[16.0, 16.0, 16.0], [80.0, 70.0, 20.0]];
const RADIUS: f64 = 9.3;

fn two_spheres(domain: Box3, which: &[usize]) -> Vec<f32> {
    sampled(domain, |p| {
        let one = |c: &[f64; 3]| (0..3).map(|a| (p[a] - c[a]).powi(2)).sum::<f64>().sqrt() - RADIUS;
        which
            .iter()
            .map(|&i| one(&CENTRES[i]))
            .fold(f64::INFINITY, f64::min)
    })
}

fn options(seeds: Vec<[i32; 3]>) -> Extract {
    Extract {
        inside: Some(Inside::Below),
        index_space: true,
        seeds,
        ..Extract::default()
    }
}

#[test]
fn a_seed_gives_its_component_only() {
    let domain = Box3::from_size([100, 90, 40]);
    let field = dense(domain, two_spheres(domain, &[0, 1]), 8);
    for (which, centre) in CENTRES.iter().enumerate() {
        // The cell where the positive x axis leaves the sphere.
        let seed = [
            (centre[0] + RADIUS).floor() as i32,
            centre[1] as i32,
            centre[2] as i32,
        ];
        let (mesh, stats) =
            mesh_of(&field, &options(vec![seed]), &Budget::mib(64)).expect("the seed is crossed");
        let alone = two_spheres(domain, &[which]);
        let question = Question {
            values: &alone,
            domain,
            iso: 0.0,
            inside: Inside::Below,
            cap: true,
        };
        assert_same_surface(&mesh, &question.march(), &format!("sphere {which}"));
        // The sphere fits in 4^3 blocks of 8; the march needs no others but its neighbours.
        assert!(stats.blocks_visited <= 6 * 6 * 6, "{stats:?}");
    }
}

#[test]
fn a_seed_beside_the_surface_is_refused() {
    let domain = Box3::from_size([100, 90, 40]);
    let field = dense(domain, two_spheres(domain, &[0, 1]), 16);
    for seed in [
        [50, 50, 30],
        [16, 16, 16],
        [1000, 0, 0],
        [i32::MIN; 3],
        [i32::MAX; 3],
    ] {
        let error =
            mesh_of(&field, &options(vec![seed]), &Budget::mib(64)).expect_err("not crossed");
        assert_eq!(error.kind(), ErrorKind::BadInput, "{seed:?}: {error}");
        assert!(
            error.to_string().contains(&seed[0].to_string()),
            "{seed:?} is not named: {error}"
        );
    }
}

#[test]
fn seeds_in_noise_give_exactly_what_is_connected() {
    let mut rng = Rng::new(44);
    let domain = Box3::new([-4, 0, 9], [20, 19, 30]);
    for content in Content::ALL {
        let values = random(content, domain, &mut rng);
        let question = Question {
            values: &values,
            domain,
            iso: content.iso(),
            inside: Inside::Above,
            cap: true,
        };
        let whole = question.march();
        let field = dense(domain, values.clone(), 8);
        let cells: Vec<[i32; 3]> = whole.loops.keys().copied().collect();
        let rounds = if cfg!(debug_assertions) { 2 } else { 6 };
        for seed in (0..rounds).map(|_| rng.pick(&cells)) {
            let options = Extract {
                iso: content.iso(),
                inside: Some(Inside::Above),
                ..options(vec![seed])
            };
            let (mesh, _) =
                mesh_of(&field, &options, &Budget::mib(64)).expect("the seed is crossed");
            let what = format!("{content:?} from {seed:?}");
            assert_same_surface(&mesh, &whole.through(seed), &what);
        }
    }
}
