use kinematics::hypot;
use nalgebra::{Matrix4x5, Matrix5, Matrix5x4, Vector4, Vector5};

use crate::{Bicycle, ConstantVelocity, Evidence, FilterFault, Gaussian, Motion, Observation};

/// A process model by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// [`ConstantVelocity`]
    ConstantVelocity,
    /// [`Bicycle`]
    Bicycle,
}

/// The process models of one agent, one per [`Kind`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Models {
    /// \[x, y, vx, vy\]
    pub constant_velocity: ConstantVelocity,
    /// \[x, y, ψ, v, β\]
    pub bicycle: Bicycle,
}

/// Spectral density of the acceleration of a steady motion, m²/s³, and its deviations of acceleration and slip
/// rate over 80 ms.
const STEADY_DENSITY: f64 = 0.01;
const STEADY_ACCELERATION_MPS2: f64 = 0.35;
const STEADY_SLIP_RATE_RADPS: f64 = 0.01;

impl Models {
    /// The models of a steady motion.
    #[must_use]
    pub fn steady(&self) -> Self {
        let Self { constant_velocity, bicycle } = *self;
        Self {
            constant_velocity: ConstantVelocity { density: STEADY_DENSITY.min(constant_velocity.density) },
            bicycle: Bicycle {
                acceleration_mps2: STEADY_ACCELERATION_MPS2.min(bicycle.acceleration_mps2),
                slip_rate_radps: STEADY_SLIP_RATE_RADPS.min(bicycle.slip_rate_radps),
                floor: bicycle.floor.map(|variance| 0.01 * variance),
                ..bicycle
            },
        }
    }
}

/// Standard deviations about 0 of the quantities that the first observation does not measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unknown {
    /// Standard deviation of the speed, and of the velocity per axis.
    pub speed_mps: f64,
    /// Standard deviation of the slip angle.
    pub slip_rad: f64,
}

/// The filter of one agent: its state, by the kind of its process model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Filter {
    /// \[x, y, vx, vy\]
    ConstantVelocity(Gaussian<4>),
    /// \[x, y, ψ, v, β\]
    Bicycle(Gaussian<5>),
}

impl Filter {
    /// The state after a first observation.
    ///
    /// If the kind's state has a heading but none was observed, the filter starts as
    /// [`Kind::ConstantVelocity`]. Linearising about an unknown heading is worse than having no heading.
    /// [`Filter::into_kind`] converts the filter once the motion shows a heading.
    #[must_use]
    pub fn start(kind: Kind, observation: &Observation, unknown: &Unknown) -> Self {
        let ([x, y], var) = (observation.position_m, observation.position_variance);
        let unknown_speed = unknown.speed_mps.powi(2);
        if let (Kind::Bicycle, Some((heading, var_h))) = (kind, observation.heading_rad) {
            let (speed, var_v) = observation.speed_mps.unwrap_or((0.0, unknown_speed));
            let variance = [var, var, var_h, var_v, unknown.slip_rad.powi(2)];
            return Self::Bicycle(Gaussian::new([x, y, heading, speed, 0.0], variance));
        }
        let ([vx, vy], var_v) = observation.velocity_mps().unwrap_or(([0.0; 2], unknown_speed));
        Self::ConstantVelocity(Gaussian::new([x, y, vx, vy], [var, var, var_v, var_v]))
    }

    /// The kind of the process model.
    pub const fn kind(&self) -> Kind {
        match self {
            Self::ConstantVelocity(_) => Kind::ConstantVelocity,
            Self::Bicycle(_) => Kind::Bicycle,
        }
    }

    /// Predicts the state `dt_ns` ahead.
    ///
    /// # Errors
    /// [`FilterFault`]; the state is then unchanged.
    pub fn predict(&mut self, dt_ns: u64, models: &Models) -> Result<(), FilterFault> {
        match self {
            Self::ConstantVelocity(state) => state.predict(dt_ns, &models.constant_velocity),
            Self::Bicycle(state) => state.predict(dt_ns, &models.bicycle),
        }
    }

    /// The state `dt_s` later (earlier if `dt_s` is negative), without process noise.
    #[must_use]
    pub fn shifted(&self, dt_s: f64, models: &Models) -> Self {
        match self {
            Self::ConstantVelocity(state) => {
                Self::ConstantVelocity(state.shifted(dt_s, &models.constant_velocity.noiseless()))
            }
            Self::Bicycle(state) => Self::Bicycle(state.shifted(dt_s, &models.bicycle.noiseless())),
        }
    }

    /// The same motion at another position, measured with this variance per axis.
    #[must_use]
    pub fn moved_to(mut self, position_m: [f64; 2], variance: f64) -> Self {
        match &mut self {
            Self::ConstantVelocity(state) => move_to(state, position_m, variance),
            Self::Bicycle(state) => move_to(state, position_m, variance),
        }
        self
    }

    /// The same motion at this share of its speed.
    #[must_use]
    pub fn slowed(mut self, share: f64) -> Self {
        match &mut self {
            Self::ConstantVelocity(Gaussian { mean, .. }) => mean.rows_mut(2, 2).scale_mut(share),
            Self::Bicycle(Gaussian { mean, .. }) => mean[3] *= share,
        }
        self
    }

    /// Updates the state by an observation.
    ///
    /// # Errors
    /// [`FilterFault`]; the state is then unchanged.
    pub fn update(&mut self, observation: &Observation, models: &Models) -> Result<Evidence, FilterFault> {
        match self {
            Self::ConstantVelocity(state) => state.update(observation, &models.constant_velocity),
            Self::Bicycle(state) => state.update(observation, &models.bicycle),
        }
    }

