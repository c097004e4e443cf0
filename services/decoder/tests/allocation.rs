//! A steady step allocates nothing.

mod support {
    pub mod frames;
}

use crate::support::frames;
use decoder::{Decoder, DecoderOptions};
use ports::Allowance;
use testing::Model;
use testing::{CountingAllocator, allocations};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

#[test]
fn a_thousand_steady_steps_allocate_nothing() {
    let weights = Model::with_all_options().weights();
    let mut decoder =
        Decoder::new(&weights, DecoderOptions { workers: 2, seed: 1, ..DecoderOptions::default() }).unwrap();
    let frames = [frames::encodings(6), frames::encodings(4)];
    let mut outs = frames.each_ref().map(|encodings| frames::room(encodings));
    let mut step = |i: usize| {
        frames::decode(&mut decoder, &frames::header(i as u64), &frames[i % 2], &mut outs[i % 2]).unwrap();
    };
    (0..4).for_each(&mut step);
    assert_eq!(allocations(|| (4..1_004).for_each(&mut step)), 0);
    let mut until = |i: usize| {
        let allowance = Allowance::Until { until_ns: (i % 3) as u64, clock: || 1 };
        let served_count = decoder.serve(&frames::header(i as u64), &frames[i % 2], allowance).unwrap();
        decoder.write(&mut outs[i % 2][..served_count]);
    };
    (0..4).for_each(&mut until);
    assert_eq!(allocations(|| (4..304).for_each(&mut until)), 0);
}
