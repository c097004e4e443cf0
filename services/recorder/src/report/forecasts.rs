//! Counts of agents and their forecasts.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Number of agents forecast per tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Agents {
    /// Mean over all ticks.
    pub mean: Option<f64>,
    /// Maximum over all ticks.
    pub max: Option<u64>,
}

/// Numbers of single forecasts by quality.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ForecastCounts {
    /// Number of forecasts by the model at the same tick.
    pub learned: u64,
    /// Number of forecasts by the model at an earlier tick, shifted in time.
    pub held: u64,
    /// Number of forecasts with constant control.
    pub kinematic: u64,
    /// Numbers of held or kinematic forecasts by cause: `late`, `rejected`, `missing`, `shed`, or `young` and
    /// `outdone`, which are not faults.
    pub causes: BTreeMap<String, u64>,
    /// Number of held or kinematic forecasts because of a fault: for a cause other than `young` and
    /// `outdone`.
    #[serde(default)]
    pub not_learned: u64,
    /// Share of the forecasts that are constant velocity because it proved better.
    #[serde(default)]
    pub constant_velocity_share: Option<f64>,
    /// Number of ticks with a forecast that is not learned because of a fault.
    pub degraded_ticks: u64,
    /// Number of ticks with predicted tracks. Their detections are missing.
    #[serde(default)]
    pub predicted_ticks: u64,
    /// Number of agents without any forecast according to the degradation policy, summed over ticks.
    #[serde(default)]
    pub silent: u64,
    /// Maximum age of a held forecast.
    pub age_ms_max: Option<f64>,
    /// Forecasts that were shed because ticks had no time for all agents.
    #[serde(default)]
    pub shed: Shed,
}

/// Agents that were left out of ticks without enough time for all agents.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Shed {
    /// Number of agents left out, summed over ticks.
    pub forecasts: u64,
    /// Number of ticks that left out any agent.
    pub ticks: u64,
    /// Share of all forecasts.
    pub share: Option<f64>,
    /// Largest number of agents that a tick left out.
    pub agents_max: u64,
    /// Maximum age of a forecast that replaces one that was left out.
    pub age_ms_max: Option<f64>,
}

impl ForecastCounts {
    /// The counts with the names of their qualities.
    #[must_use]
    pub const fn by_quality(&self) -> [(&'static str, u64); 3] {
        [("learned", self.learned), ("held", self.held), ("kinematic", self.kinematic)]
    }
}

/// Forecasts whose out-of-distribution measure is so large that the network adds less than half of its normal
/// residual.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OutOfDistribution {
    /// Number of out-of-distribution forecasts.
    pub forecasts: u64,
    /// The highest measure.
    pub measure_max: Option<f64>,
    /// The highest speed among them.
    pub speed_mps_max: Option<f64>,
}

/// Track states by the prior that predicted them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PriorCounts {
    /// Number of states predicted by a forecast of an earlier tick, at most a step old.
    pub learned: u64,
    /// Number of states predicted by an older forecast.
    pub held: u64,
    /// Number of states predicted by the kinematic prior: the process model alone.
    pub kinematic: u64,
}

impl OutOfDistribution {
    /// Adds the figures of a tick.
    pub(crate) fn merge(&mut self, other: &Self) {
        let most = |a: Option<f64>, b: Option<f64>| a.map_or(b, |a| Some(b.map_or(a, |b| a.max(b))));
        self.forecasts += other.forecasts;
        self.measure_max = most(self.measure_max, other.measure_max);
        self.speed_mps_max = most(self.speed_mps_max, other.speed_mps_max);
    }
}
