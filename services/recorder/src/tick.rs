//! The figures of one tick, from the header and the elements of its forecasts.
//!
//! Each figure of a tick is counted here once, and the [`Recorder`](crate::Recorder) holds the sums.
//! Everything else is a view of them: the report, the live table, `top`, the metrics, traces, `tick`, the
//! outages and the causes of a flight recorder.

use wire::vocabulary::LOOKS;
use wire::{Cause, Forecast, Header, Quality, flags};

use crate::passage::{Passage, Timeline};
use crate::report::OutOfDistribution;

/// Maximum time from release to forecast at 12.5 Hz.
pub const TICK_LIMIT_NS: u64 = wire::TICK_NS;
/// Out-of-distribution measure above which the network adds less than half of its normal residual.
const OUTSIDE: f32 = 0.25;

/// Time from release to forecast above which a tick is late: the tick's interval, but at most
/// [`TICK_LIMIT_NS`].
#[must_use]
pub const fn limit_ns(interval_ns: u64) -> u64 {
    if interval_ns > 0 && interval_ns < TICK_LIMIT_NS { interval_ns } else { TICK_LIMIT_NS }
}

/// Whether a held or kinematic forecast with this cause is a fault. It is not a fault if the track is young
/// or if constant velocity proved better.
pub(crate) const fn is_fault(cause: Cause) -> bool {
    matches!(cause, Cause::None) || !LOOKS[cause as usize].is_normal
}

/// The figures of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tick {
    /// The tick's number.
    pub seq: u64,
    /// The header's [`flags`].
    pub flags: u32,
    /// The passage of the tick through the stages.
    pub passage: Passage,
    /// Time from release to forecast above which the tick is late.
    pub limit_ns: u64,
    /// Number of forecasts.
    pub agents: u64,
    /// Forecasts by quality.
    pub qualities: [u64; Quality::ALL.len()],
    /// Held and kinematic forecasts by cause.
    pub causes: [u64; Cause::ALL.len()],
    /// Track states by the prior that predicted them.
    pub priors: [u64; Quality::ALL.len()],
    /// Forecasts of agents whose motion is out of the training distribution.
    pub out_of_distribution: OutOfDistribution,
    /// Maximum age of a forecast.
    pub age_ns: u64,
    /// Maximum age of a held forecast, and of a forecast that is republished for a shed agent.
    pub held_age_ns: [Option<u64>; 2],
    /// Whether a forecast is held or kinematic because of a fault.
    pub is_degraded: bool,
    /// Whether at least one forecast is served. Also true without forecasts.
    pub is_served: bool,
}

impl Tick {
    /// Counts the tick of a header. `timeline` has seen all earlier ticks.
    #[must_use]
    pub fn new(timeline: &mut Timeline, header: &Header, forecasts: &[Forecast]) -> Self {
        let mut tick = Self {
            seq: header.seq,
            flags: header.flags,
            passage: timeline.pass(header),
            limit_ns: limit_ns(header.interval_ns),
            agents: forecasts.len() as u64,
            qualities: [0; Quality::ALL.len()],
            causes: [0; Cause::ALL.len()],
            priors: [0; Quality::ALL.len()],
            out_of_distribution: OutOfDistribution::default(),
            age_ns: 0,
            held_age_ns: [None; 2],
            is_degraded: false,
            is_served: forecasts.is_empty(),
        };
        forecasts.iter().for_each(|forecast| tick.add(forecast));
        tick
    }

    /// Counts the tick of a header without earlier ticks. No stage then appears busy, so no frame counts as
    /// waiting.
    #[must_use]
    pub fn alone(header: &Header, forecasts: &[Forecast]) -> Self {
        Self::new(&mut Timeline::default(), header, forecasts)
    }

    fn add(&mut self, forecast: &Forecast) {
        let count = |counts: &mut [u64], number: u32| {
            if let Some(count) = counts.get_mut(number as usize) {
                *count += 1;
            }
        };
        count(&mut self.qualities, forecast.quality);
        count(&mut self.priors, forecast.prior);
        self.age_ns = self.age_ns.max(forecast.age_ns);
        self.is_served |= forecast.is_served();
        if forecast.out_of_distribution >= OUTSIDE {
            let speed_mps = forecast.vx_mps.hypot(forecast.vy_mps);
            self.out_of_distribution.merge(&OutOfDistribution {
                forecasts: 1,
                measure_max: Some(rounded(forecast.out_of_distribution)),
                speed_mps_max: Some(rounded(speed_mps)),
            });
        }
        if forecast.quality == Quality::Learned as u32 {
            return;
        }
        count(&mut self.causes, forecast.cause);
        self.is_degraded |= Cause::from_number(forecast.cause).is_none_or(is_fault);
        if forecast.quality == Quality::Held as u32 {
            let [held, shed] = &mut self.held_age_ns;
            *held = (*held).max(Some(forecast.age_ns));
            if forecast.cause == Cause::Shed as u32 {
                *shed = (*shed).max(Some(forecast.age_ns));
            }
        }
    }

