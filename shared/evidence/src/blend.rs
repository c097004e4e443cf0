//! The blend of experts at one step of the horizon: the weight of each expert's difference from constant
//! velocity.

use wire::AgentType;

use crate::width::single;
use crate::{EXPERTS, Statistics};

/// A single expert is the forecast if its mean distance from the truth is below this share of the
/// regression's.
const BETTER: f64 = 0.98;
/// Maximum that one forecast adds to a sum of products: an expert's error for one agent has no limit.
const PRODUCT_MAX: f32 = 1000.0;

/// Evidence required before agents of a type are forecast differently from other roads.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Caution {
    /// Weight of the prior, in forecasts.
    prior_count: f64,
    /// Discounted number of forecasts after which a single expert may be the forecast.
    expert_min: f64,
    /// Discounted number of forecasts after which constant velocity alone may be the forecast.
    steady_min: f64,
    /// Constant velocity is the forecast if its mean distance from the truth is below this share of the
    /// regression's.
    steady: f64,
}

impl Caution {
    /// Many agents are present, and their behaviour is informative about each other.
    const LITTLE: Self = Self { prior_count: 20.0, expert_min: 30.0, steady_min: 30.0, steady: BETTER };
    /// Only one or two agents are present, and their behaviour is weak evidence for the next agents. The
    /// regression must prove better than constant velocity, and a single expert is never the forecast.
    const MUCH: Self = Self { prior_count: 100.0, expert_min: f64::INFINITY, steady_min: 10.0, steady: 1.02 };

    pub(crate) const fn of(agent_type: AgentType) -> Self {
        match agent_type {
            AgentType::Vehicle | AgentType::Pedestrian => Self::LITTLE,
            AgentType::Cyclist => Self::MUCH,
        }
    }
}

/// A matured forecast: positions relative to constant velocity's, m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outcome<'a> {
    /// Positions of the experts.
    pub(crate) experts_m: &'a [[f32; 2]; EXPERTS],
    /// Position of the [regression](Blend::regression) at that time.
    pub(crate) regression_m: [f32; 2],
    /// Position of the agent.
    pub(crate) truth_m: [f32; 2],
    /// Typical deviation of similar agents.
    pub(crate) typical_m: f32,
    /// Accuracy of the best-known positions.
    pub(crate) deviation_m: f32,
}

/// The statistics of the experts, and the weights that follow from them.
#[derive(Clone, Debug)]
pub(crate) struct Blend {
    caution: Caution,
    /// Statistics of the experts on roads that the network does not know, and their weights there.
    strange: Statistics,
    strange_weights: [f32; EXPERTS],
    /// Each forecast is weighted by the inverse of the regression's error. The minimum of the sum of squares
    /// is then the minimum of the sum of distances.
    matured: Statistics,
    /// All forecasts have equal weight: a prior for other roads.
    shown: Statistics,
    /// Sums of the distances from the truth of the regression, of constant velocity and of each expert, m.
    distances_m: [f64; EXPERTS + 2],
    regression: [f32; EXPERTS],
    weights: [f32; EXPERTS],
}

impl Blend {
    /// Count of the learned numbers.
    pub(crate) const NUMBERS_LEN: usize = EXPERTS * EXPERTS + EXPERTS + 1 + (EXPERTS + 2) + 2 * EXPERTS;

    /// State before any forecast. The network knows the road with probability `known`.
    pub(crate) fn new(caution: Caution, prior: &Statistics, known: f64) -> Self {
        let mut blend = Self {
            caution,
            strange: *prior,
            strange_weights: prior.weights(),
            matured: Statistics::default(),
            shown: Statistics::default(),
            distances_m: [0.0; EXPERTS + 2],
            regression: [0.0; EXPERTS],
            weights: [0.0; EXPERTS],
        };
        blend.solve(known);
        blend
    }

    /// Adds a forecast. The weights change at the next [`Blend::solve`].
    pub(crate) fn add(&mut self, outcome: &Outcome<'_>, weight: f32) {
        let Outcome { experts_m, regression_m, truth_m, typical_m, deviation_m } = *outcome;
        let square = |[x, y]: [f32; 2]| x * x + y * y;
        let variance_m2 = deviation_m * deviation_m;
        let distance_m = |[x, y]: [f32; 2]| (truth_m[0] - x).hypot(truth_m[1] - y);
        let missed_m = (distance_m(regression_m).powi(2) + variance_m2).sqrt();
        let farthest_m2 = experts_m.iter().copied().map(square).fold(0.0, f32::max);
        let scale_m2 = missed_m * typical_m.max(deviation_m);
        self.matured.add(experts_m, truth_m, scale_m2.max(farthest_m2 / PRODUCT_MAX), weight);
        self.shown.add(experts_m, truth_m, square(truth_m) + farthest_m2 + variance_m2, weight);
        let paths_m = [regression_m, [0.0; 2]].into_iter().chain(experts_m.iter().copied());
        for (sum, path_m) in self.distances_m.iter_mut().zip(paths_m) {
            *sum += f64::from(weight * distance_m(path_m));
        }
    }

