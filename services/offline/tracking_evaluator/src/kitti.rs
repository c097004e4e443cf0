//! How well trackers tell who is where: a detector's output from a moving car, judged by the labels.
//!
//! A *contender* makes tracks of a recording. Whatever it is, it may choose one number per class, the least score of the
//! detections that it is given: the same few are tried for all, on sequences that it is not judged by. What it publishes is
//! matched with the labels within 2 m of the ground, class by class, and counted by all measures at once ([`Counts`]).

mod counts;
mod nearest;
mod report;
mod sequence;

pub use report::KittiReport;
pub use sequence::{Contender, MakeTracks, Published, PublishedTrack};

pub(crate) use counts::{Counts, GATE_M, KittiMeasure};
pub(crate) use nearest::nearest_neighbours;
pub(crate) use report::{KittiPart, KittiRow};
pub(crate) use sequence::{ByClass, CLASSES, LEAST_SCORES, Sequence, class_name};
