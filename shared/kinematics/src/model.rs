use nalgebra::Vector2;

use crate::{
    Belief, BicycleState, ControlGaussian, Displacement, DisplacementState, Moments, Motion, MotionKind,
    MotionOptions, Normals, PARTICLES_MAX, Vehicle, advance_particles, spread,
};

/// The state of an agent at the end of its history, in the world frame. Its motion starts from this state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotionStart {
    /// Position (x, y).
    pub position_m: [f32; 2],
    /// Velocity (vx, vy).
    pub velocity_mps: [f32; 2],
    /// Heading.
    pub heading_rad: f32,
    /// Turn rates of the newest two history intervals, newest first.
    pub turn_rates_radps: [f32; 2],
    /// Direction of the x-axis of the agent frame, in which displacements are given.
    pub frame_heading_rad: f32,
    /// Length, if it is known.
    pub length_m: Option<f32>,
}

/// The equations of motion of an agent, and the state from which its motion starts.
///
/// This is the only place where controls become trajectories. \[model §4\]
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionModel {
    /// By acceleration and slip rate.
    Bicycle {
        /// Equations of motion and saturation.
        motion: Vehicle,
        /// \[x, y, ψ, v, β\] at the end of the history.
        start: Belief<5>,
    },
    /// By displacements in the agent frame.
    Displacement {
        /// Equations of motion.
        motion: Displacement,
        /// \[x, y, vx, vy\] at the end of the history.
        start: Belief<4>,
    },
}

impl MotionModel {
    /// An agent whose start is known exactly.
    ///
    /// The speed of a bicycle is the velocity along its heading, negative in reverse. Its slip angle is
    /// [`MotionOptions::start_slip_rad`].
    #[must_use]
    pub fn new(kind: MotionKind, start: &MotionStart, options: &MotionOptions, dt_s: f32) -> Self {
        let ([x, y], [vx, vy]) = (start.position_m, start.velocity_mps);
        match kind {
            MotionKind::Bicycle => {
                let rear_axle_m = options.rear_axle_m(start.length_m);
                let (sin, cos) = start.heading_rad.sin_cos();
                let speed_mps = cos * vx + sin * vy;
                let slip_rad = options.start_slip_rad(rear_axle_m, speed_mps, start.turn_rates_radps);
                let state = BicycleState::from([x, y, start.heading_rad, speed_mps, slip_rad]);
                let motion = options.vehicle(rear_axle_m, dt_s);
                Self::Bicycle { motion, start: Belief::certain(state) }
            }
            MotionKind::Displacement => {
                let motion = Displacement::new(options.displacement, start.frame_heading_rad, dt_s);
                let start = Belief::certain(DisplacementState::new(x, y, vx, vy));
                Self::Displacement { motion, start }
            }
        }
    }

    /// The kind of the controls.
    pub const fn kind(&self) -> MotionKind {
        match self {
            Self::Bicycle { .. } => MotionKind::Bicycle,
            Self::Displacement { .. } => MotionKind::Displacement,
        }
    }

    /// World heading of the frame of the controls. For a bicycle it is the bicycle's heading at the start,
    /// and for displacements the heading of the agent frame.
    pub fn frame_heading_rad(&self) -> f32 {
        match self {
            Self::Bicycle { start, .. } => start.mean[2],
            Self::Displacement { motion, .. } => motion.heading_rad(),
        }
    }

    /// Covariance of the position at the start as (xx, xy, yy), m².
    pub fn position_covariance(&self) -> [f32; 3] {
        const ENTRIES: [(usize, usize); 3] = [(0, 0), (0, 1), (1, 1)];
        match self {
            Self::Bicycle { start, .. } => ENTRIES.map(|entry| start.covariance[entry]),
            Self::Displacement { start, .. } => ENTRIES.map(|entry| start.covariance[entry]),
        }
    }

    /// The same agent with the heading of a bicycle turned by the slip angle. The course is then the observed
    /// heading, and without turning the bicycle goes straight along it.
    #[must_use]
    pub fn with_course_along_heading(mut self) -> Self {
        if let Self::Bicycle { start, .. } = &mut self {
            start.mean[2] -= start.mean[4];
        }
        self
    }

    /// The same agent with additional variance of the start velocity. It applies to displacements only,
    /// because a bicycle's speed gets its variance from the controls.
    #[must_use]
    pub fn with_velocity_deviation(mut self, deviation_mps: f32) -> Self {
        if let Self::Displacement { start, .. } = &mut self {
            start.covariance[(2, 2)] += deviation_mps * deviation_mps;
            start.covariance[(3, 3)] += deviation_mps * deviation_mps;
        }
        self
    }

