use crate::displacement::displacements_by_horizon;
use crate::{Displacement, DisplacementMean, Point, Prediction, most_likely};

/// The displacements of forecasts cut off at one horizon.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HorizonScore {
    /// The best of all modes up to this horizon, each agent its own.
    pub best_of: DisplacementMean,
    /// The single best forecast.
    pub single: DisplacementMean,
    /// The likeliest mode.
    pub most_likely: DisplacementMean,
}

/// The displacements of the same forecasts at every horizon from one step to the longest.
///
/// The figures at a horizon are those that an evaluation would print whose truth ended there: ADE over the steps up to
/// it, FDE at it, and best modes chosen for it alone. Can be merged with others.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HorizonScores {
    horizons: Vec<HorizonScore>,
}

impl HorizonScores {
    /// Counts one agent.
    ///
    /// # Panics
    /// Where a trajectory is shorter than the truth, or there are not as many probabilities as modes.
    pub fn add<M: AsRef<[Point]>>(&mut self, prediction: &Prediction<'_, M>, truth: &[Option<Point>]) {
        let Prediction { best, modes, probability, .. } = *prediction;
        assert_eq!(modes.len(), probability.len(), "one probability per mode");
        self.reach(truth.len());
        let mut best_of = vec![Displacement::default(); truth.len()];
        for mode in modes {
            let displacements = displacements_by_horizon(mode.as_ref(), truth);
            best_of.iter_mut().zip(displacements).for_each(|(best, d)| *best = best.or_better(d));
        }
        for (horizon, d) in self.horizons.iter_mut().zip(best_of) {
            horizon.best_of.add(d);
        }
        for (horizon, d) in self.horizons.iter_mut().zip(displacements_by_horizon(best, truth)) {
            horizon.single.add(d);
        }
        if let Some(k) = most_likely(probability) {
            let displacements = displacements_by_horizon(modes[k].as_ref(), truth);
            self.horizons.iter_mut().zip(displacements).for_each(|(horizon, d)| horizon.most_likely.add(d));
        }
    }

    /// Counts all that `other` counted.
    pub fn merge(&mut self, other: &Self) {
        self.reach(other.horizons.len());
        for (own, more) in self.horizons.iter_mut().zip(&other.horizons) {
            own.best_of.merge(&more.best_of);
            own.single.merge(&more.single);
            own.most_likely.merge(&more.most_likely);
        }
    }

    /// The scores at each horizon, that of one step first.
    #[must_use]
    pub fn horizons(&self) -> &[HorizonScore] {
        &self.horizons
    }

    fn reach(&mut self, horizons_len: usize) {
        if self.horizons.len() < horizons_len {
            self.horizons.resize(horizons_len, HorizonScore::default());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Limits, Scores};
    use proptest::prelude::*;
    use scene::{AgentType, State};

    const STEPS: usize = 5;
    type Mode = [Point; STEPS];

    fn prediction<'a>(modes: &'a [Mode], probability: &'a [f32]) -> Prediction<'a, Mode> {
        Prediction {
            limits: Limits::of(AgentType::Pedestrian),
            now: State::default(),
            dt_s: 0.4,
            best: &modes[0],
            modes,
            probability,
            moments: None,
        }
    }

    #[test]
    fn every_horizon_has_its_own_best_mode() {
        // The first mode is right at first, the second in the end.
        let modes: [Mode; 2] = [
            [[0.0, 0.0], [0.0, 0.0], [3.0, 0.0], [3.0, 0.0], [3.0, 0.0]],
            [[1.0, 0.0], [1.0, 0.0], [1.0, 0.0], [0.0, 0.0], [0.0, 0.0]],
        ];
        let mut scores = HorizonScores::default();
        scores.add(&prediction(&modes, &[0.4, 0.6]), &[Some([0.0, 0.0]); STEPS]);
        let ade_m: Vec<f64> = scores.horizons().iter().filter_map(|h| h.best_of.ade_m.value()).collect();
        assert_eq!(ade_m, [0.0, 0.0, 1.0, 0.75, 0.6]);
        let fde_m: Vec<f64> = scores.horizons().iter().filter_map(|h| h.best_of.fde_m.value()).collect();
        assert_eq!(fde_m, [0.0, 0.0, 1.0, 0.0, 0.0]);
        assert_eq!(scores.horizons()[4].single.misses.value(), Some(1.0));
        assert_eq!(scores.horizons()[2].most_likely.fde_m.value(), Some(1.0));
    }

    type Window = (Vec<Mode>, [Option<Point>; STEPS]);

    fn windows() -> impl Strategy<Value = Vec<Window>> {
        let point = || [-5.0f32..5.0, -5.0f32..5.0];
        let modes = prop::collection::vec(prop::array::uniform5(point()), 3);
        prop::collection::vec((modes, prop::array::uniform5(prop::option::of(point()))), 1..5)
    }

    proptest! {
        #[test]
        fn each_horizon_scores_as_if_the_truth_ended_there(windows in windows()) {
            let mut scores = HorizonScores::default();
            let mut cut = [Scores::default(); STEPS];
            for (modes, truth) in &windows {
                let prediction = prediction(modes, &[0.2, 0.5, 0.3]);
                scores.add(&prediction, truth);
                for (k, cut) in cut.iter_mut().enumerate() {
                    cut.add(&prediction, &truth[..=k]);
                }
            }
            for (horizon, cut) in scores.horizons().iter().zip(&cut) {
                let expected =
                    HorizonScore { best_of: cut.best_of, single: cut.single, most_likely: cut.most_likely };
                prop_assert_eq!(*horizon, expected);
            }
        }

        #[test]
        fn merged_parts_count_as_the_whole(windows in windows(), short in 1..STEPS) {
            let (mut left, mut right, mut whole) =
                (HorizonScores::default(), HorizonScores::default(), HorizonScores::default());
            for (i, (modes, truth)) in windows.iter().enumerate() {
                let truth = &truth[..if i == 0 { short } else { STEPS }];
                let prediction = prediction(modes, &[0.2, 0.5, 0.3]);
                if i == 0 { &mut left } else { &mut right }.add(&prediction, truth);
                whole.add(&prediction, truth);
            }
            left.merge(&right);
            prop_assert_eq!(left.horizons().len(), whole.horizons().len());
            for (left, whole) in left.horizons().iter().zip(whole.horizons()) {
                prop_assert_eq!(left.single.ade_m.len(), whole.single.ade_m.len());
                let close = |a: Option<f64>, b: Option<f64>| match (a, b) {
                    (Some(a), Some(b)) => (a - b).abs() < 1e-12,
                    (a, b) => a == b,
                };
                prop_assert!(close(left.best_of.ade_m.value(), whole.best_of.ade_m.value()));
                prop_assert!(close(left.most_likely.fde_m.value(), whole.most_likely.fde_m.value()));
            }
        }
    }
}
