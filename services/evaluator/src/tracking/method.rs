//! The methods that are compared, and what of each is tuned.

use filters::{
    Bicycle, ConstantAcceleration, ConstantTurnRate, ConstantVelocity, Integrator, Kind, Models, Priors,
    Unknown,
};

/// What nobody has observed of a vehicle.
pub(crate) const UNKNOWN: Unknown =
    Unknown { speed_mps: 10.0, acceleration_mps2: 2.0, turn_rate_radps: 0.3, slip_rad: 0.05 };

/// A way to estimate motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum TrackingMethod {
    /// Constant velocity, Kalman filter.
    ConstantVelocity,
    /// Constant acceleration, Kalman filter.
    ConstantAcceleration,
    /// Constant turn rate and velocity, extended Kalman filter.
    ConstantTurnRate,
    /// Kinematic bicycle, extended Kalman filter.
    Bicycle,
    /// The bicycle steered by the model's forecasts, a mixture of extended Kalman filters.
    Learned,
}

/// The two numbers of a method that are tuned; what they are is the method's own.
pub(crate) type Setting = [f64; 2];

/// Middle of a length that is not known, m, and the rear axle's share of it.
const LENGTH_M: f32 = 4.5;
/// See [`LENGTH_M`].
const REAR_AXLE_RATIO: f32 = 0.26;
/// Largest slip of the bicycle.
const SLIP_MAX_RAD: f64 = 0.5;
/// Variances added to the bicycle in 80 ms whatever its noise.
const FLOOR: [f64; 5] = [1e-6, 1e-6, 1e-6, 0.0, 0.0];

impl TrackingMethod {
    /// All methods, in the order of the tables.
    pub const ALL: [Self; 5] = [
        Self::ConstantVelocity,
        Self::ConstantAcceleration,
        Self::ConstantTurnRate,
        Self::Bicycle,
        Self::Learned,
    ];

    /// The name in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::ConstantVelocity => "constant velocity",
            Self::ConstantAcceleration => "constant acceleration",
            Self::ConstantTurnRate => "constant turn rate",
            Self::Bicycle => "bicycle",
            Self::Learned => "learned, linearised",
        }
    }

    /// Whether forecasts of the model take part.
    pub(crate) const fn is_learned(self) -> bool {
        matches!(self, Self::Learned)
    }

    /// What the two numbers of its setting are.
    pub(crate) const fn told(self) -> [&'static str; 2] {
        match self {
            Self::ConstantVelocity => ["acceleration density, m²/s³", ""],
            Self::ConstantAcceleration => ["jerk density, m²/s⁵", ""],
            Self::ConstantTurnRate => ["root of the acceleration density", "of the yaw acceleration density"],
            Self::Bicycle => ["acceleration, m/s²", "slip rate, rad/s"],
            Self::Learned => ["factor on control covariances", "share of the bicycle's noise"],
        }
    }

    /// Where tuning begins.
    pub(crate) const fn first_setting(self) -> Setting {
        match self {
            Self::ConstantVelocity => [1.0, 1.0],
            Self::ConstantAcceleration => [1.0, 1.0],
            Self::ConstantTurnRate => [2.0, 0.5],
            Self::Bicycle => [2.0, 0.2],
            Self::Learned => [0.5, 0.3],
        }
    }

    /// The process of a state that has one, where the model's is the bicycle.
    pub(crate) const fn kind(self) -> Kind {
        match self {
            Self::ConstantVelocity => Kind::ConstantVelocity,
            Self::ConstantAcceleration => Kind::ConstantAcceleration,
            Self::ConstantTurnRate => Kind::ConstantTurnRate,
            Self::Bicycle | Self::Learned => Kind::Bicycle,
        }
    }
}

/// Settings of all methods, by their order in [`TrackingMethod::ALL`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Settings([Setting; TrackingMethod::ALL.len()]);

impl Settings {
    /// Where tuning begins.
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
        let [density, _] = self.of(TrackingMethod::ConstantVelocity);
        let [jerk_density, _] = self.of(TrackingMethod::ConstantAcceleration);
        let [acceleration, yaw_acceleration] = self.of(TrackingMethod::ConstantTurnRate);
        Models {
            constant_velocity: ConstantVelocity { density },
            constant_acceleration: ConstantAcceleration { density: jerk_density },
            constant_turn_rate: ConstantTurnRate {
                acceleration_density: acceleration.powi(2),
                yaw_density: yaw_acceleration.powi(2),
            },
            bicycle: bicycle(self.of(TrackingMethod::Bicycle), length_m),
        }
    }

    /// The processes of the learned prior.
    pub(crate) fn priors(&self, length_m: Option<f32>) -> Priors<Bicycle> {
        let [covariance_scale, share] = self.of(TrackingMethod::Learned);
        let noise = self.of(TrackingMethod::Bicycle);
        let [kinematic, learned] =
            [noise, noise.map(|sigma| share * sigma)].map(|noise| bicycle(noise, length_m));
        Priors { covariance_scale, ..Priors::new(kinematic, learned) }
    }
}

fn bicycle([acceleration_mps2, slip_rate_radps]: Setting, length_m: Option<f32>) -> Bicycle {
    Bicycle {
        rear_axle_m: f64::from(REAR_AXLE_RATIO * length_m.unwrap_or(LENGTH_M)),
        integrator: Integrator::Midpoint,
        acceleration_mps2,
        slip_rate_radps,
        floor: FLOOR,
        slip_max_rad: SLIP_MAX_RAD,
    }
}
