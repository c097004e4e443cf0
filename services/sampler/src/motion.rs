use kinematics::{ControlGaussian, MotionModel};
use nalgebra::{Matrix4, Matrix4x5, Matrix5, Matrix5x4, SMatrix};
use scene::{AgentType, State, motion_start, track_history};
use wire::Track;

use crate::SamplerOptions;

/// At lower speeds, the heading of a velocity is taken to be as uncertain as at this speed.
const STEADY_MPS: f32 = 1.0;
/// A covariance with a larger entry is not a valid estimate.
const VARIANCE_MAX: f32 = 1e6;

/// Maximum lateral acceleration that tyres permit.
const LATERAL_MAX_MPS2: f32 = 8.0;
/// Maximum reverse speed of a vehicle that drives forward.
const REVERSE_MAX_MPS: f32 = 2.0;

/// Moves a vehicle along the controls of a mode, limited to the grip of its tyres.
///
/// The course turns by the slip angle and by its change: |v (v sin β / l_r + dβ/dt)| ≤ 8 m/s². The slip angle
/// alone has the same limit. The vehicle reverses at most at 2 m/s, or at its present reverse speed if that
/// is higher.
pub(crate) struct LateralLimit {
    rear_axle_m: f32,
    dt_s: f32,
    least_mps: f32,
    speed_mps: f32,
    slip_rad: f32,
}

impl LateralLimit {
    /// The limit at the start of a motion; `None` for agents other than vehicles.
    pub(crate) fn new(model: &MotionModel) -> Option<Self> {
        match model {
            MotionModel::Bicycle { motion, start } => Some(Self {
                rear_axle_m: motion.bicycle.rear_axle_m,
                dt_s: motion.dt_s,
                least_mps: start.mean[3].min(-REVERSE_MAX_MPS),
                speed_mps: start.mean[3],
                slip_rad: start.mean[4],
            }),
            MotionModel::Displacement { .. } => None,
        }
    }

    /// Limits the controls of the next step, and takes the step.
    pub(crate) fn cut(&mut self, acting: &mut ControlGaussian) {
        let mut next_mps = self.speed_mps + acting.mean[0] * self.dt_s;
        if next_mps < self.least_mps {
            next_mps = self.least_mps;
            acting.mean[0] = (next_mps - self.speed_mps) / self.dt_s;
        }
        let middle_mps = 0.5 * (self.speed_mps + next_mps);
        // Lateral acceleration per radian of slip, and per radian by which the slip changes in this step.
        let by_slip = middle_mps * middle_mps / self.rear_axle_m;
        let by_change = middle_mps.abs() / self.dt_s;
        let sine = LATERAL_MAX_MPS2 / by_slip.max(f32::MIN_POSITIVE);
        let most_rad = if sine < 1.0 { sine.asin() } else { f32::INFINITY };
        let next_rad = self.slip_rad + acting.mean[1] * self.dt_s;
        // The slip angle in the middle of the step is the mean of those at its ends.
        let turn = 0.5 * by_slip + by_change;
        let held = self.slip_rad * (by_change - 0.5 * by_slip);
        let [least_turned_rad, most_turned_rad] =
            [-LATERAL_MAX_MPS2, LATERAL_MAX_MPS2].map(|most| (most + held) / turn.max(f32::MIN_POSITIVE));
        // If the track starts beyond the limit, its slip falls no faster than tyres permit.
        let cut_rad = next_rad.max(-most_rad).min(most_rad).max(least_turned_rad).min(most_turned_rad);
        if cut_rad != next_rad {
            acting.mean[1] = (cut_rad - self.slip_rad) / self.dt_s;
        }
        (self.speed_mps, self.slip_rad) = (next_mps, cut_rad);
    }
}

/// The motion of a track from its present state, without uncertainty.
pub(crate) fn certain_motion(
    track: &Track,
    agent_type: AgentType,
    options: &SamplerOptions,
    dt_s: f32,
) -> MotionModel {
    let now = State {
        position_m: [track.x_m, track.y_m],
        velocity_mps: [track.vx_mps, track.vy_mps],
        heading_rad: track.heading_rad,
    };
    let kind = options.kind_of(agent_type);
    let length_m = (track.length_m > 0.0).then_some(track.length_m);
    let start = motion_start(&now, &track_history(track)[..options.history_len], length_m, dt_s);
    MotionModel::new(kind, &start, &options.motion, dt_s)
}

/// The same motion with the track's covariance at its start; without uncertainty if the covariance is
/// invalid.
///
/// The slip of a bicycle has no variance: it comes from the headings, not from the filter.
pub(crate) fn with_track_covariance(mut model: MotionModel, track: &Track) -> MotionModel {
    let len = track.state_len as usize;
    let entries_hold = track.covariance.iter().all(|entry| entry.abs() <= VARIANCE_MAX);
    if !matches!(len, 4 | 5) || !entries_hold || (0..len).any(|i| track.covariance[i * len + i] < 0.0) {
        return model;
    }
    match (&mut model, len) {
        (MotionModel::Bicycle { start, .. }, 5) => {
            start.covariance = Matrix5::from_row_slice(&track.covariance);
            start.covariance.row_mut(4).fill(0.0);
            start.covariance.column_mut(4).fill(0.0);
        }
        (MotionModel::Bicycle { start, .. }, _) => {
            let covariance = Matrix4::from_row_slice(&track.covariance[..16]);
            start.covariance = turned(&bicycle_by_velocity(track), &covariance);
        }
        (MotionModel::Displacement { start, .. }, 4) => {
            start.covariance = Matrix4::from_row_slice(&track.covariance[..16]);
        }
        (MotionModel::Displacement { start, .. }, _) => {
            let covariance = Matrix5::from_row_slice(&track.covariance);
            start.covariance = turned(&velocity_by_bicycle(track), &covariance);
        }
    }
    model
}

/// Derivative of \[x, y, ψ, v, β\] by \[x, y, vx, vy\] for a vehicle that moves along its heading.
fn bicycle_by_velocity(track: &Track) -> Matrix5x4<f32> {
    let (sin, cos) = track.heading_rad.sin_cos();
    let speed_mps = track.speed_mps.abs().max(STEADY_MPS);
    let mut derivative = Matrix5x4::identity();
    derivative.fixed_view_mut::<2, 2>(2, 2).copy_from_slice(&[-sin / speed_mps, cos, cos / speed_mps, sin]);
    derivative
}

/// Derivative of \[x, y, vx, vy\] by \[x, y, ψ, v, β\].
fn velocity_by_bicycle(track: &Track) -> Matrix4x5<f32> {
    let (sin, cos) = (track.heading_rad + track.slip_rad).sin_cos();
    let across = [-track.speed_mps * sin, track.speed_mps * cos];
    let mut derivative = Matrix4x5::identity();
    derivative
        .fixed_view_mut::<2, 3>(2, 2)
        .copy_from_slice(&[across[0], across[1], cos, sin, across[0], across[1]]);
    derivative
}

fn turned<const N: usize, const M: usize>(
    derivative: &SMatrix<f32, N, M>,
    covariance: &SMatrix<f32, M, M>,
) -> SMatrix<f32, N, N> {
    derivative * covariance * derivative.transpose()
}
