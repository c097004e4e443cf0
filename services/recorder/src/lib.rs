//! The recorder: measures latency, losses and accuracy of a run, and reports them.
//!
//! The [`Recorder`] reads three topics:
//!
//! * `forecasts`: their headers contain the times of each tick in every stage ([`passage`]);
//! * `truth`: forecasts are scored against it once their horizon has passed ([`accuracy`]);
//! * `heartbeats`: they count lost frames and restarts.
//!
//! The figures of a [`Tick`] are counted once, and the recorder sums them. Everything that shows a run is a view
//! of this state: the [`Report`], the status of a running pipeline ([`status`]), metrics ([`exposition`]) and
//! traces ([`trace`]). The launcher has its own recorder, so that it shows a run without the recorder's process.
//! [`ForecastWriter`] writes the forecasts.
//!
//! A run may last for days. Percentiles therefore come from histograms, forecasts wait in bounded queues, and
//! nothing else grows.

pub mod accuracy;
mod arrivals;
mod distribution;
pub mod exposition;
mod forecast_lines;
mod input;
mod lanes;
mod losses;
mod options;
pub mod passage;
mod record;
mod refusals;
mod render;
pub mod report;
pub mod saved;
mod sessions;
pub mod stage;
pub mod status;
pub mod text;
pub mod tick;
pub mod trace;
mod whole_file;
mod worst;

pub use arrivals::{InputStatus, Silences};
pub use forecast_lines::{FORECASTS_VERSION, ForecastWriter, write_forecast_line};
pub use input::{InputReport, InputTally};
pub use lanes::LaneCounts;
pub use options::{Options, STAGE};
pub use record::{Checkpoint, Recorder, RecorderOptions};
pub use report::{
    Errors, Outage, PARTNERS, REPORT_VERSION, RefusedFrames, Replacement, ReplacementOutcome, Report,
    ReportError, RunInfo, SceneNoise, SpareReport, StageMemory, Status, Supervision, Verdict, WorstTick,
    program_name,
};
pub use sessions::Sessions;
pub use tick::Tick;
pub use whole_file::{WholeFile, is_standard_output};
