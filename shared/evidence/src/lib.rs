//! Evidence while it runs: what each expert's forecasts turned out to be worth, and how wide regions must be.
//!
//! A network is good where it was trained, and may be worse than constant velocity elsewhere; nothing in its
//! input says so. Its matured forecasts do. Every forecast is kept until the agent has taken its steps, and
//! then tells three things of its [context](Context), the type and speed of the agent:
//!
//! * **How to blend.** Experts are the network, the base control, a decaying turn and a decaying acceleration;
//!   constant velocity is what remains. With d_e an expert's position less constant velocity's and y the truth
//!   less it, a regression finds weights of the least mean distance over all matured forecasts, discounted by age,
//!   none negative and at most 1 in sum, by squares that are weighted with the distance r missed so far
//!   ([iteratively reweighted](https://doi.org/10.1007/s10479-008-0352-z)):
//!
//! ```text
//! w = argmin wᵀ A w − 2 bᵀ w,  w ≥ 0, Σ w ≤ 1      A = n₀ A₀ + Σ D Dᵀ / (r σ),  b = n₀ b₀ + Σ D y / (r σ)
//! ```
//!
//!   σ is how far agents alike deviate; it takes the unit away, so that the prior counts for n₀ forecasts. An
//!   expert that has been nearer than this regression is the forecast alone; of cyclists, of whom few are about, only
//!   constant velocity is, and sooner. A₀ and b₀ are the
//!   [prior](Prior): such sums per forecast, over recordings that the network never saw, where ‖y‖² + max
//!   ‖d_e‖² stands for r σ, so that no forecast tells others more than another. With the probability that the
//!   network knows the road they are those of a network that is right:
//!   [Hedge](https://doi.org/10.1006/jcss.1997.1504) by which of the two was nearer.
//! * **How wide.** The level of the highest-density region on whose border the truth lies, as a radius r =
//!   √(−2 ln (1 − level)), is 2.15 at nine of ten forecasts of calibrated regions. Its 0.9 quantile over
//!   matured forecasts, discounted by age, is the factor by which regions widen ([`Evidence::widths`]), times
//!   a correction that all speeds have in common: every miss widens all later regions, every hit narrows them
//!   by a ninth of that ([adaptive conformal inference](https://arxiv.org/abs/2106.00170)).
//!
//! * **Which modes.** Those that stand for both the network's and a [fan](FAN), as wide as agents alike deviate from
//!   its middle ([`Choice`]): more of the set whose nearest mode has been nearer. The middle lies where the fan has been
//!   nearest, about constant velocity, the blend or halfway between them.
//!
//! All are kept at four steps of the horizon and linear between them, and for six speeds between which they
//! are linear too. Nothing here allocates after the start.
//!
//! A network that says "twice as far" where agents keep their velocity:
//!
//! ```
//! use evidence::{Agent, EXPERTS, Evidence, Paths, Prior};
//! use wire::{AgentType, Expert, HORIZON_MAX};
//!
//! const STEP_NS: i64 = 400_000_000;
//! let mut evidence = Evidence::new(12, STEP_NS as u64, &Prior::default());
//! let before = evidence.weights(AgentType::Vehicle, 10.0)[11];
//! for tick in 0..100 {
//!     let x_m = 4.0 * tick as f32;
//!     evidence.observe(tick * STEP_NS, [(1, [x_m, 0.0])]);
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
mod width;

pub use choice::Choice;
pub use context::{BANDS, Context, SPEEDS_MPS, fill_unknown};
pub use fan::{FAN, Fan, Pattern};
pub use ledger::numbers::NUMBERS_LEN;
pub use ledger::{Agent, Evidence, Matured, Mixture};
pub use paths::{MotionNow, Paths};
pub use prior::{ContextPrior, Patterns, Prior, PriorError, Priors};
pub use statistics::Statistics;
pub use width::RADIUS_90;

/// Experts beside constant velocity, in the order of their numbers in [`SLOTS`].
pub const EXPERTS: usize = 4;
/// The slot of each expert in [`wire::Forecast::expert_weights`].
pub const SLOTS: [wire::Expert; EXPERTS] = [
    wire::Expert::Network,
    wire::Expert::Base,
    wire::Expert::DecayingTurn,
    wire::Expert::DecayingAcceleration,
];
/// Steps of the horizon at which evidence is kept.
pub const KNOTS: usize = 4;
/// A residual counts as no more than so many deviations: of jumps of identity there is no end.
pub const OUTLIER: f32 = 6.0;

/// The factor by which sums fade that count for `len` forecasts: for no fewer than one, so that what is known of agents
/// that come rarely outlasts them, and yields to the next.
pub(crate) fn fading(kept: f64, len: f64) -> f64 {
    kept.max((1.0 / len).min(1.0))
}

/// The indices of these steps, of a horizon of so many, in time order; of few steps some come twice.
#[must_use]
pub fn knots(horizon_len: usize) -> [usize; KNOTS] {
    let last = horizon_len.saturating_sub(1);
    [0, (last / 2).min(2), last / 2, last]
}
