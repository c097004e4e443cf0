//! Forecasts of windows with exact states: the data sets of the literature, and any recordings.

mod baselines;
mod eth_ucy;
mod files;
mod group;
mod interaction;
mod judge;
mod method;
mod observed;
mod protocol;
mod reference;
mod report;
mod sdd;
mod state;
mod tables;
mod tally;

pub use baselines::{ANCHOR_AGENTS, Baselines};
pub use eth_ucy::eth_ucy;
pub use files::Evaluation;
pub use group::{Contrast, Group};
pub use interaction::{InteractionPart, interaction};
pub use judge::{Block, Judge, Subset};
pub use method::Method;
pub use report::{Figure, Report};
pub use sdd::sdd;
pub use state::{BLOCKS_MAX, DoubtCount, RECORDINGS_MAX, State, StateError};
pub use tally::{Calibration, Measure, Tally};
