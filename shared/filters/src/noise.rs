//! The noise of measurements, estimated from the measurements themselves.
//!
//! A motion model explains slow changes of a measured value, and noise explains fast ones. A *divided
//! difference* of M consecutive measurements z_1 … z_M at the times t_1 … t_M cancels every polynomial of
//! degree M − 2 and keeps the noise:
//!
//! ```text
//! w_i = 1 / Π_{j≠i} (t_i − t_j)      c = Σ w_i z_i / √(Σ w_i² σ_i²)
//! ```
//!
//! With independent errors of the standard deviation s σ_i, the *contrast* c has the variance s². It is also
//! the innovation of the newest measurement relative to the polynomial through the others, normalised.
//! [Gasser, Sroka, Jennen-Steinmetz: *Residual variance and residual pattern in nonlinear regression*, 1986]
//!
//! Contrasts have heavy tails: flipped headings, quantised positions, box centres that jump. A [`Scale`]
//! therefore fits Student's t distribution with ν degrees of freedom, by an online EM step for each contrast:
//!
//! ```text
//! u = (ν + 1) / (ν + c² / v)      v' = v + (u c² − v) / (n + 1)      n' = min(n + 1, n_max)
//! ```
//!
//! v is the squared scale of the t distribution, and n counts contrasts including the prior's.
//! [Lange, Little, Taylor: *Robust statistical modeling using the t distribution*, 1989; Cappé, Moulines:
//! *On-line expectation–maximization algorithm for latent data models*, 2009]

/// Degrees of freedom ν of the t distribution.
const FREEDOM: f64 = 4.0;
/// v / σ² of the fit to normal contrasts of the variance σ².
const NORMAL_SHARE: f64 = 0.690_566_806_670_877_9;

/// A variance that is learned from contrasts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// The squared scale of the t distribution.
    squared: f64,
    /// Number of contrasts that the estimate counts, including the prior's.
    count: f64,
    count_max: f64,
}

impl Scale {
    /// A prior of this standard deviation that counts as `count` contrasts. Of the learned contrasts at most
    /// `count_max` count, so older ones fade.
    #[must_use]
    pub const fn new(sigma: f64, count: f64, count_max: f64) -> Self {
        Self { squared: NORMAL_SHARE * sigma * sigma, count, count_max }
    }

    /// Learns from a contrast. A contrast that is not finite changes nothing.
    pub fn add(&mut self, contrast: f64) {
        let square = contrast * contrast;
        let weighed = (FREEDOM + 1.0) * square / (FREEDOM + square / self.squared.max(f64::MIN_POSITIVE));
        if weighed.is_finite() {
            self.squared += (weighed - self.squared) / (self.count + 1.0);
            self.count = (self.count + 1.0).min(self.count_max);
        }
    }

    /// The variance of normal contrasts that fit as well.
    #[must_use]
    pub fn variance(&self) -> f64 {
        self.squared / NORMAL_SHARE
    }

    /// Number of contrasts that the estimate counts, including the prior's.
    #[must_use]
    pub const fn count(&self) -> f64 {
        self.count
    }
}

/// A measured value of `D` components.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured<const D: usize> {
    /// Time of the measurement.
    pub time_ns: i64,
    /// The value.
    pub value: [f64; D],
    /// Nominal standard deviation of each component. Contrasts are relative to it.
    pub sigma: f64,
}

/// The newest `M` measurements of one agent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window<const D: usize, const M: usize> {
    /// Newest last; the first `len` are valid.
    measured: [Measured<D>; M],
    len: usize,
}

impl<const D: usize, const M: usize> Window<D, M> {
    /// A window without measurements.
    #[must_use]
    pub const fn new() -> Self {
        Self { measured: [Measured { time_ns: 0, value: [0.0; D], sigma: 1.0 }; M], len: 0 }
    }

    /// Time of the newest measurement.
    #[must_use]
    pub fn newest_ns(&self) -> Option<i64> {
        self.len.checked_sub(1).map(|last| self.measured[last].time_ns)
    }

    /// The newest value.
    #[must_use]
    pub fn newest(&self) -> Option<[f64; D]> {
        self.len.checked_sub(1).map(|last| self.measured[last].value)
    }

    /// Adds a measurement. Returns its contrasts if the window is full, or if three measurements lie within
    /// `short_ns`: over a longer time, three do not tell an acceleration from noise. A measurement that is not
    /// newer than the last one is ignored. After a gap of more than `gap_max_ns` the window starts again.
    pub fn add(&mut self, newest: Measured<D>, gap_max_ns: u64, short_ns: u64) -> Option<[f64; D]> {
        if let Some(last_ns) = self.newest_ns() {
            if newest.time_ns <= last_ns {
                return None;
            }
            if newest.time_ns.abs_diff(last_ns) > gap_max_ns {
                self.len = 0;
            }
        }
        if self.len == M {
            self.measured.rotate_left(1);
            self.len -= 1;
        }
        self.measured[self.len] = newest;
        self.len += 1;
        let is_short = self.len >= 3 && newest.time_ns.abs_diff(self.measured[0].time_ns) <= short_ns;
        if self.len == M || is_short { self.contrast() } else { None }
    }

