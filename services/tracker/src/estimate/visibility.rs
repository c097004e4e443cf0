use crate::estimate::Estimate;
use crate::occlusion::{Occlusion, Outline};
use crate::options::TrackerOptions;

/// Length and width by type, used if the size is unknown.
const EXTENT_M: [[f64; 2]; 3] = [[4.5, 1.8], [1.8, 0.6], [0.5, 0.5]];
/// Smallest visibility that a cost assumes. Outlines are not exact, and a sensor sees some agents over and
/// through others.
const VISIBILITY_MIN: f64 = 0.02;
/// Visibility from which an agent counts as in view.
const VISIBILITY_IN_VIEW: f64 = 0.8;

impl Estimate {
    /// Whether the agent occludes objects behind it.
    #[must_use]
    pub fn is_opaque(&self) -> bool {
        self.is_ready() && self.management.is_certain()
    }

    /// Whether the last frame that observed the track's type missed the track.
    #[must_use]
    pub const fn is_coasting(&self) -> bool {
        self.is_ready() && !self.management.was_hit()
    }

    /// Computes the share of the agent that the sensor can see past the others.
    pub fn update_visibility(&mut self, occlusion: &Occlusion) {
        self.visibility = occlusion.visibility(&self.outline());
    }

    /// Whether more than the edge of the agent is occluded.
    #[must_use]
    pub fn is_occluded(&self) -> bool {
        self.visibility < VISIBILITY_IN_VIEW
    }

    /// Cost that the agent's visibility adds to each of its pairs: −2 ln of the odds of a detection, relative
    /// to the odds in full view.
    #[must_use]
    pub fn occlusion_cost(&self, options: &TrackerOptions) -> f64 {
        if self.visibility >= 1.0 {
            return 0.0;
        }
        let odds = |visibility: f64| {
            let probability = visibility * options.detection_probability;
            probability / (1.0 - probability)
        };
        -2.0 * (odds(self.visibility.max(VISIBILITY_MIN)) / odds(1.0)).ln()
    }

    /// The agent's outline on the ground. If its extent is unknown, the outline has the usual extent of its
    /// type.
    #[must_use]
    pub fn outline(&self) -> Outline {
        let (centre_m, covariance_m2) = self.belief.position();
        let heading_rad = self.belief.motion().heading_rad.unwrap_or(self.published.heading_rad);
        let usual_m = EXTENT_M[self.class.current().index()];
        let known_m = [self.size.length_m, self.size.width_m].map(f64::from);
        let half_m = [0, 1].map(|axis| 0.5 * if known_m[axis] > 0.0 { known_m[axis] } else { usual_m[axis] });
        Outline { centre_m, covariance_m2, heading_rad, half_m }
    }
}
