//! Every forecast or track behind a table beside the truth, as JSON lines.

use std::collections::BTreeMap;
use std::fmt;
use std::io::{self, Write};
use std::sync::{Mutex, PoisonError};

use metrics::Point;
use serde::Serialize;
use wire::Forecast;

/// Where the lines are written. A failure ends the writing and is reported at the end.
pub struct ForecastLines(Mutex<(Box<dyn Write + Send>, io::Result<()>)>);

/// All forecasts for an agent at a time.
#[derive(Debug, Serialize)]
pub struct ForecastLine<'a> {
    /// Part of the evaluation: a fold, a site, a source or a recording.
    pub part: &'a str,
    /// Name of the recording.
    pub recording: &'a str,
    /// Time of the forecast.
    pub stamp_ns: i64,
    /// Identity of the agent in the recording.
    pub agent: u64,
    /// Type of the agent.
    #[serde(rename = "type")]
    pub agent_type: &'static str,
    /// Speed at the last observed step, m/s.
    pub speed_mps: f32,
    /// The subsets of the tables that count the agent.
    pub subsets: Vec<&'static str>,
    /// Size of a pixel of the video, if the tables have pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pixel_m: Option<f64>,
    /// Position at each step of the horizon; `null` if the recording has none.
    pub truth_m: &'a [Option<Point>],
    /// The forecasts by the name of their method in the tables.
    pub forecasts: BTreeMap<&'static str, &'a Candidate>,
}

/// The forecasts of one method for one agent.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Candidate {
    /// The 20 modes; empty if the method has none.
    #[serde(rename = "modes_m", skip_serializing_if = "Vec::is_empty")]
    pub modes: Vec<Vec<Point>>,
    /// Probabilities of the modes; `None` if the method has none.
    #[serde(rename = "probabilities", skip_serializing_if = "Option::is_none")]
    pub probability: Option<Vec<f32>>,
    /// Covariances (xx, xy, yy) of each mode's positions, m²; empty if the method has none.
    #[serde(skip)]
    pub covariance: Vec<Vec<[f32; 3]>>,
    /// The single forecast; `None` if the method has none.
    #[serde(rename = "single_m", skip_serializing_if = "Option::is_none")]
    pub single: Option<Vec<Point>>,
}

/// The estimates of a tracked agent at a time.
#[derive(Debug, Serialize)]
pub(crate) struct TrackLine<'a> {
    /// Part of the evaluation.
    pub(crate) part: &'a str,
    pub(crate) recording: &'a str,
    pub(crate) stamp_ns: i64,
    pub(crate) agent: u64,
    #[serde(rename = "type")]
    pub(crate) agent_type: &'static str,
    /// Standard deviation of the measured positions, m.
    pub(crate) sigma_m: f64,
    /// Length of the gaps in the measurements, s; 0 for none.
    pub(crate) gap_s: f64,
    /// Whether the agent is measured at this time.
    pub(crate) is_measured: bool,
    pub(crate) truth: Motion,
    /// The estimates by the name of their method in the tables.
    pub(crate) tracks: BTreeMap<&'static str, Motion>,
}

/// Position and, if the evaluation compares it, velocity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Motion {
    pub(crate) position_m: [f64; 2],
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) velocity_mps: Option<[f64; 2]>,
}

/// The counted objects and tracks of a class in a frame, as (identity, x, y).
#[derive(Debug, Serialize)]
pub(crate) struct FrameLine<'a> {
    pub(crate) part: &'a str,
    pub(crate) recording: &'a str,
    pub(crate) frame: usize,
    pub(crate) class: &'static str,
    pub(crate) tracker: &'static str,
    pub(crate) truths: Vec<(u64, f64, f64)>,
    pub(crate) tracks: Vec<(u64, f64, f64)>,
}

impl Candidate {
    /// The first `len` steps of a published forecast.
    #[must_use]
    pub fn published(forecast: &Forecast, len: usize) -> Self {
        let modes_len = forecast.modes_len as usize;
        let covariance = &forecast.mode_covariance[..modes_len];
        Self {
            modes: forecast.modes[..modes_len].iter().map(|mode| mode[..len].to_vec()).collect(),
            probability: Some(forecast.probability[..modes_len].to_vec()),
            covariance: covariance.iter().map(|mode| mode[..len].to_vec()).collect(),
            single: Some(forecast.best[..len].to_vec()),
        }
    }

    /// Whether the method has no forecast.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.modes.is_empty() && self.single.is_none()
    }
}

impl ForecastLines {
    /// Lines for a writer.
    pub fn to(writer: impl Write + Send + 'static) -> Self {
        Self(Mutex::new((Box::new(writer), Ok(()))))
    }

    /// Writes a line.
    pub(crate) fn add(&self, line: &impl Serialize) {
        self.write(&text(line));
    }

    /// Writes whole lines.
    pub fn write(&self, lines: &str) {
        let mut of = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (writer, outcome) = &mut *of;
        if outcome.is_ok() {
            *outcome = writer.write_all(lines.as_bytes());
        }
    }

    /// Ends the writing.
    ///
    /// # Errors
    /// The first failure.
    pub fn finish(&self) -> io::Result<()> {
        let mut of = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (writer, outcome) = &mut *of;
        std::mem::replace(outcome, Ok(())).and_then(|()| writer.flush())
    }
}

impl fmt::Debug for ForecastLines {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("ForecastLines")
    }
}

/// A line with its end.
///
/// # Panics
/// Never: all keys are strings.
pub(crate) fn text(line: &impl Serialize) -> String {
    serde_json::to_string(line).expect("all keys are strings") + "\n"
}
