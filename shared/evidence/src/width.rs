//! The factors by which regions widen. A discounted histogram of radii gives the factor at each speed.
//! Adaptive conformal inference corrects it at all speeds of a type: every miss widens all later regions a
//! little, and every hit narrows them by a ninth of that.

use crate::fading;

/// Bins of the logarithm of the radius relative to a calibrated 90 % region's.
const BINS: usize = 64;
/// Range of the logarithm.
const RANGE: [f32; 2] = [-3.2, 3.2];
/// Radius of the region of 90 % in standard deviations: √(−2 ln 0.1).
pub const RADIUS_90: f32 = 2.145_966;
/// Probability of the calibrated region.
const LEVEL: f64 = 0.9;
/// Assumed radii of a calibrated region at the start.
const ASSUMED: f64 = 15.0;
/// Gain of the correction: its change within one horizon per excess share of misses.
const GAIN: f64 = 0.7;
/// Maximum change of the correction by a single forecast.
const STEP_MAX: f64 = 0.05;
/// Maximum correction.
const CORRECTION_MAX: f64 = 1.5;
/// Time constant of the correction's fading. Lasting effects are in the histograms.
const CORRECTION_FADING_S: f64 = 30.0;

/// Radii of matured forecasts at one step of the horizon, in one context.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Widths {
    bins: [f64; BINS],
    len: f64,
    /// Logarithm of the factor.
    log: f32,
}

/// The offset that adaptive conformal inference adds to the logarithms of the factors, at one step of the
/// horizon and all speeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Correction {
    value: f64,
    /// Forecasts that mature within one horizon.
    rate: f64,
}

impl Widths {
    /// Count of the learned numbers.
    pub(crate) const NUMBERS_LEN: usize = BINS + 2;

    /// No radius yet; regions start with `factor` times their own width.
    pub(crate) fn new(factor: f32) -> Self {
        let log = factor.max(f32::MIN_POSITIVE).ln().clamp(RANGE[0], RANGE[1]);
        Self { bins: [0.0; BINS], len: 0.0, log }.begun()
    }

    /// Distributes the assumed radii as in a two-dimensional Gaussian.
    fn begun(mut self) -> Self {
        let share = |radius: f64| 1.0 - (-0.5 * radius * radius).exp();
        for (bin, count) in self.bins.iter_mut().enumerate() {
            let edge = |bin: usize| f64::from(RADIUS_90 * (log_of(bin) - self.log).exp());
            *count = ASSUMED * (share(edge(bin + 1)) - share(edge(bin)));
        }
        self.len = self.bins.iter().sum();
        self
    }

    /// Adds a forecast: the level whose region's border contains the truth, for a region widened by `factor`
    /// without a [`Correction`].
    pub(crate) fn add(&mut self, level: f64, factor: f32, weight: f32) {
        let radius = (-2.0 * (1.0 - level).max(1e-6).ln()).sqrt() as f32;
        let log = (radius.max(1e-3) / RADIUS_90).ln() + factor.ln();
        let place = (log - RANGE[0]) / (RANGE[1] - RANGE[0]) * BINS as f32;
        self.bins[(place.max(0.0) as usize).min(BINS - 1)] += f64::from(weight);
        self.len += f64::from(weight);
        self.log = self.quantile();
    }

    /// Multiplies the evidence by this factor.
    pub(crate) fn discount(&mut self, kept: f64) {
        let kept = fading(kept, self.len);
        self.bins.iter_mut().for_each(|count| *count *= kept);
        self.len *= kept;
    }

    /// Calls `each` with all learned numbers, to read or to change them.
    pub(crate) fn numbers(&mut self, each: &mut impl FnMut(&mut f64)) {
        let Self { bins, len, log } = self;
        bins.iter_mut().chain([len]).for_each(&mut *each);
        single(log, each);
    }

    /// Logarithm of the factor.
    pub(crate) const fn log(&self) -> f32 {
        self.log
    }

