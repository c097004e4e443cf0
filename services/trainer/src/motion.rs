//! Controls to motion, differentiable: the equations of the `kinematics` crate over a batch, in agent frames.

use burn::tensor::Tensor;
use nn::{Displacement, Integrator, ModelConfig};

/// How vehicles stand at the last observed step, one value per trajectory.
#[derive(Clone, Debug)]
pub struct VehicleStart {
    /// Position `[rows, 2]`.
    pub position_m: Tensor<2>,
    /// Heading `[rows, 1]`.
    pub heading_rad: Tensor<2>,
    /// Signed speed along the heading `[rows, 1]`.
    pub speed_mps: Tensor<2>,
    /// Slip angle `[rows, 1]`.
    pub slip_rad: Tensor<2>,
    /// Distance from the centre to the rear axle `[rows, 1]`.
    pub rear_axle_m: Tensor<2>,
}

/// States [x, y, ψ, v, β] of kinematic bicycles, `[rows, steps, 5]`, under `controls` `[rows, steps, 2]` of acceleration
/// and slip rate before saturation. \[model §4\]
#[must_use]
pub fn drive(config: &ModelConfig, start: &VehicleStart, controls: Tensor<3>) -> Tensor<3> {
    let [rows_len, steps_len, _] = controls.dims();
    let dt_s = config.dt_s;
    let (mut x, mut y) = (start.position_m.clone().narrow(1, 0, 1), start.position_m.clone().narrow(1, 1, 1));
    let (mut heading, mut speed, mut slip) =
        (start.heading_rad.clone(), start.speed_mps.clone(), start.slip_rad.clone());
    let accel = saturate(controls.clone().narrow(2, 0, 1), config.accel_limit_mps2);
    let slip_rate = saturate(controls.narrow(2, 1, 1), config.slip_rate_limit_radps);
    let mut states = Vec::with_capacity(steps_len);
    for step in 0..steps_len {
        let of_step = |values: &Tensor<3>| values.clone().narrow(1, step, 1).reshape([rows_len, 1]);
        let next_speed = speed.clone() + of_step(&accel) * dt_s;
        let mut next_slip = slip.clone() + of_step(&slip_rate) * dt_s;
        if let Some(limit) = config.slip_limit_rad {
            next_slip = next_slip.clamp(-limit, limit);
        }
        let (at_speed, at_slip) = match config.integrator {
            Integrator::Euler => (speed, slip),
            Integrator::Midpoint => ((speed + next_speed.clone()) * 0.5, (slip + next_slip.clone()) * 0.5),
        };
        let turn_rate = at_speed.clone() * at_slip.clone().sin() / start.rear_axle_m.clone();
        let course = match config.integrator {
            Integrator::Euler => heading.clone() + at_slip,
            Integrator::Midpoint => heading.clone() + turn_rate.clone() * (dt_s * 0.5) + at_slip,
        };
        let travelled = at_speed * dt_s;
        x = x + travelled.clone() * course.clone().cos();
        y = y + travelled * course.sin();
        heading = heading + turn_rate * dt_s;
        (speed, slip) = (next_speed, next_slip);
        let state = vec![x.clone(), y.clone(), heading.clone(), speed.clone(), slip.clone()];
        states.push(Tensor::cat(state, 1).unsqueeze_dim::<3>(1));
    }
    Tensor::cat(states, 1)
}

/// limit · tanh(value / limit).
fn saturate(values: Tensor<3>, limit: f32) -> Tensor<3> {
    (values / limit).tanh() * limit
}

/// Positions `[rows, steps, 2]` of agents that move by `controls` `[rows, steps, 2]` a step, beyond their constant
/// velocity `[rows, 2]` where displacements are residual.
#[must_use]
pub fn displace(config: &ModelConfig, velocity_mps: &Tensor<2>, controls: &Tensor<3>) -> Tensor<3> {
    let [rows_len, steps_len, _] = controls.dims();
    let carried = match config.displacement {
        Displacement::Residual => velocity_mps.clone() * config.dt_s,
        Displacement::Absolute => Tensor::zeros_like(velocity_mps),
    };
    let mut position: Tensor<2> = Tensor::zeros_like(velocity_mps);
    let mut positions = Vec::with_capacity(steps_len);
    for step in 0..steps_len {
        position = position + carried.clone() + controls.clone().narrow(1, step, 1).reshape([rows_len, 2]);
        positions.push(position.clone().unsqueeze_dim::<3>(1));
    }
    Tensor::cat(positions, 1)
}
