use model::ModelConfig;
use run::{OptionError, Run};

use crate::{STAGE, TrackerOptions};

/// The tracker's settings in a run with this model.
///
/// # Errors
/// [`OptionError`] if the run's record has options that the tracker does not have.
pub fn settings(run: &Run, model: &ModelConfig) -> Result<TrackerOptions, OptionError> {
    let options = STAGE.options(run)?;
    let horizon_s = model.dt_s * model.horizon_len as f64;
    Ok(TrackerOptions {
        history_len: model.history_len,
        step_ns: model.step_ns(),
        horizon_ns: (horizon_s * 1e9) as u64,
        associate: options.associate,
        prior: options.prior,
        association: options.association,
        fov: options.fov,
        frozen_frames: options.frozen_frames,
        speed_limits: options.speed_limits(),
        ..TrackerOptions::default()
    })
}
