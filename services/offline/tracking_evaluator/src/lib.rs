//! Evaluates tracking, beside filters and trackers without forecasts; `stgdat evaluate tracking` calls it.
//!
//! In go recordings in the layout of their data sets and weights ([`evaluator::Options`]), out come reports
//! as Markdown, CSV and JSON.
//!
//! [`interaction()`] measures how well filters estimate the motion of vehicles whose positions are measured
//! with noise and, during gaps, not at all. A `Course` is a recording as such a sensor reports it. A
//! `Follower` runs one filter per agent over it, all agents at once, since the learned prior of one depends
//! on the positions of the others. Every method is tuned with the same number of trials on recordings outside
//! the evaluation, and all get the same noise and the same gaps.
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
pub(crate) use report::MethodErrors;
pub(crate) use tuning::{TRIALS, Trials, tune};

/// The head of the figures of [`TrackingReport::csv`] and [`KittiReport::csv`], which are lines of one table.
pub const COLUMNS: &str =
    "part,sigma_m,gap_s,sequences,least_score,class,method,quantity,measure,value,len,weights_sha256\n";
