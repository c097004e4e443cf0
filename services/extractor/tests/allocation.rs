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
    let allocations = allocations(|| {
        for tick in 100..1_100 {
            scene.tick(tick);
        }
    });
    assert_eq!(allocations, 0);
}
