//! Ports between stages: round trips between processes, relays and refused frames.

mod integrity;
mod relay;
mod round_trip;
mod turns;

use ports::{RawTopic, Space};
use run::{Declaration, NoOptions, Run};
use wire::{StageId, Topic, TracksTopic};

/// A stage that only reads tracks.
const READER: Declaration<NoOptions> = Declaration::new(StageId::Localiser, &[TracksTopic::NAME], &[]);

/// A separate run for each test, so that tests can run in parallel.
fn run() -> (Space, Run) {
    let space = Space::create(None, 1 << 20).expect("shared memory has room");
    let run =
        Run { id: space.id(), prefix: space.prefix().into(), root: space.root().into(), ..Run::default() };
    (space, run)
}

fn topic<T: Topic>(run: &Run) -> RawTopic {
    RawTopic::of(run, T::NAME).expect("the table has the topic")
}
