//! A million random ticks: what the tests do ten thousand times, until memory would show if it grew.

#[path = "../tests/support/torture.rs"]
mod support;

use config::Prior;

fn main() {
    for (prior, seed) in [(Prior::Kinematic, 1), (Prior::Learned, 2)] {
        let begin = std::time::Instant::now();
        let survived = support::torture(prior, seed, 500_000);
        println!("500,000 ticks, {prior:?}, {:.0} s: {survived:?}", begin.elapsed().as_secs_f64());
    }
}
