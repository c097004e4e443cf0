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
mod interaction;
mod kitti;
mod method;
mod outcome;
mod report;
mod singer;
mod smoother;
mod tuning;

pub use interaction::interaction;
pub use kitti::{Contender, MakeTracks, Published, PublishedTrack, kitti};

use course::{Course, Instant, Seen, Sensor};
use follower::Follower;
use hypotheses::{Estimate, Hypotheses, OnboardForecasts, Place};
use method::{ACCELERATION_MPS2, Setting, Settings, TURN_RATE_RADPS, TrackingMethod, UNKNOWN, control_gains};
use outcome::{Error, Outcome, SETTLED_S};
use report::{MethodErrors, TrackingReport};
use singer::SingerBicycle;
use smoother::smooth;
use tuning::{TRIALS, Trials, tune};
