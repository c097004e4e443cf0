//! A steady step takes no memory.

mod support {
    pub mod frames;
}

use crate::support::frames;
use testing::{CountingAllocator, allocations};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

#[test]
fn a_thousand_steady_steps_allocate_nothing() {
    let mut encoder =
        encoder::Encoder::new(&nn::Weights::onboard(), encoder::EncoderOptions { workers: 2 }).unwrap();
    let frames = [frames::Frame::new(12), frames::Frame::new(9)];
    let mut outs = frames.each_ref().map(frames::Frame::out);
    let mut step = |i: usize| {
        let frame = &frames[i % 2];
        encoder.step(&frame.header, &frame.features(), &mut outs[i % 2]).unwrap();
    };
    (0..4).for_each(&mut step);
    assert_eq!(allocations(|| (0..1_000).for_each(&mut step)), 0);
}
