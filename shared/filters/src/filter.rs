use nalgebra::{Matrix4x5, Matrix5, Matrix5x4, Vector4, Vector5};

use crate::{Bicycle, BicycleModel, ConstantVelocity, FilterFault, Gaussian, Motion, Observation};

/// One agent's filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Filter {
    /// \[x, y, ψ, v, β\]
    Bicycle(Bicycle),
    /// \[x, y, vx, vy\]
    ConstantVelocity(ConstantVelocity),
}

impl Filter {
    /// Moves the state on by `dt_ns`.
    ///
    /// # Errors
    /// [`FilterFault::NotFinite`]; the state is then as before.
    pub fn predict(&mut self, dt_ns: u64, bicycle: &BicycleModel, density: f64) -> Result<(), FilterFault> {
        match self {
            Self::Bicycle(filter) => filter.predict(dt_ns, bicycle),
            Self::ConstantVelocity(filter) => filter.predict(dt_ns, density),
        }
    }

    /// Corrects the state; returns the normalised innovation squared.
    ///
    /// # Errors
    /// [`FilterFault`]; the state is then as before.
    pub fn update(&mut self, seen: &Observation, slip_max_rad: f64) -> Result<f64, FilterFault> {
        match self {
            Self::Bicycle(filter) => filter.update(seen, slip_max_rad),
            Self::ConstantVelocity(filter) => filter.update(seen),
        }
    }

    /// Mean position and its covariance as (xx, xy, yy).
    #[must_use]
    pub fn position(&self) -> ([f64; 2], [f64; 3]) {
        match self {
            Self::Bicycle(Bicycle { state: Gaussian { mean: m, covariance: p } }) => {
                ([m[0], m[1]], [p[(0, 0)], p[(0, 1)], p[(1, 1)]])
            }
            Self::ConstantVelocity(ConstantVelocity { state: Gaussian { mean: m, covariance: p } }) => {
                ([m[0], m[1]], [p[(0, 0)], p[(0, 1)], p[(1, 1)]])
            }
        }
    }

    /// The mean's motion.
    #[must_use]
    pub fn motion(&self) -> Motion {
        match self {
            Self::Bicycle(Bicycle { state: Gaussian { mean: m, .. } }) => {
                let (sin, cos) = (m[2] + m[4]).sin_cos();
                Motion {
                    position_m: [m[0], m[1]],
                    velocity_mps: [m[3] * cos, m[3] * sin],
                    heading_rad: Some(m[2]),
                    speed_mps: m[3],
                    slip_rad: m[4],
                }
            }
            Self::ConstantVelocity(ConstantVelocity { state: Gaussian { mean: m, .. } }) => Motion {
                position_m: [m[0], m[1]],
                velocity_mps: [m[2], m[3]],
                heading_rad: None,
                speed_mps: m[2].hypot(m[3]),
                slip_rad: 0.0,
            },
        }
    }

    /// Standard deviation of the direction of motion; large where the agent hardly moves.
    #[must_use]
    pub fn course_sigma_rad(&self) -> f64 {
        match self {
            Self::Bicycle(Bicycle { state: Gaussian { covariance: p, .. } }) => {
                (p[(2, 2)] + 2.0 * p[(2, 4)] + p[(4, 4)]).max(0.0).sqrt()
            }
            Self::ConstantVelocity(ConstantVelocity { state: Gaussian { mean: m, covariance: p } }) => {
                let spread = p[(2, 2)].max(p[(3, 3)]).sqrt();
                spread / m[2].hypot(m[3]).max(f64::MIN_POSITIVE)
            }
        }
    }

    /// The same motion as a bicycle whose front points along the course; `slip_variance` is that of the slip, which
    /// a constant velocity says nothing of.
    #[must_use]
    pub fn into_bicycle(self, slip_variance: f64) -> Self {
        let Self::ConstantVelocity(ConstantVelocity { state }) = self else { return self };
        let m = &state.mean;
        let speed = m[2].hypot(m[3]).max(1e-6);
        let (cos, sin) = (m[2] / speed, m[3] / speed);
        let mut jacobian = Matrix5x4::zeros();
        jacobian[(0, 0)] = 1.0;
        jacobian[(1, 1)] = 1.0;
        jacobian[(2, 2)] = -sin / speed;
        jacobian[(2, 3)] = cos / speed;
        jacobian[(3, 2)] = cos;
        jacobian[(3, 3)] = sin;
        let mean = Vector5::new(m[0], m[1], m[3].atan2(m[2]), speed, 0.0);
        let mut moved = state.transformed(mean, &jacobian);
        moved.covariance += Matrix5::from_diagonal(&Vector5::new(0.0, 0.0, 0.0, 0.0, slip_variance));
        Self::Bicycle(Bicycle { state: moved })
    }

    /// The same motion without heading and slip.
    #[must_use]
    pub fn into_constant_velocity(self) -> Self {
        let Self::Bicycle(Bicycle { state }) = self else { return self };
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
        Self::ConstantVelocity(ConstantVelocity { state: state.transformed(mean, &jacobian) })
    }
}
