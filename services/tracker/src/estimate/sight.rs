use crate::estimate::Estimate;
use crate::occlusion::{Occlusion, Outline};
use crate::options::TrackerOptions;

/// Length and width where none are known, by type.
const EXTENT_M: [[f64; 2]; 3] = [[4.5, 1.8], [1.8, 0.6], [0.5, 0.5]];
/// No agent is hidden more surely than that: outlines are not exact, and a sensor sees some over and through others.
const VISIBLE_SHARE_MIN: f64 = 0.02;
/// An agent counts as in view from that on.
const IN_VIEW_SHARE: f64 = 0.8;

impl Estimate {
    /// Whether it surely hides what is behind it.
    #[must_use]
    pub fn is_opaque(&self) -> bool {
        self.is_ready() && self.life.is_certain()
    }

    /// Whether it is a track that the last frame which observed its type did not see.
    #[must_use]
    pub const fn is_coasting(&self) -> bool {
        self.is_ready() && !self.life.is_hit()
    }

    /// Finds out how much of the agent can be seen past the others.
    pub fn look(&mut self, occlusion: &Occlusion) {
        self.visible_share = occlusion.visible_share(&self.outline());
    }

    /// Whether it is more than its edge that can't be seen.
    #[must_use]
    pub fn is_hidden(&self) -> bool {
        self.visible_share < IN_VIEW_SHARE
    }

    /// What it costs, beside the fit, to take a detection for that of an agent of whom so much can be seen: −2 ln of the odds that it is
    /// detected, beside the odds in full view.
    #[must_use]
    pub fn hidden_cost(&self, options: &TrackerOptions) -> f64 {
        if self.visible_share >= 1.0 {
            return 0.0;
        }
        let odds = |share: f64| {
            let probability = share * options.detection_probability;
            probability / (1.0 - probability)
        };
        -2.0 * (odds(self.visible_share.max(VISIBLE_SHARE_MIN)) / odds(1.0)).ln()
    }

    /// Where the agent stands, in the extent that is usual for its type where its own is unknown.
    #[must_use]
    pub fn outline(&self) -> Outline {
        let (centre_m, covariance_m2) = self.belief.position();
        let heading_rad = self.belief.motion().heading_rad.unwrap_or(self.heading_rad);
        let usual_m = EXTENT_M[self.class.current().index()];
        let known_m = [self.length_m, self.width_m].map(f64::from);
        let half_m = [0, 1].map(|axis| 0.5 * if known_m[axis] > 0.0 { known_m[axis] } else { usual_m[axis] });
        Outline { centre_m, covariance_m2, heading_rad, half_m }
    }
}
