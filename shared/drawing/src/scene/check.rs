//! Refuses invalid input before anything is drawn.

use metrics::Point;

use wire::tick_view::ForecastView;

use super::content::{AgentDrawing, SceneDrawing, SceneOptions};
use crate::error::{PictureError, within};

/// Maximum numbers of agents in a panel, modes of an agent and steps of a trajectory.
const AGENTS_MAX: usize = 4096;
const MODES_MAX: usize = 256;
const STEPS_MAX: usize = 1024;

pub fn options(options: &SceneOptions) -> Result<(), PictureError> {
    within("the width in pt", options.width, 72.0, 7200.0)?;
    within("the number of columns", options.columns as f64, 1.0, 16.0)?;
    within("the height of a panel relative to its width", options.height_per_width, 0.1, 10.0)?;
    within("the least extent in m", options.extent_min_m.unwrap_or(1.0), 0.1, 1e5)
}

pub fn panels(drawings: &[SceneDrawing<'_>], panels_max: usize) -> Result<(), PictureError> {
    if drawings.iter().all(|drawing| drawing.agents.is_empty()) {
        return Err(PictureError::Empty);
    }
    within("the number of panels", drawings.len() as f64, 1.0, panels_max as f64)?;
    for drawing in drawings {
        within("the number of agents", drawing.agents.len() as f64, 0.0, AGENTS_MAX as f64)?;
        drawing.agents.iter().try_for_each(agent)?;
    }
    Ok(())
}

fn agent(AgentDrawing { agent, truth }: &AgentDrawing) -> Result<(), PictureError> {
    let id = agent.known_as();
    let known =
        |points: &[Option<Point>]| -> Vec<f32> { points.iter().flatten().flatten().copied().collect() };
    finite(id, "position", &agent.position_m)?;
    finite(id, "heading", &[agent.heading_rad])?;
    finite(id, "size", &[agent.length_m.unwrap_or(1.0), agent.width_m.unwrap_or(1.0)])?;
    finite(id, "history", &known(&agent.history))?;
    finite(id, "truth", &known(truth))?;
    within("the number of steps", agent.history.len().max(truth.len()) as f64, 0.0, STEPS_MAX as f64)?;
    agent.forecast.as_ref().map_or(Ok(()), |forecast| of_forecast(id, forecast))
}

fn of_forecast(agent: u64, forecast: &ForecastView) -> Result<(), PictureError> {
    let modes_len = forecast.modes.len();
    let step_count = forecast.modes.first().map_or(0, Vec::len);
    let wrong = |problem: String| Err(PictureError::Agent { agent, problem });
    let same = |what: &str, len: usize, expected: usize| match len == expected {
        true => Ok(()),
        false => wrong(format!("{what} has length {len}, expected {expected}")),
    };
    within("the number of modes", modes_len as f64, 1.0, MODES_MAX as f64)?;
    within("the number of steps", step_count as f64, 1.0, STEPS_MAX as f64)?;
    same("the best forecast", forecast.best.len(), step_count)?;
    finite(agent, "best forecast", forecast.best.as_flattened())?;
    same("the modes' probabilities", forecast.probability.len(), modes_len)?;
    same("the modes' covariances", forecast.covariance.len(), modes_len)?;
    finite(agent, "probability", &forecast.probability)?;
    let total: f64 = forecast.probability.iter().map(|probability| f64::from(*probability)).sum();
    within("the sum of an agent's probabilities", total, 0.999, 1.001)?;
    for (mode, (means, covariances)) in forecast.modes.iter().zip(&forecast.covariance).enumerate() {
        within("a mode's probability", f64::from(forecast.probability[mode]), 0.0, 1.001)?;
        same("a mode", means.len(), step_count)?;
        same("a mode's covariances", covariances.len(), step_count)?;
        finite(agent, "forecast", means.as_flattened())?;
        for (step, &covariance) in covariances.iter().enumerate() {
            let [xx, xy, yy] = covariance.map(f64::from);
            // Rounding may leave a thin Gaussian with a determinant just below 0.
            let is_positive = xx >= 0.0 && yy >= 0.0 && xy * xy <= xx * yy * 1.001 + 1e-12;
            if !is_positive || !(xx + yy).is_finite() {
                return wrong(format!("mode {mode}, step {step}: covariance {covariance:?} is not positive"));
            }
        }
    }
    Ok(())
}

fn finite(agent: u64, what: &str, values: &[f32]) -> Result<(), PictureError> {
    if values.iter().all(|value| value.is_finite()) {
        return Ok(());
    }
    Err(PictureError::Agent { agent, problem: format!("its {what} is not finite") })
}
