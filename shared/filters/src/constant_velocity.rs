use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};

use crate::{Control, ControlStep, Controlled, Gaussian, Innovation, Observation, Process};

/// \[x, y, vx, vy\] under white acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstantVelocity {
    /// Spectral density q of the acceleration per axis, m²/s³.
    pub density: f64,
}

impl ConstantVelocity {
    /// The same process without noise.
    pub const fn noiseless(&self) -> Self {
        Self { density: 0.0 }
    }
}

impl Process<4> for ConstantVelocity {
    const ANGLES: &'static [usize] = &[];

    fn step(&self, state: &Gaussian<4>, dt_s: f64) -> Gaussian<4> {
        self.step_controlled(state, &Control::default(), dt_s)
    }

    fn innovation(&self, mean: &Vector4<f64>, observation: &Observation) -> Innovation<4> {
        observation.against_cartesian(mean)
    }

    fn constrain(&self, _: &mut Vector4<f64>) {}
}

impl Controlled<4> for ConstantVelocity {
    /// ```text
    /// p' = p + v Δt + a Δt²/2      v' = v + a Δt      Q = q [Δt³/3  Δt²/2; Δt²/2  Δt] per axis
    /// ```
    fn step_controlled(&self, state: &Gaussian<4>, control: &Control, dt_s: f64) -> Gaussian<4> {
        let density = self.density;
        let mut transition = Matrix4::identity();
        transition[(0, 2)] = dt_s;
        transition[(1, 3)] = dt_s;
        let (position, cross, velocity) =
            (density * dt_s.powi(3) / 3.0, density * dt_s.powi(2) / 2.0, density * dt_s);
        let diagonal = Vector4::new(position, position, velocity, velocity);
        let mut covariance = state.propagated(&transition, &diagonal);
        for (p, v) in [(0, 2), (1, 3)] {
            covariance[(p, v)] += cross;
            covariance[(v, p)] += cross;
        }
        let [xx, xy, yy] = control.density.map(|density| density * dt_s);
        covariance[(0, 0)] += xx;
        covariance[(0, 1)] += xy;
        covariance[(1, 0)] += xy;
        covariance[(1, 1)] += yy;
        let [ax, ay] = control.rate;
        let half = dt_s.powi(2) / 2.0;
        let pushed = Vector4::new(ax * half, ay * half, ax * dt_s, ay * dt_s);
        Gaussian { mean: transition * state.mean + pushed, covariance }
    }

    /// Converts displacements to accelerations. A step's displacement divided by its duration is the velocity
    /// in the middle of the step, relative to the velocity at the stamp. Between these times the velocity
    /// changes linearly. The displacement's covariance grows with time.
    fn control(steps: &[ControlStep], number: usize, step_s: f64, heading_rad: f64) -> Control {
        let (sin, cos) = heading_rad.sin_cos();
        let world_from_agent = Matrix2::new(cos, -sin, sin, cos);
        let velocity = |step: &ControlStep| Vector2::from(step.mean) / step_s;
        let change = match (number.checked_sub(1).map(|before| steps.get(before)), steps.get(number)) {
            (None, Some(first)) => velocity(first) * 2.0,
            (Some(Some(before)), Some(next)) => velocity(next) - velocity(before),
            _ => Vector2::zeros(),
        };
        let near = steps.get(number).or(steps.last()).copied().unwrap_or_default();
        let covariance = world_from_agent * near.covariance() * world_from_agent.transpose();
        Control::new((world_from_agent * change / step_s).into(), &(covariance / step_s))
    }

    fn first_ns(step_ns: u64) -> u64 {
        step_ns / 2
    }
}
