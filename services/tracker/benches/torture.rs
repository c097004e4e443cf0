//! Runs a million random ticks, 100 times the number in the tests. A memory leak would show here.

#[path = "../tests/support/torture.rs"]
mod support;

use tracker::{Association, Prior};

fn main() {
    for (prior, association, seed) in [
        (Prior::Kinematic, Association::Assignment, 1),
        (Prior::Learned, Association::Assignment, 2),
        (Prior::Kinematic, Association::Jpda, 3),
        (Prior::Learned, Association::Jpda, 4),
    ] {
        let begin = std::time::Instant::now();
        let survived = support::torture(prior, association, seed, 250_000);
        let time_s = begin.elapsed().as_secs_f64();
        println!("250,000 ticks, {prior:?}, {association:?}, {time_s:.0} s: {survived:?}");
    }
}
