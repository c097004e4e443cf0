//! Evaluates trackers on a detector's output from a moving car, against KITTI's labels.
//!
//! 1. A *contender* makes tracks from a recording.
//! 2. It may choose one score threshold per class for its detections. All contenders choose among the same
//!    few thresholds, on sequences outside their evaluation.
//! 3. The tracks of each class are matched with the labels within 2 m on the ground.
//! 4. All measures count the matches ([`Counts`]).

mod counts;
mod nearest;
mod report;
mod sequence;

pub use sequence::{Contender, MakeTracks, Published, PublishedTrack};

pub(crate) use counts::{Counts, GATE_M, KittiMeasure};
pub(crate) use nearest::nearest_neighbours;
pub(crate) use report::{KittiPart, KittiRow, page};
pub(crate) use sequence::{ByClass, CLASSES, LEAST_SCORES, Sequence, class_name};
