//! The retrieval memory of a site: corrects forecasts online by the residuals of earlier ones.
//!
//! A model that was not trained at a site has no information on its stop lines, its bends and the places
//! where agents slow down. The agents that were recently forecast there provide it without training: a
//! *memory bank* is filled online and read by nearest neighbours.
//!
//! # The idea
//!
//! * An **entry** consists of a [`Key`] and **forecast residuals** ([`Residuals`]). The key is the position
//!   and motion of an agent at a time. The residuals are the actual path from there minus the forecast path,
//!   step by step. A step is filled in after it was taken, so an entry never contains future data. The
//!   forecast is the model's own, before any retrieval.
//! * To **retrieve**, the agent's key is compared with nearby stored keys by a Gaussian **similarity kernel**
//!   k = exp(−d²/2) with finite support. d is the distance of position (m), heading (rad), velocity (m/s),
//!   acceleration (m/s²) and turn rate (rad/s) in units of their widths. Entries are in buckets by cell and
//!   heading. The agent's own entries are left out.
//! * The **kernel mean** of the residuals (Nadaraya–Watson, shrunk towards 0) is their common part.
//!   **Shrinkage** multiplies it by a factor from a ridge regression of actual on predicted residuals, which
//!   is updated online. The factor is near 0 if the model was trained at the site, and near 1 if all agents
//!   differ from their forecasts in the same way.
//!
//! ```text
//! Δ_k = Σ w δ_k / (Σ w + ν)                                             for each step k and component
//! Δ'_k = c_k Δ_k,  c_k = Σ Δ_k δ_k / (Σ Δ_k² + ρ) ∈ [0, 1]
//! ```
//!
//! * The [nearest neighbours](Neighbour) are also retrieved individually, at most [`RETRIEVED_MAX`], by a
//!   wider kernel. Their paths are candidate modes. **Mode selection** replaces modes by some of them
//!   ([`ModeSelection`]: weighted k-medoids, solved by greedy interchange from the modes).
//! * Residuals become changes of controls ([`Residuals::control_change`]), so that forecasts remain drivable.
//!   The best forecast is changed by Δ', and modes by half of it. A neighbour's path is the best forecast
//!   changed by that neighbour's residuals ([`ControlAdapter`]).
//! * A **session** is the time during which agents keep their numbers. Entries outlast the session, and in
//!   [files](RetrievalMemory::save) also the process. They are used by the next session (*warm start*).
//!
//! [`Retrieval`] does all of it for one agent of an online pipeline at a time, on any number of threads.
//! [`RetrievalMemory`] and [`ControlAdapter`] do it in parts.
//!
//! In this example, vehicles with a forecast of a constant 8 m/s pass in turn, and all brake at 1 m/s². The
//! code then retrieves for the next vehicle:
//!
//! ```
//! use kinematics::{MotionKind, MotionModel, MotionOptions, MotionStart};
//! use retrieval::{BicycleKey, Key, Query, RetrievalMemory, Retrieved};
//!
//! const STEP_NS: i64 = 400_000_000;
//! let mut memory = RetrievalMemory::new(6, STEP_NS as u64);
//! let mut retrieved = Retrieved::default();
//! let key = Key::Bicycle(BicycleKey { speed_mps: 8.0, ..BicycleKey::default() });
//! let forecast_m: Vec<[f32; 2]> = (1..=6).map(|step| [8.0 * 0.4 * step as f32, 0.0]).collect();
//! let mut stamp_ns = 0;
//! for agent in 0..50 {
//!     for step in 0..=6 {
//!         let t_s = 0.4 * step as f32;
//!         stamp_ns += STEP_NS;
//!         memory.observe(stamp_ns, [(agent, [8.0 * t_s - 0.5 * t_s * t_s, 0.0])]);
//!         if step == 0 {
//!             memory.retrieve_and_store(&Query { stamp_ns, agent, key }, &forecast_m, &mut retrieved);
//!         }
//!     }
//! }
//! memory.retrieve(99, &key, &mut retrieved);
//! assert_eq!(retrieved.neighbours.len(), 50);
//!
//! // As controls: about −1 m/s² at every step but the last, whose final speed is unknown.
//! let start = MotionStart { velocity_mps: [8.0, 0.0], ..MotionStart::default() };
//! let model = MotionModel::new(MotionKind::Bicycle, &start, &MotionOptions::default(), 0.4);
//! let change = retrieved.expected.control_change(&model);
//! assert!(change[1..5].iter().all(|[acceleration, _]| (acceleration + 1.0).abs() < 0.2), "{change:?}");
//! ```

mod controls;
mod expectation;
mod file;
mod index;
mod key;
mod memory;
mod residuals;
mod retrieval;
mod selection;
mod stored;

pub use controls::{ControlAdapter, ControlChanges, ForecastControls};
pub use file::MemoryError;
pub use key::{BicycleKey, Bucket, DisplacementKey, Key};
pub use memory::{CHANGED_MAX, Neighbour, Query, RetrievalMemory, Retrieved, Unstored};
pub use residuals::{ControlChange, Residuals};
pub use retrieval::Retrieval;
pub use selection::ModeSelection;
pub use stored::{StoredEntry, StoredState};

/// Maximum number of neighbours that are retrieved individually: the most similar ones.
pub const RETRIEVED_MAX: usize = 64;
