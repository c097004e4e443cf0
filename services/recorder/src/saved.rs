//! The files of the recorder in the run's directory.

use std::io;
use std::path::PathBuf;

use ports::StageError;
use run::Run;
use wire::{Forecast, Header};

use crate::{Checkpoint, ForecastWriter, Options, Recorder, RecorderOptions, Report, STAGE};

/// Name of the checkpoint in the run's directory.
const CHECKPOINT: &str = "recorder-checkpoint.json";
/// Name of the file in the run's directory with the forecasts' errors so far, for the launcher.
const ACCURACY: &str = "accuracy.json";
/// Name of the report in the run's directory.
const REPORT: &str = "report.json";

/// The file of forecasts that the options name, if they name one.
pub(crate) struct ForecastFile(Option<(PathBuf, ForecastWriter)>);

impl ForecastFile {
    fn with(&mut self, act: impl FnOnce(&mut ForecastWriter) -> io::Result<()>) -> Result<(), StageError> {
        let Some((path, writer)) = &mut self.0 else { return Ok(()) };
        act(writer).map_err(|source| StageError::File { path: path.clone(), source })
    }

    /// Appends the forecasts of a tick.
    pub(crate) fn write(&mut self, header: &Header, forecasts: &[Forecast]) -> Result<(), StageError> {
        self.with(|writer| writer.write(header, forecasts))
    }

    /// Passes what is written to the system.
    pub(crate) fn flush(&mut self) -> Result<(), StageError> {
        self.with(ForecastWriter::flush)
    }

    /// Completes the file.
    pub(crate) fn finish(self) -> Result<(), StageError> {
        let Some((path, writer)) = self.0 else { return Ok(()) };
        writer.finish().map_err(|source| StageError::File { path, source })
    }
}

/// The recorder and its file of forecasts. A restarted process continues from the last checkpoint.
pub(crate) fn resume(run: &Run, options: &Options) -> Result<(Recorder, ForecastFile), StageError> {
    let kept = (ports::incarnation() > 0).then(|| Checkpoint::read(&checkpoint_path(run)).ok()).flatten();
    let open = if kept.is_some() { ForecastWriter::resume } else { ForecastWriter::create };
    let file = options.forecasts.clone().map(|path| match open(&path, run.origin()) {
        Ok(writer) => Ok((path, writer)),
        Err(source) => Err(StageError::File { path, source }),
    });
    let recorder = match kept {
        Some(kept) => Recorder::resume(settings(run), kept),
        None => Recorder::new(settings(run)),
    };
    Ok((recorder, ForecastFile(file.transpose()?)))
}

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
