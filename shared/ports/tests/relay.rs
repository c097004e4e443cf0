//! Late, repeated and unexpected frames, which a relay between writer and readers sends unchanged.

#![expect(clippy::unwrap_used, reason = "a test that cannot open its ports has failed")]

use bytemuck::cast_slice;
use ports::{Awaited, Relay, Stage, Subscriber, monotonic_ns};
use run::Run;
use wire::{Header, Hop, StageId, Track, TracksTopic};

use crate::{READER, run, topic};

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

/// A stage that reads tracks, the tracks that it reads, and the relay that sends them.
fn relayed(run: &Run) -> (Stage, Subscriber<TracksTopic>, Relay) {
    let mut stage = Stage::open(run, &READER).unwrap();
    let tracks = stage.subscribe::<TracksTopic>().unwrap();
    (stage, tracks, Relay::open(run, topic::<TracksTopic>(run), "raw").unwrap())
}

#[test]
fn a_tick_that_others_have_overtaken_is_no_gap() {
    let (_space, run) = run();
    let (stage, tracks, relay) = relayed(&run);
    for (seq, dropped_len) in [(0, 0), (2, 1), (1, 0), (3, 0), (5, 1)] {
        relay.send(&header(&run, seq, 0), &[]).unwrap();
        assert_eq!(tracks.receive().unwrap().expect("it is taken").header().seq, seq);
        assert_eq!(stage.heartbeat().dropped_len, dropped_len, "after tick {seq}");
    }
}

#[test]
fn a_restarted_stage_does_not_pass_on_a_tick_again() {
    let (_space, run) = run();
    let (stage, tracks, relay) = relayed(&run);
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
    let (mut stage, tracks, relay) = relayed(&run);
    for (sent, awaited) in [(0, Some(0)), (1 << 40, None), (2, Some(2)), (3, Some(3))] {
        relay.send(&header(&run, sent, 0), &[]).unwrap();
        let got = stage.wait_for(&tracks, awaited.unwrap_or(1), Some(monotonic_ns() + 1_000_000)).unwrap();
        let got = if let Awaited::Frame(frame) = &got { Some(frame.header().seq) } else { None };
        assert_eq!(got, awaited, "after tick {sent}");
    }
    let heartbeat = stage.heartbeat();
    assert_eq!((heartbeat.rejected_len, heartbeat.dropped_len), (1, 1), "tick 1 alone is missing");
}
