//! Measures the cost of killing and stopping each stage: one run with many deaths per stage, and one row per
//! kind of death.

use std::collections::BTreeSet;
use std::fmt::Display;
use std::fmt::Write as _;
use std::path::Path;

use console::failure::Failure;
use console::tables;
use ports::Point;
use recorder::Outage;
use serde::Serialize;
use wire::StageId;

use crate::effect::Random;
use crate::runner;
use crate::spec::Spec;
use crate::verdict::{Observation, longest_run};

/// Ticks before the first death, in which agents become old enough to be forecast.
const LEAD_TICKS: u64 = 25;
/// Ticks between deaths: twice the allowed time until forecasts are learned again, plus a random pause.
const SPACE_TICKS: u64 = 20;
const SPACE_RANDOM_TICKS: u64 = 5;
/// A death may first show in a tick that was already in flight.
const EARLY_TICKS: u64 = 3;
/// Durations of a stop: below and above the time until a stopped stage is detected.
const STOPS_MS: [u64; 3] = [200, 1_000, 5_000];

/// The columns of the table.
pub const COLUMNS: [&str; 10] = [
    "stage",
    "fault",
    "times:",
    "longest hole, ticks:",
    "ticks to learned again, median:",
    "at most:",
    "detections lost:",
    "unexplained:",
    "others restarted:",
    "left:",
];

/// The faults of one run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Series {
    /// The stage kills itself, at each point of its step in turn.
    Kills,
    /// The stage is stopped, for each duration in turn.
    Stops,
}

/// One run of the measurement.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    pub stage: StageId,
    /// The series of faults.
    pub series: Series,
    /// Number of faults of each kind.
    pub turns: u64,
    /// Seed of the scene and of the fault times.
    pub seed: u64,
    /// Agents of the scene.
    pub agents: u64,
}

/// The cost of one kind of fault on a stage.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Row {
    pub stage: String,
    pub fault: String,
    /// Number of faults.
    pub times: u64,
    /// Longest gap in the output, in ticks.
    pub hole: u64,
    /// Ticks until forecasts were learned again, for each fault; `None` if they never were.
    pub to_learned: Vec<Option<u64>>,
    /// Ticks whose detections did not become tracks.
    pub detections_lost: u64,
    /// Unexplained findings of the checker in the whole run.
    pub unexplained: u64,
    /// Restarts of other stages in the whole run.
    pub others_restarted: u64,
    /// Files left by the whole run.
    pub left: u64,
}

/// A fault of the series: its tick and its row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Moment {
    tick: u64,
    kind: usize,
}

impl Plan {
    /// Returns the kinds of faults, one per row.
    fn kinds(&self) -> Vec<String> {
        match self.series {
            // The recorder sends nothing.
            Series::Kills if self.stage == StageId::Recorder => vec![Point::Idle.name().to_owned()],
            Series::Kills => Point::ALL.map(|point| point.name().to_owned()).into(),
            Series::Stops => STOPS_MS.map(|ms| format!("{} s", ms as f64 / 1e3)).into(),
        }
    }

    /// Returns the times of all faults.
    fn moments(&self) -> Vec<Moment> {
        let kind_count = self.kinds().len();
        let place = |place: u64| {
            let random = Random::new(self.seed, place).below(SPACE_RANDOM_TICKS);
            let tick = LEAD_TICKS + place * (SPACE_TICKS + SPACE_RANDOM_TICKS) + random;
            Moment { tick, kind: place as usize % kind_count }
        };
        (0..self.turns * kind_count as u64).map(place).collect()
    }

    /// The specification of the run.
    fn spec(&self) -> Result<Spec, Failure> {
        let (stage, moments) = (self.stage.name(), self.moments());
        let ticks = moments.last().map_or(0, |last| last.tick) + 2 * SPACE_TICKS;
        let Self { agents, seed, .. } = self;
        let mut text = format!(
            "shows = \"what faults on the {stage} cost\"\n[run]\nticks = {ticks}\nagents = {agents}\nseed = {seed}\n\
             stages = {{ {stage} = {{ restarts_max = 1000, backoff_ms = 0 }} }}\n"
        );
        for (place, kind) in self.kinds().iter().enumerate() {
            let of_kind = moments.iter().filter(|moment| moment.kind == place);
            let at: Vec<u64> = of_kind.map(|moment| moment.tick).collect();
            let what = match self.series {
                Series::Kills => format!("kind = \"kill\"\npoint = \"{kind}\""),
                Series::Stops => format!("kind = \"stop\"\nfor_ms = {}", STOPS_MS[place]),
            };
            let _ = write!(text, "[[fault]]\n{what}\nstage = \"{stage}\"\nat = {at:?}\n");
        }
        let name = match self.series {
            Series::Kills => format!("table-kill-{stage}.toml"),
            Series::Stops => format!("table-stop-{stage}.toml"),
        };
        Ok(Spec::parse(Path::new(&name), &text)?)
    }

