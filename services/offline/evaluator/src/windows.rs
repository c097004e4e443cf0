//! Forecasts of windows with exact states: the data sets of the literature, and any recordings.

mod baselines;
mod eth_ucy;
mod files;
mod group;
mod interaction;
mod judge;
mod observed;
mod protocol;
mod reference;
mod report;
mod sdd;
mod state;
mod tables;
mod tally;

use crate::method::Method;
pub use baselines::Baselines;
pub(crate) use baselines::anchors;
pub use eth_ucy::eth_ucy;
pub use files::Evaluation;
use files::SUBSETS;
pub use group::Group;
use group::{BlockErrors, COMPARED};
pub use interaction::{InteractionPart, interaction};
pub(crate) use judge::Judge;
pub use judge::{Block, Subset};
use observed::Sensor;
use protocol::{Rules, fit, need_agents};
use reference::PaperRow;
pub use report::{Figure, Report};
pub use sdd::sdd;
use state::{Basis, DoubtCount};
pub use state::{State, StateError};
use tables::Column;
pub use tally::{Calibration, Measure, Tally};
