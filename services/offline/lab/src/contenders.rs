//! The trackers that `stgdat evaluate tracking` compares: our tracker with either prior, in this process.

use std::path::PathBuf;

use data::Recording;
use evaluator::tracking::{Contender, Published, PublishedTrack};
use nn::ModelConfig;
use run::{Run, StageRun};
use source::{Playback, PlaybackOptions};
use tracker::Prior;
use wire::{AgentType, Track};

use console::failure::Failure;
use launch::tracking::Tracking;

/// Minimum existence probability of a published track.
const EXISTENCE_MIN: f32 = 0.5;

/// Our tracker with the kinematic prior, then with forecasts of the weights as its prior.
pub fn contenders<'a>(weights: Option<&'a PathBuf>, model: &'a ModelConfig) -> Vec<Contender<'a>> {
    let contender = |name, prior| Contender {
        name,
        track: Box::new(move |recording: &Recording| {
            let options = tracker::Options { prior, ..tracker::Options::default() };
            let tracker = StageRun::with_options(&tracker::STAGE, &options)?;
            let run =
                Run { lockstep: true, weights: weights.cloned(), stages: vec![tracker], ..Run::default() };
            Ok(track(recording, run, model)?)
        }),
    };
    vec![
        contender("ours, kinematic prior", Prior::Kinematic),
        contender("ours, learned prior", Prior::Learned),
    ]
}

/// The tracks of each frame.
fn track(recording: &Recording, run: Run, model: &ModelConfig) -> Result<Published, Failure> {
    let options = PlaybackOptions { run_id: 0, ticks_max: None, lockstep: true };
    let mut playback = Playback::new(recording.clone(), options);
    let mut tracking = Tracking::new(&Run { interval_ns: playback.interval_ns(), ..run }, model)?;
    let mut published = Vec::with_capacity(recording.frames.len());
    while let Some(tick) = playback.next_tick() {
        let tracks = tracking.tick(&tick.header, tick.detections).1.iter();
        let probable = tracks.filter(|track| track.existence >= EXISTENCE_MIN);
        published.push(probable.map(published_track).collect::<Result<_, _>>()?);
    }
    Ok(published)
}

fn published_track(track: &Track) -> Result<PublishedTrack, Failure> {
    Ok(PublishedTrack {
        id: track.id,
        agent_type: AgentType::try_from(track.agent_type).map_err(Failure::data)?,
        position_m: [track.x_m, track.y_m].map(f64::from),
    })
}
