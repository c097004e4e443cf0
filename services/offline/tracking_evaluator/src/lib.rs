//! Evaluates tracking, beside filters and trackers without forecasts.
//!
//! [`interaction()`] measures how well filters estimate motion: vehicles whose positions are measured with noise
//! and, now and then, not at all. A `Course` is a recording as such a sensor would give it. A `Follower` runs a
//! filter per agent over it, all agents at once, since the learned prior of one depends on where the others are.
//! Every method is tuned with the same number of trials on recordings that do not count, and all get the same
//! noise and the same gaps.
//!
//! [`kitti()`] evaluates whole trackers by identities and positions, from a detector's output.

mod course;
mod follower;
mod hypotheses;
mod kitti;
mod method;
mod protocol;
mod report;
mod smoother;
mod tuning;

pub use kitti::{Contender, KittiReport, MakeTracks, Published, PublishedTrack};
pub use protocol::{interaction, kitti};
pub use report::TrackingReport;

pub(crate) use course::{Course, Sensor};
pub(crate) use follower::{Follower, Outcome};
pub(crate) use hypotheses::Place;
pub(crate) use kitti::{
    ByClass, CLASSES, Counts, KittiMeasure, KittiPart, KittiRow, LEAST_SCORES, Sequence, nearest_neighbours,
};
pub(crate) use method::TrackingMethod;
pub(crate) use report::Judged;
pub(crate) use tuning::{TRIALS, Trials, tune};

/// The head of the figures of [`TrackingReport::csv`] and [`KittiReport::csv`], which are lines of one table.
pub const COLUMNS: &str =
    "part,sigma_m,gap_s,sequences,least_score,class,method,quantity,measure,value,len,weights_sha256\n";
