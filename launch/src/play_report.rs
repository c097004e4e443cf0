//! The report of `predict` and `track` on a played recording, with the same figures as the report of `run`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Args;
use console::failure::Failure;
use data::Recording;
use recorder::{InputReport, InputTally, LaneCounts, Status, Verdict};
use run::Exit;
use serde::Serialize;
use source::Playback;
use wire::Header;

use crate::files::check_place;

/// The report on a recording that is played in this process.
#[derive(Debug, Args)]
pub struct VerdictArguments {
    /// Write the report as JSON: ticks, agents, findings about the input, and the verdict
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Exit with 65 if the input is doubtful or no agent was tracked
    #[arg(long)]
    pub strict: bool,
}

impl VerdictArguments {
    /// Checks before any work is done that the report can be written.
    ///
    /// # Errors
    /// [`Failure::Data`] if the report's folder does not exist.
    pub fn check(&self) -> Result<(), Failure> {
        self.report.as_deref().map_or(Ok(()), check_place)
    }
}

/// The report of `predict` and `track`. Names end with their units.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PlayReport {
    /// Whether the input produced output, and which parts did not.
    pub verdict: Verdict,
    /// Name of the recording.
    pub recording: String,
    /// Ticks that were played.
    pub ticks: u64,
    /// Interval between ticks.
    pub interval_ms: f64,
    /// One frame of this many was played.
    pub thinned_by: u64,
    /// Number of agents, summed over ticks.
    pub agents: u64,
    /// Maximum number of agents in a tick.
    pub agents_max: u64,
    /// Agents left out of full frames, summed over ticks.
    pub agents_left_out: u64,
    /// Detections left out of full frames, summed over ticks.
    pub detections_left_out: u64,
    /// Ticks that the tracker refused.
    pub ticks_refused: u64,
    /// Forecasts of vehicles on the map of lanes.
    pub lanes: LaneCounts,
    /// The contents of the input and its probable defects.
    pub input: InputReport,
    #[serde(skip)]
    tally: InputTally,
}

impl PlayReport {
    /// Creates the report before the first tick.
    pub fn new(playback: &Playback, input: InputReport) -> Self {
        let recording = playback.recording();
        Self {
            recording: recording.name.clone(),
            interval_ms: playback.interval_ns() as f64 / 1e6,
            thinned_by: playback.thinning(),
            input,
            ..Self::default()
        }
    }

    /// Adds the agents of a tick: their types and their published noise.
    pub fn tick(&mut self, header: &Header, agents: impl ExactSizeIterator<Item = (u32, [f32; 3])>) {
        let agents_len = agents.len() as u64;
        self.ticks += 1;
        self.agents += agents_len;
        self.agents_max = self.agents_max.max(agents_len);
        self.agents_left_out += u64::from(header.left_out_len);
        self.ticks_refused += u64::from(header.has(wire::flags::VOID));
        self.tally.tick(header, agents);
    }

    /// The noise of the detections so far; `None` if it is unknown.
    pub fn noise_line(&self) -> Option<String> {
        Some(format!("noise: {}", audit::noise_words(&self.tally.noise())?))
    }

    /// Completes the report, prints it on standard error and writes it to the file, if given. Returns the
    /// exit code.
    pub fn finish(mut self, playback: &Playback, file: Option<&Path>, strict: bool) -> Result<Exit, Failure> {
        self.detections_left_out = playback.left_out_len();
        self.input = self.tally.report(&self.input);
        let is_empty = self.agents == 0;
        self.verdict = Verdict::new(is_empty, self.reasons());
        self.lines().iter().for_each(|line| tracing::info!("{line}"));
        if let Some(file) = file {
            let json = serde_json::to_string_pretty(&self).map_err(Failure::data)? + "\n";
            std::fs::write(file, json).map_err(|error| Failure::file(file, error))?;
        }
        let is_doubtful = self.input.is_doubtful() || self.lanes.doubt().is_some();
        Ok(if strict && (is_empty || is_doubtful) { Exit::Data } else { Exit::Done })
    }

    fn reasons(&self) -> Vec<String> {
        let Self { ticks, agents, agents_left_out, detections_left_out, ticks_refused, .. } = *self;
        let mut reasons = Vec::new();
        let counted = [
            ("detections left out of full frames", detections_left_out),
            ("agents left out of full frames", agents_left_out),
            ("ticks refused", ticks_refused),
        ];
        for (what, count) in counted.into_iter().filter(|(_, count)| *count > 0) {
            reasons.push(format!("{what}: {count}"));
        }
        if agents == 0 {
            let detections = self.input.detections;
            reasons.push(format!("no agent was tracked in any of {ticks} ticks, of {detections} detections"));
        }
        reasons.extend(self.input.reasons());
        reasons.extend(self.lanes.reason());
        reasons
    }

    /// Returns the warnings that were not known before the first tick; empty if all went well.
    fn lines(&self) -> Vec<String> {
        let status = self.verdict.status.name();
        let warned: Vec<String> = self.input.reasons().filter(|reason| reason.ends_with(')')).collect();
        let new = self.verdict.reasons.iter().filter(|reason| !warned.contains(reason));
        let mut lines: Vec<String> = new.map(|reason| format!("  {reason}")).collect();
        let thinned = (self.thinned_by > 1).then(|| format!("1 frame in {} is played", self.thinned_by));
        let notes = self.input.findings.iter().filter(|found| !found.doubtful).map(ToString::to_string);
        let counts = self.input.line().filter(|_| !self.input.is_clean());
        lines.extend(counts.into_iter().chain(thinned).chain(notes).map(|line| format!("  {line}")));
        if self.verdict.status != Status::Ok || !lines.is_empty() {
            lines.insert(0, format!("{status}: {} ticks, at most {} agents", self.ticks, self.agents_max));
            lines.extend(self.input.noise_line().map(|noise| format!("  noise: {noise}")));
        }
        lines
    }
}

/// Returns the audit of a recording before it is played.
pub fn input_of(recording: &Recording) -> InputReport {
    let rows = recording.left_out.iter().map(|left_out| (left_out.reason.clone(), left_out.row_count as u64));
    let (findings, poses_missing) = (data::findings(recording), recording.poses_missing as u64);
    InputReport::of_recording(findings, rows.collect::<BTreeMap<_, _>>(), poses_missing)
}
