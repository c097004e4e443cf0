//! Sums of errors over agents. Every table is made from them. They are exact, so that they do not depend on
//! the order in which agents and recordings are added.

use metrics::{Displacement, Errors, ExactMean, ExactSum, Mean, Share, displacement, joint_min_displacement};
use serde::{Deserialize, Serialize};

use super::Method;
use crate::forecaster::Crowding;
use crate::lines::Candidate;
use crate::scenes::Agent;

wire::named! {
    /// How the forecasts of a method are compared with the truth.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Measure {
        /// minADE₂₀ and minFDE₂₀: minima over the modes of each agent, separately for ADE and FDE.
        BestOf => "minADE₂₀ / minFDE₂₀",
        /// The single best forecast, K = 1.
        Single => "K = 1",
        /// The most probable mode.
        Top1 => "top-1",
        /// The best of 20 futures of the scene: mode k of every agent together.
        Joint => "joint minADE₂₀ / minFDE₂₀",
        /// The best of 20 futures of the scene: the k-th most probable mode of every agent together.
        JointRanked => "joint, by rank",
        /// The best of 20 futures of the scene: mode k of every agent together. In every second future, modes
        /// move towards the single forecasts as in [`metrics::joint_spread`]. Unmoved futures suit deviations
        /// that all agents share, and moved ones suit deviations of each agent alone.
        JointNarrowed => "joint, narrowed",
    }
}

impl Measure {
    /// Place in [`Measure::ALL`].
    pub const fn index(self) -> usize {
        self as usize
    }
}

const METHODS: usize = Method::ALL.len();
const OURS: usize = Method::OURS.len();
const MEASURES: usize = Measure::ALL.len();

/// Calibration of a method's probabilities and covariances, over the steps since the previous horizon.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Negative log density of the truth under the kernel density of the modes, over agents and steps.
    pub kde_nll: ExactMean,
    /// Truths inside the 50 % highest-density region of the mixture, over agents and steps.
    pub covered_50: Share,
    /// Truths inside the 90 % region.
    pub covered_90: Share,
    /// Agents whose minFDE₂₀ is above 2 m.
    pub missed_best: Share,
    /// Agents whose single forecast has an FDE above 2 m.
    pub missed_single: Share,
}

impl Calibration {
    /// Adds the steps of `other`. The miss rates do not change, because they belong to the later horizon.
    fn merge_steps(&mut self, other: &Self) {
        self.kde_nll.merge(&other.kde_nll);
        self.covered_50.merge(&other.covered_50);
        self.covered_90.merge(&other.covered_90);
    }
}

/// Errors of all methods on a set of agents.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// Scenes with a counted agent.
    pub scene_count: u64,
    /// Counted agents.
    pub agents_len: u64,
    /// Agents with a forecast, by method and measure.
    counts: [[u64; MEASURES]; METHODS],
    /// Sums of (ADE, FDE), by horizon, method and measure.
    sums: Vec<[[[ExactSum; 2]; MEASURES]; METHODS]>,
    /// By horizon and index in [`Method::OURS`].
    calibration: Vec<[Calibration; OURS]>,
    /// Share of single forecasts that collide with another one in the same scene.
    pub collided: Share,
    /// Share of recorded futures that collide by the same rule.
    pub truly_collided: Share,
    /// Share of modes and single forecasts that violate a limit of the agent's type, by index in
    /// [`Method::OURS`].
    pub broken: [Share; OURS],
    /// Windows of the scenes that do not fit a payload.
    pub crowding: Crowding,
}

impl Tally {
    /// An empty tally for this number of horizons.
    #[must_use]
    pub fn new(horizon_count: usize) -> Self {
        Self {
            scene_count: 0,
            agents_len: 0,
            counts: [[0; MEASURES]; METHODS],
            sums: vec![[[[ExactSum::default(); 2]; MEASURES]; METHODS]; horizon_count],
            calibration: vec![[Calibration::default(); OURS]; horizon_count],
            collided: Share::default(),
            truly_collided: Share::default(),
            broken: [Share::default(); OURS],
            crowding: Crowding::default(),
        }
    }

