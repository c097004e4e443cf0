use serde::{Deserialize, Serialize};
use wire::Cause;

use crate::distribution::ms;
use crate::report::Shed;
use crate::tick::Tick;

/// Counts of agents that were left out to save time.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct ShedCounts {
    forecasts: u64,
    ticks: u64,
    agents_max: u64,
    age_ns_max: Option<u64>,
}

impl ShedCounts {
    /// Adds a tick.
    pub(super) fn add(&mut self, tick: &Tick) {
        let shed = tick.causes[Cause::Shed as usize];
        self.forecasts += shed;
        self.ticks += u64::from(shed > 0);
        self.agents_max = self.agents_max.max(shed);
        self.age_ns_max = self.age_ns_max.max(tick.held_age_ns[1]);
    }

    pub(super) fn report(&self, forecasts: u64) -> Shed {
        let Self { forecasts: shed, ticks, agents_max, age_ns_max } = *self;
        let share = (forecasts > 0).then(|| (shed as f64 / forecasts as f64 * 1e4).round() / 1e4);
        Shed { forecasts: shed, ticks, share, agents_max, age_ms_max: age_ns_max.map(ms) }
    }
}
