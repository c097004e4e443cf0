//! The forecasts that wait for truth.

use metrics::{HighestDensity, Point};
use wire::{Forecast, HORIZON_MAX, MODES_MAX};

/// Seed of the draws that determine the border of a region.
const SEED: u64 = 1;

/// The scored data of a forecast.
#[derive(Clone, Copy, Debug)]
pub struct Scored {
    pub source_id: u64,
    pub agent_type: u32,
    pub quality: u32,
    pub position_m: Point,
    pub velocity_mps: Point,
    pub modes_len: u32,
    pub modes: [[Point; HORIZON_MAX]; MODES_MAX],
    pub best: [Point; HORIZON_MAX],
    pub probability: [f32; MODES_MAX],
    pub mode_covariance_m2: [[[f32; 3]; HORIZON_MAX]; MODES_MAX],
}

impl From<&Forecast> for Scored {
    fn from(forecast: &Forecast) -> Self {
        Self {
            source_id: forecast.source_id,
            agent_type: forecast.agent_type,
            quality: forecast.quality,
            position_m: [forecast.x_m, forecast.y_m],
            velocity_mps: [forecast.vx_mps, forecast.vy_mps],
            modes_len: forecast.modes_len,
            modes: forecast.modes,
            best: forecast.best,
            probability: forecast.probability,
            mode_covariance_m2: forecast.mode_covariance,
        }
    }
}

impl Scored {
    /// The level of the highest-density region at a step that has the position on its border.
    pub fn level(&self, step: usize, position_m: Point, levels: &mut HighestDensity) -> f64 {
        let len = (self.modes_len as usize).min(MODES_MAX);
        let means_m = self.modes.map(|mode| mode[step]);
        let covariances_m2 = self.mode_covariance_m2.map(|mode| mode[step]);
        levels.level(&means_m[..len], &covariances_m2[..len], &self.probability[..len], position_m, SEED)
    }
}

/// The forecasts of one tick.
#[derive(Clone, Debug, Default)]
pub struct Waiting {
    pub seq: u64,
    pub stamp_ns: i64,
    pub step_ns: i64,
    pub horizon_len: usize,
    pub forecasts: Vec<Scored>,
}

impl Waiting {
    pub const fn step_stamp_ns(&self, step: usize) -> i64 {
        self.stamp_ns.saturating_add(self.step_ns.saturating_mul(step as i64 + 1))
    }

    /// Stamp of the last step.
    pub const fn end_ns(&self) -> i64 {
        self.stamp_ns.saturating_add(self.step_ns.saturating_mul(self.horizon_len as i64))
    }
}

/// Rounds errors to a tenth of a millimetre.
pub fn rounded(value: Option<f64>) -> Option<f64> {
    value.map(|v| (v * 1e4).round() / 1e4)
}
