//! Errors and coverage of the published forecasts by type and horizon, against where the agents were tracked
//! later. A recording of a run has no truth by default, but always the later tracks.

use std::collections::{BTreeMap, VecDeque};

use metrics::HighestDensity;
use serde::Serialize;
use wire::tick_view::{AgentView, ForecastView, TickView};
use wire::{AGENT_TYPES, HORIZON_MAX, MODES_MAX};

/// Maximum number of ticks whose forecasts wait for later positions.
const WAITING_MAX: usize = 512;
/// Number of forecasts per tick and horizon whose regions are compared, in turn over the agents.
const REGIONS: usize = 2;
/// Every third step has its regions compared.
const REGION_STEPS: usize = 3;
/// Seed of the draws that determine the border of a region.
const SEED: u64 = 1;

/// Sums of one type and step.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    forecasts: u64,
    error_m: f64,
    steady_error_m: f64,
    regions: u64,
    within_50: u64,
    within_90: u64,
}

/// A row of the table: one type, all horizons.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorRow {
    #[serde(rename = "type")]
    name: &'static str,
    horizon_s: Vec<f64>,
    forecasts: Vec<u64>,
    error_m: Vec<Option<f64>>,
    constant_velocity_m: Vec<Option<f64>>,
    within_50: Vec<Option<f64>>,
    within_90: Vec<Option<f64>>,
}

/// Compares forecasts with later tracks.
#[derive(Debug)]
pub struct HorizonErrors {
    waiting: VecDeque<TickView>,
    cells: [[Cell; HORIZON_MAX]; AGENT_TYPES.len()],
    step_ns: u64,
    levels: HighestDensity,
}

impl Default for HorizonErrors {
    fn default() -> Self {
        let (waiting, cells) = (VecDeque::new(), Default::default());
        Self { waiting, cells, step_ns: 0, levels: HighestDensity::with_room(MODES_MAX) }
    }
}

impl HorizonErrors {
    pub fn add(&mut self, view: TickView) {
        self.step_ns = self.step_ns.max(view.step_ns);
        let now: BTreeMap<u64, &AgentView> =
            view.agents.iter().filter(|agent| agent.unseen_ns == 0).map(|agent| (agent.id, agent)).collect();
        let interval_ns =
            self.waiting.back().map_or(0, |last| view.stamp_ns.saturating_sub(last.stamp_ns).max(0));
        let mut waiting = std::mem::take(&mut self.waiting);
        for earlier in &waiting {
            let step_ns = i64::try_from(earlier.step_ns).unwrap_or(i64::MAX).max(1);
            let ahead_ns = view.stamp_ns.saturating_sub(earlier.stamp_ns);
            // This tick is the first one at or after the step.
            let step = ahead_ns / step_ns;
            let after_ns = ahead_ns % step_ns;
            if step >= 1 && after_ns < interval_ns.min(step_ns) {
                self.compare(earlier, step as usize - 1, after_ns as f32 / 1e9, &now);
            }
        }
        let horizon_ns = self.step_ns.saturating_mul(HORIZON_MAX as u64 + 1);
        let is_old =
            |earlier: &TickView| view.stamp_ns.saturating_sub_unsigned(horizon_ns) > earlier.stamp_ns;
        while waiting.len() >= WAITING_MAX || waiting.front().is_some_and(is_old) {
            waiting.pop_front();
        }
        waiting.push_back(view);
        self.waiting = waiting;
    }

    /// Compares a step of a tick's forecasts with the positions `after_s` later than the step.
    fn compare(&mut self, earlier: &TickView, step: usize, after_s: f32, now: &BTreeMap<u64, &AgentView>) {
        let ahead_s = (step + 1) as f32 * earlier.step_ns as f32 / 1e9;
        let len = earlier.agents.len().max(1);
        for (place, agent) in earlier.agents.iter().enumerate() {
            let (Some(forecast), Some(later)) = (&agent.forecast, now.get(&agent.id)) else { continue };
            let Some(expected) = forecast.best.get(step) else { continue };
            let position = [0, 1].map(|axis| later.position_m[axis] - later.velocity_mps[axis] * after_s);
            let steady = [0, 1].map(|axis| agent.position_m[axis] + agent.velocity_mps[axis] * ahead_s);
            let apart = |point: [f32; 2]| f64::from((point[0] - position[0]).hypot(point[1] - position[1]));
            let cell = &mut self.cells[agent.agent_type.index()][step];
            cell.forecasts += 1;
            cell.error_m += apart(*expected);
            cell.steady_error_m += apart(steady);
            let turn = (earlier.seq as usize * REGIONS + len - place % len) % len;
            if turn < REGIONS && (step + 1).is_multiple_of(REGION_STEPS) && !forecast.modes.is_empty() {
                let level = level(forecast, step, position, &mut self.levels);
                cell.regions += 1;
                cell.within_50 += u64::from(level <= 0.5);
                cell.within_90 += u64::from(level <= 0.9);
            }
        }
    }

