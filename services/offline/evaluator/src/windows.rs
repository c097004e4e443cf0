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

pub use baselines::Baselines;
pub(crate) use baselines::anchors;
pub use eth_ucy::eth_ucy;
pub use files::Evaluation;
pub use group::Group;
pub use interaction::{InteractionPart, interaction};
pub use judge::{Block, Judge, Subset};
pub use method::Method;
pub use report::{Figure, Report};
pub use sdd::sdd;
pub use state::{State, StateError};
pub use tally::{Calibration, Measure, Tally};
