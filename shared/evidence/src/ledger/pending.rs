//! Forecasts that have not matured.

use super::Knowledge;
use crate::paths::weighted_m;
use crate::{BANDS, Context, EXPERTS, KNOTS};

/// A forecast of an agent that has not matured.
#[derive(Clone, Debug)]
pub(super) struct Pending {
    pub(super) stamp_ns: i64,
    pub(super) context: Context,
    /// Knots that have matured.
    pub(super) matured_len: usize,
    pub(super) velocity_m: [[f32; 2]; KNOTS],
    /// Middle of the fan.
    pub(super) centre_m: [[f32; 2]; KNOTS],
    /// Less constant velocity.
    pub(super) regression_m: [[f32; 2]; KNOTS],
    pub(super) course: [f32; 2],
    /// What the truth is beyond the middle of the fan along and across the course, at the knots that have
    /// matured, m.
    pub(super) residuals_m: [[f32; 2]; KNOTS],
    /// Less constant velocity.
    pub(super) experts_m: [[[f32; 2]; EXPERTS]; KNOTS],
    /// Its place among the mixtures.
    pub(super) mixture: Option<usize>,
}

impl Pending {
    /// How much nearer to the truth at a knot the network was than the blend of a road that it does not know,
    /// as a share of how far agents alike deviate. The truth is less constant velocity.
    pub(super) fn network_nearer(
        &self,
        knot: usize,
        truth_m: [f32; 2],
        deviation_m: f32,
        at_speeds: &[Knowledge; BANDS],
    ) -> f32 {
        let missed_m = |[x, y]: [f32; 2]| (truth_m[0] - x).hypot(truth_m[1] - y);
        let weights = self.context.between(|band| *at_speeds[band].blend[knot].strange_weights());
        let experts_m = &self.experts_m[knot];
        let [along_m, across_m] = self.context.between(|band| at_speeds[band].deviations_m(knot));
        let typical_m = along_m.hypot(across_m).max(deviation_m);
        (missed_m(weighted_m(&weights, experts_m)) - missed_m(experts_m[0])) / typical_m
    }
}
