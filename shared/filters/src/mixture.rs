//! The learned prior, linearised: a mixture of Kalman filters, one per draw of a forecast.
//!
//! Every draw of a forecast is a hypothesis about the agent's controls. Given the controls, the state is
//! nearly Gaussian. Only the hypothesis is therefore sampled, and the filter is *Rao-Blackwellised*.
//! Measurements weigh the hypotheses by their evidence, w_k ∝ w_k N(y; 0, S_k). One more component, predicted
//! by the kinematic process alone, covers the case that no draw is right.
//!
//! When a new forecast is adopted, the mixture collapses to the Gaussian of its moments. The forecast's
//! controls then predict this posterior. The forecast's own states are never used, because they would discard
//! every measurement since its stamp.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::observation::OBSERVATIONS_MAX;
use crate::plan::Plan;
use crate::process::{miss_probability, steps};
use crate::weights::{effective_size, log_sum_exp, normalise, systematic};
use crate::{
    Control, Controlled, FilterFault, Forecast, ForecastFault, Gaussian, HYPOTHESES_MAX, Observation, Priors,
    moments,
};

/// The predicted position of an agent, by either prior.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ahead {
    /// Position by the forecast.
    pub learned_m: [f64; 2],
    /// Position by the kinematic process alone.
    pub kinematic_m: [f64; 2],
}

#[derive(Clone, Copy, Debug)]
struct Component<const N: usize> {
    state: Gaussian<N>,
    log_weight: f64,
    /// `None`: the kinematic component.
    hypothesis: Option<usize>,
    /// Number of particles that it stands for. Particles resampled from one hypothesis stay equal forever.
    copies: usize,
}

impl<const N: usize> Component<N> {
    const fn process<'a, P>(&self, priors: &'a Priors<P>) -> &'a P {
        match self.hypothesis {
            None => &priors.kinematic,
            Some(_) => &priors.learned,
        }
    }
}

/// A mixture of Kalman filters, one per hypothesis of a forecast and one without.
#[derive(Debug)]
pub struct Mixture<P, const N: usize> {
    /// Processes and trust. They may be changed between calls.
    pub priors: Priors<P>,
    components: Vec<Component<N>>,
    /// The components of the next state. They replace the others once the step succeeds.
    next: Vec<Component<N>>,
    plan: Plan,
    age_ns: u64,
    rng: ChaCha8Rng,
}

impl<P: Controlled<N>, const N: usize> Mixture<P, N> {
    /// A mixture of the kinematic component alone.
    #[must_use]
    pub fn new(state: Gaussian<N>, priors: Priors<P>, seed: u64) -> Self {
        let mut mixture = Self {
            priors,
            components: Vec::with_capacity(HYPOTHESES_MAX + 1),
            next: Vec::with_capacity(HYPOTHESES_MAX + 1),
            plan: Plan::default(),
            age_ns: 0,
            rng: ChaCha8Rng::seed_from_u64(seed),
        };
        mixture.reset(state);
        mixture
    }

    /// Drops the forecast and continues from `state`.
    pub fn reset(&mut self, state: Gaussian<N>) {
        self.components.clear();
        self.components.push(Component { state, log_weight: 0.0, hypothesis: None, copies: 1 });
    }

    /// Adopts a forecast as the prior from now on. The mixture first collapses to its moments.
    ///
    /// # Errors
    /// [`ForecastFault`]; the mixture is then unchanged.
    pub fn adopt(&mut self, forecast: &Forecast) -> Result<(), ForecastFault> {
        self.plan.adopt(forecast, &self.priors)?;
        self.age_ns = forecast.age_ns;
        let state = self.moments();
        let kinematic = self.priors.kinematic_weight;
        self.components.clear();
        if kinematic > 0.0 {
            let log_weight = kinematic.ln();
            self.components.push(Component { state, log_weight, hypothesis: None, copies: 1 });
        }
        let sum: f64 = forecast.probability.iter().sum();
        for (hypothesis, probability) in forecast.probability.iter().enumerate() {
            let weight = (1.0 - kinematic) * probability / sum;
            if weight > 0.0 {
                let (log_weight, hypothesis) = (weight.ln(), Some(hypothesis));
                self.components.push(Component { state, log_weight, hypothesis, copies: 1 });
            }
        }
        Ok(())
    }

