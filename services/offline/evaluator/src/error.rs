use data::ReadError;
use lanes::LaneMapError;
use ports::StageError;
use run::OptionError;
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
    /// A weights file can't be used or run, no context map can be made from the lanes of a site, a folder can't be
    /// listed, or a tracker failed on a recording.
    #[error("{of}: {source}")]
    Unusable {
        /// The file, the site, the folder, or the recording and the tracker.
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
    /// No source of driving recordings has this name.
    #[error("{name}: no such source; there are {known}")]
    UnknownSource {
        /// The name that was given.
        name: String,
        /// Names of the known sources.
        known: String,
    },
    /// A bag's forecasts can't be compared with ours.
    #[error("{0}")]
    Against(String),
    /// The stages can't be set up.
    #[error(transparent)]
    Stages(#[from] StageError),
    /// The stages' options can't be recorded.
    #[error(transparent)]
    Run(#[from] OptionError),
}

impl EvaluateError {
    pub(crate) fn unusable(
        of: impl Into<String>,
        source: impl std::error::Error + Send + Sync + 'static,
    ) -> Self {
        Self::Unusable { of: of.into(), source: Box::new(source) }
    }
}
