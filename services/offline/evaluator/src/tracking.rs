//! Evaluates tracking, compared with filters and trackers without forecasts (`stgdat evaluate tracking`).
//!
//! **In:** recordings in the layout of their data sets, and weights ([`Options`](crate::footage::Options)). **Out:**
//! reports as Markdown, CSV and JSON.
//!
//! [`interaction()`] measures how well filters estimate vehicles' motion from noisy positions with gaps. A
//! `Course` is a recording as such a sensor reports it. A `Follower` runs one filter per agent over it. It
//! runs all agents together, because the learned prior of an agent depends on the positions of the others.
//! Every method is tuned with the same number of trials on recordings outside the evaluation. All methods get
//! the same noise and the same gaps.
//!
//! [`kitti()`] evaluates whole trackers on a detector's output, by identities and positions.

mod course;
mod follower;
mod hypotheses;
mod kitti;
mod method;
mod outcome;
mod protocol;
mod report;
mod singer;
mod smoother;
mod tuning;

pub use kitti::{Contender, MakeTracks, Published, PublishedTrack};
pub use protocol::{interaction, kitti};

pub(crate) use course::{Course, Sensor};
use course::{Instant, Seen};
pub(crate) use follower::Follower;
pub(crate) use hypotheses::Place;
use hypotheses::{Estimate, Hypotheses, OnboardForecasts};
pub(crate) use kitti::{
    ByClass, CLASSES, Counts, KittiMeasure, KittiPart, KittiRow, LEAST_SCORES, Sequence, class_name,
    nearest_neighbours, page as kitti_page,
};
pub(crate) use method::TrackingMethod;
use method::{ACCELERATION_MPS2, Setting, Settings, TURN_RATE_RADPS, UNKNOWN, control_gains};
pub(crate) use outcome::Outcome;
use outcome::{Error, SETTLED_S};
pub(crate) use report::{MethodErrors, TrackingReport};
use singer::SingerBicycle;
use smoother::smooth;
pub(crate) use tuning::{TRIALS, Trials, tune};
