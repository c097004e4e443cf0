//! The files of the recorder in the run's directory.

use std::io;
use std::path::PathBuf;

use run::Run;

use crate::{Checkpoint, Options, Recorder, RecorderOptions, Report, STAGE};

/// Name of the checkpoint in the run's directory.
const CHECKPOINT: &str = "recorder-checkpoint.json";
/// Name of the file in the run's directory with the forecasts' errors so far, for the launcher.
const ACCURACY: &str = "accuracy.json";
/// Name of the report in the run's directory.
const REPORT: &str = "report.json";

/// Saves the recorder's state, and the errors of the forecasts for the launcher. A failure is counted: only a
/// death of the recorder would lose anything by it.
pub(crate) fn save(run: &Run, recorder: &mut Recorder) {
    let saved = recorder.checkpoint().write(&checkpoint_path(run)).map_err(|error| error.to_string());
    let told = tell_accuracy(run, recorder).map_err(|error| error.to_string());
    if let Err(error) = saved.and(told) {
        tracing::warn!("the recorder's state is not saved: {error}");
        recorder.count_unwritten();
    }
}

/// Writes the forecasts' errors so far, for the launcher.
fn tell_accuracy(run: &Run, recorder: &Recorder) -> io::Result<()> {
    let json = serde_json::to_vec(&recorder.accuracy().errors)?;
    crate::whole_file::write_state(&accuracy_path(run), &json)
}

/// Path of the file with the forecasts' errors so far, as JSON of [`crate::Errors`].
#[must_use]
pub fn accuracy_path(run: &Run) -> PathBuf {
    run.root.join(ACCURACY)
}

pub(crate) fn checkpoint_path(run: &Run) -> PathBuf {
    run.root.join(CHECKPOINT)
}

/// The report of a run whose recorder died and was not restarted, from its last checkpoint; `None` if there
/// is no checkpoint.
#[must_use]
pub fn kept_report(run: &Run) -> Option<Report> {
    let kept = Checkpoint::read(&checkpoint_path(run)).ok()?;
    Some(Recorder::resume(settings(run), kept).report())
}

/// The report of a run whose recorder has left no checkpoint.
#[must_use]
pub fn empty_report(run: &Run) -> Report {
    Recorder::new(settings(run)).report()
}

/// Path of a run's report.
#[must_use]
pub fn report_path(run: &Run, options: &Options) -> PathBuf {
    options.report.clone().unwrap_or_else(|| run.root.join(REPORT))
}

pub(crate) fn settings(run: &Run) -> RecorderOptions {
    // The stage has refused options that can't be read.
    let silence_ns = STAGE.options(run).unwrap_or_default().silence_ns();
    RecorderOptions { silence_ns, ..RecorderOptions::of(run) }
}
