//! The compared methods and their tuned settings.

use filters::{
    Bicycle, ConstantAcceleration, ConstantTurnRate, ConstantVelocity, Gaussian, Integrator, Models, Priors,
    Unknown, control_gain,
};

use super::SingerBicycle;

/// Prior standard deviations of a vehicle's unmeasured components.
pub(crate) const UNKNOWN: Unknown = Unknown { speed_mps: 10.0, slip_rad: 0.05 };
/// The same of an acceleration per axis, and of a turn rate.
pub(crate) const ACCELERATION_MPS2: f64 = 2.0;
pub(crate) const TURN_RATE_RADPS: f64 = 0.3;

wire::named! {
    /// A method that estimates motion.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub(crate) enum TrackingMethod {
        /// Constant velocity, Kalman filter.
        ConstantVelocity => "constant velocity",
        /// Constant acceleration, Kalman filter.
        ConstantAcceleration => "constant acceleration",
        /// Constant turn rate and velocity, extended Kalman filter.
        ConstantTurnRate => "constant turn rate",
        /// Kinematic bicycle, extended Kalman filter.
        Bicycle => "bicycle",
        /// Bicycle whose acceleration and slip rate decay (Singer), extended Kalman filter.
        SingerBicycle => "Singer bicycle",
        /// The same, but acceleration and slip rate decay towards the controls of the model's forecasts: a
        /// mixture of extended Kalman filters.
        Learned => "learned, linearised",
        /// The same, and the forecasts use a retrieval memory that begins with earlier recordings.
        WarmStarted => "learned, warm-started retrieval",
        /// The processes of [`TrackingMethod::Learned`] by Monte Carlo: particles with the mixture's settings.
        LearnedParticles => "learned, Monte Carlo",
        /// Constant acceleration that also uses later measurements: not a filter, but a bound for filters
        /// (oracle).
        Smoother => "smoother bound (oracle)",
    }
}

/// The tuned numbers of a method. Each method defines their meaning and how many it uses.
pub(crate) type Setting = [f64; 3];

/// Length of a vehicle of unknown length, m.
const LENGTH_M: f32 = 4.5;
/// Distance from the reference point to the rear axle, as a share of the length.
const REAR_AXLE_RATIO: f32 = 0.26;
/// Maximum slip of the bicycle.
const SLIP_MAX_RAD: f64 = 0.5;
/// Standard deviations of speed, m/s, and heading, rad, at which the gain of a control is one half, as in the
/// pipeline's tracker.
const HALF_GAIN_SIGMA: [f64; 2] = [0.7, 0.02];
/// Time constant with which a forecast's controls fade in.
const FADE_IN_S: f64 = 1.0;
/// Variances added to the bicycle per 80 ms in addition to its noise.
const FLOOR: [f64; 5] = [1e-6, 1e-6, 1e-6, 0.0, 0.0];

impl TrackingMethod {
    /// The methods to evaluate. Particles take several times as long as all other methods together.
    pub(crate) fn evaluated(particles: bool) -> Vec<Self> {
        Self::ALL.into_iter().filter(|&method| particles || method != Self::LearnedParticles).collect()
    }

    /// Whether the method uses forecasts of the model.
    pub(crate) const fn is_learned(self) -> bool {
        matches!(self, Self::Learned | Self::WarmStarted | Self::LearnedParticles)
    }

    /// Whether the method uses neither forecasts nor later measurements.
    pub(crate) const fn is_kinematic(self) -> bool {
        !self.is_learned() && !matches!(self, Self::Smoother)
    }

    /// The method with the same settings as this one.
    pub(crate) const fn tuned_as(self) -> Self {
        match self {
            Self::LearnedParticles => Self::Learned,
            Self::Smoother => Self::ConstantAcceleration,
            own => own,
        }
    }

    /// Whether forecasts use the retrieval memory.
    pub(crate) const fn retrieves(self) -> bool {
        matches!(self, Self::WarmStarted)
    }

    /// The tuned numbers by name, each with the value with which tuning begins.
    pub(crate) const fn tuned(self) -> &'static [(&'static str, f64)] {
        match self {
            Self::ConstantVelocity => &[("acceleration density, m²/s³", 1.0)],
            Self::ConstantAcceleration => &[("jerk density, m²/s⁵", 1.0)],
            Self::ConstantTurnRate => {
                &[("root of the acceleration density", 2.0), ("of the yaw acceleration density", 0.5)]
            }
            Self::Bicycle => &[("acceleration, m/s²", 2.0), ("slip rate, rad/s", 0.2)],
            Self::SingerBicycle => {
                &[("acceleration, m/s²", 1.0), ("slip rate, rad/s", 0.05), ("decay, s", 2.0)]
            }
            Self::Learned | Self::WarmStarted => &[
                ("share of the Singer bicycle's driving noise", 1.0),
                ("decay at first, s", 1.5),
                ("decay once steered, s", 0.8),
            ],
            Self::LearnedParticles | Self::Smoother => &[],
        }
    }

    /// The setting with which tuning begins.
    pub(crate) fn first_setting(self) -> Setting {
        let mut setting = [1.0; 3];
        setting.iter_mut().zip(self.tuned()).for_each(|(value, (_, first))| *value = *first);
        setting
    }
}