    /// Discounts older forecasts.
    pub(crate) fn discount(&mut self, kept: f64) {
        self.matured.discount(kept);
        self.shown.discount(kept);
        self.distances_m.iter_mut().for_each(|sum| *sum *= kept);
    }

    /// Computes the weights. The network knows the road with probability `known`.
    pub(crate) fn solve(&mut self, known: f64) {
        let prior_count = self.caution.prior_count;
        let mut with_prior = self.matured;
        with_prior.add_scaled(&self.strange, prior_count * (1.0 - known));
        with_prior.add_scaled(&right_network(&self.strange), prior_count * known);
        self.regression = with_prior.weights();
        self.weights = self.alone().unwrap_or(self.regression);
    }

    /// The weights if a single expert or constant velocity is the forecast.
    fn alone(&self) -> Option<[f32; EXPERTS]> {
        let Caution { expert_min, steady_min, steady, .. } = self.caution;
        let [by_regression_m, steady_m, ref experts_m @ ..] = self.distances_m;
        let is_enough = |forecasts_min: f64| self.matured.len >= forecasts_min;
        let experts =
            experts_m.iter().enumerate().map(|(expert, expert_m)| (Some(expert), expert_m / BETTER));
        let experts = experts.filter(|_| is_enough(expert_min));
        let steady = is_enough(steady_min).then_some((None, steady_m / steady));
        let (best, best_m) = experts.chain(steady).min_by(|(_, a_m), (_, b_m)| a_m.total_cmp(b_m))?;
        let weights = std::array::from_fn(|expert| if Some(expert) == best { 1.0 } else { 0.0 });
        (best_m < by_regression_m).then_some(weights)
    }

    /// The experts' weights, nonnegative and at most 1 in sum. Constant velocity has the rest.
    pub(crate) const fn weights(&self) -> &[f32; EXPERTS] {
        &self.weights
    }

    /// The weights by the prior alone.
    pub(crate) const fn strange_weights(&self) -> &[f32; EXPERTS] {
        &self.strange_weights
    }

    /// The weights before the choice of a single expert.
    pub(crate) const fn regression(&self) -> &[f32; EXPERTS] {
        &self.regression
    }

    /// Discounted number of matured forecasts.
    pub(crate) const fn matured_count(&self) -> f64 {
        self.matured.len
    }

    /// The statistics of the matured forecasts, per forecast; empty if there are fewer than `len_min`.
    pub(crate) fn as_prior(&self, len_min: f64) -> Statistics {
        let mut mean = Statistics::default();
        if self.shown.len >= len_min {
            mean.add_scaled(&self.shown, 1.0 / self.shown.len);
        }
        mean
    }

    /// Calls `each` with all learned numbers, to read or to change them. The statistics for other roads are
    /// left out.
    pub(crate) fn numbers(&mut self, each: &mut impl FnMut(&mut f64)) {
        let Statistics { products, targets, len } = &mut self.matured;
        let sums = products.as_flattened_mut().iter_mut().chain(targets).chain([len]);
        sums.chain(&mut self.distances_m).for_each(&mut *each);
        // The weights are those after the last matured forecast: later fading takes effect at the next one.
        self.regression.iter_mut().chain(&mut self.weights).for_each(|weight| single(weight, each));
    }
}

/// A prior's number of forecasts, in which the network differed as much from constant velocity and was right.
fn right_network(prior: &Statistics) -> Statistics {
    let mut right = Statistics { len: prior.len, ..Statistics::default() };
    right.products[0][0] = prior.products[0][0];
    right.targets[0] = prior.products[0][0];
    right
}

#[cfg(test)]
mod tests {
    use super::*;