    /// Predicts all components `dt_ns` ahead. Beyond the forecast's horizon it uses the kinematic process
    /// alone.
    ///
    /// A component that fails is dropped.
    ///
    /// # Errors
    /// [`FilterFault`] if all components fail; the mixture is then unchanged, or collapsed to its moments.
    pub fn predict(&mut self, dt_ns: u64) -> Result<(), FilterFault> {
        let (step_count, dt_s) = steps(dt_ns)?;
        let age_ns = self.age_ns.saturating_add(dt_ns);
        if self.is_learned() && age_ns > self.plan.horizon_ns {
            self.reset(self.moments());
        }
        self.next.clear();
        for component in &self.components {
            let mut state = component.state;
            match component.hypothesis {
                None => {
                    for _ in 0..step_count {
                        state = self.priors.kinematic.step(&state, dt_s);
                    }
                }
                Some(hypothesis) => {
                    for i in 0..step_count {
                        // The control at the middle of the step, because a step's end may belong to the next
                        // control.
                        let middle_ns = self.age_ns + dt_ns * (2 * i + 1) / (2 * step_count);
                        let control = self.plan.at::<P, N>(hypothesis, middle_ns);
                        let process = self.priors.controlled(self.plan.gain(middle_ns));
                        state = process.step_controlled(&state, &control, dt_s);
                    }
                    self.priors.learned.constrain(&mut state.mean);
                }
            }
            if state.is_finite() {
                self.next.push(Component { state, ..*component });
            }
        }
        if self.next.is_empty() {
            return Err(FilterFault::NotFinite);
        }
        self.age_ns = age_ns;
        self.commit();
        Ok(())
    }

    /// Moves all components `dt_s` ahead (back if `dt_s` is negative) by a process without noise. The
    /// forecast's age does not change.
    pub fn shift(&mut self, dt_s: f64, noiseless: &P) {
        for component in &mut self.components {
            component.state = component.state.shifted(dt_s, noiseless);
        }
    }

    /// The positions after 1 to `PARTS` times `part_ns`, by the forecast and by the kinematic process alone.
    /// Returns `None` if there is no forecast or its horizon is too short.
    ///
    /// The forecast is followed by the mean of its hypotheses' controls. To first order this leads to the
    /// mean of their positions.
    #[must_use]
    pub fn ahead<const PARTS: usize>(&self, part_ns: u64) -> Option<[Ahead; PARTS]> {
        let (step_count, dt_s) = steps(part_ns).ok()?;
        let horizon_ns = part_ns.saturating_mul(PARTS as u64).saturating_add(self.age_ns);
        if !self.is_learned() || horizon_ns > self.plan.horizon_ns {
            return None;
        }
        let hypotheses = || self.components.iter().filter_map(|c| Some((c.hypothesis?, c.log_weight.exp())));
        let sum: f64 = hypotheses().map(|(_, weight)| weight).sum();
        let now = self.moments();
        let (mut learned, mut kinematic) = (now, now);
        let mut begun_ns = self.age_ns;
        let ahead = [(); PARTS].map(|()| {
            for i in 0..step_count {
                let middle_ns = begun_ns + part_ns * (2 * i + 1) / (2 * step_count);
                let mut mean = Control::default();
                for (hypothesis, weight) in hypotheses() {
                    let rate = self.plan.at::<P, N>(hypothesis, middle_ns).rate;
                    mean.rate = [0, 1].map(|axis| mean.rate[axis] + weight / sum * rate[axis]);
                }
                let process = self.priors.controlled(self.plan.gain(middle_ns));
                learned = process.step_controlled(&learned, &mean, dt_s);
                kinematic = self.priors.kinematic.step(&kinematic, dt_s);
            }
            begun_ns += part_ns;
            let [learned_m, kinematic_m] = [&learned, &kinematic].map(|state| [state.mean[0], state.mean[1]]);
            Ahead { learned_m, kinematic_m }
        });
        let are_finite = ahead.iter().all(|ahead| {
            let positions_m = [ahead.learned_m, ahead.kinematic_m];
            positions_m.as_flattened().iter().all(|position| position.is_finite())
        });
        are_finite.then_some(ahead)
    }

