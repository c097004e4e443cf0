use wire::{AgentType, SPEED_MAX_MPS, StageId};

use crate::Run;

/// Highest speed of each type of agent: nothing faster is tracked or forecast.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedLimits {
    /// Vehicles.
    pub vehicle_mps: f64,
    /// Cyclists.
    pub cyclist_mps: f64,
    /// Pedestrians.
    pub pedestrian_mps: f64,
}

impl Default for SpeedLimits {
    fn default() -> Self {
        Self::USUAL
    }
}

impl SpeedLimits {
    /// The limits without options.
    pub const USUAL: Self = Self { vehicle_mps: 70.0, cyclist_mps: 25.0, pedestrian_mps: 12.0 };

    /// The limits of a run's tracker, for the stages after it. These are the defaults if the tracker is
    /// another program.
    #[must_use]
    pub fn of_run(run: &Run) -> Self {
        let tracker = run.stage(StageId::Tracker).map(|stage| stage.options.parse::<toml::Table>());
        let Some(Ok(options)) = tracker else { return Self::default() };
        let limit = |key: &str, usual: f64| {
            let value =
                options.get(key).and_then(|value| value.as_float().or(value.as_integer().map(|n| n as f64)));
            value.filter(|mps| *mps > 0.0 && *mps <= f64::from(SPEED_MAX_MPS)).unwrap_or(usual)
        };
        let usual = Self::default();
        Self {
            vehicle_mps: limit("vehicle_speed_max_mps", usual.vehicle_mps),
            cyclist_mps: limit("cyclist_speed_max_mps", usual.cyclist_mps),
            pedestrian_mps: limit("pedestrian_speed_max_mps", usual.pedestrian_mps),
        }
    }

    /// The limit of a type.
    #[must_use]
    pub const fn of(&self, agent_type: AgentType) -> f64 {
        match agent_type {
            AgentType::Vehicle => self.vehicle_mps,
            AgentType::Cyclist => self.cyclist_mps,
            AgentType::Pedestrian => self.pedestrian_mps,
        }
    }
}
