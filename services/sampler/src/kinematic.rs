use kinematics::{ControlGaussian, Moments, MotionModel};
use scene::AgentType;
use wire::{Expert, Forecast, HORIZON_MAX, POSITION_MAX_M};

/// Spread of the motion of an agent without a learned forecast.
struct Freedom {
    /// Standard deviations of the controls: m/s² and rad/s for vehicles, m per step for others.
    control: [f32; 2],
    /// Standard deviation of the velocity of agents that move by displacements.
    velocity_mps: f32,
}

const fn freedom(agent_type: AgentType) -> Freedom {
    match agent_type {
        AgentType::Vehicle => Freedom { control: [1.0, 0.01], velocity_mps: 0.0 },
        AgentType::Cyclist => Freedom { control: [0.2, 0.2], velocity_mps: 0.4 },
        AgentType::Pedestrian => Freedom { control: [0.12, 0.12], velocity_mps: 0.15 },
    }
}

/// Writes a single mode: zero control, with a covariance that grows.
pub(crate) fn forecast(model: MotionModel, agent_type: AgentType, horizon_len: usize, out: &mut Forecast) {
    let freedom = freedom(agent_type);
    let controls = std::iter::repeat_n(ControlGaussian::centred(freedom.control), horizon_len);
    let mut moments = [Moments::default(); HORIZON_MAX];
    let model = model.with_velocity_deviation(freedom.velocity_mps);
    model.moments(controls, &mut moments);
    out.modes_len = 1;
    out.probability[0] = 1.0;
    out.mode_expert[0] = Expert::ProcessModel as u8;
    for (step, moments) in moments[..horizon_len].iter().enumerate() {
        let position_m = moments.mean.map(|x| x.clamp(-POSITION_MAX_M, POSITION_MAX_M));
        out.modes[0][step] = position_m;
        out.best[step] = position_m;
        out.mean[step] = position_m;
        out.covariance[step] = moments.covariance;
        out.mode_covariance[0][step] = moments.covariance;
    }
}
