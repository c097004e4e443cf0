//! Computes tracks from detections in this process. The tracker runs alone or in the chain whose forecasts
//! are its prior.

use audit::SensorNoise;
use data::{Inspection, Recording};
use model::ModelConfig;
use onboard::Chain;
use run::Run;
use source::{Playback, PlaybackOptions};
use tracker::{Prior, Tracker, TrackerOptions};
use wire::{AGENTS_MAX, Detection, Header, Rejected, Track};

use console::failure::Failure;

/// The stages needed to compute tracks, with the same steps and settings as in a run.
pub struct Tracking(Chain);

impl Tracking {
    /// Creates the stages that the prior of a run with this model needs.
    pub fn new(run: &Run, model: &ModelConfig) -> Result<Self, Failure> {
        let prior = tracker::STAGE.options(run)?.prior;
        if prior == Prior::Kinematic && sampler::STAGE.options(run)?.memory.is_some() {
            let why = "forecasts take no part in tracks with the kinematic prior";
            return Err(Failure::Usage(format!("--memory changes nothing here: {why}")));
        }
        Ok(Self(match prior {
            // Without forecasts as prior, other stages do not affect the tracks.
            Prior::Kinematic => {
                let tracker = Tracker::new(tracker::settings(run, model)?);
                Chain::of(vec![onboard::node(&tracker::STAGE, tracker)])
            }
            Prior::Learned => Chain::new(run, model)?,
        }))
    }

    /// Returns the header and tracks after a tick. If the tracker refuses the tick, the tracks are empty.
    pub fn tick(&mut self, header: &Header, detections: &[Detection]) -> (Header, &[Track]) {
        self.0.tick(header, detections, |_| ());
        let (tracks, _) = self.0.frames();
        (tracks.header, &tracks.elements)
    }

    /// Why the tracker has refused the last tick, if it has.
    pub fn refusal(&self) -> Option<&Rejected> {
        self.0.refusal()
    }

    /// Ends the stages: writes the retrieval memory if the run's record names a file and forecasts are the
    /// prior.
    pub fn end(&mut self, run: &Run) -> Result<(), Failure> {
        Ok(self.0.end(run)?)
    }
}

/// Completes the inspection of a recording with the noise of its detections and with its changes, as the
/// tracker of a run without forecasts learns it.
pub fn add_noise(inspection: &mut Inspection, recording: Recording) {
    let mut playback = Playback::new(recording, PlaybackOptions { lockstep: true, ..Default::default() });
    let mut tracker = Tracker::new(TrackerOptions { prior: Prior::Kinematic, ..TrackerOptions::default() });
    let mut tracks = vec![Track::default(); AGENTS_MAX];
    while let Some(tick) = playback.next_tick() {
        // A refused tick changes nothing.
        let _ = tracker.step(&tick.header, tick.detections, None, &mut tracks);
    }
    inspection.noise = tracker.noise().types().collect();
    for (agent_type, sensor, position_m) in tracker.noise_of_sensors() {
        let of_type = inspection.noise.iter_mut().find(|of_type| of_type.agent_type == agent_type.name());
        let position_m = (position_m * 1e3).round() / 1e3;
        of_type.into_iter().for_each(|of_type| of_type.sensors.push(SensorNoise { sensor, position_m }));
    }
    inspection.findings.extend(tracker.noise().changes());
}