    /// The logarithm below which the share [`LEVEL`] of the radii is.
    fn quantile(&self) -> f32 {
        let mut left = LEVEL * self.len;
        for (bin, &count) in self.bins.iter().enumerate() {
            if left < count {
                return log_of(bin) + (left / count) as f32 * (log_of(1) - log_of(0));
            }
            left -= count;
        }
        RANGE[1]
    }
}

impl Correction {
    /// Count of the learned numbers.
    pub(crate) const NUMBERS_LEN: usize = 2;

    /// State before any forecast.
    pub(crate) const fn new() -> Self {
        Self { value: 0.0, rate: 0.0 }
    }

    /// Adds a forecast by the level whose region's border contains the truth.
    pub(crate) fn add(&mut self, level: f64) {
        self.rate += 1.0;
        let step = (GAIN / self.rate).min(STEP_MAX);
        let missed = if level > LEVEL { 1.0 } else { 0.0 };
        let value = self.value + step * (missed - (1.0 - LEVEL));
        self.value = value.clamp(-CORRECTION_MAX, CORRECTION_MAX);
    }

    /// Fades the correction with the elapsed time, and the count of pending forecasts by a factor.
    pub(crate) fn discount(&mut self, passed_s: f64, under_way: f64) {
        self.value *= (-passed_s / CORRECTION_FADING_S).exp();
        self.rate *= under_way;
    }

    /// Calls `each` with all learned numbers, to read or to change them.
    pub(crate) fn numbers(&mut self, each: &mut impl FnMut(&mut f64)) {
        let Self { value, rate } = self;
        [value, rate].into_iter().for_each(each);
    }

    /// The offset of the logarithm of a factor.
    pub(crate) const fn log(&self) -> f32 {
        self.value as f32
    }
}

/// Calls `each` with a single-precision number. If it is read back unchanged, it is the same number.
pub(crate) fn single(number: &mut f32, each: &mut impl FnMut(&mut f64)) {
    let mut double = f64::from(*number);
    each(&mut double);
    *number = double as f32;
}

fn log_of(edge: usize) -> f32 {
    RANGE[0] + edge as f32 / BINS as f32 * (RANGE[1] - RANGE[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn assumed_radii_keep_the_factor_they_begin_with() {
        for factor in [0.3, 1.0, 2.5] {
            let widths = Widths::new(factor);
            assert!((widths.quantile() - factor.ln()).abs() < 0.05, "{factor}: {}", widths.quantile());
        }
    }

    /// The level of a truth at a radius of a Gaussian `deviation` times as wide as the forecast's, for a
    /// region widened by `factor`.
    fn level(sample: u32, deviation: f64, factor: f32) -> f64 {
        let share = (f64::from(sample) * 0.618_034).fract();
        let radius = deviation * (-2.0 * (1.0 - share).ln()).sqrt();
        1.0 - (-0.5 * (radius / f64::from(factor)).powi(2)).exp()
    }

    #[test]
    fn regions_three_times_too_narrow_widen_until_they_hold() {
        let mut widths = Widths::new(1.0);
        for sample in 0..4000 {
            let factor = widths.log().exp();
            widths.add(level(sample, 3.0, factor), factor, 1.0);
        }
        assert!((widths.log().exp() - 3.0).abs() < 0.2, "{}", widths.log().exp());
    }

    #[test]
    fn a_correction_widens_while_truths_are_missed_and_fades() {
        let mut correction = Correction::new();
        for sample in 0..4000 {
            correction.discount(0.0, 0.99);
            correction.add(level(sample, 3.0, correction.log().exp()));
        }
        assert!((correction.log().exp() - 3.0).abs() < 0.3, "{}", correction.log().exp());
        let before = correction.log();
        correction.discount(CORRECTION_FADING_S, 0.5);
        assert!((correction.log() - before * (-1.0_f32).exp()).abs() < 1e-6);
    }
}
