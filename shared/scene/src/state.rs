use wire::{HISTORY_MAX, HistoryState, Track};

/// The kinematic state of an agent at one time, in the world frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// Position (x, y).
    pub position_m: [f32; 2],
    /// Velocity (vx, vy).
    pub velocity_mps: [f32; 2],
    /// Heading, counter-clockwise from +x. It is also defined at rest.
    pub heading_rad: f32,
}

impl State {
    /// The state of a history step; `None` if the track was absent.
    #[must_use]
    pub fn of(step: &HistoryState) -> Option<Self> {
        (step.present != 0).then_some(Self {
            position_m: [step.x_m, step.y_m],
            velocity_mps: [step.vx_mps, step.vy_mps],
            heading_rad: step.heading_rad,
        })
    }

    /// Magnitude of the velocity, m/s.
    pub fn speed_mps(&self) -> f32 {
        self.velocity_mps[0].hypot(self.velocity_mps[1])
    }
}

/// The states of a track's history, oldest first. The first `history_len` entries are valid.
#[must_use]
pub fn track_history(track: &Track) -> [Option<State>; HISTORY_MAX] {
    std::array::from_fn(|step| State::of(&track.history[step]))
}
