//! Timings of the engine. `cargo bench -p brickmarch-benches -- [FILTER]`. Answers are checked
//! before times are printed.

#![allow(clippy::print_stdout, reason = "a benchmark prints")]

mod ambiguous;
mod brick_edge;
mod dense;
mod kernel;
mod region;
mod sample;
mod stream;

fn main() {
    let filter = std::env::args()
        .skip(1)
        .find(|a| !a.starts_with('-'))
        .unwrap_or_default();
    if "kernel".contains(&filter) {
        kernel::run();
    }
    if "region".contains(&filter) {
        region::run();
    }
    if "sample".contains(&filter) {
        sample::run();
    }
    if "stream".contains(&filter) {
        stream::run();
    }
    if "dense".contains(&filter) {
        dense::run();
    }
    if "ambiguous".contains(&filter) {
        ambiguous::run();
    }
    if "brick_edge".contains(&filter) {
        brick_edge::run();
    }
}