    /// Whether all flags of a mask are set.
    #[must_use]
    pub const fn has(&self, mask: u32) -> bool {
        self.flags & mask == mask
    }

    /// Whether the tick took longer than its limit.
    #[must_use]
    pub fn is_over_limit(&self) -> bool {
        self.passage.end_to_end_ns.is_some_and(|time_ns| time_ns > self.limit_ns)
    }

    /// Whether the tick's forecasts were late. Lockstep has no deadline.
    #[must_use]
    pub fn is_late(&self) -> bool {
        self.is_over_limit() && !self.has(flags::LOCKSTEP)
    }

    /// Number of forecasts that are held or kinematic because of a fault, by cause.
    pub fn faults(&self) -> impl Iterator<Item = (Cause, u64)> {
        Cause::ALL.into_iter().zip(self.causes).filter(|(cause, count)| is_fault(*cause) && *count > 0)
    }

    /// Number of forecasts that are held or kinematic because of a fault, and their most frequent cause.
    #[must_use]
    pub fn not_learned(&self) -> (u64, Option<Cause>) {
        let most = self.faults().max_by_key(|(_, count)| *count).map(|(cause, _)| cause);
        (self.faults().map(|(_, count)| count).sum(), most)
    }

    /// The tick's worst fault, in words.
    #[must_use]
    pub fn fault(&self) -> Option<String> {
        let Self { seq, agents, .. } = self;
        if self.is_late() {
            let took_ms = self.passage.end_to_end_ns.unwrap_or(0) as f64 / 1e6;
            return Some(format!("tick {seq} was late: {took_ms:.1} ms"));
        }
        if self.has(flags::VOID) {
            return Some(format!("tick {seq} has no forecasts"));
        }
        let (not_learned, cause) = self.not_learned();
        let cause = cause.map_or("unknown", Cause::name);
        self.is_degraded.then(|| {
            format!("tick {seq} is degraded: {not_learned} of {agents} forecasts not learned ({cause})")
        })
    }
}

/// A value with two decimals.
fn rounded(value: f32) -> f64 {
    (f64::from(value) * 1e2).round() / 1e2
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use wire::{Hop, StageId};

    use super::*;

    fn forecast(quality: Quality, cause: Cause) -> Forecast {
        Forecast { quality: quality as u32, cause: cause as u32, ..Forecast::zeroed() }
    }

    #[test]
    fn late_and_degraded_ticks_are_faults_and_young_agents_are_not() {
        const S: u64 = 1_000_000_000;
        let fault = |header: &Header, forecasts: &[Forecast]| Tick::alone(header, forecasts).fault();
        let mut header = Header { released_ns: S, interval_ns: S / 10, ..Header::new(1, 7, 0) };
        let young = [forecast(Quality::Learned, Cause::None), forecast(Quality::Kinematic, Cause::Young)];
        assert_eq!(fault(&header, &young), None);
        let held = [young[0], forecast(Quality::Held, Cause::Late)];
        let degraded = "tick 7 is degraded: 1 of 2 forecasts not learned (late)";
        assert_eq!(fault(&header, &held).as_deref(), Some(degraded));
        header.push_hop(Hop { stage: StageId::Sampler.number(), sent_ns: 2 * S, ..Hop::default() });
        assert_eq!(fault(&header, &young).as_deref(), Some("tick 7 was late: 1000.0 ms"));
        header.flags |= flags::LOCKSTEP;
        assert_eq!(fault(&header, &young), None, "in lockstep nothing is late");
        header.flags |= flags::VOID;
        assert_eq!(fault(&header, &young).as_deref(), Some("tick 7 has no forecasts"));
    }

    #[test]
    fn a_tick_counts_its_forecasts_by_quality_cause_and_age() {
        let aged = |cause, age_ns| Forecast { age_ns, ..forecast(Quality::Held, cause) };
        let outside = Forecast { out_of_distribution: 0.5, vx_mps: 3.0, vy_mps: 4.0, ..Forecast::zeroed() };
        let forecasts =
            [aged(Cause::Late, 5), aged(Cause::Shed, 3), aged(Cause::Shed, 2), outside, Forecast::zeroed()];
        let tick = Tick::alone(&Header::new(1, 7, 0), &forecasts);
        assert_eq!((tick.agents, tick.qualities), (5, [2, 3, 0]));
        assert_eq!((tick.causes[Cause::Shed as usize], tick.not_learned()), (2, (3, Some(Cause::Shed))));
        assert_eq!((tick.age_ns, tick.held_age_ns), (5, [Some(5), Some(3)]));
        let OutOfDistribution { forecasts, measure_max, speed_mps_max } = tick.out_of_distribution;
        assert_eq!((forecasts, measure_max, speed_mps_max), (1, Some(0.5), Some(5.0)));
        assert!(tick.is_degraded);
    }
}
