//! Computes tracks from detections in this process. The tracker runs alone or in the chain whose forecasts
//! are its prior.

use bytemuck::Zeroable;
use model::ModelConfig;
use onboard::Chain;
use run::Run;
use tracker::{Prior, Tracker};
use wire::{AGENTS_MAX, Detection, Header, Track};

use crate::failure::Failure;

/// The stages needed to compute tracks, with the same steps and settings as in a run.
pub enum Tracking {
    /// The tracker alone; without forecasts as prior, other stages do not affect the tracks.
    Alone {
        /// The tracker.
        tracker: Box<Tracker>,
        /// Buffer for its tracks.
        tracks: Vec<Track>,
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
                tracker: Box::new(Tracker::new(tracker::stage::settings(run, model)?)),
                tracks: vec![Track::zeroed(); AGENTS_MAX],
            },
            Prior::Learned => Self::InChain(Box::new(Chain::new(run, model)?)),
        })
    }

    /// Returns the header and tracks after a tick. If the tracker refuses the tick, the tracks are empty.
    pub fn tick(&mut self, header: &Header, detections: &[Detection]) -> (Header, &[Track]) {
        match self {
            Self::Alone { tracker, tracks } => {
                let tracked = tracker.step(header, detections, None, tracks);
                let answered = tracker.header(header);
                tracker.audit(header, detections);
                (answered, &tracks[..tracked.map_or(0, |tracked| tracked.tracks_len)])
            }
            Self::InChain(chain) => {
                let (header, _) = chain.tick(header, detections, |_| ());
                (header, chain.tracks())
            }
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
