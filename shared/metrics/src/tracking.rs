//! Measures of tracking: tracks against the truth, frame by frame.
//!
//! A [`Frame`] is one instant: the true objects and the tracks, each with an id and a position. It is
//! validated once (finite positions, unique ids) and sorted by id, so the order of the rows never changes a
//! figure. The caller separates the classes by using one set of accumulators for each.
//!
//! | measure | meaning | source |
//! |---|---|---|
//! | [`ClearMot`] | misses, false tracks, identity switches: MOTA, MOTP | Bernardin & Stiefelhagen 2008 |
//! | [`Identity`] | how long each truth keeps one identity: IDF1 | Ristani et al. 2016 |
//! | [`Hota`] | detection and association, balanced: HOTA | Luiten et al. 2021 |
//! | [`SetDistance::gospa`] | distance of two sets, with its components | Rahmathullah et al. 2017 |
//! | [`SetDistance::ospa`] | the same per object | Schuhmacher et al. 2008 |
//! | [`StateErrors`] | RMSE and MAE of position and velocity | |
//! | `Consistency` (feature `consistency`) | whether covariances fit the errors (NEES, NIS) | Bar-Shalom et al. 2001, §5.4 |
//!
//! The first three take [`Frame`]s in the order of time and return counts at the end. Every ratio follows
//! from these counts. Counts of several recordings can be merged. The ratios of the sum equal the ratios of
//! the recordings joined into one, with separate identities.
//!
//! The definitions follow the field's reference programs: py-motmetrics for [`ClearMot`] and [`Identity`],
//! `TrackEval` for [`Hota`], and Stone Soup for the distances of sets.
//!
//! * K. Bernardin, R. Stiefelhagen: *Evaluating multiple object tracking performance: the CLEAR MOT metrics*,
//!   2008.
//! * E. Ristani et al.: *Performance measures and a data set for multi-target, multi-camera tracking*, 2016.
//! * J. Luiten et al.: *HOTA: a higher order metric for evaluating multi-object tracking*, 2021.
//! * A. S. Rahmathullah et al.: *Generalized optimal sub-pattern assignment metric*, 2017.
//! * D. Schuhmacher et al.: *A consistent metric for performance evaluation of multi-object filters*, 2008.
//! * Y. Bar-Shalom et al.: *Estimation with applications to tracking and navigation*, 2001.

mod clear_mot;
#[cfg(feature = "consistency")]
mod consistency;
mod frame;
mod hota;
mod identity;
mod pairing;
mod set_distance;
mod state_error;

pub use clear_mot::{ClearMot, ClearMotCounts};
#[cfg(feature = "consistency")]
pub use consistency::{Bounds, Consistency, ConsistencySummary, chi_square_bounds, normalised_square};
pub use frame::{Frame, OBJECTS_MAX, Object, Position, Side, TrackingError};
pub use hota::{ALPHAS, AlphaCounts, Hota, HotaCounts, HotaScore, linear_similarity};
pub use identity::{Identity, IdentityCounts};
pub use set_distance::{Gospa, SetDistance};
pub use state_error::{ErrorNorms, MotionErrors, PlanarState, StateErrors};
