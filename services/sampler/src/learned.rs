use kinematics::{ControlGaussian, Moments, Normals, mixture};
use wire::{AgentControls, Expert, Forecast, HORIZON_MAX, MODES_MAX, Rejected};

use crate::Propagation;
use crate::mover::Mover;

/// The probabilities of an agent's modes may miss 1 by this much.
const PROBABILITY_SLACK: f32 = 1e-3;

/// The controls of an agent that a forecast can be made of.
pub(crate) struct LearnedControls<'a> {
    controls: &'a AgentControls,
    horizon_len: usize,
    /// What is added to the best forecast's controls.
    change: Change,
    /// What is added to every mode's controls.
    change_of_modes: Change,
    /// Modes that others take the place of: what is added to the best forecast's controls instead.
    replaced: [Option<Change>; MODES_MAX],
    probability: [f32; MODES_MAX],
}

/// What is added to controls, step by step.
pub(crate) type Change = [[f32; 2]; HORIZON_MAX];

impl<'a> LearnedControls<'a> {
    /// Refuses controls that are not finite, or modes whose probabilities are none.
    pub(crate) fn new(controls: &'a AgentControls, horizon_len: usize) -> Result<Self, Rejected> {
        controls.check()?;
        let probability = &controls.probability[..controls.modes_len as usize];
        let sum: f32 = probability.iter().sum();
        let impossible =
            |value: f32| Rejected::Impossible { field: "mode probability", value: f64::from(value) };
        if let Some(negative) = probability.iter().find(|p| **p < 0.0) {
            return Err(impossible(*negative));
        }
        if (sum - 1.0).abs() > PROBABILITY_SLACK {
            return Err(impossible(sum));
        }
        Ok(Self {
            controls,
            horizon_len,
            change: Change::default(),
            change_of_modes: Change::default(),
            replaced: [None; MODES_MAX],
            probability: controls.probability,
        })
    }

    /// Adds to the controls of the best forecast, and of all modes.
    pub(crate) const fn change(&mut self, of_best: Change, of_modes: Change) {
        (self.change, self.change_of_modes) = (of_best, of_modes);
    }

    /// Gives a mode its probability and, where there is a change, the best forecast's controls with that change in place of its own;
    /// its deviations stay.
    pub(crate) const fn replace(&mut self, mode: usize, change: Option<Change>, probability: f32) {
        (self.replaced[mode], self.probability[mode]) = (change, probability);
    }

    /// The probability of each mode.
    pub(crate) fn probability(&self) -> &[f32] {
        &self.probability[..self.controls.modes_len as usize]
    }

    /// Where the best forecast leads.
    pub(crate) fn best_path(&self, mover: &Mover) -> [[f32; 2]; HORIZON_MAX] {
        self.path(mover, self.best_steps())
    }

    /// Where the modes lead.
    pub(crate) fn mode_paths(&self, mover: &Mover, out: &mut Vec<[[f32; 2]; HORIZON_MAX]>) {
        let modes_len = self.controls.modes_len as usize;
        out.extend((0..modes_len).map(|mode| self.path(mover, self.mode_steps(mode))));
    }

    /// Where the best forecast's controls lead with a change of their own.
    pub(crate) fn path_beside_best(&self, mover: &Mover, change: &Change) -> [[f32; 2]; HORIZON_MAX] {
        self.path(mover, self.steps(&self.controls.best, &self.controls.best, *change))
    }

    /// Writes modes with their controls, best forecast and moments.
    pub(crate) fn forecast(
        &self,
        mover: &Mover,
        propagation: Propagation,
        normals: &mut Normals,
        out: &mut Forecast,
    ) {
        let modes_len = self.controls.modes_len as usize;
        let mut moments = [[Moments::default(); HORIZON_MAX]; MODES_MAX];
        let modes = out.controls.iter_mut().zip(&mut moments).enumerate();
        for (mode, (told, moments)) in modes.take(modes_len) {
            let moments = &mut moments[..self.horizon_len];
            let mut acting = [ControlGaussian::centred([0.0; 2]); HORIZON_MAX];
            for ((control, acting), told) in self.mode_steps(mode).zip(&mut acting).zip(told) {
                *acting = mover.acting(&control);
                *told = mover.told(acting);
            }
            match propagation {
                Propagation::Linearised => mover.carry(acting.into_iter(), moments),
                Propagation::MonteCarlo { particles } => {
                    mover.scatter(self.mode_steps(mode), particles, normals, moments);
                }
            }
        }
        let (steering, frame_heading_rad) = mover.steering();
        (out.steering, out.frame_heading_rad) = (steering as u32, frame_heading_rad);
        mover.follow(self.best_steps(), &mut out.best[..self.horizon_len]);
        out.modes_len = self.controls.modes_len;
        out.probability[..modes_len].copy_from_slice(self.probability());

        for (expert, replaced) in out.mode_expert.iter_mut().zip(&self.replaced).take(modes_len) {
            *expert = if replaced.is_some() { Expert::Retrieval } else { Expert::Network } as u8;
        }
        for step in 0..self.horizon_len {
            let parts =
                out.probability.iter().zip(&moments).take(modes_len).map(|(p, mode)| (*p, mode[step]));
            let mixed = mixture(parts.clone());
            (out.mean[step], out.covariance[step]) = (mixed.mean, mixed.covariance);
            let modes = out.modes.iter_mut().zip(&mut out.mode_covariance);
            for ((mode, covariance), (_, part)) in modes.zip(parts) {
                (mode[step], covariance[step]) = (part.mean, part.covariance);
            }
        }
    }

    fn path(&self, mover: &Mover, steps: impl Iterator<Item = ControlGaussian>) -> [[f32; 2]; HORIZON_MAX] {
        let mut path = [[0.0; 2]; HORIZON_MAX];
        mover.follow(steps, &mut path[..self.horizon_len]);
        path
    }

    fn best_steps(&self) -> impl Iterator<Item = ControlGaussian> + use<'a> {
        self.steps(&self.controls.best, &self.controls.best, self.change)
    }

    fn mode_steps(&self, mode: usize) -> impl Iterator<Item = ControlGaussian> + use<'a> {
        match self.replaced[mode] {
            Some(change) => self.steps(&self.controls.best, &self.controls.modes[mode], change),
            None => self.steps(&self.controls.modes[mode], &self.controls.modes[mode], self.change_of_modes),
        }
    }

    fn steps(
        &self,
        means: &'a [wire::ControlGaussian; HORIZON_MAX],
        spreads: &'a [wire::ControlGaussian; HORIZON_MAX],
        change: Change,
    ) -> impl Iterator<Item = ControlGaussian> + use<'a> {
        let parts = means.iter().zip(spreads).zip(change).take(self.horizon_len);
        parts.map(|((means, spreads), change)| {
            let mean = [0, 1].map(|component| means.mean[component] + change[component]);
            ControlGaussian::new(mean, spreads.cholesky)
        })
    }
}
