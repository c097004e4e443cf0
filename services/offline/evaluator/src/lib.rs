//! Evaluates forecasts against recorded futures, and baselines on the very same agents.
//!
//! [`eth_ucy`], [`sdd`], [`interaction`] and [`files`] are *protocols*: each reads recordings and cuts them
//! into [`Scene`]s. The [`Forecaster`] runs the shipped stages on the `tracks` payloads of scenes; the
//! [`Judge`] does so for every agent that counts, lets the baselines forecast the very same agents and adds
//! up all errors in [`Tally`]s, a [`Block`] of a recording at a time. [`Group`]s of blocks (a fold, a site)
//! make the tables of a [`Report`].
//!
//! What other evaluations share lies here too: [`Options`] and [`Footage`] read data sets and weights,
//! [`Table`] writes Markdown, [`threads`] splits work with results that do not depend on their number.

mod baselines;
mod error;
mod forecaster;
mod group;
mod judge;
mod maps;
mod method;
mod protocol;
mod reference;
mod report;
mod scenes;
mod tally;
pub mod threads;
mod tracks;
mod weights;

pub use baselines::{ANCHOR_AGENTS, Baselines};
pub use error::EvaluateError;
pub use forecaster::{Forecast, Forecaster, Variants};
pub use group::{Contrast, Group, RESAMPLES};
pub use judge::{Block, Judge, MOVING_MPS, Subset};
pub use maps::{MapInput, site_map};
pub use method::Method;
pub use protocol::{
    Footage, InteractionPart, MapChoice, Options, SEED, eth_ucy, files, interaction, map_of, sdd,
};
pub use report::{Figure, Report, Table, digits, percent};
pub use scenes::{Agent, Cut, Scene};
pub use tally::{Calibration, Crowding, Errors, Measure, Tally};
pub use tracks::TracksPayload;
pub use weights::{EMBEDDED, Model, Provenance, WeightsChoice};
