//! Evaluates forecasts as a car gets them: recordings of many roads, played through the online pipeline.
//!
//! **In:** the sources of the data set [`driving`](data::sets::DataSet::Driving), a folder of recordings each.
//! **Out:** a [`Report`]: by source, type and speed the errors of what was published, beside those of kinematic
//! forecasts and of [anchors](metrics::Anchors) that were fitted to the other sources; coverage of the
//! regions; and what the first seconds are like.
//!
//! A source is played as one run: each recording goes through the chain of `stgdat predict` from detections to
//! forecasts, tracker included, with new tracks, map and retrieval memory, as every recording is another
//! place; what the sampler has learned of its experts goes on to the next one. Before the first it expects what the
//! *other* sources have [shown](evidence::Priors). The motorway is missing: fast
//! sources are also shown at twice their scale, as sources of their own.
//!
//! [`through_gaps`] says what forecasts are worth to the tracker on the same sources: a [`GapReport`].

mod cell;
mod error;
mod gaps;
mod gaussian;
mod patterns;
mod play;
mod region_of_steady;
mod report;
mod sample;
mod source;

pub use error::DrivingError;
pub use gaps::{GapReport, through_gaps};
pub use report::Report;
pub use sample::{Errors, METHODS, Method, Sample};
pub use source::{Source, sources};

use std::path::PathBuf;

use evaluator::threads;
use evidence::Prior;
use nn::Weights;

/// What is evaluated, and how.
#[derive(Clone, Debug)]
pub struct Options {
    /// Folder with a folder of recordings for each source.
    pub folder: PathBuf,
    /// Names of the sources; all of them where there are none.
    pub sources: Vec<String>,
    /// Weights; the embedded ones where there are none.
    pub weights: Option<PathBuf>,
    /// Precision of the decoder.
    pub precision: nn::Precision,
    /// Whether the network reads the online map.
    pub map: bool,
    /// Whether the sampler heeds matured forecasts.
    pub evidence: bool,
    /// Whether a source begins with what the others have shown; else with nothing, so that it shows its own alone.
    pub priors: bool,
    /// Threads that share the work; results do not depend on it.
    pub threads: usize,
}

/// Plays all sources; calls `progress` with the name of each before it is played.
///
/// # Errors
/// [`DrivingError`] names the folder, recording or weights at fault.
pub fn evaluate(options: &Options, progress: impl Fn(&str) + Sync) -> Result<Report, DrivingError> {
    let weights = model_of(options)?;
    let model = weights.config();
    let sources = sources(&options.folder, &options.sources)?;
    let windows = threads::each(&sources, options.threads, |source, _: &mut ()| {
        progress(&format!("reading {}", source.name));
        source.windows(model)
    });
    let windows = windows.into_iter().collect::<Result<Vec<_>, _>>()?;
    let played = threads::each(&sources, options.threads, |source, _: &mut ()| {
        progress(&format!("playing {}", source.name));
        let others = sources.iter().zip(&windows).filter(|(other, _)| other.folder != source.folder);
        let anchors = source::anchors(others.map(|(_, windows)| &windows[..]), model);
        play::play(source, &anchors, options, model)
    });
    let played = played.into_iter().collect::<Result<Vec<_>, _>>()?;
    Ok(Report::new(sources, played, options, model))
}

fn model_of(options: &Options) -> Result<Weights, DrivingError> {
    let Some(path) = &options.weights else { return Ok(Weights::onboard()) };
    Weights::open(path).map_err(|source| DrivingError::Weights { path: path.clone(), source })
}

/// What evidence a source leaves, to expect at others.
pub(crate) type Learned = Option<Prior>;
