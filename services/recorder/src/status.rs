//! The state of a running pipeline as data. `stgdat top` shows it, and the metrics are made from it.
//!
//! A [`RunStatus`] combines:
//!
//! * the whole run so far ([`Report`]) and its last ten seconds, from a [`Recorder`];
//! * facts that only the launcher knows ([`Facts`]): processes with their CPU time, memory and events.

use std::borrow::Cow;
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use wire::{Cause, Quality, StageId};

use crate::arrivals::InputStatus;
use crate::distribution::ms;
use crate::record::Recorder;
use crate::report::{Errors, Percentiles, Report, Supervision};
use crate::text::{count, number};
use crate::tick::{Tick, is_fault};

/// Version of the status' fields.
pub const STATUS_VERSION: u32 = 2;

/// A stage is silent if its last heartbeat is older than this: more than two heartbeat intervals.
const SILENT_NS: u64 = 200_000_000;

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
    /// The stage that a run which has not begun waits for.
    #[serde(default)]
    pub waiting_for: Option<String>,
    /// Time since the release of the first tick.
    pub elapsed_s: f64,
    /// Number of ticks after which the run ends, if it is known.
    pub ticks_limit: Option<u64>,
    /// Number of ticks that the `recent` values cover: at most the last ten seconds.
    pub recent_ticks: u64,
    /// End-to-end latency of the recent ticks.
    pub recent_end_to_end_ms: Percentiles,
    /// Latency of each recent tick, newest last.
    pub recent_latencies_ms: Vec<f64>,
    /// Share of learned forecasts in the recent ticks, of those that can be learned: agents are old enough, and
    /// no other expert is better. `None` without such forecasts.
    #[serde(default)]
    pub recent_learned_share: Option<f64>,
    /// The stages in the order in which a tick passes them.
    pub stages: Vec<StageStatus>,
    /// The state of the input.
    #[serde(default)]
    pub input: InputStatus,
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
    /// Share of the tick limit.
    pub budget_ms: Option<f64>,
    /// Recent times in which its input was available, but it was busy or waited for other input.
    pub recent_waiting_ms: Percentiles,
    /// Recent times from the sending of the input to its receipt.
    pub recent_wake_up_ms: Percentiles,
    /// Recent times of computation.
    pub recent_compute_ms: Percentiles,
    /// Recent times of sending.
    pub recent_publish_ms: Percentiles,
    /// Process.
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
    /// Private resident memory.
    pub memory_bytes: Option<u64>,
    /// Memory that is shared with other processes, such as the frames, and mapped files.
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
    /// The stage that a run which has not begun waits for.
    pub waiting_for: Option<StageId>,
    /// The recording or scene.
    pub title: String,
    /// Number of ticks after which the run ends, if it is known.
    pub ticks_limit: Option<u64>,
    /// The time, on `CLOCK_MONOTONIC`.
    pub now_ns: u64,
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
    /// The status of a run.
    #[must_use]
    pub fn new(measured: &Recorder, facts: Facts) -> Self {
        let mut report = measured.report();
        report.supervised(facts.supervision);
        let input = measured.input_status(facts.now_ns);
        report.now(input.state.as_deref());
        let newest = measured.recent().next_back();
        let stage_status = |stage: StageId| {
            let mut process = facts.processes.get(&stage).cloned().unwrap_or_default();
            let replacements = report.supervision.replacements.iter();
            let of_stage = replacements.filter(|replacement| replacement.outage.stage == stage.name());
            let replaced: u32 = of_stage.map(|replacement| replacement.outcome.incarnations()).sum();
            let early = if stage == StageId::Source { report.supervision.early_starts } else { 0 };
            process.restarts = process.restarts.saturating_sub(replaced + early);
            let beat = measured.beat(stage);
            let reached = beat.filter(|beat| beat.frames_len > 0).map(|beat| beat.seq);
            let [recent_waiting_ms, recent_wake_up_ms, recent_compute_ms, recent_publish_ms] =
                measured.recent_ms(stage);
            StageStatus {
                name: stage.name().to_owned(),
                alive: beat.map(|beat| facts.now_ns.saturating_sub(beat.sent_ns) <= SILENT_NS),
                behind_ticks: newest.zip(reached).map(|(tick, seq)| tick.seq.saturating_sub(seq)),
                budget_ms: measured.budget_ms(stage),
                recent_waiting_ms,
                recent_wake_up_ms,
                recent_compute_ms,
                recent_publish_ms,
                process,
            }
        };
        let latencies_ns = measured.recent().filter_map(|tick| tick.passage.end_to_end_ns);
        Self {
            version: STATUS_VERSION,
            run: facts.run,
            title: facts.title,
            launcher_pid: facts.launcher_pid,
            linked: facts.linked,
            waiting_for: facts.waiting_for.map(|stage| stage.name().to_owned()),
            elapsed_s: (measured.elapsed_s(facts.now_ns) * 1e3).round() / 1e3,
            ticks_limit: facts.ticks_limit,
            recent_ticks: measured.recent().len() as u64,
            recent_end_to_end_ms: measured.recent_end_to_end_ms(),
            recent_latencies_ms: latencies_ns.map(ms).collect(),
            recent_learned_share: learned_share(measured.recent()),
            stages: measured.live_stages().map(stage_status).collect(),
            input,
            newest: Newest::of(newest),
            accuracy: facts.accuracy,
            events: facts.events,
            report,
        }
    }

    /// The state of a run that has not begun: `STARTING`, or `WAITING for source`.
    #[must_use]
    pub fn before_begin(&self) -> Cow<'static, str> {
        self.waiting_for.as_ref().map_or("STARTING".into(), |stage| format!("WAITING for {stage}").into())
    }

    /// One line for supervisors: the state of the input if it is wrong, or else the verdict so far. Then
    /// [`line`](Self::line).
    #[must_use]
    pub fn service_line(&self) -> String {
        if !self.linked {
            return self.before_begin().into_owned();
        }
        let state = self.input.state.as_deref().unwrap_or(self.report.verdict.status.name());
        format!("{state}: {}", self.line())
    }

    /// One line for outputs other than terminals: ticks, latency of the last ten seconds, late ticks and losses.
    #[must_use]
    pub fn line(&self) -> String {
        let of = self.ticks_limit.map_or_else(String::new, |limit| format!("/{limit}"));
        let Percentiles { p50, p99, .. } = self.recent_end_to_end_ms;
        let newest = |name: &str| self.newest.qualities.get(name).copied().unwrap_or(0);
        let shed = match self.report.forecasts.shed.forecasts {
            0 => String::new(),
            total => {
                let newest = self.newest.causes.get(Cause::Shed.name()).copied().unwrap_or(0);
                format!(", shed {newest} ({} so far)", count(total))
            }
        };
        format!(
            "tick {}{of}  {:.1} s  end to end p50 {} ms, p99 {} ms  forecasts {} learned, {} held, {} \
             kinematic{shed}  late {}, lost {}",
            self.report.ticks,
            self.elapsed_s,
            number(p50),
            number(p99),
            newest("learned"),
            newest("held"),
            newest("kinematic"),
            count(self.report.late_ticks),
            self.report.drops,
        )
    }
}

