//! A steady step allocates nothing.

mod support {
    pub mod scene;
}

use crate::support::scene;
use testing::{CountingAllocator, allocations};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

#[test]
fn a_thousand_steady_steps_allocate_nothing() {
    let mut scene = scene::Scene::new(24, 2);
    // All stamps of the cache are in use after 64 ticks.
    for tick in 0..100 {
        scene.tick(tick);
    }
    let counted = allocations(|| {
        for tick in 100..1_100 {
            scene.tick(tick);
        }
    });
    assert_eq!(counted, 0);
    // Most ticks have time for seven agents. Every fiftieth tick has time for all.
    let mut shedding = |tick: u64| {
        let header = scene.header(tick);
        scene.localise(&header, |_| {});
        scene
            .extract_most(&header, if tick.is_multiple_of(50) { 24 } else { 7 })
            .map(|_| ())
            .expect("a good frame");
    };
    (1_100..1_200).for_each(&mut shedding);
    assert_eq!(allocations(|| (1_200..1_500).for_each(&mut shedding)), 0);
}
