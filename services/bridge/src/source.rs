//! The source of a run whose detections come from another box.
//!
//! While the link is lost, the run degrades as if the source had died: the tracker predicts ticks, and forecasts
//! continue from them. When the link is back, the next frame is the next tick.

use std::time::{Duration, Instant};

use data::{Ego, Frame};
use ports::{StageError, monotonic_ns};
use run::{Declaration, Run};
use source::{LiveSource, LiveTicks};
use wire::{Detection, DetectionsTopic, LinkCount, StageId, Topic as _, TruthTopic, WorldOrigin, flags};

use crate::frame::Kind;
use crate::frame::detections::Detections;
use crate::options::Options;
use crate::receiver::{Body, Receiver};
use crate::report::Report;

/// The stage that this program replaces.
pub const STAGE: Declaration<Options> =
    Declaration::new(StageId::Source, &[], &[DetectionsTopic::NAME, TruthTopic::NAME])
        .with_rule(Options::check_source);

/// Frames that wait for the stage.
const INBOX_MAX: usize = 8;
/// Longest wait for a frame, so that waiting ones go out in time.
const WAIT: Duration = Duration::from_millis(10);

/// Runs the stage until the process is asked to end.
///
/// # Errors
/// [`StageError`] if an option or the run's shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    let options = STAGE.options(run)?;
    // The rule of the options has refused its absence.
    let Some(address) = options.connect.clone() else { return Ok(()) };
    let link = options.protection().link(address, Kind::Detections, &options.ages());
    let receiver = Receiver::start(link.map_err(StageError::config)?, INBOX_MAX).map_err(StageError::data)?;
    let mut source = LiveSource::open(run, &STAGE, options.ticks)?;
    source.link()?;
    // Earlier frames are stale.
    drop(receiver.take(Duration::ZERO));
    let mut ticks = LiveTicks::default();
    let mut report = Report::new(Instant::now());
    let mut refused = 0;
    while !source.is_over() {
        source.tend()?;
        if receiver.is_lost() {
            source.miss()?;
        }
        for received in receiver.take(WAIT) {
            let Body::Detections(detections) = received.body else { continue };
            source.set_identities(detections.head.flags & flags::HAS_IDENTITIES != 0);
            let (frame, outside) = frame(&detections, run.origin());
            refused += outside;
            if let Some(tick) = ticks.add(frame, received.arrived_ns)
                && !source.is_over()
            {
                source.send(&tick)?;
            }
        }
        if let Some(tick) = ticks.overdue(monotonic_ns())
            && !source.is_over()
        {
            source.send(&tick)?;
        }
        let counts = receiver.counts().list(receiver.dropped() + ticks.dropped());
        source.set_link(counts.into_iter().chain([(LinkCount::Outside, refused)]));
        report.log(receiver.counts(), || {
            format!("; {refused} detections outside of the world; {} frames dropped", receiver.dropped())
        });
    }
    tracing::info!("{}", receiver.counts());
    source.end();
    Ok(())
}

/// A frame in the world of a run, and the number of its detections outside of this world.
fn frame(detections: &Detections, origin: WorldOrigin) -> (Frame, u64) {
    let head = &detections.head;
    let is_same = origin.position_m() == head.origin_m;
    // Both are checked numbers; equal origins keep every bit of a position.
    let world_m = |position_m: [f32; 2]| match is_same {
        true => Some(position_m),
        false => WorldOrigin::new(head.origin_m).and_then(|sender| origin.world_m(sender.own_m(position_m))),
    };
    let moved = |detection: &Detection| {
        let [x_m, y_m] = world_m([detection.x_m, detection.y_m])?;
        Some(Detection { x_m, y_m, ..*detection })
    };
    let moved: Vec<Detection> = detections.detections.iter().filter_map(moved).collect();
    let outside = (detections.detections.len() - moved.len()) as u64;
    let ego = world_m(head.ego_m).map(|position_m| Ego {
        position_m,
        heading_rad: head.ego_heading_rad,
        is_sensor: head.flags & flags::SEEN_FROM_EGO != 0,
    });
    let frame = Frame {
        stamp_ns: head.stamp_ns,
        observed_types: head.observed_types.into(),
        ego: ego.unwrap_or_default(),
        detections: moved,
        ..Frame::default()
    };
    (frame, outside)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::TickHead;

    fn detections(x_m: &[f32], origin_m: [f64; 2]) -> Detections {
        let head = TickHead {
            stamp_ns: 5,
            origin_m,
            ego_m: [1.5, 2.0],
            observed_types: 0b101,
            flags: flags::SEEN_FROM_EGO,
            ..TickHead::default()
        };
        let detection = |&x_m| Detection { x_m, score: 0.5, ..Detection::default() };
        Detections { head, detections: x_m.iter().map(detection).collect() }
    }

    #[test]
    fn a_frame_keeps_every_bit_if_both_worlds_have_one_origin() {
        let sent = detections(&[0.1, -7.3], [458_000.0, 0.5]);
        let (frame, outside) = frame(&sent, WorldOrigin::new([458_000.0, 0.5]).unwrap());
        assert_eq!((frame.detections, outside), (sent.detections, 0));
        assert_eq!((frame.stamp_ns, frame.observed_types), (5, 0b101));
        assert_eq!(frame.ego, Ego { position_m: [1.5, 2.0], heading_rad: 0.0, is_sensor: true });
    }

    #[test]
    fn a_frame_is_moved_between_worlds_and_what_does_not_fit_is_counted() {
        let sent = detections(&[10.0, -9_000.0], [25_000.0, 0.0]);
        let (moved, outside) = frame(&sent, WorldOrigin::new([-7_500.0, 0.0]).unwrap());
        assert_eq!((moved.detections[0].x_m, moved.detections.len(), outside), (32_510.0, 2, 0));
        let (moved, outside) = frame(&sent, WorldOrigin::new([-10_000.0, 0.0]).unwrap());
        assert_eq!((moved.detections[0].x_m, moved.detections.len(), outside), (26_000.0, 1, 1));
        assert_eq!(moved.ego, Ego::default());
    }
}
