//! The text of a model, read by a small interpreter, gives the values of the model.

use super::{Random, model, nodes};
use crate::model::Convention;
use std::collections::HashMap;

/// The last value of a listing at a point.
fn evaluate(listing: &str, point: [f64; 3]) -> f64 {
    let mut known: HashMap<&str, f64> = HashMap::new();
    let mut last = f64::NAN;
    for line in listing.lines() {
        let words: Vec<&str> = line.split(' ').collect();
        let of = |n: usize| known[words[n]];
        last = match words[1] {
            "const" => words[2].parse().expect("a number"),
            "var-x" => point[0],
            "var-y" => point[1],
            "var-z" => point[2],
            "neg" => -of(2),
            "abs" => of(2).abs(),
            "sqrt" => of(2).sqrt(),
            "square" => of(2) * of(2),
            "sin" => of(2).sin(),
            "cos" => of(2).cos(),
            "exp" => of(2).exp(),
            "ln" => of(2).ln(),
            "floor" => of(2).floor(),
            "atan" => of(2).atan(),
            "add" => of(2) + of(3),
            "sub" => of(2) - of(3),
            "mul" => of(2) * of(3),
            "div" => of(2) / of(3),
            "min" => of(2).min(of(3)),
            "max" => of(2).max(of(3)),
            "atan2" => of(2).atan2(of(3)),
            "compare" => f64::from(of(2) > of(3)) - f64::from(of(2) < of(3)),
            other => panic!("{other} is no operation"),
        };
        known.insert(words[0], last);
    }
    last
}

#[test]
fn listings_of_every_formula_have_its_values() {
    let mut written = 0;
    for (name, shape) in nodes() {
        let model = model(&shape, 8.0);
        let Ok(listing) = model.listing() else {
            continue;
        };
        written += 1;
        let mut random = Random(9);
        for _ in 0..50 {
            let p = random.point(1.4);
            let want = model.value(p).expect("no data fails");
            let want = match model.convention() {
                Convention::Density { iso } => iso - want,
                _ => want,
            };
            let found = evaluate(&listing, p);
            let close = (found - want).abs() <= 1e-9 * (1.0 + want.abs());
            assert!(
                close || found == want || (found.is_nan() && want.is_nan()),
                "{name}: {found} for {want} at {p:?}"
            );
        }
    }
    assert!(written > 40, "{written}");
}
