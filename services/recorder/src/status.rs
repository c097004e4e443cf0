//! The state of a running pipeline as data. `stgdat top` shows it, and the metrics are made from it.
//!
//! A [`RunStatus`] combines three views:
//!
//! * the whole run so far ([`Report`]);
//! * the last ten seconds ([`LiveView`]);
//! * facts that only the launcher knows ([`Facts`]): processes with their CPU time, memory and events.

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
    /// Number of ticks after which the run ends, if it is known.
    pub ticks_limit: Option<u64>,
    /// Number of ticks that the `recent` values cover: at most the last ten seconds.
    pub recent_ticks: u64,
    /// End-to-end latency of the recent ticks.
    pub recent_end_to_end_ms: Percentiles,
    /// The stages in the order in which a tick passes them.
    pub stages: Vec<StageStatus>,
    /// The forecasts of the newest tick.
    pub newest: Newest,
    /// Errors and coverage of the forecasts so far, as last reported by the recorder; `None` before the first
    /// report.
    pub accuracy: Option<Errors>,
    /// The newest events of stages, newest last.
    pub events: Vec<StatusEvent>,
    /// The whole run so far.
    pub report: Report,
}

/// One stage of a run in progress.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageStatus {
    /// The stage's name.
    pub name: String,
    /// Whether its last heartbeat is recent; `None` before the first.
    pub alive: Option<bool>,
    /// Number of ticks that have forecasts but that it has not finished, according to its last heartbeat.
    pub behind_ticks: Option<u64>,
    /// Its share of the tick limit.
    pub budget_ms: Option<f64>,
    /// Recent times in which its input was available, but it was busy or waited for other input.
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
    /// `running`, `restarting`, `given up` or `ended`; empty if the stage is not supervised.
    pub state: String,
    /// Process number, while it runs.
    pub pid: Option<u32>,
    /// Number of restarts. The launcher also counts replacements; a [`RunStatus`] does not.
    pub restarts: u32,
    /// CPU time of all its threads since it was started.
    pub cpu_s: Option<f64>,
    /// CPU time per elapsed time since the last check: 1 is one processor.
    pub cpu: Option<f64>,
    /// Its private resident memory.
    pub memory_bytes: Option<u64>,
    /// Its memory that is shared with other processes, such as the frames, and mapped files.
    pub shared_bytes: Option<u64>,
    /// State of its spare: `ready`, `starting`, `waiting` or `given up`; `None` if it has no spare.
    #[serde(default)]
    pub spare: Option<String>,
    /// Number of times that a spare took its place after a death.
    #[serde(default)]
    pub promotions: u32,
}

/// The forecasts of the newest tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Newest {
    /// The tick's number; `None` before the first.
    pub tick: Option<u64>,
    /// Numbers of forecasts by quality.
    pub qualities: BTreeMap<String, u64>,
    /// Numbers of held or kinematic forecasts, by cause.
    pub causes: BTreeMap<String, u64>,
    /// Number of forecasts of agents that are out of distribution.
    pub outside: u64,
}

/// An event of a stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StatusEvent {
    /// Time since the start of the launcher.
    pub elapsed_s: f64,
    /// The event, in a sentence.
    pub text: String,
}

/// Facts that only the launcher knows.
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
    /// The errors last reported by the recorder.
    pub accuracy: Option<Errors>,
    /// Deaths, restarts and replacements so far.
    pub supervision: Supervision,
    /// Events of stages.
    pub events: Vec<StatusEvent>,
}

impl RunStatus {
    /// The status of a run, from the observations.
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
