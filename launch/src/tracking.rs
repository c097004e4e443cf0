//! Computes tracks from detections in this process. The tracker runs alone or in the chain whose forecasts
//! are its prior.

use data::{Inspection, Recording};
use model::ModelConfig;
use onboard::{Chain, OwnFrame};
use ports::{Allowance, Second, Tick};
use run::Run;
use source::{Playback, PlaybackOptions};
use tracker::{Prior, Tracker, TrackerOptions};
use wire::{AGENTS_MAX, Detection, Header, Rejected, Track, TracksTopic};

use crate::failure::Failure;

/// The stages needed to compute tracks, with the same steps and settings as in a run.
pub enum Tracking {
    /// The tracker alone; without forecasts as prior, other stages do not affect the tracks.
    Alone {
        /// The tracker.
        tracker: Box<Tracker>,
        /// The tracks of the last tick.
        tracks: Box<OwnFrame<TracksTopic>>,
        /// Why the tracker has refused the last tick.
        refusal: Option<Rejected>,
    },
    /// All stages, because their forecasts are the prior.
    InChain(Box<Chain>),
}

impl Tracking {
    /// Creates the stages that the prior of a run with this model needs.
    pub fn new(run: &Run, model: &ModelConfig) -> Result<Self, Failure> {
        let prior = tracker::STAGE.options(run)?.prior;
        if prior == Prior::Kinematic && sampler::STAGE.options(run)?.memory.is_some() {
            let why = "forecasts take no part in tracks with the kinematic prior";
            return Err(Failure::Usage(format!("--memory changes nothing here: {why}")));
        }
        Ok(match prior {
            Prior::Kinematic => Self::Alone {
                tracker: Box::new(Tracker::new(tracker::settings(run, model)?)),
                tracks: Box::default(),
                refusal: None,
            },
            Prior::Learned => Self::InChain(Box::new(Chain::new(run, model)?)),
        })
    }

    /// Returns the header and tracks after a tick. If the tracker refuses the tick, the tracks are empty.
    pub fn tick(&mut self, header: &Header, detections: &[Detection]) -> (Header, &[Track]) {
        match self {
            Self::Alone { tracker, tracks, refusal } => {
                let allowance = Allowance::All;
                let tick = Tick { header, input: detections, second: Second::None, allowance };
                // A refused tick leaves a VOID frame.
                *refusal = tracks.answer(&mut **tracker, &tick, || ()).err();
                (tracks.header, &tracks.elements)
            }
            Self::InChain(chain) => {
                let (header, _) = chain.tick(header, detections, |_| ());
                (header, chain.tracks())
            }
        }
    }

    /// Why the tracker has refused the last tick, if it has.
    pub const fn refusal(&self) -> Option<&Rejected> {
        match self {
            Self::Alone { refusal, .. } => refusal.as_ref(),
            Self::InChain(chain) => chain.refusal(),
        }
    }

    /// Writes the retrieval memory if the run's record names a file. Has no effect without forecasts.
    pub fn keep_memory(&self, run: &Run) -> Result<(), Failure> {
        match self {
            Self::Alone { .. } => Ok(()),
            Self::InChain(chain) => Ok(chain.keep_memory(run)?),
        }
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
    inspection.findings.extend(tracker.noise().changes());
}
