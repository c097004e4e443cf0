use filters::{Filter, Motion};

use crate::smoothing::Spread;

/// Below this speed a course is meaningless and the last heading is held.
const COURSE_MIN_MPS: f64 = 0.1;

/// The state to publish at the end of a frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Published {
    pub state: Filter,
    pub motion: Motion,
    /// How later frames smooth the state.
    pub spread: Spread,
    /// Whether the agent probably stands, so that its course is meaningless.
    pub is_standing: bool,
    /// Heading. It is held if the state has none.
    pub heading_rad: f64,
    /// The heading while frames arrive in sequence. It turns at a limited rate.
    pub limited_rad: f64,
}

impl Published {
    pub fn new(state: &Filter, heading_rad: f64, limited_rad: f64) -> Self {
        Self {
            state: *state,
            motion: state.motion(),
            spread: Spread::NONE,
            is_standing: false,
            heading_rad,
            limited_rad,
        }
    }

    /// The heading of the motion: its own, or else its course, or else the last heading.
    pub fn heading(&self) -> f64 {
        let Motion { velocity_mps: [vx, vy], heading_rad, speed_mps, .. } = self.motion;
        match heading_rad {
            Some(heading) => heading,
            None if speed_mps >= COURSE_MIN_MPS && !self.is_standing => vy.atan2(vx),
            None => self.heading_rad,
        }
    }

    /// Whether the numbers fit a payload.
    pub fn is_within_limits(&self) -> bool {
        self.motion.position_m.iter().all(|x| x.abs() <= f64::from(wire::POSITION_MAX_M))
            && self.motion.speed_mps.abs() <= f64::from(wire::SPEED_MAX_MPS)
    }
}
