//! Measures of forecasts and of tracking, and baselines to compare forecasts with.
//!
//! **Measures of forecasts** compare the forecasts of an agent with its later positions:
//!
//! | measure | function |
//! |---|---|
//! | ADE and FDE of one trajectory | [`displacement()`] |
//! | minADE and minFDE over K modes (minADE₂₀ for 20) | [`min_displacement`] |
//! | the same over joint futures of a scene | [`joint_min_displacement`] |
//! | top-1: the most likely mode | [`most_likely`] |
//! | miss rate at 2 m (MR) | [`Displacement::is_miss`], [`DisplacementMean::miss_rate`] |
//! | density at the truth (KDE-NLL) | [`kde_log_density`] |
//! | calibration: coverage of highest-density regions | [`highest_density_level`] |
//! | collisions between forecasts | [`collisions`] |
//! | violated limits of motion | [`Limits`] |
//!
//! **Measures of tracking**, of estimated rather than of forecast positions, are in [`tracking`]. The paired
//! **bootstrap** ([`paired_bootstrap`]) gives the confidence interval of a difference between two
//! forecasters.
//!
//! **Baselines** get the same windows as the model. They forecast by constant velocity and related models, or
//! by constant velocity with a table of typical residuals ([`Anchors`]).
//!
//! A *truth* is a slice with one entry per step of the horizon. An entry is `None` if the position is
//! unknown; no measure counts such a step. A trajectory may be longer than the truth, because payloads
//! have room for the longest horizon; it is never shorter. All sums are f64 and follow the order of the
//! calls, so a repeated evaluation agrees to the bit. Accumulators ([`Mean`], [`Share`],
//! [`DisplacementMean`]) of several parts can be merged. An [`ExactSum`] is the same in every order.
//!
//! ```
//! use metrics::{DisplacementMean, min_displacement};
//!
//! let truth = [Some([1.0, 0.0]), Some([2.0, 0.0])];
//! let modes = [[[1.0, 0.3], [2.0, 0.5]], [[0.5, 0.0], [1.0, 0.0]]];
//! let best = min_displacement(&modes, &truth);
//! assert_eq!(best.fde_m, Some(0.5));
//!
//! let mut mean = DisplacementMean::default();
//! mean.add(best);
//! assert_eq!(mean.miss_rate.value(), Some(0.0));
//! ```

mod anchors;
mod baseline;
mod bootstrap;
mod collision;
mod density;
mod displacement;
mod kmeans;
mod limits;
mod mean;
mod steering;
mod sum;
pub mod tracking;

pub use anchors::{
    ANCHORS, Anchors, PEDESTRIAN_SPEED_CUTS_MPS, SPEED_BINS, VEHICLE_SPEED_CUTS_MPS, Window, speed_cuts_mps,
};
pub use baseline::{
    ACCELERATION_DECAY_S, CVM_DRAWS, CVM_SIGMA_RAD, TURN_RATE_DECAY_S, constant_acceleration,
    constant_turn_rate, constant_turn_rate_acceleration, constant_velocity, sampled_constant_velocity,
};
pub use bootstrap::{Interval, PairedErrors, cluster_bootstrap, paired_bootstrap, paired_bootstrap_ratio};
pub use collision::{Disc, collisions};
pub use density::{LOG_DENSITY_MIN, kde_log_density};
pub use displacement::{
    Displacement, DisplacementMean, Errors, MISS_RADIUS_M, displacement, interpolated,
    joint_min_displacement, joint_spread, min_displacement, most_likely,
};
pub use kmeans::{Clusters, kmeans};
pub use limits::{Limits, PointLimits};
pub use mean::{Mean, Share};
pub use regions::{HighestDensity, highest_density_level};
pub use steering::BicycleLimits;
pub use sum::{ExactMean, ExactSum};

/// A position (x, y) in metres.
pub type Point = [f32; 2];

pub(crate) fn distance_m(a: Point, b: Point) -> f64 {
    (f64::from(a[0]) - f64::from(b[0])).hypot(f64::from(a[1]) - f64::from(b[1]))
}
