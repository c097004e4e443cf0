//! Online evidence: the measured accuracy of each expert's forecasts, and the required width of the regions.
//!
//! A network is good on roads like those that it was trained on, and may be worse than constant velocity on
//! other roads. Its input does not show the difference, but its matured forecasts do. Every forecast is
//! stored until the agent has taken its steps. It then gives three kinds of evidence about its
//! [context](Context), the type and speed of the agent:
//!
//! * **How to blend.** The experts are the network, the base control, a decaying turn, a decaying
//!   acceleration, both in one path behind the vehicle ahead ([`Traffic`]), and the same along a lane. Constant
//!   velocity has the remaining weight. Let d_e be an expert's position and y the
//!   truth, both relative to constant velocity. A regression computes the weights that minimise the mean
//!   distance over all matured forecasts, discounted by age. The weights are nonnegative and at most 1 in
//!   sum. The regression uses squares weighted by the inverse of the distance r missed so far ([iteratively
//!   reweighted](https://doi.org/10.1007/s10479-008-0352-z)):
//!
//! ```text
//! w = argmin wᵀ A w − 2 bᵀ w,  w ≥ 0, Σ w ≤ 1      A = n₀ A₀ + Σ D Dᵀ / (r σ),  b = n₀ b₀ + Σ D y / (r σ)
//! ```
//!
//!   σ is the typical deviation of similar agents. It removes the unit, so that the prior counts for n₀
//!   forecasts. An expert that has been nearer than this regression becomes the only forecast. Few cyclists
//!   are present at a time, so for cyclists only constant velocity can become the only forecast, and does so
//!   sooner.
//!
//!   A₀ and b₀ are the [prior](Prior): the same sums per forecast, over recordings that the network never
//!   saw. There ‖y‖² + max ‖d_e‖² replaces r σ, so that all forecasts have equal weight. With the probability
//!   that the network knows the road, the sums of a network that is right are used instead. That probability
//!   comes from [Hedge](https://doi.org/10.1006/jcss.1997.1504), by which of the two was nearer.
//! * **How wide.** The level of the highest-density region whose border contains the truth gives the radius r
//!   = √(−2 ln (1 − level)). For calibrated regions it is at most 2.15 in nine of ten forecasts. The 0.9
//!   quantile of r over matured forecasts, discounted by age, gives the factor by which regions widen
//!   ([`Evidence::widths`]). A correction that all speeds share multiplies it: every miss widens all later
//!   regions, and every hit narrows them by a ninth of that ([adaptive conformal
//!   inference](https://arxiv.org/abs/2106.00170)).
//! * **Which modes.** The selected modes ([`Choice`]) represent both the network's modes and a [fan](FAN).
//!   The fan is as wide as similar agents deviate from its centre. The set whose nearest mode has been nearer
//!   gets more modes. The centre is between constant velocity and the blend, near the position at which the
//!   fan has been closest to the truth.
//!
//! The learned state is kept at four steps of the horizon and at six speeds, with linear interpolation
//! between them. Nothing here allocates after the start.
//!
//! A network that predicts twice the distance for agents that keep their velocity:
//!
//! ```
//! use evidence::{Agent, EXPERTS, Evidence, Observed, Paths, Prior};
//! use wire::{AgentType, Expert, HORIZON_MAX};
//!
//! const STEP_NS: i64 = 400_000_000;
//! let mut evidence = Evidence::new(12, STEP_NS as u64, &Prior::default());
//! let before = evidence.weights(AgentType::Vehicle, 10.0)[11];
//! for tick in 0..100 {
//!     let x_m = 4.0 * tick as f32;
//!     let observed = Observed { position_m: [x_m, 0.0], covariance_m2: [0.0; 3] };
//!     evidence.observe(tick * STEP_NS, [(1, observed)]);
//!     let velocity = std::array::from_fn(|step| [x_m + 4.0 * (step as f32 + 1.0), 0.0]);
//!     let network = std::array::from_fn(|step| [x_m + 8.0 * (step as f32 + 1.0), 0.0]);
//!     let mut experts = [velocity; EXPERTS];
//!     experts[Expert::Network as usize] = network;
//!     let agent =
//!         Agent { id: 1, agent_type: AgentType::Vehicle, speed_mps: 10.0, course: [1.0, 0.0] };
//!     evidence.store(tick * STEP_NS, &agent, (&Paths { velocity, experts }, &velocity), None);
//! }
//! let after = evidence.weights(AgentType::Vehicle, 10.0)[11];
//! assert!(after[Expert::Network as usize] < 0.1 * before[Expert::Network as usize].max(0.5));
//! ```

mod blend;
mod choice;
mod context;
mod due;
mod familiarity;
mod fan;
mod ledger;
mod paths;
mod prior;
mod sets;
mod share;
mod statistics;
mod traffic;
mod width;

pub use choice::Choice;
pub use context::{BANDS, Context, SPEEDS_MPS, fill_unknown};
pub use due::Matured;
pub use fan::{FAN, Fan, Pattern};
pub use ledger::numbers::NUMBERS_LEN;
pub use ledger::{Agent, Evidence, Mixture, Observed};
pub use paths::{MotionNow, Paths};
pub use prior::{ContextPrior, Patterns, Prior, PriorError, Priors};
pub use statistics::Statistics;
pub use traffic::{Leader, Line, RoadUser, Traffic};
pub use width::RADIUS_90;

/// Number of experts besides constant velocity, in the order of [`SLOTS`].
pub const EXPERTS: usize = 6;
/// The slot of each expert in [`wire::Forecast::expert_weights`]. [`wire::Expert::name_for`] has the experts of
/// pedestrians in the last two slots.
pub const SLOTS: [wire::Expert; EXPERTS] = [
    wire::Expert::Network,
    wire::Expert::Base,
    wire::Expert::DecayingTurn,
    wire::Expert::DecayingAcceleration,
    wire::Expert::Following,
    wire::Expert::Lane,
];
/// Steps of the horizon at which evidence is kept.
pub const KNOTS: usize = 4;
/// Residuals are clipped to this many deviations: identity jumps have no limit.
pub const OUTLIER: f32 = 6.0;

/// The fading factor of sums that count for `len` forecasts. It applies to at least one forecast, so that
/// knowledge about rare agents outlasts them and yields to the next.
pub(crate) fn fading(kept: f64, len: f64) -> f64 {
    kept.max((1.0 / len).min(1.0))
}

/// The step indices of the knots for a horizon, in time order. A short horizon repeats some.
#[must_use]
pub fn knots(horizon_len: usize) -> [usize; KNOTS] {
    let last = horizon_len.saturating_sub(1);
    [0, (last / 2).min(2), last / 2, last]
}
