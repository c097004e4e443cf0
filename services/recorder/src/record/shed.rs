use serde::{Deserialize, Serialize};
use wire::{Cause, Forecast, Quality};

use crate::distribution::ms;
use crate::report::Shed;

/// Counts of agents that were left out to save time.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct ShedCounts {
    forecasts: u64,
    ticks: u64,
    agents_max: u64,
    age_ns_max: Option<u64>,
}

impl ShedCounts {
    /// Adds the forecasts of a tick.
    pub(super) fn add(&mut self, forecasts: &[Forecast]) {
        let shed = forecasts.iter().filter(|forecast| is_shed(forecast));
        let len = shed.clone().count() as u64;
        let ages_ns = shed.filter(|f| f.quality == Quality::Held as u32).map(|f| f.age_ns);
        self.forecasts += len;
        self.ticks += u64::from(len > 0);
        self.agents_max = self.agents_max.max(len);
        self.age_ns_max = self.age_ns_max.max(ages_ns.max());
    }

    pub(super) fn report(&self, forecasts: u64) -> Shed {
        let Self { forecasts: shed, ticks, agents_max, age_ns_max } = *self;
        let share = (forecasts > 0).then(|| (shed as f64 / forecasts as f64 * 1e4).round() / 1e4);
        Shed { forecasts: shed, ticks, share, agents_max, age_ms_max: age_ns_max.map(ms) }
    }
}

/// Whether the agent was left out of its tick to save time.
pub(crate) const fn is_shed(forecast: &Forecast) -> bool {
    forecast.quality != Quality::Learned as u32 && forecast.cause == Cause::Shed as u32
}
