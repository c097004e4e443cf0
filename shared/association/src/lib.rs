//! Data association: which detection belongs to which track.
//!
//! Gating leaves a few possible detections for each track. Each possible pair has a cost and is a
//! [`Candidate`]. Two algorithms turn the candidates into corrections of the tracks:
//!
//! * [`assignment`] chooses one detection or none for each track, at the least total cost (global nearest
//!   neighbour, GNN).
//! * [`jpda`] gives each pair its probability, over all joint pairings of tracks and detections (joint
//!   probabilistic data association).
//!
//! Both solve each *connected component* (tracks and detections that candidates connect) separately. Neither
//! depends on the meaning of a track, because the caller computes the costs. [`assignment`] also matches
//! truths with tracks in the evaluation of tracking.
//!
//! ```
//! use association::Candidate;
//! use association::assignment::Assigner;
//!
//! // Track 0 is nearest to detection 0, but only track 0 can have detection 1.
//! let pair = |track, detection, cost| Candidate { track, detection, cost };
//! let mut candidates = vec![pair(0, 0, 1.0), pair(0, 1, 2.0), pair(1, 0, 1.5)];
//! let mut paired = [None; 3];
//! Assigner::default().solve(&mut candidates, 2, 10.0, &mut paired);
//! assert_eq!(paired, [Some(1), Some(0), None]);
//! ```

pub mod assignment;
mod components;
pub mod jpda;

/// A pair of track and detection within the gate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Number of the track.
    pub track: u32,
    /// Number of the detection.
    pub detection: u32,
    /// Cost of the pair; finite.
    pub cost: f64,
}
