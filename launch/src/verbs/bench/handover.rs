//! The overhead of handing a step's blocks to workers.

use std::time::{Duration, Instant};

use console::failure::Failure;
use nn::{Job, Workers, default_workers};

use super::percentile::percentile;

/// Duration of a block.
const BLOCK: Duration = Duration::from_micros(200);
/// Number of blocks per worker in a step.
const BLOCKS: usize = 4;
/// Number of timed steps.
const STEPS: usize = 150;
/// Pause between two steps, in which the workers fall asleep.
const PAUSE: Duration = Duration::from_millis(5);

/// Keeps its processor busy for a block.
struct Busy;

impl Job for Busy {
    type Input = ();

    fn run(&mut self, (): &(), _: usize) {
        let start = Instant::now();
        while start.elapsed() < BLOCK {
            std::hint::spin_loop();
        }
    }
}

/// Formats the time by which a step exceeds its share of the blocks; `None` on one processor.
pub(super) fn line() -> Result<Option<String>, Failure> {
    let workers = default_workers();
    if workers < 2 {
        return Ok(None);
    }
    let mut pool = Workers::new((), (0..workers).map(|_| Busy)).map_err(Failure::unavailable)?;
    let mut over_us = Vec::with_capacity(STEPS);
    for _ in 0..STEPS {
        std::thread::sleep(PAUSE);
        let start = Instant::now();
        pool.run(workers * BLOCKS);
        over_us.push(start.elapsed().saturating_sub(BLOCK * BLOCKS as u32).as_secs_f64() * 1e6);
    }
    let [p50, p99] = [0.5, 0.99].map(|share| percentile(&mut over_us, share));
    Ok(Some(format!(
        "Hand-over of a step to {workers} sleeping workers, beyond the work: {p50:.0} µs at the median, {p99:.0} µs at \
         p99.\n"
    )))
}
