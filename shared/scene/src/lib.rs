//! The scene around the robot: agent states, their frames of reference, features, interaction graph and context maps.

mod state;

pub use state::State;
pub use wire::AgentType;
