use thiserror::Error;

use crate::declare::numbers;

numbers! {
    /// The kinds of agents that the model distinguishes. Each has its own state MLP, decoder and motion
    /// model.
    #[derive(Hash, PartialOrd, Ord)]
    pub enum AgentType {
        /// Cars, trucks, buses, carts: kinematic bicycle.
        Vehicle = 0 => "vehicle",
        /// Riders of bicycles and similar.
        Cyclist = 1 => "cyclist",
        /// People on foot (and on skates).
        Pedestrian = 2 => "pedestrian",
    }
}

/// All agent types, in the order of their numbers.
pub const AGENT_TYPES: [AgentType; 3] = AgentType::ALL;

/// The number or name does not belong to an agent type.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("unknown agent type {0}: expected vehicle, cyclist or pedestrian")]
pub struct UnknownAgentType(pub String);

impl AgentType {
    /// The type's index in [`AGENT_TYPES`] and in tables by type.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Usual length and width, for an agent of unknown size.
    pub const fn usual_size_m(self) -> [f32; 2] {
        match self {
            Self::Vehicle => [4.5, 1.8],
            Self::Cyclist => [1.8, 0.6],
            Self::Pedestrian => [0.5, 0.5],
        }
    }

    /// The type's bit in [`crate::Header::observed_types`].
    pub const fn bit(self) -> u32 {
        1 << self as u32
    }
}

impl TryFrom<u32> for AgentType {
    type Error = UnknownAgentType;

    fn try_from(number: u32) -> Result<Self, UnknownAgentType> {
        Self::from_number(number).ok_or_else(|| UnknownAgentType(number.to_string()))
    }
}

impl std::str::FromStr for AgentType {
    type Err = UnknownAgentType;

    fn from_str(name: &str) -> Result<Self, UnknownAgentType> {
        AGENT_TYPES
            .into_iter()
            .find(|t| t.name() == name)
            .ok_or_else(|| UnknownAgentType(format!("\"{name}\"")))
    }
}
