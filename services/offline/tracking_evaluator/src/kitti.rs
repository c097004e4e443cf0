//! Evaluates trackers on a detector's output from a moving car, by KITTI's labels.
//!
//! A *contender* makes tracks of a recording. For each it may choose one number per class, the score
//! threshold of the detections that it is given, among the same few for all and on sequences outside its
//! evaluation. Its tracks are matched with the labels within 2 m on the ground, class by class, and counted
//! by all measures ([`Counts`]).

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
