//! Data association: which detection belongs to which track.
//!
//! Gating leaves for each track the few detections that may be its own, each pair with a cost: a
//! [`Candidate`]. Two ways lead from there to what corrects the tracks:
//!
//! * [`assignment`] chooses one detection or none for each track, at the least total cost (global nearest
//!   neighbour, GNN).
//! * [`jpda`] gives each pair the probability that it is right, over all ways to pair tracks and detections
//!   at once (joint probabilistic data association).
//!
//! Both solve each *connected component*, tracks and detections that candidates connect, by itself. Neither
//! knows what a track is: costs come from the caller, [`assignment`] also matches truths with tracks when
//! tracking is evaluated.
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

/// A pair of track and detection that the gate lets through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Number of the track.
    pub track: u32,
    /// Number of the detection.
    pub detection: u32,
    /// Cost of the pair; finite.
    pub cost: f64,
}
