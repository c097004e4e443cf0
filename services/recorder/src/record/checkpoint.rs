//! The data with which a recorder continues after a previous one has died.
//!
//! The stage writes it once a second, so a death loses at most one second of the report. Forecasts that wait
//! for their truth are omitted because they are large. They count as uncovered.

use std::path::Path;

use serde::{Deserialize, Serialize};
use wire::{Cause, Quality, StageId};

use super::{Recorder, RecorderOptions, ShedCounts, Span, StageTimes};
use crate::accuracy::ScorerCheckpoint;
use crate::distribution::Kept;
use crate::input::InputTally;
use crate::lanes::LaneCounts;
use crate::losses::Losses;
use crate::report::{OutOfDistribution, ReportError};
use crate::worst::Worst;

/// All counts of a [`Recorder`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Checkpoint {
    end_to_end: Kept,
    overhead: Kept,
    /// By the stage's number: waiting, wake-up, compute, publish, and number of ticks over the budget.
    stages: Vec<(u32, [Kept; 4], u64)>,
    losses: Losses,
    scorer: ScorerCheckpoint,
    span: Option<Span>,
    next_seq: Option<u64>,
    interval_ns: u64,
    lockstep: bool,
    ticks: u64,
    late_ticks: u64,
    agents_left_out: u64,
    hops_missing: u64,
    #[serde(default)]
    input: InputTally,
    agents_max: u64,
    forecasts_by_quality: [u64; Quality::ALL.len()],
    fallbacks_by_cause: [u64; Cause::ALL.len()],
    states_by_prior: [u64; Quality::ALL.len()],
    degraded_ticks: u64,
    predicted_ticks: u64,
    silent: u64,
    age_ns_max: Option<u64>,
    shed: ShedCounts,
    out_of_distribution: OutOfDistribution,
    #[serde(default)]
    lanes: LaneCounts,
    worst: Worst,
}

impl Checkpoint {
    /// Writes it as JSON. The file is written atomically.
    ///
    /// # Errors
    /// [`ReportError::File`] with the path.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        let file = |source| ReportError::File { path: path.display().to_string(), source };
        let json = serde_json::to_vec(self).map_err(|error| file(error.into()))?;
        crate::whole_file::write(path, &json).map_err(file)
    }

    /// Reads the result of [`Checkpoint::write`].
    ///
    /// # Errors
    /// [`ReportError`] if the file cannot be read or has other content.
    pub fn read(path: &Path) -> Result<Self, ReportError> {
        let shown = || path.display().to_string();
        let json = std::fs::read(path).map_err(|source| ReportError::File { path: shown(), source })?;
        serde_json::from_slice(&json).map_err(|source| ReportError::Format { path: shown(), source })
    }
}

impl Recorder {
    /// All counts so far.
    #[must_use]
    pub fn checkpoint(&self) -> Checkpoint {
        let stages = self.stages.iter().map(|(stage, times)| {
            let StageTimes { waiting, wake_up, compute, publish, late_ticks } = times;
            (stage.number(), [waiting, wake_up, compute, publish].map(Kept::from), *late_ticks)
        });
        Checkpoint {
            end_to_end: (&self.end_to_end).into(),
            overhead: (&self.overhead).into(),
            stages: stages.collect(),
            losses: self.losses.clone(),
            scorer: self.scorer.checkpoint(),
            span: self.span,
            next_seq: self.next_seq,
            interval_ns: self.interval_ns,
            lockstep: self.lockstep,
            ticks: self.ticks,
            late_ticks: self.late_ticks,
            agents_left_out: self.agents_left_out,
            hops_missing: self.hops_missing,
            input: self.input,
            agents_max: self.agents_max,
            forecasts_by_quality: self.forecasts_by_quality,
            fallbacks_by_cause: self.fallbacks_by_cause,
            states_by_prior: self.states_by_prior,
            degraded_ticks: self.degraded_ticks,
            predicted_ticks: self.predicted_ticks,
            silent: self.silent,
            age_ns_max: self.age_ns_max,
            shed: self.shed,
            out_of_distribution: self.out_of_distribution,
            lanes: self.lanes,
            worst: self.worst.clone(),
        }
    }

    /// A recorder that continues from the counts of one that died. Ticks before the first one that it
    /// receives are counted as not recorded.
    #[must_use]
    pub fn resume(options: RecorderOptions, kept: Checkpoint) -> Self {
        let stages = kept.stages.into_iter().filter_map(|(stage, times, late_ticks)| {
            let [waiting, wake_up, compute, publish] = times.map(Into::into);
            Some((
                StageId::from_number(stage)?,
                StageTimes { waiting, wake_up, compute, publish, late_ticks },
            ))
        });
        Self {
            end_to_end: kept.end_to_end.into(),
            overhead: kept.overhead.into(),
            stages: stages.collect(),
            losses: kept.losses,
            scorer: kept.scorer.into(),
            span: kept.span,
            next_seq: kept.next_seq,
            interval_ns: kept.interval_ns,
            lockstep: kept.lockstep,
            ticks: kept.ticks,
            late_ticks: kept.late_ticks,
            agents_left_out: kept.agents_left_out,
            hops_missing: kept.hops_missing,
            input: kept.input,
            agents_max: kept.agents_max,
            forecasts_by_quality: kept.forecasts_by_quality,
            fallbacks_by_cause: kept.fallbacks_by_cause,
            states_by_prior: kept.states_by_prior,
            degraded_ticks: kept.degraded_ticks,
            predicted_ticks: kept.predicted_ticks,
            silent: kept.silent,
            age_ns_max: kept.age_ns_max,
            shed: kept.shed,
            out_of_distribution: kept.out_of_distribution,
            lanes: kept.lanes,
            worst: kept.worst.with_room(),
            resumed: true,
            ..Self::new(options)
        }
    }
}
