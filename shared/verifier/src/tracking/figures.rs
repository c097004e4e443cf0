use std::collections::BTreeMap;

use filters::Motion;
use metrics::tracking::{ErrorNorms, PlanarState, StateErrors};
use serde::Deserialize;

use super::table::Table;
use crate::VerifyError;

/// The deviations of the runs from the truth, by their keys in `parameters.json`.
#[derive(Default, Deserialize)]
#[serde(transparent)]
pub(super) struct Figures(BTreeMap<String, OfRun>);

/// Root mean square errors, mean of the NIS and number of ticks.
#[derive(Deserialize)]
struct OfRun {
    pos_rmse: f64,
    vel_rmse: f64,
    pos_rmse_visible: f64,
    pos_rmse_occluded: f64,
    vel_rmse_visible: f64,
    vel_rmse_occluded: f64,
    nis_mean: f64,
    n: u64,
}

impl Figures {
    /// The figures of a run, in the order of [`Truth::figures`].
    pub(super) fn of(&self, run: &str) -> Option<[f64; 8]> {
        self.0.get(run).map(|of| {
            [
                of.pos_rmse,
                of.vel_rmse,
                of.pos_rmse_visible,
                of.pos_rmse_occluded,
                of.vel_rmse_visible,
                of.vel_rmse_occluded,
                of.nis_mean,
                of.n as f64,
            ]
        })
    }
}

/// A filter's estimate at one tick.
pub(super) struct Sample<'a> {
    /// The tick's row.
    pub(super) at: usize,
    pub(super) visible: bool,
    /// Whether the burn-in of the track is over.
    pub(super) burnt_in: bool,
    pub(super) motion: Option<&'a Motion>,
    /// NaN if nothing was updated.
    pub(super) nis: f64,
}

/// The true motion at every tick.
pub(super) struct Truth(Vec<PlanarState>);

impl Truth {
    pub(super) fn of(table: &Table) -> Result<Self, VerifyError> {
        let rows = table.number_rows(["x", "y", "vx", "vy"])?;
        let state = |[x, y, vx, vy]: [f64; 4]| PlanarState { position_m: [x, y], velocity_mps: [vx, vy] };
        Ok(Self(rows.into_iter().map(state).collect()))
    }

    /// The figures of a run: errors after the burn-in, and the NIS of every update. A figure without a value
    /// is NaN. If an error is not finite, all figures are NaN.
    pub(super) fn figures<'a>(&self, samples: impl Iterator<Item = Sample<'a>>) -> [f64; 8] {
        let mut errors = StateErrors::default();
        let (mut nis_sum, mut update_count) = (0.0, 0_u64);
        for sample in samples {
            if !sample.nis.is_nan() {
                nis_sum += sample.nis;
                update_count += 1;
            }
            let Some(motion) = sample.motion.filter(|_| sample.burnt_in) else { continue };
            let &Motion { position_m, velocity_mps, .. } = motion;
            let estimate = PlanarState { position_m, velocity_mps };
            if errors.add(sample.visible, &self.0[sample.at], &estimate).is_err() {
                return [f64::NAN; 8];
            }
        }
        let rmse = |norms: &ErrorNorms| norms.rmse().unwrap_or(f64::NAN);
        let all = errors.all();
        [
            rmse(&all.position_m),
            rmse(&all.velocity_mps),
            rmse(&errors.visible.position_m),
            rmse(&errors.occluded.position_m),
            rmse(&errors.visible.velocity_mps),
            rmse(&errors.occluded.velocity_mps),
            nis_sum / update_count as f64,
            all.position_m.len as f64,
        ]
    }
}
