//! Statistics over a set of samples.

use metrics::{Errors, Interval};

use super::{Method, Sample};
use crate::table::{Entry, pair, ratio_of_clusters};

/// Bounds of the speed bands, m/s.
const BANDS_MPS: [f32; 4] = [3.0, 8.0, 15.0, 25.0];
pub(crate) const BAND_NAMES: [&str; 5] = ["0-3", "3-8", "8-15", "15-25", "> 25"];

/// The index of a sample's speed band.
pub(crate) fn band_of(sample: &Sample) -> usize {
    BANDS_MPS.iter().filter(|&&bound| sample.speed_mps >= bound).count()
}

/// A set of samples that are evaluated together.
pub(crate) struct Cell<'a> {
    pub(crate) samples: &'a [&'a Sample],
}

impl Cell<'_> {
    pub(crate) fn mean(&self, of: impl Fn(&Sample) -> f64) -> f64 {
        let values = self.samples.iter().map(|sample| of(sample)).filter(|value| value.is_finite());
        let (sum, len) = values.fold((0.0, 0_u32), |(sum, len), value| (sum + value, len + 1));
        sum / f64::from(len)
    }

    pub(crate) fn share(&self, of: impl Fn(&Sample) -> bool) -> f64 {
        self.mean(|sample| f64::from(u8::from(of(sample))))
    }

    pub(crate) fn errors(&self, method: Method) -> Errors {
        let of = |sample: &Sample| sample.errors[method as usize];
        Errors { ade_m: self.mean(|sample| of(sample).ade_m), fde_m: self.mean(|sample| of(sample).fde_m) }
    }

    pub(crate) fn pair(&self, method: Method) -> Option<Entry> {
        Some(self.errors(method)).filter(|errors| !errors.ade_m.is_nan()).map(pair)
    }

    pub(crate) fn held(&self, level: f64, step: usize) -> f64 {
        self.share(|sample| sample.is_held(level, step))
    }

    /// Share of truths inside the region of this level at a step, with its interval.
    pub(crate) fn held_with_interval(&self, level: f64, step: usize) -> Option<Interval> {
        self.ratio_of(|sample| [f64::from(u8::from(sample.is_held(level, step))), 1.0])
    }

    /// Ratio of the mean errors of two methods, of ADE or of FDE.
    pub(crate) fn ratio(&self, ours: Method, theirs: Method, of: fn(&Errors) -> f64) -> Option<Interval> {
        self.ratio_of(|sample| [ours, theirs].map(|method| of(&sample.errors[method as usize])))
    }

    /// Ratio of the means of two quantities. The interval resamples agents.
    fn ratio_of(&self, of: impl Fn(&Sample) -> [f64; 2]) -> Option<Interval> {
        ratio_of_clusters(self.samples.iter().map(|sample| (sample.agent, of(sample))))
    }

    /// Ratio of the published forecast's ADE to the ADE of the best kinematic expert.
    pub(crate) fn regret(&self) -> f64 {
        let experts = [Method::ConstantVelocity, Method::DecayingTurn, Method::DecayingAcceleration];
        let least = experts.map(|method| self.errors(method).ade_m).into_iter().fold(f64::INFINITY, f64::min);
        self.errors(Method::Best).ade_m / least
    }
}

#[cfg(test)]
mod tests {
    use scene::AgentType;

    use crate::driving::sample::{LEVEL, STEPS};

    use super::*;

    #[test]
    fn agents_are_resampled_and_not_their_forecasts() {
        let of = |agent: u64, is_held: bool| {
            let levels = [if is_held { 0.5 } else { 0.95 }; STEPS.len()];
            Sample { agent, levels, ..Sample::of(AgentType::Vehicle, 10.0) }
        };
        // Four agents with a hundred forecasts each: all held for one agent, half for two, none for the last.
        let held = |agent: u64, number: u64| agent == 0 || (agent < 3 && number.is_multiple_of(2));
        let samples: Vec<Sample> =
            (0..400).map(|number| of(number / 100, held(number / 100, number))).collect();
        let samples: Vec<&Sample> = samples.iter().collect();
        let cell = Cell { samples: &samples };
        let found = cell.held_with_interval(LEVEL, 0).expect("samples");
        assert!((found.mean - 0.5).abs() < 1e-9 && (cell.held(LEVEL, 0) - 0.5).abs() < 1e-9, "{found:?}");
        assert!(found.low < 0.3 && found.high > 0.7, "{found:?}");
    }
}
