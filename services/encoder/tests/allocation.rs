//! A steady step allocates nothing.

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
        encoder.step(&frame.header, &frame.features(), usize::MAX, &mut outs[i % 2]).unwrap();
    };
    (0..4).for_each(&mut step);
    assert_eq!(allocations(|| (0..1_000).for_each(&mut step)), 0);
    let mut some = |i: usize| {
        let frame = &frames[i % 2];
        let served_count = encoder.step(&frame.header, &frame.features(), i % 9, &mut outs[i % 2]).unwrap();
        assert_eq!(served_count, i % 9);
    };
    (0..18).for_each(&mut some);
    assert_eq!(allocations(|| (0..300).for_each(&mut some)), 0);
}