    /// Adds the counts and sums of `other`.
    pub fn merge(&mut self, other: &Self) {
        self.scene_count += other.scene_count;
        self.agents_len += other.agents_len;
        let counts = self.counts.as_flattened_mut().iter_mut();
        counts.zip(other.counts.as_flattened()).for_each(|(count, more)| *count += more);
        for (sums, more) in self.sums.iter_mut().zip(&other.sums) {
            let sums = sums.as_flattened_mut().as_flattened_mut().iter_mut();
            sums.zip(more.as_flattened().as_flattened()).for_each(|(sum, more)| sum.merge(more));
        }
        let (calibration, more) = (self.calibration.as_flattened_mut(), other.calibration.as_flattened());
        for (calibration, more) in calibration.iter_mut().zip(more) {
            calibration.merge_steps(more);
            calibration.missed_best.merge(&more.missed_best);
            calibration.missed_single.merge(&more.missed_single);
        }
        self.crowding.merge(&other.crowding);
        self.collided.merge(&other.collided);
        self.truly_collided.merge(&other.truly_collided);
        self.broken.iter_mut().zip(&other.broken).for_each(|(broken, more)| broken.merge(more));
    }

    /// The same errors in another unit of length, with `per_m` units per metre. Counts and shares do not
    /// change.
    #[must_use]
    pub fn scaled(mut self, per_m: f64) -> Self {
        let sums = self.sums.iter_mut().flat_map(|sums| sums.as_flattened_mut().as_flattened_mut());
        sums.for_each(|sum| *sum = sum.scaled(per_m));
        self
    }

    /// Mean errors up to a horizon; `None` if the method has no such forecast.
    #[must_use]
    pub fn errors(&self, method: Method, measure: Measure, horizon: usize) -> Option<Errors> {
        let [ade_m, fde_m] = self.sum(method, measure, horizon).map(|sum| sum.value());
        let len = self.len(method, measure);
        (len > 0).then(|| Errors { ade_m: ade_m / len as f64, fde_m: fde_m / len as f64 })
    }

    /// Sums of (ADE, FDE) up to a horizon.
    #[must_use]
    pub fn sum(&self, method: Method, measure: Measure, horizon: usize) -> [ExactSum; 2] {
        self.sums[horizon][method.index()][measure.index()]
    }

    /// Number of agents with a forecast by this method and measure.
    #[must_use]
    pub const fn len(&self, method: Method, measure: Measure) -> u64 {
        self.counts[method.index()][measure.index()]
    }

    /// Whether no agent was counted.
    pub const fn is_empty(&self) -> bool {
        self.agents_len == 0
    }

    /// Number of horizons.
    pub fn horizon_count(&self) -> usize {
        self.sums.len()
    }

    /// Whether the sums have this number of horizons.
    pub(crate) const fn has_horizons(&self, horizon_count: usize) -> bool {
        self.sums.len() == horizon_count && self.calibration.len() == horizon_count
    }

    /// The calibration of `Method::OURS[ours]`, over all steps up to a horizon.
    #[must_use]
    pub fn calibration(&self, ours: usize, horizon: usize) -> Calibration {
        let mut all = self.calibration[horizon][ours];
        self.calibration[..horizon].iter().for_each(|before| all.merge_steps(&before[ours]));
        all
    }

    /// The calibration over the steps between the previous horizon and this one.
    pub(crate) fn calibration_mut(&mut self, ours: usize, horizon: usize) -> &mut Calibration {
        &mut self.calibration[horizon][ours]
    }

    /// Adds the marginal errors of one agent; `horizons` are numbers of steps.
    pub(crate) fn add_agent(&mut self, agent: &Agent, candidates: &[Candidate; METHODS], horizons: &[usize]) {
        self.agents_len += 1;
        for (method, candidate) in candidates.iter().enumerate() {
            let Candidate { modes, probability, single, .. } = candidate;
            let likely = probability.as_deref().and_then(metrics::most_likely);
            for (horizon, &steps) in horizons.iter().enumerate() {
                let truth = &agent.future[..steps];
                let mut add = |measure: Measure, errors: Displacement| {
                    let (Some(ade_m), Some(fde_m)) = (errors.ade_m, errors.fde_m) else { return };
                    let [ade, fde] = &mut self.sums[horizon][method][measure.index()];
                    ade.add(ade_m);
                    fde.add(fde_m);
                    self.counts[method][measure.index()] += u64::from(horizon == 0);
                };
                if !modes.is_empty() {
                    add(Measure::BestOf, metrics::min_displacement(modes, truth));
                }
                if let Some(single) = single {
                    add(Measure::Single, displacement(single, truth));
                }
                if let Some(likely) = likely.and_then(|mode| modes.get(mode)) {
                    add(Measure::Top1, displacement(likely, truth));
                }
            }
        }
    }