    fn contrast(&self) -> Option<[f64; D]> {
        let all = &self.measured[..self.len];
        let [.., newest] = all else { return None };
        let time_s = |of: &Measured<D>| of.time_ns.saturating_sub(newest.time_ns) as f64 / 1e9;
        let (mut sum, mut square) = ([0.0; D], 0.0);
        for (i, one) in all.iter().enumerate() {
            let others = all.iter().enumerate().filter(|(j, _)| *j != i);
            let weight = 1.0 / others.map(|(_, other)| time_s(one) - time_s(other)).product::<f64>();
            square += (weight * one.sigma).powi(2);
            for ((sum, value), new) in sum.iter_mut().zip(one.value).zip(newest.value) {
                // Relative to the newest value, so that large coordinates lose no digits.
                *sum += weight * (value - new);
            }
        }
        let contrast = sum.map(|sum| sum / square.sqrt());
        contrast.iter().all(|c| c.is_finite()).then_some(contrast)
    }
}

impl<const D: usize, const M: usize> Default for Window<D, M> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at<const D: usize>(time_ms: i64, value: [f64; D]) -> Measured<D> {
        Measured { time_ns: time_ms * 1_000_000, value, sigma: 1.0 }
    }

    #[test]
    fn a_window_of_four_cancels_constant_acceleration_at_uneven_times() {
        let mut window = Window::<2, 4>::new();
        let place = |ms: i64| {
            let s = ms as f64 / 1e3;
            [3e4 + 9.0 * s + 1.5 * s * s, -2e4 - 4.0 * s * s]
        };
        let contrasts: Vec<_> = [0, 100, 230, 300, 410, 1300]
            .iter()
            .map(|&ms| window.add(at(ms, place(ms)), 1_000_000_000, 0))
            .collect();
        assert!(contrasts[..3].iter().all(Option::is_none));
        for contrast in &contrasts[3..] {
            assert!(contrast.expect("four measurements").iter().all(|c| c.abs() < 1e-6), "{contrasts:?}");
        }
    }

    #[test]
    fn a_window_starts_again_after_a_gap() {
        let mut window = Window::<1, 3>::new();
        for (ms, expected) in
            [(0, false), (100, false), (200, true), (200, false), (2000, false), (2100, false)]
        {
            assert_eq!(window.add(at(ms, [0.0]), 1_000_000_000, 0).is_some(), expected, "{ms} ms");
        }
    }

    /// The contrast of z = (0, 0, 0, 1) at even times: third difference over √20.
    #[test]
    fn contrasts_have_the_variance_of_the_noise() {
        let mut window = Window::<1, 4>::new();
        let all: Vec<_> =
            (0..4).map(|i| window.add(at(100 * i, [if i == 3 { 1.0 } else { 0.0 }]), u64::MAX, 0)).collect();
        let found = all[3].expect("four measurements")[0];
        assert!((found.abs() - 1.0 / 20.0_f64.sqrt()).abs() < 1e-9, "{found}");
    }

    #[test]
    fn a_scale_forgets_a_wide_prior_and_resists_outliers() {
        let mut scale = Scale::new(0.25, 0.1, 200.0);
        (0..8).for_each(|_| scale.add(0.005));
        assert!(scale.variance().sqrt() < 0.04, "{scale:?}");
        let mut scale = Scale::new(0.25, 0.1, 200.0);
        // Deterministic normal quantiles of σ = 0.12 in a mixed order, with one outlier of 3 m in fifty.
        for i in 0..2000_u32 {
            let share = f64::from(i * 617 % 2000 + 1) / 2001.0;
            let quantile = near_normal_quantile(share);
            scale.add(0.12 * quantile);
            if i % 50 == 0 {
                scale.add(3.0);
            }
        }
        assert!((scale.variance().sqrt() / 0.12 - 1.0).abs() < 0.15, "{}", scale.variance().sqrt());
        scale.add(f64::NAN);
        scale.add(f64::INFINITY);
        assert!(scale.variance().is_finite());
    }

    /// A quantile of nearly the standard normal distribution.
    fn near_normal_quantile(share: f64) -> f64 {
        // Φ(x) ≈ 1 / (1 + exp(−1.702 x)) has an error below 0.01, which is enough here.
        (share / (1.0 - share)).ln() / 1.702
    }
}