/// Settings of all methods, by their order in [`TrackingMethod::ALL`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Settings([Setting; TrackingMethod::ALL.len()]);

impl Settings {
    /// The settings with which tuning begins.
    pub(crate) fn first() -> Self {
        Self(TrackingMethod::ALL.map(TrackingMethod::first_setting))
    }

    pub(crate) fn of(&self, method: TrackingMethod) -> Setting {
        self.0[method as usize]
    }

    pub(crate) fn with(mut self, method: TrackingMethod, setting: Setting) -> Self {
        self.0[method as usize] = setting;
        self
    }

    /// The process models of a vehicle.
    pub(crate) fn models(&self, length_m: Option<f32>) -> Models {
        let [density, ..] = self.of(TrackingMethod::ConstantVelocity);
        let [acceleration_mps2, slip_rate_radps, _] = self.of(TrackingMethod::Bicycle);
        Models {
            constant_velocity: ConstantVelocity { density },
            bicycle: bicycle(acceleration_mps2, slip_rate_radps, length_m),
        }
    }

    pub(crate) fn acceleration(&self) -> ConstantAcceleration {
        let [density, ..] = self.of(TrackingMethod::ConstantAcceleration);
        ConstantAcceleration { density }
    }

    pub(crate) fn turn_rate(&self) -> ConstantTurnRate {
        let [acceleration, yaw_acceleration, _] = self.of(TrackingMethod::ConstantTurnRate);
        ConstantTurnRate { acceleration_density: acceleration.powi(2), yaw_density: yaw_acceleration.powi(2) }
    }

    /// The processes of a Singer bicycle with and without forecasts, at these gains of the controls.
    ///
    /// With a forecast, acceleration and slip rate decay towards the forecast's means. The time constant
    /// changes once the controls have faded in. Both are driven by a share of the Singer bicycle's white
    /// noise, in standard deviations. The density σ² / τ of this noise determines how fast a manoeuvre may
    /// change, whatever the decay. The spread among the modes represents the uncertainty of the controls, and
    /// the noise represents the rest.
    pub(crate) fn priors(
        &self,
        method: TrackingMethod,
        length_m: Option<f32>,
        control_gain: [f64; 2],
    ) -> Priors<SingerBicycle> {
        let mixture = if method.is_learned() { method.tuned_as() } else { TrackingMethod::Learned };
        let [noise_share, first_decay_s, steered_decay_s] = self.of(mixture);
        let [acceleration_mps2, slip_rate_radps, decay_s] = self.of(TrackingMethod::SingerBicycle);
        let driven = |share: f64, to_decay_s: f64| {
            let of_sigma = share * (to_decay_s / decay_s).sqrt();
            SingerBicycle {
                bicycle: bicycle(0.0, 0.0, length_m),
                acceleration_mps2: of_sigma * acceleration_mps2,
                slip_rate_radps: of_sigma * slip_rate_radps,
                decay_s: [to_decay_s; 2],
            }
        };
        Priors {
            uncontrolled: driven(noise_share, first_decay_s),
            covariance_scale: 0.0,
            control_gain,
            fade_in_s: FADE_IN_S,
            ..Priors::new(driven(1.0, decay_s), driven(noise_share, steered_decay_s))
        }
    }
}

/// Gains of a forecast's acceleration and slip rate, given the uncertainty of speed and heading.
pub(crate) fn control_gains(state: &Gaussian<7>) -> [f64; 2] {
    let gain = |component: usize, sigma: f64| control_gain(sigma, state.covariance[(component, component)]);
    [gain(3, HALF_GAIN_SIGMA[0]), gain(2, HALF_GAIN_SIGMA[1])]
}

fn bicycle(acceleration_mps2: f64, slip_rate_radps: f64, length_m: Option<f32>) -> Bicycle {
    Bicycle {
        rear_axle_m: f64::from(REAR_AXLE_RATIO * length_m.unwrap_or(LENGTH_M)),
        integrator: Integrator::Midpoint,
        acceleration_mps2,
        slip_rate_radps,
        slip_decay_per_s: 0.0,
        floor: FLOOR,
        slip_max_rad: SLIP_MAX_RAD,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// With a noise share of 1 and the Singer bicycle's own decay at first.
    #[test]
    fn without_controls_the_learned_prior_is_the_singer_bicycle() {
        let [acceleration_mps2, slip_rate_radps, decay_s] = [0.7, 0.03, 1.6];
        let settings = Settings::first()
            .with(TrackingMethod::SingerBicycle, [acceleration_mps2, slip_rate_radps, decay_s])
            .with(TrackingMethod::Learned, [1.0, decay_s, 0.5]);
        let priors = settings.priors(TrackingMethod::Learned, Some(4.0), [0.0; 2]);
        assert_eq!(priors.uncontrolled, priors.kinematic);
        assert_eq!(priors.kinematic.decay_s, [decay_s; 2]);
        // With controls the acceleration decays faster; the process noise is unchanged.
        let ratio = priors.learned.acceleration_mps2 / acceleration_mps2;
        assert!((ratio.powi(2) - 0.5 / decay_s).abs() < 1e-12 && priors.learned.decay_s == [0.5; 2]);
    }
}