    /// Adds the joint errors of a scene's counted agents; `present` is the number of agents that are
    /// forecast.
    pub(crate) fn add_scene(
        &mut self,
        scene: &[(&Agent, &[Candidate; METHODS])],
        present: usize,
        horizons: &[usize],
    ) {
        self.scene_count += 1;
        for method in 0..METHODS {
            let modes_len = scene.first().map_or(0, |(_, candidates)| candidates[method].modes.len());
            let is_joint = |(_, c): &(&Agent, &[Candidate; METHODS])| c[method].modes.len() == modes_len;
            if modes_len == 0 || !scene.iter().all(is_joint) {
                continue;
            }
            let ranked: Option<Vec<Vec<_>>> =
                scene.iter().map(|(_, candidates)| by_rank(&candidates[method])).collect();
            let narrowed: Option<Vec<Vec<_>>> =
                scene.iter().map(|(_, candidates)| narrowed(&candidates[method], present)).collect();
            for (horizon, &steps) in horizons.iter().enumerate() {
                let truths = scene.iter().map(|(agent, _)| &agent.future[..steps]);
                let plain = scene.iter().map(|(_, candidates)| &candidates[method].modes[..]);
                let pairs: Vec<_> = plain.zip(truths.clone()).collect();
                self.add_joint(method, Measure::Joint, horizon, joint_min_displacement(&pairs));
                if let Some(ranked) = &ranked {
                    let pairs: Vec<_> = ranked.iter().map(Vec::as_slice).zip(truths.clone()).collect();
                    self.add_joint(method, Measure::JointRanked, horizon, joint_min_displacement(&pairs));
                }
                if let Some(narrowed) = &narrowed {
                    let pairs: Vec<_> = narrowed.iter().map(Vec::as_slice).zip(truths).collect();
                    self.add_joint(method, Measure::JointNarrowed, horizon, joint_min_displacement(&pairs));
                }
            }
        }
    }

    fn add_joint(
        &mut self,
        method: usize,
        measure: Measure,
        horizon: usize,
        errors: metrics::DisplacementMean,
    ) {
        let total = |mean: &Mean| mean.value().unwrap_or_default() * mean.len() as f64;
        let [ade, fde] = &mut self.sums[horizon][method][measure.index()];
        ade.add(total(&errors.ade_m));
        fde.add(total(&errors.fde_m));
        self.counts[method][measure.index()] += if horizon == 0 { errors.ade_m.len() } else { 0 };
    }
}

/// The modes by descending probability; `None` without probabilities.
fn by_rank(candidate: &Candidate) -> Option<Vec<&[metrics::Point]>> {
    let probability = candidate.probability.as_ref()?;
    let mut order: Vec<usize> = (0..candidate.modes.len()).collect();
    order.sort_by(|&a, &b| probability[b].total_cmp(&probability[a]));
    Some(order.into_iter().map(|mode| &candidate.modes[mode][..]).collect())
}

