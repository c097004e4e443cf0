//! The state of a run in progress as data: what `stgdat top` shows, and what the metrics are made of.
//!
//! A [`RunStatus`] joins three views: the whole run so far ([`Report`]), the last ten seconds ([`LiveView`]),
//! and what only the launcher knows ([`Facts`]): processes, their CPU time and memory, and what happened to
//! them.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use wire::{Cause, Quality, StageId};

use crate::live::LiveView;
use crate::record::Recorder;
use crate::report::{Errors, Percentiles, Report, Supervision};

/// Version of the status' fields.
pub const STATUS_VERSION: u32 = 1;

/// A run in progress.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunStatus {
    /// [`STATUS_VERSION`].
    pub version: u32,
    /// The run's name.
    pub run: String,
    /// The recording or scene.
    pub title: String,
    /// Process number of the launcher.
    pub launcher_pid: u32,
    /// Whether a frame has passed through the whole chain.
    pub linked: bool,
    /// Time since the release of the first tick.
    pub elapsed_s: f64,
    /// Ticks after which the run ends, if that is known.
    pub ticks_limit: Option<u64>,
    /// Ticks that `recent` values are of: at most the last ten seconds.
    pub recent_ticks: u64,
    /// End-to-end latency of the recent ticks.
    pub recent_end_to_end_ms: Percentiles,
    /// The stages in the order in which a tick passes them.
    pub stages: Vec<StageStatus>,
    /// The forecasts of the newest tick.
    pub newest: Newest,
    /// Errors and coverage of the forecasts so far, as the recorder last told; none before it has.
    pub accuracy: Option<Errors>,
    /// The newest of what happened to stages, the newest last.
    pub events: Vec<StatusEvent>,
    /// The whole run so far.
    pub report: Report,
}

/// One stage of a run in progress.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageStatus {
    /// The stage's name.
    pub name: String,
    /// Whether its last heartbeat is recent; none before the first.
    pub alive: Option<bool>,
    /// Ticks that it has not finished of those that have forecasts, by its last heartbeat.
    pub behind_ticks: Option<u64>,
    /// Its share of the tick limit.
    pub budget_ms: Option<f64>,
    /// Recent times in which its input was there, but it was busy or waited for other input.
    pub recent_waiting_ms: Percentiles,
    /// Recent times from the sending of the input to its receipt.
    pub recent_wake_up_ms: Percentiles,
    /// Recent times of computation.
    pub recent_compute_ms: Percentiles,
    /// Recent times of sending.
    pub recent_publish_ms: Percentiles,
    /// Its process.
    pub process: ProcessStatus,
}

/// The process of a stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ProcessStatus {
    /// `running`, `restarting`, `given up` or `ended`; empty where nobody supervises it.
    pub state: String,
    /// Process number, while it runs.
    pub pid: Option<u32>,
    /// Restarts. The launcher counts replacements too, a [`RunStatus`] does not.
    pub restarts: u32,
    /// CPU time of all its threads since it was started.
    pub cpu_s: Option<f64>,
    /// CPU time per time, since the last look: 1 is one processor.
    pub cpu: Option<f64>,
    /// Memory of its own that lies in RAM.
    pub memory_bytes: Option<u64>,
    /// Memory that it shares with others, such as the frames, and files that it has mapped.
    pub shared_bytes: Option<u64>,
    /// What its spare is doing: `ready`, `starting`, `waiting` or `given up`; none where it has none.
    #[serde(default)]
    pub spare: Option<String>,
    /// Times that a spare took its place after a death.
    #[serde(default)]
    pub promotions: u32,
}

/// The forecasts of the newest tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Newest {
    /// The tick's number; none before the first.
    pub tick: Option<u64>,
    /// Forecasts by quality.
    pub qualities: BTreeMap<String, u64>,
    /// Forecasts that are held or kinematic, by cause.
    pub causes: BTreeMap<String, u64>,
    /// Forecasts of agents that move as none did in training.
    pub outside: u64,
}

/// Something that happened to a stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StatusEvent {
    /// Since the start of the launcher.
    pub elapsed_s: f64,
    /// What happened, in a sentence.
    pub text: String,
}