    /// A control after saturation: see [`Motion::acting`].
    #[must_use]
    #[inline]
    pub fn acting(&self, control: &ControlGaussian) -> ControlGaussian {
        match self {
            Self::Bicycle { motion, .. } => motion.acting(control),
            Self::Displacement { motion, .. } => motion.acting(control),
        }
    }

    /// An acting control with its mean relative to constant velocity. Displacements of any
    /// [`DisplacementKind`](crate::DisplacementKind) become displacements beyond the start velocity. A
    /// bicycle's controls are already relative.
    #[must_use]
    #[inline]
    pub fn relative_to_start(&self, acting: &ControlGaussian) -> ControlGaussian {
        let mean = match self {
            Self::Bicycle { .. } => acting.mean,
            Self::Displacement { motion, start } => {
                motion.residual(&acting.mean, [start.mean[2], start.mean[3]])
            }
        };
        ControlGaussian { mean, ..*acting }
    }

    /// Writes the position after each control, before saturation: the trajectory of the means.
    ///
    /// The number of positions is the smaller of the lengths of `controls` and `out`. The start is not
    /// written.
    pub fn positions(&self, controls: impl Iterator<Item = [f32; 2]>, out: &mut [[f32; 2]]) {
        match self {
            Self::Bicycle { motion, start } => positions(motion, start, controls, out),
            Self::Displacement { motion, start } => positions(motion, start, controls, out),
        }
    }

    /// Writes controls, before saturation, that lead along a path of one position per step. Displacements
    /// follow the path exactly, and a bicycle follows it as closely as it can.
    ///
    /// The number of controls is the smaller of the lengths of `path_m` and `controls`.
    pub fn follow(&self, path_m: &[[f32; 2]], controls: &mut [[f32; 2]]) {
        match self {
            Self::Bicycle { motion, start } => motion.follow(&start.mean, path_m, controls),
            Self::Displacement { motion, start } => motion.follow(&start.mean, path_m, controls),
        }
    }

    /// Writes mean and covariance of the position after each [acting](MotionModel::acting) control as
    /// linearised Gaussians, see [`Belief::advance`].
    pub fn moments(&self, acting: impl Iterator<Item = ControlGaussian>, out: &mut [Moments]) {
        match self {
            Self::Bicycle { motion, start } => moments(motion, start, acting, out),
            Self::Displacement { motion, start } => moments(motion, start, acting, out),
        }
    }

    /// Writes the position after each [acting](MotionModel::acting) control: the means of
    /// [`MotionModel::moments`], without covariance.
    pub fn means(&self, acting: impl Iterator<Item = ControlGaussian>, out: &mut [Moments]) {
        match self {
            Self::Bicycle { motion, start } => means(motion, start, acting, out),
            Self::Displacement { motion, start } => means(motion, start, acting, out),
        }
    }

    /// Writes mean and covariance of the position after each control, before saturation. The moments come
    /// from `particles` particles drawn from the start, see [`advance_particles`].
    ///
    /// # Panics
    /// If `particles` is above [`PARTICLES_MAX`].
    pub fn particle_moments(
        &self,
        controls: impl Iterator<Item = ControlGaussian>,
        particles: usize,
        normals: &mut Normals,
        out: &mut [Moments],
    ) {
        match self {
            Self::Bicycle { motion, start } => {
                particle_moments(motion, start, controls, particles, normals, out);
            }
            Self::Displacement { motion, start } => {
                particle_moments(motion, start, controls, particles, normals, out);
            }
        }
    }
}

fn positions<const N: usize>(
    motion: &impl Motion<N>,
    start: &Belief<N>,
    controls: impl Iterator<Item = [f32; 2]>,
    out: &mut [[f32; 2]],
) {
    let mut state = start.mean;
    for (control, out) in controls.zip(out) {
        let (acting, _) = motion.saturate(&Vector2::from(control));
        state = motion.step(&state, &acting);
        *out = [state[0], state[1]];
    }
}

fn moments<const N: usize>(
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

fn means<const N: usize>(
    motion: &impl Motion<N>,
    start: &Belief<N>,
    acting: impl Iterator<Item = ControlGaussian>,
    out: &mut [Moments],
) {
    let mut state = start.mean;
    for (control, out) in acting.zip(out) {
        state = motion.step(&state, &control.mean);
        *out = Moments { mean: [state[0], state[1]], ..Moments::default() };
    }
}

fn particle_moments<const N: usize>(
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