    /// Updates all components and their weights by an observation. Returns the logarithm of its density under
    /// the mixture.
    ///
    /// A component that fails is dropped.
    ///
    /// # Errors
    /// [`FilterFault`] if all components fail; the mixture is then unchanged.
    pub fn update(&mut self, observation: &Observation) -> Result<f64, FilterFault> {
        let mut fault = FilterFault::NotFinite;
        self.next.clear();
        for component in &self.components {
            let mut state = component.state;
            match state.update(observation, component.process(&self.priors)) {
                Ok(evidence) => {
                    let log_weight = component.log_weight + evidence.log_likelihood;
                    self.next.push(Component { state, log_weight, ..*component });
                }
                Err(found) => fault = found,
            }
        }
        let log_likelihood = log_sum_exp(self.next.iter().map(|component| component.log_weight));
        if !log_likelihood.is_finite() {
            return Err(fault);
        }
        self.commit();
        self.resample();
        Ok(log_likelihood)
    }

    /// Updates all components and their weights by several observations. At most one of them is an
    /// observation of the agent. Each comes with the probability β that it is; the remaining probability is
    /// that none is.
    ///
    /// A component gains weight w by the observations that it predicted better than the mixture did. These
    /// observations also count for more in the component's own [`Gaussian::update_jointly`]. Together the
    /// components have the moments of the mixture's posteriors under each observation and of the mixture
    /// itself:
    ///
    /// ```text
    /// s_kj = w_k β_j N_k(y_j) / Σ_i w_i N_i(y_j)      s_k0 = w_k β_0
    /// w'_k = Σ_j s_kj      β_kj = s_kj / w'_k
    /// ```
    ///
    /// A component that fails is dropped.
    ///
    /// # Errors
    /// [`FilterFault`] if all components fail, even at a single observation. The mixture is then unchanged.
    ///
    /// # Panics
    /// If there are more than [`OBSERVATIONS_MAX`] observations, a probability is invalid, or the
    /// probabilities add up to more than 1.
    pub fn update_jointly(&mut self, observations: &[(f64, Observation)]) -> Result<(), FilterFault> {
        let [first, ..] = observations else { return Ok(()) };
        if observations.len() == 1 && first.0 == 1.0 {
            return self.update(&first.1).map(drop);
        }
        let mut fault = FilterFault::NotFinite;
        let mut own = [*first; OBSERVATIONS_MAX];
        self.next.clear();
        for (component, log_shares) in self.components.iter().zip(&self.log_shares(observations)?) {
            let log_weight = log_sum_exp(log_shares.iter().copied());
            if !log_weight.is_finite() {
                continue;
            }
            // The difference of two large logarithms is imprecise, so the shares are normalised again.
            let share = |log_share: &f64| (log_share - log_weight).exp();
            let sum: f64 = log_shares.iter().map(share).sum();
            for ((own, observed), log_share) in own.iter_mut().zip(observations).zip(log_shares) {
                *own = ((share(log_share) / sum).min(1.0), observed.1);
            }
            let mut state = component.state;
            match state.update_jointly(&own[..observations.len()], component.process(&self.priors)) {
                Ok(()) => self.next.push(Component { state, log_weight, ..*component }),
                Err(found) => fault = found,
            }
        }
        if self.next.is_empty() {
            return Err(fault);
        }
        self.commit();
        self.resample();
        Ok(())
    }

    /// ln s of each component: one value per observation, and last the value for no observation.
    fn log_shares(
        &self,
        observations: &[(f64, Observation)],
    ) -> Result<[[f64; OBSERVATIONS_MAX + 1]; HYPOTHESES_MAX + 1], FilterFault> {
        let missed = miss_probability(observations);
        let mut log_shares = [[f64::NEG_INFINITY; OBSERVATIONS_MAX + 1]; HYPOTHESES_MAX + 1];
        for (j, (probability, observation)) in observations.iter().enumerate() {
            let mut fault = FilterFault::NotFinite;
            for (component, of_component) in self.components.iter().zip(&mut log_shares) {
                let mut state = component.state;
                match state.update(observation, component.process(&self.priors)) {
                    Ok(evidence) => of_component[j] = component.log_weight + evidence.log_likelihood,
                    Err(found) => fault = found,
                }
            }
            let log_sum = log_sum_exp(log_shares.iter().map(|of_component| of_component[j]));
            if !log_sum.is_finite() {
                return Err(fault);
            }
            for of_component in &mut log_shares {
                of_component[j] += probability.ln() - log_sum;
            }
        }
        for (component, of_component) in self.components.iter().zip(&mut log_shares) {
            of_component[OBSERVATIONS_MAX] = component.log_weight + missed.ln();
        }
        Ok(log_shares)
    }