/// The modes in [`Measure::JointNarrowed`] for a scene of `present` agents; `None` without a single forecast.
fn narrowed(candidate: &Candidate, present: usize) -> Option<Vec<Vec<metrics::Point>>> {
    let single = candidate.single.as_ref()?;
    let own = metrics::joint_spread(present, candidate.modes.len());
    let future =
        |(k, mode): (usize, &Vec<_>)| metrics::interpolated(single, mode, if k % 2 == 0 { 1.0 } else { own });
    Some(candidate.modes.iter().enumerate().map(future).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::{AgentType, State};

    /// An agent that stands at the origin and moves to `future`.
    fn agent(future: [metrics::Point; 2]) -> Agent {
        Agent {
            id: 1,
            agent_type: AgentType::Pedestrian,
            length_m: None,
            history: vec![Some(State::default())],
            future: future.map(Some).to_vec(),
        }
    }

    /// Two modes of the network, 1 m and 3 m to the left of the truth. The farther one is more probable.
    fn candidates(near_first: bool) -> [Candidate; METHODS] {
        let mut candidates: [Candidate; METHODS] = Default::default();
        let (near, far) = (vec![[1.0, 1.0], [2.0, 1.0]], vec![[1.0, 3.0], [2.0, 3.0]]);
        let modes = if near_first { vec![near, far] } else { vec![far, near] };
        let probability = if near_first { vec![0.2, 0.8] } else { vec![0.8, 0.2] };
        candidates[Method::Network.index()] = Candidate {
            single: Some(modes[0].clone()),
            modes,
            probability: Some(probability),
            ..Candidate::default()
        };
        candidates
    }

    #[test]
    fn errors_by_hand() {
        let agent = agent([[1.0, 0.0], [2.0, 0.0]]);
        let mut tally = Tally::new(2);
        tally.add_agent(&agent, &candidates(true), &[1, 2]);
        let errors = |measure| tally.errors(Method::Network, measure, 1).map(|errors| errors.fde_m);
        assert_eq!(errors(Measure::BestOf), Some(1.0));
        assert_eq!(errors(Measure::Single), Some(1.0));
        assert_eq!(errors(Measure::Top1), Some(3.0));
        assert_eq!(errors(Measure::Joint), None, "no scene was counted");
        assert_eq!(tally.errors(Method::Base, Measure::BestOf, 1), None);
    }

    #[test]
    fn one_future_of_the_scene_serves_all_its_agents() {
        let agent = agent([[1.0, 0.0], [2.0, 0.0]]);
        let (first, second) = (candidates(true), candidates(false));
        let mut tally = Tally::new(1);
        tally.add_scene(&[(&agent, &first), (&agent, &second)], 2, &[2]);
        let errors = |measure| tally.errors(Method::Network, measure, 0).map(|errors| errors.ade_m);
        assert_eq!(errors(Measure::Joint), Some(2.0), "mode 0 is near for one, far for the other");
        assert_eq!(errors(Measure::JointRanked), Some(1.0), "the second likeliest is near for both");
    }

    #[test]
    fn every_other_future_is_narrowed() {
        // The single forecast and mode 0 are 3 m off, mode 1 is 1 m off.
        let (agent, candidates) = (agent([[1.0, 0.0], [2.0, 0.0]]), candidates(false));
        let narrowed = |present: usize| {
            let mut tally = Tally::new(1);
            tally.add_scene(&[(&agent, &candidates), (&agent, &candidates)], present, &[2]);
            tally.errors(Method::Network, Measure::JointNarrowed, 0).map(|errors| errors.ade_m)
        };
        for present in [1, 2, 50] {
            let expected = 3.0 - 2.0 * f64::from(metrics::joint_spread(present, 2));
            assert!(narrowed(present).is_some_and(|ade_m| (ade_m - expected).abs() < 1e-5), "{present}");
        }
        assert_eq!(narrowed(1), Some(1.0));
        assert!(narrowed(50) > Some(2.0), "fifty agents leave little to each");
    }

    #[test]
    fn merged_parts_equal_the_whole_and_other_units_only_scale() {
        let agents = [agent([[1.0, 0.0], [2.0, 0.0]]), agent([[0.0, 1.0], [0.0, 2.0]])];
        let (mut whole, mut merged) = (Tally::new(1), Tally::new(1));
        for agent in &agents {
            let mut part = Tally::new(1);
            part.add_agent(agent, &candidates(true), &[2]);
            merged.merge(&part);
            whole.add_agent(agent, &candidates(true), &[2]);
        }
        assert_eq!(merged, whole);
        let metres = whole.sum(Method::Network, Measure::BestOf, 0);
        let pixels = whole.scaled(20.0).sum(Method::Network, Measure::BestOf, 0);
        assert_eq!(pixels, metres.map(|sum| sum.scaled(20.0)));
    }
}
