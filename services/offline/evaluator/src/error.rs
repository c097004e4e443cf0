use data::ReadError;
use lanes::LaneMapError;
use thiserror::Error;

/// Why an evaluation fails.
#[derive(Debug, Error)]
pub enum EvaluateError {
    /// A recording can't be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A map of lanes can't be read.
    #[error(transparent)]
    Lanes(#[from] LaneMapError),
    /// A weights file can't be used or run, or no context map can be made from the lanes of a site.
    #[error("{of}: {source}")]
    Unusable {
        /// The file or the site.
        of: String,
        /// What is wrong with it.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The weights that a table needs do not exist.
    #[error("{path}: no such weights; `stgdat train --recipe {recipe}` makes them, --weights names others")]
    NoWeights {
        /// The file.
        path: String,
        /// The recipe that writes it.
        recipe: String,
    },
    /// The model's steps differ from the steps of the data set.
    #[error("{path}: the model has {own}, {set} has {wanted}")]
    Steps {
        /// The weights file.
        path: String,
        /// The model's steps.
        own: String,
        /// The data set.
        set: &'static str,
        /// The data set's steps.
        wanted: String,
    },
    /// The size of a pixel is unknown.
    #[error("{name}: the scale of the video is unknown, so that errors in pixels are too")]
    NoScale {
        /// The recording.
        name: String,
    },
    /// No agent is present from the first history step to the last forecast step.
    #[error("{name}: no agent is present over {steps} steps of {dt_s} s")]
    NoWindows {
        /// The recordings.
        name: String,
        /// Steps of history and forecast.
        steps: usize,
        /// Length of a step, s.
        dt_s: f64,
    },
    /// A tracker failed on a recording.
    #[error("{recording}: the tracker \"{name}\": {source}")]
    Contender {
        /// The tracker.
        name: &'static str,
        /// The recording that it failed on.
        recording: String,
        /// What is wrong.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

impl EvaluateError {
    pub(crate) fn unusable(
        of: impl Into<String>,
        source: impl std::error::Error + Send + Sync + 'static,
    ) -> Self {
        Self::Unusable { of: of.into(), source: Box::new(source) }
    }
}
