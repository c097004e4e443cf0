//! A steady step takes no memory.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

#[path = "../../../tests/support/counting.rs"]
mod counting;
#[path = "support/scene.rs"]
mod scene;

#[test]
fn a_thousand_steady_steps_allocate_nothing() {
    let mut scene = scene::Scene::new(24, 2);
    // All stamps of the cache are in use after 64 ticks.
    for tick in 0..100 {
        scene.tick(tick);
    }
    let allocations = counting::allocations(|| {
        for tick in 100..1_100 {
            scene.tick(tick);
        }
    });
    assert_eq!(allocations, 0);
}
