use scene::State;

use crate::{
    DisplacementMean, Limits, Mean, Point, Share, best_of, covers, displacement, kde_log_density, most_likely,
};

/// Moments of the mixture of an agent's modes, one entry per step.
#[derive(Clone, Copy, Debug)]
pub struct Moments<'a> {
    /// Mean positions.
    pub mean: &'a [Point],
    /// Covariances (xx, xy, yy), m².
    pub covariance: &'a [[f32; 3]],
}

/// What was forecast for one agent.
#[derive(Clone, Copy, Debug)]
pub struct Prediction<'a, M> {
    /// What the agent can do: [`Limits::vehicle`] where a vehicle's length is known, else [`Limits::of`] its type.
    pub limits: Limits,
    /// The agent's state when the forecast was made.
    pub now: State,
    /// Time between two steps.
    pub dt_s: f32,
    /// The single best forecast (K = 1).
    pub best: &'a [Point],
    /// All modes.
    pub modes: &'a [M],
    /// The probability of each mode.
    pub probability: &'a [f32],
    /// The stated uncertainty; `None` for baselines that state none.
    pub moments: Option<Moments<'a>>,
}

/// The measures that concern one agent at a time, over all that were counted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scores {
    /// The best of all modes, each agent its own.
    pub best_of: DisplacementMean,
    /// The single best forecast.
    pub single: DisplacementMean,
    /// The likeliest mode.
    pub most_likely: DisplacementMean,
    /// Negative log density of the known positions under the modes' kernel density, over agents and steps.
    pub kde_nll: Mean,
    /// Known positions inside the 50 % ellipse of the moments.
    pub covered_50: Share,
    /// Known positions inside the 90 % ellipse of the moments.
    pub covered_90: Share,
    /// Modes that break a physical limit of their agent.
    pub broken: Share,
}

impl Scores {
    /// Counts one agent.
    ///
    /// # Panics
    /// Where a trajectory is shorter than the truth, or there are not as many probabilities as modes.
    pub fn add<M: AsRef<[Point]>>(&mut self, prediction: &Prediction<'_, M>, truth: &[Option<Point>]) {
        let Prediction { modes, probability, .. } = *prediction;
        assert_eq!(modes.len(), probability.len(), "one probability per mode");
        self.best_of.add(best_of(modes, truth));
        self.single.add(displacement(prediction.best, truth));
        if let Some(k) = most_likely(probability) {
            self.most_likely.add(displacement(modes[k].as_ref(), truth));
        }
        for mode in modes {
            let steps = &mode.as_ref()[..truth.len()];
            self.broken.add(prediction.limits.broken_by(&prediction.now, steps, prediction.dt_s));
        }
        let mut ends: Vec<Point> = Vec::with_capacity(modes.len());
        for (step, &position) in truth.iter().enumerate() {
            let Some(position) = position else { continue };
            ends.clear();
            ends.extend(modes.iter().map(|mode| mode.as_ref()[step]));
            self.kde_nll.add(-kde_log_density(&ends, probability, position));
            if let Some(Moments { mean, covariance }) = prediction.moments {
                self.covered_50.add(covers(mean[step], covariance[step], position, 0.5));
                self.covered_90.add(covers(mean[step], covariance[step], position, 0.9));
            }
        }
    }

    /// Counts all that `other` counted.
    pub fn merge(&mut self, other: &Self) {
        self.best_of.merge(&other.best_of);
        self.single.merge(&other.single);
        self.most_likely.merge(&other.most_likely);
        self.kde_nll.merge(&other.kde_nll);
        self.covered_50.merge(&other.covered_50);
        self.covered_90.merge(&other.covered_90);
        self.broken.merge(&other.broken);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::AgentType;

    const MODES: [[Point; 2]; 2] = [[[1.0, 0.0], [2.0, 0.0]], [[1.0, 1.0], [2.0, 3.0]]];
    const TRUTH: [Option<Point>; 2] = [Some([1.0, 1.0]), Some([2.0, 3.0])];

    fn prediction<'a>(moments: Option<Moments<'a>>) -> Prediction<'a, [Point; 2]> {
        Prediction {
            limits: Limits::of(AgentType::Pedestrian),
            now: State { velocity_mps: [1.0, 0.0], ..State::default() },
            dt_s: 1.0,
            best: &[[1.0, 0.0], [2.0, 1.0]],
            modes: &MODES,
            probability: &[0.75, 0.25],
            moments,
        }
    }

    #[test]
    fn every_measure_of_one_agent() {
        let moments =
            Moments { mean: &[[1.0, 0.5], [2.0, 1.5]], covariance: &[[0.5, 0.0, 0.5], [0.5, 0.0, 0.5]] };
        let mut scores = Scores::default();
        scores.add(&prediction(Some(moments)), &TRUTH);
        assert_eq!(scores.best_of.ade_m.value(), Some(0.0));
        assert_eq!(scores.single.ade_m.value(), Some(1.5));
        assert_eq!(scores.most_likely.fde_m.value(), Some(3.0));
        assert_eq!(scores.most_likely.misses.value(), Some(1.0));
        // Squared Mahalanobis distances 0.5 and 4.5; the radii are 1.386 (50 %) and 4.605 (90 %).
        assert_eq!(scores.covered_50.value(), Some(0.5));
        assert_eq!(scores.covered_90.value(), Some(1.0));
        assert_eq!(scores.broken.value(), Some(0.0));
        assert_eq!(scores.kde_nll.len(), 2);
    }

    #[test]
    fn merged_parts_equal_the_whole() {
        let (mut left, mut right, mut whole) = (Scores::default(), Scores::default(), Scores::default());
        let half_known = [TRUTH[0], None];
        left.add(&prediction(None), &TRUTH);
        right.add(&prediction(None), &half_known);
        whole.add(&prediction(None), &TRUTH);
        whole.add(&prediction(None), &half_known);
        left.merge(&right);
        assert_eq!(left, whole);
        assert_eq!(whole.best_of.fde_m.len(), 1, "the second window's end is unknown");
        assert!(whole.covered_50.is_empty(), "no moments were stated");
    }
}
