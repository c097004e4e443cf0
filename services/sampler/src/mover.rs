use kinematics::{
    Belief, Bicycle, ControlGaussian, Displacement, Moments, Motion, Normals, PARTICLES_MAX, Vehicle,
    advance_particles, initial_slip, spread,
};
use nalgebra::{Matrix4, Matrix4x5, Matrix5, Matrix5x4, SMatrix, Vector4, Vector5};
use scene::{AgentFrame, AgentType, Departures, Moment, State, agent_frame, track_history, turn_rates};
use wire::{Steering, Track};

use crate::SamplerOptions;
use crate::learned::Change;

/// Below this speed a velocity says no more about a heading than at it.
const STEADY_MPS: f32 = 1.0;
/// A variance beyond this is no estimate.
const VARIANCE_MAX: f32 = 1e6;

/// An agent at the end of its history: how it moves, and from where.
pub(crate) enum Mover {
    /// By acceleration and slip rate.
    Vehicle(Vehicle, Belief<5>),
    /// By displacements.
    Walker(Displacement, Belief<4>),
}

impl Mover {
    /// An agent whose present state is known for certain.
    pub(crate) fn certain(track: &Track, agent_type: AgentType, options: &SamplerOptions, dt_s: f32) -> Self {
        let history = track_history(track);
        let history = &history[..options.history_len];
        let now = State {
            position_m: [track.x_m, track.y_m],
            velocity_mps: [track.vx_mps, track.vy_mps],
            heading_rad: track.heading_rad,
        };
        if agent_type == AgentType::Vehicle && options.vehicles_drive {
            return vehicle(&now, history, track.length_m, options, dt_s);
        }
        let frame = agent_frame(history).unwrap_or(AgentFrame::new(now.position_m, now.heading_rad));
        let motion = Displacement::new(options.displacement, frame.heading_rad, dt_s);
        let ([x, y], [vx, vy]) = (now.position_m, now.velocity_mps);
        Self::Walker(motion, Belief::certain(Vector4::new(x, y, vx, vy)))
    }

    /// The same agent, as uncertain as its track. A covariance that is none leaves it certain.
    ///
    /// A vehicle's slip stays certain: it is read off the headings, not taken from the filter.
    pub(crate) fn with_track_covariance(mut self, track: &Track) -> Self {
        let len = track.state_len as usize;
        let entries_hold = track.covariance.iter().all(|entry| entry.abs() <= VARIANCE_MAX);
        if !matches!(len, 4 | 5) || !entries_hold || (0..len).any(|i| track.covariance[i * len + i] < 0.0) {
            return self;
        }
        match (&mut self, len) {
            (Self::Vehicle(_, belief), 5) => {
                belief.covariance = Matrix5::from_row_slice(&track.covariance);
                belief.covariance.row_mut(4).fill(0.0);
                belief.covariance.column_mut(4).fill(0.0);
            }
            (Self::Vehicle(_, belief), _) => {
                let covariance = Matrix4::from_row_slice(&track.covariance[..16]);
                belief.covariance = turned(&bicycle_by_velocity(track), &covariance);
            }
            (Self::Walker(_, belief), 4) => {
                belief.covariance = Matrix4::from_row_slice(&track.covariance[..16]);
            }
            (Self::Walker(_, belief), _) => {
                let covariance = Matrix5::from_row_slice(&track.covariance);
                belief.covariance = turned(&velocity_by_bicycle(track), &covariance);
            }
        }
        self
    }

    /// The same agent, a vehicle with its heading turned so that its course is the heading that was observed.
    ///
    /// Recorded headings are courses. A learned forecast begins at the recorded heading all the same, as in training:
    /// the network makes up for the slip.
    pub(crate) fn along_its_course(mut self) -> Self {
        if let Self::Vehicle(_, belief) = &mut self {
            belief.mean[2] -= belief.mean[4];
        }
        self
    }

    /// Adds to the variance of a walker's velocity; a vehicle's comes from its controls.
    pub(crate) fn with_velocity_deviation(mut self, deviation_mps: f32) -> Self {
        if let Self::Walker(_, belief) = &mut self {
            belief.covariance[(2, 2)] += deviation_mps * deviation_mps;
            belief.covariance[(3, 3)] += deviation_mps * deviation_mps;
        }
        self
    }

    /// The moment of the agent at the end of its history, for the memory of the place.
    pub(crate) fn moment(&self, history: &[Option<State>]) -> Option<Moment> {
        match self {
            Self::Vehicle(motion, _) => Moment::driving(history, motion.dt_s),
            Self::Walker(..) => Moment::walking(history),
        }
    }

    /// What the agent's controls have to be changed by so that its path departs so.
    pub(crate) fn changes(&self, departures: &Departures) -> Change {
        match self {
            Self::Vehicle(motion, _) => departures.controls(motion.bicycle.rear_axle_m, motion.dt_s),
            Self::Walker(motion, _) => departures.displacements(motion.heading_rad()),
        }
    }

