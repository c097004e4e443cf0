//! From detections to tracks, in this process: the tracker alone, or in the chain whose forecasts are its
//! prior.

use bytemuck::Zeroable;
use model::ModelConfig;
use onboard::Chain;
use run::Run;
use tracker::{Prior, Tracker};
use wire::{AGENTS_MAX, Detection, Header, Track};

use crate::failure::Failure;

/// What of the pipeline it takes to make tracks: the same steps on the same settings as in a run.
pub enum Tracking {
    /// Without forecasts the other stages change no track.
    Alone {
        /// The tracker.
        tracker: Box<Tracker>,
        /// Room for its tracks.
        tracks: Vec<Track>,
    },
    /// All stages, for the sake of the forecasts.
    InChain(Box<Chain>),
}

impl Tracking {
    /// Sets up what the prior of a run with that model needs.
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

    /// The tracks after a tick, with their header; none if the tracker refuses the tick.
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

    /// Writes the retrieval memory where the run's record names a file; without forecasts there is none.
    pub fn keep_memory(&self, run: &Run) -> Result<(), Failure> {
        match self {
            Self::Alone { .. } => Ok(()),
            Self::InChain(chain) => Ok(chain.keep_memory(run)?),
        }
    }
}
