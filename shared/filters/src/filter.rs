use elementary::hypot;
use nalgebra::{Matrix4x5, Matrix5, Matrix5x4, Matrix6, SVector, Vector4, Vector5, Vector6};

use crate::{
    Bicycle, ConstantAcceleration, ConstantTurnRate, ConstantVelocity, Evidence, FilterFault, Gaussian,
    Motion, Observation,
};

/// A process model by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// [`ConstantVelocity`]
    ConstantVelocity,
    /// [`ConstantAcceleration`]
    ConstantAcceleration,
    /// [`ConstantTurnRate`]
    ConstantTurnRate,
    /// [`Bicycle`]
    Bicycle,
}

impl Kind {
    /// All kinds, simplest first.
    pub const ALL: [Self; 4] =
        [Self::ConstantVelocity, Self::ConstantAcceleration, Self::ConstantTurnRate, Self::Bicycle];

    /// The name used in files and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::ConstantVelocity => "constant-velocity",
            Self::ConstantAcceleration => "constant-acceleration",
            Self::ConstantTurnRate => "constant-turn-rate",
            Self::Bicycle => "bicycle",
        }
    }
}

/// The process models of one agent, one per [`Kind`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Models {
    /// \[x, y, vx, vy\]
    pub constant_velocity: ConstantVelocity,
    /// \[x, y, vx, vy, ax, ay\]
    pub constant_acceleration: ConstantAcceleration,
    /// \[x, y, ψ, v, ω\]
    pub constant_turn_rate: ConstantTurnRate,
    /// \[x, y, ψ, v, β\]
    pub bicycle: Bicycle,
}

/// Standard deviations about 0 of the quantities that the first observation does not measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unknown {
    /// Standard deviation of the speed, and of the velocity per axis.
    pub speed_mps: f64,
    /// Standard deviation of the acceleration per axis.
    pub acceleration_mps2: f64,
    /// Standard deviation of the turn rate.
    pub turn_rate_radps: f64,
    /// Standard deviation of the slip angle.
    pub slip_rad: f64,
}

