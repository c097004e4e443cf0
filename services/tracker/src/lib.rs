//! Multi-object tracking: builds tracks from detections, with forecasts as the prior.
//!
//! A *detection* is the sensor's measurement of one object at one time. A *track* is the estimated past of
//! one agent. Its id is never reused. [`Tracker::step`] processes a frame of detections in the steps of a
//! recursive Bayesian filter:
//!
//! 1. **Predict.** Each track's [filter](filters) is predicted to the frame's stamp. The prior is a process
//!    model ([`Prior::Kinematic`]), or the pipeline's forecast of the track from an earlier tick
//!    ([`Prior::Learned`]).
//! 2. **Associate.** Gating is followed by optimal assignment or joint probabilistic data association
//!    ([`association`]). If the detections have trusted identities, the identities replace the association.
//! 3. **Update.** A track with a detection is updated, with the noise that earlier detections of its type have
//!    shown. A track without a detection counts a miss. A detection
//!    without a track starts one.
//! 4. **Manage.** A new track is *tentative* and unpublished. It is confirmed when three of the last five
//!    frames that observed its type have detected it and its existence is nearly certain, or immediately if
//!    identities can be trusted. A missed track *coasts*: it is predicted and published until its coast time
//!    ends, at most to the forecast's horizon. If the sensor's position is known, the miss probability
//!    depends on occlusion. A track hidden behind others coasts for longer and is less likely to take a
//!    detection.
//! 5. **Publish.** Each track carries its history at exact Δt spacing, made of the previously published
//!    states. Of noisy detections, these states are smoothed.
//!
//! **Out of sequence.** An *estimate* is the belief about one agent. It depends on the frames and the
//! forecasts that came with them, in the order of their stamps. A frame that arrives after newer ones is
//! processed by rollback and replay. The *publication* of an agent, which is everything published about it,
//! remains unchanged.
//!
//! # Modules
//!
//! Each module imports only from the lines below its own.
//!
//! ```text
//! step                  one tick of the stage, for all drivers
//! feedback              feedback of the newest forecasts for the next stages
//! settings              the run's options
//! tracker               the steps above, frame by frame
//! replay                out-of-sequence frames: scans, checkpoints, rollback
//! estimates             predict, associate, update and manage all agents
//! predecessor           the tracks of a previous process
//! publication           ids and histories as published      pairing   gating and association
//! estimate              one agent: belief, type, front, visibility, track management
//! steady                steady motion and standing     noise     the noise of the detections
//! belief  forecasts     motion and its prior           trials    trials of forecasts
//! class  fit  front  grid  history  observation  occlusion  placeholders  scan  tally  track_management
//! smoothing             smoothing of published histories  tracked
//! options
//! ```

mod belief;
mod class;
mod estimate;
mod estimates;
mod feedback;
mod field_of_view;
mod fit;
mod forecasts;
mod front;
mod frozen;
mod grid;
mod history;
mod noise;
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
mod smoothing;
mod steady;
mod step;
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
pub use settings::settings;
pub use step::run;
pub use tally::Tally;
pub use tracked::Tracked;
pub use tracker::Tracker;
