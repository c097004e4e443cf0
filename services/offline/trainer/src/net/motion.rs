//! Controls to positions: the equations of the `kinematics` crate over a batch, in agent frames, and their
//! gradients. \[model §4\]
//!
//! Each row of a matrix is one trajectory, with two columns per step. The rows of an agent, its *draws*, are
//! consecutive and share one [`Start`]. Vehicles move by the bicycle model unless the model's configuration
//! moves them by displacements. The backward pass takes the controls instead of a trace, because computing
//! the states again costs less than keeping them.

mod bicycle;
mod noise;
mod reals;

use nn::{Displacement, ModelConfig};
use wire::AgentType;

use super::matrix::Matrix;

pub(crate) use bicycle::Start;
pub(crate) use noise::{noisy_controls, noisy_controls_backward};

/// Positions `[rows, horizon × 2]` under `controls` of the same shape; vehicles' controls are before
/// saturation. Row r starts from `starts[r / draw_count]`. \[model §4\]
pub(crate) fn positions(
    config: &ModelConfig,
    agent_type: AgentType,
    starts: &[Start],
    draw_count: usize,
    controls: &Matrix,
) -> Matrix {
    assert_eq!(starts.len() * draw_count, controls.rows, "a start for every {draw_count} rows");
    if config.drives(agent_type) {
        bicycle::positions(config, starts, draw_count, controls)
    } else {
        displace(config, starts, draw_count, controls)
    }
}

/// Gradient by the controls of [`positions`], given the gradient by the positions. Panics under the same
/// condition.
pub(crate) fn positions_backward(
    config: &ModelConfig,
    agent_type: AgentType,
    starts: &[Start],
    draw_count: usize,
    controls: &Matrix,
    d_positions: &Matrix,
) -> Matrix {
    assert_eq!(starts.len() * draw_count, controls.rows, "a start for every {draw_count} rows");
    assert_eq!((controls.rows, controls.cols), (d_positions.rows, d_positions.cols), "shape of the gradient");
    if config.drives(agent_type) {
        bicycle::positions_backward(config, starts, draw_count, controls, d_positions)
    } else {
        displace_backward(d_positions)
    }
}

/// Cumulative sums of the displacements. Residual displacements are relative to constant velocity.
fn displace(config: &ModelConfig, starts: &[Start], draw_count: usize, controls: &Matrix) -> Matrix {
    let carried_s = match config.displacement {
        Displacement::Residual => config.dt_s as f32,
        Displacement::Absolute => 0.0,
    };
    let mut positions = controls.clone();
    for (row, trajectory) in positions.values.chunks_exact_mut(controls.cols.max(1)).enumerate() {
        let carried = starts[row / draw_count].velocity_mps.map(|velocity| velocity * carried_s);
        let mut position = [0.0; 2];
        for step in trajectory.as_chunks_mut::<2>().0 {
            position = [0, 1].map(|axis| position[axis] + carried[axis] + step[axis]);
            *step = position;
        }
    }
    positions
}

/// A displacement moves its own position and all later ones.
fn displace_backward(d_positions: &Matrix) -> Matrix {
    let mut gradient = d_positions.clone();
    for trajectory in gradient.values.chunks_exact_mut(d_positions.cols.max(1)) {
        let mut later = [0.0; 2];
        for step in trajectory.as_chunks_mut::<2>().0.iter_mut().rev() {
            later = [0, 1].map(|axis| later[axis] + step[axis]);
            *step = later;
        }
    }
    gradient
}

#[cfg(test)]
mod tests;
