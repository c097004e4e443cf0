//! Errors of the published forecasts against the recording's later truth.
//!
//! Forecasts wait until the truth has passed their horizon. If a forecast's detections carried an identity,
//! it is matched with the truth of the same identity. Otherwise it is matched with the nearest truth of the
//! same type at its stamp, at most 2 m away. The truth at step k is interpolated linearly at stamp + (k + 1)
//! Δt.
//!
//! A forecast is scored if the truth covers *all* steps of its horizon. Otherwise an agent that leaves the
//! scene early would contribute only the easy first steps. Such forecasts are counted as uncovered.

mod agents;
mod forecast;
mod truth;

use std::collections::{BTreeMap, VecDeque};

use metrics::{Displacement, DisplacementMean, HighestDensity, Point, displacement, min_displacement};
use serde::{Deserialize, Serialize};
use wire::{AGENT_TYPES, AgentType, Forecast, HORIZON_MAX, Header, MODES_MAX, Quality, Rejected, Truth};

use crate::report::{Accuracy, Errors};
use agents::Agents;
use forecast::{Scored, Waiting, rounded};
use truth::{GAP_MAX_NS, Paths};

/// Largest distance between a forecast and the truth with which it is matched, if identities are missing.
const MATCH_RADIUS_M: f32 = 2.0;
/// Largest lag between the truth of a tick and its forecasts, in either direction.
const LAG_MAX_NS: i64 = 2_000_000_000;
/// Largest number of ticks whose forecasts wait for truth. If there are more, the oldest are scored as they
/// are.
const WAITING_MAX: usize = 256;

/// Levels of the regions whose coverage the report contains.
const LEVELS: [f64; 2] = [0.5, 0.9];
/// Largest number of forecasts per tick whose regions are scored, spread evenly over the agents.
const REGIONS_MAX: usize = 8;

/// Scores forecasts against later truth. Its memory is bounded, even if truth is missing.
#[derive(Clone, Debug)]
pub struct Scorer {
    paths: Paths,
    waiting: VecDeque<Waiting>,
    /// Empty buffers of ticks that were scored.
    spare: Vec<Vec<Scored>>,
    tally: Tally,
    levels: HighestDensity,
    /// Number and stamp of the newest truth.
    newest: Option<(u64, i64)>,
}

impl Default for Scorer {
    fn default() -> Self {
        let (paths, waiting, spare, tally) = Default::default();
        Self { paths, waiting, spare, tally, levels: HighestDensity::with_room(MODES_MAX), newest: None }
    }
}

impl Scorer {
    /// Adds the truth at the frame's stamp, and scores the forecasts whose horizon has passed.
    ///
    /// # Errors
    /// [`Rejected`] if a number is impossible or the frame is not newer than the last; nothing changes then.
    pub fn truth(&mut self, header: &Header, truths: &[Truth]) -> Result<(), Rejected> {
        if self.newest.is_some_and(|newest| header.begins_session_after(newest)) {
            self.end_session();
            self.paths = Paths::default();
        }
        self.paths.add(header.stamp_ns, truths)?;
        self.newest = Some((header.seq, header.stamp_ns));
        // The truth at the end of the horizon is interpolated, and the next sample may arrive a whole gap
        // later.
        while self
            .waiting
            .front()
            .is_some_and(|tick| tick.end_ns().saturating_add(GAP_MAX_NS) <= header.stamp_ns)
        {
            self.score_oldest();
        }
        let oldest_ns = self.waiting.front().map_or(i64::MAX, |tick| tick.stamp_ns);
        self.paths.forget_before(oldest_ns.min(header.stamp_ns.saturating_sub(LAG_MAX_NS)));
        Ok(())
    }

    /// Keeps the forecasts of a tick until their horizon has passed.
    pub fn forecasts(&mut self, header: &Header, forecasts: &[Forecast]) {
        let horizon_len = (header.counts.horizon_len as usize).min(HORIZON_MAX);
        let step_ns = i64::try_from(header.step_ns).unwrap_or(i64::MAX);
        if forecasts.is_empty() || horizon_len == 0 || step_ns == 0 {
            return;
        }
        let mut kept = self.spare.pop().unwrap_or_default();
        kept.extend(forecasts.iter().map(Scored::from));
        let (seq, stamp_ns) = (header.seq, header.stamp_ns);
        let tick = Waiting { seq, stamp_ns, step_ns, horizon_len, forecasts: kept };
        // If there is no truth, a tick is dropped once the truth of its whole horizon is overdue.
        let due =
            |oldest: &Waiting| oldest.end_ns().saturating_add(GAP_MAX_NS + LAG_MAX_NS) < header.stamp_ns;
        while self.waiting.len() >= WAITING_MAX || self.waiting.front().is_some_and(due) {
            self.score_oldest();
        }
        self.waiting.push_back(tick);
    }

