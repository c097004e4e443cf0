use bytemuck::Zeroable;
use wire::Forecast;

use super::*;
use crate::passage::Timeline;

const MS: u64 = 1_000_000;
const CLOCKS: Clocks = Clocks { monotonic_ns: 5, boottime_ns: 5, realtime_ns: None };

/// A tick whose stages take a millisecond each. The decoder is restarted at tick 3 and is slow in tick 1.
fn tick(seq: u64) -> Header {
    let released_ns = 1_000 * MS + seq * 80 * MS;
    let mut header = Header { released_ns, interval_ns: 80 * MS, ..Header::new(1, seq, 0) };
    let mut now_ns = released_ns;
    for stage in &StageId::ALL[..7] {
        let is_decoder = *stage == StageId::Decoder;
        let (received_ns, started_ns) = (now_ns + 1_000, now_ns + 2_000);
        let finished_ns = started_ns + if is_decoder && seq == 1 { 120 * MS } else { MS };
        let incarnation = u32::from(is_decoder && seq >= 3);
        let sent_ns = finished_ns + 500;
        header.push_hop(Hop {
            stage: stage.number(),
            incarnation,
            received_ns,
            started_ns,
            finished_ns,
            sent_ns,
        });
        now_ns = sent_ns;
    }
    header
}

fn traced() -> Vec<u8> {
    let mut tracer = Tracer::new(CLOCKS, Some(77));
    let mut timeline = Timeline::default();
    let mut bytes = Vec::new();
    for seq in 0..5 {
        for stage in &StageId::ALL[..7] {
            let incarnation = u32::from(*stage == StageId::Decoder && seq >= 3);
            let pid = 100 + stage.number() + 50 * incarnation;
            tracer.heartbeat(&Heartbeat { stage: stage.number(), incarnation, pid, ..Heartbeat::zeroed() });
        }
        let header = tick(seq);
        tracer.tick(&header, &Tick::new(&mut timeline, &header, &[Forecast::zeroed()]));
        bytes.extend(tracer.take());
    }
    tracer.event(StageId::Decoder, 2_000 * MS, "died", "was killed by signal 9");
    bytes.extend(tracer.finish());
    bytes
}

fn count(bytes: &[u8], text: &str) -> usize {
    bytes.windows(text.len()).filter(|window| *window == text.as_bytes()).count()
}

#[test]
fn every_stage_has_its_process_and_every_tick_its_spans() {
    let bytes = traced();
    for stage in &StageId::ALL[..7] {
        assert!(count(&bytes, stage.name()) >= 1, "{}", stage.name());
    }
    assert_eq!(count(&bytes, "decoder (restart 1)"), 1);
    assert_eq!(count(&bytes, "compute"), 5 * 7);
    // According to its hops, tick 2 passes decoder and sampler while they still work on tick 1. The spans of
    // a stage do not overlap, so these two spans have no room.
    assert_eq!(count(&bytes, "publish"), 5 * 7 - 2);
    assert_eq!((count(&bytes, "restarted"), count(&bytes, "died")), (1, 1));
    // Only tick 1 took more than the interval.
    assert_eq!(count(&bytes, "late"), 1);
    assert_eq!(bytes, traced(), "a trace is a function of its input");
}

#[test]
fn frames_that_wait_for_a_busy_stage_are_counted_as_its_queue() {
    let mut tracer = Tracer::new(CLOCKS, None);
    let mut timeline = Timeline::default();
    let hop = |received_ns, finished_ns| Hop {
        stage: StageId::Decoder.number(),
        incarnation: 0,
        received_ns,
        started_ns: received_ns,
        finished_ns,
        sent_ns: finished_ns,
    };
    for (seq, released_ns, received_ns, finished_ns) in
        [(0, 10, 11, 300), (1, 90, 301, 400), (2, 170, 401, 500)]
    {
        let mut header = Header { released_ns: released_ns * MS, ..Header::new(1, seq, 0) };
        header.push_hop(hop(received_ns * MS, finished_ns * MS));
        tracer.tick(&header, &Tick::new(&mut timeline, &header, &[]));
    }
    assert_eq!(tracer.stages[StageId::Decoder.place()].queued_count, 2, "ticks 1 and 2 wait for tick 0");
    assert_eq!(tracer.stages[StageId::Decoder.place()].changes.len(), 2);
    let bytes = tracer.finish();
    assert_eq!(count(&bytes, "waiting"), 2);
}

#[test]
fn refusals_and_gaps_are_told_once() {
    let mut tracer = Tracer::new(CLOCKS, None);
    let mut heartbeat =
        Heartbeat { stage: StageId::Sampler.number(), dropped_len: 2, sent_ns: 9, ..Heartbeat::zeroed() };
    Refusals::count(&mut heartbeat.refusals, StageId::Decoder.number(), RefusalCause::CheckValue, 3);
    Refusals::put_link(&mut heartbeat.refusals, [(wire::LinkCount::Frames, 5)]);
    tracer.heartbeat(&heartbeat);
    tracer.heartbeat(&heartbeat);
    let bytes = tracer.finish();
    assert_eq!((count(&bytes, "refused"), count(&bytes, "frames missing")), (1, 1));
    assert_eq!(count(&bytes, "unknown"), 0, "counts of a link are no refusals");
    assert_eq!(count(&bytes, "check value"), 1);
}

#[test]
fn hops_whose_clocks_run_backwards_make_no_overlap() {
    let mut tracer = Tracer::new(CLOCKS, None);
    let mut timeline = Timeline::default();
    let mut header = Header { released_ns: 100, ..Header::new(1, 0, 0) };
    for times in [[50, 40, 30, 20], [9, 8, 7, 6]] {
        let [received_ns, started_ns, finished_ns, sent_ns] = times;
        let stage = StageId::Tracker.number();
        header.push_hop(Hop { stage, incarnation: 0, received_ns, started_ns, finished_ns, sent_ns });
    }
    tracer.tick(&header, &Tick::new(&mut timeline, &header, &[]));
    assert!(!tracer.finish().is_empty());
}

#[test]
fn a_tracer_keeps_no_more_than_the_newest_ticks() {
    let mut tracer = Tracer::new(CLOCKS, None);
    let mut timeline = Timeline::default();
    for seq in 0..10_000 {
        tracer.tick(&tick(seq), &Tick::new(&mut timeline, &tick(seq), &[]));
        tracer.take();
    }
    assert!(tracer.stages.iter().all(|stage| stage.changes.len() <= CHANGES_MAX));
}
