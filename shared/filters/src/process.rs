use nalgebra::SVector;

use crate::innovation::Misfit;
use crate::observation::OBSERVATIONS_MAX;
use crate::{Evidence, FilterFault, GAP_MAX_NS, Gaussian, Innovation, Observation, STEP_MAX_NS, moments};

/// How agents move and how they are seen: a state of `N` components, the first two the position, and its noise.
pub trait Process<const N: usize> {
    /// The components that go round: their means are taken on the circle. An angle that stays small is none of these.
    const ANGLES: &'static [usize];

    /// The state `dt_s` later, at most 80 ms.
    #[must_use]
    fn step(&self, state: &Gaussian<N>, dt_s: f64) -> Gaussian<N>;

    /// What an observation tells beyond a state.
    #[must_use]
    fn innovation(&self, mean: &SVector<f64, N>, seen: &Observation) -> Innovation<N>;

    /// Brings the mean after an update back into its range: angles wrapped, limits kept.
    fn settle(&self, mean: &mut SVector<f64, N>);
}

impl<const N: usize> Gaussian<N> {
    /// Moves the state on by `dt_ns`, in equal steps of at most 80 ms.
    ///
    /// # Errors
    /// [`FilterFault`]; the state is then as before.
    pub fn predict(&mut self, dt_ns: u64, process: &impl Process<N>) -> Result<(), FilterFault> {
        let (steps_len, dt_s) = steps(dt_ns)?;
        if steps_len == 0 {
            return Ok(());
        }
        let mut state = process.step(self, dt_s);
        for _ in 1..steps_len {
            state = process.step(&state, dt_s);
        }
        if !state.is_finite() {
            return Err(FilterFault::NotFinite);
        }
        *self = state;
        Ok(())
    }

    /// Corrects the state by what was observed.
    ///
    /// # Errors
    /// [`FilterFault`]; the state is then as before.
    pub fn update(&mut self, seen: &Observation, process: &impl Process<N>) -> Result<Evidence, FilterFault> {
        self.take_in(seen, process).map(|misfit| misfit.evidence())
    }

    fn take_in(&mut self, seen: &Observation, process: &impl Process<N>) -> Result<Misfit, FilterFault> {
        let misfit = self.correct(&process.innovation(&self.mean, seen))?;
        process.settle(&mut self.mean);
        Ok(misfit)
    }

    /// Corrects the state by observations of which at most one is of the agent, each with the probability that it is;
    /// what these lack of 1 is the probability that none is.
    ///
    /// The state becomes the Gaussian with the [`moments`] of its posteriors under each observation and of itself. Where
    /// all have the same noise, that is the probabilistic data association filter
    /// \[Y. Bar-Shalom, E. Tse: *Tracking in a cluttered environment with probabilistic data association*, 1975\], its
    /// spread of the innovations included. A single observation of probability 1 is an [update](Gaussian::update) to the bit,
    /// none changes nothing.
    ///
    /// # Errors
    /// [`FilterFault`] where the update by any of them fails; the state is then as before.
    ///
    /// # Panics
    /// If there are more than [`SIDE_MAX`] observations, or their probabilities are none or add up to more than 1.
    pub fn update_jointly<P: Process<N>>(
        &mut self,
        seen: &[(f64, Observation)],
        process: &P,
    ) -> Result<(), FilterFault> {
        if seen.is_empty() {
            return Ok(());
        }
        let missed = missed(seen);
        if let [(_, only)] = seen
            && missed == 0.0
        {
            return self.take_in(only, process).map(drop);
        }
        let mut posteriors = [(0.0, *self); OBSERVATIONS_MAX + 1];
        for ((weight, posterior), (probability, seen)) in posteriors[..OBSERVATIONS_MAX].iter_mut().zip(seen)
        {
            posterior.take_in(seen, process)?;
            *weight = *probability;
        }
        posteriors[seen.len()].0 = missed;
        let weighed = posteriors[..=seen.len()].iter().map(|(weight, state)| (*weight, state));
        let corrected = moments(weighed, P::ANGLES);
        if !corrected.is_finite() {
            return Err(FilterFault::NotFinite);
        }
        *self = corrected;
        Ok(())
    }
}

/// Probability that none of the observations is of the agent; 0 to the bit where a single one is for certain.
pub(crate) fn missed(seen: &[(f64, Observation)]) -> f64 {
    assert!(seen.len() <= OBSERVATIONS_MAX, "{} observations, at most {OBSERVATIONS_MAX}", seen.len());
    let missed = seen.iter().fold(1.0, |rest, (probability, _)| {
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
    let steps_len = dt_ns.div_ceil(STEP_MAX_NS);
    Ok((steps_len, dt_ns as f64 / 1e9 / steps_len.max(1) as f64))
}