    /// Scores all forecasts that wait as they are, because no truth follows.
    pub fn end_session(&mut self) {
        while !self.waiting.is_empty() {
            self.score_oldest();
        }
    }

    fn score_oldest(&mut self) {
        if let Some(mut tick) = self.waiting.pop_front() {
            self.tally.score(&tick, &self.paths, &mut self.levels);
            tick.forecasts.clear();
            self.spare.push(tick.forecasts);
        }
    }

    /// The errors so far, including the waiting forecasts whose horizon the truth already covers. All values
    /// are `None` if there is no truth.
    #[must_use]
    pub fn accuracy(&self) -> Accuracy {
        let Some(newest_ns) = self.paths.newest_ns() else {
            return Accuracy::default();
        };
        let mut tally = self.tally.clone();
        let (covered, open): (Vec<_>, Vec<_>) =
            self.waiting.iter().partition(|tick| tick.end_ns() <= newest_ns);
        let mut levels = self.levels.clone();
        covered.iter().for_each(|tick| tally.score(tick, &self.paths, &mut levels));
        tally.uncovered_len += open.iter().map(|tick| tick.forecasts.len() as u64).sum::<u64>();
        tally.accuracy()
    }

    pub(crate) fn checkpoint(&self) -> ScorerCheckpoint {
        let mut tally = self.tally.clone();
        tally.uncovered_len += self.waiting.iter().map(|tick| tick.forecasts.len() as u64).sum::<u64>();
        ScorerCheckpoint(tally)
    }

    /// Number of forecasts that wait for truth.
    #[cfg(test)]
    fn waiting_count(&self) -> usize {
        self.waiting.len()
    }
}

/// The sums of a [`Scorer`], with the forecasts that wait for truth counted as uncovered.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct ScorerCheckpoint(Tally);

impl From<ScorerCheckpoint> for Scorer {
    fn from(ScorerCheckpoint(tally): ScorerCheckpoint) -> Self {
        Self { tally, ..Self::default() }
    }
}

/// Sums of the errors of one group of forecasts.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Group {
    best_mode: DisplacementMean,
    single: DisplacementMean,
    constant_velocity: DisplacementMean,
    /// Number of regions of each of [`LEVELS`] that contained the truth, and number of scored regions.
    held: ([u64; LEVELS.len()], u64),
}

impl Group {
    fn add(&mut self, [best_mode, single, constant_velocity]: [Displacement; 3]) {
        self.best_mode.add(best_mode);
        self.single.add(single);
        self.constant_velocity.add(constant_velocity);
    }

    fn add_level(&mut self, level: f64) {
        let (held, len) = &mut self.held;
        held.iter_mut().zip(LEVELS).for_each(|(held, of)| *held += u64::from(level <= of));
        *len += 1;
    }

    fn errors(&self) -> Errors {
        let (held, len) = self.held;
        let held = held.map(|held| (len > 0).then(|| held as f64 / len as f64));
        Errors {
            forecasts: self.best_mode.ade_m.len(),
            ade_m: rounded(self.best_mode.ade_m.value()),
            fde_m: rounded(self.best_mode.fde_m.value()),
            miss_rate: rounded(self.best_mode.miss_rate.value()),
            single_ade_m: rounded(self.single.ade_m.value()),
            single_fde_m: rounded(self.single.fde_m.value()),
            single_miss_rate: rounded(self.single.miss_rate.value()),
            cv_ade_m: rounded(self.constant_velocity.ade_m.value()),
            cv_fde_m: rounded(self.constant_velocity.fde_m.value()),
            cv_miss_rate: rounded(self.constant_velocity.miss_rate.value()),
            held_50: rounded(held[0]),
            held_90: rounded(held[1]),
        }
    }
}

/// Sums of the errors so far.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Tally {
    all: Group,
    learned: Group,
    by_type: [Group; AGENT_TYPES.len()],
    agents: Agents,
    draws: u32,
    horizon_ns: i64,
    uncovered_len: u64,
    unmatched_len: u64,
}

