//! Multi-object tracking: makes tracks of detections, with forecasts as the prior.
//!
//! A *detection* is what the sensor measured of one object at one time. A *track* is the estimated past of
//! one agent; its id is never reused. [`Tracker::step`] processes a frame of detections in the steps of a
//! recursive Bayesian filter:
//!
//! 1. **Predict.** Each track's [filter](filters) is predicted to the frame's stamp. The prior is a process
//!    model ([`Prior::Kinematic`]), or the forecast that the pipeline made of the track at an earlier tick
//!    ([`Prior::Learned`]).
//! 2. **Associate.** Gating, then optimal assignment or joint probabilistic data association
//!    ([`association`]); recordings whose detections carry identities go by these.
//! 3. **Update.** A track with a detection is updated, one without counts a miss, a detection without a track
//!    starts one.
//! 4. **Manage.** A new track is *tentative*: unpublished until three of the last five frames that observed
//!    its type have detected it and its existence is near certain, or at once where identities can be
//!    trusted. A track that is missed *coasts*: it is predicted and published until its coast time is over,
//!    at most to the forecast's horizon. Where the sensor's position is known, the miss probability depends
//!    on occlusion: a track hidden behind others coasts for longer, and is less likely to take a detection.
//! 5. **Publish.** Each track carries its history at exact Δt spacing, made of the states published before.
//!
//! **Out of sequence.** An *estimate*, the belief about one agent, depends on the frames and the forecasts
//! that came with them, in the order of their stamps. A frame that arrives after newer ones is processed by
//! rollback and replay. What is published of an agent, its *publication*, stays as it is.
//!
//! # Modules
//!
//! Each module imports only from the lines below its own.
//!
//! ```text
//! stage                 the ports
//! feedback              what the newest forecasts tell the stages that follow
//! settings              the run's options
//! tracker               the steps above, frame by frame
//! replay                out-of-sequence frames: scans, checkpoints, rollback
//! estimates             predict, associate, update and manage all agents
//! predecessor           the tracks of a process before
//! publication           ids and histories as published      pairing   gating and association
//! estimate              one agent: belief, type, front, visibility, track management
//! belief  forecasts     motion and its prior           trials    what forecasts are worth
//! class  front  grid  history  observation  occlusion  placeholders  scan  tally  track_management
//! tracked
//! options
//! ```

mod belief;
mod class;
mod estimate;
mod estimates;
pub mod feedback;
mod field_of_view;
mod forecasts;
mod front;
mod frozen;
mod grid;
mod history;
mod missing;
mod observation;
mod occlusion;
mod options;
mod pairing;
mod placeholders;
mod predecessor;
mod publication;
mod replay;
mod scan;
mod settings;
pub mod stage;
mod tally;
mod track_management;
mod tracked;
mod tracker;
mod trials;

pub use field_of_view::{FieldOfView, UnknownFieldOfView};
pub use options::{
    Association, ForecastTrust, InputModel, MotionNoise, Options, Prior, STAGE, SensorNoise, TrackerOptions,
};
pub use predecessor::Predecessor;
pub use tally::Tally;
pub use tracked::Tracked;
pub use tracker::Tracker;