    /// The table, one row for each type that was compared.
    pub fn rows(&self) -> Vec<ErrorRow> {
        let mean = |sum: f64, count: u64| (count > 0).then(|| (sum / count as f64 * 1e3).round() / 1e3);
        let row = |(agent_type, cells): (wire::AgentType, &[Cell; HORIZON_MAX])| {
            let cells: Vec<Cell> = cells.iter().copied().take_while(|cell| cell.forecasts > 0).collect();
            let seconds = |step: usize| ((step + 1) as f64 * self.step_ns as f64 / 1e6).round() / 1e3;
            (!cells.is_empty()).then(|| ErrorRow {
                name: agent_type.name(),
                horizon_s: (0..cells.len()).map(seconds).collect(),
                forecasts: cells.iter().map(|cell| cell.forecasts).collect(),
                error_m: cells.iter().map(|cell| mean(cell.error_m, cell.forecasts)).collect(),
                constant_velocity_m: cells
                    .iter()
                    .map(|cell| mean(cell.steady_error_m, cell.forecasts))
                    .collect(),
                within_50: cells.iter().map(|cell| mean(cell.within_50 as f64, cell.regions)).collect(),
                within_90: cells.iter().map(|cell| mean(cell.within_90 as f64, cell.regions)).collect(),
            })
        };
        AGENT_TYPES.into_iter().zip(&self.cells).filter_map(row).collect()
    }
}

/// The level of the highest-density region at a step that has the position on its border.
fn level(forecast: &ForecastView, step: usize, position_m: [f32; 2], levels: &mut HighestDensity) -> f64 {
    let means: Vec<[f32; 2]> = forecast.modes.iter().filter_map(|mode| mode.get(step).copied()).collect();
    let covariances: Vec<[f32; 3]> =
        forecast.covariance.iter().filter_map(|mode| mode.get(step).copied()).collect();
    let len = means.len().min(covariances.len()).min(forecast.probability.len());
    levels.level(&means[..len], &covariances[..len], &forecast.probability[..len], position_m, SEED)
}

#[cfg(test)]
mod tests {
    use wire::{AgentType, Cause, Quality};

    use super::*;

    /// A pedestrian at 1 m/s whose forecasts are 0.25 m too far at each step, at 10 Hz.
    fn tick(seq: u64) -> TickView {
        let x_m = seq as f32 * 0.1;
        let best: Vec<[f32; 2]> = (1..=4).map(|step| [x_m + 0.4 * step as f32, 0.25]).collect();
        let forecast = ForecastView {
            quality: Quality::Learned,
            cause: Cause::None as u32,
            age_ns: 0,
            experts: [0.0; wire::EXPERTS_MAX],
            out_of_distribution: 0.0,
            modes: vec![best.clone()],
            covariance: vec![vec![[1.0, 0.0, 1.0]; 4]],
            best,
            probability: vec![1.0],
        };
        let agent = AgentView {
            id: 3,
            source_id: 0,
            agent_type: AgentType::Pedestrian,
            position_m: [x_m, 0.0],
            velocity_mps: [1.0, 0.0],
            heading_rad: 0.0,
            length_m: None,
            width_m: None,
            unseen_ns: 0,
            history: Vec::new(),
            forecast: Some(forecast),
        };
        TickView {
            seq,
            stamp_ns: seq as i64 * 100_000_000,
            step_ns: 400_000_000,
            agents: vec![agent],
            ..TickView::default()
        }
    }

    #[test]
    fn forecasts_are_compared_with_later_tracks_by_horizon() {
        let mut errors = HorizonErrors::default();
        (0..100).for_each(|seq| errors.add(tick(seq)));
        let rows = errors.rows();
        assert_eq!(rows.len(), 1);
        assert_eq!((rows[0].name, rows[0].horizon_s.as_slice()), ("pedestrian", &[0.4, 0.8, 1.2, 1.6][..]));
        assert_eq!(rows[0].forecasts, [96, 92, 88, 84]);
        assert_eq!(rows[0].error_m, [Some(0.25); 4]);
        assert!(rows[0].constant_velocity_m.iter().all(|error| error.is_some_and(|error| error < 1e-3)));
        assert_eq!((rows[0].within_50[2], rows[0].within_90[2]), (Some(1.0), Some(1.0)), "0.25 σ");
        assert_eq!(rows[0].within_50[0], None);
    }
}