    /// Updates the state by several observations. At most one of them is an observation of the agent; each
    /// comes with the probability that it is. See [`Gaussian::update_jointly`].
    ///
    /// # Errors
    /// [`FilterFault`] if the update by any observation fails; the state is then unchanged.
    ///
    /// # Panics
    /// If there are more than [`OBSERVATIONS_MAX`](crate::OBSERVATIONS_MAX) observations, a probability is
    /// invalid, or the probabilities add up to more than 1.
    pub fn update_jointly(
        &mut self,
        observations: &[(f64, Observation)],
        models: &Models,
    ) -> Result<(), FilterFault> {
        match self {
            Self::ConstantVelocity(state) => state.update_jointly(observations, &models.constant_velocity),
            Self::Bicycle(state) => state.update_jointly(observations, &models.bicycle),
        }
    }

    /// Mean position and its covariance as (xx, xy, yy).
    #[inline]
    pub fn position(&self) -> ([f64; 2], [f64; 3]) {
        match self {
            Self::ConstantVelocity(state) => position(state),
            Self::Bicycle(state) => position(state),
        }
    }

    /// The motion of the mean.
    #[inline]
    pub fn motion(&self) -> Motion {
        match self {
            Self::ConstantVelocity(Gaussian { mean: m, .. }) => Motion {
                position_m: [m[0], m[1]],
                velocity_mps: [m[2], m[3]],
                heading_rad: None,
                speed_mps: hypot(m[2], m[3]),
                slip_rad: 0.0,
            },
            Self::Bicycle(Gaussian { mean: m, .. }) => {
                let (sin, cos) = (m[2] + m[4]).sin_cos();
                Motion {
                    position_m: [m[0], m[1]],
                    velocity_mps: [m[3] * cos, m[3] * sin],
                    heading_rad: Some(m[2]),
                    speed_mps: m[3],
                    slip_rad: m[4],
                }
            }
        }
    }

    /// Standard deviation of the direction of motion. It is large at low speed.
    pub fn course_sigma_rad(&self) -> f64 {
        match self {
            Self::Bicycle(Gaussian { covariance: p, .. }) => {
                (p[(2, 2)] + 2.0 * p[(2, 4)] + p[(4, 4)]).max(0.0).sqrt()
            }
            Self::ConstantVelocity(Gaussian { mean: m, covariance: p }) => {
                let spread = p[(2, 2)].max(p[(3, 3)]).sqrt();
                spread / hypot(m[2], m[3]).max(f64::MIN_POSITIVE)
            }
        }
    }

    /// Mean and covariance of \[x, y, vx, vy\] in the world frame. All kinds have these components.
    pub fn cartesian(&self) -> Gaussian<4> {
        match self {
            Self::ConstantVelocity(state) => *state,
            Self::Bicycle(state) => cartesian(state),
        }
    }

    /// The same motion in the state of another kind. Added components are 0 with the standard deviations of
    /// `unknown`. An added heading points along the course.
    #[must_use]
    pub fn into_kind(self, kind: Kind, unknown: &Unknown) -> Self {
        if self.kind() == kind {
            return self;
        }
        let from = self.cartesian();
        match kind {
            Kind::ConstantVelocity => Self::ConstantVelocity(from),
            Kind::Bicycle => Self::Bicycle(polar(&from, unknown.slip_rad)),
        }
    }
}

fn position<const N: usize>(Gaussian { mean: m, covariance: p }: &Gaussian<N>) -> ([f64; 2], [f64; 3]) {
    ([m[0], m[1]], [p[(0, 0)], p[(0, 1)], p[(1, 1)]])
}

fn move_to<const N: usize>(state: &mut Gaussian<N>, position_m: [f64; 2], variance: f64) {
    for (axis, position) in position_m.into_iter().enumerate() {
        state.mean[axis] = position;
        state.covariance.row_mut(axis).fill(0.0);
        state.covariance.column_mut(axis).fill(0.0);
        state.covariance[(axis, axis)] = variance;
    }
}

/// Converts a state \[x, y, ψ, v, β\] to \[x, y, vx, vy\].
fn cartesian(state: &Gaussian<5>) -> Gaussian<4> {
    let m = &state.mean;
    let (sin, cos) = (m[2] + m[4]).sin_cos();
    let mut jacobian = Matrix4x5::zeros();
    jacobian[(0, 0)] = 1.0;
    jacobian[(1, 1)] = 1.0;
    for turn in [2, 4] {
        jacobian[(2, turn)] = -m[3] * sin;
        jacobian[(3, turn)] = m[3] * cos;
    }
    jacobian[(2, 3)] = cos;
    jacobian[(3, 3)] = sin;
    let mean = Vector4::new(m[0], m[1], m[3] * cos, m[3] * sin);
    state.transformed(mean, &jacobian)
}

/// Converts a state \[x, y, vx, vy\] to \[x, y, ψ, v, β\]. The slip is 0 with the standard deviation `sigma`.
fn polar(state: &Gaussian<4>, sigma: f64) -> Gaussian<5> {
    let m = &state.mean;
    let speed = hypot(m[2], m[3]).max(1e-6);
    let (cos, sin) = (m[2] / speed, m[3] / speed);
    let mut jacobian = Matrix5x4::zeros();
    jacobian[(0, 0)] = 1.0;
    jacobian[(1, 1)] = 1.0;
    jacobian[(2, 2)] = -sin / speed;
    jacobian[(2, 3)] = cos / speed;
    jacobian[(3, 2)] = cos;
    jacobian[(3, 3)] = sin;
    let mut moved = state.transformed(Vector5::new(m[0], m[1], m[3].atan2(m[2]), speed, 0.0), &jacobian);
    moved.covariance += Matrix5::from_diagonal(&Vector5::new(0.0, 0.0, 0.0, 0.0, sigma.powi(2)));
    moved
}
