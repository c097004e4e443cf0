use thiserror::Error;

/// The kinds of agents that the model tells apart; each has state MLP, decoder and motion model of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u32)]
pub enum AgentType {
    /// Cars, trucks, buses, carts: kinematic bicycle.
    Vehicle = 0,
    /// Riders of bicycles and similar.
    Cyclist = 1,
    /// People on foot (and on skates).
    Pedestrian = 2,
}

/// All agent types, in the order of their numbers.
pub const AGENT_TYPES: [AgentType; 3] = [AgentType::Vehicle, AgentType::Cyclist, AgentType::Pedestrian];

/// A number or name that stands for no agent type.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("unknown agent type {0}: expected vehicle, cyclist or pedestrian")]
pub struct UnknownAgentType(pub String);

impl AgentType {
    /// The name used in files, weights and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Vehicle => "vehicle",
            Self::Cyclist => "cyclist",
            Self::Pedestrian => "pedestrian",
        }
    }

    /// The type's place in [`AGENT_TYPES`] and in tables by type.
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The type's bit in [`crate::Header::observed_types`].
    #[must_use]
    pub const fn bit(self) -> u32 {
        1 << self as u32
    }
}

impl TryFrom<u32> for AgentType {
    type Error = UnknownAgentType;

    fn try_from(value: u32) -> Result<Self, UnknownAgentType> {
        AGENT_TYPES.get(value as usize).copied().ok_or_else(|| UnknownAgentType(value.to_string()))
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
