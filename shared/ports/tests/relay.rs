//! Late, repeated and unexpected frames, which a relay between writer and readers sends unchanged.

use bytemuck::cast_slice;
use ports::{Awaited, RawTopic, Relay, Space, Stage, monotonic_ns};
use run::{Declaration, NoOptions, Run};
use wire::{Header, Hop, StageId, Topic, Track, TracksTopic};

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

/// The header of a tick that a tracker of this incarnation has sent.
fn header(run: &Run, seq: u64, incarnation: u32) -> Header {
    let mut header = Header::new(run.id, seq, seq as i64 * 80_000_000);
    header.sender = StageId::Tracker.number();
    header.incarnation = incarnation;
    header.push_hop(Hop { stage: header.sender, incarnation, ..Hop::default() });
    header
}

#[test]
fn a_relay_takes_and_sends_any_frame() {
    let (_space, run) = run();
    let back = Relay::open(&run, topic::<TracksTopic>(&run), "tracks-again").unwrap();
    let reader = Relay::consumer(&run, topic::<TracksTopic>(&run)).unwrap();
    let track = Track { id: 4, x_m: f32::NAN, ..bytemuck::Zeroable::zeroed() };
    let impossible = Header { schema: 99, run_id: 3, ..header(&run, 0, 7) };
    back.send(&impossible, cast_slice(&[track, track])).unwrap();
    let frame = reader.receive().unwrap().expect("the frame is in the queue");
    assert_eq!(frame.header(), &impossible);
    assert_eq!(
        cast_slice::<u8, Track>(frame.payload()).iter().map(|track| track.id).collect::<Vec<_>>(),
        [4, 4]
    );
    assert!(back.receive().unwrap().is_none(), "what it reads has another name");
}

#[test]
fn a_tick_that_others_have_overtaken_is_no_gap() {
    let (_space, run) = run();
    let mut stage = Stage::open(&run, &READER).unwrap();
    let tracks = stage.subscribe::<TracksTopic>().unwrap();
    let relay = Relay::open(&run, topic::<TracksTopic>(&run), "raw").unwrap();
    for (seq, dropped_len) in [(0, 0), (2, 1), (1, 0), (3, 0), (5, 1)] {
        relay.send(&header(&run, seq, 0), &[]).unwrap();
        assert_eq!(tracks.receive().unwrap().expect("it is taken").header().seq, seq);
        assert_eq!(stage.heartbeat().dropped_len, dropped_len, "after tick {seq}");
    }
}

#[test]
fn a_restarted_stage_does_not_pass_on_a_tick_again() {
    let (_space, run) = run();
    let mut stage = Stage::open(&run, &READER).unwrap();
    let tracks = stage.subscribe::<TracksTopic>().unwrap();
    let relay = Relay::open(&run, topic::<TracksTopic>(&run), "raw").unwrap();
    for (seq, incarnation, is_taken) in [(5, 0, true), (5, 1, false), (6, 1, true), (7, 1, true)] {
        relay.send(&header(&run, seq, incarnation), &[]).unwrap();
        let taken = tracks.receive().unwrap();
        assert_eq!(taken.is_some(), is_taken, "tick {seq} of incarnation {incarnation}");
    }
    let heartbeat = stage.heartbeat();
    assert_eq!((heartbeat.rejected_len, heartbeat.dropped_len), (1, 0));
}

#[test]
fn a_tick_from_nowhere_is_not_waited_for() {
    let (_space, run) = run();
    let mut stage = Stage::open(&run, &READER).unwrap();
    let tracks = stage.subscribe::<TracksTopic>().unwrap();
    let relay = Relay::open(&run, topic::<TracksTopic>(&run), "raw").unwrap();
    for (sent, awaited) in [(0, Some(0)), (1 << 40, None), (2, Some(2)), (3, Some(3))] {
        relay.send(&header(&run, sent, 0), &[]).unwrap();
        let got = stage.wait_for(&tracks, awaited.unwrap_or(1), Some(monotonic_ns() + 1_000_000)).unwrap();
        let got = if let Awaited::Frame(frame) = &got { Some(frame.header().seq) } else { None };
        assert_eq!(got, awaited, "after tick {sent}");
    }
    let heartbeat = stage.heartbeat();
    assert_eq!((heartbeat.rejected_len, heartbeat.dropped_len), (1, 1), "tick 1 alone is missing");
}
