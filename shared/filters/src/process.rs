use nalgebra::SVector;

use crate::innovation::Misfit;
use crate::observation::OBSERVATIONS_MAX;
use crate::{
    Evidence, FilterFault, GAP_MAX_NS, Gaussian, Innovation, Observation, STEP_MAX_NS, STEP_MAX_S, moments,
};

/// A process and measurement model. It defines how a state of `N` components moves and how observations
/// measure it. The first two components are the position.
pub trait Process<const N: usize> {
    /// The components that are angles on the full circle and therefore have circular means. An angle that
    /// stays small does not count.
    const ANGLES: &'static [usize];

    /// The state `dt_s` later. `dt_s` is at most 80 ms.
    #[must_use]
    fn step(&self, state: &Gaussian<N>, dt_s: f64) -> Gaussian<N>;

    /// The innovation of an observation relative to a state.
    #[must_use]
    fn innovation(&self, mean: &SVector<f64, N>, observation: &Observation) -> Innovation<N>;

    /// Constrains the mean after an update to its range: wraps angles and applies limits.
    fn constrain(&self, mean: &mut SVector<f64, N>);
}

impl<const N: usize> Gaussian<N> {
    /// Predicts the state `dt_ns` ahead, in equal steps of at most 80 ms.
    ///
    /// # Errors
    /// [`FilterFault`]; the state is then unchanged.
    pub fn predict(&mut self, dt_ns: u64, process: &impl Process<N>) -> Result<(), FilterFault> {
        let (step_count, dt_s) = steps(dt_ns)?;
        if step_count == 0 {
            return Ok(());
        }
        let mut state = process.step(self, dt_s);
        for _ in 1..step_count {
            state = process.step(&state, dt_s);
        }
        if !state.is_finite() {
            return Err(FilterFault::NotFinite);
        }
        *self = state;
        Ok(())
    }

    /// The state `dt_s` later (earlier if `dt_s` is negative) by a process without noise. Shifting ahead and
    /// back gives the same state.
    #[must_use]
    pub fn shifted(&self, dt_s: f64, noiseless: &impl Process<N>) -> Self {
        let step_count = (dt_s.abs() / STEP_MAX_S).ceil().max(1.0);
        let mut state = *self;
        for _ in 0..step_count as usize {
            state = noiseless.step(&state, dt_s / step_count);
        }
        state
    }

    /// Updates the state by an observation.
    ///
    /// # Errors
    /// [`FilterFault`]; the state is then unchanged.
    pub fn update(
        &mut self,
        observation: &Observation,
        process: &impl Process<N>,
    ) -> Result<Evidence, FilterFault> {
        self.update_state(observation, process).map(|misfit| misfit.evidence())
    }

    fn update_state(
        &mut self,
        observation: &Observation,
        process: &impl Process<N>,
    ) -> Result<Misfit, FilterFault> {
        let misfit = self.correct(&process.innovation(&self.mean, observation))?;
        process.constrain(&mut self.mean);
        Ok(misfit)
    }

    /// Updates the state by several observations. At most one of them is an observation of the agent. Each
    /// comes with the probability that it is; the remaining probability is that none is.
    ///
    /// The state becomes the Gaussian with the [`moments`](fn@crate::moments) of its posteriors under each
    /// observation and of the state itself. If all observations have the same noise, this is the
    /// probabilistic data association filter \[Y. Bar-Shalom, E. Tse: *Tracking in a cluttered environment
    /// with probabilistic data association*, 1975\], including the spread of the innovations. A single
    /// observation of probability 1 is an [update](Gaussian::update) to the bit. Without observations the
    /// state is unchanged.
    ///
    /// # Errors
    /// [`FilterFault`] if the update by any observation fails; the state is then unchanged.
    ///
    /// # Panics
    /// If there are more than [`OBSERVATIONS_MAX`] observations, a probability is invalid, or the
    /// probabilities add up to more than 1.
    pub fn update_jointly<P: Process<N>>(
        &mut self,
        observations: &[(f64, Observation)],
        process: &P,
    ) -> Result<(), FilterFault> {
        if observations.is_empty() {
            return Ok(());
        }
        let missed = miss_probability(observations);
        if let [(_, only)] = observations
            && missed == 0.0
        {
            return self.update_state(only, process).map(drop);
        }
        let mut posteriors = [(0.0, *self); OBSERVATIONS_MAX + 1];
        let slots = posteriors[..OBSERVATIONS_MAX].iter_mut();
        for ((weight, posterior), (probability, observation)) in slots.zip(observations) {
            posterior.update_state(observation, process)?;
            *weight = *probability;
        }
        posteriors[observations.len()].0 = missed;
        let weighed = posteriors[..=observations.len()].iter().map(|(weight, state)| (*weight, state));
        let matched = moments(weighed, P::ANGLES);
        if !matched.is_finite() {
            return Err(FilterFault::NotFinite);
        }
        *self = matched;
        Ok(())
    }
}

/// Probability that no observation is of the agent. One observation of probability 1 gives exactly 0.
pub(crate) fn miss_probability(observations: &[(f64, Observation)]) -> f64 {
    let len = observations.len();
    assert!(len <= OBSERVATIONS_MAX, "{len} observations, at most {OBSERVATIONS_MAX}");
    let missed = observations.iter().fold(1.0, |rest, (probability, _)| {
        assert!((0.0..=1.0).contains(probability), "{probability} is no probability");
        rest - probability
    });
    assert!(missed > -1e-9, "probabilities add up to 1 − {missed}");
    missed.max(0.0)
}

/// Number and length of equal steps, each of at most 80 ms.
pub(crate) fn steps(dt_ns: u64) -> Result<(u64, f64), FilterFault> {
    if dt_ns > GAP_MAX_NS {
        return Err(FilterFault::TooLong(dt_ns));
    }
    let step_count = dt_ns.div_ceil(STEP_MAX_NS);
    Ok((step_count, dt_ns as f64 / 1e9 / step_count.max(1) as f64))
}
