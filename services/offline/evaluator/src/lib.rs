//! Evaluates forecasts and tracks against recorded motion, and baselines on exactly the same agents.
//!
//! | input | evaluation |
//! |---|---|
//! | windows with exact states, or with histories of a noisy sensor | [`eth_ucy`], [`sdd`], [`interaction`], and any recordings ([`Evaluation`]), whose [`State`]s merge |
//! | recordings of roads, through the whole pipeline | [`driving`]: forecasts, tracks in gaps, forecasts under noise |
//! | noisy positions with gaps, and a detector's output | [`tracking`]: filters and trackers, with forecasts as their prior and without |
//! | the forecasts of another system, from its bag | [`bag`] |
//! | one recording of a fleet | [`fleet`]: every forecast beside its outcome |
//!
//! All of them read data sets and weights by [`Options`], see the same sensor ([`Noise`]), and write [`Table`]s.
//! Threads share the work; results do not depend on their number.
//!
//! # Modules
//!
//! Each module imports only from the lines below its own.
//!
//! ```text
//! bag  fleet            forecasts of another system; jobs over many recordings
//! driving  tracking     roads through the pipeline; filters and trackers
//! windows               data sets and recordings in windows, and states
//! footage               data sets cut into scenes; the options
//! forecaster            the stages on scenes
//! playback              recordings through the pipeline, beside their motion
//! scenes  matching      what a forecaster sees and the true future; which agent a track follows
//! noise  lines  page    a noisy sensor; the forecasts of a method, as JSON lines; reports in all their forms
//! table  error  threads  method    tables and intervals; why an evaluation fails; shared work; the compared methods
//! ```

pub mod bag;
pub mod driving;
mod error;
pub mod fleet;
mod footage;
mod forecaster;
mod lines;
mod matching;
mod method;
mod noise;
mod page;
mod playback;
mod scenes;
mod table;
mod threads;
pub mod tracking;
mod windows;

pub use error::EvaluateError;
pub use footage::{MapChoice, Options, SEED};
pub use forecaster::{Forecaster, MapInput, TracksPayload, Variants, WeightsChoice};
pub use lines::{Candidate, ForecastLines};
pub use method::Method;
pub use metrics::Errors;
pub use noise::Noise;
pub use page::Page;
pub use playback::Truth;
pub use scenes::{Agent, Cut, MOVING_MPS, Scene};
pub use table::{Entry, Table, digits, pair};
pub use windows::{
    Evaluation, Figure, InteractionPart, Measure, Report, State, StateError, eth_ucy, interaction, sdd,
};