    /// The Gaussian with the mixture's moments.
    pub fn moments(&self) -> Gaussian<N> {
        match self.components.as_slice() {
            [only] => only.state,
            all => moments(all.iter().map(|c| (c.log_weight.exp(), &c.state)), P::ANGLES),
        }
    }

    /// The remaining components with number, weight and state. The number of the kinematic component is
    /// `None`. The weights sum to 1.
    pub fn components(&self) -> impl Iterator<Item = (Option<usize>, f64, &Gaussian<N>)> {
        self.components.iter().map(|c| (c.hypothesis, c.log_weight.exp(), &c.state))
    }

    /// Weight of a hypothesis; 0 if it was dropped.
    #[must_use]
    pub fn weight(&self, hypothesis: usize) -> f64 {
        self.components().find(|c| c.0 == Some(hypothesis)).map_or(0.0, |c| c.1)
    }

    /// Whether a forecast is the prior.
    pub fn is_learned(&self) -> bool {
        self.components.iter().any(|component| component.hypothesis.is_some())
    }

    /// Time since the start of the forecast that is the prior.
    pub fn forecast_age_ns(&self) -> Option<u64> {
        self.is_learned().then_some(self.age_ns)
    }

    /// Replaces the components by the next ones and normalises the weights to the sum 1.
    fn commit(&mut self) {
        std::mem::swap(&mut self.components, &mut self.next);
        normalise(&mut self.components, |component| &mut component.log_weight);
        self.components.retain(|component| component.log_weight > f64::NEG_INFINITY);
    }

    /// Resamples the hypotheses if their effective number is below half the number of their particles. The
    /// kinematic component keeps its weight.
    fn resample(&mut self) {
        let learned = |component: &&Component<N>| component.hypothesis.is_some();
        let hypotheses = || self.components.iter().filter(learned);
        let sum = log_sum_exp(hypotheses().map(|component| component.log_weight));
        let weights = || hypotheses().map(|component| (component.log_weight - sum).exp());
        // A component of n copies counts as n particles of weight w / n each.
        let particle_count: usize = hypotheses().map(|component| component.copies).sum();
        let root = hypotheses().map(|component| (component.copies as f64).sqrt());
        let effective = effective_size(weights().zip(root).map(|(weight, root)| weight / root));
        if particle_count < 2 || effective >= particle_count as f64 / 2.0 {
            return;
        }
        let mut copies = [0; HYPOTHESES_MAX];
        for chosen in systematic(weights(), self.rng.random(), particle_count) {
            copies[chosen] += 1;
        }
        let chosen = self.components.iter_mut().filter(|component| component.hypothesis.is_some());
        for (component, copies) in chosen.zip(copies) {
            component.copies = copies;
            component.log_weight = sum + (copies as f64 / particle_count as f64).ln();
        }
        self.components.retain(|component| component.copies > 0);
    }
}

impl<P: Clone, const N: usize> Clone for Mixture<P, N> {
    fn clone(&self) -> Self {
        let mut components = Vec::with_capacity(HYPOTHESES_MAX + 1);
        components.extend_from_slice(&self.components);
        Self {
            priors: self.priors.clone(),
            components,
            next: Vec::with_capacity(HYPOTHESES_MAX + 1),
            plan: self.plan.clone(),
            age_ns: self.age_ns,
            rng: self.rng.clone(),
        }
    }

    /// Reuses the memory of components and controls.
    fn clone_from(&mut self, source: &Self) {
        self.priors.clone_from(&source.priors);
        self.components.clone_from(&source.components);
        self.plan.clone_from(&source.plan);
        self.age_ns = source.age_ns;
        self.rng.clone_from(&source.rng);
    }
}