/// See [`RunStatus::recent_learned_share`].
fn learned_share<'a>(ticks: impl Iterator<Item = &'a Tick>) -> Option<f64> {
    let faults = Cause::ALL.into_iter().enumerate().filter(|(_, cause)| is_fault(*cause));
    let faults: Vec<usize> = faults.map(|(place, _)| place).collect();
    let (learned, others) = ticks.fold((0, 0), |(learned, others), tick| {
        let [of_tick, ..] = tick.qualities;
        (learned + of_tick, others + faults.iter().map(|place| tick.causes[*place]).sum::<u64>())
    });
    (learned + others > 0).then(|| learned as f64 / (learned + others) as f64)
}

impl Newest {
    fn of(tick: Option<&Tick>) -> Self {
        let names = Quality::ALL.map(|quality| quality.name().to_owned());
        let counts = tick.map_or([0; Quality::ALL.len()], |tick| tick.qualities);
        let causes = tick.into_iter().flat_map(|tick| Cause::ALL.into_iter().zip(tick.causes));
        let causes = causes.filter(|(cause, count)| *cause != Cause::None && *count > 0);
        Self {
            tick: tick.map(|tick| tick.seq),
            qualities: names.into_iter().zip(counts).collect(),
            causes: causes.map(|(cause, count)| (cause.name().to_owned(), count)).collect(),
            outside: tick.map_or(0, |tick| tick.out_of_distribution.forecasts),
        }
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use wire::{Forecast, Header, Heartbeat, Hop};

    use super::*;
    use crate::record::RecorderOptions;
    use crate::report::{Outage, Replacement, ReplacementOutcome};

    /// A run of `ticks` ticks with these forecasts, two silent seconds after the heartbeats of two stages.
    fn status(ticks: u64, forecasts: &[Forecast]) -> RunStatus {
        const MS: u64 = 1_000_000;
        let mut measured = Recorder::new(RecorderOptions { scores: false, ..RecorderOptions::default() });
        for seq in 0..ticks {
            let released_ns = 1_000 * MS + seq * 80 * MS;
            let mut header = Header { released_ns, ..Header::new(1, seq, (seq * 80 * MS) as i64) };
            header.counts.agents_len = forecasts.len() as u32;
            let sent_ns = released_ns + (10 + seq % 5) * MS;
            header.push_hop(Hop { stage: StageId::Sampler.number(), sent_ns, ..Hop::zeroed() });
            measured.forecasts(&header, forecasts).unwrap();
        }
        let now_ns = 1_000 * MS + ticks * 80 * MS;
        for (stage, ago_ns) in [(StageId::Source, 100 * MS), (StageId::Tracker, 300 * MS)] {
            let sent_ns = now_ns - ago_ns;
            let (frames_len, stage) = (ticks, stage.number());
            measured.heartbeat(&Heartbeat { stage, sent_ns, frames_len, ..Heartbeat::zeroed() });
        }
        RunStatus::new(&measured, Facts { now_ns, ticks_limit: Some(500), ..Facts::default() })
    }

    fn forecast(quality: Quality, cause: Cause) -> Forecast {
        Forecast { quality: quality as u32, cause: cause as u32, ..Forecast::zeroed() }
    }

    #[test]
    fn the_line_has_the_figures_of_the_status() {
        let learned = forecast(Quality::Learned, Cause::None);
        let shed = forecast(Quality::Held, Cause::Shed);
        assert_eq!(
            status(155, &[learned, shed, forecast(Quality::Held, Cause::Late)]).line(),
            "tick 155/500  12.4 s  end to end p50 12.0 ms, p99 14.0 ms  forecasts 1 learned, 2 held, 0 kinematic, \
             shed 1 (155 so far)  late 0, lost 0"
        );
        assert!(status(2, &[learned]).line().contains("1 learned, 0 held, 0 kinematic  late 0"));
    }

    #[test]
    fn the_newest_values_are_of_ten_seconds() {
        let status = status(10_000, &[]);
        assert_eq!(
            (status.recent_ticks, status.recent_latencies_ms.len(), status.report.ticks),
            (125, 125, 10_000)
        );
        assert_eq!(status.recent_latencies_ms[123..], [13.0, 14.0], "the newest is last");
    }

    #[test]
    fn a_stage_without_a_recent_heartbeat_is_silent() {
        let status = status(20, &[]);
        let alive = |name| status.stages.iter().find(|stage| stage.name == name).map(|stage| stage.alive);
        assert_eq!(alive("source"), Some(Some(true)));
        assert_eq!(alive("tracker"), Some(Some(false)));
        assert_eq!(alive("sampler"), Some(None));
        assert_eq!(alive("decoder"), None, "it has no budget and no tick has passed it");
    }

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
            let measured = Recorder::new(RecorderOptions { budgets_ms, ..RecorderOptions::default() });
            RunStatus::new(&measured, facts).stages[0].process.restarts
        };
        assert_eq!(restarts(2, &[]), 2);
        assert_eq!(restarts(1, &[ReplacementOutcome::Replaced]), 0);
        assert_eq!(restarts(4, &[ReplacementOutcome::RolledBack, ReplacementOutcome::NotUsed]), 2);
    }
}
