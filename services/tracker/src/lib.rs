//! Makes tracks of detections: which detection belongs to which agent, and how each agent moves.
//!
//! A *detection* is what the sensor saw of one object at one time. A *track* is the estimated past of one agent; its
//! id is never reused. Every frame takes the same way: each track's filter ([`filters`]) is predicted to the frame's
//! stamp, detections are associated with tracks ([`filters::assignment`]; recordings that carry identities go by these), paired
//! tracks are updated, the others count a miss, and detections without a track start one.
//!
//! A new track is *tentative*: unpublished until three of the last five frames that looked for its type have seen it
//! and it surely exists, or at once where identities can be trusted. A track that is not seen is *coasting*: predicted and published until
//! it was missed for too long, at most over the forecast's horizon. Where the sensor's place is known, a track that is hidden behind
//! others is hardly missed: it coasts for longer, and takes fewer detections for its own.
//!
//! The tracks that are published carry their history at exact Δt spacing, taken from what was published before.
//!
//! What is believed of an agent, its *estimate*, follows from the frames and the forecasts that came with them, in the order of
//! their stamps: where one comes late, it is made again from there. What has been told of the agent, its *publication*, stays as it is.

mod belief;
mod class;
mod estimate;
mod estimates;
mod field_of_view;
mod forecasts;
mod front;
mod grid;
mod history;
mod life;
mod observed;
mod occlusion;
mod options;
mod pairing;
mod publication;
mod scans;
mod settings;
pub mod stage;
mod tally;
mod tracker;

pub use field_of_view::{FieldOfView, UnknownFieldOfView};
pub use options::{
    Association, ForecastTrust, InputModel, MotionNoise, Options, Prior, STAGE, SensorNoise, TrackerOptions,
};
pub use tally::Tally;
pub use tracker::{Tracked, Tracker};
