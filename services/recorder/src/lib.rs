//! Keeps what the report needs, and tells it.
//!
//! The [`Recorder`] reads the topics at the pipeline's ends: `forecasts`, whose headers tell the whole way of each tick
//! ([`passage`]), `truth`, against which the forecasts are judged once their horizon has passed ([`accuracy`]), and
//! `heartbeats`, which tell of frames lost and stages started again. It answers with a [`Report`]: as JSON for scripts,
//! as tables for people ([`Report::render`]). [`live`] shows the same while it runs; [`ForecastWriter`] writes the
//! forecasts themselves.
//!
//! A run may last for days: percentiles come from histograms, forecasts wait in bounded queues, and nothing else grows.

pub mod accuracy;
mod distribution;
mod forecast_lines;
pub mod live;
mod losses;
mod options;
pub mod passage;
mod record;
mod render;
pub mod report;
pub mod stage;
mod text;
mod whole_file;

pub use forecast_lines::{FORECASTS_VERSION, ForecastWriter};
pub use options::{Options, STAGE};
pub use record::{Recorder, RecorderOptions, TICK_LIMIT_NS};
pub use report::{REPORT_VERSION, Report, ReportError, RunInfo, Status, Verdict};
pub use whole_file::{WholeFile, is_standard_output};