    /// What the controls stand for, and the direction of the axes of displacements.
    pub(crate) fn steering(&self) -> (Steering, f32) {
        match self {
            Self::Vehicle(_, start) => (Steering::Bicycle, start.mean[2]),
            Self::Walker(motion, _) => (Steering::Displacement, motion.heading_rad()),
        }
    }

    /// A control as it acts, after saturation.
    pub(crate) fn acting(&self, control: &ControlGaussian) -> ControlGaussian {
        match self {
            Self::Vehicle(motion, _) => motion.acting(control),
            Self::Walker(motion, _) => motion.acting(control),
        }
    }

    /// A control that acts as a forecast tells it.
    pub(crate) fn told(&self, acting: &ControlGaussian) -> wire::ControlGaussian {
        let mean = match self {
            Self::Vehicle(..) => acting.mean,
            Self::Walker(motion, start) => motion.residual(&acting.mean, [start.mean[2], start.mean[3]]),
        };
        let factor = &acting.cholesky;
        wire::ControlGaussian { mean: mean.into(), cholesky: [factor.m11, factor.m21, factor.m22] }
    }

    /// Mean and covariance of the position after each control that acts: linearised Gaussians.
    pub(crate) fn carry(&self, acting: impl Iterator<Item = ControlGaussian>, out: &mut [Moments]) {
        match self {
            Self::Vehicle(motion, start) => carry(motion, start, acting, out),
            Self::Walker(motion, start) => carry(motion, start, acting, out),
        }
    }

    /// Mean and covariance of the position after each control, before saturation: those of particles.
    pub(crate) fn scatter(
        &self,
        controls: impl Iterator<Item = ControlGaussian>,
        particles: usize,
        normals: &mut Normals,
        out: &mut [Moments],
    ) {
        match self {
            Self::Vehicle(motion, start) => scatter(motion, start, controls, particles, normals, out),
            Self::Walker(motion, start) => scatter(motion, start, controls, particles, normals, out),
        }
    }

    /// The positions that the means of the controls lead to.
    pub(crate) fn follow(&self, controls: impl Iterator<Item = ControlGaussian>, out: &mut [[f32; 2]]) {
        match self {
            Self::Vehicle(motion, start) => drive(motion, start, controls, out),
            Self::Walker(motion, start) => drive(motion, start, controls, out),
        }
    }
}

fn vehicle(
    now: &State,
    history: &[Option<State>],
    length_m: f32,
    options: &SamplerOptions,
    dt_s: f32,
) -> Mover {
    let length_m = if length_m > 0.0 { length_m } else { options.default_length_m };
    let rear_axle_m = options.rear_axle_ratio * length_m;
    // Along the heading: negative in reverse.
    let [speed_mps, _] = AgentFrame::new(now.position_m, now.heading_rad).rotate_into(now.velocity_mps);
    let slip_rad = match options.initial_slip {
        true => initial_slip(rear_axle_m, speed_mps, turn_rates(history, dt_s)),
        false => 0.0,
    };
    let bicycle =
        Bicycle { rear_axle_m, slip_limit_rad: options.slip_limit_rad, integrator: options.integrator };
    let [x, y] = now.position_m;
    let start = Belief::certain(Vector5::new(x, y, now.heading_rad, speed_mps, slip_rad));
    Mover::Vehicle(Vehicle { bicycle, limits: options.limits, dt_s }, start)
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

fn carry<const N: usize>(
    motion: &impl Motion<N>,
    start: &Belief<N>,
    acting: impl Iterator<Item = ControlGaussian>,
    out: &mut [Moments],
) {
    let mut belief = *start;
    for (control, out) in acting.zip(out) {
        belief.advance_by(motion, &control);
        *out = belief.position();
    }
}

fn scatter<const N: usize>(
    motion: &impl Motion<N>,
    start: &Belief<N>,
    controls: impl Iterator<Item = ControlGaussian>,
    particles: usize,
    normals: &mut Normals,
    out: &mut [Moments],
) {
    let mut cloud = [start.mean; PARTICLES_MAX];
    let cloud = &mut cloud[..particles];
    cloud.fill_with(|| start.sample(normals));
    for (control, out) in controls.zip(out) {
        advance_particles(motion, &control, cloud, normals);
        *out = spread(cloud.iter().map(|particle| [particle[0], particle[1]]));
    }
}

fn drive<const N: usize>(
    motion: &impl Motion<N>,
    start: &Belief<N>,
    controls: impl Iterator<Item = ControlGaussian>,
    out: &mut [[f32; 2]],
) {
    let mut state = start.mean;
    for (control, out) in controls.zip(out) {
        let (acting, _) = motion.saturate(&control.mean);
        state = motion.step(&state, &acting);
        *out = [state[0], state[1]];
    }
}
