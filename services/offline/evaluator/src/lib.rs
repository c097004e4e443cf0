//! Offline checks of the pipeline's parts against references, and of its forecasts against recorded futures.
//!
//! [`verify`] recomputes every tensor of a folder of golden vectors with the very code that runs on board and
//! names those that are off: users run it on their own processor before they trust it.
//!
//! [`eth_ucy`], [`sdd`], [`interaction`] and [`files`] judge forecasts by recorded futures. A *protocol*
//! reads recordings and cuts them into [`Scene`]s. The [`Forecaster`] runs the shipped stages on the `tracks`
//! payloads of scenes; the [`Judge`] does so for every agent that counts, lets the baselines forecast the
//! very same agents and adds up all errors in [`Tally`]s, a [`Block`] of a recording at a time. [`Group`]s of
//! blocks (a fold, a site) make the tables of a [`Report`]. [`ablation()`] compares variants of a model with
//! one another on the same blocks.
//!
//! [`tracking()`] judges filters, with the model's forecasts as their prior and without, by the motion that
//! they estimate; [`kitti()`] judges trackers by the identities and positions that they report.

mod ablation;
mod baselines;
mod error;
mod forecaster;
mod group;
mod judge;
mod maps;
mod method;
pub mod picture;
mod protocol;
mod reference;
mod report;
mod scenes;
mod tally;
mod threads;
mod tracking;
mod tracks;
mod verify;
mod weights;

pub use ablation::{Ablation, AblationRow, Verdict};
pub use baselines::{ANCHOR_AGENTS, Baselines};
pub use error::EvaluateError;
pub use forecaster::{Forecast, Forecaster, Variants};
pub use group::{Contrast, Group};
pub use judge::{Block, Judge, MOVING_MPS, Subset};
pub use maps::{MapInput, site_map};
pub use method::Method;
pub use protocol::{
    InteractionPart, MapChoice, Options, Variant, ablation, eth_ucy, files, interaction, kitti, sdd, tracking,
};
pub use report::{Figure, Report};
pub use scenes::{Agent, Cut, Scene};
pub use tally::{Crowding, Errors, Measure, Sureness, Tally};
pub use tracking::{
    Contender, KittiReport, MakeTracks, Published, PublishedTrack, TRACKING_COLUMNS, TrackingReport,
};
pub use tracks::TracksPayload;
pub use verify::{Comparison, VerifyError, verify};
pub use weights::{Provenance, WeightsChoice};