/// The filter of one agent: its state, by the kind of its process model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Filter {
    /// \[x, y, vx, vy\]
    ConstantVelocity(Gaussian<4>),
    /// \[x, y, vx, vy, ax, ay\]
    ConstantAcceleration(Gaussian<6>),
    /// \[x, y, ψ, v, ω\]
    ConstantTurnRate(Gaussian<5>),
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
        let polar = |last: f64| {
            let (heading, var_h) = observation.heading_rad?;
            let (speed, var_v) = observation.speed_mps.unwrap_or((0.0, unknown_speed));
            Some(Gaussian::new([x, y, heading, speed, 0.0], [var, var, var_h, var_v, last.powi(2)]))
        };
        let ([vx, vy], var_v) = observation.velocity_mps().unwrap_or(([0.0; 2], unknown_speed));
        let cartesian = Gaussian::new([x, y, vx, vy], [var, var, var_v, var_v]);
        match kind {
            Kind::Bicycle => polar(unknown.slip_rad).map(Self::Bicycle),
            Kind::ConstantTurnRate => polar(unknown.turn_rate_radps).map(Self::ConstantTurnRate),
            Kind::ConstantAcceleration => {
                Some(Self::ConstantAcceleration(with_acceleration(&cartesian, unknown.acceleration_mps2)))
            }
            Kind::ConstantVelocity => None,
        }
        .unwrap_or(Self::ConstantVelocity(cartesian))
    }

    /// The kind of the process model.
    pub const fn kind(&self) -> Kind {
        match self {
            Self::ConstantVelocity(_) => Kind::ConstantVelocity,
            Self::ConstantAcceleration(_) => Kind::ConstantAcceleration,
            Self::ConstantTurnRate(_) => Kind::ConstantTurnRate,
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
            Self::ConstantAcceleration(state) => state.predict(dt_ns, &models.constant_acceleration),
            Self::ConstantTurnRate(state) => state.predict(dt_ns, &models.constant_turn_rate),
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
            // No tracker uses these kinds. Their positions move at the present velocity.
            Self::ConstantAcceleration(_) | Self::ConstantTurnRate(_) => {
                Self::ConstantVelocity(self.cartesian()).shifted(dt_s, models)
            }
        }
    }

    /// The same motion at another position, measured with this variance per axis.
    #[must_use]
    pub fn moved_to(mut self, position_m: [f64; 2], variance: f64) -> Self {
        match &mut self {
            Self::ConstantVelocity(state) => move_to(state, position_m, variance),
            Self::ConstantAcceleration(state) => move_to(state, position_m, variance),
            Self::ConstantTurnRate(state) | Self::Bicycle(state) => move_to(state, position_m, variance),
        }
        self
    }

    /// The same motion at this share of its speed.
    #[must_use]
    pub fn slowed(mut self, share: f64) -> Self {
        match &mut self {
            Self::ConstantVelocity(Gaussian { mean, .. }) => mean.rows_mut(2, 2).scale_mut(share),
            Self::ConstantAcceleration(Gaussian { mean, .. }) => mean.rows_mut(2, 2).scale_mut(share),
            Self::ConstantTurnRate(Gaussian { mean, .. }) | Self::Bicycle(Gaussian { mean, .. }) => {
                mean[3] *= share;
            }
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
            Self::ConstantAcceleration(state) => state.update(observation, &models.constant_acceleration),
            Self::ConstantTurnRate(state) => state.update(observation, &models.constant_turn_rate),
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
            Self::ConstantAcceleration(state) => {
                state.update_jointly(observations, &models.constant_acceleration)
            }
            Self::ConstantTurnRate(state) => state.update_jointly(observations, &models.constant_turn_rate),
            Self::Bicycle(state) => state.update_jointly(observations, &models.bicycle),
        }
    }

    /// Mean position and its covariance as (xx, xy, yy).
    #[inline]
    pub fn position(&self) -> ([f64; 2], [f64; 3]) {
        match self {
            Self::ConstantVelocity(state) => position(state),
            Self::ConstantAcceleration(state) => position(state),
            Self::ConstantTurnRate(state) | Self::Bicycle(state) => position(state),
        }
    }

    /// The motion of the mean.
    #[inline]
    pub fn motion(&self) -> Motion {
        match self {
            Self::ConstantVelocity(Gaussian { mean: m, .. }) => cartesian_motion(m),
            Self::ConstantAcceleration(Gaussian { mean: m, .. }) => cartesian_motion(m),
            Self::ConstantTurnRate(Gaussian { mean: m, .. }) => polar_motion(m, 0.0),
            Self::Bicycle(Gaussian { mean: m, .. }) => polar_motion(m, m[4]),
        }
    }

    /// Standard deviation of the direction of motion. It is large at low speed.
    pub fn course_sigma_rad(&self) -> f64 {
        match self {
            Self::Bicycle(Gaussian { covariance: p, .. }) => {
                (p[(2, 2)] + 2.0 * p[(2, 4)] + p[(4, 4)]).max(0.0).sqrt()
            }
            Self::ConstantTurnRate(Gaussian { covariance: p, .. }) => p[(2, 2)].max(0.0).sqrt(),
            Self::ConstantVelocity(Gaussian { mean: m, covariance: p }) => {
                let spread = p[(2, 2)].max(p[(3, 3)]).sqrt();
                spread / hypot(m[2], m[3]).max(f64::MIN_POSITIVE)
            }
            Self::ConstantAcceleration(_) => Self::ConstantVelocity(self.cartesian()).course_sigma_rad(),
        }
    }

    /// Mean and covariance of \[x, y, vx, vy\] in the world frame. All kinds have these components.
    pub fn cartesian(&self) -> Gaussian<4> {
        match self {
            Self::ConstantVelocity(state) => *state,
            Self::ConstantAcceleration(state) => Gaussian {
                mean: state.mean.fixed_rows::<4>(0).into_owned(),
                covariance: state.covariance.fixed_view::<4, 4>(0, 0).into_owned(),
            },
            Self::ConstantTurnRate(state) => cartesian(state, 0.0, &[2]),
            Self::Bicycle(state) => cartesian(state, state.mean[4], &[2, 4]),
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
            Kind::ConstantAcceleration => {
                Self::ConstantAcceleration(with_acceleration(&from, unknown.acceleration_mps2))
            }
            Kind::ConstantTurnRate => Self::ConstantTurnRate(polar(&from, unknown.turn_rate_radps)),
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

fn cartesian_motion<const N: usize>(m: &SVector<f64, N>) -> Motion {
    Motion {
        position_m: [m[0], m[1]],
        velocity_mps: [m[2], m[3]],
        heading_rad: None,
        speed_mps: hypot(m[2], m[3]),
        slip_rad: 0.0,
    }
}

fn polar_motion(m: &Vector5<f64>, slip_rad: f64) -> Motion {
    let (sin, cos) = (m[2] + slip_rad).sin_cos();
    Motion {
        position_m: [m[0], m[1]],
        velocity_mps: [m[3] * cos, m[3] * sin],
        heading_rad: Some(m[2]),
        speed_mps: m[3],
        slip_rad,
    }
}

/// Converts a state \[x, y, ψ, v, …\] to \[x, y, vx, vy\]. The components `turns` add up to the course.
fn cartesian(state: &Gaussian<5>, slip_rad: f64, turns: &[usize]) -> Gaussian<4> {
    let m = &state.mean;
    let (sin, cos) = (m[2] + slip_rad).sin_cos();
    let mut jacobian = Matrix4x5::zeros();
    jacobian[(0, 0)] = 1.0;
    jacobian[(1, 1)] = 1.0;
    for &turn in turns {
        jacobian[(2, turn)] = -m[3] * sin;
        jacobian[(3, turn)] = m[3] * cos;
    }
    jacobian[(2, 3)] = cos;
    jacobian[(3, 3)] = sin;
    let mean = Vector4::new(m[0], m[1], m[3] * cos, m[3] * sin);
    state.transformed(mean, &jacobian)
}

/// Converts a state \[x, y, vx, vy\] to \[x, y, ψ, v, …\]. The last component is 0 with the standard
/// deviation `sigma`.
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

fn with_acceleration(state: &Gaussian<4>, sigma_mps2: f64) -> Gaussian<6> {
    let mut mean = Vector6::zeros();
    mean.fixed_rows_mut::<4>(0).copy_from(&state.mean);
    let mut covariance = Matrix6::zeros();
    covariance.fixed_view_mut::<4, 4>(0, 0).copy_from(&state.covariance);
    for axis in [4, 5] {
        covariance[(axis, axis)] = sigma_mps2.powi(2);
    }
    Gaussian { mean, covariance }
}