impl Tally {
    fn score(&mut self, tick: &Waiting, paths: &Paths, levels: &mut HighestDensity) {
        let stride = tick.forecasts.len().div_ceil(REGIONS_MAX).max(1);
        for (number, forecast) in tick.forecasts.iter().enumerate() {
            let Some(id) = agent_of(forecast, tick.stamp_ns, paths) else {
                self.unmatched_len += 1;
                continue;
            };
            let mut truth = [None; HORIZON_MAX];
            let truth = &mut truth[..tick.horizon_len];
            for (step, position) in truth.iter_mut().enumerate() {
                *position = paths.at(id, tick.step_stamp_ns(step));
            }
            if truth.contains(&None) {
                self.uncovered_len += 1;
                continue;
            }
            self.add(tick, (id, forecast), truth);
            // A different place in each tick, so that every agent is scored from time to time.
            let turn = (tick.stamp_ns / tick.step_ns.max(1)).unsigned_abs() as usize;
            if let Some(Some(end_m)) = truth.last().filter(|_| (number + turn).is_multiple_of(stride)) {
                let level = forecast.level(tick.horizon_len - 1, *end_m, levels);
                self.groups(forecast).for_each(|group| group.add_level(level));
            }
        }
    }

    fn add(&mut self, tick: &Waiting, (id, forecast): (u64, &Scored), truth: &[Option<Point>]) {
        let modes_len = (forecast.modes_len as usize).min(MODES_MAX);
        let displacements = [
            min_displacement(&forecast.modes[..modes_len], truth),
            displacement(&forecast.best, truth),
            displacement(&constant_velocity(forecast, tick.step_ns), truth),
        ];
        self.groups(forecast).for_each(|group| group.add(displacements));
        self.agents.add(id, tick, forecast, displacements[0]);
        self.draws = self.draws.max(forecast.modes_len);
        self.horizon_ns = self.horizon_ns.max(tick.end_ns() - tick.stamp_ns);
    }

    /// The groups to which a forecast belongs.
    fn groups(&mut self, forecast: &Scored) -> impl Iterator<Item = &mut Group> {
        let is_learned = forecast.quality == Quality::Learned as u32;
        let learned = is_learned.then_some(&mut self.learned);
        let by_type = AgentType::try_from(forecast.agent_type);
        let by_type = by_type.ok().map(|agent_type| &mut self.by_type[agent_type.index()]);
        std::iter::once(&mut self.all).chain(learned).chain(by_type)
    }

    fn accuracy(&self) -> Accuracy {
        let is_scored = !self.all.best_mode.ade_m.is_empty();
        let by_type: BTreeMap<String, Errors> = AGENT_TYPES
            .iter()
            .map(|agent_type| (agent_type.name().to_owned(), self.by_type[agent_type.index()].errors()))
            .filter(|(_, errors)| errors.forecasts > 0)
            .collect();
        Accuracy {
            errors: self.all.errors(),
            draws: is_scored.then_some(self.draws),
            horizon_s: is_scored.then_some(self.horizon_ns as f64 / 1e9),
            miss_radius_m: metrics::MISS_RADIUS_M,
            learned: self.learned.errors(),
            by_type,
            agents: self.agents.errors(),
            agents_unlisted: self.agents.unlisted(),
            uncovered: self.uncovered_len,
            unmatched: self.unmatched_len,
        }
    }
}

fn agent_of(forecast: &Scored, stamp_ns: i64, paths: &Paths) -> Option<u64> {
    if forecast.source_id != 0 {
        return Some(forecast.source_id).filter(|&id| paths.knows(id));
    }
    paths.nearest(forecast.agent_type, forecast.position_m, stamp_ns, MATCH_RADIUS_M)
}

/// The baseline: the agent keeps the velocity at the start of its forecast.
fn constant_velocity(forecast: &Scored, step_ns: i64) -> [Point; HORIZON_MAX] {
    std::array::from_fn(|step| {
        let t_s = ((step as i64 + 1) * step_ns) as f64 / 1e9;
        let along = |axis: usize| {
            let (start_m, v_mps) = (forecast.position_m[axis], forecast.velocity_mps[axis]);
            (f64::from(start_m) + f64::from(v_mps) * t_s) as f32
        };
        [along(0), along(1)]
    })
}

#[cfg(test)]
mod tests;
