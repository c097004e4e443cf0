use data::ReadError;
use lanes::LaneMapError;
use nn::WeightsError;
use onboard::ChainError;
use thiserror::Error;

/// Why nothing could be evaluated.
#[derive(Debug, Error)]
pub enum EvaluateError {
    /// A recording can't be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A map of lanes can't be read.
    #[error(transparent)]
    Lanes(#[from] LaneMapError),
    /// A map of lanes gives no context map.
    #[error("{site}: {source}")]
    Map {
        /// The site.
        site: String,
        /// Why.
        source: mapper::MapError,
    },
    /// Weights that a table needs are not there.
    #[error("{path}: no such weights; `stgdat train --recipe {recipe}` makes them, --weights names others")]
    NoWeights {
        /// The file.
        path: String,
        /// The recipe that writes it.
        recipe: String,
    },
    /// Weights can't be used.
    #[error("{path}: {source}")]
    Weights {
        /// The file.
        path: String,
        /// What is wrong with it.
        source: WeightsError,
    },
    /// The stages that run on board can't run the weights.
    #[error("{path}: {source}")]
    Stages {
        /// The file.
        path: String,
        /// What is wrong.
        source: ChainError,
    },
    /// The model is of another kind than the data set asks for.
    #[error("{path}: the model has {own}, {set} has {wanted}")]
    Steps {
        /// The weights file.
        path: String,
        /// The model's steps.
        own: String,
        /// The data set.
        set: &'static str,
        /// The set's steps.
        wanted: String,
    },
    /// The size of a pixel is unknown.
    #[error("{name}: the scale of the video is unknown, so that errors in pixels are too")]
    NoScale {
        /// The recording.
        name: String,
    },
    /// No agent is there from the first history step to the last forecast step.
    #[error("{name}: no agent is present over {steps} steps of {dt_s} s")]
    NoWindows {
        /// The recordings.
        name: String,
        /// Steps of history and forecast.
        steps: usize,
        /// The step.
        dt_s: f64,
    },
    /// A tracker failed on a recording.
    #[error("{recording}: the tracker \"{name}\": {source}")]
    Contender {
        /// The tracker.
        name: &'static str,
        /// What it was to track.
        recording: String,
        /// What is wrong.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}
