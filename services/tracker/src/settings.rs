use config::Run;

use crate::TrackerOptions;

/// The run's settings of the tracker.
#[must_use]
pub fn options(run: &Run) -> TrackerOptions {
    let horizon_s = run.model.dt_s * run.model.horizon_len as f64;
    TrackerOptions {
        history_len: run.model.history_len,
        step_ns: run.model.step_ns(),
        horizon_ns: (horizon_s * 1e9) as u64,
        associate: run.associate,
        prior: run.prior,
        association: run.association,
        view: run.view,
        ..TrackerOptions::default()
    }
}