    /// Computes the rows from the observation of the run.
    fn rows(&self, spec: &Spec, seen: &Observation) -> Vec<Row> {
        let (moments, cost) = (self.moments(), seen.cost(spec));
        let outages: Vec<&Outage> =
            seen.report.iter().flat_map(|report| &report.supervision.outages).collect();
        let others = |outage: &&&Outage| outage.stage != self.stage.name();
        let verb = if self.series == Series::Kills { "killed" } else { "stopped for" };
        let row = |kind: &String| Row {
            stage: self.stage.name().to_owned(),
            fault: format!("{verb} {kind}").replace("killed ", "killed, "),
            unexplained: cost.unexplained,
            others_restarted: outages.iter().filter(others).count() as u64,
            left: seen.leftovers,
            ..Row::default()
        };
        let mut rows: Vec<Row> = self.kinds().iter().map(row).collect();
        let (missing, degraded, predicted) = (seen.missing(spec), seen.degraded(), seen.predicted());
        for (place, moment) in moments.iter().enumerate() {
            let begin = moment.tick - EARLY_TICKS;
            let end = moments.get(place + 1).map_or(spec.run.ticks, |next| next.tick - EARLY_TICKS);
            let within = |ticks: &BTreeSet<u64>| ticks.range(begin..end).copied().collect::<Vec<u64>>();
            let lost = within(&missing);
            let of_it = outages.iter().find(|outage| !others(outage) && (begin..end).contains(&outage.tick));
            let row = &mut rows[moment.kind];
            row.times += 1;
            row.hole = row.hole.max(longest_run(&lost));
            row.detections_lost += (lost.len() + within(&predicted).len()) as u64;
            row.to_learned.push(match of_it {
                Some(outage) => outage.ticks_to_learned,
                // The process continued before its stop was detected.
                None => {
                    Some(within(&degraded).last().map_or(0, |last| (last + 1).saturating_sub(moment.tick)))
                }
            });
        }
        rows
    }
}

/// Runs a plan.
///
/// # Errors
/// [`Failure`] if the run can't be started.
pub fn measure(plan: &Plan) -> Result<Vec<Row>, Failure> {
    let spec = plan.spec()?;
    let folder = runner::temporary_folder(&format!("stgdat-fault-{}-", spec.name))?;
    let seen = runner::observe(&spec, &folder)?;
    if seen.exit != 0 {
        let message = format!("a run ended with exit code {}: see {}", seen.exit, folder.display());
        return Err(Failure::Failed(message));
    }
    let _ = std::fs::remove_dir_all(&folder);
    Ok(plan.rows(&spec, &seen))
}

/// The load averages of the machine over 1, 5 and 15 minutes.
pub fn load_average() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split_whitespace().next().unwrap_or("unknown").to_owned()
}

impl Row {
    /// The row as a line of the table.
    pub fn line(&self) -> String {
        let mut learned: Vec<u64> = self.to_learned.iter().copied().flatten().collect();
        learned.sort_unstable();
        let is_always = learned.len() == self.to_learned.len();
        let median = learned.get(learned.len() / 2).map_or_else(|| "–".to_owned(), u64::to_string);
        let most = learned.last().filter(|_| is_always).map_or_else(|| "never".to_owned(), u64::to_string);
        let Self { stage, fault, times, hole, detections_lost, unexplained, others_restarted, left, .. } =
            self;
        let cells: [&dyn Display; 10] =
            [stage, fault, times, hole, &median, &most, detections_lost, unexplained, others_restarted, left];
        tables::row(cells)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checker::{ForecastSeen, Line, Output};
    use recorder::{Report, Supervision};

    fn plan(stage: StageId, series: Series) -> Plan {
        Plan { stage, series, turns: 2, seed: 3, agents: 8 }
    }

    #[test]
    fn each_stage_is_killed_at_each_of_its_points_and_stopped_for_each_time() {
        let kinds = |stage, series| plan(stage, series).spec().unwrap().faults.count;
        assert_eq!(kinds(StageId::Encoder, Series::Kills), 5);
        assert_eq!(kinds(StageId::Recorder, Series::Kills), 1);
        assert_eq!(kinds(StageId::Recorder, Series::Stops), 3);
        let moments = plan(StageId::Encoder, Series::Kills).moments();
        assert_eq!(moments.len(), 10);
        assert!(moments.is_sorted_by(|a, b| a.tick + SPACE_TICKS <= b.tick));
    }

    #[test]
    fn what_was_seen_counts_for_the_fault_before_it() {
        let plan = plan(StageId::Sampler, Series::Stops);
        let (spec, moments) = (plan.spec().unwrap(), plan.moments());
        let lost = moments[1].tick + 1..moments[1].tick + 3;
        let outage = |moment: &Moment| Outage {
            stage: "sampler".into(),
            tick: moment.tick,
            ticks_to_learned: Some(4),
            ..Outage::default()
        };
        let output = |tick| {
            let forecast = ForecastSeen { quality: "learned".into(), ..ForecastSeen::default() };
            Line::Forecasts(Output {
                tick,
                stamp_ns: tick as i64,
                forecasts: vec![forecast],
                ..Output::default()
            })
        };
        let outages = moments[1..].iter().map(outage).collect();
        let supervision = Supervision { outages, ..Supervision::default() };
        let seen = Observation {
            lines: (0..spec.run.ticks).filter(|tick| !lost.contains(tick)).map(output).collect(),
            report: Some(Report { supervision, ..Report::default() }),
            ..Observation::default()
        };
        let rows = plan.rows(&spec, &seen.concluded(&spec));
        assert_eq!(rows.iter().map(|row| row.hole).collect::<Vec<_>>(), [0, 2, 0]);
        assert_eq!(rows[0].to_learned, [Some(0), Some(4)], "the first one was not found");
        assert_eq!(rows[1].line(), "| sampler | stopped for 1 s | 2 | 2 | 4 | 4 | 2 | 0 | 0 | 0 |\n");
    }
}