    const NETWORK_ALONE: [f32; EXPERTS] = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0];

    /// A blend of vehicles after forecasts of the network alone. Each pair is the predicted and the actual
    /// distance along a line.
    fn after(forecasts: impl IntoIterator<Item = (f32, f32)>) -> Blend {
        after_those_of(AgentType::Vehicle, forecasts)
    }

    fn after_those_of(agent_type: AgentType, forecasts: impl IntoIterator<Item = (f32, f32)>) -> Blend {
        let mut blend = Blend::new(Caution::of(agent_type), &Statistics::default(), 0.0);
        for (network_m, truth_m) in forecasts {
            let mut experts_m = [[0.0; 2]; EXPERTS];
            experts_m[0][0] = network_m;
            let outcome = Outcome {
                experts_m: &experts_m,
                regression_m: [blend.regression[0] * network_m, 0.0],
                truth_m: [truth_m, 0.0],
                typical_m: 1.0,
                deviation_m: 0.1,
            };
            blend.add(&outcome, 1.0);
            blend.solve(0.0);
        }
        blend
    }

    #[test]
    fn the_least_mean_distance_rules_and_not_the_least_mean_square() {
        // In three of five forecasts the network is right; in the other two the agent keeps its velocity.
        // Least squares give 0.6.
        let blend = after((0..100).map(|n| (2.0, if n % 5 < 3 { 2.0 } else { 0.0 })));
        assert!(blend.regression[0] > 0.85, "{:?}", blend.regression);
    }

    #[test]
    fn an_expert_that_is_better_than_the_regression_is_the_forecast() {
        // Standing agents hold the regression back until the others start.
        let standing = std::iter::repeat_n((0.1, 0.0), 300);
        let blend = after(standing.chain(std::iter::repeat_n((5.0, 5.0), 30)));
        assert!(blend.regression[0] < 1.0, "{:?}", blend.regression);
        assert_eq!(blend.weights, NETWORK_ALONE);
    }

    #[test]
    fn few_forecasts_choose_nobody() {
        let standing = std::iter::repeat_n((0.1, 0.0), 20);
        let forecasts = |moving: usize| standing.clone().chain(std::iter::repeat_n((5.0, 5.0), moving));
        let [few, enough] = [9, 10].map(|moving| after(forecasts(moving)));
        assert!(few.weights == few.regression && few.regression[0] < 1.0, "{:?}", few.weights);
        assert_eq!(enough.weights, NETWORK_ALONE);
    }

    #[test]
    fn of_cyclists_the_regression_must_prove_better_than_constant_velocity() {
        // The network is right that they move, but predicts a hundredth of the distance.
        let of_little_use = || std::iter::repeat_n((1.0, 100.0), 100);
        let [vehicles, cyclists] =
            [AgentType::Vehicle, AgentType::Cyclist].map(|of| after_those_of(of, of_little_use()));
        assert_eq!(vehicles.weights, NETWORK_ALONE);
        assert_eq!(cyclists.weights, [0.0; EXPERTS]);
    }

    #[test]
    fn of_cyclists_no_expert_is_the_forecast_alone() {
        let moving = || std::iter::repeat_n((0.1, 0.0), 300).chain(std::iter::repeat_n((5.0, 5.0), 30));
        let [vehicles, cyclists] =
            [AgentType::Vehicle, AgentType::Cyclist].map(|of| after_those_of(of, moving()));
        assert_eq!(vehicles.weights, NETWORK_ALONE);
        assert_eq!(cyclists.weights, cyclists.regression);
        assert!(cyclists.weights[0] > 0.5, "{:?}", cyclists.weights);
    }

    #[test]
    fn where_the_network_knows_the_road_it_is_trusted_before_any_forecast_matures() {
        let mut prior = Statistics::doubting();
        prior.targets = [0.3, 0.2, 0.2, 0.0, 0.0, 0.0];
        let [strange, half, known] = [0.0, 0.5, 1.0].map(|known| Blend::new(Caution::LITTLE, &prior, known));
        let [by_strange, by_half, by_known] = [&strange, &half, &known].map(|blend| blend.weights[0]);
        assert!(by_strange < 0.31 && by_strange < by_half, "{by_strange} {by_half}");
        assert!(by_half < by_known && by_known > 0.99, "{by_half} {by_known}");
        assert_eq!(half.strange_weights[0], by_strange);
    }

    #[test]
    fn no_forecast_shows_others_more_than_another() {
        let blend = after([(1e4, -1e4)]);
        let shown = blend.as_prior(1.0);
        assert!(shown.products.as_flattened().iter().all(|product| *product <= 1.0), "{shown:?}");
        assert_eq!(blend.as_prior(2.0), Statistics::default());
    }
}