/// What only the launcher knows.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    /// The run's name.
    pub run: String,
    /// Process number of the launcher.
    pub launcher_pid: u32,
    /// Whether a frame has passed through the whole chain.
    pub linked: bool,
    /// The processes of the stages.
    pub processes: BTreeMap<StageId, ProcessStatus>,
    /// What the recorder last told of the forecasts.
    pub accuracy: Option<Errors>,
    /// Deaths, restarts and replacements so far.
    pub supervision: Supervision,
    /// What happened to stages.
    pub events: Vec<StatusEvent>,
}

impl RunStatus {
    /// The status of a run, of what was seen of it.
    #[must_use]
    pub fn new(view: &LiveView, measured: &Recorder, facts: Facts) -> Self {
        let mut report = measured.report();
        report.supervised(facts.supervision);
        let newest_tick = view.newest_tick();
        let stages = view.stages().into_iter().map(|(stage, row)| {
            let [waiting, wake_up, compute, publish] = view.recent_ms(stage);
            let mut process = facts.processes.get(&stage).cloned().unwrap_or_default();
            let replacements = report.supervision.replacements.iter();
            let of_stage = replacements.filter(|replacement| replacement.outage.stage == stage.name());
            let replaced: u32 = of_stage.map(|replacement| replacement.outcome.incarnations()).sum();
            process.restarts = process.restarts.saturating_sub(replaced);
            let reached = view.beat(stage).filter(|beat| beat.frames_len > 0).map(|beat| beat.seq);
            StageStatus {
                name: stage.name().to_owned(),
                alive: row.alive,
                behind_ticks: newest_tick.zip(reached).map(|(newest, seq)| newest.saturating_sub(seq)),
                budget_ms: row.budget_ms,
                recent_waiting_ms: waiting,
                recent_wake_up_ms: wake_up,
                recent_compute_ms: compute,
                recent_publish_ms: publish,
                process,
            }
        });
        let count = |counts: &[u64], name: fn(usize) -> &'static str| {
            let named = counts.iter().enumerate().map(|(nth, &count)| (name(nth).to_owned(), count));
            named.collect::<BTreeMap<String, u64>>()
        };
        let mut causes = count(view.newest_causes(), |nth| Cause::ALL[nth].name());
        causes.retain(|cause, count| cause != Cause::None.name() && *count > 0);
        Self {
            version: STATUS_VERSION,
            run: facts.run,
            title: view.title().to_owned(),
            launcher_pid: facts.launcher_pid,
            linked: facts.linked,
            elapsed_s: (view.elapsed_s() * 1e3).round() / 1e3,
            ticks_limit: view.ticks_limit(),
            recent_ticks: view.recent_ticks(),
            recent_end_to_end_ms: view.recent_end_to_end_ms(),
            stages: stages.collect(),
            newest: Newest {
                tick: newest_tick,
                qualities: count(view.newest_qualities(), |nth| Quality::ALL[nth].name()),
                causes,
                outside: view.newest_outside(),
            },
            accuracy: facts.accuracy,
            events: facts.events,
            report,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::LiveOptions;
    use crate::record::RecorderOptions;
    use crate::report::{Outage, Replacement, ReplacementOutcome};

    #[test]
    fn a_replacement_is_no_restart() {
        let replacement = |outcome| Replacement {
            outcome,
            outage: Outage { stage: "encoder".to_owned(), ..Outage::default() },
            ..Replacement::default()
        };
        let restarts = |started: u32, outcomes: &[ReplacementOutcome]| {
            let process = ProcessStatus { restarts: started, ..ProcessStatus::default() };
            let replacements = outcomes.iter().map(|outcome| replacement(*outcome)).collect();
            let facts = Facts {
                processes: [(StageId::Encoder, process)].into(),
                supervision: Supervision { replacements, ..Supervision::default() },
                ..Facts::default()
            };
            let budgets_ms = BTreeMap::from([(StageId::Encoder, 10.0)]);
            let view = LiveView::new(LiveOptions { budgets_ms, ..LiveOptions::default() });
            let measured = Recorder::new(RecorderOptions::default());
            RunStatus::new(&view, &measured, facts).stages[0].process.restarts
        };
        assert_eq!(restarts(2, &[]), 2);
        assert_eq!(restarts(1, &[ReplacementOutcome::Replaced]), 0);
        assert_eq!(restarts(4, &[ReplacementOutcome::RolledBack, ReplacementOutcome::NotUsed]), 2);
    }
}
