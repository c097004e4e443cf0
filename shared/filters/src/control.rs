use nalgebra::Matrix2;
use thiserror::Error;

use crate::{Gaussian, Process};

/// Largest number of hypotheses in one forecast.
pub const HYPOTHESES_MAX: usize = 32;

/// The Gaussian u = μ + L ε of a control over one step of a forecast.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ControlStep {
    /// Mean μ after saturation. For a [`crate::Bicycle`] it is acceleration in m/s² and slip rate in rad/s.
    /// For a [`crate::ConstantVelocity`] it is the displacement in m along and across the agent, relative to
    /// the displacement by the velocity at the forecast's stamp.
    pub mean: [f64; 2],
    /// Lower Cholesky factor L as \[l11, l21, l22\].
    pub cholesky: [f64; 3],
}

impl ControlStep {
    fn is_finite(&self) -> bool {
        self.mean.iter().chain(&self.cholesky).all(|x| x.is_finite())
    }

    /// The covariance L Lᵀ.
    pub fn covariance(&self) -> Matrix2<f64> {
        let [l11, l21, l22] = self.cholesky;
        let factor = Matrix2::new(l11, 0.0, l21, l22);
        factor * factor.transpose()
    }
}

/// Gain of a forecast's control, within \[0, 1\]. `variance` is the variance of the estimate from which the
/// control was inferred.
///
/// ```text
/// g = S² / (S² + σ²)      one half at the standard deviation S = half_gain_sigma
/// ```
///
/// The network treats its history as exact. Much of what it infers from a noisy history undoes motion that
/// never happened. The gain is the share of a control's variance that is not due to the noise of the history.
#[must_use]
#[inline]
pub fn control_gain(half_gain_sigma: f64, variance: f64) -> f64 {
    half_gain_sigma.powi(2) / (half_gain_sigma.powi(2) + variance.max(0.0))
}

/// Share of the process noise (standard deviations) that remains at this gain of a control: 1 at gain 0 and
/// `noise_share` at gain 1.
#[must_use]
#[inline]
pub fn noise_left(control_gain: f64, noise_share: f64) -> f64 {
    (1.0 - control_gain * (1.0 - noise_share.powi(2))).max(0.0).sqrt()
}

/// The control input of a process over a stretch of time, in addition to its noise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Control {
    /// Constant rates: (a, β̇) of a bicycle, acceleration (x, y) of a constant velocity.
    pub rate: [f64; 2],
    /// Covariance per second (11, 21, 22) of the control's noise. It acts on (v, β) of a bicycle and on the
    /// position of a constant velocity. If a state contains the rates, it is the covariance of the rates.
    pub density: [f64; 3],
}

impl Control {
    /// A control of these rates and this covariance per second.
    #[must_use]
    pub fn new(rate: [f64; 2], density: &Matrix2<f64>) -> Self {
        Self { rate, density: [density[(0, 0)], density[(1, 0)], density[(1, 1)]] }
    }
}

/// A process with a control input.
pub trait Controlled<const N: usize>: Process<N> + Copy {
    /// Like [`Process::step`], under a control.
    #[must_use]
    fn step_controlled(&self, state: &Gaussian<N>, control: &Control, dt_s: f64) -> Gaussian<N>;

    /// The process for controls of these gains, component by component. Gain 1 gives this process and gain 0
    /// gives `uncontrolled`.
    ///
    /// By default every gain gives this process. The gain is then that of a whole forecast, for which the
    /// [`Priors`](crate::Priors) were made.
    #[must_use]
    fn blended(&self, _uncontrolled: &Self, _control_gain: [f64; 2]) -> Self {
        *self
    }

    /// The control input with this `number` in a forecast. `steps` belong to one hypothesis, last `step_s`
    /// each, and have axes along `heading_rad`.
    #[must_use]
    fn control(steps: &[ControlStep], number: usize, step_s: f64, heading_rad: f64) -> Control;

    /// Duration of the first control input. The others last one step each.
    #[must_use]
    fn first_ns(step_ns: u64) -> u64;
}

/// A forecast of one agent: equally long sequences of controls, one per hypothesis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Forecast<'a> {
    /// Time since the state from which the forecast starts.
    pub age_ns: u64,
    /// Duration of a step.
    pub step_ns: u64,
    /// Heading of the agent at the forecast's start.
    pub heading_rad: f64,
    /// Probability of each hypothesis, up to a common factor. There are at most [`HYPOTHESES_MAX`].
    pub probability: &'a [f64],
    /// The steps of the first hypothesis, then the steps of the next.
    pub controls: &'a [ControlStep],
}

/// Why a forecast cannot be a prior.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum ForecastFault {
    /// There is no control, there are too many hypotheses, or the sequences differ in length.
    #[error("{control_count} controls of {hypothesis_count} hypotheses")]
    Shape {
        /// Number of hypotheses.
        hypothesis_count: usize,
        /// Number of controls.
        control_count: usize,
    },
    /// A probability is negative or not finite, or all are 0.
    #[error("hypotheses of probability {0}")]
    Probability(f64),
    /// A control, or the heading, is not finite.
    #[error("a control of hypothesis {hypothesis} is not finite")]
    NotFinite {
        /// Number of the hypothesis.
        hypothesis: usize,
    },
    /// The age exceeds the forecast's horizon.
    #[error("forecast of {horizon_ns} ns is {age_ns} ns old")]
    Over {
        /// Age.
        age_ns: u64,
        /// Duration of the forecast.
        horizon_ns: u64,
    },
}

impl Forecast<'_> {
    /// Number of steps of each hypothesis.
    pub fn step_count(&self) -> usize {
        self.controls.len() / self.probability.len().max(1)
    }

    /// Duration of the forecast.
    pub fn horizon_ns(&self) -> u64 {
        self.step_ns.saturating_mul(self.step_count() as u64)
    }

    pub(crate) fn check(&self) -> Result<(), ForecastFault> {
        let (hypothesis_count, control_count) = (self.probability.len(), self.controls.len());
        let fits = (1..=HYPOTHESES_MAX).contains(&hypothesis_count)
            && self.step_count() > 0
            && control_count.is_multiple_of(hypothesis_count);
        if !fits {
            return Err(ForecastFault::Shape { hypothesis_count, control_count });
        }
        let wrong = self.probability.iter().find(|p| !(p.is_finite() && **p >= 0.0));
        let sum: f64 = self.probability.iter().sum();
        if wrong.is_some() || !(sum.is_finite() && sum > 0.0) {
            return Err(ForecastFault::Probability(*wrong.unwrap_or(&sum)));
        }
        let broken = self.controls.iter().position(|step| !step.is_finite());
        if let Some(at) = broken.or_else(|| (!self.heading_rad.is_finite()).then_some(0)) {
            return Err(ForecastFault::NotFinite { hypothesis: at / self.step_count() });
        }
        let (age_ns, horizon_ns) = (self.age_ns, self.horizon_ns());
        if age_ns >= horizon_ns { Err(ForecastFault::Over { age_ns, horizon_ns }) } else { Ok(()) }
    }
}
