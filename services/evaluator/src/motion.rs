//! From controls to positions: where an agent stands at the end of its history, and how its type moves.

use filters::ControlStep;
use kinematics::{
    Belief, Bicycle, ControlGaussian, ControlLimits, Displacement, DisplacementKind, Integrator, Motion,
    Vehicle, initial_slip,
};
use metrics::Point;
use nalgebra::{Vector2, Vector4, Vector5};
use nn::ModelConfig;
use scene::{AgentFrame, Departures, Moment, State};
use wire::HORIZON_MAX;

use crate::Agent;

/// An agent at its newest state, known for certain.
pub(crate) enum Mover {
    /// By acceleration and slip rate.
    Vehicle(Vehicle, Belief<5>),
    /// By displacements in the agent frame.
    Walker(Displacement, Belief<4>),
}

/// The moment of an agent at the end of its history, for the memory of the place.
pub(crate) fn moment(agent: &Agent, config: &ModelConfig) -> Option<Moment> {
    if config.drives(agent.agent_type) {
        Moment::driving(&agent.history, config.dt_s as f32)
    } else {
        Moment::walking(&agent.history)
    }
}

/// Means and covariances (xx, xy, yy) of the positions of a mode.
pub(crate) type Spread = (Vec<Point>, Vec<[f32; 3]>);

impl Mover {
    pub(crate) fn new(agent: &Agent, now: &State, frame: &AgentFrame, config: &ModelConfig) -> Self {
        let dt_s = config.dt_s as f32;
        let [x, y] = now.position_m;
        if !config.drives(agent.agent_type) {
            let kind = match config.displacement {
                nn::Displacement::Residual => DisplacementKind::Residual,
                nn::Displacement::Absolute => DisplacementKind::Absolute,
            };
            let [vx, vy] = now.velocity_mps;
            let start = Belief::certain(Vector4::new(x, y, vx, vy));
            return Self::Walker(Displacement::new(kind, frame.heading_rad, dt_s), start);
        }
        let rear_axle_m = config.rear_axle_ratio * agent.length_m.unwrap_or(config.default_length_m);
        // Along the heading: negative in reverse.
        let [speed_mps, _] = AgentFrame::new(now.position_m, now.heading_rad).rotate_into(now.velocity_mps);
        let slip_rad = if config.initial_slip {
            initial_slip(rear_axle_m, speed_mps, scene::turn_rates(&agent.history, dt_s))
        } else {
            0.0
        };
        let integrator = match config.integrator {
            nn::Integrator::Euler => Integrator::Euler,
            nn::Integrator::Midpoint => Integrator::Midpoint,
        };
        let bicycle = Bicycle { rear_axle_m, slip_limit_rad: config.slip_limit_rad, integrator };
        let limits = ControlLimits {
            accel_mps2: config.accel_limit_mps2,
            slip_rate_radps: config.slip_rate_limit_radps,
        };
        let start = Belief::certain(Vector5::new(x, y, now.heading_rad, speed_mps, slip_rad));
        Self::Vehicle(Vehicle { bicycle, limits, dt_s }, start)
    }

    /// Means and covariances of the positions that Gaussian controls lead to, linearised.
    pub(crate) fn spread(&self, controls: &[wire::ControlGaussian]) -> Spread {
        match self {
            Self::Vehicle(motion, start) => spread(motion, *start, controls),
            Self::Walker(motion, start) => spread(motion, *start, controls),
        }
    }

    /// A control as it acts, after saturation.
    pub(crate) fn acting(&self, control: &wire::ControlGaussian) -> ControlStep {
        let asked = Vector2::from(control.mean);
        let (acting, slope) = match self {
            Self::Vehicle(motion, _) => motion.saturate(&asked),
            Self::Walker(motion, _) => motion.saturate(&asked),
        };
        let [l11, l21, l22] = control.cholesky;
        ControlStep {
            mean: [acting.x, acting.y].map(f64::from),
            cholesky: [slope.x * l11, slope.y * l21, slope.y * l22].map(f64::from),
        }
    }

    /// The heading of the axes that controls are told in.
    pub(crate) fn heading_rad(&self) -> f32 {
        match self {
            Self::Vehicle(_, start) => start.mean[2],
            Self::Walker(motion, _) => motion.heading_rad(),
        }
    }

    /// What an agent's controls have to be changed by so that its path departs so.
    pub(crate) fn changes(&self, departures: &Departures) -> [[f32; 2]; HORIZON_MAX] {
        match self {
            Self::Vehicle(motion, _) => departures.controls(motion.bicycle.rear_axle_m, motion.dt_s),
            Self::Walker(motion, _) => departures.displacements(motion.heading_rad()),
        }
    }

    /// The positions that certain controls lead to.
    pub(crate) fn follow(&self, controls: impl Iterator<Item = [f32; 2]>) -> Vec<Point> {
        match self {
            Self::Vehicle(motion, start) => follow(motion, start, controls),
            Self::Walker(motion, start) => follow(motion, start, controls),
        }
    }
}

fn spread<const N: usize>(
    motion: &impl Motion<N>,
    mut belief: Belief<N>,
    controls: &[wire::ControlGaussian],
) -> Spread {
    let steps = controls.iter().map(|control| {
        belief.advance(motion, &ControlGaussian::new(control.mean, control.cholesky));
        let position = belief.position();
        (position.mean, position.covariance)
    });
    steps.unzip()
}

fn follow<const N: usize>(
    motion: &impl Motion<N>,
    start: &Belief<N>,
    controls: impl Iterator<Item = [f32; 2]>,
) -> Vec<Point> {
    let mut state = start.mean;
    let steps = controls.map(|control| {
        let (acting, _) = motion.saturate(&Vector2::from(control));
        state = motion.step(&state, &acting);
        [state[0], state[1]]
    });
    steps.collect()
}
