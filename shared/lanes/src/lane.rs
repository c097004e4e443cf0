use wire::AgentType;

/// Maximum number of points of all lanes together.
pub const POINTS_MAX: usize = 8_000_000;
/// Largest distance between the points of a lane.
pub const SPACING_M: f64 = 1.0;

/// A lanelet in one direction.
#[derive(Clone, Debug)]
pub struct Lane {
    /// Number of the lanelet in the file.
    pub id: i64,
    /// Types of agents that use it.
    pub users: Users,
    /// Speed limit; `None` if neither the map nor the kind of road has one.
    pub limit_mps: Option<f32>,
    /// At least two points along the middle, at most [`SPACING_M`] apart, all different.
    pub centre_m: Vec<[f32; 2]>,
    /// Half of the width at each point.
    pub half_width_m: Vec<f32>,
    /// Length along the middle up to each point.
    pub along_m: Vec<f32>,
    /// The bounds, left and right, in the direction of the lane.
    pub bounds_m: [Vec<[f32; 2]>; 2],
    /// Places in [`LaneMap::lanes`](crate::LaneMap::lanes) of the lanes that begin where this one ends.
    pub successors: Vec<u32>,
    /// Places of the lanes to the left and right that an agent may change to.
    pub neighbours: [Option<u32>; 2],
}

impl Lane {
    /// Length along the middle.
    pub fn length_m(&self) -> f32 {
        self.along_m.last().copied().unwrap_or(0.0)
    }
}

/// A set of agent types, one bit each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Users(u8);

impl Users {
    /// The set of these types.
    #[must_use]
    pub fn of(types: &[AgentType]) -> Self {
        Self(types.iter().fold(0, |bits, &agent_type| bits | 1 << agent_type as u8))
    }

    /// Whether the set contains a type.
    #[must_use]
    pub const fn contain(self, agent_type: AgentType) -> bool {
        self.0 & 1 << agent_type as u8 != 0
    }

    pub(crate) const fn shares_any(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    pub(crate) const fn is_empty(self) -> bool {
        self.0 == 0
    }
}
