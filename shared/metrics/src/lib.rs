//! How good forecasts are, and what they have to beat.
//!
//! *Measures* compare the forecasts of an agent with its later positions: the mean (ADE) and the last (FDE) distance,
//! of one trajectory or of the best of several, misses, density at the truth, coverage of the stated uncertainty,
//! collisions and broken limits. *Baselines* forecast without learning (constant velocity and relatives) or with
//! nothing but a table of typical residuals ([`Anchors`]); they see the same windows and are printed beside the model.
//! Measures of *tracking*, of what is rather than of what will be, stand in a module of their own: [`tracking`].
//!
//! A *truth* is a slice with one entry per step of the horizon, `None` where nobody knows the position; such steps
//! count nowhere. A trajectory may be longer than the truth (payloads have room for the longest horizon), never
//! shorter. All sums are f64 and in the order of the calls, so that a repeated evaluation agrees to the bit;
//! accumulators ([`Mean`], [`Share`], [`DisplacementMean`]) of several parts can be merged.

mod anchors;
mod baseline;
mod bootstrap;
mod collision;
mod density;
mod displacement;
mod kmeans;
mod limits;
mod mean;
mod region;
mod steering;
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
    Displacement, DisplacementMean, MISS_RADIUS_M, best_of, displacement, joint_best_of, joint_spread,
    most_likely, part_way,
};
pub use kmeans::{Clusters, kmeans};
pub use limits::{BicycleLimits, Limits, PointLimits};
pub use mean::{Mean, Share};
pub use region::highest_density_level;

/// A position (x, y) in metres.
pub type Point = [f32; 2];

pub(crate) fn distance_m(a: Point, b: Point) -> f64 {
    (f64::from(a[0]) - f64::from(b[0])).hypot(f64::from(a[1]) - f64::from(b[1]))
}
