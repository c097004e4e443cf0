//! The recorder: measures latency, losses and accuracy of a run, and reports them.
//!
//! The [`Recorder`] reads three topics:
//!
//! * `forecasts`: their headers contain the times of each tick in every stage ([`passage`]);
//! * `truth`: forecasts are scored against it once their horizon has passed ([`accuracy`]);
//! * `heartbeats`: they count lost frames and restarts.
//!
//! Its [`Report`] is JSON for scripts and tables for people ([`Report::render`]). [`live`] shows the same
//! during the run. [`ForecastWriter`] writes the forecasts.
//!
//! A run may last for days. Percentiles therefore come from histograms, forecasts wait in bounded queues, and
//! nothing else grows.

pub mod accuracy;
mod distribution;
pub mod exposition;
mod forecast_lines;
mod input;
mod lanes;
pub mod live;
mod losses;
mod options;
pub mod passage;
mod record;
mod refusals;
mod render;
pub mod report;
pub mod screen;
pub mod stage;
pub mod status;
pub mod text;
pub mod trace;
mod whole_file;
mod worst;

pub use forecast_lines::{FORECASTS_VERSION, ForecastWriter};
pub use input::{InputReport, InputTally};
pub use lanes::LaneCounts;
pub use options::{Options, STAGE};
pub use record::{Checkpoint, Recorder, RecorderOptions, TICK_LIMIT_NS};
pub use report::{
    Errors, Outage, REPORT_VERSION, RefusedFrames, Replacement, ReplacementOutcome, Report, ReportError,
    RunInfo, SpareReport, StageMemory, Status, Supervision, Verdict, WorstTick, program_name,
};
pub use whole_file::{WholeFile, is_standard_output};
