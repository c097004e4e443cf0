use nalgebra::SVector;

use crate::{Evidence, FilterFault, GAP_MAX_NS, Gaussian, Innovation, Observation, STEP_MAX_NS};

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
        let mut state = *self;
        for _ in 0..steps_len {
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
        let (mut posterior, evidence) = self.corrected(&process.innovation(&self.mean, seen))?;
        process.settle(&mut posterior.mean);
        *self = posterior;
        Ok(evidence)
    }
}

/// Number and length of equal steps, each of at most 80 ms.
pub(crate) fn steps(dt_ns: u64) -> Result<(u64, f64), FilterFault> {
    if dt_ns > GAP_MAX_NS {
        return Err(FilterFault::TooLong(dt_ns));
    }
    let steps_len = dt_ns.div_ceil(STEP_MAX_NS);
    Ok((steps_len, dt_ns as f64 / 1e9 / steps_len.max(1) as f64))
}
