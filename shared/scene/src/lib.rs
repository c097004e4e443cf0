//! The scene around the robot: agent states, their frames of reference, features, interaction graph and
//! context maps.

pub mod file;

mod features;
mod graph;
mod map;
mod motion;
mod state;

pub use features::{AgentFrame, FeatureScales, MOVING_MPS, agent_frame, relation_features, state_features};
pub use file::FileError;
pub use graph::{EdgeRule, NEIGHBOURS_MAX, Vertex};
pub use map::{CELLS_MAX, ContextMap, MapBuilder, ONLINE_SIDE, OnlineMap, PatchOptions, extent};
pub use motion::{motion_start, states_from_positions, turn, turn_rates};
pub use state::{State, track_history};
pub use wire::AgentType;
