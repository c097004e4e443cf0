//! Evaluates forecasts against recorded futures, and baselines on exactly the same agents.
//!
//! 1. A *protocol* ([`eth_ucy`], [`sdd`], [`interaction`] or [`Evaluation`]) reads recordings and cuts them into
//!    [`Scene`]s.
//! 2. The [`Forecaster`] runs the shipped stages on the `tracks` payloads of scenes.
//! 3. The [`Judge`] compares the forecasts and the baselines for every counted agent. It sums all errors in
//!    [`Tally`]s, one per subset and [`Block`] of a recording.
//! 4. [`Group`]s of blocks (a fold, a site) make the tables of a [`Report`].
//!
//! [`Evaluation`] is for any recordings. Its [`State`] of a recording merges with the states of others.
//!
//! Other evaluations share parts of this crate. [`Options`] and [`Footage`] read data sets and weights, and
//! [`Table`] writes Markdown. [`threads`] splits work; results do not depend on the number of threads.

mod baselines;
mod error;
mod forecast;
mod forecaster;
mod group;
mod judge;
mod lines;
mod maps;
mod matching;
mod method;
mod noise;
mod observed;
mod protocol;
mod reference;
mod report;
mod scenes;
mod state;
mod tally;
pub mod threads;
mod tracks;
mod weights;

pub use baselines::{ANCHOR_AGENTS, Baselines, Candidate};
pub use error::EvaluateError;
pub use forecast::{Forecast, Variants};
pub use forecaster::Forecaster;
pub use group::{Contrast, Group, RESAMPLES};
pub use judge::{Block, Judge, MOVING_MPS, Subset};
pub use lines::{ForecastLine, ForecastLines};
pub use maps::{MapInput, site_map};
pub use matching::{Placed, nearest};
pub use method::Method;
pub use metrics::Errors;
pub use noise::Noise;
pub use protocol::{
    Evaluation, Footage, InteractionPart, MapChoice, Options, SEED, eth_ucy, interaction, map_of, sdd,
};
pub use report::{Figure, Report, Table, digits, percent};
pub use scenes::{Agent, Cut, Scene};
pub use state::{BLOCKS_MAX, DoubtCount, RECORDINGS_MAX, State, StateError};
pub use tally::{Calibration, Crowding, Measure, Tally};
pub use tracks::TracksPayload;
pub use weights::{EMBEDDED, Model, Provenance, WeightsChoice};
