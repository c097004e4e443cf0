//! Pending forecasts: those that have not matured.

use super::Knowledge;
use crate::paths::weighted_m;
use crate::{BANDS, Context, EXPERTS, KNOTS};

/// A pending forecast of an agent.
#[derive(Clone, Debug)]
pub(super) struct Pending {
    pub(super) stamp_ns: i64,
    pub(super) context: Context,
    /// Number of matured knots.
    pub(super) matured_count: usize,
    pub(super) velocity_m: [[f32; 2]; KNOTS],
    /// Centre of the fan.
    pub(super) centre_m: [[f32; 2]; KNOTS],
    /// Relative to constant velocity.
    pub(super) regression_m: [[f32; 2]; KNOTS],
    pub(super) course: [f32; 2],
    /// Offset of the truth from the fan's centre, along and across the course, at the matured knots, m.
    pub(super) residuals_m: [[f32; 2]; KNOTS],
    /// Relative to constant velocity.
    pub(super) experts_m: [[[f32; 2]; EXPERTS]; KNOTS],
    /// Index among the mixtures.
    pub(super) mixture: Option<usize>,
}

impl Pending {
    /// The network's advantage over the blend of an unknown road: the difference of their distances to the
    /// truth at a knot. It is a share of the typical deviation of similar agents. The truth is relative to
    /// constant velocity.
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
