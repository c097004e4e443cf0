//! The tracker as a process: `detections` and earlier `forecasts` in, `tracks` out.

use bytemuck::Zeroable;
use model::ModelConfig;
use ports::{Awaited, Frame, Stage, StageError, Subscriber, monotonic_ns};
use run::Run;
use wire::{AGENTS_MAX, DetectionsTopic, ForecastsTopic, Header, Rejected, Topic, Track, TracksTopic, flags};

use crate::feedback;
use crate::missing::Missing;
pub use crate::settings::settings;
use crate::tally::Warned;
use crate::{Predecessor, STAGE, Tracker};

/// Runs the stage until the process is asked to end.
///
/// # Errors
/// [`StageError`] where the run's model, options or shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    let model = ModelConfig::of_run(&run.root).map_err(StageError::config)?;
    let mut tracker = Tracker::new(settings(run, &model)?).with_ids_of(ports::incarnation());
    let mut tracks = vec![Track::zeroed(); AGENTS_MAX];
    let mut warned = Warned::default();
    let mut prior = None;
    let mut missing = Missing::default();

    let mut stage = Stage::open(run, &STAGE)?;
    let detections = stage.subscribe::<DetectionsTopic>()?;
    let forecasts = stage.subscribe_feedback::<ForecastsTopic>(ForecastsTopic::DEPTH_MAX)?;
    let mut predecessor = Predecessor::default();
    let output = stage.publish_after::<TracksTopic>(|header, tracks| predecessor.follow(header, tracks))?;
    tracker.begin_with(&predecessor);
    drop(predecessor);

    loop {
        let (header, input) = match stage.next_until(&detections, &output, missing.until_ns())? {
            Awaited::Frame(frame) => (*frame.header(), Some(frame)),
            Awaited::Late => match missing.predict(detections.has_no_publisher(), monotonic_ns()) {
                Some(header) => (header, None),
                None => continue,
            },
            Awaited::Void(frame) => {
                missing.is_no_tick(frame.header());
                continue;
            }
            Awaited::Lost => continue,
            Awaited::Stopped => break,
        };
        if let Some(frame) = &input {
            missing.came(&header, frame.received_ns());
        }
        if let Some(newer) = newer_prior(&mut stage, &forecasts, &header)? {
            prior = Some(newer);
        }
        let mut passage = input.as_ref().map_or_else(|| stage.release(header), |frame| stage.begin(frame));
        let given = prior.as_ref().map(|frame| (frame.header(), &frame[..]));
        let detections = input.as_deref().unwrap_or_default();
        let tracked = tracker.step(&header, detections, given, &mut tracks);
        passage.header = tracker.header(&passage.header);
        match tracked {
            // An out-of-sequence frame: newer tracks are out already, its effect shows in the next.
            Ok(tracked) if tracked.replayed_len > 0 => {
                passage.header.flags |= flags::VOID;
                stage.done(passage.header.seq);
                stage.pass_empty(passage, &output)?;
            }
            // The number of tracks is known only now, so they are copied into shared memory.
            Ok(tracked) => {
                if tracked.frozen_len > 0 {
                    let (field, frames) = ("detections", tracked.frozen_len);
                    stage.refuse(&header, DetectionsTopic::NAME, &Rejected::Frozen { field, frames });
                }
                let tracks = &mut tracks[..tracked.tracks_len];
                if !header.has(flags::LOCKSTEP) {
                    feedback::tell(&mut passage.header, tracks, given);
                }
                let loan = output.copy(tracks)?;
                stage.finish(passage, &output, Ok(loan))?;
            }
            Err(rejected) => stage.finish(passage, &output, Err(rejected))?,
        }
        tracker.audit(&header, input.as_deref().unwrap_or_default());
        warned.warn(tracker.tally());
        for finding in tracker.new_doubts() {
            let found = finding.found(|place| format!("tick {}", place.line));
            tracing::warn!("input: {found}");
        }
    }
    Ok(())
}

/// Newer forecasts, if there are any; without, the caller keeps those that it has. In lockstep they are those
/// of the tick before, so that timing has no effect.
fn newer_prior(
    stage: &mut Stage,
    forecasts: &Subscriber<ForecastsTopic>,
    header: &Header,
) -> Result<Option<Frame<ForecastsTopic>>, StageError> {
    if !header.has(flags::LOCKSTEP) || header.seq == 0 {
        return Ok(forecasts.newest()?);
    }
    match stage.wait_for(forecasts, header.seq - 1, None)? {
        Awaited::Frame(frame) => Ok(Some(frame)),
        Awaited::Void(_) | Awaited::Late | Awaited::Lost | Awaited::Stopped => Ok(None),
    }
}
