//! Evaluates forecasts as a car gets them: recordings of many roads, played through the online pipeline.
//!
//! * **In:** the sources of the data set [`driving`](data::sets::DataSet::Driving). A source is a folder of
//!   recordings.
//! * **Out:** a [`Report`] by source, type and speed. It contains the errors of the published forecasts, of
//!   kinematic forecasts and of [anchors](metrics::Anchors) fitted to the other sources, the coverage of the
//!   regions, and the errors in the first seconds.
//!
//! A source is played as one run. Each recording goes through the chain of `stgdat predict`, from detections
//! to forecasts, tracker included. Every recording is another place, so each has new tracks, a new map and a
//! new retrieval memory. The sampler keeps its evidence from one recording to the next. Before the first one,
//! its prior comes from the [evidence](evidence::Priors) of the *other* sources.
//!
//! No source has motorway speeds. Fast sources are therefore also shown at twice their scale, as separate
//! sources.
//!
//! [`through_gaps`] evaluates how much forecasts help the tracker on the same sources. It returns a
//! [`Page`](crate::Page).
//!
//! [`synthetic`] evaluates forecasts and tracks of generated agents under noise, [`under_noise`] and
//! [`network_under_noise`] forecasts of recorded vehicles.

mod cell;
mod conflicts;
mod gaps;
mod gaussian;
mod noise;
mod odds;
mod patterns;
mod play;
mod region_of_steady;
mod report;
mod sample;
mod source;

use self::conflicts::{FORETELLERS, Foretold, Known, Pair, RECALL};
use cell::{BAND_NAMES, Cell, band_of};
pub use gaps::through_gaps;
use gaussian::Gaussian;
pub use noise::{network_under_noise, synthetic, under_noise};
pub(crate) use patterns::{Residual, Residuals, patterns};
use play::Played;
pub(crate) use play::{EVERY_NS, LEARNED_MIN};
pub use report::Report;
use report::subsets_of;
use sample::{Judge, Judged, LEVEL, Method, STEPS, Sample};
pub(crate) use sample::{at_step, nll_at, residuals_m};
pub(crate) use source::run;
pub use source::{Source, sources};

use crate::error::EvaluateError;
use crate::footage::Options;
use crate::threads;

/// Plays all sources. Calls `progress` with each source's name before it is read and before it is played.
///
/// # Errors
/// [`EvaluateError`] names the folder, recording or weights at fault.
pub fn evaluate(options: &Options, progress: impl Fn(&str) + Sync) -> Result<Report, EvaluateError> {
    let weights = options.weights.load()?;
    let model = weights.config();
    let sources = sources(&options.data.join("driving"), &options.sources)?;
    let windows = threads::each(&sources, options.threads, |source, _: &mut ()| {
        progress(&format!("reading {}", source.name));
        source.windows(model)
    });
    let windows = windows.into_iter().collect::<Result<Vec<_>, _>>()?;
    let threads = if options.lines.is_some() { 1 } else { options.threads };
    let played = threads::each(&sources, threads, |source, _: &mut ()| {
        progress(&format!("playing {}", source.name));
        let others = sources.iter().zip(&windows).filter(|(other, _)| other.folder != source.folder);
        let anchors = source::anchors(others.map(|(_, windows)| &windows[..]), model);
        play::play(source, &anchors, options, model)
    });
    let played = played.into_iter().collect::<Result<Vec<_>, _>>()?;
    Ok(Report::new(sources, played, options, model))
}
