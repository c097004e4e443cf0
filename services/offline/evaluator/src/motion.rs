//! How the agents of a scene move: from their histories and controls to positions.

use filters::ControlStep;
use kinematics::{ControlGaussian, Moments, MotionModel};
use metrics::Point;
use nn::ModelConfig;
use retrieval::Key;

use crate::Agent;

/// Means and covariances (xx, xy, yy) of the positions of a mode.
pub(crate) type Spread = (Vec<Point>, Vec<[f32; 3]>);

/// An agent at its newest state, known for certain.
///
/// # Panics
/// Where it is absent then.
pub(crate) fn model(agent: &Agent, config: &ModelConfig) -> MotionModel {
    let (now, dt_s) = (agent.newest().expect("a wanted agent is present"), config.dt_s as f32);
    let start = scene::motion_start(&now, &agent.history, agent.length_m, dt_s);
    let kind = nn::motion_kind(config, agent.agent_type);
    MotionModel::new(kind, &start, &nn::motion_options(config), dt_s)
}

/// The key of an agent at the end of its history, for the retrieval memory.
pub(crate) fn key(agent: &Agent, config: &ModelConfig) -> Option<Key> {
    Key::new(nn::motion_kind(config, agent.agent_type), &agent.history, config.dt_s as f32)
}

/// Means and covariances of the positions that so many Gaussian controls lead to, linearised.
pub(crate) fn spread(
    model: &MotionModel,
    controls: impl Iterator<Item = wire::ControlGaussian>,
    len: usize,
) -> Spread {
    let mut moments = vec![Moments::default(); len];
    model.moments(controls.map(|control| model.acting(&gaussian(&control))), &mut moments);
    moments.into_iter().map(|moments| (moments.mean, moments.covariance)).unzip()
}

/// The positions that so many controls lead to.
pub(crate) fn positions(
    model: &MotionModel,
    controls: impl Iterator<Item = [f32; 2]>,
    len: usize,
) -> Vec<Point> {
    let mut positions = vec![[0.0; 2]; len];
    model.positions(controls, &mut positions);
    positions
}

/// A control as it acts, after saturation.
pub(crate) fn acting(model: &MotionModel, control: &wire::ControlGaussian) -> ControlStep {
    let ControlGaussian { mean, cholesky } = model.acting(&gaussian(control));
    ControlStep {
        mean: [mean.x, mean.y].map(f64::from),
        cholesky: [cholesky.m11, cholesky.m21, cholesky.m22].map(f64::from),
    }
}

fn gaussian(control: &wire::ControlGaussian) -> ControlGaussian {
    ControlGaussian::new(control.mean, control.cholesky)
}
