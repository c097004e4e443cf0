//! Impossible measurements. A *misfit* is a detection that an agent of this type cannot have reached since
//! its last detection.
//!
//! A single misfit is a missed detection. Several misfits that agree are a new state. Two misfits that move
//! like the track show that the localisation jumped. Three misfits that move like an agent of their type show
//! that an identity was handed on.

use wire::{AgentType, Detection};

use crate::observation::Found;

/// Weight of a new residual in the mean of the residuals that the covariance does not explain.
const RESIDUAL_WEIGHT: f64 = 0.1;
/// Number of measurements after which the prediction is good enough to judge by.
pub(super) const SETTLED: u8 = 3;

/// The gate's data about an agent.
#[derive(Clone, Copy, Debug)]
pub struct Gate {
    /// Own time of the last measurement.
    pub(super) measured_ns: i64,
    /// Mean square of the residuals beyond the covariance.
    pub(super) residual_m2: f64,
    /// Number of measurements so far, up to [`SETTLED`].
    pub(super) measured: u8,
    /// The newest consecutive misfits, oldest first.
    pub(super) misfits: [Option<Misfit>; 2],
}

/// A measurement that the agent cannot have reached.
#[derive(Clone, Copy, Debug)]
pub(super) struct Misfit {
    pub(super) detection: Detection,
    pub(super) agent_type: AgentType,
    pub(super) own_ns: i64,
}

impl Misfit {
    pub(super) const fn new(found: &Found<'_>) -> Self {
        Self { detection: *found.detection, agent_type: found.agent_type, own_ns: found.own_ns }
    }

    pub(super) const fn found(&self) -> Found<'_> {
        Found { detection: &self.detection, agent_type: self.agent_type, own_ns: self.own_ns }
    }
}

/// The relation between a detection and the prediction of its track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It is a measurement.
    Fits,
    /// It may be a measurement, but another agent's is more likely.
    Strange,
    /// The agent cannot have reached it.
    Misfit,
}

impl Gate {
    pub const fn new(own_ns: i64) -> Self {
        Self { measured_ns: own_ns, residual_m2: 0.0, measured: 1, misfits: [None; 2] }
    }

    /// Adds a measurement with this distance beyond the covariance.
    pub fn add(&mut self, own_ns: i64, beyond_m: f64) {
        if self.measured >= SETTLED {
            self.residual_m2 += RESIDUAL_WEIGHT * (beyond_m * beyond_m - self.residual_m2);
        }
        self.measured = (self.measured + 1).min(SETTLED);
        self.measured_ns = self.measured_ns.max(own_ns);
        self.misfits = [None; 2];
    }

    pub(super) fn since_measured_s(&self, own_ns: i64) -> f64 {
        own_ns.saturating_sub(self.measured_ns).max(0) as f64 / 1e9
    }
}
